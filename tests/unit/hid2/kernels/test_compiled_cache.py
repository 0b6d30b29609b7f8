"""Compiled functions that were kept, and sources that have changed since."""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numba
import pytest

from hid2.kernels.compiled_cache import PACKAGES, forget_outdated, keep_compiled, sources_of


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
    assert forget_outdated(sources_of([tmp_path / "a", tmp_path / "b"])) == [old]
    assert not old.exists()
    assert new.exists()
    assert other.exists()
    assert forget_outdated(sources_of([tmp_path / "a", tmp_path / "b"])) == []


def test_source_of_the_future_is_nothing_to_go_by(package: Callable[[str, float], Path], tmp_path: Path) -> None:
    package("a/caller.py", -1000.0)
    kept = package("a/__pycache__/caller.f-1.nbi", 80.0)
    assert forget_outdated(sources_of([tmp_path / "a"])) == []
    assert kept.exists()


def test_all_packages_are_looked_at() -> None:
    assert [path.name for path in PACKAGES if (path / "__init__.py").is_file()] == ["bridge", "hid2", "netconvert"]


@pytest.fixture
def places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The user's cache; nothing is chosen, and what is changed is changed back."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")  # so that it is restored, too
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    return tmp_path / "cache" / "hid2-sumo"


def _make_unwritable(package: Path) -> None:
    """Also for root: where the folder of compiled code would be is a file."""
    (package / "__pycache__").write_text("")


def test_code_is_kept_beside_sources_that_can_be_written(
    package: Callable[[str, float], Path], tmp_path: Path, places: Path
) -> None:
    package("a/caller.py", 50.0)
    outdated = package("a/__pycache__/caller.f-1.nbi", 80.0)
    assert keep_compiled([tmp_path / "a"]) is None
    assert not outdated.exists()
    assert not places.exists()
    assert os.environ["NUMBA_CACHE_DIR"] == numba.config.CACHE_DIR == ""


def test_code_of_sources_that_cannot_be_written_is_kept_for_just_these_sources(
    package: Callable[[str, float], Path], tmp_path: Path, places: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = package("a/caller.py", 50.0)
    _make_unwritable(tmp_path / "a")
    first = keep_compiled([tmp_path / "a"])
    assert first is not None
    assert first.parent == places
    assert os.environ["NUMBA_CACHE_DIR"] == numba.config.CACHE_DIR == str(first)
    assert keep_compiled([tmp_path / "a"]) == first  # as a process does that this one starts
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    assert keep_compiled([tmp_path / "a"]) == first
    os.utime(source, (time.time(),) * 2)
    changed = keep_compiled([tmp_path / "a"])
    assert changed is not None
    assert changed != first
    assert changed.parent == places


def test_code_is_kept_where_the_user_wants_it(
    package: Callable[[str, float], Path], tmp_path: Path, places: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = package("a/caller.py", 50.0)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "chosen"))
    first = keep_compiled([tmp_path / "a"])
    assert first is not None
    assert first.parent == tmp_path / "chosen"
    os.utime(source, (time.time(),) * 2)
    changed = keep_compiled([tmp_path / "a"])  # after an update while the variable is still that of before
    assert changed is not None
    assert changed != first
    assert changed.parent == tmp_path / "chosen"
    assert not places.exists()


@pytest.mark.parametrize("writable", ["cache", "nothing"])
def test_functions_compile_and_never_call_older_ones_where_sources_cannot_be_written(
    tmp_path: Path, writable: str
) -> None:
    """The user's cache is used again; where it cannot be written either, nothing is left behind."""
    package = tmp_path / "package"
    package.mkdir()
    _make_unwritable(package)
    (package / "caller.py").write_text(
        "from numba import njit\nfrom package.called import g\n\n\n@njit(cache=True)\ndef f():\n    return g()\n"
    )
    (tmp_path / "nothing").write_text("")
    (tmp_path / "tmp").mkdir()
    environment = {
        "PATH": os.environ["PATH"], "HOME": str(tmp_path / "nothing"), "XDG_CACHE_HOME": str(tmp_path / writable),
        "TMPDIR": str(tmp_path / "tmp"), "PYTHONPATH": str(PACKAGES[0].parent),
    }  # fmt: skip
    code = (
        "from pathlib import Path\nfrom hid2.kernels.compiled_cache import keep_compiled\n"
        "place = keep_compiled([Path('package')])\nfrom package.caller import f\n"
        "print(f(), len(list(place.rglob('*.nbi'))), sum(f.stats.cache_hits.values()))"
    )

    def answer(value: int, *, write: bool = True) -> list[int]:
        if write:
            (package / "called.py").write_text(
                f"from numba import njit\n\n\n@njit(cache=True)\ndef g():\n    return {value}\n"
            )
        run = [sys.executable, "-c", code]
        done = subprocess.run(run, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return [int(word) for word in done.stdout.split()]

    assert answer(1) == [1, 2, 0]
    os.utime(package / "caller.py", (time.time() - 200.0,) * 2)
    assert answer(2) == [2, 2, 0]
    assert answer(2, write=False) == [2, 2, 1 if writable == "cache" else 0]
    assert list((tmp_path / "tmp").iterdir()) == []


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
        forget_outdated(sources_of([package]))
        run = [sys.executable, "-c", "from package.caller import f; print(f())"]
        done = subprocess.run(run, cwd=tmp_path, capture_output=True, text=True, check=True)
        return done.stdout.strip()

    os.utime(package / "caller.py", (time.time() - 200.0,) * 2)
    assert answer(1, 100.0) == "1"
    for index in package.glob("__pycache__/*.nbi"):
        os.utime(index, (time.time() - 50.0,) * 2)
    assert answer(2, 1.0) == "2"
