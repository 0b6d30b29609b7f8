"""`hid2 calibrate`: what it writes, of scenes of which one cannot be read."""

import csv
import shutil
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from written import copy_with_new_id

from hid2.params import Drivers

Run = Callable[..., Any]


@pytest.fixture(scope="module")
def calibrated(hid2: Run, data_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("calibrated") / "mine.toml"
    root = shutil.copytree(data_root, out.with_name("av2"))
    broken = copy_with_new_id(next(root.glob("val/*")), root / "val" / "broken", "00000000-0000-4000-8000-000000000000")
    next(broken.glob("scenario_*.parquet")).write_bytes(b"no parquet")
    result = hid2("calibrate", root, "-o", out)
    assert result.returncode == 1, result.stderr
    assert str(broken) in result.stderr
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
