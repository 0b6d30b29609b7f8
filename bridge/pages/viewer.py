"""Scenes as one HTML file that a browser plays: what it holds of each, packed; `templates/viewer.js` shows it.

A column of numbers is written as differences of integers, of first or second order, in steps of a quantum: small
numbers, of which deflate leaves a byte or less. What is derived of the states comes from where every picture and every
check takes it: `motion`, `leaders`, `first_lane_offset`, `original_occupancy`, the judge.
"""

import base64
import csv
import io
import json
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from bridge.config import asked_for, word_for_recorded
from bridge.files import MAX_FILE_MB, one_line, read_packed, rounded, write_text
from bridge.pages.parts import text
from bridge.pictures import figures
from bridge.recordings.folders import Address
from bridge.recordings.judging import findings_of, recording_states
from bridge.recordings.recording import Recording
from bridge.recordings.sources import read_recording
from hid2.agents import FOCAL_CATEGORY, FloatArray
from hid2.evaluation.kinematics import motion
from hid2.judge.findings import Quantity
from hid2.measures.arrays import is_generated_id
from hid2.measures.driven_lanes import first_lane_offset
from hid2.measures.following import leaders
from hid2.measures.manoeuvres import ManeuverKind
from hid2.occupancy.agent_states import AgentStates
from hid2.occupancy.sigma import cell_boxes, original_occupancy
from hid2.policy.behaviours import BEHAVIOURS, behaviour_seen
from hid2.reasons import Reason
from netconvert.cells import build_cell_grid
from netconvert.errors import MapError, ScenarioError
from netconvert.lane_graph import LaneGraph, LaneSegment

#: Quantum of metres and of what is made of them, and of headings, rad.
METRE, RADIAN = 0.001, 0.0001
#: A number that is not there, before differences are taken: the least of 32 bits, in which they are summed.
NONE = -(2**31)
#: What of a look at a gap is shown, of the columns of gaps_<id>.csv.gz.
LOOK_COLUMNS = (
    "time_s", "side", "lane_id", "cell", "cells_free", "lead_id", "lead_gap_m", "lag_id", "lag_gap_m", "remaining_m",
    "rule", "refusals", "guard", "sumo",
)  # fmt: skip
_NUMBERS = frozenset({"time_s", "lane_id", "cell", "lead_gap_m", "lag_gap_m", "remaining_m"})
#: What of the sidecar a page holds.
SAID = {"source_scenario_id", "seed", "variant", "requested", "placed", "agents", "unmet", "events", "rejected"}


def view_scenes(
    addresses: Sequence[Address], out_file: Path, *, on_scene: Callable[[int, int], None] | None = None
) -> tuple[Path, list[tuple[Address, str]]]:
    """Write scenes, recorded or generated, as one HTML file without outside references, in the order given.

    on_scene(done, total) is called after each. Returns the file, and what cannot be read and is left out, with reasons.
    Errors: ScenarioError where no scene can be read; ExportError where the file cannot be written.
    """
    unread: list[tuple[Address, str]] = []

    def documents() -> Iterator[dict[str, Any]]:
        for number, address in enumerate(addresses, 1):
            try:
                document = scene_document(read_recording(address))
            except (ScenarioError, MapError) as error:
                unread.append((address, str(error)))
            else:
                yield document
            if on_scene is not None:
                on_scene(number, len(addresses))

    page = page_of(documents())
    if len(unread) == len(addresses):
        raise ScenarioError(unread[0][1])
    write_text(out_file, page)
    return out_file, unread


def page_of(documents: Iterable[Mapping[str, Any]]) -> str:
    """The page of scenes, each as `scene_document` has it."""
    each = [(facts_of(document), pack(document)) for document in documents]
    facts, packed = ([one[k] for one in each] for k in (0, 1))
    return text("viewer.html.j2", shared=_shared(), facts=facts, packed=packed)


def pack(document: Mapping[str, Any]) -> str:
    """A document as a page holds it: JSON, zlib, base64."""
    content = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    return base64.b64encode(zlib.compress(content, 9)).decode()


def _shared() -> dict[str, Any]:
    """What all scenes of a page are shown with."""
    return {
        "faces": dict(figures.FACES), "map": dict(figures.MAP_COLORS), "highlight": figures.HIGHLIGHT,
        "series": {"blue": figures.BLUE, "green": figures.GREEN, "orange": figures.ORANGE},
        "metre": METRE, "radian": RADIAN, "none": NONE, "look_columns": LOOK_COLUMNS,
        "short": {policy.value: one.short for policy, one in BEHAVIOURS.items()},
        "label": {policy.value: one.label for policy, one in BEHAVIOURS.items()},
        "policy": {kind.value: behaviour_seen(kind).policy for kind in ManeuverKind},
        "reasons": {reason.value: reason.text for reason in Reason},
        "quantities": {one.value: [one.sentence, one.unit] for one in Quantity},
    }  # fmt: skip


