"""The rules on an Argoverse 1 sequence that was written beside a scene: its format, the scene's rows, the source's."""

import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from bridge.files import one_line, read_received
from bridge.recordings.argoverse1 import OTHERS, check_sequence
from bridge.recordings.recording import Recording
from bridge.recordings.scenario import RowArrays
from bridge.recordings.sequence import inserted_id
from netconvert.av2_map import Breach
from netconvert.errors import ScenarioError


def check_written_sequence(
    path: Path, rows: RowArrays, generated_ids: set[str], *, source: Recording | None
) -> Iterator[Breach]:
    """A sequence against the rows of its scene, and its recorded lines against those of the source."""
    try:
        content = read_received(path, ScenarioError, wanted="an Argoverse 1 sequence")
        found = check_sequence(content, str(path))
    except ScenarioError as error:
        yield "sequence", str(error)
        return
    is_inserted = inserted_id(0)[:-12]
    inserted = {
        name: found.code == code
        for code, (name, kind) in enumerate(zip(found.ids, found.kinds, strict=True))
        if name.startswith(is_inserted) and kind == OTHERS
    }
    wanted = {inserted_id(int(name.removeprefix("gen_"))): name for name in generated_ids if name in rows.ids}
    if inserted.keys() != wanted.keys():
        names = ", ".join(sorted(inserted.keys() ^ wanted.keys())[:5])
        yield "sequence", f"inserted tracks differ from those of the scene: {one_line(names, most=200)}"
        return
    for name, track_id in sorted(wanted.items()):
        index = rows.of_track(rows.ids.index(track_id))
        own = inserted[name]
        same = np.array_equal(found.timestep[own], rows.timestep[index])
        if not same or not np.array_equal(found.position[own], rows.motion[index, :2]):
            yield "sequence", f"track {name}: positions are not those of {track_id} in the scene"
    if source is not None and source.sequence is not None:
        lines = source.sequence.decode("ascii").splitlines()
        ours = content.decode("ascii").splitlines()
        column = next(csv.reader(ours[:1])).index("TRACK_ID")
        recorded = [line for line, row in zip(ours, csv.reader(ours), strict=False) if row[column] not in inserted]
        if recorded != lines:
            line = next((k for k, (a, b) in enumerate(zip(recorded, lines, strict=False)) if a != b), len(lines))
            yield "source", f"recorded line {line + 1} is not that of {source.folder.name}"
