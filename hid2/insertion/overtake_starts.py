"""Overtakes: where one may fit, by straight lines over time; whether it comes about, by rollouts with Algorithm 1.

closing in on a slower leader, recorded, inserted before, or added for it | trigger: out | past | back | to the end
"""

from dataclasses import dataclass, field, replace

import numpy as np

from hid2.agents import DEFAULT_SIZES, BoxSize, FloatArray, IntArray
from hid2.drivers.driver import Driver, draw_driver
from hid2.insertion.routes import RouteOffer
from hid2.insertion.starts import Starts
from hid2.insertion.surroundings import Surroundings
from hid2.kernels.polyline import frenet
from hid2.motion.lane_change_path import LateralTiming
from hid2.motion.route import DrivenPath
from hid2.occupancy.along_path import PathOccupancy
from hid2.occupancy.traffic import BoolArray
from hid2.policy.decision import Side
from hid2.policy.observation import admissible_neighbor
from hid2.reasons import Reason
from hid2.scene import clearance_box
from hid2.vehicle import Start, VehicleRequest

#: Starts (N,) m on the path, leaders' centres there at each look (N, K) m, inf where gone, and speeds (N,) m/s.
_Drawn = tuple[FloatArray, FloatArray, FloatArray]
#: No tunable: places tried on one way.
_TRIED = 2
#: Shares of a lateral motion after which two usual cars do not overlap any more, and up to which they do not yet.
_OUT, _BACK = 0.6, 0.4


@dataclass(frozen=True, eq=False, slots=True)
class _Way:
    """A route past: its vehicle begins on lane_id; beside: the path on a side's lane, begin to end m on the own path.

    shift_m: arc length on the path beside minus that on the own one.
    """

    offer: RouteOffer
    lane_id: int
    side: Side
    path: DrivenPath
    beside: DrivenPath
    begin: float
    end: float
    shift_m: float


@dataclass(frozen=True, slots=True)
class _Likely:
    """Where an overtaker begins, m on its path, and its leader where one is added (else None), with its speed, m/s."""

    start_s: float
    leader_s: float | None
    leader_mps: float


