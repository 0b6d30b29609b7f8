"""Argoverse 1 sequences out: recorded lines text for text, inserted vehicles as OTHERS among them.

OUT/argoverse1/[train|val|test_obs/]data/<number>.csv, a folder that loaders of Argoverse 1 read unchanged. The number
is the first 48 bits of the scene's id: the same request names the same file, two requests never one.
"""

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path

from bridge.files import beside
from bridge.recordings.argoverse1 import COLUMNS, OTHERS
from bridge.recordings.folders import sequence_path
from bridge.recordings.recording import Recording
from hid2.agents import FloatArray, IntArray, Track
from netconvert.errors import ExportError

#: TRACK_IDs of inserted vehicles begin so; recorded ones have 0000 before the last part.
INSERTED = "00000000-0000-0000-0001-"


def write_sequence(scenario: Recording, generated: Sequence[Track], out_dir: Path, *, new_id: str) -> Path:
    """Write the sequence of a scene that was made from one; returns its path. Errors: ExportError."""
    if scenario.sequence is None:
        raise ExportError(f"{scenario.folder}: no Argoverse 1 sequence, expected one to write one")
    path = sequence_path(out_dir, scenario.split, new_id)
    content = sequence_bytes(scenario.sequence, [(track.timesteps, track.position) for track in generated])
    with beside(path) as hidden:
        hidden.write_bytes(content)
    return path


def sequence_bytes(recorded: bytes, inserted: Iterable[tuple[IntArray, FloatArray]]) -> bytes:
    """Recorded lines, and behind those of each time stamp the inserted vehicles. inserted: steps and positions, m.

    Errors: ExportError where one of their TRACK_IDs is taken.
    """
    lines = recorded.decode("ascii").splitlines(keepends=True)
    ending = "\r\n" if lines[0].endswith("\r\n") else "\n"
    lines[-1] = lines[-1].rstrip("\r\n") + ending
    rows = list(csv.reader(lines))
    at = {column: rows[0].index(column) for column in COLUMNS}
    stamps = [row[at["TIMESTAMP"]] for row in rows[1:]]
    by_time = sorted({float(stamp): stamp for stamp in stamps}.items())
    taken = {row[at["TRACK_ID"]] for row in rows[1:]}
    added: dict[float, list[str]] = {stamp: [] for stamp, _ in by_time}
    for number, (steps, places) in enumerate(inserted):
        name = f"{INSERTED}{number:012d}"
        if name in taken:
            raise ExportError(f"TRACK_ID {name} is taken in the sequence, expected it free for gen_{number}")
        for step, (x, y) in zip(steps.tolist(), places.tolist(), strict=True):
            stamp, text = by_time[step]
            values = {"TIMESTAMP": text, "TRACK_ID": name, "OBJECT_TYPE": OTHERS, "X": repr(x), "Y": repr(y)}
            values["CITY_NAME"] = rows[1][at["CITY_NAME"]]
            added[stamp].append(",".join(values[column] for column in rows[0]) + ending)
    last = {float(stamp): line for line, stamp in enumerate(stamps, start=1)}
    out = io.StringIO()
    for number, line in enumerate(lines):
        out.write(line)
        if number and last[float(stamps[number - 1])] == number:
            out.writelines(added[float(stamps[number - 1])])
    return out.getvalue().encode("ascii")
