"""Recordings of three formats through the command: one folder that mixes them, and what is wrong with each."""

import csv
import json
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from implausible import FAULTS, plant
from recordings import LOG_ID, make_argoverse1, make_log

Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="module")
def mixed(data_scenes: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One scene, one sequence with its map files, one log."""
    root = tmp_path_factory.mktemp("recordings") / "mixed"
    shutil.copytree(data_scenes["arterial"], root / "av2" / "train" / data_scenes["arterial"].name)
    made = make_argoverse1(root.parent / "av1")
    shutil.copytree(made / "map_files", root / "av1" / "map_files")
    (root / "av1" / "val" / "data").mkdir(parents=True)
    shutil.copyfile(made / "val" / "data" / "7.csv", root / "av1" / "val" / "data" / "7.csv")
    make_log(data_scenes["curve"], root / "logs" / "test")
    return root


def rows(out: Path) -> dict[str, dict[str, str]]:
    with (out / "manifest.csv").open() as file:
        return {row["scenario"]: row for row in csv.DictReader(file)}


@pytest.mark.parametrize(("command", "code"), [("resimulate", 2), ("calibrate", 0)])
def test_scenes_alone_are_read_each_once_and_what_is_left_out_is_told(
    hid2: Run, mixed: Path, data_scenes: dict[str, Path], tmp_path: Path, command: str, code: int
) -> None:
    copy = shutil.copytree(data_scenes["arterial"], tmp_path / "val" / "copy")
    result = hid2(command, mixed, copy, "-o", tmp_path / "out.toml")
    assert result.returncode == code, result.stderr
    for said in (f"{copy}: the same scene as {mixed}", "2 of 4 recordings left out: sensor logs and Argoverse 1"):
        assert said in result.stderr


def test_implausible_scene_is_refused_before_anything_is_driven_and_the_other_is_done(
    hid2: Run, data_scenes: dict[str, Path], tmp_path: Path
) -> None:
    change, said = FAULTS["swapped"]
    bad = plant(data_scenes["arterial"], tmp_path / "train", change)
    out = tmp_path / "out"
    result = hid2("generate", bad, data_scenes["curve"], "-o", out, "--agents", 1)
    assert result.returncode == 1
    assert "1 of 2 scenes done" in result.stdout
    found = rows(out)
    assert found[bad.name]["folder"] == ""
    assert re.search(said, found[bad.name]["reason"])
    assert found[data_scenes["curve"].name]["placed"] == "1"
    assert len(list(out.rglob("*.parquet"))) == 1


@pytest.mark.slow
def test_a_folder_that_mixes_three_formats_is_done_whole(hid2: Run, mixed: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    arguments = ["generate", mixed, "-o", out, "--agents", 2]
    result = hid2(*arguments)
    assert result.returncode == 0, result.stderr
    assert "Windows of Argoverse 2 sensor logs: 1 found" in result.stderr
    assert result.stderr.count("Argoverse 1 tells no types, sizes and headings") == 1
    found = rows(out)
    assert {(row["scenario"], row["split"]) for row in found.values()} == {
        ("c58d7c2e-a9c9-5311-9808-c6a914afd19f", "train"), ("argoverse1-val-7", "val"), (LOG_ID, "test"),
    }  # fmt: skip
    checked = hid2("validate", out, "--source", mixed)
    assert checked.returncode == 0, checked.stdout
    recording = json.loads(next(out / found[LOG_ID]["folder"].glob("hid2_*.json")).read_text())["recording"]
    assert (recording["format"], recording["provenance"], recording["observed_steps"]) == ("sensor_log", "human", 50)
    assert recording["sizes"]["AV"] == [4.877, 2.0]
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*.parquet")}
    assert hid2(*arguments, "--resume").returncode == 0
    assert before == {path: path.stat().st_mtime_ns for path in out.rglob("*.parquet")}
    assert hid2("evaluate", mixed, "-o", tmp_path / "report", "-q").returncode == 0
    assert hid2("scan", mixed, "-q", "-o", tmp_path / "scan.csv").returncode == 0
    assert len((tmp_path / "scan.csv").read_text().splitlines()) == 4


def test_what_cannot_be_read_is_quarantined_and_its_bundle_says_the_same(
    hid2: Run, mixed: Path, tmp_path: Path
) -> None:
    """A sequence without AGENT and a log without poses beside each other: two reasons, and nothing half-written."""
    copy = tmp_path / "in"
    shutil.copytree(mixed / "av1", copy / "av1")
    shutil.copytree(mixed / "logs", copy / "logs")
    sequence = copy / "av1/val/data/7.csv"
    sequence.write_text(sequence.read_text().replace("AGENT", "OTHERS"))
    (copy / "logs" / "test" / LOG_ID / "city_SE3_egovehicle.feather").unlink()
    out = tmp_path / "out"
    assert hid2("generate", copy, "-o", out, "--window", 3).returncode == 1
    reasons = {row["reason"] for row in rows(out).values()}
    assert any("no tracks of OBJECT_TYPE AGENT" in reason for reason in reasons)
    assert any("city_SE3_egovehicle.feather: no such file" in reason for reason in reasons)
    assert list(out.rglob("*.parquet")) == []
    for bundle, said in (("val/argoverse1-val-7", "OBJECT_TYPE AGENT"), ("test/", "no such file")):
        (path,) = (path for path in out.rglob("*.zip") if bundle in path.as_posix())
        again = hid2("generate", "--repro", path)
        assert again.returncode == 1
        assert said in again.stdout
