from pathlib import Path

import pytest

from bridge.sumo.net import convert
from netconvert.errors import ExportError
from netconvert.fidelity import UNEXPLAINED


def test_convert_writes_the_net_and_everything_that_opens_it(data_scene: Path, tmp_path: Path) -> None:
    report = convert(data_scene, tmp_path / "deep" / "out")
    suffixes = ("net.xml", "sumocfg", "poly.xml", "view.xml", "cells.csv")
    written = {path.name for path in (tmp_path / "deep" / "out").iterdir()}
    assert written == {f"{data_scene.name}.{suffix}" for suffix in suffixes}
    assert report.lanes == report.lanes_in_net
    assert report.largest_distance_m <= 0.01
    assert UNEXPLAINED not in {link.reason for link in report.lost}


def test_two_runs_write_the_same_bytes(data_scenes: dict[str, Path], tmp_path: Path) -> None:
    for run in ("a", "b", "b"):
        convert(data_scenes["curve"], tmp_path / run)
    for path in (tmp_path / "a").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()
    (path,) = data_scenes["curve"].glob("log_map_archive_*.json")
    assert convert(path, tmp_path / "map").lanes_in_net > 0  # the file alone
    assert {path.name for path in (tmp_path / "map").iterdir()} == {path.name for path in (tmp_path / "a").iterdir()}


def test_where_a_folder_or_a_file_is_in_the_way_nothing_is_written(
    data_scenes: dict[str, Path], tmp_path: Path
) -> None:
    blocked = tmp_path / f"{data_scenes['curve'].name}.view.xml"
    blocked.mkdir()
    with pytest.raises(ExportError, match=rf"{blocked.name}: is a folder, expected a file to write"):
        convert(data_scenes["curve"], tmp_path)
    assert list(tmp_path.iterdir()) == [blocked]
    (tmp_path / "out").write_text("here already")
    with pytest.raises(ExportError, match="out: cannot be written \\("):
        convert(data_scenes["curve"], tmp_path / "out")
