"""`hid2 calibrate`, and what `hid2 generate` makes of the drivers it wrote."""

import csv
import json
import shutil
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hid2.params import Drivers

Run = Callable[..., Any]


@pytest.fixture(scope="module")
def calibrated(hid2: Run, data_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("calibrated") / "mine.toml"
    result = hid2("calibrate", data_root, "-o", out)
    assert result.returncode == 0, result.stderr
    assert result.stdout.splitlines() == [str(out), str(out.with_name("mine.html"))]
    return out


def test_every_parameter_is_measured_or_said_to_keep_its_prior(calibrated: Path) -> None:
    text = calibrated.read_text()
    measured = tomllib.loads(text)["drivers"]
    for name in Drivers.model_fields:
        assert (name in measured) != (f"# {name} keeps its prior" in text), name
    Drivers.model_validate(measured)


def test_table_has_size_and_interval(calibrated: Path) -> None:
    with calibrated.with_name("mine.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert {row["group"] for row in rows} >= {"all", "lane straight", "lane turning"}
    for row in rows:
        assert row["source"] in {"measured", "prior"}
        if row["source"] == "measured":
            assert float(row["low"]) <= float(row["high"])
            assert int(row["drivers"]) >= 12
    assert "95 % interval" in calibrated.with_name("mine.html").read_text()


def test_generate_draws_from_the_drivers_of_the_file(hid2: Run, data_scenes: dict[str, Path], tmp_path: Path) -> None:
    path = tmp_path / "drivers.toml"
    path.write_text("[drivers]\ntau_mean_s = 1.7\ntau_sd_s = 0.0\n")
    result = hid2("generate", data_scenes["arterial"], "-o", tmp_path / "out", "--agents", 3, "--drivers", path, "-q")
    assert result.returncode == 0, result.stderr
    sidecar = json.loads(next((tmp_path / "out").rglob("hid2_*.json")).read_text())
    assert sidecar["config"]["drivers"]["tau_mean_s"] == 1.7
    gaps = [agent["driver"]["parameters"]["tau_s"] for agent in sidecar["agents"]]
    assert gaps == pytest.approx([1.7] * len(gaps))


@pytest.mark.slow
def test_a_scene_that_cannot_be_read_is_listed_and_the_rest_measured(
    hid2: Run, data_root: Path, tmp_path: Path
) -> None:
    root = tmp_path / "av2"
    shutil.copytree(data_root, root)
    broken = next(root.rglob("scenario_*.parquet"))
    broken.write_bytes(b"no parquet")
    result = hid2("calibrate", root, "-o", tmp_path / "mine.toml")
    assert result.returncode in (0, 1)
    assert "Traceback" not in result.stderr
    assert broken.name in result.stderr
    assert (tmp_path / "mine.toml").exists()
