"""Plans for an event with a recorded target: on which route, from where, how fast, and when to change lanes.

A plan is worked out from the recorded future: of the target, and of everybody else who would be met
(`insertion/event_motions.py`). What comes of it when SUMO drives is another matter (`insertion/events.py`).

    t_c  moment of the event    s_c  where the vehicle is then, on its own path    gap  bumper to bumper

    lead, follow   s_c = s_T(t_c) +- (gap + half of both lengths), on the target's lanes
    cut_in         the same, on the lane beside; the change of lanes begins half its duration before t_c
    merge          s_c = start of the lane that both come onto, the vehicle from another lane than the target
    cross          s_c = where the paths cross
    overtake       from behind the target, faster; the manoeuvre itself is Algorithm 1's
"""

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hid2.agents import BoxSize, FloatArray, IntArray, Track
from hid2.drivers.driver import Driver
from hid2.insertion.event_motions import (
    SLOWS_MPS2,
    SPEEDS_UP_MPS2,
    Along,
    Rules,
    Wanted,
    free,
    kept_to,
    motions,
)
from hid2.insertion.routes import Routes
from hid2.measures.arrays import stack
from hid2.measures.driven_lanes import LaneView, Run, runs_of
from hid2.measures.encounters import CROSSING_RAD
from hid2.measures.lane_matching import match_lanes
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.motion.route import ROUTE_LONGEST_M, DrivenPath, Route, routes_from
from hid2.occupancy.along_path import PathOccupancy, look_along
from hid2.occupancy.traffic import BoolArray, Traffic
from hid2.params import Event
from hid2.policy.decision import Side
from hid2.policy.observation import admissible_neighbor
from hid2.policy.roads import Roads
from hid2.reasons import Reason
from hid2.scene import Scene
from netconvert.lane_graph import SIDES, TurnType

#: Duration of the change of lanes of a cut-in, s; and the shortest, where the moment is near.
CHANGE_S, _CHANGE_LEAST_S = 3.4, 2.5
#: No crossing is planned sooner, s; passing a conflict point so long before or after the target, s; the usual one.
_SOONEST_S, _CROSS_APART_S, _CROSS_USUAL_S = 1.0, (1.4, 5.0), 2.4
#: For so long after an event its vehicle stays on its path, and nobody may be met by plan: later its driver sees to it.
_ON_PATH_S, _FREE_S = 2.0, 2.0
_BACK_MOST = 4  # ways that lead to a lane
#: Shares of a band that are tried: the middle first.
_SHARES = (0.5, 0.3, 0.7, 0.12, 0.88, 0.02)
_SLOWEST_MPS, _FASTEST_MPS = 2.5, 20.0
#: Speed differences that are tried, m/s, and their share of the band where a criticality is asked for.
_DIFFERENCES_MPS = (-1.0, 0.0, 1.0, -2.0, 2.0, -3.5, 3.5)
_CRITICAL_SHARES = tuple(number / 20 for number in range(21))
#: Accelerations before the moment, m/s2; nan: as the target moves.
_BEFORE_MPS2 = (0.0, math.nan, 0.5, -0.5, 1.1, -1.1)
#: Speeds to which a vehicle goes afterwards, over that at the moment, m/s; nan: it keeps to the target.
_LATER_MPS = (math.nan, 0.0, 3.0, -2.0)
_TTC_SPARE_S = 0.3  # that plans keep above the critical TTC
_MOST_OF_A_WAY = 150  # plans that are kept of those along one way


@dataclass(frozen=True, eq=False, slots=True)
class Target:
    """A recorded vehicle that an event is about: its track, lanes in the order driven, and way driven (T,) m.

    present (T,); position (T, 2) m and speed (T,) m/s as dense arrays, steps step_s apart; runs: lane ids with first
    and last step.
    """

    track: Track
    row: int
    present: BoolArray
    position: FloatArray
    speed: FloatArray
    way: FloatArray
    runs: tuple[tuple[int, int, int], ...]
    step_s: float

    def lane_at(self, step: int) -> int | None:
        """Lane id at a step, None off every lane."""
        return next((lane for lane, first, last in self.runs if first <= step <= last), None)

    def lanes_from(self, step: int) -> tuple[int, ...]:
        """Lane ids driven from a step on."""
        return tuple(lane for lane, _, last in self.runs if last >= step)


