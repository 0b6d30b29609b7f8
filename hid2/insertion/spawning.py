"""Vehicles for free places: where they start, how fast, and on which route, each with a motion that meets nobody.

Paper: generated agents can be placed in any unoccupied cell (sigma = 0). Here the whole box is free, nobody recorded
would run into it, nobody appears inside it, and a speed profile exists that meets nobody on the way.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from hid2.agents import DEFAULT_SIZES, BoxSize, FloatArray, Policy
from hid2.conflicts.cases import DT_S, Prospect
from hid2.conflicts.speed_plan import SpeedPlan
from hid2.insertion.draws import Draws
from hid2.insertion.foresight import PASS_STEPS, Foresight, Intention, Wish
from hid2.insertion.places import Places
from hid2.insertion.screening import BEND_M, Candidate, Screening, shares_at_spawn
from hid2.insertion.starts import Start
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.motion.route import DrivenPath, Route, Way
from hid2.occupancy.along_path import meet_all
from hid2.occupancy.sigma import FREE, GENERATED, UNDER_SHARE, cells_under
from hid2.occupancy.traffic import BoolArray, Traffic
from hid2.policy.decision import Side
from hid2.policy.turns import TURN_OF_POLICY
from hid2.scene import PlannedVehicle, World, predicted_traffic

#: Quantiles of labelled boxes (share, length m, width m): cars, box trucks, buses.
_CAR = ((0.0, 3.8, 1.72), (0.1, 4.0, 1.76), (0.5, 4.2, 1.87), (0.9, 5.2, 2.05), (1.0, 5.6, 2.12))
_TRUCK = ((0.0, 7.0, 2.3), (0.5, 9.6, 2.6), (1.0, 10.5, 2.7))
_BUS = ((0.0, 10.5, 2.7), (0.5, 11.6, 2.9), (1.0, 12.3, 2.95))
_MIN_MOVE_M, _MIN_MOVE_LATE_M = 10.0, 3.0
_KEEP_FREE_M = 4.0
_EDGE_M, _EDGE_MPS = 6.0, 2.0  # nobody slows down at the edge of the map because it is one
_TRIGGERS = 4  # moments tried for a lane change at a place
_PROGRESS = 0.9  # of what the desired speed makes up to the trigger, usually
_BEGINNING, _BEGINS_BRAKING_MPS2 = 20, 2.5  # steps of the scene in which nobody brakes harder, if it can be
#: Desired speed of an overtaker: slower ones do not get past within a scene, faster ones find no corridor in traffic.
_OVERTAKER_MPS = (9.0, 11.0)
_FASTER_MPS = 3.5  # than the leader: who is slower does not get past within a scene
_LEADER_SHARE, _LEADER_MPS = (0.3, 0.4), 2.8  # of the overtaker's speed: slow enough to be passed within a scene
_LEADER_SPARE_M = (8.0, 4.0, 0.5)  # beyond the gap at which the overtaker would begin to brake
_SCREENED_LATER = 8
_SCREENED_MOST = 32  # candidates in one go; fewer at first, because what follows the first possible one is in vain
_NO_BETTER_SLOWER = frozenset({"turn_not_reached", "would_stand", "curve_too_sharp"})
#: Objections that cost nothing to find do not count as attempts.
_SEEN_AT_ONCE = frozenset(
    {
        "no_room_on_lane",
        "leaves_too_early",
        "would_turn",
        "no_lane_beside_at_trigger",
        "cells_occupied",
        "lanes_part_too_soon",
        "overtake_leader_not_slower",
    }
)


@dataclass(slots=True)
class Spawner:
    """Chooses vehicles one after the other; each one planned is an obstacle to the next.

    fixed: generated vehicles of earlier rounds, with their final motion. patience: 0 takes only places where a vehicle
    drives as it likes; from 1 on it may start slowly, from 2 on it may stand in a queue. reasons counts what was turned
    down; led_by tells which overtakers brought their own leader.
    """

    places: Places
    fixed: Traffic
    patience: int = 0
    planned: list[PlannedVehicle] = field(default_factory=list)
    reasons: Counter[str] = field(default_factory=Counter)
    led_by: dict[str, str] = field(default_factory=dict)
    _sigma: np.ndarray[tuple[int], np.dtype[np.uint8]] = field(init=False)
    _crowded: BoolArray = field(init=False)
    _ahead: Foresight = field(init=False)
    _screening: Screening = field(init=False)
    _against: dict[Policy, Counter[str]] = field(default_factory=dict)
    _exhausted: set[Policy] = field(default_factory=set)
    _streams: dict[Policy, Iterator[tuple[Way, float] | None]] = field(default_factory=dict)
    _left: dict[Policy, list[tuple[Way, float]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Occupancy at step 0, with the fixed vehicles in it."""
        self._sigma = self.world.occupancy.sigma[0].copy()
        self._crowded = self._crowds(self.world.traffic) | self._crowds(self.fixed)
        for row in range(len(self.fixed.ids)):
            if self.fixed.present[row, 0]:
                x, y = self.fixed.position[row, 0].tolist()
                size = BoxSize(self.fixed.length_m[row], self.fixed.width_m[row])
                self._mark(x, y, float(self.fixed.heading[row, 0]), size)
        self._screening = Screening(self.places)
        nobody = predicted_traffic([], self.world.num_steps)
        self._ahead = Foresight(self.world, self.fixed, nobody, nobody)

    @property
    def world(self) -> World:
        """The scene that the places are in."""
        return self.places.world

    @property
    def draws(self) -> Draws:
        """What everything here is drawn from."""
        return self.places.draws

    def spawn(self, policy: Policy, vehicle_id: str, *, attempts: int) -> PlannedVehicle | None:
        """Plan one vehicle for a policy; None, with the reasons counted, where no candidate of `attempts` holds.

        Candidates that were turned down are not tried again by this spawner: there is only less room later.
        """
        wish = Wish(policy, vehicle_id, *self._draw_size(), self._draw_trigger(policy))
        against: Counter[str] = Counter()
        count = tried = _SCREENED_LATER if self.patience > 0 else 1
        while places := self._next(policy, min(count, attempts - _closely(against)), against):
            candidates = [self._candidate(wish, way, s0) for way, s0 in places]
            screened = self._screening.starts(candidates, self._ahead, self._sigma, self.patience)
            for row, (candidate, start) in enumerate(zip(candidates, screened, strict=True)):
                vehicle = start if isinstance(start, str) else self._from(candidate, start)
                if isinstance(vehicle, PlannedVehicle):
                    self._add(vehicle)
                    rest = zip(places[row + 1 :], screened[row + 1 :], strict=True)
                    possible = [place for place, start in rest if isinstance(start, Start)]
                    self._left[policy] = possible + self._left[policy]
                    return vehicle
                against[vehicle] += 1
            tried += count
            count = max(count, min(tried // 4, _SCREENED_MOST))
        self._note(policy, against)
        return None

    def spawn_overtake(self, vehicle_id: str, leader_id: str | None, *, attempts: int) -> tuple[PlannedVehicle, ...]:
        """Plan an overtaker, behind a slower vehicle that is there or behind a new slow leader.

        leader_id: of the new leader; None where there is no room for one in the count, or none is allowed.
        """
        object_type, own = self._draw_size()
        against: Counter[str] = Counter()
        if self.world.config.request.trigger_min_s / DT_S >= self.world.num_steps - PASS_STEPS:
            self._note(Policy.OVERTAKE, Counter({"overtake_scene_too_short": 1}))
            return ()
        while places := self._next(Policy.OVERTAKE, min(1, attempts - _closely(against)), against):
            way, s0 = places[0]
            cruise = self.draws.uniform(*_OVERTAKER_MPS)
            wish = Wish(Policy.OVERTAKE, vehicle_id, object_type, own, self._draw_trigger(Policy.OVERTAKE), cruise)
            leader = self._ahead.leader_at_start(wish, self.world.path(way.route), s0)
            if leader is not None and leader.speed_mps + _FASTER_MPS > cruise:
                against["overtake_leader_not_slower"] += 1
                continue
            found = self._overtaker(wish, way, s0, leader_id)
            if isinstance(found, tuple):
                return found
            against[found] += 1
        self._note(Policy.OVERTAKE, against)
        return ()

    def look_again(self) -> None:
        """Take all candidates anew, with more patience."""
        self.patience += 1
        self._streams, self._left = {}, {}

    def close_up(self, world: World) -> None:
        """Look for places with the gaps of another view of the same scene from now on."""
        self.places.world, before = world, self._ahead
        self._ahead = Foresight(world, self.fixed, before.predicted, before.claims)
        self._crowded = self._crowds(world.traffic) | self._crowds(self.fixed) | self._crowds(before.predicted)
        self._screening.forget()

    def why_none(self, policy: Policy) -> str:
        """What speaks against another vehicle of a policy.

        map_offers_no_...: nothing on the map; no_place:...: every cell was tried, with what was said most often; else
        what was said most often of those that were tried.
        """
        if not self.places.offers(policy):
            return f"map_offers_no_{policy.value}"
        against = self._against.get(policy, Counter())
        # what took a closer look says more than the many cells that are simply taken
        order = sorted(against, key=lambda reason: (reason in _SEEN_AT_ONCE, -against[reason], reason))
        reason = order[0] if order else "no_free_cell"
        return f"no_place:{reason}" if policy in self._exhausted else reason

    def _note(self, policy: Policy, against: Counter[str]) -> None:
        self.reasons.update(against)
        self._against.setdefault(policy, Counter()).update(against)

    def _next(self, policy: Policy, count: int, against: Counter[str]) -> list[tuple[Way, float]]:
        """The next places of a policy, at most `count`: first those that another vehicle did not need."""
        left = self._left.setdefault(policy, [])
        found, self._left[policy] = left[: max(count, 0)], left[max(count, 0) :]
        if policy not in self._streams:
            self._streams[policy] = self.places.candidates(policy, self._is_free, self.patience)
        while len(found) < count:
            try:
                place = next(self._streams[policy])
            except StopIteration:
                self._exhausted.add(policy)
                break
            if place is None:
                against["cells_occupied"] += 1
            else:
                found.append(place)
        return found

    def _is_free(self, cell: int) -> bool:
        free = self._sigma[cell] == FREE and not self._crowded[cell]
        return bool(free) or "collision" in self.world.config.without

    def _crowds(self, traffic: Traffic) -> BoolArray:
        """(C,) cells in which no car, wherever it is in them, keeps its distance to somebody at step 0.

        What is common to its boxes, with the distance, all along a cell.
        """
        cells, usual = self.world.boxes, DEFAULT_SIZES["vehicle"]
        apart_m = 2 * (self.world.config.spawn.clear_gap_m - BEND_M)
        common_m = np.maximum(usual.length_m + apart_m - cells.length_m, 0.0)
        return meet_all(traffic, 0, cells.center, cells.heading, common_m, usual.width_m)

    def _overtaker(self, wish: Wish, way: Way, s0: float, leader_id: str | None) -> tuple[PlannedVehicle, ...] | str:
        vehicle = self._try(wish, way, s0)
        if isinstance(vehicle, PlannedVehicle):
            self._add(vehicle)
            return (vehicle,)
        if vehicle != "no_leader" or leader_id is None or wish.cruise_mps is None:
            return vehicle
        slow = max(wish.cruise_mps * self.draws.uniform(*_LEADER_SHARE), _LEADER_MPS)
        own = BoxSize(*_quantile(_CAR, self.draws.unit()))
        lead = Wish(Policy.STRAIGHT, leader_id, "vehicle", own, 0.0, slow, steady=True)
        apart = self._ahead.following_apart_m(wish, lead)
        reason = "no_leader"
        for spare in _LEADER_SPARE_M:
            leader = self._try(lead, way, s0 + apart + spare)
            if not isinstance(leader, PlannedVehicle):
                reason = f"leader_{leader}"
                continue
            before = self._sigma.copy(), self._crowded, self._ahead
            self._add(leader)
            vehicle = self._try(wish, way, s0)
            if isinstance(vehicle, PlannedVehicle):
                self._add(vehicle)
                self.led_by[vehicle.vehicle_id] = leader_id
                return (vehicle, leader)
            self.planned.pop()
            self._sigma, self._crowded, self._ahead = before
            self._screening.forget()  # what was seen with the leader
            reason = vehicle
        return reason

    def _try(self, wish: Wish, way: Way, s0: float) -> PlannedVehicle | str:
        """A planned vehicle, or the reason against it."""
        candidate = self._candidate(wish, way, s0)
        start = self._screening.starts([candidate], self._ahead, self._sigma, self.patience)[0]
        return start if isinstance(start, str) else self._from(candidate, start)

    def _candidate(self, wish: Wish, way: Way, s0: float) -> Candidate:
        """What is drawn for a place."""
        cruise = wish.cruise_mps
        if cruise is None:
            cruise = self.world.speed_sample(way.on_lane(s0)[0], self.draws)
        if wish.policy is Policy.LANE_CHANGE:
            wish = replace(wish, trigger_s=self._draw_trigger(wish.policy))  # late ones suit few places
            wish = self._when_beside(wish, way, s0, cruise)
        keeps = wish.steady or wish.policy is Policy.OVERTAKE
        return Candidate(wish, way, s0, cruise, cruise if keeps else cruise * self.draws.uniform(0.85, 1.0))

    def _from(self, candidate: Candidate, start: Start) -> PlannedVehicle | str:
        """A planned vehicle from a start, or the reason against it."""
        wish, s0, cruise, route = candidate.wish, candidate.s0, candidate.cruise_mps, candidate.way.route
        path = self.world.path(route)
        if "collision" in self.world.config.without:
            return self._unchecked(wish, route, path, s0, cruise)
        look = self._ahead.prospect(path, wish.size, cruise)
        intention = self._intend(candidate, path, look, start)
        if isinstance(intention, str):
            return intention
        conflict = self._ahead.conflict(wish, intention)
        if conflict is not None:
            return conflict
        return PlannedVehicle(
            vehicle_id=wish.vehicle_id, policy=wish.policy, object_type=wish.object_type, size=wish.size,
            own_size=wish.own_size, route=route, path=path, s0=s0, v0=float(intention.own.v[0]), cruise_mps=cruise,
            trigger_s=wish.trigger_s, plan_s=intention.own.s, plan_v=intention.own.v, sides=intention.sides,
            intended_path=intention.path, intended_s=intention.plan.s, claims=intention.claims,
        )  # fmt: skip

    def _intend(self, candidate: Candidate, path: DrivenPath, look: Prospect, start: Start) -> Intention | str:
        """What it will do from here, starting as fast as it may or slower; or why nothing comes of it."""
        wish, s0, cruise = candidate.wish, candidate.s0, candidate.cruise_mps
        if wish.policy is Policy.OVERTAKE:
            if self.places.too_sharp(path, s0, s0 + cruise * self.world.num_steps * DT_S):
                return "curve_too_sharp"
            return self._ahead.overtake(wish, path, s0, start.v0, cruise, obstacles=self.patience > 0)
        speeds = [share * start.v0 for share in shares_at_spawn(wish.policy, self.patience)]
        reason, plan = "no_safe_timing", start.plan
        while plan is not None:
            for unhurried in self._unhurried_first(look, plan):
                intention = self._on_plan(wish, path, look, unhurried, cruise, candidate.turn_end)
                if isinstance(intention, Intention):
                    return intention
                reason = intention
            speeds = [speed for speed in speeds if speed < plan.v[0]]  # it may come about from a slower start
            if reason in _NO_BETTER_SLOWER or not speeds:
                break
            plan = look.plan(s0=s0, v0=speeds, a0=0.0, first_step=0, config=self.world.config)
        return reason

    def _on_plan(
        self, wish: Wish, path: DrivenPath, look: Prospect, plan: SpeedPlan, cruise: float, turn_end: float
    ) -> Intention | str:
        """What it will do on a plan along its own path; or why nothing comes of it."""
        if not self._moves(look, plan.s):
            return "would_stand"
        edge = path.exit_s - wish.size.length_m / 2
        if plan.s[-1] > edge and np.any((plan.v < _EDGE_MPS) & (plan.s > edge - _EDGE_M) & (plan.s <= edge)):
            return "stops_at_map_edge"
        if self.places.too_sharp(path, float(plan.s[0]), float(plan.s[-1])):
            return "curve_too_sharp"
        if wish.policy in TURN_OF_POLICY:
            return self._ahead.turn(wish, path, plan, turn_end)
        if wish.policy is Policy.LANE_CHANGE:
            sides: tuple[Side, ...] = ("left", "right") if self.draws.unit() < 0.5 else ("right", "left")
            return self._ahead.lane_change(wish, path, plan, cruise, sides)
        return Intention(path, plan, plan)

    def _unhurried_first(self, look: Prospect, plan: SpeedPlan) -> Iterator[SpeedPlan]:
        """The plan; before it, where it begins with braking, one from a slower start, as who saw that came."""
        if float(np.diff(plan.v[: _BEGINNING + 1]).min()) < -_BEGINS_BRAKING_MPS2 * DT_S:
            slower = look.plan(
                s0=float(plan.s[0]), v0=float(plan.v[_BEGINNING]), a0=0.0, first_step=0, config=self.world.config
            )
            if slower is not None:
                yield slower
        yield plan

    def _moves(self, look: Prospect, s: FloatArray) -> bool:
        """Whether a vehicle goes anywhere, or stands for a reason that can be seen."""
        moved = float(s[-1] - s[0])
        if moved >= _MIN_MOVE_M or (self.patience >= 1 and moved > _MIN_MOVE_LATE_M):
            return True
        low, along = look.occupancy.low[:, 0], np.abs(look.occupancy.along[:, 0])
        queue = (low > s[0]) & (low < s[0] + 15.0) & (along < 1.0) & look.occupancy.aligned[:, 0]
        return self.patience >= 2 and bool(queue.any())

    def _unchecked(self, wish: Wish, route: Route, path: DrivenPath, s0: float, cruise: float) -> PlannedVehicle:
        """Ablation without collision checks: any cell, the desired speed, nobody looked at."""
        desired = self.world.desired(path, cruise)
        steps = self.world.num_steps
        s, v = np.empty(steps), np.empty(steps)
        s[0] = s0
        for k in range(steps):
            v[k] = desired[min(int(s[k] / TABLE_STEP_M), desired.size - 1)]
            if k + 1 < steps:
                s[k + 1] = s[k] + v[k] * DT_S
        return PlannedVehicle(
            vehicle_id=wish.vehicle_id, policy=wish.policy, object_type=wish.object_type, size=wish.size,
            own_size=wish.own_size, route=route, path=path, s0=s0, v0=float(v[0]), cruise_mps=cruise,
            trigger_s=wish.trigger_s, plan_s=s, plan_v=v, sides=("left", "right"), intended_path=path, intended_s=s,
        )  # fmt: skip

    def _draw_size(self) -> tuple[str, BoxSize]:
        request = self.world.config.request
        kind, share = self.draws.unit(), self.draws.unit()
        if kind < request.bus_share:
            return "bus", BoxSize(*_quantile(_BUS, share))
        if kind < request.bus_share + request.truck_share:
            return "vehicle", BoxSize(*_quantile(_TRUCK, share))
        return "vehicle", BoxSize(*_quantile(_CAR, share))

    def _draw_trigger(self, policy: Policy) -> float:
        """t_trigger, uniform in the range asked for, within the first 40 % of the scene where the range allows.

        Overtakes, which need most of a scene, take it from the first quarter of the range.
        """
        request = self.world.config.request
        low, high = request.trigger_min_s, request.trigger_max_s
        high = max(low, min(high, 0.4 * self.world.num_steps * DT_S))  # a short scene still has time for the manoeuvre
        if policy is Policy.OVERTAKE:
            high = low + 0.25 * (high - low)
        return self.draws.uniform(low, high) if high > low else low

    def _when_beside(self, wish: Wish, way: Way, s0: float, cruise: float) -> Wish:
        """With a moment of the range asked for at which a lane is likely to lie beside, if one of a few is such."""
        for _ in range(_TRIGGERS):
            if self.places.lies_beside(way, s0 + _PROGRESS * cruise * wish.trigger_s):
                break
            wish = replace(wish, trigger_s=self._draw_trigger(wish.policy))
        return wish

    def _add(self, vehicle: PlannedVehicle) -> None:
        self.planned.append(vehicle)
        start = np.array([vehicle.s0])
        xy = vehicle.path.line.position(start)[0]
        self._mark(float(xy[0]), float(xy[1]), float(vehicle.path.line.heading(start)[0]), vehicle.size)
        one = predicted_traffic([_foreseen(vehicle)], self.world.num_steps)
        self._crowded = self._crowded | self._crowds(one)
        claims = self._ahead.claims if vehicle.claims is None else self._ahead.claims.joined(vehicle.claims)
        self._ahead = Foresight(self.world, self.fixed, self._ahead.predicted.joined(one), claims)

    def _mark(self, x: float, y: float, heading: float, size: BoxSize) -> None:
        under = cells_under(self.world.boxes, x, y, heading, length_m=size.length_m, width_m=UNDER_SHARE * size.width_m)
        self._sigma[under[self._sigma[under] == FREE]] = GENERATED


def _foreseen(vehicle: PlannedVehicle) -> tuple[str, DrivenPath, BoxSize, FloatArray]:
    """How the next ones see it: one that will change lanes keeps the cells free that it will ask for."""
    size = vehicle.size
    if vehicle.policy in (Policy.LANE_CHANGE, Policy.OVERTAKE):
        size = BoxSize(size.length_m + 2 * _KEEP_FREE_M, size.width_m)
    return vehicle.vehicle_id, vehicle.intended_path, size, vehicle.intended_s


def _closely(against: Counter[str]) -> int:
    """How many were turned down after a closer look."""
    return sum(count for reason, count in against.items() if reason not in _SEEN_AT_ONCE)


def _quantile(table: tuple[tuple[float, float, float], ...], share: float) -> tuple[float, float]:
    columns = np.array(table).T
    return round(float(np.interp(share, columns[0], columns[1])), 3), round(
        float(np.interp(share, columns[0], columns[2])), 3
    )
