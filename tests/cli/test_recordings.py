"""Recordings of three formats through the command: one folder that mixes them, and what is wrong with each."""

import csv
import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
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


@pytest.mark.slow
def test_a_folder_that_mixes_three_formats_is_done_whole(hid2: Run, mixed: Path, tmp_path: Path) -> None:
    out, sumo = tmp_path / "out", tmp_path / "sumo"
    arguments = ["generate", mixed, "-o", out, "--agents", 2, "--sumo", sumo]
    result = hid2(*arguments)
    assert result.returncode == 0, result.stderr
    assert "1 window of an Argoverse 2 sensor log found" in result.stderr
    assert result.stderr.count("Argoverse 1 tells no types, sizes and headings") == 1
    found = rows(out)
    assert {(row["scenario"], row["split"]) for row in found.values()} == {
        ("c58d7c2e-a9c9-5311-9808-c6a914afd19f", "train"), ("argoverse1-val-7", "val"), (LOG_ID, "test"),
    }  # fmt: skip
    checked = hid2("validate", out, "--source", mixed)
    assert checked.returncode == 0, checked.stdout
    log = out / found[LOG_ID]["folder"]
    recording = json.loads(next(log.glob("hid2_*.json")).read_text())["recording"]
    assert (recording["format"], recording["provenance"], recording["observed_steps"]) == ("sensor_log", "human", 50)
    assert recording["sizes"]["AV"] == [4.877, 2.0]
    assert len(list(sumo.glob("*/*/*.fcd.xml"))) == 3
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*.parquet")}
    assert hid2(*arguments, "--resume").returncode == 0
    assert before == {path: path.stat().st_mtime_ns for path in out.rglob("*.parquet")}
    assert hid2("evaluate", mixed, "-o", tmp_path / "report", "-q").returncode == 0
    assert hid2("scan", mixed, "-q", "-o", tmp_path / "scan.csv").returncode == 0
    assert len((tmp_path / "scan.csv").read_text().splitlines()) == 4


def test_single_scene_commands_take_a_sequence_and_a_window(hid2: Run, mixed: Path, tmp_path: Path) -> None:
    sequence, log = mixed / "av1/val/data/7.csv", mixed / "logs" / "test" / LOG_ID
    assert hid2("render", sequence, "-o", tmp_path / "s.png", "-q").returncode == 0
    assert hid2("net", log, "-o", tmp_path / "net", "--window", 5, "-q").returncode == 0
    assert len(list((tmp_path / "net").glob("*_scene.sumocfg"))) == 1
    assert len(list((tmp_path / "net").glob("*.fcd.xml"))) == 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--format", "argoverse1"], "is no Argoverse 1 sequence, expected these alone"),
        (["--map", "nowhere"], "--map nowhere: no such file or folder, expected one Argoverse 2 map"),
        (["--stride", "0"], "invalid value for '--stride'"),
    ],
    ids=["format", "map", "stride"],
)
def test_choices_that_do_not_fit_are_mistakes_of_usage(
    hid2: Run, mixed: Path, tmp_path: Path, arguments: list[str], said: str
) -> None:
    result = hid2("generate", mixed, "-o", tmp_path / "out", *arguments)
    assert result.returncode in (1, 2)
    assert said in result.stderr.replace("\n", " ")
    assert not (tmp_path / "out").exists()


def test_missing_map_files_are_said_before_anything_is_written(hid2: Run, mixed: Path, tmp_path: Path) -> None:
    copy = tmp_path / "in"
    shutil.copytree(mixed / "av1", copy)
    shutil.rmtree(copy / "map_files")
    result = hid2("generate", copy, "-o", tmp_path / "out")
    assert result.returncode in (1, 2)
    assert "this is Argoverse 1: its map files are missing" in result.stderr
    assert "Traceback" not in result.stderr
    assert not (tmp_path / "out").exists()


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
    result = hid2("generate", copy, "-o", out, "--window", 3)
    assert result.returncode == 1
    reasons = {row["reason"] for row in rows(out).values()}
    assert any("no track of OBJECT_TYPE AGENT" in reason for reason in reasons)
    assert any("city_SE3_egovehicle.feather: no such file" in reason for reason in reasons)
    assert list(out.rglob("*.parquet")) == []
    for bundle, said in (("val/argoverse1-val-7", "OBJECT_TYPE AGENT"), ("test/", "no such file")):
        (path,) = (path for path in out.rglob("*.zip") if bundle in path.as_posix())
        again = hid2("generate", "--repro", path)
        assert again.returncode == 1
        assert said in again.stdout
