"""Overtakes: where one may fit, by lines over time; whether it comes about, by rollouts with Algorithm 1.

    closing in on a slower leader, recorded, inserted before, or added for it | trigger: out | past | back | to the end

An added leader is rolled out first, and is known traffic for the vehicle that overtakes it.
"""

import math
from collections import Counter
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hid2.agents import DEFAULT_SIZES, FloatArray, IntArray
from hid2.drivers.driver import Driver, draw_driver
from hid2.insertion.routes import RouteOffer
from hid2.insertion.starts import BEGIN_BRAKING_MPS2, CLEAR_GAP_M, DRIVERS, Site, Starts, speed_behind
from hid2.insertion.surroundings import Surroundings
from hid2.kernels.polyline import frenet
from hid2.measures.manoeuvres import PARKED_MPS
from hid2.motion.lane_change_path import LateralTiming
from hid2.motion.route import DrivenPath
from hid2.occupancy.along_path import PathOccupancy
from hid2.occupancy.traffic import BoolArray
from hid2.policy.decision import Side
from hid2.policy.observation import admissible_neighbor
from hid2.policy.overtake import SHIFT_RATIO, shortest_shift_s
from hid2.reasons import Reason
from hid2.scene import SLOW_LEADER_SHARE, clearance_box
from hid2.vehicle import Start, VehicleRequest

#: Not parameters, they save time: routes on which places are looked for, drawn on each, and rolled out at most.
_ROUTES, _DRAWS, _ROLLED_OUT = 40, 120, 20
#: No tunables, what is drawn: an added leader drives no slower, m/s; s of the speed difference from the leader at the
#: start, beyond the gap at standstill.
_SLOWEST_MPS, _GAP_S = 3.0, (1.0, 4.0)
#: Not parameters, they save time: s between two looks at places, places tried on one way, and how many there
#: are to choose among for each that is tried.
_LOOKS_S, _TRIED, _ENOUGH = 0.5, 2, 3
#: Not parameters, they save rollouts: share of a lateral motion at which the centre has crossed the line; s kept above
#: a TTC; m by which it may seem late for the way back, as this is rough; how fast a driver settles at the desired
#: speed, over that speed and the acceleration; and the speed in a lateral motion over what its sharpest bend allows, as
#: smoothing rounds it.
_CROSSED, _SPARE_S, _LATE_M, _SETTLES, _BENDS = 0.5, 0.2, 5.0, 2.5, 1.4


@dataclass(frozen=True, eq=False, slots=True)
class _Way:
    """A route past: its vehicle begins at first to last m on the path, and has the lane of `beside` from there on.

    apart_m: of the two lanes; shift_m: arc length on the path beside minus that on the own one.
    """

    offer: RouteOffer
    lane_id: int
    side: Side
    path: DrivenPath
    beside: DrivenPath
    first: float
    last: float
    apart_m: float
    shift_m: float


@dataclass(frozen=True, eq=False, slots=True)
class _Drawn:
    """Gaps (N,) m at the start to leaders: speeds m/s, and how far they are from their starts at looks (N, K) m.

    start_s (N,) m on the path, of those behind known leaders; None: anywhere, behind added ones.
    """

    gap_m: FloatArray
    leader_mps: FloatArray
    leader_m: FloatArray
    start_s: FloatArray | None = None


class _Motions(NamedTuple):
    """Starts (N,) m on the path and m/s with places (N, K) m at looks; those out (N, K) m since the trigger, m.

    back_s (N, 1): where the way back begins; across_m (N, 1): how far a lateral motion goes; leader_s (N,) m,
    leader_mps (N,); spare_m (N,): driven after the way back; added (N,): whether the leader is.
    """

    start_s: FloatArray
    start_mps: FloatArray
    s: FloatArray
    out_m: FloatArray
    back_s: FloatArray
    across_m: FloatArray
    leader_s: FloatArray
    leader_mps: FloatArray
    spare_m: FloatArray
    added: BoolArray

    def rows(self, rows: IntArray) -> "_Motions":
        """Some of them, in this order."""
        return _Motions._make(column[rows] for column in self)


