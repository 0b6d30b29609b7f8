"""A generated scene made again from its sidecar, bit for bit."""

import json
import shutil
from pathlib import Path

import pytest

from bridge.batch.batch import Options, plan, run_batch
from bridge.batch.provenance import make_again
from bridge.config import load_config
from bridge.generation.generate import generate
from bridge.recordings.scenario import read_scenario
from bridge.recordings.sidecar import read_sidecar
from bridge.recordings.sources import find_sources
from netconvert.errors import ConfigError, NoSceneError, ScenarioError


@pytest.fixture(scope="module")
def made(data_scenes: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The curve with two vehicles, in a split folder."""
    scene = generate(read_scenario(data_scenes["curve"]), load_config(None, ["request.agents=2"]))
    return scene.write(tmp_path_factory.mktemp("made"))


@pytest.fixture
def scene(made: Path, tmp_path: Path) -> Path:
    """A copy of it that a test may spoil."""
    return shutil.copytree(made, tmp_path / "first" / "train" / made.name)


def sidecar_of(folder: Path) -> Path:
    return folder / f"hid2_{folder.name}.json"


def test_a_scene_is_made_again_bit_for_bit(scene: Path, data_root: Path, tmp_path: Path) -> None:
    made = make_again(sidecar_of(scene), data_root, tmp_path / "again")
    assert (made.folder.name, made.differences, made.compared) == (scene.name, (), True)
    for path in scene.iterdir():
        assert (made.folder / path.name).read_bytes() == path.read_bytes()


def test_a_scene_of_another_format_is_made_again(argoverse1: Path, tmp_path: Path) -> None:
    found = find_sources([argoverse1 / "train" / "data" / "1.csv"])
    (row,) = run_batch(plan(found, load_config(None, ["request.agents=1"])), tmp_path / "first", Options())
    folder = tmp_path / "first" / row.folder
    made = make_again(sidecar_of(folder), argoverse1 / "train", tmp_path / "again")
    assert (made.folder.name, made.differences, made.compared) == (folder.name, (), True)


def edited(folder: Path, **values: object) -> None:
    sidecar_of(folder).write_text(json.dumps(json.loads(sidecar_of(folder).read_text()) | values))


def test_what_another_program_made_is_compared_but_for_the_program(
    scene: Path, data_root: Path, tmp_path: Path
) -> None:
    """What differs is said, of every file; the scene itself is compared as ever."""
    here = read_sidecar(sidecar_of(scene)).program
    generator = json.loads(sidecar_of(scene).read_text())["generator"]
    edited(scene, generator=generator | {"code_sha256": "0" * 64})
    made = make_again(sidecar_of(scene), data_root, tmp_path / "other-code")
    assert (made.differences, made.program) == ((), f"code {'0' * 12} then and {here['code']} now")
    edited(scene, rejected=[{"reason": "spare", "count": 999}])
    (scene / f"scenario_{scene.name}.parquet").write_bytes(b"other")
    found = make_again(sidecar_of(scene), data_root, tmp_path / "other-scene")
    assert found.differences == tuple(
        f"{found.folder / name}: differs from {scene / name}; {made.program}"
        for name in (f"hid2_{scene.name}.json", f"scenario_{scene.name}.parquet")
    )


def test_what_cannot_be_made_again_is_explained(scene: Path, data_root: Path, data_scenes, tmp_path: Path) -> None:
    """A configuration of another program with its name."""
    config = json.loads(before := sidecar_of(scene).read_text())["config"]
    edited(scene, config=config | {"later": {"value": 1}})
    with pytest.raises(
        ConfigError, match=r"later.*; made by hid2-sumo .*, code [0-9a-f]{12}, SUMO .*: use that program$"
    ):
        make_again(sidecar_of(scene), data_root, tmp_path / "again")
    sidecar_of(scene).write_text(before)
    with pytest.raises(ConfigError, match="holds the scene of"):
        make_again(sidecar_of(scene), data_root, scene.parents[1])
    with pytest.raises(NoSceneError, match=r"no recorded scene .*, of which .* was made; give the ROOT"):
        make_again(sidecar_of(scene), data_scenes["arterial"], tmp_path / "again")
    (tmp_path / "text.json").write_text("no JSON")
    with pytest.raises(ScenarioError, match=r"text\.json: not JSON, expected a sidecar"):
        make_again(tmp_path / "text.json", data_root, tmp_path / "again")
    content = json.loads(sidecar_of(scene).read_text())
    content["config"]["request"]["agents"] = 3
    sidecar_of(scene).write_text(json.dumps(content))
    with pytest.raises(ConfigError, match=r"config_sha256 .* edited, or of another version"):
        make_again(sidecar_of(scene), data_root, tmp_path / "again")
    assert not (tmp_path / "again").exists()
