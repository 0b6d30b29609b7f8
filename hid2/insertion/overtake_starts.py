"""Overtakes: many are drawn and driven roughly, those that come about so are rolled out with Algorithm 1.

    closing in on a slower leader, recorded, inserted before, or added for it | trigger: out | past | back | to the end

An added leader is rolled out first, and is known traffic for the vehicle that overtakes it.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hid2.agents import DEFAULT_SIZES, FloatArray, IntArray
from hid2.conflicts.signals import AMBER_S
from hid2.drivers.driver import Driver, draw_driver, wandering, with_wander
from hid2.insertion.routes import RouteOffer
from hid2.insertion.starts import CLEAR_GAP_M, Site, Starts, speed_behind
from hid2.insertion.surroundings import Surroundings
from hid2.kernels.rollout import met_by
from hid2.measures.manoeuvres import PARKED_MPS
from hid2.motion.lane_change_path import LateralTiming
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.motion.route import DrivenPath
from hid2.occupancy.along_path import PathOccupancy
from hid2.occupancy.traffic import BoolArray
from hid2.policy.observation import admissible_neighbor
from hid2.policy.overtake import SHIFT_RATIO, shortest_shift_s
from hid2.reasons import Reason
from hid2.scene import SLOW_LEADER_SHARE, clearance_box
from hid2.vehicle import Start, VehicleRequest
from netconvert.lane_graph import Side

# No tunables from here to _ROLLED_OUT: they bound the search.
_WAYS = 288  # ways looked at for a request, at most
_TOGETHER = 16  # ways looked at in one batch
_HOPELESS = 48  # ways after which the search is given up where no overtake seems to fit
_LEADERS = 6  # added leaders drawn for each way
_DRIVERS = 6  # drivers drawn for each way
_GAPS = 6  # gaps drawn for each pair of leader and driver
_WANDERS = 48  # wanderings of the desired speed drawn for a request
_ROLLED_OUT = 24  # overtakes rolled out for a request, at most
# No tunables from here to _HURRIED: bounds of what is drawn.
_SLOWEST_MPS = 3.0  # least speed of an added leader, m/s
_GAP_S = (1.0, 5.0)  # start gap to the leader beyond that at standstill, over the speed difference, s
_HURRIED = 3  # inverse share of the fastest wanderings, of which an overtaker, in a hurry, has one
# Not parameters from here to _LASTS: they save rollouts.
_LOOKS_S = 0.2  # time between two looks at the rough motion, s
_CROSSED = 0.5  # share of a lateral motion at which the centre has crossed the line
_SPARE_S = 0.1  # spare above the critical TTC to the leader, s
_BACK = 1.05  # least share of the way back that is done by the scene's end: above 1, as a rollout wants some time left
_BRAKES_MPS2 = 3.0  # largest deceleration of a driver, m/s2
_LASTS = 0.75  # share of the scene's duration that an overtake takes up to the end of its stretch


@dataclass(frozen=True, eq=False, slots=True)
class _Way:
    """A route past: its vehicle begins at first to last m on the path, and has the lane of `beside` from there to end.

    apart_m: of the two lanes; shift_m: arc length on the path beside minus that on the own one.
    """

    offer: RouteOffer
    lane_id: int
    side: Side
    path: DrivenPath
    beside: DrivenPath
    first: float
    last: float
    end: float
    apart_m: float
    shift_m: float


@dataclass(frozen=True, eq=False, slots=True)
class _Leader:
    """One to overtake: it is touched from low to high (T,) m on the path, and drives at mps (T,) m/s.

    driver: of one that would be added, which desires that speed; None for one that is known.
    """

    way: _Way
    low: FloatArray
    high: FloatArray
    mps: FloatArray
    driver: Driver | None = None


class _Foreseen(NamedTuple):
    """An overtake that roughly comes about: it begins at s m on the way's path, at v m/s; desired (T,) m/s."""

    leader: _Leader
    driver: Driver
    s: float
    v: float
    desired: FloatArray


class _Drawn(NamedTuple):
    """What begins behind leaders, by the rows of these and of drivers (N,): s m, v m/s, and desired (N, T) m/s."""

    leader: IntArray
    driver: IntArray
    s: FloatArray
    v: FloatArray
    desired: FloatArray


#: Clearance box of a usual vehicle, with which places are looked for.
_BOX = clearance_box(DEFAULT_SIZES["vehicle"], DEFAULT_SIZES["vehicle"])