#: Places are looked for with a usual vehicle.
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
        scene, rng = self.here.scene, self.starts.rng
        self.found_none = Reason.NO_OVERTAKE_FORESEEN if slow is not None else Reason.NO_SLOW_LEADER
        if request.trigger_s + 2.0 * shortest_shift_s(scene.config) > scene.last_s:
            return []  # out and back alone take longer
        ways, likely = self.here.routes.ways_past, list[tuple[_Way, Driver, _Motions]]()
        looked = 0
        for place in np.resize(rng.permutation(len(ways)), 6 * len(ways)).tolist():
            drivers = [
                draw_driver(scene.config, rng, lane_speed_mps=scene.lane_speed(ways[place][1], rng))
                for _ in range(DRIVERS)
            ]
            driver = max(drivers, key=lambda one: one.desired_mps)  # that of an overtaker is in a hurry
            way = self._way(*ways[place], reach_m=driver.desired_mps * request.trigger_s)
            if way is None:
                continue
            looked += 1
            for drawn in (self._behind_known, self._behind_added)[: 2 if slow is not None else 1]:
                motions = self._likely(way, driver, request.trigger_s, drawn(way, driver))
                likely += [(way, driver, motions.rows(np.array([n]))) for n in range(motions.start_s.size)[:_TRIED]]
            if looked == _ROUTES or len(likely) >= _ENOUGH * _ROLLED_OUT:
                break
        likely.sort(key=lambda one: -float(one[2].spare_m[0]))
        ranks, on_lane = list[int](), Counter[int]()
        for way, _, _ in likely:  # the best of each lane first: what is in the way is mostly in the way of all
            ranks.append(on_lane[way.lane_id])
            on_lane[way.lane_id] += 1
        for n in np.argsort(ranks, kind="stable")[:_ROLLED_OUT].tolist():
            way, driver, motion = likely[n]
            self.found_none = None
            found = self._starts(request, slow, way, driver, motion)
            if found:
                return found
        return []

    def _way(self, offer: RouteOffer, lane_id: int, side: Side, *, reach_m: float) -> _Way | None:
        """A way past with its paths; None where it begins farther than reach_m from the lane."""
        scene, stretch = self.here.scene, self.here.routes.together(offer, side)
        lanes, row, at = scene.grid.graph.lanes, 0, 0.0
        lane_end = offer.start_m + lanes[lane_id].length_m
        if stretch is None or stretch[0] - reach_m > lane_end:
            return None
        while at + lanes[offer.route[row]].length_m <= stretch[0] + 0.5:
            at, row = at + lanes[offer.route[row]].length_m, row + 1
        neighbor = admissible_neighbor(scene, offer.route[row], side)
        if neighbor is None:
            return None
        path, beside = scene.paths.along(offer.route), scene.paths.beside(offer.route[row:], neighbor)
        first, last = path.to_line(max(offer.start_m, stretch[0] - reach_m)), path.to_line(lane_end)
        here_s = np.array([max(first, path.to_line(stretch[0]))])
        there, aside = frenet(path.line.position(here_s), beside.raw_line.points, beside.raw_line.s)
        shift_m = float((beside.all_to_line(there) - here_s)[0])
        return _Way(offer, lane_id, side, path, beside, first, last, abs(float(aside[0])), shift_m)

    def _behind_known(self, way: _Way, driver: Driver) -> _Drawn:
        """Behind recorded cars and buses, and inserted vehicles, that are slower at the start."""
        scene, overtake, length_m = self.here.scene, self.here.scene.config.overtake, _BOX.length_m
        known, last = self.starts.world.guard.known_on(way.path, _BOX), scene.num_steps - 1
        recorded = scene.kept_clear_on(way.path, _BOX, scene.future).agents.size
        usable = np.isin(known.agents, scene.vehicle_rows) | (np.arange(known.agents.size) >= recorded)
        usable &= known.same_direction[:, 0] & (known.along[:, 0] > PARKED_MPS)
        slow = np.flatnonzero(usable & np.isfinite(known.low[:, : last + 1]).all(axis=1))
        driven_m = known.high[slow, last] - known.low[slow, 0]
        can = known.along[slow, 0] < driver.desired_mps - overtake.speed_advantage_mps
        can &= driven_m + length_m + overtake.return_gap_m < driver.desired_mps * scene.last_s
        rows = np.repeat(slow[can], 2 * _TRIED)
        gap_m = self._gap_m(driver, known.along[rows, 0])
        start = known.low[rows, 0] - gap_m
        near = (start > way.first) & (start < way.last)
        rows, start, gap_m = rows[near], start[near], gap_m[near]
        leader_m = known.high[rows][:, self._looks()] - length_m - start[:, None]
        return _Drawn(gap_m, known.along[rows, 0], leader_m, start)

    def _behind_added(self, way: _Way, driver: Driver) -> _Drawn:
        """Behind leaders at some share of the lane's usual speed."""
        scene, rng = self.here.scene, self.starts.rng
        share = rng.uniform(*SLOW_LEADER_SHARE, size=_DRAWS)
        slow_mps = np.maximum(_SLOWEST_MPS, share * self.here.scene.usual_speed(way.lane_id))
        slow_mps = slow_mps[slow_mps < driver.desired_mps - scene.config.overtake.speed_advantage_mps]
        gap_m = self._gap_m(driver, slow_mps)
        leader_m = (_BOX.length_m + gap_m)[:, None] + slow_mps[:, None] * self._looks() * scene.step_s
        return _Drawn(gap_m, slow_mps, leader_m)

    def _looks(self) -> IntArray:
        """Steps (K,) at which places are looked at."""
        return np.arange(0, self.here.scene.num_steps, self.here.scene.steps_in(_LOOKS_S))

    def _gap_m(self, driver: Driver, leader_mps: FloatArray) -> FloatArray:
        """Bumper gaps (N,) m at the start, by the speed at which the driver closes in."""
        share = self.starts.rng.uniform(*_GAP_S, size=leader_mps.size)
        return np.asarray(driver.min_gap_m + share * (driver.desired_mps - leader_mps))

    def _likely(self, way: _Way, driver: Driver, trigger_s: float, drawn: _Drawn) -> _Motions:
        """Motions that are past their leaders and back in time, and touch none; the soonest first."""
        if not drawn.gap_m.size:
            return _Motions._make([np.zeros(0)] * len(_Motions._fields))
        motions, looks = self._in_time(way, driver, trigger_s, drawn), self._looks()
        if self.here.scene.config.request.sites == "any" or not motions.start_s.size:
            return motions
        s, out_m, across_m = motions.s, motions.out_m, motions.across_m
        own, beside = (self.starts.world.guard.known_on(path, _BOX) for path in (way.path, way.beside))
        met = _taken(own, looks, s) & ((out_m < _CROSSED * across_m) | (s > motions.back_s))
        first = out_m.shape[1] - (out_m > 0.0).sum(axis=1).max(initial=1)  # the first look at which it may be out
        enters = self._may_enter(beside, driver, int(looks[first]), s[:, first] + way.shift_m)
        return motions.rows(np.flatnonzero(enters & ~met.any(axis=1)))

    def _in_time(self, way: _Way, driver: Driver, trigger_s: float, drawn: _Drawn) -> _Motions:
        """Motions that come past and back in the time and on the stretch that there is; the soonest first.

        As a driver begins behind a leader, slower by the trigger, then towards the desired speed as the IDM
        does near to it. A lateral motion takes its time, or its length where the vehicle is slow.
        """
        scene, change, overtake = self.here.scene, self.here.scene.config.lane_change, self.here.scene.config.overtake
        desired, length_m = driver.desired_mps, _BOX.length_m
        start_mps = np.minimum(driver.desired_mps, speed_behind(drawn.gap_m, drawn.leader_mps, driver))
        timing = LateralTiming.of(SHIFT_RATIO * driver.lane_change_s, way.apart_m, change)
        # v2 kappa of a lateral motion is what the driver takes: of `lateral_share`, D over the square of its length
        sharpest = 2.0 * way.apart_m / (timing.ramp * (1.0 - timing.ramp))
        across_m = timing.lasting_s * max(timing.slow_mps, desired)
        desired = min(desired, _BENDS * math.sqrt(driver.turn_lateral_mps2 / sharpest) * across_m)
        times, settles_s = self._looks() * scene.step_s, desired / (_SETTLES * driver.accel_mps2)
        free, lag_s = np.maximum(times - trigger_s, 0.0), scene.config.drivers.reaction_s
        slow_s = np.minimum(free, lag_s) + settles_s * (1.0 - np.exp(-np.maximum(free - lag_s, 0.0) / settles_s))
        out_mps = np.maximum(start_mps - BEGIN_BRAKING_MPS2 * trigger_s, drawn.leader_mps)[:, None]
        out_mps = np.minimum(out_mps, desired)
        out_m = out_mps * slow_s + desired * (free - slow_s)
        m = 0.5 * (start_mps[:, None] + out_mps) * np.minimum(times, trigger_s) + out_m
        past = (m > drawn.leader_m + length_m + overtake.return_gap_m) & (out_m > across_m)
        back_m = np.where(past.any(axis=1), m[np.arange(len(m)), past.argmax(axis=1)], 1e9)
        spare_m = m[:, -1] - back_m - across_m
        last = np.minimum(way.last, way.path.exit_s - m[:, -1])
        start = drawn.start_s
        if start is None:
            start = way.first + np.maximum(last - way.first, 0.0) * self.starts.rng.random(spare_m.size)
        room_m = (scene.config.conflict.ttc_min_s + _SPARE_S) * (
            np.gradient(m, times, axis=1) - drawn.leader_mps[:, None]
        )
        is_behind = (m + room_m < drawn.leader_m - length_m) | (out_m > _CROSSED * across_m)
        fits = (start >= way.first) & (start <= last)
        if scene.config.request.sites != "any":
            fits &= (spare_m > -_LATE_M) & is_behind.all(axis=1) & (start_mps > drawn.leader_mps)
        rows = np.flatnonzero(fits)
        rows = rows[np.argsort(-spare_m[rows], kind="stable")]
        leader_s, place = start + drawn.leader_m[:, 0], start[:, None]
        return _Motions(
            start, start_mps, place + m, out_m, place + back_m[:, None], np.full_like(place, across_m), leader_s,
            drawn.leader_mps, spare_m, np.full(start.size, drawn.start_s is None),
        ).rows(rows)  # fmt: skip

    def _may_enter(self, beside: PathOccupancy, driver: Driver, at: int, s: FloatArray) -> BoolArray:
        """Whether Algorithm 1 finds its gaps and its corridor at a step at places (N,) m on the lane beside."""
        overtake = self.here.scene.config.overtake
        low, high, along = beside.low[:, at], beside.high[:, at], beside.along[:, at]
        free_m = np.where(along < driver.desired_mps, overtake.d_overtake_m, overtake.safe_front_m)
        in_the_way = (high > s[:, None] - overtake.safe_rear_m) & (low < s[:, None] + free_m)
        return np.asarray(~in_the_way.any(axis=1))

    def _starts(
        self, request: VehicleRequest, slow: VehicleRequest | None, way: _Way, driver: Driver, one: _Motions
    ) -> list[Start]:
        """The vehicle, after its leader where one is added; empty where a rollout speaks against one of them."""
        starts, world, leaders, raw = self.starts, self.starts.world, list[Start](), way.path.to_raw
        if one.added[0] and slow is not None:
            mps = float(one.leader_mps[0])
            base = draw_driver(self.here.scene.config, starts.rng, lane_speed_mps=mps)
            leader = starts.make(
                slow, Site(way.offer, raw(float(one.leader_s[0]))), driver=replace(base, desired_mps=mps), speed_mps=mps
            )
            if not isinstance(leader, Start):
                starts.rejected[leader] += 1
                return []
            leaders, starts.world = [leader], world.joined_by(*starts.rolled(leader))
        found = starts.make(
            request, Site(way.offer, raw(float(one.start_s[0]))), driver=driver, speed_mps=float(one.start_mps[0]),
            sides=(way.side,),
        )  # fmt: skip
        starts.world = world
        if isinstance(found, Start):
            return starts.take([*leaders, found])
        starts.rejected[found] += 1
        return []


def _taken(known: PathOccupancy, looks: IntArray, s: FloatArray) -> BoolArray:
    """Whether a box at places (N, K) m at looks (K,), with room ahead, half of it behind, touches any known, (N, K)."""
    low, high = known.low[:, looks] - CLEAR_GAP_M, known.high[:, looks] + 0.5 * CLEAR_GAP_M
    return np.asarray(((low[None] < s[:, None]) & (s[:, None] < high[None])).any(axis=1))
