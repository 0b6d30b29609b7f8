"""manifest.csv: one row per scene and variant of a batch, written as they are done and sorted at the end."""

import csv
import hashlib
import os
from collections.abc import Iterable
from functools import cache
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any, NamedTuple

import bridge
import hid2
import netconvert
from bridge.files import table_file

MANIFEST_NAME = "manifest.csv"

DONE = "done"
QUARANTINED = "quarantined"


class ManifestRow(NamedTuple):
    """What became of one variant of one source scene.

    scenario: name of the source folder; requested: number, or "max"; maneuvers_*: records of the sidecar; rejected,
    not_done: "reason (count)" joined by "; "; failure: error, exception, crashed, killed or timeout; bundle: file that
    reproduces the failure, below the output folder; *_sha256: contents of the source's and of the written files;
    version: of the program, by its contents too (`code_version`).
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

    @property
    def key(self) -> tuple[str, str, str, int]:
        """What a row is about: a later row with the same key takes its place."""
        return (self.split, self.scenario, self.config_sha256, self.variant)


class Manifest:
    """The rows of an output folder, on disk after every change."""

    def __init__(self, out_dir: Path) -> None:
        self.path = out_dir / MANIFEST_NAME
        self._rows = {row.key: row for row in read_manifest(self.path)}
        self.save()  # drops a line that an interruption has cut

    @property
    def rows(self) -> list[ManifestRow]:
        """All rows, sorted by split, scenario, configuration and variant."""
        return [self._rows[key] for key in sorted(self._rows)]

    def get(self, key: tuple[str, str, str, int]) -> ManifestRow | None:
        """The row about a scene, configuration and variant."""
        return self._rows.get(key)

    def add(self, row: ManifestRow) -> None:
        """Append a row to the file."""
        self._rows[row.key] = row
        with self.path.open("a", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerow(row)

    def save(self) -> None:
        """Write the file anew, sorted, each row once."""
        write_rows(self.path, self.rows)


def read_manifest(path: Path) -> list[ManifestRow]:
    """The rows of a manifest, none where there is no file; lines that are not whole are left out."""
    if not path.exists():
        return []
    rows = []
    with path.open(newline="", encoding="utf-8") as file:
        for values in csv.DictReader(file):
            row = _parse(values)
            if row is not None:
                rows.append(row)
    return rows


def write_rows(path: Path, rows: Iterable[ManifestRow]) -> None:
    """Write rows with a header."""
    with table_file(path) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(ManifestRow._fields)
        writer.writerows(rows)


def _parse(values: dict[str, Any]) -> ManifestRow | None:
    if set(values) != set(ManifestRow._fields) or any(value is None for value in values.values()):
        return None
    types = ManifestRow.__annotations__
    try:
        return ManifestRow(**{name: types[name](value) for name, value in values.items()})
    except ValueError:
        return None


def files_sha256(paths: Iterable[Path]) -> str:
    """One digest of the names and contents of files, whatever their order; "" where there is none."""
    digest, found = hashlib.sha256(), False
    for path in sorted(paths, key=lambda path: path.name):
        content = path.read_bytes()
        digest.update(f"{path.name} {len(content)}\n".encode())
        digest.update(content)
        found = True
    return digest.hexdigest() if found else ""


@cache
def code_version() -> str:
    """Version of the program with a digest of its source, "0.1.0+3f2a...": edited code is another version."""
    digest = hashlib.sha256()
    for package in (netconvert, hid2, bridge):
        for place in package.__path__:
            for path in sorted(Path(place).rglob("*.py")):
                content = path.read_bytes()
                digest.update(f"{package.__name__}/{path.relative_to(place).as_posix()} {len(content)}\n".encode())
                digest.update(content)
    return f"{installed_version('hid2-sumo')}+{digest.hexdigest()[:12]}"


def source_files(folder: Path) -> list[Path]:
    """The files of a scenario folder that a generated scene depends on."""
    patterns = ("scenario_*.parquet", "log_map_archive_*.json", "hid2_*.json", "agent_sizes.csv")
    return [path for pattern in patterns for path in folder.glob(pattern)]


def output_files(folder: Path) -> list[Path]:
    """All files of a written scenario folder."""
    return [Path(entry.path) for entry in os.scandir(folder) if entry.is_file()] if folder.is_dir() else []
