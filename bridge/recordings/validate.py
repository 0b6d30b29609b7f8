"""`hid2 validate`: everything that readers of a generated data set demand, also what they would not complain about.

README.md lists the rules; what is checked of rows, map and sidecar is in `rules` and `map_rules`.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from bridge.config import REACTIVE_PREFIX
from bridge.files import one_line
from bridge.recordings import rules
from bridge.recordings.export import map_bytes, recording_record_of
from bridge.recordings.folders import RAW, SPLITS, Address, sequence_path, split_of
from bridge.recordings.judging import findings_of, states_of
from bridge.recordings.map_rules import check_ground, checked, read_document
from bridge.recordings.plausibility import implausible
from bridge.recordings.scenario import RowArrays, read_scenario, read_table, row_breaches, sizes_of, tracks_of
from bridge.recordings.sidecar import REACTIVE, Sidecar, read_sidecar, sidecar_path
from bridge.recordings.sources import ARGOVERSE2, read_recording
from hid2.agents import BoxSize
from hid2.measures.lane_matching import flatten_lanes
from netconvert.errors import Hid2Error, MapError, ScenarioError
from netconvert.lane_graph import LaneGraph

_Part = TypeVar("_Part")
_LONGEST = 2_000  # characters of what is said of one breach
_OTHER = "no other parquet file anywhere under OUT: readers take every one they find"


class FileBreach(NamedTuple):
    """One breach of one rule; what the judge found also as values: vehicle, step, value and limit, the other track."""

    file: Path
    rule: str
    message: str
    vehicle: str | None = None
    step: int | None = None
    value: float | None = None
    limit: float | None = None
    other: str | None = None

    @property
    def is_note(self) -> bool:
        """Whether it is told and is no fault of the scene."""
        return self.rule == rules.RECORDED

    def line(self) -> str:
        """As it is printed."""
        return f"{self.file}: {'note: ' if self.is_note else ''}{self.rule}: {one_line(self.message, most=_LONGEST)}"


@dataclass(frozen=True, slots=True)
class Against:
    """What scenes are held against. out: the data set; sources: recordings by id, None for no comparison.

    inserted: ids of the tracks that are judged, None for those that hid2 inserted.
    """

    out: Path | None = None
    sources: Mapping[str, Address] | None = None
    inserted: frozenset[str] | None = None


def validate_scene(against: Against, folder: Path) -> list[FileBreach]:
    """Check one scenario folder, and its sequence of Argoverse 1 below out where there is one.

    A scene without sidecar in which no track is a generated one was recorded: it is held to the format alone.
    """
    new_id = folder.name
    findings: list[FileBreach] = []
    sidecar, rows, document, graph = _parts(folder, findings)
    if new_id.startswith(REACTIVE_PREFIX) or (sidecar is not None and sidecar.replay.mode == "reactive"):
        return [FileBreach(folder, "replay", REACTIVE)]  # whatever else it is, it is no scene of Argoverse
    findings += _missing_sidecar(folder, rows)
    if rows is None:
        return findings
    path, agents = folder / f"scenario_{new_id}.parquet", sidecar.agents if sidecar is not None else ()
    generated_ids = {agent.track_id for agent in agents} | {name for name in rows.ids if name.startswith("gen_")}
    clean = {agent.track_id: agent.clean.motion for agent in agents if agent.clean}
    length_m = {agent.track_id: agent.length_m for agent in agents}
    breaches = list(rules.check_rows(rows, new_id))
    for track_id in sorted(generated_ids & set(rows.ids)):
        breaches += rules.check_generated(rows, track_id, clean.get(track_id), length_m.get(track_id, 0.0))
    findings += [FileBreach(path, *breach) for breach in breaches]
    if document is None:
        return findings
    if graph is not None and next(row_breaches(rows), None) is None:
        findings += _judged(path, rows, graph, sidecar, generated_ids if against.inserted is None else against.inserted)
    if sidecar is not None:
        begins = dict(zip(rows.ids, rows.timestep[rows.starts].tolist(), strict=True))
        lanes = {str(lane) for lane in document["lane_segments"]}
        found_in = rules.check_sidecar(sidecar, new_id, begins, generated_ids, lanes)
        findings += [FileBreach(sidecar_path(folder, new_id), *breach) for breach in found_in]
        findings += _compared(folder, sidecar, rows, generated_ids, against)
    return findings


def _parts(
    folder: Path, findings: list[FileBreach]
) -> tuple[Sidecar | None, RowArrays | None, dict[str, Any] | None, LaneGraph | None]:
    """Sidecar, rows, map and its graph, as far as they are there; why one cannot be read is appended to `findings`."""
    parquet_path, map_path = folder / f"scenario_{folder.name}.parquet", folder / f"log_map_archive_{folder.name}.json"
    findings += [FileBreach(path, "folder", "no such file") for path in (parquet_path, map_path) if not path.is_file()]

    def read(path: Path, rule: str, reader: Callable[[Path], _Part]) -> _Part | None:
        try:
            return reader(path) if path.is_file() else None
        except (ScenarioError, MapError) as error:
            findings.append(FileBreach(path, rule, str(error).removeprefix(f"{path}: ")))
            return None

    sidecar = read(sidecar_path(folder, folder.name), "sidecar", read_sidecar)
    document, graph = read(map_path, "map", read_document), None
    if document is not None:
        graph, breaches = checked(document)
        findings += [FileBreach(map_path, *breach) for breach in breaches]
        for key in [key for key, lane in document["lane_segments"].items() if not lane.get("centerline")]:
            said = f"lane segment {key}: no centerline, expected at least 2 points"  # which recorded maps may lack
            findings.append(FileBreach(map_path, "boundary", said))
    rows = read(parquet_path, "columns", lambda path: RowArrays.of(read_table(path)))
    if rows is not None and sidecar is not None:
        rows = replace(rows, observed_steps=sidecar.recording.observed_steps, step_s=sidecar.recording.step_s)
    return sidecar, rows, document, graph


def _compared(
    folder: Path, sidecar: Sidecar, rows: RowArrays, generated_ids: set[str], against: Against
) -> Iterator[FileBreach]:
    """A scene against its source, and its sequence of Argoverse 1 where there is one."""
    source = None
    if against.sources is not None:
        wanted = sidecar.source_scenario_id
        try:
            if wanted not in against.sources:
                raise ScenarioError(f"source scenario {wanted} is not among the {len(against.sources)} given")
            source = read_recording(against.sources[wanted])
        except Hid2Error as error:
            yield FileBreach(sidecar_path(folder, folder.name), "source", str(error))
            return
        path = folder / f"scenario_{folder.name}.parquet"
        for message in rules.compare_rows(rows.table, source.table, generated_ids):
            yield FileBreach(path, "source", message)
        path = folder / f"log_map_archive_{folder.name}.json"
        if path.read_bytes() != map_bytes(source):
            yield FileBreach(path, "source", f"not the bytes that are written for {source.map_path.name}")
        if source.format != ARGOVERSE2.name and sidecar.recording != recording_record_of(source):
            yield FileBreach(sidecar_path(folder, folder.name), "source", "recording: not that of the source")
    if against.out is not None:
        path = sequence_path(against.out, split_of(folder), folder.name)
        if path.is_file():
            for breach in rules.check_written_sequence(path, rows, generated_ids, source=source):
                yield FileBreach(path, *breach)


def _missing_sidecar(folder: Path, rows: RowArrays | None) -> list[FileBreach]:
    """A finding where there is no sidecar, unless none of the tracks is a generated one: then how plausible it is."""
    path = sidecar_path(folder, folder.name)
    if path.is_file():
        return []
    if rows is None or any(track_id.startswith("gen_") for track_id in rows.ids):
        return [FileBreach(path, "folder", "no such file, which every generated scene has (a recorded one has none)")]
    with suppress(Hid2Error):  # which the other rules find
        said = implausible(read_scenario(folder))
        return [FileBreach(folder / f"scenario_{folder.name}.parquet", rules.RECORDED, said)] if said else []
    return []


def _judged(
    path: Path, rows: RowArrays, graph: LaneGraph, sidecar: Sidecar | None, inserted: Set[str]
) -> list[FileBreach]:
    """What the judge finds in a scene with sound rows and map."""
    sizes: Mapping[str, BoxSize] = {}
    with suppress(ScenarioError):  # sizes beside a scene are none of its files
        sizes = sizes_of(path.parent, sidecar)
    tracks = tracks_of(rows, sizes)
    try:
        check_ground(tracks, graph, path.name)
    except ScenarioError as error:
        return [FileBreach(path, "columns", str(error))]
    states = states_of(tracks, flatten_lanes(graph), inserted, num_steps=rows.num_steps, step_s=rows.step_s)
    found = []
    for one in findings_of(states, sidecar):
        said = "not seen" if math.isinf(one.value) else f"{one.value:.3g} {one.quantity.unit}"
        other = "" if one.other is None else f" (track {one.other!r})"
        message = f"track {one.track_id!r}, timestep {one.step}: {said}{other}, limit {one.limit:.3g}"
        value = None if math.isinf(one.value) else one.value
        found.append(FileBreach(path, one.quantity.value, message, one.track_id, one.step, value, one.limit, one.other))
    return found


def check_tree(out: Path, folders: Sequence[Path]) -> list[FileBreach]:
    """What is wrong with the places of files in a data set."""
    expected = {folder / f"scenario_{folder.name}.parquet" for folder in folders}
    others = [path for path in sorted(out.rglob("*.parquet")) if path not in expected]
    findings = [FileBreach(path, "other-parquet", _OTHER) for path in others]
    for folder in folders:
        depth = len(folder.relative_to(out).parts)
        split = folder.parent.parent.name if depth == 3 and folder.parent.name == RAW else folder.parent.name
        if depth > 1 and split not in SPLITS:
            findings.append(FileBreach(folder, "folder", f"split {split!r}, expected one of {', '.join(SPLITS)}"))
    return findings
