"""Compiled functions that were kept, and sources that have changed since."""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from netconvert.machine_code import PACKAGES, forget_outdated


@pytest.fixture
def package(tmp_path: Path) -> Callable[[str, float], Path]:
    """package(name, age) -> a file of that name in a package, so many seconds old."""

    def make(name: str, age_s: float) -> Path:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
        os.utime(path, (time.time() - age_s,) * 2)
        return path

    return make


def test_code_older_than_any_source_is_forgotten(package: Callable[[str, float], Path], tmp_path: Path) -> None:
    """Also that of functions whose own file has not changed: they may call one that has."""
    package("a/caller.py", 100.0)
    package("b/called.py", 50.0)
    old, new = package("a/__pycache__/caller.f-1.nbi", 80.0), package("b/__pycache__/called.g-1.nbi", 20.0)
    other = package("a/__pycache__/caller.cpython-311.pyc", 80.0)
    assert forget_outdated([tmp_path / "a", tmp_path / "b"]) == [old]
    assert not old.exists()
    assert new.exists()
    assert other.exists()
    assert forget_outdated([tmp_path / "a", tmp_path / "b"]) == []


def test_source_of_the_future_is_nothing_to_go_by(package: Callable[[str, float], Path], tmp_path: Path) -> None:
    package("a/caller.py", -1000.0)
    kept = package("a/__pycache__/caller.f-1.nbi", 80.0)
    assert forget_outdated([tmp_path / "a"]) == []
    assert kept.exists()


def test_all_packages_are_looked_at() -> None:
    assert [path.name for path in PACKAGES if (path / "__init__.py").is_file()] == ["bridge", "hid2", "netconvert"]


def test_changed_function_is_called_by_one_that_was_compiled_before(tmp_path: Path) -> None:
    """numba would go on with 1: the caller's own file is the same."""
    package = tmp_path / "package"
    package.mkdir()
    (package / "caller.py").write_text(
        "from numba import njit\nfrom package.called import g\n\n\n@njit(cache=True)\ndef f():\n    return g()\n"
    )

    def answer(value: int, age_s: float) -> str:
        called = package / "called.py"
        called.write_text(f"from numba import njit\n\n\n@njit(cache=True)\ndef g():\n    return {value}\n")
        os.utime(called, (time.time() - age_s,) * 2)
        forget_outdated([package])
        run = [sys.executable, "-c", "from package.caller import f; print(f())"]
        done = subprocess.run(run, cwd=tmp_path, capture_output=True, text=True, check=True)
        return done.stdout.strip()

    os.utime(package / "caller.py", (time.time() - 200.0,) * 2)
    assert answer(1, 100.0) == "1"
    for index in package.glob("__pycache__/*.nbi"):
        os.utime(index, (time.time() - 50.0,) * 2)
    assert answer(2, 1.0) == "2"
