"""Starts: whether a vehicle can begin at a site, with which driver, and how fast."""

import math
from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from hid2.agents import DEFAULT_SIZES, BoxSize, Policy
from hid2.conflicts.guard import Guard, Obstacles
from hid2.conflicts.stop_lines import StopLines
from hid2.drivers.driver import Driver, desired_speeds, draw_driver, free_speeds, lane_offset
from hid2.insertion.meetings import Meetings
from hid2.insertion.routes import RouteOffer
from hid2.insertion.sizes import draw_size
from hid2.kernels.path_intervals import SAME_WAY
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.motion.route import DrivenPath, first_turn
from hid2.occupancy.along_path import PathOccupancy
from hid2.occupancy.gaps import gaps_from_pose, gaps_on_path, gaps_to_all
from hid2.occupancy.traffic import Traffic
from hid2.params import Sites
from hid2.policy.behaviours import TURN_OF_POLICY
from hid2.policy.decision import Side, gap_view
from hid2.policy.lane_change import NOBODY, Gap
from hid2.policy.observation import lane_options, lay_across, own_gaps
from hid2.policy.roads import Roads
from hid2.policy.rules import expected_reason, foreseen_reason
from hid2.reasons import Reason
from hid2.scene import Scene, clearance_box
from hid2.vehicle import Start, VehicleRequest

#: Verdicts that another driver may change.
_ANOTHER_DRIVER = frozenset({Reason.TTC_RECORDED_FOLLOWER, Reason.LEAVES_TOO_EARLY})
_BESIDE_MOST_M = 80.0  # no tunable, spares time: two starts farther apart have nothing to do with each other


