"""`hid2 resimulate` from the command line, on the synthetic scenes."""

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Run = Callable[..., Any]


@pytest.fixture(scope="module")
def ended(hid2: Run, data_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("resimulated") / "out"
    result = hid2("resimulate", data_root, "-o", out, "--seeds", 2, "--write", 1)
    assert result.returncode == 0, result.stderr
    assert result.stdout.splitlines() == [str(out / "resimulation.html")]
    return out


def rows(path: Path) -> list[dict[str, str]]:
    with path.open() as stream:
        return list(csv.DictReader(stream))


def test_every_scene_is_scored_beside_all_models(ended: Path) -> None:
    scores = rows(ended / "scores.csv")
    assert len({row["scene"] for row in scores}) == 3
    assert len(scores) == 3 * 5
    for row in scores:
        assert 0.0 < float(row["sum"]) <= 1.0
    of = {(row["scene"], row["model"]): float(row["sum"]) for row in scores}
    for scene in {row["scene"] for row in scores}:
        assert of[scene, "log"] > of[scene, "calibrated"]


def test_every_vehicle_is_in_the_table_and_the_page_says_what_differs(ended: Path) -> None:
    vehicles = rows(ended / "vehicles.csv")
    assert all((row["driven"] == "True") == (row["why_not"] == "") for row in vehicles)
    page = (ended / "resimulation.html").read_text()
    for text in ("WOSAC-like", "What differs from the challenge", "calibrated / reference", "constant velocity"):
        assert text in page


def test_written_rollouts_can_be_viewed(hid2: Run, ended: Path, tmp_path: Path) -> None:
    assert len(list((ended / "scenes").rglob("scenario_*.parquet"))) == 3
    result = hid2("view", ended / "scenes", "-o", tmp_path / "page.html")
    assert result.returncode == 0, result.stderr


def test_same_request_gives_the_same_bytes_whatever_the_workers(hid2: Run, ended: Path, data_root: Path) -> None:
    again = ended.parent / "again"
    result = hid2("resimulate", data_root, "-o", again, "--seeds", 2, "--write", 1, "--jobs", 2)
    assert result.returncode == 0, result.stderr
    files = sorted(path.relative_to(ended) for path in ended.rglob("*") if path.is_file())
    assert files == sorted(path.relative_to(again) for path in again.rglob("*") if path.is_file())
    for file in files:
        assert (ended / file).read_bytes() == (again / file).read_bytes(), file


def test_one_scene_is_too_few(hid2: Run, data_scenes: dict[str, Path], tmp_path: Path) -> None:
    result = hid2("resimulate", data_scenes["curve"], "-o", tmp_path / "out", "--seeds", 1)
    assert result.returncode == 2
    assert ": 1 scene, expected two at least: each half is driven" in result.stderr
    assert not (tmp_path / "out").exists()
