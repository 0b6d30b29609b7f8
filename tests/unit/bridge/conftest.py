"""A generated scene on disk, made once for all tests that look at scenes."""

from pathlib import Path

import pytest

from bridge.config import load_config
from bridge.generate import generate, write
from bridge.scenario import read_scenario


@pytest.fixture(scope="session")
def made_root(tmp_path_factory: pytest.TempPathFactory, data_scenes: dict[str, Path]) -> Path:
    """A data-set root with one generated scene for two sources: eight vehicles each, many asked to change lanes."""
    out = tmp_path_factory.mktemp("made")
    settings = ["request.agents=8", "request.straight=0.3", "request.lane_change=0.5", "request.trigger_max_s=3"]
    config = load_config(None, settings)
    for name in ("arterial", "intersection"):
        write(generate(read_scenario(data_scenes[name]), config), out)
    return out


@pytest.fixture(scope="session")
def made_scene(made_root: Path) -> Path:
    """The generated arterial scene: the one with the most lane changes."""
    folders = sorted(path.parent for path in made_root.rglob("scenario_*.parquet"))
    return max(folders, key=lambda folder: next(folder.glob("hid2_*.json")).read_text().count('"lane_change"'))
