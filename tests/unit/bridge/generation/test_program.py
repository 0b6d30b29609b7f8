"""What a scene's bytes depend on beside its request, as sidecars and manifests say it."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

import bridge
import hid2
import netconvert
from bridge.generation import program


@pytest.fixture
def code(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Path]:
    """A folder with three packages of a module each, which are taken for the program's."""
    for package in (netconvert, hid2, bridge):
        place = tmp_path / "code" / package.__name__
        place.mkdir(parents=True)
        (place / "module.py").write_bytes(b"A = 1\nB = 2\n")
        monkeypatch.setattr(package, "__path__", [str(place)])
    program.code_sha256.cache_clear()
    yield tmp_path / "code"
    program.code_sha256.cache_clear()


def digest() -> str:
    program.code_sha256.cache_clear()
    return program.code_sha256()


def test_digest_of_the_code_is_of_its_names_and_contents_not_of_places_line_ends_and_what_was_compiled(
    code: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = digest()
    (code / "bridge" / "module.py").write_bytes(b"A = 1\r\nB = 2\r\n")
    (code / "bridge" / "__pycache__").mkdir()
    (code / "bridge" / "__pycache__" / "module.cpython-311.pyc").write_bytes(b"compiled")
    shutil.move(code / "hid2", code.parent / "elsewhere")
    monkeypatch.setattr(hid2, "__path__", [str(code.parent / "elsewhere")])
    assert digest() == before
    (code.parent / "elsewhere" / "module.py").write_bytes(b"A = 1\nB = 3\n")
    edited = digest()
    (code.parent / "elsewhere" / "module.py").rename(code.parent / "elsewhere" / "other.py")
    assert len({before, edited, digest()}) == 3
