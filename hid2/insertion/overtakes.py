"""Where and when an overtake fits into the recorded traffic: many motions at once, foreseen before anything is driven.

    on the own lane, closing in on a slower leader | trigger: out | past, on the lane beside | back | on, to the end

A motion is that of a driver who follows by the intelligent driver model until out of the leader's way and drives freely
afterwards; the leader keeps its speed, or is a recorded one. Whatever is recorded, or kept from rounds before, is known
for the whole scene, so that a motion which would meet somebody, or come too near, is none. What comes of a site that is
found so is another matter: SUMO drives, and Algorithm 1 decides at every step.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hid2.agents import DEFAULT_SIZES, BoxSize, FloatArray, IntArray
from hid2.conflicts.guard import Guard, Obstacles
from hid2.conflicts.stop_lines import ClosedLines
from hid2.drivers.driver import Driver
from hid2.insertion.routes import RouteOffer, Routes
from hid2.kernels.polyline import frenet
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.motion.route import DrivenPath
from hid2.occupancy.along_path import PathOccupancy
from hid2.occupancy.traffic import BoolArray
from hid2.policy.decision import Side
from hid2.policy.observation import admissible_neighbor
from hid2.policy.overtake import stretch_m
from hid2.policy.roads import Roads
from hid2.scene import Scene, clearance_box

_GRID_M = 1.0  # no tunable: of the table that leads from the own lane to the one beside
#: Shares of a lateral motion: the lane left is touched up to the second, the lane entered from the first on.
_ENTERS, _LEAVES = 0.25, 0.7
_OUT_OF_THE_WAY = 0.6  # share of a lateral motion after which two usual cars do not overlap any more


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
    """Motions (N,): starts on the path, m, speeds, m/s, and places of the leaders' centres, m, at each look (N, K)."""

    start_s: FloatArray
    start_mps: FloatArray
    leader: FloatArray
    leader_mps: FloatArray
    added: BoolArray

    def rows(self, rows: BoolArray) -> "_Tried":
        """Some of them."""
        return _Tried(
            self.start_s[rows], self.start_mps[rows], self.leader[rows], self.leader_mps[rows], self.added[rows]
        )