@dataclass(slots=True)
class OvertakeStarts:
    """Starts of the overtakes of one round. found_none: why the one looked for last has no place to be tried at."""

    here: Surroundings
    starts: Starts
    found_none: Reason | None = None

    def propose(self, request: VehicleRequest, slow: VehicleRequest | None) -> list[Start]:
        """A start from which an overtake comes about, after its leader where one is added; empty where none does.

        slow: the request that an added leader would meet; None: only vehicles that are known may be overtaken.
        """
        scene, rng, ways = self.here.scene, self.starts.rng, self.here.routes.ways_past
        self.found_none = Reason.NO_OVERTAKE_FORESEEN if slow is not None else Reason.NO_SLOW_LEADER
        if request.trigger_s + 2.0 * shortest_shift_s(scene.config) > scene.last_s or not ways:
            return []  # out and back alone take longer
        wander = np.array(
            [wandering(scene.config, rng, num_steps=scene.num_steps, step_s=scene.step_s) for _ in range(_WANDERS)]
        )
        order = np.resize(rng.permutation(len(ways)), _WAYS).tolist()
        led, tried = dict[_Leader, list[Start] | None](), 0
        for n in range(0, _WAYS, _TOGETHER):
            looked = [self._way(*ways[place], request.trigger_s) for place in order[n : n + _TOGETHER]]
            leaders = [
                leader for way in looked if way is not None
                for leader in (*self._known(way), *(self._added(way, wander) if slow is not None else ()))
            ]  # fmt: skip
            for one in self._foreseen(leaders, request.trigger_s, wander):
                if one.leader not in led:
                    led[one.leader] = self._led_by(one.leader, slow)
                self.found_none, tried, before = None, tried + 1, led[one.leader]
                found = [] if before is None else self._starts(request, one, before)
                if found or tried == _ROLLED_OUT:
                    return found
            if not tried and n >= _HOPELESS:
                break
        return []

    def _way(self, offer: RouteOffer, lane_id: int, side: Side, trigger_s: float) -> _Way | None:
        """A way past with its paths; None where it begins farther from the lane than is driven up to the trigger."""
        scene, stretch = self.here.scene, self.here.routes.together(offer, side)
        lanes, row, at = scene.grid.graph.lanes, 0, 0.0
        lane_end, reach_m = offer.start_m + lanes[lane_id].length_m, scene.usual_speed(lane_id) * trigger_s
        if stretch is None or stretch[0] - reach_m > lane_end:
            return None
        while at + lanes[offer.route[row]].length_m <= stretch[0] + 0.5:
            at, row = at + lanes[offer.route[row]].length_m, row + 1
        neighbor = admissible_neighbor(scene, offer.route[row], side)
        if neighbor is None:
            return None
        path, beside = scene.paths.along(offer.route), scene.paths.beside(offer.route[row:], neighbor)
        first, last = path.to_line(max(offer.start_m, stretch[0] - reach_m)), path.to_line(lane_end)
        end = min(path.to_line(stretch[1]), path.exit_m - _BOX.length_m)
        here_m = np.array([max(first, path.to_line(stretch[0]))])
        there, aside = beside.frenet(path.line.position(here_m))
        shift_m = float((there - here_m)[0])
        return _Way(offer, lane_id, side, path, beside, first, last, end, abs(float(aside[0])), shift_m)

    def _known(self, way: _Way) -> Iterator[_Leader]:
        """Recorded cars and buses, and inserted vehicles, that drive ahead on a way all the time."""
        scene, known = self.here.scene, self._on(way.path)
        usable = np.isin(known.agents, scene.vehicle_rows) | (known.agents >= scene.num_recorded)
        recorded = known.agents < scene.num_recorded
        usable[recorded] &= scene.traffic.present[known.agents[recorded]].all(axis=1)
        usable &= known.same_direction[:, 0] & (known.along[:, 0] > PARKED_MPS) & (known.low[:, 0] > way.first)
        steps = slice(scene.num_steps)
        for row in np.flatnonzero(usable & np.isfinite(known.low[:, steps]).all(axis=1)).tolist():
            yield _Leader(way, known.low[row, steps], known.high[row, steps], known.along[row, steps])

    def _added(self, way: _Way, wander: FloatArray) -> Iterator[_Leader]:
        """Leaders at some share of the lane's usual speed that could be added on a way, and meet none."""
        scene, rng = self.here.scene, self.starts.rng
        usual_mps, length_m = scene.usual_speed(way.lane_id), _BOX.length_m
        driver = draw_driver(scene.config, rng, lane_speed_mps=usual_mps)
        slowest_mps, fastest_mps = (max(_SLOWEST_MPS, share * usual_mps) for share in SLOW_LEADER_SHARE)
        latest = max(min(way.last, way.end - _LASTS * scene.last_s * usual_mps), way.first)
        for _ in range(_LEADERS):
            mps = rng.uniform(slowest_mps, fastest_mps)
            v = np.maximum(with_wander(mps, wander[int(rng.integers(len(wander)))]), slowest_mps)
            start = rng.uniform(way.first, latest) + length_m + rng.uniform(*_GAP_S) * (usual_mps - mps)
            s = start + scene.step_s * (np.cumsum(v) - v)
            if s[-1] < way.path.exit_m and not self._is_met(way.path, driver, s, v):
                yield _Leader(way, s - length_m, s + length_m, v, replace(driver, desired_mps=mps))

    def _on(self, path: DrivenPath) -> PathOccupancy:
        return self.starts.world.guard.known_on(path, _BOX)

    def _is_met(self, path: DrivenPath, driver: Driver, s: FloatArray, v: FloatArray) -> bool:
        """Whether a motion (T,) meets any that is known, or a line that is closed."""
        conflict, known = self.here.scene.config.conflict, self._on(path)
        met = met_by(s, v, 0, known.low, known.high, known.along, known.same_direction, self.here.scene.step_s)
        contact, ahead_s, behind_s = met.min(axis=0, initial=math.inf)
        lines, amber = self.starts.world.guard.stop_lines, self.here.scene.steps_in(AMBER_S)
        return bool(
            contact < math.inf or ahead_s < conflict.ttc_min_s or behind_s < conflict.follower_ttc_min_s
            or lines.on(path, _BOX).is_passed(s, driver, first=0, closed_steps=amber)
        )  # fmt: skip

    def _foreseen(self, leaders: list[_Leader], trigger_s: float, wander: FloatArray) -> Iterator[_Foreseen]:
        """Overtakes that come past and back in the time and on the stretch that there is; the soonest first."""
        scene, rng = self.here.scene, self.starts.rng
        drivers = [
            (way, draw_driver(scene.config, rng, lane_speed_mps=scene.lane_speed(way.lane_id, rng)))
            for way in dict.fromkeys(leader.way for leader in leaders) for _ in range(_DRIVERS)
        ]  # fmt: skip
        drawn = self._drawn(leaders, drivers, wander) if leaders else None
        if drawn is None or not drawn.s.size:
            return
        over, fits = self._driven(leaders, drivers, drawn, trigger_s)
        rows = np.flatnonzero((fits & (over > _BACK)) | (scene.config.request.sites == "any"))
        for n in rows[np.argsort(-over[rows], kind="stable")].tolist():
            (_, driver), s, v = drivers[drawn.driver[n]], float(drawn.s[n]), float(drawn.v[n])
            yield _Foreseen(leaders[drawn.leader[n]], driver, s, v, drawn.desired[n])

    def _drawn(self, leaders: list[_Leader], drivers: list[tuple[_Way, Driver]], wander: FloatArray) -> _Drawn:
        """Gaps behind leaders for the drivers on their ways, where there is room to begin."""
        rng, ways = self.starts.rng, [way for way, _ in drivers[::_DRIVERS]]
        gap_s = rng.uniform(*_GAP_S, size=(len(leaders), _DRIVERS, _GAPS))
        way_of = np.array([ways.index(leader.way) for leader in leaders])
        leader, driver, _ = (one.ravel() for one in np.indices(gap_s.shape))
        driver = driver + _DRIVERS * way_of[leader]
        low, mps = np.array([(one.low[0], one.mps[0]) for one in leaders]).T[:, leader]
        desired_mps = np.array([one.desired_mps for _, one in drivers])[driver]
        following = tuple(np.array([one.following for _, one in drivers]).T[:, driver])
        gap_m = following[-1] + gap_s.ravel() * (desired_mps - mps)
        s, v = low - gap_m, speed_behind(gap_m, mps, following)
        fits = (mps < desired_mps - self.here.scene.config.overtake.speed_advantage_mps) & (mps < v)
        for n, way in enumerate(ways):
            known, rows = self._on(way.path).at(0), np.flatnonzero(way_of[leader] == n)
            touched = (known.low - CLEAR_GAP_M < s[rows]) & (s[rows] < known.high + CLEAR_GAP_M)
            fits[rows] &= (way.first < s[rows]) & (s[rows] < way.last) & ~touched.any(axis=0)
        hurried = wander[np.argsort(-wander.mean(axis=1), kind="stable")[: len(wander) // _HURRIED]]
        desired = with_wander(desired_mps[fits, None], hurried[rng.integers(len(hurried), size=fits.sum())])
        return _Drawn(leader[fits], driver[fits], s[fits], np.minimum(v[fits], desired[:, 0]), desired)

    def _driven(
        self, leaders: list[_Leader], drivers: list[tuple[_Way, Driver]], drawn: _Drawn, trigger_s: float
    ) -> tuple[FloatArray, BoolArray]:
        """How much of the way back is done by the scene's end (N,), and whether the stretch is long enough (N,).

        By the IDM: behind the leader up to the trigger, then on a free road. A lateral motion takes its time, or its
        length where the vehicle is slow.
        """
        scene, config = self.here.scene, self.here.scene.config
        step_s, shortest_s = scene.step_s * scene.steps_in(_LOOKS_S), config.lane_change.min_duration_s

        def timed(way: _Way, wanted_s: float) -> tuple[float, float]:
            timing = LateralTiming.of(SHIFT_RATIO * wanted_s, way.apart_m, config.lane_change)
            return timing.lasting_s, timing.slow_mps

        tau, accel, decel, min_gap, out_s, out_mps, back_s, back_mps, shift_m, end = np.array([
            (*one.following, *timed(way, one.lane_change_s), *timed(way, shortest_s), way.shift_m, way.end)
            for way, one in drivers
        ]).T[:, drawn.driver]  # fmt: skip
        roads = [self.here.roads.speeds(way.beside, one) for way, one in drivers[::_DRIVERS]]
        road = np.full((len(roads), max(one.size for one in roads)), np.inf)
        for n, one in enumerate(roads):
            road[n, : one.size] = one
        low, high, mps = np.array([(o.low, o.high, o.mps) for o in leaders]).transpose(1, 2, 0)[..., drawn.leader]
        s, v, fits, looks = drawn.s, drawn.v, drawn.v > mps[0], scene.steps_in(_LOOKS_S)
        across, over = np.zeros((2, s.size))
        for now in range(0, scene.num_steps - looks, looks):
            is_behind = low[now] - s > (config.conflict.ttc_min_s + _SPARE_S) * (v - mps[now])
            fits &= ((across >= _CROSSED) | is_behind) & ((over >= 1.0) | (s < end))
            star = min_gap + np.maximum(0.0, v * tau + 0.5 * v * (v - mps[now]) / np.sqrt(accel * decel))
            follows, is_out = (star / np.maximum(low[now] - s, CLEAR_GAP_M)) ** 2, now * scene.step_s >= trigger_s
            wanted = accel * (1.0 - (v / drawn.desired[:, now]) ** 4 - (0.0 if is_out else follows))
            faster = np.maximum(v + step_s * np.maximum(wanted, -_BRAKES_MPS2), 0.0)
            if is_out:
                cell = np.minimum((s + shift_m) / TABLE_STEP_M, road.shape[1] - 1.0).astype(np.int64)
                faster = np.minimum(faster, road[drawn.driver // _DRIVERS, cell])
                returns = (over > 0.0) | ((across >= 1.0) & (s > high[now] + config.overtake.return_gap_m))
                across = across + np.minimum(v / out_mps, 1.0) * step_s / out_s
                over = over + returns * np.minimum(v / back_mps, 1.0) * step_s / back_s
            s, v = s + 0.5 * step_s * (v + faster), faster
        return over, fits

    def _led_by(self, leader: _Leader, slow: VehicleRequest | None) -> list[Start] | None:
        """The start of a leader where one is to be added; None where it cannot be."""
        if leader.driver is None or slow is None:
            return []
        site = Site(leader.way.offer, leader.way.path.to_raw(float(leader.low[0]) + _BOX.length_m))
        found = self.starts.make(slow, site, driver=leader.driver, speed_mps=float(leader.mps[0]), desired=leader.mps)
        if isinstance(found, Start):
            return [found]
        self.starts.refusals[found] += 1
        return None

    def _starts(self, request: VehicleRequest, one: _Foreseen, before: list[Start]) -> list[Start]:
        """The vehicle, after those before it; empty where a rollout speaks against it."""
        starts, world, way = self.starts, self.starts.world, one.leader.way
        starts.world = world.joined_by(*(rolled for start in before for rolled in starts.rolled(start)))
        found = starts.make(
            request, Site(way.offer, way.path.to_raw(one.s)), driver=one.driver, speed_mps=one.v,
            sides=(way.side,), desired=one.desired,
        )  # fmt: skip
        starts.world = world
        if isinstance(found, Start):
            return starts.take([*before, found])
        starts.refusals[found] += 1
        return []
