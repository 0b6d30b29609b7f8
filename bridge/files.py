"""Files that are there whole or not at all."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from netconvert.errors import ExportError


@contextlib.contextmanager
def beside(path: Path) -> Iterator[Path]:
    """A hidden path beside a file, to write to: at the end it takes the file's place, and it is gone if all fails.

    The folder is made. Errors: OSError, for the caller to explain.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    hidden = path.with_name(f".{path.name}")
    try:
        yield hidden
        hidden.replace(path)
    finally:
        hidden.unlink(missing_ok=True)


@contextlib.contextmanager
def table_file(path: Path) -> Iterator[IO[str]]:
    """A file for `csv` to write to, `beside` its place. Errors: OSError."""
    with beside(path) as hidden, hidden.open("w", newline="", encoding="utf-8") as stream:
        yield stream


@contextlib.contextmanager
def explained(path: Path) -> Iterator[None]:
    """What the system says against writing to a path becomes an ExportError that names it."""
    try:
        yield
    except OSError as error:
        raise ExportError(f"{path}: cannot be written ({error.strerror or error})") from error


def make_folder(folder: Path) -> None:
    """Make a folder for what takes long to work out. Errors: ExportError."""
    with explained(folder):
        folder.mkdir(parents=True, exist_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8. Errors: OSError."""
    with beside(path) as hidden:
        hidden.write_text(text, encoding="utf-8")