@dataclass(frozen=True, eq=False, slots=True)
class Plan:
    """How an event may come about.

    speeds (T,) m/s as planned; at_step: the moment of the event; trigger_s, side, change_s: of the change of lanes;
    order: -1 where the vehicle is behind the target, or crosses second, else 1; score: how far from the middle of what
    is asked; desired_mps: what its driver drives at most; traits: what it shares with plans that are like it.
    """

    event: Event
    target: Target
    route: Route
    start_s: float
    speeds: FloatArray
    at_step: int
    order: int
    score: float
    desired_mps: float
    traits: tuple[float, ...]
    trigger_s: float = 0.0
    side: Side | None = None
    change_s: float = CHANGE_S

    @property
    def way(self) -> FloatArray:
        """(T,) m, arc length on the path by plan."""
        return self.start_s + np.concatenate([[0.0], np.cumsum(self.speeds[1:]) * self.target.step_s])

    def moved(self, *, forward_m: float, later_s: float) -> "Plan":
        """The same from farther ahead, with a later change of lanes."""
        return replace(self, start_s=self.start_s + forward_m, trigger_s=max(0.0, self.trigger_s + later_s))


def target_of(scene: Scene, row: int) -> Target | None:
    """A recorded vehicle as a target; None where it is never on a lane. row: of `scene.traffic`."""
    traffic = scene.traffic
    at = scene.vehicle_rows.tolist()
    if row not in at:
        return None
    track = scene.recorded.tracks[at.index(row)]
    lanes = scene.recorded.lanes
    arrays = stack([track], num_steps=scene.num_steps, step_s=scene.step_s)
    matches, _ = match_lanes(arrays, lanes)
    runs: list[Run] = [run for run in runs_of(LaneView(arrays, lanes, matches), 0) if run.lane >= 0]
    if not runs:
        return None
    step = np.hypot(*np.diff(traffic.position[row], axis=0).T)
    step[~(traffic.present[row, 1:] & traffic.present[row, :-1])] = 0.0
    return Target(
        track=track, row=row, present=traffic.present[row], position=traffic.position[row],
        speed=np.hypot(*traffic.velocity[row].T), way=np.concatenate([[0.0], np.cumsum(step)]),
        runs=tuple(
            (int(lanes.lane_ids[run.lane]), int(arrays.step[run.first]), int(arrays.step[run.last])) for run in runs
        ),
        step_s=scene.step_s,
    )  # fmt: skip


@dataclass(frozen=True, eq=False, slots=True)
class _Course:
    """Motions that are wanted along one route, with what they have to do with. side: of the change of lanes."""

    route: Route
    wanted: Wanted
    off: FloatArray
    rules: Rules
    before: Along
    after: Along
    desired_mps: float
    side: Side | None = None


