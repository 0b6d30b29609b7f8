"""Red and green inferred from recorded traffic: signals are not in the data, traffic is.

An entrance of an intersection is red while recorded vehicles cross the ground behind it or start at the side to do so,
while its own recorded queue stands, and, straight on, while that of the opposite approach does. Recorded vehicles that
enter tell that it is green.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hid2.agents import FloatArray, IntArray
from hid2.kernels.gaps import STANDING_MPS
from hid2.measures.encounters import CROSSING_RAD
from hid2.motion.route import line_along, route_points
from hid2.occupancy.agent_states import AgentStates, parked
from hid2.occupancy.along_path import look_along
from hid2.occupancy.traffic import BoolArray, Traffic
from hid2.once import once
from hid2.params import Limits, Signals
from netconvert.lane_graph import LaneGraph, TurnType

#: Largest distance before an entrance of a standing queue that makes it red, and of centres beyond the entrance, m.
#: No tunables: what recorded traffic tells of a phase.
_QUEUE_M, _BEYOND_M = 20.0, 3.0
_UNDER_SHARE = 0.8  # share of a lane's width that traffic crosses; no tunable: what only grazes it does not cross it
_FLOW_MPS = 1.0  # speed above which recorded vehicles are cross traffic; no tunable
#: Green time before and after a recorded entry, s, and time before and after cross traffic at which the entrance is red
#: even so, s (the critical PET). No tunables: what recorded traffic tells of a phase.
_ENTRY_BEFORE_S, _ENTRY_AFTER_S, _CROSSING_S = 1.0, 2.0, 1.0
_STARTS_M = 30.0  # largest distance of cross traffic from where it has stood; no tunable: as wide as intersections are
#: Time for which a vehicle that comes to stand at an entrance has braked for the red, s. No tunable: as those above.
_BRAKES_S = 2.0
#: Time after green in which a vehicle that can no longer stop may pass (amber), about, s. No tunable.
AMBER_S = 1.5
#: Largest distance of an opposite approach to where a lane of the intersection ends, m, and largest cosine of the angle
#: between the two. No tunables.
_OPPOSITE_M, _OPPOSITE = 25.0, -0.94


@dataclass(frozen=True, slots=True)
class _Approach:
    """An approach of an intersection: its lanes side by side, and the lanes of the intersection that begin there."""

    lanes: tuple[int, ...]
    fan: tuple[int, ...]


class _Watched(NamedTuple):
    """An approach over the scene: (A,) whether a vehicle comes from there; by lane, (T,) entries and waiting ones."""

    comes_from: BoolArray
    enters: dict[int, BoolArray]
    waits: dict[int, BoolArray]


@dataclass(frozen=True, eq=False)
class InferredSignals:
    """Red and green of the entrances of a scene: of lanes of an intersection that are entered from outside of it.

    states: the recorded agents, of which those of ROAD_TYPES count.
    """

    graph: LaneGraph
    states: AgentStates
    params: Signals

    @cached_property
    def _flowing(self) -> tuple[IntArray, Traffic]:
        """Rows of the agents that are cross traffic where they cross at some step, and these alone."""
        rows = np.flatnonzero(self.states.arrays.moving_on_roads & (self.states.traffic.speed > _FLOW_MPS).any(axis=1))
        return rows, self.states.traffic.rows(rows.tolist())

    @cached_property
    def _waits(self) -> IntArray:
        """Rows that stand as in a queue."""
        arrays = self.states.arrays
        stands = self.states.traffic.speed[arrays.agent, arrays.step] < STANDING_MPS
        return np.flatnonzero(stands & (self.states.matches.lane >= 0) & ~parked(self.states)[arrays.agent])

    @once
    def red(self, lane_id: int) -> BoolArray | None:
        """(T,) whether a vehicle that approaches the lane at a step has to stop at its entrance.

        None for a lane without an entrance: outside of intersections, or entered from within one or from nowhere.
        Straight on also while the opposite queue stands, as both have the same phase: none of the 93 recorded vehicles
        that drive straight on in fourteen scenes enters then.
        """
        approach = self._approach(lane_id)
        if approach is None:
            return None
        watched, (entered, queued) = self._watch(approach), self._seen(lane_id, approach)
        if (opposite := self._opposite(lane_id)) is not None:
            go, stand = self._seen(*opposite)
            queued |= stand & ~self._spread(go, _ENTRY_BEFORE_S, _ENTRY_AFTER_S)
        return self._reds(*self._crossed(lane_id, ~watched.comes_from), entered, queued)

    def shown(self, lane_id: int) -> NDArray[np.str_] | None:
        """(T,) SUMO's letter of `red`, which is yellow at first, also where the scene as a program begins again."""
        if (red := self.red(lane_id)) is None:
            return None
        after_green = self._spread(np.tile(~red, 2), 0.0, AMBER_S)[red.size :]
        return np.where(red, np.where(after_green, "y", "r"), "g")

    def _seen(self, lane_id: int, approach: _Approach) -> tuple[BoolArray, BoolArray]:
        """(T,) whether recorded vehicles enter, and whether they wait to; lanes that turn alike share a signal.

        A queue makes red what it stands before, and the lanes beside if it can go nowhere else.
        """
        graph, watched = self.graph, self._watch(approach)
        turn = graph.lanes[lane_id].turn
        alike = [one for one in approach.fan if graph.lanes[one].turn is turn]
        entered = np.logical_or.reduce([watched.enters[one] for one in alike])
        queued = watched.waits[lane_id].copy()
        for lane in approach.lanes:
            onward = graph.successors(lane)
            alone = all(one in approach.fan and graph.lanes[one].turn is turn for one in onward)
            if lane_id in onward or (onward and alone):
                queued |= watched.waits[lane]
        return entered, self._spread(queued, _BRAKES_S, 0.0)

    def _opposite(self, lane_id: int) -> tuple[int, _Approach] | None:
        """The lane straight on from the opposite approach, with that; None where there is none, or the lane turns."""
        lanes = self.graph.lanes
        if lanes[lane_id].turn is not TurnType.STRAIGHT:
            return None
        out, forward = lanes[_through(self.graph, lane_id)[-1]].centerline[-1], _forward(lanes[lane_id].centerline)
        for other, one in lanes.items():
            if (
                one.is_intersection
                and one.turn is TurnType.STRAIGHT
                and math.dist(one.centerline[0], out) < _OPPOSITE_M
            ):
                found = self._approach(other)
                if found is not None and _forward(one.centerline) @ forward < _OPPOSITE:
                    return other, found
        return None

    def _spread(self, at: BoolArray, before_s: float, after_s: float) -> BoolArray:
        """(T,) steps from before_s before to after_s after those that are true (T,)."""
        before, after = (round(span_s / self.states.arrays.step_s) for span_s in (before_s, after_s))
        found = np.zeros_like(at)
        for step in np.flatnonzero(at).tolist():
            found[max(0, step - before) : step + after + 1] = True
        return found

    def _reds(self, crossed: BoolArray, aside: BoolArray, entered: BoolArray, queued: BoolArray) -> BoolArray:
        """(T,) red: `crossed` (T,) spread over steps before and after it, or `queued` (T,); not near an entry.

        Before `aside` (T,) is amber, too. An entry takes away the red of a queue, and that of cross traffic that is
        more than _CROSSING_S away; that of cross traffic to come only up to itself, as the light has turned since.
        """
        before_s, flow = self.params.before_s, self._spread(crossed, 0.0, self.params.after_s)
        amber = (before_s > 0.0) & self._spread(aside, before_s + AMBER_S, 0.0)  # 0 in events that meet what crosses
        to_come, close = self._spread(crossed, before_s, 0.0) | amber, self._spread(crossed, _CROSSING_S, _CROSSING_S)
        entering, green = (self._spread(entered, _ENTRY_BEFORE_S, after_s) for after_s in (0.0, _ENTRY_AFTER_S))
        return close | ((flow | queued) & ~green) | (to_come & ~entering)

    def _crossed(self, lane_id: int, others: BoolArray) -> tuple[BoolArray, BoolArray]:
        """(T,) when recorded vehicles from other approaches cross the lane's ground; when those from the side begin to.

        The latter since they last stood, as their light has turned then: an opposite one may have waited for a gap.
        """
        (rows, flowing), width_m = self._flowing, _UNDER_SHARE * self.graph.lanes[lane_id].width_m
        line = line_along(route_points(self.graph, tuple(_through(self.graph, lane_id))), Limits())
        seen, ahead = look_along(line, flowing, 0.0, width_m), _forward(self.graph.lanes[lane_id].centerline)
        speed = flowing.speed[seen.agents]
        across = (np.abs(seen.along) <= math.cos(CROSSING_RAD) * speed) & (speed > _FLOW_MPS)
        across &= others[rows[seen.agents], None] & (seen.low < line.length_m)
        aside = np.zeros(across.shape[1], dtype=np.bool_)
        for row in np.flatnonzero(across.any(axis=1)).tolist():
            agent, at = int(seen.agents[row]), int(across[row].argmax())
            apart_m = np.hypot(*(flowing.position[agent, : at + 1] - flowing.position[agent, at]).T)
            came = np.flatnonzero(flowing.present[agent, : at + 1] & (apart_m < _STARTS_M))
            stood = came[speed[row, came] < STANDING_MPS]
            heading = flowing.heading[agent, stood[-1] if stood.size else came[0]]
            if ahead @ (math.cos(heading), math.sin(heading)) > -math.cos(CROSSING_RAD):
                aside[stood[-1] + 1 if stood.size else at : at + 1] = True
        return np.asarray(across.any(axis=0)), aside

    @once
    def _watch(self, approach: _Approach) -> _Watched:
        arrays, matches, lanes = self.states.arrays, self.states.matches, self.states.lanes
        steps, length_m = arrays.num_steps, lanes.length_m
        comes_from = np.zeros(arrays.num_agents, dtype=np.bool_)
        every = (*approach.lanes, *approach.fan)
        enters, waits = ({lane: np.zeros(steps, dtype=np.bool_) for lane in every} for _ in range(2))
        number = {lane: lanes.index_of[lane] for lane in every if lane in lanes.index_of}
        before = np.isin(matches.lane, [number[lane] for lane in approach.lanes if lane in number])
        inside = np.isin(matches.lane, [number[lane] for lane in approach.fan if lane in number])
        for agent in np.unique(arrays.agent[before | inside]).tolist():
            own = self.states.row_span(agent)
            within = own.start + np.flatnonzero(inside[own])
            if before[own].any():
                comes_from[agent] = True
                within = within[within > own.start + np.argmax(before[own])]
                if within.size:
                    enters[int(lanes.lane_ids[matches.lane[within[0]]])][arrays.step[within[0]]] = True
            else:
                comes_from[agent] = bool((matches.s[within] < length_m[matches.lane[within]] / 3).any())
        lane, s, step = matches.lane[self._waits], matches.s[self._waits], arrays.step[self._waits]
        for one in approach.fan:
            waits[one][step[(lane == number.get(one, -1)) & (s < _BEYOND_M)]] = True
        for one in approach.lanes:
            for behind, ahead_m in _upstream(self.graph, one, _QUEUE_M):
                row = lanes.index_of.get(behind, -1)
                waits[one][step[(lane == row) & (length_m[row] - s + ahead_m <= _QUEUE_M)]] = True
        return _Watched(comes_from, enters, waits)

    @cached_property
    def _row_of(self) -> dict[int, tuple[int, ...]]:
        """Of each lane outside of intersections the lanes side by side, with itself."""
        inside = {one for one, lane in self.graph.lanes.items() if lane.is_intersection}
        return {lane: row for row in self.graph.rows(without=inside) for lane in row}

    @once
    def _approach(self, lane_id: int) -> _Approach | None:
        graph = self.graph
        if not graph.lanes[lane_id].is_intersection:
            return None
        lanes = {lane for before in graph.predecessors(lane_id) for lane in self._row_of.get(before, ())}
        fan = {onward for lane in lanes for onward in graph.successors(lane) if graph.lanes[onward].is_intersection}
        return _Approach(tuple(sorted(lanes)), tuple(sorted(fan))) if lanes else None


def _upstream(graph: LaneGraph, lane_id: int, reach_m: float) -> list[tuple[int, float]]:
    """The lane and those behind it within reach_m, each with the metres from its end to the entrance."""
    found, stack = [], [(lane_id, 0.0)]
    while stack:
        lane, ahead_m = stack.pop()
        found.append((lane, ahead_m))
        ahead_m += graph.lanes[lane].length_m
        if ahead_m < reach_m:
            stack.extend((one, ahead_m) for one in graph.predecessors(lane) if not graph.lanes[one].is_intersection)
    return found


def _forward(points: FloatArray) -> FloatArray:
    """Direction (2,) in which a line of points (N, 2) begins."""
    return np.asarray((points[1] - points[0]) / math.dist(points[0], points[1]))


def _through(graph: LaneGraph, lane_id: int) -> list[int]:
    """The lane, and the lanes of the intersection that lead straight on where it is cut into several."""
    found, onward = [lane_id], graph.straightest_successor(lane_id)
    while onward is not None and onward not in found and graph.lanes[onward].is_intersection:
        found.append(onward)
        onward = graph.straightest_successor(onward)
    return found
