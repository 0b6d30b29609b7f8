"""Red and green inferred from recorded traffic: signals are not in the data, traffic is.

An entrance of an intersection is red while recorded vehicles cross the ground behind it, and while its own recorded
queue stands. Recorded vehicles that enter tell that it is green.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hid2.kernels.approaches import crossing_steps, red_steps, vehicle_states, watch_approach
from hid2.measures.arrays import MOVING_EXTENT_M
from hid2.measures.encounters import CROSSING_RAD
from hid2.occupancy.shown import STANDING_MPS
from hid2.occupancy.sigma import AGREES_RAD, UNDER_SHARE
from hid2.occupancy.traffic import BoolArray, Traffic
from hid2.params import Signals
from netconvert.cells import CellGrid
from netconvert.lane_graph import SIDES, LaneGraph, TurnType

# No tunables, here and below: what recorded traffic tells of a phase. A queue that stands so near to the entrance
# makes it red, m, with centres up to so far beyond it, and so far beside a lane's edge; a vehicle that enters follows
# the lane nearest on average, and any farther by at most the last.
_QUEUE_M, _BEYOND_M, _BESIDE_M, _ALIKE_M = 20.0, 3.0, 0.5, 0.3
_FLOW_MPS = 1.0  # faster recorded vehicles are cross traffic, m/s
#: Green so long before and after a recorded vehicle enters, s, but not this close to cross traffic (critical PET).
_ENTRY_BEFORE_S, _ENTRY_AFTER_S, _CROSSING_S = 1.0, 2.0, 1.0
#: Recorded object types that obey signals.
SIGNALLED_TYPES = frozenset({"vehicle", "bus", "motorcyclist", "cyclist"})


@dataclass(frozen=True, slots=True)
class _Approach:
    """An approach of an intersection: its lanes side by side, and the lanes of the intersection that begin there."""

    lanes: tuple[int, ...]
    fan: tuple[int, ...]


class _Watched(NamedTuple):
    """An approach over the scene: (A,) whether a vehicle comes from there; by lane, (T,) entries and waiting vehicles.

    queues: waiting vehicles on an approach lane and on what lies behind it.
    """

    comes_from: BoolArray
    enters: dict[int, BoolArray]
    waits_inside: dict[int, BoolArray]
    queues: dict[int, BoolArray]


@dataclass(slots=True)
class InferredSignals:
    """Red and green of the entrances of a scene, worked out for each lane when it is first asked for.

    Only lanes of an intersection that are entered from a lane outside of it have an entrance. traffic: the recorded
    agents of SIGNALLED_TYPES alone; step_s: seconds from one step to the next.
    """

    grid: CellGrid
    traffic: Traffic
    params: Signals
    step_s: float
    _states: tuple[npt.NDArray[Any], ...] = field(init=False, repr=False)
    _approaches: dict[int, _Approach | None] = field(init=False, default_factory=dict, repr=False)
    _watched: dict[_Approach, _Watched] = field(init=False, default_factory=dict, repr=False)
    _red: dict[int, BoolArray | None] = field(init=False, default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        traffic = self.traffic
        self._states = vehicle_states(
            traffic.position, traffic.velocity, traffic.heading, traffic.present,
            _FLOW_MPS, STANDING_MPS, MOVING_EXTENT_M,
        )  # fmt: skip

    def red(self, lane_id: int) -> BoolArray | None:
        """(T,) whether a vehicle that approaches the lane at a step has to stop at its entrance.

        None for a lane without an entrance: outside of intersections, or entered from within one or from nowhere.
        """
        if lane_id not in self._red:
            approach = self._approach(lane_id)
            self._red[lane_id] = None if approach is None else self._infer(lane_id, approach)
        return self._red[lane_id]

    def enters(self, lane_id: int) -> BoolArray | None:
        """(T,) whether a recorded vehicle's centre passes the lane's entrance at a step; None as in `red`."""
        approach = self._approach(lane_id)
        return None if approach is None else self._watch(approach).enters[lane_id]

    def _infer(self, lane_id: int, approach: _Approach) -> BoolArray:
        """Lanes of one approach that turn alike share a signal.

        An entry into one of them makes all green; a queue makes red what it stands before, and the lanes beside if it
        can go nowhere else.
        """
        graph, params, watched = self.grid.graph, self.params, self._watch(approach)
        turn = graph.lanes[lane_id].turn
        alike = [one for one in approach.fan if graph.lanes[one].turn is turn]
        entered = np.logical_or.reduce([watched.enters[one] for one in alike])
        queued = watched.waits_inside[lane_id].copy()
        for lane in approach.lanes:
            if lane_id in graph.successors(lane) or _leads_only(graph, lane, turn, approach.fan):
                queued |= watched.queues[lane]
        spans = params.before_s, params.after_s, _ENTRY_BEFORE_S, _ENTRY_AFTER_S, _CROSSING_S
        crossed = self._crossed(lane_id, ~watched.comes_from)
        return red_steps(crossed, entered, queued, *(round(span / self.step_s) for span in spans))

    def _crossed(self, lane_id: int, others: BoolArray) -> BoolArray:
        """(T,) whether a recorded vehicle that comes from another approach crosses the lane's ground."""
        through = _through(self.grid.graph, lane_id)
        borders = [self.grid.borders(one) for one in through]
        # Where one lane ends and the next begins lies a cell of no length.
        counts = [len(one) for one in borders]
        width_m = np.repeat([self.grid.graph.lanes[one].width_m for one in through], counts)[:-1]
        pose, way, _, flows, bounds, _ = self._states
        traffic = self.traffic
        line = np.ascontiguousarray(borders[0] if len(borders) == 1 else np.concatenate(borders))
        return crossing_steps(
            line, UNDER_SHARE * width_m / 2,
            math.cos(CROSSING_RAD), pose, way, flows, others,
            traffic.length_m / 2, traffic.width_m / 2, bounds,
        )  # fmt: skip

    def _watch(self, approach: _Approach) -> _Watched:
        if approach not in self._watched:
            self._watched[approach] = self._look(approach)
        return self._watched[approach]

    def _look(self, approach: _Approach) -> _Watched:
        graph = self.grid.graph
        before = [found for lane in approach.lanes for found in _upstream(graph, lane, _QUEUE_M)]
        lanes = [graph.lanes[lane] for _, lane, _ in before] + [graph.lanes[lane] for lane in approach.fan]
        first = np.cumsum([0, *(len(lane.path.points) for lane in lanes)])
        pose, _, state, _, bounds, moves = self._states
        rule = _BESIDE_M, math.cos(AGREES_RAD), _QUEUE_M, _BEYOND_M, _ALIKE_M
        comes_from, enters, waits = watch_approach(
            np.concatenate([lane.path.points for lane in lanes]), np.concatenate([lane.path.s for lane in lanes]),
            first, np.array([lane.width_m / 2 for lane in lanes]), np.array([ahead_m for _, _, ahead_m in before]),
            len(approach.fan), pose, state, bounds, moves, rule,
        )  # fmt: skip
        queues = {lane: np.zeros(self.traffic.num_steps, dtype=np.bool_) for lane in approach.lanes}
        for (lane, _, _), waiting in zip(before, waits[: len(before)], strict=True):
            queues[lane] |= waiting
        return _Watched(
            comes_from=comes_from,
            enters=dict(zip(approach.fan, enters[len(before) :], strict=True)),
            waits_inside=dict(zip(approach.fan, waits[len(before) :], strict=True)),
            queues=queues,
        )

    def _approach(self, lane_id: int) -> _Approach | None:
        if lane_id not in self._approaches:
            self._approaches[lane_id] = _approach_of(self.grid.graph, lane_id)
        return self._approaches[lane_id]