@dataclass(slots=True)
class Planner:
    """Plans of one scene for a vehicle of a size; box: what is kept clear for it; fixed: vehicles that are kept.

    turned_down: motions that were no plans, by reason.
    """

    scene: Scene
    routes: Routes
    roads: Roads
    size: BoxSize
    box: BoxSize
    fixed: Traffic
    turned_down: Counter[Reason] = field(default_factory=Counter)
    _ways: dict[tuple[int, tuple[int, ...]], list[Route]] = field(default_factory=dict)
    _caps: dict[tuple[Route, float], FloatArray] = field(default_factory=dict)
    _taken: dict[Route, tuple[PathOccupancy, IntArray]] = field(default_factory=dict)

    def plans(self, event: Event, target: Target) -> list[Plan]:
        """Plans for an event with a target, the likeliest ones first."""
        if event.kind == "overtake":
            found = [plan for plan in self._overtakes(event, target) if self._is_possible(plan)]
        else:
            courses = {
                "lead": self._along, "follow": self._along, "cut_in": self._cut_ins, "merge": self._merges,
                "cross": self._crossings,
            }[event.kind](event, target)  # fmt: skip
            found = [plan for course in courses for plan in self._free(event, target, course)]
        return sorted(found, key=lambda plan: plan.score)

    def _moments(self, event: Event, target: Target) -> list[tuple[int, float]]:
        """Steps of the time asked for at which the target is there, with their distance from its middle, 0 to 1."""
        spare, step_s = 0.6 * self.scene.config.event_search.moment_s, self.scene.step_s
        low, high = event.at_s
        times = [low + share * (high - low) for share in _SHARES[:-1]] if high - low > 2 * spare else [
            0.5 * (low + high) + share * spare for share in (0.0, -1.0, 1.0)
        ]  # fmt: skip
        middle, wide = 0.5 * (low + high), max(0.5 * (high - low), spare)
        steps = {round(time_s / step_s): abs(time_s - middle) / wide for time_s in reversed(times)}
        return [(step, off) for step, off in steps.items() if 0 < step < target.present.size and target.present[step]]

    def _relations(self, event: Event) -> tuple[FloatArray, FloatArray]:
        """Gaps, m, and speed differences, m/s, within what is asked for."""
        least, most = event.gap_band_m[0], min(event.gap_band_m[1], max(30.0, event.gap_band_m[0]))
        gaps = np.array([least + share * (most - least) for share in _SHARES])
        low, high = event.difference_band_mps
        if event.ttc_s is None and event.drac_mps2 is None:
            usual = [difference for difference in _DIFFERENCES_MPS if low <= difference <= high]
            differences = usual or [low + share * (high - low) for share in _SHARES]
        else:
            differences = [low + share * (high - low) for share in _CRITICAL_SHARES]
        return np.unique(gaps), np.unique(differences)

    # what is wanted, by kind

    def _along(self, event: Event, target: Target) -> Iterator[_Course]:
        """Ahead of the target, or behind it, on its lanes."""
        order = 1 if event.kind == "lead" else -1
        for moments in self._same_lane(event, target):
            at = moments[0][0]
            lane = target.lane_at(at)
            assert lane is not None
            for route in self._ways_over(lane, target.lanes_from(at), before=self._before(target, at)):
                ahead = self._on_path(self.scene.path(route), target, at)
                if ahead is None:
                    continue
                along = self._looked_along(route, target, _FASTEST_MPS)
                wanted, off = self._grid(event, target, moments, ahead, order)
                yield _Course(route, wanted, off, self._rules(event, target, ahead, order), along, along, _FASTEST_MPS)

    def _cut_ins(self, event: Event, target: Target) -> Iterator[_Course]:
        """From the lane beside to before the target, wherever the marking lets one over."""
        graph = self.scene.grid.graph
        for moments in self._same_lane(event, target):
            at = moments[0][0]
            lane = target.lane_at(at)
            assert lane is not None
            own = self._ways_over(lane, target.lanes_from(at), before=self._before(target, at))
            sides: tuple[tuple[Side, Side], ...] = (("left", "right"), ("right", "left"))
            for where, side in sides:
                # the vehicle is ahead: where the target has no lane beside yet, there may be one by then
                lanes = [lane, *target.lanes_from(at)[1:4]]
                beside = next((n for one in lanes if (n := graph.neighbor(one, where)) is not None), None)
                if beside is None or not self.routes.usable(beside) or not own:
                    continue
                wanted_lanes = [graph.neighbor(n, where) for n in own[0]]
                ahead_lanes = tuple(n for n in wanted_lanes if n is not None)
                before = [graph.neighbor(n, where) for n in self._before(target, at)]
                for route in self._ways_over(beside, ahead_lanes, before=tuple(n for n in before if n is not None)):
                    # the way that it will go on: beside its own route, as Algorithm 1 has it
                    over = graph.neighbor(beside, side)
                    if over is None or not self.routes.usable(over):
                        continue
                    joined = self.scene.route_beside(route[route.index(beside) :], over)
                    ahead = self._on_path(self.scene.path(route), target, at)
                    there = self._on_path(self.scene.path(joined), target, at)
                    if ahead is None or there is None:
                        continue
                    wanted, off = self._grid(event, target, moments, ahead, 1)
                    desired = min(_FASTEST_MPS, float(wanted.speed_mps.max(initial=_SLOWEST_MPS)) + 1.0)
                    first = self._looked_along(route, target, desired)
                    second = self._looked_along(joined, target, desired, from_m=float(there[at] - ahead[at]))
                    rules = self._rules(event, target, ahead, 1, changes=True)
                    yield _Course(route, wanted, off, rules, first, second, desired, side)

    def _merges(self, event: Event, target: Target) -> Iterator[_Course]:
        """Onto a lane that the target comes onto from another one, before or behind it."""
        graph = self.scene.grid.graph
        for number in range(1, len(target.runs)):
            lane, entered, _ = target.runs[number]
            source = target.runs[number - 1][0]
            if source not in graph.predecessors(lane):
                continue
            for other in (n for n in graph.predecessors(lane) if n != source and self.routes.usable(n)):
                for route in self._ways_over(other, (lane, *target.lanes_from(entered)), before=()):
                    if lane not in route:
                        continue
                    begin = next(s.start for s in self.scene.path(route).segments if s.lane_id == lane)
                    ahead = begin + target.way - target.way[entered]
                    yield from self._at_place(event, target, route, begin, ahead)

    def _at_place(
        self, event: Event, target: Target, route: Route, place: float, ahead: FloatArray
    ) -> Iterator[_Course]:
        """At a place on a route at each step of the time asked for: the gap is what the target leaves."""
        along = self._looked_along(route, target, _FASTEST_MPS)
        spare = self.scene.config.event_search.moment_s
        steps = np.flatnonzero(target.present)
        near = np.abs(steps * self.scene.step_s - 0.5 * sum(event.at_s)) <= 0.5 * np.ptp(event.at_s) + spare
        gaps = np.abs(place - ahead[steps]) - self._lengths(target)
        steps = steps[near & (gaps >= event.gap_band_m[0]) & (gaps <= event.gap_band_m[1]) & (steps > 0)]
        for order in (1, -1):
            moments = [int(step) for step in steps if (place > ahead[step]) == (order > 0)]
            if not moments:
                continue
            _, differences = self._relations(event)
            rows = [
                (at, place, abs(place - float(ahead[at])) - self._lengths(target), target.speed[at] + d, a, later,
                 0.02 * abs(d) + self._pull(a))
                for at in moments[:: max(1, len(moments) // 6)]
                for d in differences
                for a in _BEFORE_MPS2
                for later in _LATER_MPS
            ]  # fmt: skip
            wanted, off = self._wanted(rows)
            rules = self._rules(event, target, ahead, order)
            yield _Course(route, wanted, off, rules, along, along, _FASTEST_MPS)

    def _crossings(self, event: Event, target: Target) -> Iterator[_Course]:
        """Across the target's path, before or behind it."""
        spare, step_s = self.scene.config.event_search.moment_s, self.scene.step_s
        for lane, lane_s, crossed in self._crossed_lanes(target):
            for route in self._ways_over(lane, (), before=()):
                segment = next(s for s in self.scene.path(route).segments if s.lane_id == lane)
                share = lane_s / max(segment.lane_end, 1e-9)
                point = segment.start + share * (segment.end - segment.start)
                along = self._looked_along(route, None, _FASTEST_MPS)
                for order in (1, -1):
                    rows = []
                    for at in range(round(_SOONEST_S / step_s), self.scene.num_steps):
                        apart = order * (crossed - at) * step_s
                        gap = abs(float(target.way[crossed] - target.way[at])) - 0.5 * target.track.size.length_m
                        asked = event.at_s[0] - spare <= at * step_s <= event.at_s[1] + spare
                        if not asked or not target.present[at] or not self._is_apart(event, apart):
                            continue
                        if event.gap_band_m[0] <= gap <= event.gap_band_m[1]:
                            rows += [
                                (at, point, gap, speed, a, 0.0, 0.1 * abs(apart - _CROSS_USUAL_S) + self._pull(a))
                                for speed in self._speeds_of(lane)
                                for a in _BEFORE_MPS2
                                if not math.isnan(a)
                            ]
                    if rows:
                        wanted, off = self._wanted(rows)
                        rules = replace(self._rules(event, target, None, order), brakes_mps2=0.0)
                        yield _Course(route, wanted, off, rules, along, along, _FASTEST_MPS)

    @staticmethod
    def _is_apart(event: Event, apart_s: float) -> bool:
        """Whether a time between the two centres at the conflict point is what is asked for, about."""
        if event.pet_s is None:
            return _CROSS_APART_S[0] <= apart_s <= _CROSS_APART_S[1]
        return event.pet_s[0] + 0.2 <= apart_s <= event.pet_s[1] + 1.5

    def _overtakes(self, event: Event, target: Target) -> Iterator[Plan]:
        """From behind the target and faster, where it is slow enough to be overtaken within the scene."""
        overtake = self.scene.config.overtake
        first = int(np.flatnonzero(target.present)[0])
        lane = target.lane_at(first)
        mean = float(target.speed[target.present].mean())
        if lane is None or first > 0 or mean < overtake.parked_mps:
            return
        lanes = [one for one, _, _ in target.runs]
        if not any(admissible_neighbor(self.scene, one, side) is not None for one in lanes for side in SIDES):
            return
        for route in self._ways_over(lane, target.lanes_from(first), before=()):
            ahead = self._on_path(self.scene.path(route), target, first)
            if ahead is None:
                continue
            for number, (faster, gap, trigger) in enumerate(
                (f, g, t) for f in (5.0, 7.0, 4.0, 9.0) for g in (8.0, 14.0, 22.0) for t in (0.3, 1.5, 3.0)
            ):
                speed = min(mean + faster, _FASTEST_MPS)
                start = float(ahead[0]) - gap - self._lengths(target)
                yield Plan(
                    event, target, route, start, np.full(self.scene.num_steps, speed),
                    round(event.at_s[0] / self.scene.step_s), -1, 0.05 * number, speed, (faster, gap, trigger),
                    trigger_s=trigger,
                )  # fmt: skip

    # motions

    def _same_lane(self, event: Event, target: Target) -> Iterator[list[tuple[int, float]]]:
        """Moments at which the target is on the same lane, together."""
        found: dict[int, list[tuple[int, float]]] = {}
        for at, off in sorted(self._moments(event, target), key=lambda moment: moment[1]):
            lane = target.lane_at(at)
            if lane is not None:
                found.setdefault(lane, []).append((at, off))
        yield from found.values()

    def _grid(
        self, event: Event, target: Target, moments: Sequence[tuple[int, float]], ahead: FloatArray, order: int
    ) -> tuple[Wanted, FloatArray]:
        """Every gap, speed difference and way to come there that is tried, at each moment."""
        gaps, differences = self._relations(event)
        if event.ttc_s is not None:  # whoever is behind is faster, or nobody closes in
            differences = differences[order * differences < 0.0]
        middle = 0.5 * (gaps[0] + gaps[-1])
        wide = max(float(np.ptp(gaps)), 1.0)
        rows = [
            (at, float(ahead[at]) + order * (gap + self._lengths(target)), gap, float(target.speed[at]) + d, a, later,
             0.2 * off + 0.3 * abs(gap - middle) / wide + 0.03 * abs(d) + self._pull(a)
             + (0.0 if math.isnan(later) else 0.05))
            for at, off in moments
            for gap in gaps.tolist()
            for d in differences.tolist()
            for a in _BEFORE_MPS2
            for later in _LATER_MPS
        ]  # fmt: skip
        return self._wanted(rows)

    @staticmethod
    def _pull(before_mps2: float) -> float:
        return 0.02 if math.isnan(before_mps2) else 0.1 * abs(before_mps2)

    @staticmethod
    def _wanted(rows: Sequence[tuple[int, float, float, float, float, float, float]]) -> tuple[Wanted, FloatArray]:
        """Rows of step, place, gap, speed, acceleration before, speed later over that, and score."""
        table = np.array(rows, dtype=np.float64).reshape(-1, 7)
        table = table[(table[:, 3] >= _SLOWEST_MPS) & (table[:, 3] <= _FASTEST_MPS)]
        at, place, gap, speed, before, later, off = table.T
        return Wanted(at.astype(np.int64), place, gap, speed, before, np.maximum(speed + later, 0.5)), off

    def _rules(
        self, event: Event, target: Target, ahead: FloatArray | None, order: int, *, changes: bool = False
    ) -> Rules:
        critical = self.scene.config.conflict
        return Rules(
            order=order, lengths=self._lengths(target), changes=changes,
            brakes_mps2=event.brakes_mps2 if event.kind == "lead" else 0.0, target_mps=target.speed, ahead=ahead,
            ttc_s=max(critical.ttc_min_s, critical.follower_ttc_min_s) + _TTC_SPARE_S, step_s=self.scene.step_s,
        )  # fmt: skip

    def _looked_along(self, route: Route, target: Target | None, desired_mps: float, *, from_m: float = 0.0) -> Along:
        """A route's path with everybody on it: recorded vehicles and those kept."""
        if route not in self._taken:
            path, margin = self.scene.path(route), self.scene.config.conflict.margin_lateral_m
            taken, rows = self.scene.kept_clear_on(path, self.box), self.scene.rows_on(path, self.box)
            if self.fixed.ids:
                more_rows, more = look_along(
                    path.line, self.fixed, self.box.length_m, self.box.width_m + 2 * margin
                )  # fmt: skip
                taken = taken.joined(more)
                rows = np.concatenate([rows, np.full(more_rows.size, -1)])
            self._taken[route] = taken, rows
        taken, rows = self._taken[route]
        own = np.zeros(rows.size, dtype=np.bool_) if target is None else rows == target.row
        return Along(self._cap(route, desired_mps), taken, own, self.scene.path(route).exit_s, from_m)

    def _free(self, event: Event, target: Target, course: _Course) -> list[Plan]:
        """Plans of a course that the road has room for, that meet nobody, and that are as critical as is asked for."""
        wanted, off = course.wanted, course.off
        if not wanted.at.size:
            return []
        step_s, rules = self.scene.step_s, course.rules
        most = np.minimum(course.before.at(wanted.place), course.after.at(wanted.place + course.after.from_m))
        wanted = replace(wanted, speed_mps=np.minimum(wanted.speed_mps, most))  # as fast as the road lets it
        low, high = event.difference_band_mps
        difference = wanted.speed_mps - target.speed[wanted.at]
        fast = (wanted.speed_mps >= _SLOWEST_MPS) & (difference >= low) & (difference <= high)
        keep = self._still(fast, np.ones(fast.size, dtype=np.bool_), Reason.TOO_SLOW)
        speeds, way = motions(wanted, rules, course.before, course.after)
        keep = self._still(self._has_room(course, way), keep, Reason.NO_SITE)
        keep = self._still(self._may_change(course, way), keep, Reason.NO_ADJACENT_LANE)
        if rules.ahead is not None:
            least, drac = kept_to(wanted, rules, speeds, way, target.present)
            keep = self._still(self._is_critical(event, least, drac), keep, Reason.EVENT_NOT_AS_ASKED)
        if not keep.any():
            return []
        wanted, off, speeds, way = wanted.rows(keep), off[keep], speeds[keep], way[keep]
        until = free(wanted, rules, course.before, course.after, speeds, way)
        late = until - wanted.at * step_s
        rows = np.flatnonzero(self._still(late > _FREE_S, np.ones(late.size, dtype=np.bool_), Reason.MEETS_RECORDED))
        # somebody is met in the end: a driver may see to it
        score = off[rows] + np.where(np.isinf(until[rows]), 0.0, 0.5)
        found = []
        for place in np.argsort(score, kind="stable")[:_MOST_OF_A_WAY].tolist():
            row = rows[place]
            at_s = float(wanted.at[row]) * step_s
            change_s = min(CHANGE_S, 2.0 * at_s)
            traits = (
                float(sum(course.route) % 9973), float(wanted.at[row]), float(wanted.gap_m[row]),
                float(wanted.speed_mps[row]), float(np.nan_to_num(wanted.before_mps2[row], nan=9.0)),
                float(np.nan_to_num(wanted.later_mps[row], nan=-1.0)),
            )  # fmt: skip
            plan = Plan(
                event, target, course.route, float(way[row, 0]), speeds[row], int(wanted.at[row]), rules.order,
                float(score[place]), course.desired_mps, traits,
            )  # fmt: skip
            if course.side is not None:
                plan = replace(plan, trigger_s=max(0.0, at_s - 0.5 * change_s), side=course.side, change_s=change_s)
            found.append(plan)
        return found

    def _still(self, holds: BoolArray, before: BoolArray, reason: Reason) -> BoolArray:
        """Those for whom something holds, of those before; the others are counted."""
        self.turned_down[reason] += int((before & ~holds).sum())
        return before & holds

    def _has_room(self, course: _Course, way: FloatArray) -> BoolArray:
        """(N,) whether motions begin and go on, after the moment, on the map."""
        scene, at, half_m = self.scene, course.wanted.at, 0.5 * self.box.length_m
        rows = np.arange(at.size)
        needed = np.minimum(np.maximum(scene.first_exit_step, at + scene.steps_in(_ON_PATH_S)), scene.num_steps - 1)
        end = course.after.exit_m - course.after.from_m - half_m - 1.0
        found = (way[:, 0] >= half_m + 0.5) & (way[rows, needed] < end)
        if course.side is not None:
            begins, change = self._begins(course.wanted), self.scene.config.lane_change
            left = course.after.exit_m - course.after.from_m - way[rows, begins]
            pace = 0.5 * (course.wanted.speed_mps + course.desired_mps)
            found &= left > np.maximum(change.min_remaining_m, change.min_duration_s * pace / change.length_share) + 1.0
            found &= way[rows, course.wanted.at] < course.before.exit_m - half_m - 1.0
        return found

    def _begins(self, wanted: Wanted) -> IntArray:
        """(N,) steps at which changes of lanes begin."""
        step_s = self.scene.step_s
        change_s = np.minimum(CHANGE_S, 2.0 * wanted.at * step_s)
        return np.asarray(np.maximum(wanted.at - np.round(0.5 * change_s / step_s).astype(np.int64), 0))

    def _may_change(self, course: _Course, way: FloatArray) -> BoolArray:
        """(N,) whether the marking lets a vehicle over when it begins to change lanes and when it crosses."""
        wanted, side, path = course.wanted, course.side, self.scene.path(course.route)
        found = np.ones(wanted.at.size, dtype=np.bool_)
        if side is None:
            return found
        ends = np.array([segment.end for segment in path.segments])
        may = np.array([admissible_neighbor(self.scene, one.lane_id, side) is not None for one in path.segments])
        found &= 2.0 * wanted.at * self.scene.step_s >= _CHANGE_LEAST_S
        for step in (self._begins(wanted), wanted.at):
            s = way[np.arange(wanted.at.size), step]
            found &= may[np.minimum(np.searchsorted(ends, s, side="right"), ends.size - 1)]
        return found

    def _is_critical(self, event: Event, least_s: FloatArray, drac: FloatArray) -> BoolArray:
        """(N,) whether the criticality is what is asked for, and not below the critical values else."""
        found = least_s > 0.0
        if event.drac_mps2 is not None:
            found &= (event.drac_mps2[0] <= drac) & (drac <= event.drac_mps2[1])
        if event.ttc_s is None:
            return np.asarray(found & (least_s > self.scene.config.conflict.ttc_min_s + _TTC_SPARE_S))
        wide = min(0.1, 0.2 * (event.ttc_s[1] - event.ttc_s[0]))
        return np.asarray(found & (event.ttc_s[0] + wide <= least_s) & (least_s <= event.ttc_s[1] - wide))

    def _cap(self, route: Route, speed: float) -> FloatArray:
        """(S,) m/s, what the road lets a vehicle drive at most at the table of its path."""
        key = route, speed
        if key not in self._caps:
            driver = Driver(
                desired_mps=speed, tau_s=1.0, accel_mps2=SPEEDS_UP_MPS2, decel_mps2=-SLOWS_MPS2, min_gap_m=2.0,
                turn_lateral_mps2=self.scene.config.drivers.turn_lateral_max_mps2, offset_m=0.0,
                lane_change_s=CHANGE_S,
            )  # fmt: skip
            self._caps[key] = np.minimum(self.roads.speeds(self.scene.path(route), driver), speed)
        return self._caps[key]

    # the map

    def _lengths(self, target: Target) -> float:
        return 0.5 * (self.size.length_m + target.track.size.length_m)

    def _speeds_of(self, lane_id: int) -> tuple[float, ...]:
        pool = self.scene.lane_speeds.get(lane_id) or self.scene.scene_speeds
        usual = float(np.median(pool)) if pool else self.scene.config.spawn.prior_speed_mps
        shares = (1.0, 0.8, 0.6, 1.2, 0.45, 0.3, 1.4)
        return tuple(min(max(share * usual, _SLOWEST_MPS), _FASTEST_MPS) for share in shares)

    @staticmethod
    def _before(target: Target, step: int) -> tuple[int, ...]:
        """Lanes of the target before a step, the last one first."""
        return tuple(lane for lane, _, last in reversed(target.runs) if last < step)

    def _ways_over(self, lane_id: int, ahead: tuple[int, ...], *, before: tuple[int, ...]) -> list[Route]:
        """Routes over a lane: on along the wanted lanes where they can, else straight on; back to the map's edge."""
        key = lane_id, (*ahead, -1, *before)
        if key not in self._ways:
            graph, lanes = self.scene.grid.graph, self.scene.grid.graph.lanes
            if not self.routes.usable(lane_id):
                self._ways[key] = []
                return []

            def choose(onward: tuple[int, ...]) -> tuple[int, ...]:
                return tuple(sorted(onward, key=lambda n: (n not in ahead, lanes[n].turn is not TurnType.STRAIGHT, n)))

            onward = next(
                routes_from(
                    graph, lane_id, choose=choose, usable=self.routes.usable, most=1, longest_m=ROUTE_LONGEST_M
                ),
                (lane_id,),
            )
            found: list[Route] = []
            stack_: list[tuple[Route, float]] = [(onward, 0.0)]
            while stack_ and len(found) < _BACK_MOST:
                route, back_m = stack_.pop()
                back = [n for n in graph.predecessors(route[0]) if self.routes.usable(n) and n not in route]
                if not back or back_m > 0.5 * ROUTE_LONGEST_M:
                    found.append(route)
                    continue
                back.sort(key=lambda n: (n in before, lanes[n].turn is TurnType.STRAIGHT, -n))  # the best one last
                stack_.extend(((n, *route), back_m + lanes[n].length_m) for n in back)
            self._ways[key] = found
        return self._ways[key]

    def _on_path(self, path: DrivenPath, target: Target, at: int) -> FloatArray | None:
        """(T,) m, where the target is along a path by the way it drives; None where it is not beside it at a step."""
        offset = path.line.table_xy - target.position[at]
        cell = int(np.argmin(np.square(offset).sum(axis=1)))
        heading = float(path.line.table_heading[cell])
        forward = math.cos(heading), math.sin(heading)
        aside = abs(-offset[cell, 0] * forward[1] + offset[cell, 1] * forward[0])
        if aside > 6.0 or math.cos(heading - float(self.scene.traffic.heading[target.row, at])) < 0.8:
            return None
        along = -float(offset[cell] @ np.array(forward))
        return np.asarray(cell * TABLE_STEP_M + along + target.way - target.way[at])

    def _crossed_lanes(self, target: Target) -> list[tuple[int, float, int]]:
        """Lanes that the target's path crosses: lane id, arc length there, m, and the step at which the target does."""
        steps = np.flatnonzero(target.present)
        xy = target.position[steps]
        found: list[tuple[int, float, int]] = []
        own = {lane for lane, _, _ in target.runs}
        for lane_id in self.routes.lanes:
            if lane_id in own:
                continue
            path = self.scene.grid.graph.lanes[lane_id].path
            s, d = path.frenet(xy)
            inside = (s[1:] > 0.0) & (s[1:] < path.length_m) & (d[1:] * d[:-1] < 0.0) & (np.abs(d[1:]) < 3.0)
            for row in np.flatnonzero(inside).tolist():
                lane_heading = float(path.heading(s[row + 1 : row + 2])[0])
                angle = abs(math.sin(lane_heading - float(self.scene.traffic.heading[target.row, steps[row + 1]])))
                if angle > math.sin(CROSSING_RAD):
                    found.append((lane_id, float(s[row + 1]), int(steps[row + 1])))
                    break
        return found

    def _is_possible(self, plan: Plan) -> bool:
        """Whether the route is long enough for the plan of an overtake."""
        scene, path = self.scene, self.scene.path(plan.route)
        way = plan.way
        if plan.start_s < 0.5 * self.box.length_m + 0.5:
            return False
        inside = way < path.exit_s - 0.5 * self.box.length_m - 1.0
        needed = max(scene.first_exit_step, min(plan.at_step + scene.steps_in(_ON_PATH_S), scene.num_steps))
        return bool(inside[:needed].all())