@dataclass(slots=True)
class OvertakeStarts:
    """Starts of the overtakes of one round. found_none: why the one looked for last has no place to be tried at."""

    here: Surroundings
    starts: Starts
    found_none: Reason | None = None
    _box: BoxSize = field(init=False)

    def __post_init__(self) -> None:
        """Places are looked for with a usual vehicle."""
        self._box = clearance_box(DEFAULT_SIZES["vehicle"], DEFAULT_SIZES["vehicle"])

    def propose(self, request: VehicleRequest, slow: VehicleRequest | None) -> list[Start]:
        """A start from which an overtake comes about, after its leader where one is added; empty where none does.

        slow: the request that an added leader would meet; None: only vehicles that are known may be overtaken.
        """
        scene, rng, sites = self.here.scene, self.starts.rng, self.here.scene.config.sites
        ways, tried, looked = self.here.routes.ways_past(), 0, 0
        self.found_none = Reason.NO_OVERTAKE_FORESEEN if slow is not None else Reason.NO_SLOW_LEADER
        for place in rng.permutation(len(ways)).tolist():
            drivers = [
                draw_driver(scene.config, rng, lane_speed_mps=scene.lane_speed(ways[place][1], rng))
                for _ in range(sites.drivers)
            ]
            driver = max(drivers, key=lambda one: one.desired_mps)  # that of an overtaker is in a hurry
            way = self._way(*ways[place], reach_m=driver.desired_mps * request.trigger_s)
            if way is None:
                continue
            looked += 1
            for one in self._likely(way, driver, request.trigger_s, adds=slow is not None):
                self.found_none, tried = None, tried + 1
                found = self._starts(request, slow, way, one, driver)
                if found or tried == sites.overtake_tries:
                    return found
            if looked == sites.overtake_ways:
                break
        return []

    def _way(self, offer: RouteOffer, lane_id: int, side: Side, *, reach_m: float) -> _Way | None:
        """A way past with its paths; None where it begins farther than reach_m from the lane."""
        scene, stretch = self.here.scene, self.here.routes.together(offer, side)
        lanes, row, at = scene.grid.graph.lanes, 0, 0.0
        if stretch is None or stretch[0] - offer.start_m - lanes[lane_id].length_m > reach_m:
            return None
        while at + lanes[offer.route[row]].length_m <= stretch[0] + 0.5:
            at, row = at + lanes[offer.route[row]].length_m, row + 1
        neighbor = admissible_neighbor(scene, offer.route[row], side)
        if neighbor is None:
            return None
        path, beside = scene.path(offer.route), scene.path_beside(offer.route[row:], neighbor)
        begin, end = path.to_line(stretch[0]), path.to_line(stretch[1])
        there = frenet(path.line.position(np.array([begin])), beside.raw_line.points, beside.raw_line.s)[0]
        return _Way(offer, lane_id, side, path, beside, begin, end, float(beside.all_to_line(there)[0]) - begin)

    def _likely(self, way: _Way, driver: Driver, trigger_s: float, *, adds: bool) -> list[_Likely]:
        """Places on a way from which straight lines over time lead past a known leader; else past an added one."""
        looks = np.arange(0, self.here.scene.num_steps, self.here.scene.config.conflict.stride)
        known = self.starts.world.known_on(way.path, self._box)
        start, leader, leader_mps = self._behind_known(way, driver, trigger_s, known, looks)
        fits = np.flatnonzero(self._fits(way, driver, trigger_s, known, looks, start, leader))
        if fits.size or not adds:
            return [_Likely(float(start[n]), None, 0.0) for n in fits[:_TRIED].tolist()]
        start, leader, leader_mps = self._behind_added(way, driver, trigger_s, looks)
        fits = np.flatnonzero(
            self._fits(way, driver, trigger_s, known, looks, start, leader)
            & ~_taken(known, looks, leader).any(axis=1) & (leader_mps < driver.desired_mps)
        )  # fmt: skip
        return [_Likely(float(start[n]), float(leader[n, 0]), float(leader_mps[n])) for n in fits[:_TRIED].tolist()]

    def _gap_m(self, driver: Driver, closing_mps: FloatArray) -> FloatArray:
        """Bumper gaps to leaders at the trigger, m (N,): as short as they may be with so much closed until out."""
        low, high = self.here.scene.config.sites.overtake_gap_s
        return driver.min_gap_m + closing_mps * self.starts.rng.uniform(low, high, size=closing_mps.size)

    def _behind_known(
        self, way: _Way, driver: Driver, trigger_s: float, known: PathOccupancy, looks: IntArray
    ) -> _Drawn:
        """Behind recorded cars and buses, and inserted vehicles, that are slower at the trigger."""
        scene, overtake = self.here.scene, self.here.scene.config.overtake
        recorded = scene.kept_clear_on(way.path, self._box).agents.size
        at = min(round(trigger_s / scene.step_s), scene.num_steps - 1)
        usable = np.isin(known.agents, scene.vehicle_rows) | (np.arange(known.agents.size) >= recorded)
        usable &= (
            known.same_direction[:, at] & np.isfinite(known.low[:, at]) & (known.along[:, at] > overtake.parked_mps)
        )
        slower = known.along[:, at] < driver.desired_mps - overtake.speed_advantage_mps
        rows = np.repeat(np.flatnonzero(usable & slower), _TRIED)
        there = np.isfinite(known.low[rows][:, looks])
        low, high = (np.where(there, one[rows][:, looks], np.inf) for one in (known.low, known.high))
        gap_m = self._gap_m(driver, driver.desired_mps - known.along[rows, at])
        return known.low[rows, at] - gap_m - driver.desired_mps * trigger_s, 0.5 * (low + high), known.along[rows, at]

    def _behind_added(self, way: _Way, driver: Driver, trigger_s: float, looks: IntArray) -> _Drawn:
        """Anywhere on the lane behind leaders at 50 to 70 % of its usual speed, or as `sites` has it."""
        scene, sites, rng = self.here.scene, self.here.scene.config.sites, self.starts.rng
        begin, end = self._between(way, driver, trigger_s)
        usual_mps = self.here.meetings.usual_speed(way.lane_id)
        share = rng.uniform(sites.slow_leader_min, sites.slow_leader_max, size=sites.overtake_draws)
        slow_mps = np.maximum(sites.slow_leader_mps, share * usual_mps)
        closing_mps = np.maximum(driver.desired_mps - slow_mps, 0.0)
        start = begin + max(0.0, end - begin) * rng.random(slow_mps.size)
        leader = start + self._box.length_m + self._gap_m(driver, closing_mps) + closing_mps * trigger_s
        return start, leader[:, None] + slow_mps[:, None] * looks * scene.step_s, slow_mps

    def _between(self, way: _Way, driver: Driver, trigger_s: float) -> tuple[float, float]:
        """From where to where on its lane, m on the path, a vehicle begins that has a lane beside at the trigger."""
        lane_m = self.here.scene.grid.graph.lanes[way.lane_id].length_m
        first, last = (way.path.to_line(way.offer.start_m + more) for more in (0.0, lane_m))
        return max(first, way.begin - driver.desired_mps * trigger_s), last

    def _fits(
        self, way: _Way, driver: Driver, trigger_s: float, known: PathOccupancy, looks: IntArray, start: FloatArray,
        leader: FloatArray,
    ) -> BoolArray:  # fmt: skip
        """Which of N starts at the desired speed are past their leaders, (N, K) m, and back in time, and meet none.

        known: on the own path; looks (K,): steps.
        """
        scene, change, overtake = self.here.scene, self.here.scene.config.lane_change, self.here.scene.config.overtake
        if not start.size or self.here.scene.config.request.sites == "any":
            return np.ones(start.size, dtype=np.bool_)
        wanted_s = max(change.min_duration_s, overtake.shift_ratio * driver.lane_change_s)
        across_s = LateralTiming.of(wanted_s, scene.config.grid.cell_m, change).lasting_s
        times, desired = looks * scene.step_s, driver.desired_mps
        s = start[:, None] + desired * times
        past = (s > leader + self._box.length_m + overtake.return_gap_m) & (times > trigger_s + across_s)
        back_s = np.where(past.any(axis=1), times[past.argmax(axis=1)], np.inf)
        begin, end = self._between(way, driver, trigger_s)
        fits = (back_s + across_s < scene.last_s) & (start >= begin) & (start <= end)
        fits &= start + desired * np.minimum(back_s + across_s, scene.last_s) < way.end
        out = (times > trigger_s + _OUT * across_s) & (times < back_s[:, None] + _BACK * across_s)
        beside = self.starts.world.known_on(way.beside, self._box)
        return fits & ~np.where(out, _taken(beside, looks, s + way.shift_m), _taken(known, looks, s)).any(axis=1)

    def _starts(
        self, request: VehicleRequest, slow: VehicleRequest | None, way: _Way, likely: _Likely, driver: Driver
    ) -> list[Start]:
        """The vehicle, after its leader where one is added; empty where a rollout speaks against one of them."""
        starts, raw = self.starts, way.path.to_raw
        world, leaders = starts.world, list[Start]()
        if likely.leader_s is not None and slow is not None:
            base = draw_driver(self.here.scene.config, starts.rng, lane_speed_mps=likely.leader_mps)
            leader = starts.make(
                slow, way.offer, way.lane_id, raw(likely.leader_s), driver=replace(base, desired_mps=likely.leader_mps),
                speed_mps=likely.leader_mps,
            )  # fmt: skip
            if not isinstance(leader, Start):
                starts.rejected[leader] += 1
                return []
            leaders, starts.world = [leader], world.joined_by(starts.rolled(leader))
        found = starts.make(
            request, way.offer, way.lane_id, raw(likely.start_s), driver=driver, speed_mps=driver.desired_mps,
            sides=(way.side,),
        )  # fmt: skip
        starts.world = world
        if isinstance(found, Start):
            return starts.take([*leaders, found])
        starts.rejected[found] += 1
        return []


def _taken(known: PathOccupancy, looks: IntArray, s: FloatArray) -> BoolArray:
    """Whether a box at places (N, K) m at looks (K,) touches any of those known on a path, (N, K)."""
    low, high = known.low[None, :, looks], known.high[None, :, looks]
    return np.asarray(((low < s[:, None]) & (s[:, None] < high)).any(axis=1))
