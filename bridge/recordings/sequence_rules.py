"""The rules on an Argoverse 1 sequence that was written beside a scene: its format, the scene's rows, the source's."""

from collections.abc import Iterator
from pathlib import Path

from bridge.files import one_line, read_regular
from bridge.recordings.argoverse1 import check_sequence
from bridge.recordings.limits import MAX_FILE_MB
from bridge.recordings.recording import Recording
from bridge.recordings.row_rules import Rows
from bridge.recordings.rules import Breach
from bridge.recordings.sequence import inserted_id, split_lines
from netconvert.errors import ScenarioError


def check_written_sequence(
    path: Path, rows: Rows, generated_ids: set[str], *, source: Recording | None
) -> Iterator[Breach]:
    """A sequence against the rows of its scene, and its recorded lines against those of the source."""
    try:
        content = read_regular(path, most_mb=MAX_FILE_MB)
        check_sequence(content, str(path))
    except OSError as error:
        yield "sequence", f"cannot be read ({error.strerror})"
        return
    except ScenarioError as error:
        yield "sequence", str(error)
        return
    recorded, inserted = split_lines(content)
    stamps = sorted({float(line.split(",")[recorded[0].split(",").index("TIMESTAMP")]) for line in recorded[1:]})
    wanted = {inserted_id(int(name.removeprefix("gen_"))): name for name in generated_ids if name in rows.ids}
    if inserted.keys() != wanted.keys():
        names = ", ".join(sorted(inserted.keys() ^ wanted.keys())[:5])
        yield "sequence", f"inserted tracks differ from those of the scene: {one_line(names, most=200)}"
        return
    for name, track_id in sorted(wanted.items()):
        index = rows.of(track_id)
        steps = rows.timestep[index].tolist()
        have = [(float(stamp), float(x), float(y)) for stamp, x, y in inserted[name]]
        want = [(stamps[t], x, y) for t, (x, y) in zip(steps, rows.motion[index, :2].tolist(), strict=True)]
        if have != want:
            yield "sequence", f"track {name}: positions are not those of {track_id} in the scene"
    if source is not None and source.sequence is not None:
        lines = source.sequence.decode("ascii").splitlines()
        if recorded != lines:
            line = next((k for k, (a, b) in enumerate(zip(recorded, lines, strict=False)) if a != b), len(lines))
            yield "source", f"recorded line {line + 1} is not that of {source.folder.name}"
