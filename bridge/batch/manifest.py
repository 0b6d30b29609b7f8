"""manifest.csv: one row per scene and variant of a batch, appended as they are done and sorted at the end.

The file is the working state too: a row is one line that ends with its own check sum, so that whatever is cut, merged,
overwritten or edited costs the lines it touches and no other, also on the network file systems that clusters share. A
line that cannot be read is left out, said, and its scene made again. Texts are bounded, and paths stay below OUT.
"""

import contextlib
import csv
import hashlib
import io
import logging
import os
import re
import zlib
from collections.abc import Iterable
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from bridge.files import MAX_FILE_MB, explained, one_line, read_regular, table_file, table_text, untabled, write_text
from bridge.recordings.folders import SPLITS, WRITTEN
from netconvert.errors import BatchError, ConfigError

MANIFEST_NAME, CONTENTS_NAME = "manifest.csv", "contents.txt"
_HEAD = b"scenario,split,"  # how the first line begins
#: Last column: CRC-32 of the line up to it.
CHECK = "check"
#: Longest text in a row, characters; the bundle of a scene has all of its reason.
MAX_TEXT = 2_000
#: Size of a manifest, MB, at most: a row has 1 kB, a data set 250,000 scenes.
_MOST_MB = 2_000
_DIGEST = re.compile(r"([0-9a-f]{64})?")
_LOG = logging.getLogger(__name__)

DONE = "done"
QUARANTINED = "quarantined"


class ManifestRow(NamedTuple):
    """What became of one variant of one source scene.

    scenario: name of the source folder; requested: number, or "max"; maneuvers_*, events_*: records of the sidecar;
    events: those that came about, with time, gap and criticality; rejected, not_done: "reason (count)" joined by "; ";
    failure: error, exception, crashed, killed, timeout or memory; bundle: file that reproduces the failure, below the
    output folder; *_sha256: contents of the source's and of the written files, and of the file of a lane-change rule
    of the user's own; version: of the program, by its contents too (`code_version`); platform, processor: where it
    ran; driven: vehicles, of which those placed are a selection; braking_*, standing_*: share of the vehicles that
    are kept, dropped or recorded that brake harder than 3 m/s2, or stand, at some time; limited_*: share of steps in
    which one was limited for a conflict; near: of those placed, those within request.within_m of what request.near
    names: of traffic at any step, of named agents at the last observed one; entered: of those placed, those that are
    not there from the first step; focal: policy that a generated focal track does. Texts are printable and bounded.
    """

    scenario: str
    split: str
    variant: int
    seed: int
    status: str
    city: str = ""
    recorded: int = 0
    requested: str = ""
    placed: int = 0
    straight: int = 0
    left_turn: int = 0
    right_turn: int = 0
    lane_change: int = 0
    overtake: int = 0
    maneuvers_requested: int = 0
    maneuvers_done: int = 0
    events_requested: int = 0
    events_done: int = 0
    rejected: str = ""
    not_done: str = ""
    seconds: float = 0.0
    attempts: int = 1
    failure: str = ""
    reason: str = ""
    bundle: str = ""
    folder: str = ""
    source_sha256: str = ""
    config_sha256: str = ""
    output_sha256: str = ""
    version: str = ""
    rule_sha256: str = ""
    platform: str = ""
    processor: str = ""
    driven: int = 0
    braking_kept: float = 0.0
    braking_dropped: float = 0.0
    braking_recorded: float = 0.0
    standing_kept: float = 0.0
    standing_dropped: float = 0.0
    standing_recorded: float = 0.0
    limited_kept: float = 0.0
    limited_dropped: float = 0.0
    events: str = ""
    near: int = 0
    entered: int = 0
    focal: str = ""

    @property
    def asked(self) -> str:
        """Vehicles asked for, or max: those of events are made even where they are more than requested."""
        return self.requested if self.requested == "max" else str(max(int(self.requested), self.events_requested))

    @property
    def key(self) -> tuple[str, str, str, int]:
        """What a row is about: a later row with the same key takes its place."""
        return (self.split, self.scenario, self.config_sha256, self.variant)


