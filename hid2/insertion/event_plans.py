"""Plans for an event with a recorded target: on which route, from where, how fast, and when to change lanes.

A plan is worked out from the target's recorded future, as if nobody else were there and the vehicle kept to its plan.
What comes of it when SUMO drives is another matter (`insertion/events.py`).

    t_c  moment of the event    s_c  where the vehicle is then, on its own path    gap  bumper to bumper

    lead, follow   s_c = s_T(t_c) +- (gap + half of both lengths), on the target's lanes
    cut_in         the same, on the lane beside; the change of lanes begins half its duration before t_c
    merge          s_c = start of the lane that both come onto, the vehicle from another lane than the target
    cross          s_c = where the paths cross
    overtake       from behind the target, faster; the manoeuvre itself is Algorithm 1's
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from hid2.agents import BoxSize, FloatArray, Track
from hid2.drivers.driver import Driver
from hid2.insertion.routes import Routes
from hid2.measures.arrays import stack
from hid2.measures.driven_lanes import LaneView, Run, runs_of
from hid2.measures.encounters import CROSSING_RAD
from hid2.measures.lane_matching import match_lanes
from hid2.motion.lane_change_path import lateral_share
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.motion.route import ROUTE_LONGEST_M, DrivenPath, Route, routes_from
from hid2.motion.smoothing import Trajectory
from hid2.occupancy.traffic import BoolArray
from hid2.params import Event
from hid2.policy.decision import Side
from hid2.policy.observation import admissible_neighbor
from hid2.policy.roads import Roads
from hid2.scene import Scene
from netconvert.lane_graph import TurnType

#: Duration of the change of lanes of a cut-in, s.
CHANGE_S = 3.4
#: How a driver of an event keeps to the target: pull towards its speed, 1/s, and towards the gap, 1/s2.
_SPEED_PULL, _GAP_PULL = 0.6, 0.15
_SLOWS_MPS2, _SPEEDS_UP_MPS2 = -1.5, 1.4
#: Ahead of the target a vehicle keeps at least this gap, m, and so much of its speed, s.
_AHEAD_GAP_M, _AHEAD_TIME_S = 5.0, 0.3
_BRAKES_FOR_S = 1.5
#: Passing a conflict point this long before or after the target: what is tried, s.
_CROSS_APART_S = (2.4, 3.2, 2.0, 4.0, 1.6, 5.0)
#: No crossing is planned sooner, s; and for so long after an event its vehicle stays on its path, s.
_SOONEST_S, _ON_PATH_S = 1.0, 2.0
_BACK_MOST = 4  # ways that lead to a lane
#: Shares of a band that are tried: the middle first.
_SHARES = (0.5, 0.3, 0.7, 0.12, 0.88)
_SLOWEST_MPS, _FASTEST_MPS = 2.5, 20.0


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

    speeds (T,) m/s as planned; at_step: the moment of the event; trigger_s, side: of the change of lanes; order: -1
    where the vehicle is behind the target, or crosses second, else 1; score: how far from the middle of what is asked.
    """

    event: Event
    target: Target
    route: Route
    start_s: float
    speeds: FloatArray
    at_step: int
    order: int
    score: float
    trigger_s: float = 0.0
    side: Side | None = None

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


