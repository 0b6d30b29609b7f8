"""Argoverse 1 sequences out: recorded lines text for text, inserted vehicles as OTHERS among them.

OUT/argoverse1/[train|val|test_obs/]data/<number>.csv, a folder that loaders of Argoverse 1 read unchanged. The number
is the first 48 bits of the scene's id: the same request names the same file, two requests never one.
"""

import csv
import io
from collections.abc import Sequence
from pathlib import Path

from bridge.files import beside
from bridge.recordings.argoverse1 import COLUMNS, OTHERS
from bridge.recordings.folders import sequence_path
from bridge.recordings.recording import Recording
from hid2.agents import Track
from netconvert.errors import ExportError


def write_sequence(scenario: Recording, generated: Sequence[Track], out_dir: Path, *, new_id: str) -> Path:
    """Write the sequence of a scene that was made from one; returns its path. Errors: ExportError."""
    path = sequence_path(out_dir, scenario.split, new_id)
    content = sequence_bytes(scenario, generated)
    with beside(path) as hidden:
        hidden.write_bytes(content)
    return path


def sequence_bytes(scenario: Recording, generated: Sequence[Track]) -> bytes:
    """The source's lines, and behind those of each time stamp the inserted vehicles. Errors: ExportError."""
    if scenario.sequence is None:
        raise ExportError(f"{scenario.folder}: no Argoverse 1 sequence, expected one to write one")
    lines = scenario.sequence.decode("ascii").splitlines(keepends=True)
    ending = "\r\n" if lines[0].endswith("\r\n") else "\n"
    lines[-1] = lines[-1].rstrip("\r\n") + ending
    rows = list(csv.reader(lines))
    at = {column: rows[0].index(column) for column in COLUMNS}
    stamps = [row[at["TIMESTAMP"]] for row in rows[1:]]
    by_time = sorted({float(stamp): stamp for stamp in stamps}.items())
    taken = {row[at["TRACK_ID"]] for row in rows[1:]}
    added: dict[float, list[str]] = {stamp: [] for stamp, _ in by_time}
    for number, track in enumerate(generated):
        name = inserted_id(number)
        if name in taken:
            raise ExportError(f"{scenario.folder}: TRACK_ID {name} is taken, expected it free for {track.track_id}")
        for step, (x, y) in zip(track.timesteps.tolist(), track.position.tolist(), strict=True):
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


def inserted_id(number: int) -> str:
    """TRACK_ID of an inserted vehicle gen_<number>; recorded ones have 0000 before the last part."""
    return f"00000000-0000-0000-0001-{number:012d}"
