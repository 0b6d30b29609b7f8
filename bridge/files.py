"""Files that are there whole or not at all, and files of others, which may be anything."""

import contextlib
import csv
import errno
import json
import os
import stat
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import IO

from netconvert.errors import DiskFullError, ExportError

#: What the system says when nothing more can be written: full, over the quota or the size, read-only.
_DISK = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS})
#: Each file of a scene, MB. Real: below 3.
MAX_FILE_MB = 32
_SHORTENED = " ... (shortened)"


@contextlib.contextmanager
def beside(path: Path) -> Iterator[Path]:
    """A hidden path beside a file, to write to: at the end it takes the file's place, and it is gone if all fails.

    The folder is made. Errors: OSError, for the caller to explain.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    hidden = path.with_name(f".{path.name}")
    hidden.unlink(missing_ok=True)  # a link there would be followed
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
    """What the system says against writing to a path becomes an ExportError that names it, or a DiskFullError."""
    try:
        yield
    except OSError as error:
        kind = DiskFullError if disk_error(error) else ExportError
        raise kind(f"{path}: cannot be written ({error.strerror or error})") from error


def make_folder(folder: Path) -> None:
    """Make a folder for what takes long to work out. Errors: ExportError."""
    with explained(folder):
        folder.mkdir(parents=True, exist_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8. Errors: OSError."""
    with beside(path) as hidden:
        hidden.write_text(text, encoding="utf-8")


def write_json(path: Path, content: object) -> None:
    """Write what a reader may also look at: a line for each value. Errors: OSError."""
    write_text(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def write_rows(path: Path, head: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a CSV table. Errors: OSError."""
    with table_file(path) as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(head)
        writer.writerows(rows)


def disk_error(error: BaseException) -> OSError | None:
    """The system's word that nothing more can be written, if an error says so or was raised from one that does."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno in _DISK:
            return cause
        cause = cause.__cause__
    return None


def read_regular(path: Path, *, most_mb: int) -> bytes:
    """The bytes of a regular file of bounded size. Errors: OSError, also for a pipe or a device, which would not end.

    Opened without waiting and looked at when it is open: what the name stands for may change in between.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise OSError(errno.EINVAL, "not a regular file", str(path))
        with open(descriptor, "rb", closefd=False) as file:
            content = file.read(most_mb * 1_000_000 + 1)
    finally:
        os.close(descriptor)
    if len(content) > most_mb * 1_000_000:
        raise OSError(errno.EINVAL, f"larger than {most_mb} MB", str(path))
    return content


def printable(text: str) -> str:
    """A text in which all that does not print is escaped: no control sequences for terminals, always valid UTF-8."""
    return "".join(c if c.isprintable() or c in "\n\t" else c.encode("unicode_escape").decode() for c in text)


def one_line(text: str, *, most: int) -> str:
    """A printable text on one line, of at most so many characters; a text that is so already stays as it is."""
    if len(text) > most or not text.isprintable():
        text = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in " ".join(text.split()))
    return text if len(text) <= most else text[: most - len(_SHORTENED)] + _SHORTENED