def facts_of(document: Mapping[str, Any]) -> dict[str, Any]:
    """What the index of a page tells of a scene, and filters it by."""
    said, inserted = document["said"], sum(is_generated_id(track["id"]) for track in document["tracks"])
    maneuvers = [one for agent in said.get("agents", ()) for one in agent["maneuvers"]] + said.get("unmet", [])
    events, rejected = said.get("events", []), said.get("rejected", [])
    return {
        **{key: document[key] for key in ("id", "city", "split", "word")},
        "inserted": inserted,
        "recorded": len(document["tracks"]) - inserted,
        "seconds": round((document["steps"] - 1) * document["step_s"], 6),
        "findings": len(document["findings"]),
        "source": said.get("source_scenario_id", document["id"]),
        "asked": asked_for(said.get("requested", {}).get("agents"), len(events)),
        "behaviours": said.get("placed", {}).get("behaviours", {}),
        "reasons": sorted({one["reason"] for one in (*maneuvers, *events, *rejected) if one["reason"]}),
        "events": [[one["kind"], one["status"]] for one in events],
        "maneuvers": [[one["kind"], one["status"]] for one in maneuvers],
    }


def scene_document(recording: Recording, looks: bytes | None = None) -> dict[str, Any]:
    """All that a page holds of a scene. Errors: ScenarioError for a table of looks that is none.

    looks: the table of looks of a scene that is not written; else what lies beside it.
    """
    sidecar, beside = recording.sidecar, recording.folder / f"gaps_{recording.scenario_id}.csv.gz"
    said = {} if sidecar is None else sidecar.model_dump(mode="json", include=SAID)
    ids = {track.track_id for track in recording.tracks if is_generated_id(track.track_id)}
    word, states = word_for_recorded(recording.scenario_id), recording_states(recording)
    origin, found = _origin(recording.graph), findings_of(states, sidecar)
    return {
        "id": recording.scenario_id, "city": recording.city, "split": recording.split, "origin": origin.tolist(),
        "step_s": recording.step_s, "steps": recording.num_steps, "observed": recording.observed_steps,
        "word": word, "kinds": figures.kinds_in_words(word), "map": _map(recording.graph, origin),
        "tracks": _tracks(recording, states, origin), "occupied": _occupied(recording.graph, states),
        "said": said, "looks": _looks(beside, looks, ids),
        "findings": [
            [one.track_id, one.step, one.quantity.value, rounded(one.value), rounded(one.limit), one.other]
            for one in found
        ],
    }  # fmt: skip


def coded(values: npt.ArrayLike, *, quantum: float = 1.0, order: int = 1) -> list[int]:
    """Numbers (N,) as differences of that order of multiples of a quantum; what is not finite as NONE."""
    numbers = np.asarray(values, dtype=np.float64)
    whole = np.where(np.isfinite(numbers), np.rint(np.nan_to_num(numbers, posinf=0, neginf=0) / quantum), NONE)
    found = whole.astype(np.int64)
    for _ in range(order):
        found = np.diff(found, prepend=0)
    return list(found.tolist())


def _origin(graph: LaneGraph) -> FloatArray:
    """(2,) m, a round place south-west of a map, from which the page counts: small numbers."""
    points = [*graph.drivable_areas, *(lane.centerline for lane in graph.lanes.values())]
    low: FloatArray = np.min([line[:, :2].min(axis=0) for line in points], axis=0)
    return np.floor(low / 100) * 100


def _line(points: FloatArray, origin: FloatArray) -> list[list[int]]:
    """A polyline (N, 2) m, x and y apart."""
    return [coded(points[:, axis] - origin[axis], quantum=METRE) for axis in (0, 1)]


def _map(graph: LaneGraph, origin: FloatArray) -> dict[str, Any]:
    """Ground, crossings, and lanes with the number of their cells, which are cut of their sides."""
    grid = build_cell_grid(graph)

    def sides(lane: LaneSegment) -> list[list[list[int]]]:
        return [_line(line, origin) for line in (*lane.sides, lane.centerline)]

    return {
        "ground": [_line(ring, origin) for ring in graph.drivable_areas],
        "crossings": [_line(ring, origin) for ring in graph.pedestrian_crossings],
        "lanes": [
            [lane.lane_id, lane.lane_type, grid.count(lane.lane_id), *sides(lane)] for lane in graph.lanes.values()
        ],
    }