@dataclass(slots=True)
class Starts:
    """Starts of one round; each keeps clear of those that were taken before it."""

    scene: Scene
    roads: Roads
    stop_lines: StopLines
    meetings: Meetings
    guard: Guard
    rng: np.random.Generator
    round_number: int
    taken: list[Start] = field(default_factory=list)
    rejected: Counter[Reason] = field(default_factory=Counter)
    _obstacles: dict[tuple[DrivenPath, BoxSize], Obstacles] = field(default_factory=dict)
    _foreseen: dict[tuple[float, int], Traffic] = field(default_factory=dict)

    def take(self, starts: list[Start]) -> list[Start]:
        """The same starts; those after them keep clear of them."""
        self.taken += starts
        return starts

    def make(
        self, request: VehicleRequest, offer: RouteOffer, lane_id: int, s: float | None, *,
        driver: Driver | None = None, speed_mps: float | None = None, likely: bool = False, step: int = 0,
        led_by: int = -1,
    ) -> Start | Reason:  # fmt: skip
        """A vehicle with a driver at a site, with a start speed, m/s, or why it cannot begin there.

        s: along the route's lanes, m; None: at their beginning, all of it on them. step: from which on it is there;
        led_by: whom it would follow then.
        """
        scene, config, rng = self.scene, self.scene.config, self.rng
        object_type, size = draw_size(config.request, rng)
        box = clearance_box(size, DEFAULT_SIZES[object_type])
        half_m, run_on = box.length_m / 2, "topology" in config.without
        first_m = half_m + config.sites.from_edge_m
        if s is None:  # it has come over the edge since the step before
            s = first_m + float(rng.random()) * self.meetings.usual_speed(lane_id) * scene.step_s
        if s < first_m or (s + half_m > offer.length_m - 1.0 and not run_on):
            return Reason.NO_SITE
        if step == 0 and self._meets_taken_roughly(lane_id, s - offer.start_m, box):
            return Reason.NO_SITE
        path = scene.path(offer.route)
        start_s = path.to_line(s)
        if "collision" not in config.without and self._is_taken(path, box, start_s, step):
            return Reason.NO_SITE
        reach_s: float | None = None
        if request.policy in TURN_OF_POLICY:
            turn = first_turn(scene.grid.graph, path, TURN_OF_POLICY[request.policy], after=start_s)
            if turn is None:
                return Reason.TURN_NOT_SEEN
            reach_s = turn.end + 1.0 if likely else None
        elif likely and (step > 0 or request.policy is not Policy.STRAIGHT):  # who changes lanes or enters is under way
            pace_mps = config.sites.under_way_share * self.meetings.usual_speed(lane_id)
            reach_s = start_s + pace_mps * (scene.last_s - step * scene.step_s)
        led_mps = 0.0
        if config.request.sites == "promising":
            leader = led_by if step else self.meetings.leader_of(scene.cell_at(path, start_s), offer.route)
            led_mps = self.meetings.pace_of(leader)
        verdict: Reason = Reason.NO_SITE
        for _ in range(1 if driver is not None else config.sites.drivers):
            # who follows at a usual gap drives as fast as the leader at least, or would not be there
            pace_mps = max(scene.lane_speed(lane_id, rng), led_mps)
            who = driver or draw_driver(config, rng, lane_speed_mps=pace_mps)
            speed = speed_mps
            if speed is None:
                speed = who.desired_mps * (1.0 + config.spawn.speed_sd * min(max(rng.standard_normal(), -2.0), 2.0))
            found = self._start_speed(offer, path, box, s, start_s, speed, who, reach_s, step)
            if not isinstance(found, Reason):
                break
            verdict = found
            if found not in _ANOTHER_DRIVER:
                return found
        else:
            return verdict
        speed = found
        sides: tuple[Side, ...] = ("left", "right") if rng.random() < 0.5 else ("right", "left")
        if (
            likely
            and request.policy is Policy.LANE_CHANGE
            and not self._gap_likely(path, box, start_s, speed, request, who)
        ):
            return Reason.CELLS_OCCUPIED
        wished = desired_speeds(
            who, config, rng, num_steps=scene.num_steps - step, step_s=scene.step_s, at_least_mps=speed
        )
        return Start(
            vehicle_id=f"v{request.number}_{self.round_number}", request=request, object_type=object_type, size=size,
            box=box, route=offer.route, path=path, start_s=start_s, start_mps=speed, driver=who,
            desired=np.concatenate([np.full(step, wished[0]), wished]),
            offset=lane_offset(who, config, rng, length_m=path.line.length_m), sides=sides, step=step,
        )  # fmt: skip

    def _gap_likely(
        self, path: DrivenPath, box: BoxSize, s: float, speed_mps: float, request: VehicleRequest, driver: Driver
    ) -> bool:
        """Whether a vehicle that drives on finds a gap beside it soon after its trigger, and a way into it in time.

        A gap that the rule of the configuration takes.
        """
        scene, change = self.scene, self.scene.config.lane_change
        for wait_s in self.scene.config.sites.gap_waits_s:
            at_s = request.trigger_s + wait_s
            step = round(at_s / scene.step_s)
            if step >= scene.num_steps:
                break
            at, v = self._place_after(path, box, s, speed_mps, driver, at_s)
            if at > path.exit_s:
                break
            options = lane_options(
                scene, path, box, s=at, step=step, sides=("left", "right"), fixed=self.guard.fixed,
                fleet=self._taken_at(at_s), speed_mps=v, desired_mps=driver.desired_mps,
            )  # fmt: skip
            own = own_gaps(
                scene, path, box, s=at, step=step, fixed=self.guard.fixed, fleet=self._taken_at(at_s)
            )  # fmt: skip
            wished = np.full(scene.num_steps - step, driver.desired_mps)
            foreseen = free_speeds(driver, wished, speed_mps=v, step_s=scene.step_s)
            for option, target in options:
                view = gap_view(
                    option, driver, time_s=at_s, waited_s=wait_s, speed_mps=v, length_m=box.length_m, own=own
                )  # fmt: skip
                if foreseen_reason(view, change) is not None:
                    continue
                across = lay_across(
                    scene, path, target, s=at, step=step, speed_mps=foreseen, remaining_m=option.remaining_m,
                    driver=driver,
                )  # fmt: skip
                if isinstance(across, DrivenPath):
                    return True
        return False

    def _place_after(
        self, path: DrivenPath, box: BoxSize, s: float, speed_mps: float, driver: Driver, time_s: float
    ) -> tuple[float, float]:
        """Where a vehicle is after some time, m on its path, and how fast, m/s: as before, or behind who is ahead."""
        known, step = self._known_on(path, box), round(time_s / self.scene.step_s)
        at, led = s + speed_mps * time_s, np.isfinite(gaps_to_all(known, np.array([s]), 0).lead_m)
        found = gaps_on_path(known, np.array([s]), step, among=known.same_direction & led)
        leader_mps = float(found.lead_mps[0])
        behind = s + float(found.lead_m[0]) - driver.min_gap_m - driver.tau_s * leader_mps
        return (at, speed_mps) if behind >= at else (max(s, behind), leader_mps)

    def _taken_at(self, time_s: float) -> Traffic:
        """The other starts of this round after some time, each at its start speed (one step)."""
        count, step_s = len(self.taken), self.scene.step_s
        if (time_s, count) not in self._foreseen:
            lasting_s = [time_s - start.step * step_s for start in self.taken]
            places = [
                np.array([start.start_s + start.start_mps * max(0.0, since_s)])
                for start, since_s in zip(self.taken, lasting_s, strict=True)
            ]
            poses = [start.path.line.motion(at) for start, at in zip(self.taken, places, strict=True)]
            tangent = np.array([tangent[0] for _, tangent, _ in poses]).reshape(count, 1, 2)
            self._foreseen[time_s, count] = Traffic(
                ids=tuple(start.vehicle_id for start in self.taken),
                position=np.array([xy[0] for xy, _, _ in poses]).reshape(count, 1, 2),
                heading=np.arctan2(tangent[..., 1], tangent[..., 0]),
                velocity=tangent * np.array([start.start_mps for start in self.taken])[:, None, None],
                present=np.array([since_s >= 0.0 for since_s in lasting_s], dtype=np.bool_).reshape(count, 1),
                length_m=np.array([start.box.length_m for start in self.taken]),
                width_m=np.array([start.box.width_m for start in self.taken]),
            )  # fmt: skip
        return self._foreseen[time_s, count]

    def _start_speed(
        self, offer: RouteOffer, path: DrivenPath, box: BoxSize, s: float, start_s: float, speed: float,
        driver: Driver, reach_s: float | None, step: int,
    ) -> float | Reason:  # fmt: skip
        """Speed at which a driver who would like to drive at `speed` begins, m/s; or why it cannot begin there.

        s, start_s: the site along the route's lanes and on the path, m; reach_s: where it has to get unhindered.
        """
        limits, export = self.scene.config.limits, self.scene.config.export
        if self.leaves_early(offer, s + box.length_m / 2, 0.95 * speed, step):
            return Reason.LEAVES_TOO_EARLY
        reach = slice(int(start_s / TABLE_STEP_M), int((start_s + 12.0 * speed) / TABLE_STEP_M) + 2)
        if np.abs(path.line.table_curvature[reach]).max(initial=0.0) > export.limit_share / limits.min_radius_m:
            return Reason.LIMIT_CURVATURE
        road = self.roads.speeds(path, driver)
        speed = min(speed, float(road[min(int(start_s / TABLE_STEP_M), road.size - 1)]))
        if "collision" in self.scene.config.without:
            return speed
        return self._admitted_speed(path, box, start_s, speed, driver, reach_s, step)

    def leaves_early(self, offer: RouteOffer, s: float, speed_mps: float, step: int = 0) -> bool:
        """Whether the map ends before the last observed step at a speed."""
        if "topology" in self.scene.config.without:
            return False
        return offer.length_m - s < speed_mps * self.scene.steps_to_stay(step) * self.scene.step_s

    def _is_taken(self, path: DrivenPath, box: BoxSize, s: float, step: int) -> bool:
        """Whether somebody recorded or kept is at a place at the start, or too near to it."""
        near = gaps_on_path(self._known_on(path, box), np.array([s]), step)
        return bool(min(near.lead_m[0], near.lag_m[0]) < self.scene.config.spawn.clear_gap_m)

    def _known_on(self, path: DrivenPath, box: BoxSize) -> PathOccupancy:
        return self._obstacles_on(path, box).known

    def _obstacles_on(self, path: DrivenPath, box: BoxSize) -> Obstacles:
        key = path, box
        if key not in self._obstacles:
            self._obstacles[key] = self.guard.obstacles(path, box, [])
        return self._obstacles[key]

    def _admitted_speed(
        self, path: DrivenPath, box: BoxSize, s: float, speed: float, driver: Driver, reach_s: float | None, step: int
    ) -> float | Reason:
        """Speed that who is ahead allows, m/s, at most the one wished for; or why nobody can begin there."""
        conflict, spawn, sites = self.scene.config.conflict, self.scene.config.spawn, self.scene.config.sites
        seen, wished = gaps_to_all(self._known_on(path, box), np.array([s]), step), speed
        for row in np.flatnonzero(np.isfinite(seen.lead_m[:, 0])).tolist():
            speed = min(speed, speed_behind(float(seen.lead_m[row, 0]), float(seen.along_mps[row, 0]), driver, sites))
        stop = self.stop_lines.arrays(path, box).braking(driver, s=s, speed_mps=speed, step=step)
        if stop is not None and stop[0] < -driver.decel_mps2:
            return Reason.CONFLICT_PREDICTED
        beside = self._beside_taken(path, box, s, speed, driver, step)
        if beside is None:
            return Reason.NO_SITE
        speed = beside
        if step > 0 and (speed < sites.standing_mps or self._follower_is_near(path, s, box, speed, step)):
            return Reason.NO_SITE
        if speed < max(sites.standing_mps, sites.slowest_share * wished):
            if not np.any((seen.lead_m < sites.queue_m) & (seen.along_mps < sites.standing_mps)):
                return Reason.NO_SITE  # nobody drives so slowly with so much room ahead
            speed = 0.0
        fleet = np.array([[s, speed, 0.0, 0.0, 1.0]])
        found = self.guard.braking(
            self._obstacles_on(path, box), own=0, step=step, fleet=fleet, state=(s, speed, 0.0),
            desired_mps=driver.desired_mps, road=self.roads.speeds(path, driver), driver=driver,
            horizon_s=self.scene.last_s - step * self.scene.step_s,
        )  # fmt: skip
        if found.run_into:
            return Reason.TTC_RECORDED_FOLLOWER
        soon = found.free_conflict_s is not None and found.free_conflict_s < conflict.horizon_s
        if found.conflict_s is not None and found.conflict_s < spawn.settle_s:
            return Reason.CONFLICT_PREDICTED
        if soon and found.decel_mps2 > sites.braking_ratio * driver.decel_mps2:
            return Reason.CONFLICT_PREDICTED
        if reach_s is not None and found.free_s < reach_s:
            return Reason.CONFLICT_PREDICTED
        return speed

    def _follower_is_near(self, path: DrivenPath, s: float, box: BoxSize, speed_mps: float, step: int) -> bool:
        """Whether somebody comes from behind at a step, as recorded or kept, on the lane or before the map's edge."""
        config = self.scene.config
        here = self.scene.traffic.at(step)
        here = here.joined(self.guard.fixed.at(step)) if self.guard.fixed.ids else here
        xy, forward, _ = path.line.motion(np.array([s]))
        seen = gaps_from_pose(xy, forward, box, here)
        least_m = np.maximum(
            config.spawn.clear_gap_m, config.conflict.follower_ttc_min_s * (seen.along_mps - speed_mps)
        )  # fmt: skip
        near = (seen.aside_m < config.conflict.margin_lateral_m) & (seen.gap_m > -box.length_m)
        return bool(np.any(near & (seen.gap_m < least_m) & here.present[:, 0] & (seen.along_m < 0.0)))

    def _beside_taken(
        self, path: DrivenPath, box: BoxSize, s: float, speed: float, driver: Driver, step: int
    ) -> float | None:
        """Fastest start speed beside the other starts of this round, m/s; None where one of them is too near.

        As they are when the later of the two begins, each at its start speed.
        """
        if not self.taken:
            return speed
        sites, step_s, there = self.scene.config.sites, self.scene.step_s, self._taken_at(step * self.scene.step_s)
        waits_s = np.array([step_s * max(0, other.step - step) for other in self.taken])
        xy, forward, _ = path.line.motion(s + speed * waits_s)
        seen, offset = gaps_from_pose(xy, forward, box, there), xy - there.position[:, 0]
        ways = np.stack([np.cos(there.heading[:, 0]), np.sin(there.heading[:, 0])], axis=1)
        same_way, ahead_of_other = (ways * forward).sum(axis=1) >= SAME_WAY, (ways * offset).sum(axis=1)
        for row in np.flatnonzero(np.hypot(*offset.T) <= _BESIDE_MOST_M).tolist():
            other, gap, ahead_m = self.taken[row], float(seen.gap_m[row]), float(ahead_of_other[row])
            aside = seen.aside_m[row] + 0.5 * (box.width_m + other.box.width_m) <= sites.pass_beside_m
            near = -sites.pass_behind_m < ahead_m < sites.pass_ahead_m and aside
            if other.request.policy is Policy.OVERTAKE and near and same_way[row]:
                return None  # nor between it and its leader
            if seen.aside_m[row] > 0.5:
                if same_way[row] and aside and self._in_the_gap(other, ahead_m, speed, box):
                    return None
            elif not same_way[row]:
                if gap <= sites.crossing_gap_m:
                    return None
            elif seen.along_m[row] > 0:
                if gap <= self.scene.config.spawn.clear_gap_m:
                    return None
                speed = min(speed, speed_behind(gap, other.start_mps, driver, sites))
            elif speed_behind(gap, speed, other.driver, sites) < other.start_mps:
                return None
        return speed

    def _in_the_gap(self, changes: Start, ahead_m: float, speed_mps: float, box: BoxSize) -> bool:
        """Whether a vehicle ahead_m ahead on a lane beside is in the way of another one's change, at its trigger."""
        if changes.request.policy is not Policy.LANE_CHANGE:
            return False
        at_m = ahead_m + (speed_mps - changes.start_mps) * changes.request.trigger_s
        gap = Gap(abs(at_m) - 0.5 * (changes.box.length_m + box.length_m), speed_mps)
        front, rear = (gap, NOBODY) if at_m > 0.0 else (NOBODY, gap)
        change = self.scene.config.lane_change
        found = expected_reason(changes.driver, change, speed_mps=changes.start_mps, front=front, rear=rear)
        return found is not None

    def _meets_taken_roughly(self, lane_id: int, lane_s: float, box: BoxSize) -> bool:
        point, there = self.scene.grid.graph.lanes[lane_id].path.point(np.array([lane_s])), self._taken_at(0.0)
        apart = np.hypot(*(there.position[:, 0] - point).T)
        return bool((apart < np.minimum(box.width_m, there.width_m)).any())


def speed_behind(gap_m: float, leader_mps: float, driver: Driver, sites: Sites) -> float:
    """Fastest speed at which a driver may begin behind a leader without having to brake (IDM), m/s."""
    room = math.sqrt(1.0 + sites.begin_braking_mps2 / driver.accel_mps2) * gap_m - driver.min_gap_m
    if room <= 0.0:
        return 0.0
    # v tau + v max(0, v - v_l) / (2 sqrt(a b)) = room
    c = 2.0 * math.sqrt(driver.accel_mps2 * driver.decel_mps2)
    b = driver.tau_s * c - leader_mps
    return min(room / driver.tau_s, 0.5 * (-b + math.sqrt(b * b + 4.0 * c * room)))
