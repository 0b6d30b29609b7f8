"""Files that are there whole or not at all, and files of others, which may be anything."""

import contextlib
import csv
import errno
import gzip
import io
import json
import math
import os
import re
import stat
import zlib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import IO

from bridge.interruption import hidden_file
from netconvert.errors import DiskFullError, ExportError, Hid2Error

#: What the system says when nothing more can be written: full, over the quota or the size, read-only.
_DISK = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS})
#: Each file of a scene, MB. Real: below 3.
MAX_FILE_MB = 32
_SHORTENED = " ...(shortened)... "
#: A text that a spreadsheet runs as a formula, behind apostrophes or not; a number is none, nor is a sign alone.
_FORMULA = re.compile(r"\A'*(?:[=@\t\r]|[+-](?!(?:\d*\.?\d+(?:e[+-]?\d+)?|inf|nan)$)).", re.DOTALL | re.IGNORECASE)


@contextlib.contextmanager
def explained(path: Path) -> Iterator[None]:
    """What the system says against writing to a path becomes an ExportError that names it, or a DiskFullError."""
    try:
        yield
    except OSError as error:
        kind = DiskFullError if disk_error(error) else ExportError
        rights = error.errno in {errno.EACCES, errno.EPERM, errno.EROFS}
        way_out = "; choose a folder that you may write to" if rights else ""
        raise kind(f"{path}: cannot be written ({error.strerror or error}){way_out}") from error


def with_name(path: object, reason: str) -> str:
    """A reason behind what it is of, once: most reasons name their file themselves."""
    return reason if reason.startswith(str(path)) else f"{path}: {reason}"


@contextlib.contextmanager
def beside(path: Path) -> Iterator[Path]:
    """A hidden file beside a file, which takes the place of that at the end; gone if all fails. Errors: ExportError."""
    with explained(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with hidden_file(path.parent, path.suffix) as hidden:
            yield hidden
            hidden.replace(path)


def data_folder() -> Path:
    """Synthetic scenes, configurations, studies and notebooks: in a wheel's packages, beside those of a checkout."""
    packed = Path(__file__).parent / "data"
    return packed if packed.is_dir() else packed.parents[1] / "data"


@contextlib.contextmanager
def table_file(path: Path) -> Iterator[IO[str]]:
    """A file for `table_text`, `beside` its place. Errors: ExportError."""
    with beside(path) as hidden, hidden.open("w", newline="", encoding="utf-8") as stream:
        yield stream


def make_folder(folder: Path) -> None:
    """Make a folder for what takes long to work out. Errors: ExportError."""
    with explained(folder):
        folder.mkdir(parents=True, exist_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8. Errors: ExportError."""
    with beside(path) as hidden:
        hidden.write_text(text, encoding="utf-8")


def write_json(path: Path, content: object) -> None:
    """Write what a reader may also look at: a line for each value. Errors: ExportError."""
    write_text(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def write_rows(path: Path, head: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a CSV table. Errors: ExportError."""
    write_text(path, table_text([head, *rows]))


def table_text(rows: Iterable[Iterable[object]]) -> str:
    """Rows as lines of CSV: every table that hid2 writes for people goes through here."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(map(table_cell, row) for row in rows)
    return text.getvalue()


def table_cell(value: object) -> object:
    """A value as a CSV table has it: a text or path that would be run as a formula goes behind an apostrophe."""
    return printable(_FORMULA.sub(r"'\g<0>", str(value))) if isinstance(value, str | Path) else value


def rounded(value: float | None, digits: int = 4) -> float | None:
    """A value as tables and sidecars have it, to so many digits; None where there is none, or no finite one."""
    return None if value is None or not math.isfinite(value) else round(float(value), digits)


def untabled(text: str) -> str:
    """The way back from `table_cell`."""
    return text[1:] if text[:1] == "'" and _FORMULA.match(text) else text


def disk_error(error: BaseException) -> OSError | None:
    """The system's word that nothing more can be written, if an error says so or was raised from one that does."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno in _DISK:
            return cause
        cause = cause.__cause__
    return None


def read_regular(path: Path, *, most_mb: int) -> bytes:
    """The bytes of a regular file of bounded size. Errors: OSError, also for a pipe or a device, which has no end."""
    with open(path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK)) as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError(errno.EINVAL, "not a regular file", str(path))
        return read_bounded(file, path, most_mb=most_mb)


def read_bounded(stream: IO[bytes] | gzip.GzipFile, path: Path, *, most_mb: int) -> bytes:
    """What is left of a stream, never more than so much of it. path: what errors name. Errors: OSError."""
    content = stream.read(most_mb * 1_000_000 + 1)
    if len(content) > most_mb * 1_000_000:
        raise OSError(errno.EINVAL, f"holds more than {most_mb} MB", str(path))
    return content


def read_received(path: Path, kind: type[Hid2Error], *, wanted: str, most_mb: int = MAX_FILE_MB) -> bytes:
    """As `read_regular`, of a file that may come from anywhere. Errors: of that kind, with what was wanted."""
    try:
        return read_regular(path, most_mb=most_mb)
    except OSError as error:
        said = "no such file" if isinstance(error, FileNotFoundError) else f"cannot be read ({error.strerror})"
        raise kind(f"{path}: {said}, expected {wanted}") from error


def read_packed(path: Path, *, most_mb: int) -> bytes:
    """What a gzip file holds, never unpacked beyond its limit. Errors: OSError."""
    try:
        with gzip.open(io.BytesIO(read_regular(path, most_mb=most_mb))) as stream:
            return read_bounded(stream, path, most_mb=most_mb)
    except (EOFError, zlib.error) as error:
        raise OSError(errno.EINVAL, f"not gzip ({error})", str(path)) from error


def printable(text: str) -> str:
    """A text in which all that does not print is escaped: no control sequences for terminals, always valid UTF-8."""
    return "".join(c if c.isprintable() or c in "\n\t" else c.encode("unicode_escape").decode() for c in text)


def one_line(text: str, *, most: int) -> str:
    """A printable text on one line, of at most so many characters; a longer one keeps its end: what is expected."""
    if len(text) > most or not text.isprintable():
        text = printable(" ".join(text.split()))
    end = (most - len(_SHORTENED)) // 3
    return text if len(text) <= most else text[: most - end - len(_SHORTENED)] + _SHORTENED + text[len(text) - end :]