class Manifest:
    """The rows of an output folder, on disk after every change. Errors: ExportError where it cannot be written.

    Lines that cannot be read, and scenes that are done but not there, are left out, which is said.
    """

    def __init__(self, out_dir: Path) -> None:
        self.path = out_dir / MANIFEST_NAME
        rows, unread = read_manifest(self.path)
        there = [row for row in rows if row.status != DONE or (out_dir / row.folder).is_dir()]
        if unread:
            _LOG.warning(
                "%s: %d lines cannot be read: their scenes are made again if they are wanted", self.path, unread
            )
        if len(there) < len(rows):
            _LOG.warning("%s: %d rows left out: their folders are not there", self.path, len(rows) - len(there))
        self.by_key = {row.key: row for row in there}
        self.save()

    @property
    def rows(self) -> list[ManifestRow]:
        """All rows, sorted by split, scenario, configuration and variant."""
        return [self.by_key[key] for key in sorted(self.by_key)]

    def name_contents(self, contents: str) -> None:
        """Write down beside it what the rows are of. Errors: ConfigError where they are of anything else."""
        path, contents, known = self.path.with_name(CONTENTS_NAME), contents.strip(), ""
        if path.is_file():
            with explained(path):
                known = path.read_text(encoding="utf-8", errors="replace").strip()
        if self.by_key and known != contents:
            held = repr(one_line(known, most=300)) if known else "no such file, but runs beside it"
            raise ConfigError(
                f"{path}: {held}, expected {contents!r}: take another OUT, or write that line into it if it is so"
            )
        write_text(path, f"{contents}\n")

    def add(self, row: ManifestRow) -> None:
        """Append a row to the file."""
        with explained(self.path), self.path.open("a", newline="", encoding="utf-8") as file:
            file.write(_line(row))
        self.by_key[row.key] = row

    def save(self) -> None:
        """Write the file anew, sorted, each row once."""
        with table_file(self.path) as file:
            file.write(",".join((*ManifestRow._fields, CHECK)) + "\n")
            file.writelines(map(_line, self.rows))


def read_manifest(path: Path) -> tuple[list[ManifestRow], int]:
    """The rows of a manifest, and the number of lines that cannot be read. No file, no rows. Errors: BatchError."""
    try:
        content = read_regular(path, most_mb=_MOST_MB)
    except FileNotFoundError:
        return [], 0
    except OSError as error:
        said = f"{path}: {error.strerror}, expected a manifest, or nothing of that name: move it away"
        raise BatchError(said) from error
    lines = [line for line in io.BytesIO(content) if line.strip() and not line.startswith(_HEAD)]
    rows = [row for line in lines if (row := _parse(line)) is not None]
    return rows, len(lines) - len(rows)


def is_output(folder: Path) -> bool:
    """Whether a folder has a manifest that hid2 wrote, by its first line."""
    with contextlib.suppress(OSError):  # one that may not be read
        if (path := folder / MANIFEST_NAME).is_file():
            with path.open("rb") as file:
                return file.read(len(_HEAD)) == _HEAD
    return False


def _line(row: ManifestRow) -> str:
    cells = [one_line(value, most=MAX_TEXT) if isinstance(value, str) else value for value in row]
    said = table_text([cells]).rstrip("\n")
    return f"{said},{zlib.crc32(said.encode()):08x}\n"


def _parse(line: bytes) -> ManifestRow | None:
    """The row on a line, None where it is not whole or says what no row does."""
    text, _, check = line.rpartition(b",")
    if check != b"%08x\n" % zlib.crc32(text):
        return None
    try:
        named = zip(ManifestRow._fields, next(csv.reader([text.decode()]), []), strict=True)
        row = ManifestRow(**{name: ManifestRow.__annotations__[name](untabled(value)) for name, value in named})
    except (ValueError, csv.Error):
        return None
    return row if _is_sound(row) else None


def _is_sound(row: ManifestRow) -> bool:
    """Whether a row can have been written here: known words, digests, and paths that stay below OUT."""
    return (
        row.status in (DONE, QUARANTINED)
        and row.split in ("", *SPLITS)
        and row.variant >= 0
        and all(_DIGEST.fullmatch(getattr(row, name)) for name in ManifestRow._fields if name.endswith("_sha256"))
        and not any(path.startswith("/") or ".." in PurePosixPath(path).parts for path in (row.folder, row.bundle))
        and (row.status == DONE) == (row.folder != "")
        and all(value == one_line(value, most=MAX_TEXT) for value in row if isinstance(value, str))
    )


def files_sha256(paths: Iterable[Path]) -> str:
    """One digest of the names and contents of regular files, in any order; "" where there is none. Errors: OSError.

    One that is larger than any reader takes counts by its size.
    """
    digest, found = hashlib.sha256(), False
    for path in sorted(paths, key=lambda path: path.name):
        size = path.stat().st_size
        content = path.read_bytes() if size <= MAX_FILE_MB * 1_000_000 else b""
        digest.update(f"{path.name} {len(content) or size}\n".encode("utf-8", "surrogateescape"))
        digest.update(content)
        found = True
    return digest.hexdigest() if found else ""


def output_files(folder: Path) -> list[Path]:
    """All regular files of a written folder that hid2 writes; a user's notes beside them change nothing."""
    files = [Path(entry.path) for entry in os.scandir(folder) if entry.is_file()] if folder.is_dir() else []
    return [path for path in files if path.name.startswith(WRITTEN)]
