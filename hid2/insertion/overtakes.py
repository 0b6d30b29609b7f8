"""Where and when an overtake fits into the recorded traffic: many motions at once, foreseen before anything is driven.

    on the own lane, closing in on a slower leader | trigger: out | past, on the lane beside | back | on, to the end

A motion is that of a driver who follows by the intelligent driver model until out of the leader's way and drives freely
afterwards; the leader keeps its speed, or is a recorded one. Whatever is recorded, or kept from rounds before, is known
for the whole scene, so that a motion which would meet somebody, or come too near, is none. What comes of a site that is
found so is another matter: SUMO drives, and Algorithm 1 decides at every step.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from hid2.agents import BoxSize, FloatArray, IntArray
from hid2.conflicts.guard import Guard
from hid2.drivers.driver import Driver
from hid2.insertion.routes import RouteOffer, Routes
from hid2.kernels.overtakes import drives_on, overtakes_done
from hid2.kernels.polyline import frenet
from hid2.motion.lane_change_path import LateralTiming
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.motion.route import DrivenPath
from hid2.occupancy.traffic import BoolArray
from hid2.policy.decision import Side
from hid2.policy.observation import admissible_neighbor
from hid2.policy.overtake import stretch_m
from hid2.policy.roads import Roads
from hid2.scene import Scene

_GRID_M = 1.0  # no tunable: of the table that leads from the own lane to the one beside


@dataclass(frozen=True, eq=False, slots=True)
class Way:
    """A route with a lane beside that lasts for an overtake.

    lane_id: where its vehicle begins; side: of the lane beside; begin, end: of the stretch side by side, m on the path.
    """

    offer: RouteOffer
    lane_id: int
    side: Side
    path: DrivenPath
    beside: DrivenPath
    begin: float
    end: float
    apart_m: float
    """Between the middles of the two lanes."""
    beside_s: FloatArray
    """(S,) arc length on the path beside at each _GRID_M of the own one."""


@dataclass(frozen=True, slots=True)
class ForeseenOvertake:
    """An overtake that fits: where the vehicle begins, m on its path, and its speed, m/s; the same of its leader.

    leader_s None: a recorded one. done_s: when it is back, s.
    """

    start_s: float
    start_mps: float
    leader_s: float | None
    leader_mps: float
    done_s: float


@dataclass(frozen=True, eq=False, slots=True)
class _Tried:
    """Motions (N,): starts on the path, m, and speeds, m/s; leaders' centres at each look (N, K) m, and speeds, m/s.

    A leader that is not there any more is at -inf.
    """

    start_s: FloatArray
    start_mps: FloatArray
    leader: FloatArray
    leader_mps: FloatArray


@dataclass(slots=True)
class Overtakes:
    """Overtakes of one scene that fit between everybody known; ways that are found out are kept with the routes.

    box: what is kept clear for who overtakes, and for a leader that is added.
    """

    scene: Scene
    routes: Routes
    roads: Roads
    guard: Guard
    box: BoxSize
    _known: dict[DrivenPath, tuple[FloatArray, BoolArray, IntArray, FloatArray, BoolArray]] = field(
        default_factory=dict
    )

    def way(self, offer: RouteOffer, lane_id: int, side: Side, *, reach_m: float) -> Way | None:
        """A route from a lane on with the stretch on which a lane is beside; None where that is too short.

        Also where it begins farther than reach_m behind the lane.
        """
        stretch = self.routes.together(offer, side)
        lane_m = self.scene.grid.graph.lanes[lane_id].length_m
        if stretch is None or stretch[0] - offer.start_m - lane_m > reach_m:
            return None
        scene, path = self.scene, self.scene.path(offer.route)
        begin, end = path.to_line(stretch[0]), path.to_line(stretch[1])
        at, row = 0.0, 0
        lanes = scene.grid.graph.lanes
        while at + lanes[offer.route[row]].length_m <= stretch[0] + 0.5:
            at += lanes[offer.route[row]].length_m
            row += 1
        neighbor = admissible_neighbor(scene, offer.route[row], side)
        if neighbor is None:
            return None
        beside = scene.path_beside(offer.route[row:], neighbor)
        grid = np.arange(0.0, path.line.length_m, _GRID_M)
        along, lateral = frenet(path.line.position(grid), beside.raw_line.points, beside.raw_line.s)
        near = np.abs(lateral) <= scene.config.lane_change.max_shift_m
        apart = np.flatnonzero(~near & (grid > begin) & (grid < end))
        if apart.size:
            end = float(grid[apart[0]])
        if end - begin < stretch_m(scene.config):
            return None
        apart_m = float(np.median(np.abs(lateral[(grid > begin) & (grid < end)])))
        return Way(offer, lane_id, side, path, beside, begin, end, apart_m, beside.all_to_line(along))

    def foresee(
        self,
        way: Way,
        driver: Driver,
        rng: np.random.Generator,
        *,
        trigger_s: float,
        lead: bool,
        leader: int | None = None,
    ) -> list[ForeseenOvertake]:
        """Overtakes by a driver that begin at the trigger or soon after, the soonest done first.

        lead: whether a leader may be added, or only recorded ones are there to be overtaken; leader: row in the scene's
        traffic of the only one that may be, None: anybody.
        """
        found = []
        for tried, added in (
            (self._behind_recorded(way, driver, rng, trigger_s, leader), False),
            (self._behind_added(way, driver, rng, trigger_s) if lead else None, True),
        ):
            if tried is None or not tried.start_s.size:
                continue
            done_s = self._done_s(way, driver, trigger_s, tried)
            found += [
                ForeseenOvertake(
                    float(tried.start_s[n]), float(tried.start_mps[n]),
                    float(tried.leader[n, 0]) if added else None, float(tried.leader_mps[n]), float(done_s[n]),
                )
                for n in np.argsort(done_s, kind="stable")[: np.isfinite(done_s).sum()].tolist()
            ]  # fmt: skip
            if found:  # nobody is added where somebody recorded can be overtaken
                break
        return found

    def timing(self, way: Way, driver: Driver) -> LateralTiming:
        """Of the lateral motion out, and of that back."""
        change = self.scene.config.lane_change
        wanted_s = max(change.min_duration_s, self.scene.config.overtake.shift_ratio * driver.lane_change_s)
        return LateralTiming.of(wanted_s, way.apart_m, change)

    def _lane_end(self, way: Way) -> float:
        return way.path.to_line(way.offer.start_m + self.scene.grid.graph.lanes[way.lane_id].length_m)

    def _look_s(self) -> float:
        """From one look to the next, s."""
        return self.scene.config.conflict.stride * self.scene.step_s

    def _times(self) -> FloatArray:
        """Times of the looks, s."""
        return np.asarray(self._looks() * self.scene.step_s, dtype=np.float64)

    def _looks(self) -> IntArray:
        """Steps at which motions are looked at."""
        return np.arange(0, self.scene.num_steps, self.scene.config.conflict.stride)

    def _between(self, way: Way, driver: Driver, trigger_s: float) -> tuple[float, float]:
        """From where to where on its lane, m on the path, a vehicle begins that is soon where a lane is beside."""
        reach_m = driver.desired_mps * (trigger_s + self.scene.config.foresight.waits_s)
        return max(way.path.to_line(way.offer.start_m), way.begin - reach_m), self._lane_end(way)

    def _gap_m(self, driver: Driver, closing_mps: FloatArray, trigger_s: float, share: FloatArray) -> FloatArray:
        """Gaps at the start, m, to leaders that are closed in on, by drawn shares."""
        foresight = self.scene.config.foresight
        low, high = foresight.gap_s
        return driver.min_gap_m + foresight.gap_m + closing_mps * (trigger_s + low + share * (high - low))

    def _behind_added(self, way: Way, driver: Driver, rng: np.random.Generator, trigger_s: float) -> _Tried:
        """Drawn places, start speeds and slower leaders ahead, which drive on and meet nobody."""
        config = self.scene.config
        foresight, sites = config.foresight, config.sites
        begin, end = self._between(way, driver, trigger_s)
        places = begin + max(0.0, end - begin) * rng.random(foresight.motions)
        share = rng.random((3, foresight.motions))
        slowest = max(sites.slow_leader_mps, sites.slow_leader_min * driver.desired_mps)
        fastest = min(
            driver.desired_mps - config.overtake.speed_advantage_mps, sites.slow_leader_max * driver.desired_mps
        )
        leader_mps = slowest + share[0] * max(0.0, fastest - slowest)
        closing = share[1] * (driver.desired_mps - leader_mps)
        gap_m = self._gap_m(driver, closing, trigger_s, share[2])
        ahead = places + self.box.length_m + gap_m
        free = drives_on(
            ahead, leader_mps, self._looks().size, self._look_s(), way.path.exit_s, *self._on(way.path), self._keeps()
        ) & bool(slowest <= fastest)
        leader = ahead[free, None] + leader_mps[free, None] * self._times()
        return _Tried(places[free], (leader_mps + closing)[free], leader, leader_mps[free])

    def _behind_recorded(
        self, way: Way, driver: Driver, rng: np.random.Generator, trigger_s: float, leader: int | None
    ) -> _Tried | None:
        """Drawn places and start speeds behind recorded vehicles that are slower at the trigger; None without any.

        leader: the only one that may be overtaken; None: anybody.
        """
        overtake, foresight, looks = self.scene.config.overtake, self.scene.config.foresight, self._looks()
        known, at = self.scene.recorded_on(way.path, self.box), self.scene.steps_in(trigger_s)
        vehicles = np.isin(known.agents, self.scene.vehicle_rows if leader is None else [leader])
        speed = known.along[:, at]
        rows = np.flatnonzero(
            vehicles & known.same_direction[:, 0] & np.isfinite(known.low[:, 0]) & np.isfinite(known.low[:, at])
            & (speed > overtake.parked_mps) & (speed < driver.desired_mps - overtake.speed_advantage_mps)
            & (known.low[:, at] < way.end)
        )  # fmt: skip
        if not rows.size:
            return None
        row = rows[rng.integers(rows.size, size=foresight.motions)]
        share = rng.random((2, row.size))
        closing = share[0] * (driver.desired_mps - speed[row])
        start_mps = speed[row] + closing
        places = known.low[row, 0] - self._gap_m(driver, closing, trigger_s, share[1])
        low, high = known.low[row][:, looks], known.high[row][:, looks]
        there = np.isfinite(low) & np.isfinite(high)
        middle = np.where(there, 0.5 * (np.where(there, low, 0.0) + np.where(there, high, 0.0)), -np.inf)
        begin, end = self._between(way, driver, trigger_s)
        near = (places >= begin) & (places <= end)
        return _Tried(places[near], start_mps[near], np.ascontiguousarray(middle[near]), speed[row][near])

    def _done_s(self, way: Way, driver: Driver, trigger_s: float, tried: _Tried) -> FloatArray:
        """(N,) time, s, at which each is back in its lane; inf where it does not fit."""
        config, overtake = self.scene.config, self.scene.config.overtake
        timing = self.timing(way, driver)
        # v2 kappa of a lateral motion is what the driver takes: of `lateral_share`, D over the square of its length
        sharpest = 2.0 * way.apart_m / (timing.ramp * (1.0 - timing.ramp))
        bend = config.foresight.bend_share * math.sqrt(driver.turn_lateral_mps2 / sharpest)
        who = (
            driver.desired_mps, driver.accel_mps2, driver.decel_mps2, driver.tau_s, driver.min_gap_m,
            bend * timing.lasting_s, timing.slow_mps, self.box.length_m,
        )  # fmt: skip
        latest_s = self.scene.last_s - config.foresight.spare_s
        gaps = (
            overtake.d_obs_m, overtake.return_gap_m, overtake.d_overtake_m, overtake.safe_front_m, overtake.safe_rear_m
        )  # fmt: skip
        return overtakes_done(
            tried.start_s, tried.start_mps, tried.leader, self._look_s(), np.array(who),
            np.array([way.begin, way.end, way.path.exit_s, way.beside.exit_s]),
            np.array([trigger_s, config.foresight.waits_s, timing.lasting_s, latest_s, *self._keeps()]), np.array(gaps),
            self.roads.speeds(way.path, driver), TABLE_STEP_M, way.beside_s, _GRID_M, *self._on(way.path),
            *self._on(way.beside),
        )  # fmt: skip

    def _keeps(self) -> FloatArray:
        """What motions keep to: margin m, headway s, TTC s, braking m/s2."""
        foresight = self.scene.config.foresight
        return np.array([foresight.margin_m, foresight.headway_s, foresight.ttc_s, foresight.stops_mps2])

    def _on(self, path: DrivenPath) -> tuple[FloatArray, BoolArray, IntArray, FloatArray, BoolArray]:
        """Everybody known on a path at each look, and its stop lines, as kernels take them."""
        if path not in self._known:
            obstacles, looks = self.guard.obstacles(path, self.box, []), self._looks()
            known = obstacles.known
            there = np.isfinite(known.low[:, looks]).T
            spans = np.stack([one[:, looks].T[there] for one in (known.low, known.high, known.along)], axis=1)
            self._known[path] = (
                spans, known.same_direction[:, looks].T[there], np.concatenate([[0], np.cumsum(there.sum(axis=1))]),
                obstacles.lines.stop_s, np.ascontiguousarray(obstacles.lines.closed[:, looks]),
            )  # fmt: skip
        return self._known[path]
