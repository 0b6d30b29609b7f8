"""Plans for an event with a recorded target: on which route, from where, how fast, and when to change lanes.

A plan is worked out from the recorded future: of the target, and of everybody else who would be met. Which motions are
wanted is in `insertion/event_courses.py`, how they go on in `insertion/event_motions.py`. What comes of a plan when
SUMO drives is another matter (`insertion/events.py`). An overtake is foreseen as any other one is
(`insertion/overtakes.py`), of the target alone: its driver holds to no speed, and the manoeuvre is Algorithm 1's.
"""

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from hid2.agents import BoxSize, FloatArray, IntArray
from hid2.conflicts.guard import Guard
from hid2.drivers.driver import Driver, draw_driver, usual_driver
from hid2.insertion.event_courses import Course, Courses
from hid2.insertion.event_motions import Fan, first_met_s, kept_to, motions
from hid2.insertion.event_paths import EventPaths
from hid2.insertion.event_targets import Target
from hid2.insertion.overtakes import Overtakes
from hid2.insertion.routes import Routes
from hid2.motion.lane_change_path import LateralTiming
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.motion.route import Route
from hid2.occupancy.traffic import BoolArray
from hid2.params import Config, Event, EventSearch
from hid2.policy.decision import Side
from hid2.policy.observation import admissible_neighbor
from hid2.policy.roads import Roads
from hid2.policy.rules import expected_reason
from hid2.reasons import Reason
from hid2.scene import Scene

_LOOKS_S = 0.5  # between looks at stop lines by plan; no tunable, spares time: driving looks at every step
_MANY_ROUTES = 9973  # a prime: routes are told apart by the sum of their lane ids over it; no tunable


