"""What starting does without: the caller all that only scene processes need."""

import json
import subprocess
import sys
from pathlib import Path

GENERATE = """
import json, sys
from bridge.cli import main
sys.argv = ["hid2", "generate", {folder!r}, "--agents", "1", "-o", {out!r}, "-q"]
try:
    main()
finally:
    print(json.dumps([name for name in {heavy!r} if name in sys.modules]))
"""
HEAVY = ["distributed", "libsumo", "matplotlib", "numba", "numpy", "pandas", "pyarrow", "rich", "scipy", "shapely"]


def test_command_leaves_what_is_slow_to_import_to_the_scene_process(
    data_scenes: dict[str, Path], tmp_path: Path
) -> None:
    script = GENERATE.format(folder=str(data_scenes["curve"]), out=str(tmp_path / "out"), heavy=HEAVY)
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == []
