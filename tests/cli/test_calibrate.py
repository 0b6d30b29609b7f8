"""`hid2 calibrate`: what it writes, of scenes of which one cannot be read."""

import csv
import shutil
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from written import copy_with_new_id

from hid2.params import Drivers

Run = Callable[..., Any]


def test_every_parameter_is_measured_with_size_and_interval_or_said_to_keep_its_prior(
    hid2: Run, data_root: Path, tmp_path: Path
) -> None:
    """A scene that cannot be read is listed, and the others measured."""
    root, out = shutil.copytree(data_root, tmp_path / "av2"), tmp_path / "mine.toml"
    broken = copy_with_new_id(next(root.glob("val/*")), root / "val" / "broken", "00000000-0000-4000-8000-000000000000")
    next(broken.glob("scenario_*.parquet")).write_bytes(b"no parquet")
    result = hid2("calibrate", root, "-o", out)
    assert (result.returncode, str(broken) in result.stderr) == (1, True), result.stderr
    assert hid2("calibrate", broken, "-o", out).stderr.count(f"{broken}: ") == 1  # the only one: told once
    assert result.stdout.splitlines() == [str(out), str(out.with_name("mine.html"))]
    text = out.read_text()
    measured = tomllib.loads(text)["drivers"]
    for name in Drivers.model_fields:
        assert (name in measured) != (f"# {name} keeps its prior" in text), name
    Drivers.model_validate(measured)
    with out.with_name("mine.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert {row["group"] for row in rows} >= {"all", "lane straight", "lane turning"}
    for row in rows:
        assert row["source"] in {"measured", "prior"}
        if row["source"] == "measured":
            assert float(row["low"]) <= float(row["high"])
            assert int(row["drivers"]) >= 12
    assert "95 % interval" in out.with_name("mine.html").read_text()
