"""What the README shows works as it stands there."""

import os
import re
import subprocess
import sys
from pathlib import Path

from bridge.cli.commands import COMMANDS

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
PYTHON = (ROOT / "bridge" / "PYTHON.md").read_text()


#: Between the two: another folder, and three pictures of a film, as all 110 take longer than the rest.
BETWEEN = """
import os
from bridge.pictures.render import _Drawing
os.chdir("../page")
frames = _Drawing.frames
_Drawing.frames = lambda drawing, steps, *more: frames(drawing, steps[:3], *more)
print("-----")
"""


def test_what_pages_show_in_python_runs(tmp_path: Path) -> None:
    """The example of the README, then the page on Python, in one process; warnings are errors."""
    (example,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert len([line for line in example.splitlines() if line and not line.startswith(("from", "import"))]) <= 12
    page = "\n".join(re.findall(r"```python\n(.*?)```", PYTHON, re.DOTALL))
    for name in ("example", "page"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "data").symlink_to(ROOT / "data")
    code = f"exec({example!r}, {{}})\nexec({BETWEEN!r}, {{}})\n{page}"
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], cwd=tmp_path / "example", env=os.environ | {"MPLBACKEND": "Agg"},
        capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    shown, said = result.stdout.split("-----\n")
    assert shown.startswith("TrafficScene(")
    assert Path(tmp_path, "example", shown.splitlines()[-1]).is_dir()
    assert {path.name for path in (tmp_path / "example").iterdir()} > {"before_after.png", "gen_0.png", "scene.html"}
    assert re.search(r"^TrafficScene\(.*: \d+ recorded tracks, 0 inserted\)$", said, re.MULTILINE)
    assert re.search(
        r"^TrafficScene\(.*: \d+ recorded tracks, [1-6] inserted, \d of \d manoeuvres done\)$", said, re.MULTILINE
    )
    assert re.search(r"^standing_share +standing share .* 0\.\d+$", said, re.MULTILINE)
    assert {path.name for path in (tmp_path / "page").iterdir()} == {
        "data", "gen_0.png", "out", "scene.gif", "scene.html", "scene.png",
    }  # fmt: skip


def test_every_command_is_in_the_table() -> None:
    assert {name for name in COMMANDS if f"`hid2 {name}" not in README} == set()
