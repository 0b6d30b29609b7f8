"""`hid2 resimulate` from the command line, on two of the synthetic scenes and a part of one."""

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from written import copy_with_new_id, edit_rows, standing

from bridge.evaluation.resimulate import ResimulationPlan, resimulate_folders
from netconvert.errors import ScenarioError

Run = Callable[..., Any]
HOW = ("--seeds", 2, "--write", 1)


@pytest.fixture(scope="module")
def scenes(data_scenes: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ...]:
    """Two, one of 10 s, and one that is too short to be scored."""
    root = tmp_path_factory.mktemp("short")
    parts = {steps: f"{steps:08}-0000-4000-8000-{0:012}" for steps in (90, 100)}
    less = {steps: copy_with_new_id(data_scenes["curve"], root / name, name) for steps, name in parts.items()}
    for steps, folder in less.items():
        edit_rows(folder, lambda rows, steps=steps: rows[rows.timestep < steps])
    return data_scenes["curve"], data_scenes["intersection"], *less.values()


@pytest.fixture(scope="module")
def ended(hid2: Run, scenes: tuple[Path, ...], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("resimulated") / "out"
    result = hid2("resimulate", *scenes, "-o", out, *HOW)
    assert (result.returncode, "90 steps, expected at least 91" in result.stderr) == (1, True), result.stderr
    assert result.stdout.splitlines() == [str(out / "resimulation.html")]
    return out


def rows(path: Path) -> list[dict[str, str]]:
    with path.open() as stream:
        return list(csv.DictReader(stream))


def test_every_scene_is_scored_beside_all_models_on_a_page_that_says_what_differs_and_can_be_viewed(
    hid2: Run, ended: Path, tmp_path: Path
) -> None:
    """Every vehicle is in the table; rollouts that are written are scenes."""
    of = {(row["scene"], row["model"]): float(row["sum"]) for row in rows(ended / "scores.csv")}
    names = {scene for scene, _ in of}
    assert (len(names), len(of)) == (3, 3 * 5)
    assert all(0.0 < score <= 1.0 for score in of.values())
    assert all(of[scene, "log"] > of[scene, "calibrated"] for scene in names)
    assert all((row["driven"] == "True") == (row["why_not"] == "") for row in rows(ended / "vehicles.csv"))
    page = (ended / "resimulation.html").read_text()
    said = "WOSAC-like", "What differs from the challenge", "calibrated / reference", "constant velocity", "at least 91"
    assert all(text in page for text in said)
    assert len(list((ended / "scenes").rglob("scenario_*.parquet"))) == 3
    result = hid2("view", ended / "scenes", "-o", tmp_path / "page.html")
    assert result.returncode == 0, result.stderr


def test_scenes_of_another_run_are_not_mixed_with_new_ones(hid2: Run, ended: Path, scenes: tuple[Path, ...]) -> None:
    result = hid2("resimulate", *scenes, "-o", ended, *HOW)
    assert (result.returncode, f"{ended / 'scenes'}: is there already" in result.stderr) == (2, True), result.stderr
    result = hid2("resimulate", *scenes, "-o", ended / "new", "--seed", 2**31)
    assert (result.returncode, "request.seed = 2147483648, expected" in result.stderr) == (2, True), result.stderr


def test_scenes_without_a_vehicle_to_drive_are_refused_with_the_commonest_reason(
    data_scenes: dict[str, Path], tmp_path: Path, here: None
) -> None:
    """Two scenes in which every track stays where it is first seen, and one that cannot be read."""
    for name in ("00000000-0000-4000-8000-000000000000", "00000001-0000-4000-8000-000000000000"):
        edit_rows(copy_with_new_id(data_scenes["intersection"], tmp_path / name, name), standing)
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "scenario_1.parquet").write_bytes(b"no parquet")
    said = r"0 scenes with a vehicle to drive, expected two at least; \S+: not a parquet.*; \d+ vehicles: parked, or st"
    with pytest.raises(ScenarioError, match=said):
        resimulate_folders([tmp_path], tmp_path.with_name("out"), ResimulationPlan(1))


def test_same_request_gives_the_same_bytes_whatever_the_workers(
    new_hid2: Run, ended: Path, scenes: tuple[Path, ...]
) -> None:
    again = ended.parent / "again"
    result = new_hid2("resimulate", *scenes, "-o", again, *HOW, "--jobs", 2)
    assert result.returncode == 1, result.stderr
    files = sorted(path.relative_to(ended) for path in ended.rglob("*") if path.is_file())
    assert files == sorted(path.relative_to(again) for path in again.rglob("*") if path.is_file())
    for file in files:
        assert (ended / file).read_bytes() == (again / file).read_bytes(), file
