"""Paths of the command line that cannot be what they are given as, and results that would lie among the sources."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from bridge.cli.places import check_out, one_scene
from netconvert.errors import ConfigError

Run = Callable[..., Any]


@pytest.fixture
def data_set(tmp_path: Path, data_scenes: dict[str, Path]) -> Path:
    """A root with one scene in its split train."""
    root = tmp_path / "root"
    shutil.copytree(data_scenes["curve"], root / "train" / data_scenes["curve"].name)
    return root


def test_out_in_a_scene_or_a_split_folder_is_refused(data_set: Path, tmp_path: Path) -> None:
    """Also deeper in it, for a file, and through a link."""
    scene = next((data_set / "train").iterdir())
    (tmp_path / "link").symlink_to(data_set / "train")
    for out in (scene, scene / "deep" / "er"):
        with pytest.raises(ConfigError, match="inside the scene"):
            check_out(out)
        with pytest.raises(ConfigError, match="inside the scene"):
            check_out(out / "picture.png", is_file=True)
    for out in (data_set / "train" / "out", data_set / "train" / "deep" / "er", tmp_path / "link" / "out"):
        with pytest.raises(ConfigError, match="inside the split folder"):
            check_out(out)
    with pytest.raises(ConfigError, match="inside the split folder"):
        check_out(data_set / "train" / "picture.png", is_file=True)


def test_a_folder_with_a_single_scene_may_be_that_of_the_user(
    data_scenes: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One scene was put into a folder, and the command is called there; a second one makes it a split folder."""
    shutil.copytree(data_scenes["curve"], tmp_path / "mine")
    check_out(tmp_path / "out")
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"hid2: warning: {tmp_path / 'out'} lies inside the data set {tmp_path}")
    shutil.copytree(data_scenes["curve"], tmp_path / "second")
    with pytest.raises(ConfigError, match=r"inside the split folder .*, beside the scene (mine|second); choose"):
        check_out(tmp_path / "out")


def test_out_elsewhere_or_of_an_earlier_run_is_taken_silently(
    data_set: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Scenes with a sidecar were generated: more may be written beside them. Else out in a data set is warned of."""
    (data_set / "manifest.csv").write_text("of another tool")
    check_out(data_set / "out")
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"hid2: warning: {data_set / 'out'} lies inside the data set {data_set}")
    (data_set / "manifest.csv").write_text("scenario,split,")  # of an output folder, from which a sidecar is lost
    check_out(data_set)
    (data_set / "manifest.csv").unlink()
    (next((data_set / "train").iterdir()) / "hid2_x.json").touch()
    for out in (tmp_path / "out", data_set, data_set / "report", data_set / "train" / "report"):
        check_out(out)
    assert capsys.readouterr().err == ""


WRITING = (
    "generate {scene} -o {out}", "export {scene} --to sumo -o {out}", "evaluate {scene} -o {out}",
    "calibrate {scene} -o {out}/drivers.toml", "scan {scene} -o {out}/scan.csv", "net {scene} -o {out}",
    "render {scene} -o {out}/a.png", "plot {scene} --agent AV -o {out}/a.png", "compose {scene} -o {out}",
    "gui {scene} --screenshot {out}/a.png", "forecast {scene} -o {out}", "paper table1 --scenes {scene} -o {out}",
    "study study.toml --scenes {scene} -o {out}", "make corridor -o {out}", "public page.toml -o {out}",
    "resimulate {scene} -o {out}",
)  # fmt: skip


def test_no_command_writes_into_a_scene_or_beside_recorded_ones(hid2: Run, data_set: Path, tmp_path: Path) -> None:
    scene = next((data_set / "train").iterdir())
    before = sorted(data_set.rglob("*"))
    places = {data_set / "train" / "out": "inside the split folder", scene / "out": "inside the scene"}
    for command in WRITING:
        for out, words in places.items():
            result = hid2(*command.format(scene=scene, out=out).split(), cwd=tmp_path)
            assert (result.returncode, len(result.stderr.splitlines())) == (2, 1), command
            assert result.stderr.startswith(f"hid2: error: {out}"), command
            assert words in result.stderr, command
    assert sorted(data_set.rglob("*")) == before
    assert [path.name for path in tmp_path.iterdir()] == ["root"]


def test_command_of_one_scene_gets_the_only_one_of_a_data_set(data_set: Path, tmp_path: Path) -> None:
    """Else a line says what is missing, or gives an example, here of sequences."""
    assert one_scene(data_set, (None, 0)) == next((data_set / "train").iterdir())
    empty, sequences, city = (tmp_path / name for name in ("empty", "data", "map.json"))
    empty.mkdir()
    with pytest.raises(ConfigError, match=r"no scenario; expected scenario_<id>\.parquet .* in it or"):
        one_scene(empty, (None, 0))
    sequences.mkdir()
    for path in (sequences / "7.csv", sequences / "8.csv", city):
        path.touch()
    with pytest.raises(ConfigError, match=r"holds several scenes, expected one of them, such as .*data/7\.csv"):
        one_scene(sequences, (city, 0))
