"""`hid2 compose`, and `evaluate` with several files of predictions, as a user runs them."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from baseline_file import write_baseline

Run = Callable[..., Any]


def test_a_root_is_composed_and_checked(hid2: Run, data_root: Path, tmp_path: Path) -> None:
    root = tmp_path / "root"
    result = hid2("compose", data_root, "-o", root, "--json", "-q")
    assert result.returncode == 0, result.stderr
    assert json.loads(result.stdout) == [{"data set": ".", "train": "2", "val": "1", "test": "0"}]
    (held_out,) = (root / "val").iterdir()
    shutil.copytree(held_out, root / "train" / held_out.name)
    result = hid2("compose", "--check", root)
    assert result.returncode == 1
    assert result.stdout == f"{root}/train/{held_out.name}: the same scene as {held_out}\n"


def test_files_of_predictions_are_compared(hid2: Run, data_root: Path, tmp_path: Path) -> None:
    files = [
        write_baseline(data_root, tmp_path / f"{kind}.parquet", kind=kind)
        for kind in ("constant-velocity", "constant-turn-rate")
    ]
    given = [part for name, file in zip("ab", files, strict=True) for part in ("--predictions", f"{name}={file}")]
    result = hid2("evaluate", data_root, "-o", tmp_path / "report", *given, "--json", "-q")
    assert result.returncode == 0, result.stderr
    rows = json.loads(result.stdout)
    assert {(row["model"], row["minus"]) for row in rows} == {("b", "a")}
    assert (tmp_path / "report" / "comparison.html").is_file()