def _approach_of(graph: LaneGraph, lane_id: int) -> _Approach | None:
    if not graph.lanes[lane_id].is_intersection:
        return None
    lanes = {before for before in graph.predecessors(lane_id) if not graph.lanes[before].is_intersection}
    for before in tuple(lanes):
        for side in SIDES:
            beside = graph.neighbor(before, side)
            while beside is not None and not graph.lanes[beside].is_intersection:
                lanes.add(beside)
                beside = graph.neighbor(beside, side)
    fan = {onward for lane in lanes for onward in graph.successors(lane) if graph.lanes[onward].is_intersection}
    return _Approach(tuple(sorted(lanes)), tuple(sorted(fan))) if lanes else None


def _leads_only(graph: LaneGraph, lane_id: int, turn: TurnType, fan: Sequence[int]) -> bool:
    onward = graph.successors(lane_id)
    return bool(onward) and all(one in fan and graph.lanes[one].turn is turn for one in onward)


def _upstream(graph: LaneGraph, lane_id: int, reach_m: float) -> list[tuple[int, int, float]]:
    """(lane_id, lane, metres from that lane's end to the entrance): the lane, and those behind it within reach_m."""
    found, stack = [], [(lane_id, 0.0)]
    while stack:
        lane, ahead_m = stack.pop()
        found.append((lane_id, lane, ahead_m))
        ahead_m += graph.lanes[lane].length_m
        if ahead_m < reach_m:
            stack.extend((one, ahead_m) for one in graph.predecessors(lane) if not graph.lanes[one].is_intersection)
    return found


def _through(graph: LaneGraph, lane_id: int) -> list[int]:
    """The lane, and the lanes of the intersection that lead straight on where it is cut into several."""
    found = [lane_id]
    while (onward := graph.straightest_successor(found[-1])) is not None:
        if onward in found or not graph.lanes[onward].is_intersection:
            break
        found.append(onward)
    return found