@dataclass(slots=True)
class Overtakes:
    """Overtakes of one scene that fit between everybody known; ways that are found out are kept with the routes."""

    scene: Scene
    routes: Routes
    roads: Roads
    guard: Guard
    box: BoxSize = field(init=False)
    _obstacles: dict[DrivenPath, Obstacles] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """A usual car."""
        size = DEFAULT_SIZES["vehicle"]
        self.box = clearance_box(size, size)

    def way(self, offer: RouteOffer, lane_id: int, side: Side) -> Way | None:
        """A route from a lane on with the stretch on which a lane is beside; None where that is too short."""
        stretch = self.routes.together(offer, side)
        if stretch is None:
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
        self, way: Way, driver: Driver, rng: np.random.Generator, *, trigger_s: float, lead: bool
    ) -> list[ForeseenOvertake]:
        """Overtakes by a driver that begin at the trigger or soon after, the soonest done first.

        lead: whether a leader may be added, or only recorded ones are there to be overtaken.
        """
        tried = self._tried(way, driver, rng, trigger_s, lead=lead)
        if not tried.start_s.size:
            return []
        done_s = self._done_s(way, driver, trigger_s, tried)
        return [
            ForeseenOvertake(
                float(tried.start_s[n]), float(tried.start_mps[n]),
                float(tried.leader[n, 0]) if tried.added[n] else None, float(tried.leader_mps[n]), float(done_s[n]),
            )
            for n in np.argsort(done_s, kind="stable").tolist()
            if np.isfinite(done_s[n])
        ]  # fmt: skip

    def _lane_end(self, way: Way) -> float:
        return way.path.to_line(way.offer.start_m + self.scene.grid.graph.lanes[way.lane_id].length_m)

    def is_in_reach(self, way: Way, driver: Driver, trigger_s: float) -> bool:
        """Whether a driver from the lane where a way begins is where a lane is beside soon after the trigger."""
        reach_m = driver.desired_mps * (trigger_s + self.scene.config.foresight.waits_s)
        return way.begin - self._lane_end(way) < reach_m

    def _looks(self) -> IntArray:
        """Steps at which motions are looked at."""
        return np.arange(0, self.scene.num_steps, self.scene.config.conflict.stride)

    def _tried(
        self, way: Way, driver: Driver, rng: np.random.Generator, trigger_s: float, *, lead: bool
    ) -> _Tried:
        """Drawn places and start speeds behind drawn leaders, and behind every recorded one that is slower."""
        config = self.scene.config
        foresight, sites, overtake = config.foresight, config.sites, config.overtake
        looks = self._looks()
        time_s = looks * self.scene.step_s
        begin, end = way.path.to_line(way.offer.start_m), self._lane_end(way)
        begin = max(begin, way.begin - driver.desired_mps * (trigger_s + foresight.waits_s))
        places = begin + max(0.0, end - begin) * rng.random(foresight.motions)
        share = rng.random((3, foresight.motions))
        most_mps = driver.desired_mps - overtake.speed_advantage_mps
        slowest = max(sites.slow_leader_mps, sites.slow_leader_min * driver.desired_mps)
        fastest = min(most_mps, sites.slow_leader_max * driver.desired_mps)
        leader_mps = slowest + share[0] * max(0.0, fastest - slowest)
        closing = share[1] * (driver.desired_mps - leader_mps)
        start_mps = leader_mps + closing
        low, high = foresight.gap_s
        gap_m = driver.min_gap_m + foresight.gap_m + closing * (trigger_s + low + share[2] * (high - low))
        leader = (places + self.box.length_m + gap_m)[:, None] + leader_mps[:, None] * time_s
        found = _Tried(places, start_mps, leader, leader_mps, np.ones(places.size, dtype=np.bool_))
        speeds = np.broadcast_to(leader_mps[:, None], leader.shape)
        free = np.full(places.size, lead and slowest <= fastest)
        rows = np.flatnonzero(free)
        free[rows] = self._is_free(way.path, leader[rows], speeds[rows]).all(axis=1)
        return found.rows(free)

    def _done_s(
        self, way: Way, driver: Driver, trigger_s: float, tried: _Tried
    ) -> FloatArray:
        """(N,) time, s, at which each is back in its lane; inf where it does not fit."""
        scene, config = self.scene, self.scene.config
        overtake, conflict, change = config.overtake, config.conflict, config.lane_change
        looks = self._looks()
        dt = conflict.stride * scene.step_s
        count, length = tried.start_s.size, self.box.length_m
        lasting_s = max(change.min_duration_s, overtake.shift_ratio * driver.lane_change_s)
        s, v = tried.start_s.copy(), tried.start_mps.copy()
        way_m, speeds = np.empty((count, looks.size)), np.empty((count, looks.size))
        out_at, back_at = np.full(count, np.inf), np.full(count, np.inf)  # where the lateral motions begin, m
        out_m, back_m = np.zeros(count), np.zeros(count)
        done_s, ok = np.full(count, np.inf), np.ones(count, dtype=np.bool_)
        on_own, on_beside = np.ones((count, looks.size), dtype=np.bool_), np.zeros((count, looks.size), dtype=np.bool_)
        road = self.roads.speeds(way.path, driver)
        # v2 kappa of a lateral motion is what the driver takes: its curvature is 9 D / L2 at most (`lateral_share`)
        bend_share = config.foresight.bend_share * math.sqrt(driver.turn_lateral_mps2 / (9.0 * way.apart_m))
        root = 2.0 * math.sqrt(driver.accel_mps2 * driver.decel_mps2)
        for look, step in enumerate(looks.tolist()):
            time_s = step * scene.step_s
            way_m[:, look], speeds[:, look] = s, v
            leader = tried.leader[:, look]
            leader_v = (tried.leader[:, min(look + 1, looks.size - 1)] - tried.leader[:, max(look - 1, 0)]) / (
                dt * (min(look + 1, looks.size - 1) - max(look - 1, 0))
            )
            pace = 0.5 * (v + np.maximum(v, driver.desired_mps))
            gap = leader - s - length
            if time_s >= trigger_s:
                out = np.isinf(out_at) & (s >= way.begin) & (gap < overtake.d_obs_m)
                out &= self._may_enter(way, driver, s, step)
                out_at, out_m = np.where(out, s, out_at), np.where(out, pace * lasting_s, out_m)
                ok &= np.isfinite(out_at) | (time_s < trigger_s + config.foresight.waits_s)
            back = np.isinf(back_at) & (s >= out_at + out_m) & (-gap - 2.0 * length > overtake.return_gap_m)
            back_at, back_m = np.where(back, s, back_at), np.where(back, pace * lasting_s, back_m)
            ended = np.isinf(done_s) & (s >= back_at + back_m)
            done_s = np.where(ended, time_s, done_s)
            ok &= (s < way.end) | np.isfinite(done_s)
            behind = np.isinf(out_at) | (s < out_at + _OUT_OF_THE_WAY * out_m)
            closing = v - leader_v
            ok &= ~behind | (gap > np.maximum(1.0, config.foresight.ttc_s * closing))
            on_own[:, look] = np.isinf(out_at) | (s < out_at + _LEAVES * out_m) | (s > back_at + _ENTERS * back_m)
            on_beside[:, look] = (s > out_at + _ENTERS * out_m) & (s < back_at + _LEAVES * back_m)
            wished = driver.min_gap_m + np.maximum(0.0, v * driver.tau_s + v * closing / root)
            room = np.where(np.isinf(out_at), (wished / np.maximum(gap, 0.5)) ** 2, 0.0)
            accel = config.foresight.accel_share * driver.accel_mps2 * (1.0 - (v / driver.desired_mps) ** 4 - room)
            v_next = np.maximum(0.0, v + np.clip(accel, -driver.decel_mps2, driver.accel_mps2) * dt)
            moving = ((s >= out_at) & (s < out_at + out_m)) | ((s >= back_at) & (s < back_at + back_m))
            bend = np.where(moving, bend_share * np.where(np.isinf(back_at), out_m, back_m), np.inf)
            v_next = np.where(v_next > bend, np.maximum(bend, v - driver.decel_mps2 * dt), v_next)
            v_next = np.minimum(v_next, road[np.clip((s / TABLE_STEP_M).astype(np.int64), 0, road.size - 1)])
            s, v = s + 0.5 * (v + v_next) * dt, v_next
        ok &= done_s <= scene.last_s - config.foresight.spare_s
        rows = np.flatnonzero(ok)
        if rows.size:
            own = self._is_free(way.path, way_m[rows], speeds[rows]) | ~on_own[rows]
            beside = self._is_free(way.beside, self._beside_s(way, way_m[rows]), speeds[rows]) | ~on_beside[rows]
            ok[rows] = (own & beside).all(axis=1)
        return np.where(ok, done_s, np.inf)

    def _may_enter(self, way: Way, driver: Driver, s: FloatArray, step: int) -> BoolArray:
        """(N,) whether Algorithm 1 lets vehicles at s, m on the path, onto the lane beside at a step."""
        overtake, known = self.scene.config.overtake, self._on(way.beside).known
        at = self._beside_s(way, s)
        found = way.beside.exit_s - at >= overtake.d_overtake_m
        low, high, along = known.low[:, step], known.high[:, step], known.along[:, step]
        for row in np.flatnonzero(np.isfinite(low)).tolist():
            ahead = 0.5 * (low[row] + high[row]) >= at
            least = overtake.safe_front_m if along[row] >= driver.desired_mps else overtake.d_overtake_m
            found &= np.where(ahead, low[row] - at >= least, at - high[row] >= overtake.safe_rear_m)
        return found

    def _beside_s(self, way: Way, s: FloatArray) -> FloatArray:
        """Places on the lane beside, m on its path, of places on the own one."""
        return np.interp(s, _GRID_M * np.arange(way.beside_s.size), way.beside_s)

    def _is_free(self, path: DrivenPath, s: FloatArray, v: FloatArray) -> BoolArray:
        """(N, K) whether a box that is at s, m on a path, with v, m/s, at each look meets nobody and stops nowhere."""
        obstacles, looks, foresight = self._on(path), self._looks(), self.scene.config.foresight
        known = obstacles.known
        found = _stops_nowhere(obstacles.lines, s, v, looks, foresight.stops_mps2)
        rows = np.flatnonzero(np.isfinite(known.low[:, looks]).any(axis=1))
        for row in rows.tolist():
            low, high = known.low[row, looks], known.high[row, looks]
            along, aligned = known.along[row, looks], known.aligned[row, looks]
            ahead, behind = low - s, s - high
            found &= (ahead > foresight.margin_m) | (behind > foresight.margin_m) | ~np.isfinite(low)
            near = np.maximum(foresight.margin_m + foresight.headway_s * v, foresight.ttc_s * (v - along))
            found &= ~(aligned & (ahead > 0.0) & (ahead < near))
            near = np.maximum(foresight.margin_m, foresight.ttc_s * (along - v))
            found &= ~(aligned & (behind > 0.0) & (behind < near))
        return found | (s > path.exit_s)

    def _known(self, path: DrivenPath) -> PathOccupancy:
        return self._on(path).known

    def _on(self, path: DrivenPath) -> Obstacles:
        if path not in self._obstacles:
            self._obstacles[path] = self.guard.obstacles(path, self.box, [])
        return self._obstacles[path]


def _stops_nowhere(lines: ClosedLines, s: FloatArray, v: FloatArray, looks: IntArray, most_mps2: float) -> BoolArray:
    """(N, K) whether no closed stop line ahead asks for more braking than most_mps2."""
    found = np.ones(s.shape, dtype=np.bool_)
    for place, closed in zip(lines.stop_s.tolist(), lines.closed, strict=True):
        room = place - s
        found &= ~(closed[looks] & (room > 0.0) & (v * v > 2.0 * most_mps2 * room))
    return found