@dataclass(frozen=True, eq=False, slots=True)
class Plan:
    """How an event may come about.

    speeds (T,) m/s as planned; at_step: the moment of the event; trigger_s, side: of the change of lanes;
    order: -1 where the vehicle is behind the target, or crosses second, else 1; score: how far from the middle of what
    is asked; desired_mps, tau_s: what its driver drives at most, and its time gap; traits: what it shares with plans
    that are like it; driver: of an overtake that is foreseen, who drives freely: speeds are what it starts with and
    what it wishes.
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
    tau_s: float
    trigger_s: float = 0.0
    side: Side | None = None
    driver: Driver | None = None

    @property
    def way(self) -> FloatArray:
        """(T,) m, arc length on the path by plan."""
        return self.start_s + np.concatenate([[0.0], np.cumsum(self.speeds[1:]) * self.target.step_s])

    def moved(self, *, forward_m: float, later_s: float) -> "Plan":
        """The same from farther ahead, with a later change of lanes."""
        return replace(self, start_s=self.start_s + forward_m, trigger_s=max(0.0, self.trigger_s + later_s))


def hurried_driver(
    config: Config, rng: np.random.Generator, *, desired_mps: float, tau_s: float, lane_change_s: float
) -> Driver:
    """Who brings an event about: a driver drawn as any other, but as brisk as `event_search` has it."""
    search = config.event_search
    return replace(
        draw_driver(config, rng, lane_speed_mps=desired_mps), desired_mps=desired_mps, tau_s=tau_s,
        turn_lateral_mps2=config.drivers.turn_lateral_max_mps2, accel_mps2=search.accel_mps2,
        decel_mps2=search.decel_mps2, min_gap_m=search.min_gap_m, lane_change_s=lane_change_s,
    )  # fmt: skip


@dataclass(slots=True)
class Planner:
    """Plans of one scene for a vehicle of a size; box: what is kept clear for it; guard: with the vehicles kept.

    turned_down: motions that were no plans, by reason.
    """

    scene: Scene
    routes: Routes
    roads: Roads
    size: BoxSize
    box: BoxSize
    guard: Guard
    turned_down: Counter[Reason] = field(default_factory=Counter)
    _paths: EventPaths = field(init=False)
    _foresight: Overtakes = field(init=False)

    def __post_init__(self) -> None:
        """Nothing is known of any path yet."""
        self._paths = EventPaths(self.scene, self.routes, self.roads, self.box, self.guard.fixed)
        self._foresight = Overtakes(self.scene, self.routes, self.roads, self.guard, self.box)

    def plans(self, event: Event, target: Target) -> list[Plan]:
        """Plans for an event with a target, the likeliest ones first."""
        lengths_m = 0.5 * (self.size.length_m + target.track.size.length_m)
        if event.kind == "overtake":
            found = list(self._overtakes(event, target))
        else:
            found = []
            courses = list(Courses(self._paths, event, target, lengths_m).all())
            for tau_s in self._search.taus_s:
                if len(found) < self._search.plans:  # no more of a target are looked at
                    found += [plan for course in courses for plan in self._free(event, target, course, tau_s)]
        return sorted((plan for plan in found if self._rule_lets(plan)), key=lambda plan: plan.score)

    def _rule_lets(self, plan: Plan) -> bool:
        """Whether the configured rule would change lanes where a plan expects it, with nobody on the lane beside."""
        if plan.side is None:
            return True
        speed_mps = float(plan.speeds[min(self.scene.steps_in(plan.trigger_s), plan.speeds.size - 1)])
        driver = plan.driver or usual_driver(plan.desired_mps)
        reason = expected_reason(driver, self.scene.config.lane_change, speed_mps=speed_mps)
        if reason is not None:
            self.turned_down[reason] += 1
        return reason is None

    def has_plan(self, event: Event, target: Target) -> bool:
        """Whether any of the plans that would be tried is one that road and stop lines let be driven."""
        rng = np.random.default_rng(target.row)
        plans = self.plans(event, target)[: self._search.plans]
        return any(self.objection(plan, self.driver_of(plan, rng), self.box) is None for plan in plans)

    def driver_of(self, plan: Plan, rng: np.random.Generator) -> Driver:
        """Who drives a plan."""
        if plan.driver is not None:
            return plan.driver
        driver = hurried_driver(
            self.scene.config, rng, desired_mps=plan.desired_mps, tau_s=plan.tau_s, lane_change_s=self._search.change_s
        )
        return replace(driver, decel_mps2=max(driver.decel_mps2, plan.event.brakes_mps2))

    def objection(self, plan: Plan, driver: Driver, box: BoxSize) -> Reason | None:
        """What road and stop lines have against a plan before SUMO is asked; None for nothing."""
        scene, path, search = self.scene, self.scene.path(plan.route), self._search
        if plan.driver is not None:  # foreseen with the road and the lines
            return None
        until = min(plan.at_step + scene.steps_in(search.after_s), scene.num_steps)
        if plan.side is not None:  # then it is on another path
            until = scene.steps_in(plan.trigger_s) + 1
        way = plan.way
        if way[0] < 0.5 * box.length_m:
            return Reason.NO_SITE
        table = self.roads.speeds(path, driver)
        asked = table[np.minimum((way / TABLE_STEP_M).astype(np.int64), table.size - 1)]
        if (plan.speeds[:until] > asked[:until] + search.road_spare_mps).any():
            return Reason.TOO_SLOW
        closed = self.guard.stop_lines.arrays(path, box)
        for step in range(0, until, scene.steps_in(_LOOKS_S)):
            stop = closed.braking(driver, s=float(way[step]), speed_mps=float(plan.speeds[step]), step=step)
            if stop is not None and stop[0] < 0.0:
                return Reason.CONFLICT_PREDICTED
        return None

    @property
    def _search(self) -> EventSearch:
        return self.scene.config.event_search

    def _overtakes(self, event: Event, target: Target) -> Iterator[Plan]:
        """Foreseen ones, back in the lane ahead of the target at the time asked for; drivers no faster than needed."""
        scene, search = self.scene, self._search
        foresight, (earliest_s, latest_s) = self._foresight, event.at_band_s
        pace = float(target.speed[target.present].mean())
        least, most = event.difference_band_mps
        least = max(least, scene.config.overtake.speed_advantage_mps)
        if least > most:
            return
        rng = np.random.default_rng(target.row)
        drivers = [
            hurried_driver(
                scene.config,
                rng,
                tau_s=max(search.taus_s),
                lane_change_s=change_s,
                desired_mps=min(pace + least + share * (most - least), scene.config.spawn.max_speed_mps),
            )
            for change_s, share in product(search.overtake_changes_s, search.band_shares)
        ]
        triggers = np.arange(0.0, latest_s, scene.config.foresight.waits_s).tolist()
        target_lanes = set(target.lanes_from(0))
        for offer, lane_id, side in self.routes.ways_past():
            if target_lanes.isdisjoint(offer.route):
                continue
            way = foresight.way(offer, lane_id, side, reach_m=scene.config.spawn.max_speed_mps * latest_s)
            if way is None:
                continue
            for (number, driver), trigger_s in product(enumerate(drivers), triggers):
                # whoever asks for it, scan or generate, at whatever time, looks at the same motions
                rng = np.random.default_rng([target.row, lane_id, number, scene.steps_in(trigger_s)])
                back_s = 0.5 * foresight.timing(way, driver).lasting_s
                found = foresight.foresee(way, driver, rng, trigger_s=trigger_s, lead=False, leader=target.row)
                self.turned_down[Reason.NO_OVERTAKE_FORESEEN] += not found
                for one in found[:: math.ceil(len(found) / search.overtake_starts) or 1]:
                    at_s = one.done_s - back_s
                    if not earliest_s - search.moment_s <= at_s <= latest_s + search.moment_s:
                        continue
                    off = abs(at_s - 0.5 * (earliest_s + latest_s)) / max(
                        0.5 * (latest_s - earliest_s), search.moment_s
                    )
                    traits = float(sum(offer.route) % _MANY_ROUTES), trigger_s, driver.desired_mps, driver.lane_change_s
                    speeds = np.full(scene.num_steps, driver.desired_mps)
                    speeds[0] = one.start_mps
                    yield Plan(
                        event, target, offer.route, one.start_s, speeds, round(at_s / scene.step_s), 1,
                        search.off_moment * off + search.off_difference * (driver.desired_mps - pace),
                        driver.desired_mps, traits, driver.tau_s, trigger_s=trigger_s, side=side,
                        driver=driver,
                    )  # fmt: skip

    def _free(self, event: Event, target: Target, course: Course, tau_s: float) -> list[Plan]:
        """Plans of a course that the road has room for, that meet nobody, and that are as critical as is asked for."""
        wanted, off = course.wanted, course.off
        if not wanted.at.size:
            return []
        step_s, rules, search = self.scene.step_s, replace(course.rules, tau_s=tau_s), self._search
        most = np.minimum(course.before.at(wanted.place), course.after.at(wanted.place + course.after.from_m))
        wanted = replace(wanted, speed_mps=np.minimum(wanted.speed_mps, most))  # as fast as the road lets it
        low, high = event.difference_band_mps
        difference = wanted.speed_mps - target.speed[wanted.at]
        fast = (wanted.speed_mps >= search.slowest_mps) & (difference >= low) & (difference <= high)
        keep = self._still(fast, np.ones(fast.size, dtype=np.bool_), Reason.TOO_SLOW)
        fan = motions(wanted, rules, course.before, course.after)
        begins = self._begins(course, fan)
        keep = self._still(self._has_room(course, fan, begins), keep, Reason.NO_SITE)
        keep = self._still(self._may_change(course, fan, begins), keep, Reason.NO_ADJACENT_LANE)
        if rules.ahead is not None:
            least, drac = kept_to(fan, rules, course.after.is_own_there[: target.present.size])
            keep = self._still(self._is_critical(event, least, drac), keep, Reason.EVENT_NOT_AS_ASKED)
        if not keep.any():
            return []
        wanted, off, fan, begins = wanted.rows(keep), off[keep], fan.rows(keep), begins[keep]
        until = first_met_s(fan, rules, course.before, course.after)
        late = until - wanted.at * step_s
        rows = np.flatnonzero(
            self._still(late > search.after_s, np.ones(late.size, dtype=np.bool_), Reason.MEETS_RECORDED)
        )
        # somebody is met in the end: a driver may see to it
        score = (
            off[rows]
            + search.off_tau * (max(search.taus_s) - tau_s)
            + np.where(np.isinf(until[rows]), 0.0, search.off_met)
        )
        found = []
        for place in np.argsort(score, kind="stable")[: search.route_plans].tolist():
            row = int(rows[place])
            speeds, way = fan.motion(row)
            traits = (
                float(sum(course.route) % _MANY_ROUTES), float(wanted.at[row]), float(wanted.gap_m[row]),
                float(wanted.speed_mps[row]), float(np.nan_to_num(wanted.before_mps2[row], nan=9.0)),
                float(np.nan_to_num(wanted.later_mps[row], nan=-1.0)),
            )  # fmt: skip
            plan = Plan(
                event, target, course.route, float(way[0]), speeds, int(wanted.at[row]), rules.order,
                float(score[place]), course.desired_mps, traits, tau_s,
            )  # fmt: skip
            if course.side is not None:
                plan = replace(plan, trigger_s=float(begins[row]) * step_s, side=course.side)
            found.append(plan)
        return found

    def _still(self, holds: BoolArray, before: BoolArray, reason: Reason) -> BoolArray:
        """Those for whom something holds, of those before; the others are counted."""
        self.turned_down[reason] += int((before & ~holds).sum())
        return before & holds

    def _has_room(self, course: Course, fan: Fan, begins: IntArray) -> BoolArray:
        """(N,) whether motions begin and go on, after the moment, on the map."""
        scene, at, half_m = self.scene, course.wanted.at, 0.5 * self.box.length_m
        needed = np.minimum(
            np.maximum(scene.first_exit_step, at + scene.steps_in(self._search.after_s)), scene.num_steps - 1
        )
        end = course.after.exit_m - course.after.from_m - half_m - 1.0
        found = (fan.way_at(np.zeros_like(at)) >= half_m + 0.5) & (fan.way_at(needed) < end)
        if course.side is not None:
            change = self.scene.config.lane_change
            left = course.after.exit_m - course.after.from_m - fan.way_at(begins)
            pace = 0.5 * (course.wanted.speed_mps + course.desired_mps)
            found &= left > np.maximum(change.min_remaining_m, change.min_duration_s * pace / change.length_share) + 1.0
            found &= fan.way_at(at) < course.before.exit_m - half_m - 1.0
        return found

    def _begins(self, course: Course, fan: Fan) -> IntArray:
        """(N,) steps at which changes of lanes begin that are half done at the moments; -1 where that is too early."""
        half = fan.until
        if course.side is None:
            return np.zeros(fan.at.size, dtype=np.int64)
        timing = LateralTiming.of(self._search.change_s, course.apart_m, self.scene.config.lane_change)
        gained = timing.gained(half.speeds, self.scene.step_s)  # 0 behind the moment
        done = np.cumsum(gained[:, ::-1], axis=1)[:, ::-1] - gained  # from the end of each step on
        return np.asarray((done >= 0.5).sum(axis=1) - 1)[half.of]

    def _may_change(self, course: Course, fan: Fan, begins: IntArray) -> BoolArray:
        """(N,) whether the marking lets a vehicle over when it begins to change lanes and when it crosses."""
        wanted, side, path = course.wanted, course.side, self.scene.path(course.route)
        found = np.ones(wanted.at.size, dtype=np.bool_)
        if side is None:
            return found
        ends = np.array([segment.end for segment in path.segments])
        may = np.array([admissible_neighbor(self.scene, one.lane_id, side) is not None for one in path.segments])
        found &= begins >= 0
        front_m = 0.5 * self.size.length_m  # SUMO has the front bumper on a lane, and it goes on for the coming step
        asked = fan.way_at(np.minimum(begins + 1, self.scene.num_steps - 1)) + front_m
        for s in (fan.way_at(begins), asked, fan.way_at(wanted.at)):
            found &= may[np.minimum(np.searchsorted(ends, s, side="right"), ends.size - 1)]
        return found

    def _is_critical(self, event: Event, least_s: FloatArray, drac: FloatArray) -> BoolArray:
        """(N,) whether the criticality is what is asked for, and not below the critical values else."""
        found = least_s > 0.0
        if event.drac_mps2 is not None:
            found &= (event.drac_mps2[0] <= drac) & (drac <= event.drac_mps2[1])
        if event.ttc_s is None:
            return np.asarray(found & (least_s > self.scene.config.conflict.ttc_min_s + self._search.ttc_spare_s))
        wide = min(self._search.ttc_edge_s, self._search.edge_share * (event.ttc_s[1] - event.ttc_s[0]))
        return np.asarray(found & (event.ttc_s[0] + wide <= least_s) & (least_s <= event.ttc_s[1] - wide))
