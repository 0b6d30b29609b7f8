"""What starting does without: the caller all that only scene processes need, these what nothing in them needs."""

import json
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from bridge.batch.isolation import IsolatedProcess

GENERATE = """
import json, sys
from bridge.cli import main
sys.argv = ["hid2", "generate", {folder!r}, "--agents", "1", "-o", {out!r}, "-q"]
try:
    main()
finally:
    print(json.dumps([name for name in {heavy!r} if name in sys.modules]))
"""
HEAVY = ["libsumo", "matplotlib", "numba", "numpy", "pandas", "pyarrow", "rich", "scipy", "shapely"]


def test_command_leaves_what_is_slow_to_import_to_the_scene_process(
    data_scenes: dict[str, Path], tmp_path: Path
) -> None:
    script = GENERATE.format(folder=str(data_scenes["curve"]), out=str(tmp_path / "out"), heavy=HEAVY)
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == []


def generated_with(folder: str, _items: Sequence[int]) -> Iterator[list[str]]:
    """Work of a scene process: generate, then say which optional libraries are there, and take one."""
    from bridge.batch import scene_work  # noqa: F401  # as the command does
    from bridge.generation.generate import generate
    from bridge.recordings.scenario import read_scenario
    from hid2.params import Config, Request

    scenario = read_scenario(Path(folder))

    def work() -> Iterator[list[str]]:
        generate(scenario, Config(request=Request(agents=3)))
        yield [
            name
            for name in (
                "matplotlib",
                "pandas",
                "pyproj",
                "scipy.linalg",
                "yaml",
                "numba.np.arraymath",
            )
            if name in sys.modules
        ]
        import pyproj
        import scipy.linalg

        yield [pyproj.__name__, scipy.linalg.__name__]

    return work()


def test_scene_process_spares_what_libraries_load_and_nothing_needs(
    data_scenes: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing of it is loaded by generating a scene, and it is there for whoever asks."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    process = IsolatedProcess(timeout_s=200.0)
    try:
        assert list(process.stream("test_start_up:generated_with", str(data_scenes["intersection"]), (1, 2))) == [
            [],
            ["pyproj", "scipy.linalg"],
        ]
        assert len(list(process.stream("test_start_up:generated_with", str(data_scenes["curve"]), (1, 2)))) == 2
    finally:
        process.close()
