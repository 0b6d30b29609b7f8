"""Manoeuvres from positions and the map alone, by the definitions that hid2.evaluation has too; no code is shared.

Slow and plain on purpose: one vehicle, one step and one lane at a time.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
import numpy.typing as npt

from hid2.agents import Track
from netconvert.geometry import Polyline
from netconvert.lane_graph import LaneGraph, TurnType

Floats = npt.NDArray[np.float64]

DT_S = 0.1
STAY_STEPS = 5
HALF_LANE_M = 1.75
TURN_RAD = math.radians(30.0)


@dataclass(frozen=True, slots=True)
class Crossing:
    """From one lane path to the next: step of the crossing, side (+1 left), the lane path that was left."""

    step: int
    side: int
    left_behind: Polyline


def seen(graph: LaneGraph, track: Track, others: Sequence[Track]) -> set[str]:
    """Kinds of the manoeuvres that a vehicle makes: lane_change, left_turn, right_turn, overtake."""
    lanes = lanes_driven(graph, track)
    crossings = _crossings(graph, track, lanes)
    kinds = {"lane_change"} if crossings else set()
    for kind in (TurnType.LEFT, TurnType.RIGHT):
        if _turns(graph, track, lanes, kind):
            kinds.add(kind.value)
    for first, second in pairwise(crossings):
        if first.side == -second.side and any(_passed(track, other, first, second) for other in others):
            kinds.add("overtake")
    return kinds


def lanes_driven(graph: LaneGraph, track: Track) -> list[int]:
    """Lane segment under the centre at each step; the one before it or what follows from that one where possible.

    -1 where the centre is on no lane that goes its way.
    """
    on: dict[int, tuple[Floats, npt.NDArray[np.bool_]]] = {}
    for lane in graph.lanes.values():
        if lane.lane_type not in ("VEHICLE", "BUS"):
            continue
        near = lane.centerline
        if np.abs(near[:, None] - track.position[None, ::10]).max(axis=2).min() > 40.0 + lane.length_m:
            continue
        s, d = lane.path.frenet(track.position)
        turn = np.cos(lane.path.heading(np.clip(s, 0.0, lane.length_m)) - track.heading)
        there = (s >= 0.0) & (s <= lane.length_m) & (np.abs(d) <= lane.width_m / 2 + 0.3) & (turn > 0.5)
        if there.any():
            on[lane.lane_id] = (np.abs(d), there)
    driven: list[int] = []
    for step in range(len(track.timesteps)):
        here = [lane_id for lane_id, (_, there) in on.items() if there[step]]
        last = driven[-1] if driven else -1

        def cost(lane_id: int, step: int = step, last: int = last) -> float:
            kept = last in (-1, lane_id) or lane_id in graph.successors(last)
            return float(on[lane_id][0][step]) + (0.0 if kept else 0.3)

        driven.append(min(here, key=cost) if here else -1)
    return driven


def _crossings(graph: LaneGraph, track: Track, lanes: list[int]) -> list[Crossing]:
    """Where the centre goes over to a neighbour lane, was 0.5 s on one side before and is 0.5 s on the other after."""
    found = []
    for step in range(STAY_STEPS, len(lanes) - STAY_STEPS):
        before, after = lanes[step - 1], lanes[step]
        if -1 in (before, after) or before == after:
            continue
        sides = [side for side in (1, -1) if after in _beside(graph, before, side)]
        if not sides:
            continue
        path = _lane_path(graph, before)
        _, d = path.frenet(track.position)
        toward = d * sides[0]
        start, end = toward[max(0, step - 40) : step].min(), toward[step : step + 40].max()
        stays = (toward[step - STAY_STEPS : step] < HALF_LANE_M + 0.3).all() and (
            toward[step : step + STAY_STEPS] > HALF_LANE_M - 0.6
        ).all()
        if stays and end - start >= HALF_LANE_M:
            found.append(Crossing(step, sides[0], path))
    return found


def _beside(graph: LaneGraph, lane_id: int, side: int) -> set[int]:
    """Neighbours on a side, of the lane or of what follows from it, and what follows from the neighbour."""
    name: Literal["left", "right"] = "left" if side > 0 else "right"
    beside = {graph.neighbor(lane, name) for lane in (lane_id, *graph.successors(lane_id))}
    direct = graph.neighbor(lane_id, name)
    onward = graph.successors(direct) if direct is not None else ()
    return {lane for lane in (*beside, *onward) if lane is not None} - {lane_id, *graph.successors(lane_id)}


def _lane_path(graph: LaneGraph, lane_id: int) -> Polyline:
    """A lane with those that lead straightest to it and on from it, 150 m or so each way."""
    points, length, first = [graph.lanes[lane_id].centerline], 0.0, lane_id
    while graph.predecessors(first) and length < 150.0:
        first = min(graph.predecessors(first), key=lambda n: _bend(graph, n, first))
        points.insert(0, graph.lanes[first].centerline[:-1])
        length += graph.lanes[first].length_m
    last, length = lane_id, 0.0
    while graph.successors(last) and length < 150.0:
        last = min(graph.successors(last), key=lambda n: _bend(graph, last, n))
        points.append(graph.lanes[last].centerline[1:])
        length += graph.lanes[last].length_m
    return Polyline(np.concatenate(points))


def _bend(graph: LaneGraph, one: int, other: int) -> float:
    a, b = (graph.lanes[n].centerline[-1] - graph.lanes[n].centerline[0] for n in (one, other))
    return abs(math.remainder(math.atan2(b[1], b[0]) - math.atan2(a[1], a[0]), math.tau))


def _turns(graph: LaneGraph, track: Track, lanes: list[int], kind: TurnType) -> bool:
    """On lanes that turn this way, and its own heading does so from 1 s before to 1 s after them."""
    sign = 1.0 if kind is TurnType.LEFT else -1.0
    heading = np.unwrap(track.heading)
    step = 0
    while step < len(lanes):
        if lanes[step] == -1 or graph.lanes[lanes[step]].turn is not kind:
            step += 1
            continue
        end = step
        while end + 1 < len(lanes) and lanes[end + 1] != -1 and graph.lanes[lanes[end + 1]].turn is kind:
            end += 1
        if sign * (heading[min(end + 10, len(lanes) - 1)] - heading[max(step - 10, 0)]) >= TURN_RAD:
            return True
        step = end + 1
    return False


def _passed(track: Track, other: Track, out: Crossing, back: Crossing) -> bool:
    """Ahead on the lane path that was left before the first crossing, behind on it at the second, moving meanwhile."""
    steps, own, theirs = np.intersect1d(track.timesteps, other.timesteps, return_indices=True)
    if steps.size == 0 or other.track_id == track.track_id:
        return False
    s_own, _ = out.left_behind.frenet(track.position[own])
    s_other, d_other = out.left_behind.frenet(other.position[theirs])
    on_path = np.abs(d_other) <= HALF_LANE_M
    half = 0.5 * (track.size.length_m + other.size.length_m)
    before = on_path & (own <= out.step) & (s_other - s_own > half)
    after = on_path & (own <= back.step) & (own > out.step) & (s_own - s_other > half)
    moves = np.hypot(*np.ptp(other.position[theirs], axis=0)) > 5.0
    return bool(before.any() and after.any() and moves)
