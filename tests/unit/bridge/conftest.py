"""A generated scene on disk and a virtual screen, made once for all tests that look at scenes."""

import os
import shutil
import subprocess
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
from recordings import make_argoverse1

from bridge.config import load_config
from bridge.generation.generate import generate
from bridge.recordings.scenario import read_scenario
from hid2 import resampling


@pytest.fixture(scope="session")
def made_root(tmp_path_factory: pytest.TempPathFactory, data_scenes: dict[str, Path]) -> Path:
    """A data-set root with one generated scene for two sources: eight vehicles each, many asked to change lanes."""
    out = tmp_path_factory.mktemp("made")
    settings = ["request.agents=8", "request.straight=0.3", "request.lane_change=0.5", "request.trigger_max_s=3"]
    config = load_config(None, settings)
    for name in ("arterial", "intersection"):
        generate(read_scenario(data_scenes[name]), config).write(out)
    return out


@pytest.fixture(scope="session")
def made_scene(made_root: Path, data_scenes: dict[str, Path]) -> Path:
    """The generated arterial scene."""
    sidecars = made_root.rglob("hid2_*.json")
    return next(path.parent for path in sidecars if data_scenes["arterial"].name in path.read_text())


@pytest.fixture(scope="session")
def argoverse1(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set of Argoverse 1, which no test may change."""
    return make_argoverse1(tmp_path_factory.mktemp("argoverse1") / "made")


@pytest.fixture
def few_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    """Intervals by a tenth of the usual draws, for tests that do not look at how sure they are."""
    monkeypatch.setattr(resampling, "draws", partial(resampling.draws, resamples=resampling.RESAMPLES // 10))


@pytest.fixture(scope="session")
def screen() -> Iterator[dict[str, str]]:
    """The environment of programs on a virtual screen; the X server takes a display number that is free."""
    if shutil.which("Xvfb") is None:
        pytest.skip("Xvfb is not installed: sh setup.sh tests")
    reading, writing = os.pipe()
    command = ["Xvfb", "-displayfd", str(writing), "-screen", "0", "1280x1024x24", "-nolisten", "tcp", "-noreset"]
    quiet = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(command, pass_fds=[writing], **quiet) as server:
        os.close(writing)
        with os.fdopen(reading) as pipe:
            number = pipe.readline().strip()  # nothing if the server ends
        assert number, f"Xvfb does not start, exit code {server.wait()}"
        yield {key: value for key, value in os.environ.items() if key != "XAUTHORITY"} | {"DISPLAY": f":{number}"}
        server.terminate()