def _tracks(recording: Recording, states: AgentStates, origin: FloatArray) -> list[dict[str, Any]]:
    """Each agent with its states and what is derived of them: acceleration, lateral offset, leader and gap."""
    arrays, moved = states.arrays, motion(states.arrays)
    ahead = leaders(states)
    lane_ids = list(recording.graph.lanes)  # lanes by their place in the map, none for those that match none, -1
    lane_of = np.array([*(lane_ids.index(one) for one in states.lanes.lane_ids), np.nan])
    tracks, kinds = {track.track_id: track for track in recording.tracks}, figures.kinds_in(recording)
    found = []
    for row, track_id in enumerate(arrays.track_ids):
        track, span, alone = tracks[track_id], states.row_span(row), states.rows([row])
        step, position = arrays.step[span], arrays.position[span]
        breaks = np.flatnonzero(np.diff(step, prepend=step[0] - 2) != 1)
        found.append({
            "id": track_id, "type": track.object_type, "kind": kinds[track_id],
            "focal": track.category == FOCAL_CATEGORY, "inserted": is_generated_id(track_id),
            "size": [round(track.size.length_m, 2), round(track.size.width_m, 2)],
            "runs": [[int(step[a]), int(b - a)] for a, b in zip(breaks, [*breaks[1:], len(step)], strict=True)],
            "x": coded(position[:, 0] - origin[0], quantum=METRE, order=2),
            "y": coded(position[:, 1] - origin[1], quantum=METRE, order=2),
            "heading": coded(np.unwrap(arrays.heading[span]), quantum=RADIAN, order=2),
            "speed": coded(np.hypot(*arrays.velocity[span].T), quantum=METRE),
            **({} if not arrays.vehicle[row] else {
                "accel": coded(moved.accel_mps2[span], quantum=METRE),
                "offset": coded(first_lane_offset(alone), quantum=METRE),
                "gap": coded(ahead.gap_m[span], quantum=METRE),
                "leader": coded(ahead.agent[span]),
                "lane": coded(lane_of[states.matches.lane[span]]),
            }),
        })  # fmt: skip
    return found


def _occupied(graph: LaneGraph, states: AgentStates) -> list[list[int]]:
    """Which cells boxes cover, as columns: cell (in the grid's order), agent, first step, number of steps."""
    boxes = cell_boxes(build_cell_grid(graph))
    rows: list[npt.NDArray[np.int64]] = [np.zeros((0, 4), dtype=np.int64)]
    for agent in range(states.arrays.num_agents):
        sigma = original_occupancy(boxes, states.traffic.rows([agent])).sigma.astype(np.int8)
        edges = np.diff(sigma, axis=0, prepend=np.int8(0), append=np.int8(0)).T
        (cell, first), (_, last) = np.nonzero(edges == 1), np.nonzero(edges == -1)
        rows.append(np.column_stack([cell, np.full(len(cell), agent), first, last - first]))
    every = np.concatenate(rows)
    every = every[np.lexsort(every.T[::-1])]
    return [coded(column) for column in every.T]


def _looks(path: Path, table: bytes | None, exported: Collection[str]) -> dict[str, list[list[Any]]]:
    """Each look at a gap of the exported vehicles, by LOOK_COLUMNS, of a table, else of that at a path, or none."""
    found: dict[str, list[list[Any]]] = {}
    if table is None and not path.is_file():
        return found
    try:
        content = read_packed(path, most_mb=MAX_FILE_MB) if table is None else table
        rows = [row for row in csv.DictReader(io.StringIO(content.decode())) if row["track_id"] in exported]
        names = {row["vehicle"]: row["track_id"] for row in rows}
        for row in rows:  # ids in the simulation become those of exported tracks
            told = ((column, names.get(row[column], row[column]) or None) for column in LOOK_COLUMNS)
            found.setdefault(row["track_id"], []).append(
                [rounded(float(value)) if column in _NUMBERS and value else value for column, value in told]
            )
    except (OSError, ValueError, KeyError, TypeError, csv.Error) as error:
        raise ScenarioError(
            f"{path}: {one_line(str(error), most=200)}; expected the table of hid2 generate --record gaps, or no such "
            "file"
        ) from error
    return found
