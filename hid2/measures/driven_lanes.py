"""The lanes that a vehicle drives, as runs and as polylines: what manoeuvres are measured against."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hid2.agents import FloatArray
from hid2.measures.arrays import SceneArrays
from hid2.measures.lane_matching import GOES_ON, FlatLanes, Matches
from netconvert.geometry import Polyline

# What a manoeuvre is, to method and evaluation, whatever the configuration: no tunables.
_PATH_AHEAD_M = 150.0  # length of lane paths beyond the lane of a change, m
STRETCH_M = 10.0  # length of the stretches of a lane on which vehicles are compared with each other, m
_SHORT_OFF_S = 1.0  # longest time off every lane that does not end a run on a lane, s


class LaneRun(NamedTuple):
    """Rows first to last (inclusive) of one vehicle on one lane."""

    lane: int
    first: int
    last: int


@dataclass(frozen=True, eq=False, slots=True)
class LaneView:
    """Agents row by row, the lanes of their map, and the lane of each row: everything that detectors read."""

    arrays: SceneArrays
    lanes: FlatLanes
    matches: Matches


def first_lane_offset(view: LaneView) -> FloatArray:
    """(N,) m, left positive, of the only vehicle from the path of the lane that it starts in; NaN where there is none.

    The path is kept beside the vehicle through lane changes, so that each shows as one smooth step; no offset is told
    off every lane and beyond the path's ends.
    """
    runs, link = [run for run in runs_of(view, 0) if run.lane >= 0], view.lanes.link
    if not runs:
        return np.full(len(view.arrays.step), np.nan)
    change = next((k for k, (a, b) in enumerate(pairwise(runs), 1) if link[a.lane, b.lane] != GOES_ON), len(runs))
    path = source_path(view, runs, change)[0]
    s, d = path.frenet(view.arrays.position)
    return np.where((s > -1.0) & (s < path.length_m + 1.0), d, np.nan)


def recorded_places(view: LaneView, *, within_m: float) -> dict[int, FloatArray]:
    """Where recorded vehicles drive on lanes: by lane id d m of each `STRETCH_M`, left positive, NaN where none does.

    The median over vehicles of the median of each. within_m: a vehicle farther from the middle changes lanes.
    """
    arrays, matches, found = view.arrays, view.matches, dict[int, FloatArray]()
    usual = (arrays.clean & ~arrays.generated)[arrays.agent]
    rows = np.flatnonzero(usual & (matches.lane >= 0) & (np.abs(matches.d) < within_m))
    if not rows.size:
        return found
    key = np.column_stack([matches.lane[rows], matches.s[rows] // STRETCH_M, arrays.agent[rows]]).astype(np.int64)
    each, of_each = np.unique(key, axis=0, return_inverse=True)
    order = np.argsort(of_each.ravel(), kind="stable")
    places = np.split(matches.d[rows][order], np.flatnonzero(np.diff(of_each.ravel()[order])) + 1)
    median = np.array([np.median(one) for one in places])
    for lane, stretch in np.unique(each[:, :2], axis=0).tolist():
        lane_id, count = int(view.lanes.lane_ids[lane]), int(view.lanes.length_m[lane] // STRETCH_M) + 1
        at = found.setdefault(lane_id, np.full(count, np.nan))
        at[min(stretch, count - 1)] = np.median(median[(each[:, 0] == lane) & (each[:, 1] == stretch)])
    return found


def runs_of(view: LaneView, agent: int) -> list[LaneRun]:
    """Lanes in the order driven; short times off every lane are bridged, longer ones are runs of lane -1."""
    start, stop = int(view.arrays.first[agent]), int(view.arrays.first[agent + 1])
    lane = view.matches.lane[start:stop]
    edges = [0, *(np.flatnonzero(np.diff(lane)) + 1).tolist(), len(lane)]
    runs = [LaneRun(int(lane[a]), start + a, start + b - 1) for a, b in pairwise(edges)]
    short = round(_SHORT_OFF_S / view.arrays.step_s)
    return [run for run in runs if run.lane >= 0 or run.last - run.first + 1 > short]


def source_path(view: LaneView, runs: list[LaneRun], k: int) -> tuple[Polyline, tuple[int, ...]]:
    """The lane path that the vehicle leaves: its lanes so far, then those beside the lanes that it drives later."""
    chain = _chain_back(view, runs, k - 1)
    return _path(view, chain, {n for run in runs[k:] if run.lane >= 0 for n in _beside(view.lanes, run.lane)})


def target_path(view: LaneView, runs: list[LaneRun], k: int) -> tuple[Polyline, tuple[int, ...]]:
    """The lane path that the vehicle joins: the lane and those that it drives later, begun beside its lanes so far."""
    chain = [runs[k].lane]
    beside = {n for run in runs[:k] if run.lane >= 0 for n in _beside(view.lanes, run.lane)}
    while len(chain) < 20:
        before = [n for n in beside if chain[0] in view.lanes.successors[n] and n not in chain]
        if not before:
            break
        chain.insert(0, min(before))
    return _path(view, chain, {run.lane for run in runs[k:]})


def path_driven(view: LaneView, runs: list[LaneRun], k: int) -> tuple[Polyline, tuple[int, ...]]:
    """The lane path of run k as the vehicle has it then: lanes so far, then its own until it changes, then ahead."""
    own: set[int] = set()
    for before, after in pairwise(runs[k:]):
        if after.lane < 0 or view.lanes.link[before.lane, after.lane] != GOES_ON:
            break
        own.add(after.lane)
    return _path(view, _chain_back(view, runs, k), own)


def run_at(runs: list[LaneRun], row: int) -> int | None:
    """Which run along a lane holds a row; None off every lane."""
    return next((k for k, run in enumerate(runs) if run.first <= row <= run.last and run.lane >= 0), None)


def points_ahead(lanes: FlatLanes, lane: int, s: float, d: float, ahead_m: float, *, beyond_m: float) -> FloatArray:
    """(M, 2) m along a lane and its straightest successors, d to the left: from beyond_m to ahead_m behind s."""
    if lane < 0:
        return np.zeros((0, 2))
    chain, length = [lane], float(lanes.length_m[lane]) - s
    while length < ahead_m and (following := int(lanes.straight[chain[-1]])) >= 0 and following not in chain:
        chain.append(following)
        length += float(lanes.length_m[following])
    if length <= beyond_m:
        return np.zeros((0, 2))
    along = Polyline(np.concatenate([lanes.lane_points(one) for one in chain]))
    return along.xy(np.arange(s + beyond_m, s + min(length, ahead_m), beyond_m), d)


def _chain_back(view: LaneView, runs: list[LaneRun], k: int) -> list[int]:
    chain = [runs[k].lane]
    for run in reversed(runs[:k]):
        if run.lane < 0 or chain[0] not in view.lanes.successors[run.lane]:
            break
        chain.insert(0, run.lane)
    return chain


def _beside(lanes: FlatLanes, lane: int) -> list[int]:
    return [int(n) for n in (lanes.left[lane], lanes.right[lane]) if n >= 0]


def _path(view: LaneView, chain: list[int], preferred: set[int]) -> tuple[Polyline, tuple[int, ...]]:
    """The polyline of `chain`, extended over preferred successors, else the straightest, by _PATH_AHEAD_M."""
    lanes, ahead = list(chain), 0.0
    while ahead < _PATH_AHEAD_M and len(lanes) < 100:
        wanted = [n for n in view.lanes.successors[lanes[-1]] if n in preferred]
        following = wanted[0] if wanted else int(view.lanes.straight[lanes[-1]])
        if following < 0 or following in lanes:
            break
        lanes.append(following)
        ahead += float(view.lanes.length_m[following])
    return line_of(view.lanes, lanes), tuple(lanes)


def line_of(lanes: FlatLanes, path: Sequence[int], side: int = 0) -> Polyline:
    """The middle of lanes in a row, or their border on a side: +1 left, -1 right."""
    sides = (lanes.graph.lanes[int(lanes.lane_ids[one])].sides for one in path)
    parts = [ground[side < 0] for ground in sides] if side else [lanes.lane_points(one) for one in path]
    points = np.concatenate(parts)
    return Polyline(points[np.append(True, np.hypot(*np.diff(points, axis=0).T) > 1e-6)])