@dataclass(slots=True)
class Planner:
    """Plans of one scene for a vehicle of a size; box: what is kept clear for it."""

    scene: Scene
    routes: Routes
    roads: Roads
    size: BoxSize
    box: BoxSize
    _ways: dict[tuple[int, tuple[int, ...]], list[Route]] = field(default_factory=dict)
    _caps: dict[tuple[Route, float], FloatArray] = field(default_factory=dict)

    def plans(self, event: Event, target: Target) -> list[Plan]:
        """Plans for an event with a target, the likeliest ones first."""
        made = {
            "lead": self._along, "follow": self._along, "cut_in": self._cut_ins, "merge": self._merges,
            "cross": self._crossings, "overtake": self._overtakes,
        }[event.kind](event, target)  # fmt: skip
        return sorted((plan for plan in made if self._is_possible(plan)), key=lambda plan: plan.score)

    def _moments(self, event: Event, target: Target) -> Iterator[tuple[int, float]]:
        """Steps within the time asked for at which the target is there, with their distance from its middle, s."""
        low, high = event.at_s
        for share in _SHARES:
            at_s = low + share * (high - low)
            step = round(at_s / self.scene.step_s)
            if 0 < step < self.scene.num_steps and target.present[step]:
                yield step, abs(share - 0.5)
            if high - low < self.scene.step_s:
                return

    def _relations(self, event: Event) -> Iterator[tuple[float, float, float]]:
        """Gaps, m, and speed differences, m/s, within what is asked for, and their distance from its middle."""
        wanted = event.ttc_s
        for g in _SHARES:
            gap = event.gap_band_m[0] + g * (min(event.gap_band_m[1], 30.0) - event.gap_band_m[0])
            low, high = event.speed_difference_mps
            slower = [low + d * (high - low) for d in _SHARES]
            if wanted is None and low <= 0.0 <= high:
                slower = [max(low, -1.0), 0.0, min(high, 1.5)]
            for number, difference in enumerate(slower):
                yield gap, difference, 0.5 * abs(g - 0.5) + 0.05 * number

    # plans by kind

    def _along(self, event: Event, target: Target) -> Iterator[Plan]:
        """Ahead of the target, or behind it, on its lanes."""
        order = 1 if event.kind == "lead" else -1
        for at, off in self._moments(event, target):
            lane = target.lane_at(at)
            if lane is None:
                continue
            for route in self._ways_over(lane, target.lanes_from(at), before=self._before(target, at)):
                path = self.scene.path(route)
                ahead = self._on_path(path, target, at)
                if ahead is None:
                    continue
                yield from self._at_any_relation(event, target, route, ahead=ahead, at=at, order=order, score=off)

    def _cut_ins(self, event: Event, target: Target) -> Iterator[Plan]:
        """From the lane beside to before the target."""
        graph = self.scene.grid.graph
        for at, off in self._moments(event, target):
            lane = target.lane_at(at)
            if lane is None:
                continue
            sides: tuple[tuple[Side, Side], ...] = (("left", "right"), ("right", "left"))
            for where, side in sides:
                beside = graph.neighbor(lane, where)
                if beside is None or not self.routes.usable(beside):
                    continue
                if admissible_neighbor(self.scene, beside, side) != lane:
                    continue
                wanted = [graph.neighbor(n, where) for n in target.lanes_from(at)]
                before = [graph.neighbor(n, where) for n in self._before(target, at)]
                for route in self._ways_over(
                    beside, tuple(n for n in wanted if n is not None), before=tuple(n for n in before if n is not None)
                ):
                    path = self.scene.path(route)
                    ahead = self._on_path(path, target, at)
                    if ahead is None:
                        continue
                    for plan in self._at_any_relation(event, target, route, ahead=ahead, at=at, order=1, score=off):
                        trigger = at * self.scene.step_s - 0.5 * CHANGE_S
                        if trigger >= 0.0:
                            yield replace(plan, trigger_s=trigger, side=side)

    def _merges(self, event: Event, target: Target) -> Iterator[Plan]:
        """Onto a lane that the target comes onto from another one, before or behind it."""
        graph = self.scene.grid.graph
        for number in range(1, len(target.runs)):
            lane, entered, _ = target.runs[number]
            source = target.runs[number - 1][0]
            others = [n for n in graph.predecessors(lane) if n != source and self.routes.usable(n)]
            if source not in graph.predecessors(lane):
                continue
            for other in others:
                for route in self._ways_over(other, (lane, *target.lanes_from(entered)), before=()):
                    if lane not in route:
                        continue
                    path = self.scene.path(route)
                    begin = next(s.start for s in path.segments if s.lane_id == lane)
                    ahead = begin + target.way - target.way[entered]
                    for at, off in self._moments(event, target):
                        gap = abs(begin - float(ahead[at])) - self._lengths(target)
                        order = 1 if begin > ahead[at] else -1
                        if not event.gap_band_m[0] <= gap <= event.gap_band_m[1]:
                            continue
                        yield from self._at_any_relation(
                            event, target, route, ahead=ahead, at=at, order=order, score=off, gap=gap
                        )

    def _crossings(self, event: Event, target: Target) -> Iterator[Plan]:
        """Across the target's path, before or behind it."""
        for lane, lane_s, crossed in self._crossed_lanes(target):
            for route in self._ways_over(lane, (), before=()):
                path = self.scene.path(route)
                segment = next(s for s in path.segments if s.lane_id == lane)
                share = lane_s / max(segment.lane_end, 1e-9)
                point = segment.start + share * (segment.end - segment.start)
                for number, apart in enumerate(_CROSS_APART_S):
                    for order in (1, -1):
                        at = crossed - order * round(apart / self.scene.step_s)
                        at_s = at * self.scene.step_s
                        spare = self.scene.config.event_search.moment_s
                        if not (event.at_s[0] - spare <= at_s <= event.at_s[1] + spare) or at_s < _SOONEST_S:
                            continue
                        if at >= self.scene.num_steps or not target.present[at]:
                            continue
                        gap = abs(float(target.way[crossed] - target.way[at])) - 0.5 * target.track.size.length_m
                        if not event.gap_band_m[0] <= gap <= event.gap_band_m[1]:
                            continue
                        for speed in self._speeds_of(lane):
                            yield self._steady(
                                event, target, route, point=point, at=at, order=order, speed=speed, score=0.1 * number
                            )

    def _overtakes(self, event: Event, target: Target) -> Iterator[Plan]:
        """From behind the target and faster, where it is slow enough to be overtaken within the scene."""
        overtake = self.scene.config.overtake
        first = int(np.flatnonzero(target.present)[0])
        lane = target.lane_at(first)
        mean = float(target.speed[target.present].mean())
        if lane is None or first > 0 or mean < overtake.parked_mps:
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
                plan = Plan(
                    event, target, route, start, np.full(self.scene.num_steps, speed),
                    round(event.at_s[0] / self.scene.step_s), -1, 0.05 * number, trigger_s=trigger,
                )  # fmt: skip
                yield plan

    # how a plan is driven

    def _at_any_relation(
        self, event: Event, target: Target, route: Route, *, ahead: FloatArray, at: int, order: int, score: float,
        gap: float | None = None,
    ) -> Iterator[Plan]:  # fmt: skip
        """Plans that keep to the target at each gap and speed difference asked for. gap: that of the place."""
        for asked, difference, more in self._relations(event):
            yield from self._keeping(
                event, target, route, ahead=ahead, at=at, order=order, gap=asked if gap is None else gap,
                difference=difference, score=score + more,
            )  # fmt: skip

    def _keeping(
        self, event: Event, target: Target, route: Route, *, ahead: FloatArray, at: int, order: int, gap: float,
        difference: float, score: float,
    ) -> Iterator[Plan]:  # fmt: skip
        """A vehicle that is at its gap, with its speed difference, at the moment, and keeps to the target from then on.

        ahead (T,): where the target is on the vehicle's path, m.
        """
        steps, step_s, lengths = self.scene.num_steps, self.scene.step_s, self._lengths(target)
        speed = float(target.speed[at]) + difference
        if not _SLOWEST_MPS <= speed <= _FASTEST_MPS:
            return
        starts_beside = event.kind in ("cut_in", "merge")
        place = float(ahead[at]) + order * (gap + lengths)
        speeds = np.empty(steps)
        if starts_beside:  # steady up to the change of lanes, then towards the target's speed
            change = max(0, at - round(0.5 * CHANGE_S / step_s)) if event.kind == "cut_in" else at
            speeds, _ = self._up_to(route, place, at, speed)
            if event.kind == "cut_in" and event.ttc_s is None and difference < 0.0:
                speeds[change : at + 1] = np.minimum(
                    speed + _SPEEDS_UP_MPS2 * step_s * np.arange(at + 1 - change), target.speed[at]
                )
        else:
            speeds[: at + 1] = np.maximum(target.speed[: at + 1] + difference * np.linspace(0.0, 1.0, at + 1), 0.0)
        start = place - float(speeds[1 : at + 1].sum()) * step_s
        s, v, cap = place, float(speeds[at]), self._cap(route, _FASTEST_MPS)
        brakes = event.brakes_mps2 if event.kind == "lead" else 0.0
        for step in range(at + 1, steps):
            t_speed, t_s = float(target.speed[step - 1]), float(ahead[step - 1])
            apart = order * (s - t_s) - lengths
            wanted = max(min(gap, 12.0), _AHEAD_GAP_M + _AHEAD_TIME_S * v)
            accel = _SPEED_PULL * (t_speed - v) + order * _GAP_PULL * (wanted - apart)
            accel = min(max(accel, _SLOWS_MPS2), _SPEEDS_UP_MPS2)
            if brakes and (step - at) * step_s <= _BRAKES_FOR_S:
                accel = -brakes
            v = max(0.0, min(v + accel * step_s, float(cap[min(max(int(s / TABLE_STEP_M), 0), cap.size - 1)])))
            s += v * step_s
            speeds[step] = v
        plan = Plan(event, target, route, start, speeds, at, order, score)
        if self._fits(plan, ahead):
            yield plan

    def _fits(self, plan: Plan, ahead: FloatArray) -> bool:
        """Whether the planned motion keeps to the criticality that is asked for, and to the critical values else."""
        event, conflict = plan.event, self.scene.config.conflict
        there = plan.target.present.copy()
        there[: plan.at_step] = False
        apart = plan.order * (plan.way - ahead) - self._lengths(plan.target)
        closing = plan.order * (plan.target.speed - plan.speeds)
        if (apart[there] < 1.0).any():
            return False
        with np.errstate(divide="ignore", invalid="ignore"):
            ttc = np.where(there & (closing > 0.05), apart / closing, np.inf)
            drac = np.where(there & (closing > 0.05), closing * closing / (2.0 * apart), 0.0)
        least = float(ttc.min())
        if event.drac_mps2 is not None and not event.drac_mps2[0] <= float(drac.max()) <= event.drac_mps2[1]:
            return False
        if event.ttc_s is not None:
            return event.ttc_s[0] + 0.1 <= least <= event.ttc_s[1]
        return least > conflict.ttc_min_s + 0.3

    def _steady(
        self, event: Event, target: Target, route: Route, *, point: float, at: int, order: int, speed: float,
        score: float,
    ) -> Plan:  # fmt: skip
        """A vehicle that comes to a point at a moment at a constant speed."""
        speeds, start = self._up_to(route, point, at, speed)
        cap, s = self._cap(route, speed), point
        for step in range(at + 1, self.scene.num_steps):
            speeds[step] = min(speed, float(cap[min(int(s / TABLE_STEP_M), cap.size - 1)]))
            s += float(speeds[step]) * self.scene.step_s
        return Plan(event, target, route, start, speeds, at, order, score)

    def _up_to(self, route: Route, place: float, at: int, speed: float) -> tuple[FloatArray, float]:
        """Speeds (T,) m/s of a vehicle that is at a place at a step, as fast as the road lets it up to a speed.

        Only those up to that step are filled in; and where it starts, m.
        """
        cap, s = self._cap(route, speed), place
        speeds = np.full(self.scene.num_steps, speed)
        for step in range(at, -1, -1):
            speeds[step] = min(speed, float(cap[min(max(int(s / TABLE_STEP_M), 0), cap.size - 1)]))
            if step:
                s -= float(speeds[step]) * self.scene.step_s
        return speeds, s

    def _cap(self, route: Route, speed: float) -> FloatArray:
        """(S,) m/s, what the road lets a vehicle drive at most at the table of its path."""
        key = route, speed
        if key not in self._caps:
            driver = Driver(
                desired_mps=speed, tau_s=1.0, accel_mps2=_SPEEDS_UP_MPS2, decel_mps2=-_SLOWS_MPS2, min_gap_m=2.0,
                turn_lateral_mps2=self.scene.config.drivers.turn_lateral_max_mps2, offset_m=0.0,
                lane_change_s=CHANGE_S,
            )  # fmt: skip
            self._caps[key] = self.roads.speeds(self.scene.path(route), driver)
        return self._caps[key]

    # the map

    def _lengths(self, target: Target) -> float:
        return 0.5 * (self.size.length_m + target.track.size.length_m)

    def _speeds_of(self, lane_id: int) -> tuple[float, ...]:
        pool = self.scene.lane_speeds.get(lane_id) or self.scene.scene_speeds
        usual = float(np.median(pool)) if pool else self.scene.config.spawn.prior_speed_mps
        return tuple(min(max(share * usual, _SLOWEST_MPS), _FASTEST_MPS) for share in (1.0, 0.8, 0.6, 1.2))

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
        """Whether the route is long enough for the plan, and no box, everybody recorded, is met by it."""
        scene, path = self.scene, self.scene.path(plan.route)
        way = plan.way
        if plan.start_s < 0.5 * self.box.length_m + 0.5:
            return False
        inside = way < path.exit_s - 0.5 * self.box.length_m - 1.0
        needed = max(scene.first_exit_step, min(plan.at_step + scene.steps_in(_ON_PATH_S), scene.num_steps))
        return bool(inside[:needed].all())

    def trajectory(self, plan: Plan) -> Trajectory:
        """The plan as poses, without the driver's place in the lane; on the lane beside after a change of lanes."""
        path = self.scene.path(plan.route)
        xy, tangent, _ = path.line.motion(np.minimum(plan.way, path.exit_s))
        steps = int((plan.way <= path.exit_s).sum())
        shift = np.zeros(len(xy))
        if plan.side is not None:
            target = plan.target.position[plan.at_step]
            normal = np.array([-tangent[plan.at_step, 1], tangent[plan.at_step, 0]])
            wide = float((target - xy[plan.at_step]) @ normal)
            tau: FloatArray = (np.arange(len(xy), dtype=np.float64) * self.scene.step_s - plan.trigger_s) / CHANGE_S
            shift = wide * lateral_share(tau)
        normals = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
        return Trajectory(
            position=np.ascontiguousarray((xy + shift[:, None] * normals)[:steps]),
            heading=np.ascontiguousarray(np.arctan2(tangent[:, 1], tangent[:, 0])[:steps]),
            velocity=np.ascontiguousarray((tangent * plan.speeds[:, None])[:steps]),
            s=plan.way[:steps],
        )
