"""What a vehicle did, seen from its positions and the map alone: lane changes, turns, overtakes.

Definitions:
- lane change: the centre crosses to a same-direction neighbour lane, stays at least 0.5 s on each side and moves at
  least half a lane width; it starts and ends where the lateral speed passes 0.1 m/s;
- turn: the vehicle drives a turning lane of an intersection and its own direction changes by as much as makes a turn;
- overtake: behind another vehicle on the same lane path, then in the adjacent same-direction lane, then ahead, then
  back; without the return it is a pass; round a vehicle that stands all the while it is obstacle avoidance.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import groupby, pairwise

import numpy as np

from hid2.agents import FloatArray
from hid2.measures.arrays import BoolArray
from hid2.measures.driven_lanes import LaneRun, LaneView, line_of, runs_of, source_path, target_path
from hid2.measures.lane_matching import CHANGES_LANES
from netconvert.geometry import Polyline, slopes
from netconvert.lane_graph import TURN_RAD

#: Least time on each side of the marking before and after a lane change's crossing, s.
STAY_S = 0.5
#: Lateral speed at which a lane change starts and ends, m/s.
LATERAL_SPEED_MPS = 0.1
#: Time over which a parabola is fitted for its slope, the lateral speed, s: recorded positions jitter by centimetres.
LATERAL_WINDOW_S = 1.1
#: Longest time from a lane change's crossing in which its start and end are sought, s.
LONGEST_HALF_S = 6.0
#: Time before and after the turning lane from which, and to which, a turn's change of direction is measured, s.
TURN_MARGIN_S = 1.0
#: Largest distance ahead, at the crossing of the lane change, of a vehicle that is overtaken, m.
OVERTAKE_REACH_M = 60.0
#: Speed, m/s, below which a vehicle is an obstacle if it stays so all the while it is passed.
PARKED_MPS = 0.5


class ManeuverKind(StrEnum):
    """Kinds that the detector tells apart."""

    LANE_CHANGE = "lane_change"
    LEFT_TURN = "left_turn"
    RIGHT_TURN = "right_turn"
    OVERTAKE = "overtake"
    PASS = "pass"  # noqa: S105
    OBSTACLE_AVOIDANCE = "obstacle_avoidance"


#: Turns by the side that the driven lanes turn to, as `FlatLanes.turn` has it.
TURNS = {+1: ManeuverKind.LEFT_TURN, -1: ManeuverKind.RIGHT_TURN}


@dataclass(frozen=True, slots=True)
class Maneuver:
    """One manoeuvre seen. Times in s from timestep 0; lanes are lane segment ids; side +1 left, -1 right.

    crossing_s: when the centre crosses between the lanes (overtakes: when the vehicle draws level; turns: half-way).
    complete: a lane change or turn with its start and end both within the track, ended: with its end; an overtake is
    complete by definition. part_of: the overtake, pass or obstacle avoidance that a lane change belongs to.
    """

    track_id: str
    kind: ManeuverKind
    start_s: float
    crossing_s: float
    end_s: float
    source_lane: int
    target_lane: int
    side: int
    complete: bool
    other_track_id: str | None = None
    part_of: ManeuverKind | None = None
    ended: bool = True

    @property
    def duration_s(self) -> float:
        """From start to end."""
        return self.end_s - self.start_s


@dataclass(frozen=True, eq=False, slots=True)
class _Change:
    """A lane change with what an overtake needs of it."""

    maneuver: Maneuver
    source: int
    row: int
    path: Polyline
    path_lanes: tuple[int, ...]


def detect(view: LaneView, *, among: Iterable[int] | None = None) -> list[Maneuver]:
    """Every manoeuvre of every moving vehicle, in the order of the tracks and of their start.

    among: the agents that are looked at, all unless told.
    """
    arrays, link = view.arrays, view.lanes.link
    found: list[Maneuver] = []
    moving = arrays.moving_vehicles
    for agent in (one for one in (range(arrays.num_agents) if among is None else among) if moving[one]):
        runs = runs_of(view, agent)
        tried = (
            _lane_change(view, agent, runs, k)
            for k, (before, after) in enumerate(pairwise(runs), 1)
            if min(before.lane, after.lane) >= 0 and link[before.lane, after.lane] == CHANGES_LANES
        )
        overtakes, changes = _overtakes(view, agent, [one for one in tried if one is not None])
        seen = [change.maneuver for change in changes] + overtakes + list(_turns(view, agent, runs))
        found += sorted(seen, key=lambda maneuver: (maneuver.start_s, maneuver.kind))
    return found


# Lane changes


def whole_lane_changes(seen: Iterable[Maneuver]) -> list[Maneuver]:
    """Lane changes of which start and end were seen: those that have a duration."""
    return [one for one in seen if one.kind is ManeuverKind.LANE_CHANGE and one.complete]


def _lane_change(view: LaneView, agent: int, runs: list[LaneRun], k: int) -> _Change | None:
    """Measure the change from run k - 1 to run k; None where it does not meet the definition."""
    arrays, lanes = view.arrays, view.lanes
    source, target = runs[k - 1].lane, runs[k].lane
    (left, leaves), (_, joins) = source_path(view, runs, k), target_path(view, runs, k)
    start, stop = int(arrays.first[agent]), int(arrays.first[agent + 1])
    time = np.asarray(arrays.step[start:stop] * arrays.step_s, dtype=np.float64)
    side = 1 if np.median(left.frenet(lanes.lane_points(target))[1]) > 0.0 else -1
    lateral, known = _lateral(arrays.position[start:stop], line_of(lanes, leaves, side), line_of(lanes, joins, -side))
    switch = runs[k].first - start
    if not known[max(0, switch - 1)] or not known[switch]:
        return None
    toward = lateral * side
    crossing = _crossing(toward, known, time, switch)
    if crossing is None:
        return None
    at, crossing_s = crossing
    smooth = lateral_speed(toward, time)
    first, started = _edge(smooth, known, at, -1, time)
    last, ended = _edge(smooth, known, at + 1, +1, time)
    if toward[last] - toward[first] < float(lanes.half_width[source] + lanes.half_width[target]) / 2:
        return None
    maneuver = Maneuver(
        track_id=arrays.track_ids[agent],
        kind=ManeuverKind.LANE_CHANGE,
        start_s=float(time[first]),
        crossing_s=crossing_s,
        end_s=float(time[last]),
        source_lane=int(lanes.lane_ids[source]),
        target_lane=int(lanes.lane_ids[target]),
        side=side,
        complete=started and ended,
        ended=ended,
    )
    return _Change(maneuver, source, start + at, left, leaves)


def _lateral(position: FloatArray, source: Polyline, target: Polyline) -> tuple[FloatArray, BoolArray]:
    """Offset (T,) m from the middle of the border that is left and the one that is entered, and where it is known (T,).

    Lanes that part have two borders there, else it is one. Where only one lies beside the vehicle, it is half of their
    distance from that one.
    """
    s_source, d_source = source.frenet(position)
    s_target, d_target = target.frenet(position)
    by_source = (s_source > -2.0) & (s_source < source.length_m + 2.0)
    by_target = (s_target > -2.0) & (s_target < target.length_m + 2.0)
    rows, both = np.arange(len(position)), by_source & by_target
    half_m = 0.5 * np.interp(rows, rows[both], (d_source - d_target)[both]) if both.any() else 0.0
    return np.where(by_source, d_source - half_m, d_target + half_m), by_source | by_target


def _crossing(toward: FloatArray, known: BoolArray, time: FloatArray, switch: int) -> tuple[int, float] | None:
    """The crossing nearest to row `switch` with STAY_S on each side: the last row before it and its time."""
    sign = np.where(toward >= 0, 1, -1)
    rows = np.flatnonzero((sign[:-1] < 0) & (sign[1:] > 0) & known[:-1] & known[1:])
    for at in sorted(rows, key=lambda row: abs(int(row) + 1 - switch)):
        share = -toward[at] / (toward[at + 1] - toward[at])
        crossing = float(time[at] + share * (time[at + 1] - time[at]))
        before = (time >= crossing - STAY_S) & (time <= time[at])
        after = (time <= crossing + STAY_S) & (time >= time[at + 1])
        long_enough = time[0] <= crossing - STAY_S + 1e-9 and time[-1] >= crossing + STAY_S - 1e-9
        if long_enough and (sign[before] < 0).all() and (sign[after] > 0).all() and abs(time[at] - time[switch]) < 3.0:
            return int(at), crossing
    return None


def lateral_speed(values: FloatArray, time: FloatArray) -> FloatArray:
    """Slope of an offset (T,) m, m/s: of a parabola fitted over LATERAL_WINDOW_S."""
    step = float(np.median(np.diff(time)))
    window = round(LATERAL_WINDOW_S / step) | 1
    if len(values) < window:
        return np.gradient(values, time)
    return slopes(values, window, step)


def _edge(slope: FloatArray, known: BoolArray, at: int, direction: int, time: FloatArray) -> tuple[int, bool]:
    """The row from `at` on where the lateral speed falls below the threshold, else the last known; whether it did."""
    rows = np.arange(at, len(slope) if direction > 0 else -1, direction)
    there = known[rows] & (np.abs(time[rows] - time[at]) <= LONGEST_HALF_S)
    rows = rows[: 1 + int(np.logical_and.accumulate(there[1:]).sum())]
    slow = rows[1:-1][slope[rows[1:-1]] < LATERAL_SPEED_MPS]
    return (int(slow[0]), True) if slow.size else (int(rows[-1]), False)


# Turns


def _turns(view: LaneView, agent: int, runs: list[LaneRun]) -> Iterator[Maneuver]:
    arrays, lanes = view.arrays, view.lanes
    start, stop = int(arrays.first[agent]), int(arrays.first[agent + 1])
    margin = round(TURN_MARGIN_S / arrays.step_s)
    direction = np.unwrap(view.matches.direction[start:stop])
    for sign, each in groupby(runs, lambda run: int(lanes.turn[run.lane]) if run.lane >= 0 else 0):
        driven = list(each)
        first, last = driven[0].first - start, driven[-1].last - start
        change = direction[min(last + margin, stop - start - 1)] - direction[max(first - margin, 0)]
        if sign and change * sign >= TURN_RAD:
            time = arrays.step[[start + first, start + last]] * arrays.step_s
            yield Maneuver(
                track_id=arrays.track_ids[agent],
                kind=TURNS[sign],
                start_s=float(time[0]),
                crossing_s=float(time.mean()),
                end_s=float(time[1]),
                source_lane=int(lanes.lane_ids[driven[0].lane]),
                target_lane=int(lanes.lane_ids[driven[-1].lane]),
                side=sign,
                complete=first > 0 and last < stop - start - 1,
            )


# Overtakes


def _overtakes(view: LaneView, agent: int, changes: list[_Change]) -> tuple[list[Maneuver], list[_Change]]:
    """Overtakes, passes and obstacle avoidances begun by each change; the changes, marked with what they belong to."""
    found: list[Maneuver] = []
    marked = list(changes)
    for k, change in enumerate(changes):
        if marked[k].maneuver.part_of is not None:
            continue
        back = next((m for m in range(k + 1, len(changes)) if changes[m].maneuver.side == -change.maneuver.side), None)
        passed = _overtake(view, agent, change, changes[back] if back is not None else None)
        if passed is None:
            continue
        maneuver, returned = passed
        found.append(maneuver)
        for m in (k, back) if returned and back is not None else (k,):
            marked[m] = replace(marked[m], maneuver=replace(marked[m].maneuver, part_of=maneuver.kind))
    return found, marked


def _overtake(view: LaneView, agent: int, change: _Change, back: _Change | None) -> tuple[Maneuver, bool] | None:
    """What is passed between a change and its return (if any), and whether the return followed.

    Of several vehicles a moving one, else an obstacle; of those the last one drawn level with.
    """
    arrays = view.arrays
    own = slice(int(arrays.first[agent]), int(arrays.first[agent + 1]))
    s_own, _ = change.path.frenet(arrays.position[own])
    step_own, row = arrays.step[own], change.row - own.start
    until = change.maneuver.end_s if back is None else back.maneuver.crossing_s
    found: list[tuple[bool, float, Maneuver, bool]] = []
    for other in _ahead_on_path(view, agent, change, float(s_own[row])):
        rows = arrays.row_of[other, step_own]
        shared = np.flatnonzero(rows >= 0)
        s_other, d_other = change.path.frenet(arrays.position[rows[shared]])
        lead = s_own[shared] - s_other
        half = (arrays.length[agent] + arrays.length[other]) / 2
        on_path = np.abs(d_other) <= view.lanes.half_width[change.source]
        behind = shared[(lead < -half) & on_path & (shared <= row)]
        ahead = shared[(lead > half) & on_path & (shared > row)]
        if not len(behind) or not len(ahead):
            continue
        time_ahead = float(step_own[ahead[0]] * arrays.step_s)
        returned = back is not None and back.maneuver.crossing_s >= time_ahead - 1e-9
        if back is not None and not returned and time_ahead > until:
            continue  # back in the lane before it was ahead: not passed in the adjacent lane
        speed = np.hypot(*arrays.velocity[rows[shared]].T)
        parked = bool((speed[(shared >= behind[-1]) & (shared <= ahead[0])] < PARKED_MPS).all())
        level_s = float(step_own[shared[np.flatnonzero(lead >= 0)[0]]] * arrays.step_s)
        end_s = back.maneuver.end_s if returned and back is not None else time_ahead
        kind = ManeuverKind.OVERTAKE if returned else ManeuverKind.PASS
        maneuver = replace(
            change.maneuver, kind=ManeuverKind.OBSTACLE_AVOIDANCE if parked else kind, crossing_s=level_s,
            end_s=max(end_s, change.maneuver.end_s), complete=True, other_track_id=arrays.track_ids[other],
        )  # fmt: skip
        found.append((not parked, level_s, maneuver, returned))
    return max(found, key=lambda item: item[:2])[2:] if found else None


def _ahead_on_path(view: LaneView, agent: int, change: _Change, s_own: float) -> Iterator[int]:
    """Vehicles on the lanes of the path that was left, ahead of the vehicle when it crosses."""
    arrays = view.arrays
    step = int(arrays.step[change.row])
    for other in np.flatnonzero(arrays.vehicle):
        row = int(arrays.row_of[other, step])
        if other == agent or row < 0 or int(view.matches.lane[row]) not in change.path_lanes:
            continue
        s_other, _ = change.path.frenet(arrays.position[row : row + 1])
        if -2.0 < float(s_other[0]) - s_own <= OVERTAKE_REACH_M:
            yield int(other)
