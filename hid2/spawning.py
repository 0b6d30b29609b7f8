"""Vehicles for free places: where they start, how fast, and on which route, each with a motion that meets nobody.

Paper: generated agents can be placed in any unoccupied cell (sigma = 0). Here the whole box is free, nobody recorded
would run into it, nobody appears inside it, and a speed profile exists that meets nobody on the way.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numba import njit

from hid2.agents import DEFAULT_SIZES, BoxSize, FloatArray, Policy
from hid2.conflicts import DT_S, Prospect
from hid2.decision import Side
from hid2.draws import Draws
from hid2.foresight import PASS_STEPS, Foresight, Intention, Wish
from hid2.occupancy import FREE, GENERATED, cells_under
from hid2.path_occupancy import meet_all
from hid2.places import Places
from hid2.reference_line import TABLE_STEP_M
from hid2.route import DrivenPath, Route
from hid2.speed_plan import SpeedPlan
from hid2.traffic import BoolArray, Traffic
from hid2.turns import TURN_OF_POLICY
from hid2.world import PlannedVehicle, World, predicted_traffic

#: Quantiles of labelled boxes (share, length m, width m): cars, box trucks, buses.
_CAR = ((0.0, 3.8, 1.72), (0.1, 4.0, 1.76), (0.5, 4.2, 1.87), (0.9, 5.2, 2.05), (1.0, 5.6, 2.12))
_TRUCK = ((0.0, 7.0, 2.3), (0.5, 9.6, 2.6), (1.0, 10.5, 2.7))
_BUS = ((0.0, 10.5, 2.7), (0.5, 11.6, 2.9), (1.0, 12.3, 2.95))
_MIN_MOVE_M, _MIN_MOVE_LATE_M = 10.0, 3.0
_KEEP_FREE_M = 4.0
_EDGE_M, _EDGE_MPS = 6.0, 2.0  # nobody slows down at the edge of the map because it is one
_TRIGGERS = 4  # moments tried for a lane change at a place
_PROGRESS = 0.9  # of what the desired speed makes up to the trigger, usually
_BEHIND_M = 60.0
_BEGINNING, _BEGINS_BRAKING_MPS2 = 20, 2.5  # steps of the scene in which nobody brakes harder, if it can be
_EASES_MPS = 1.0  # by which who is behind may be too fast for its gap: it eases off the pedal
_BEND_M = 0.3  # by which gaps along a bend may differ from those straight ahead
#: Desired speed of an overtaker: slower ones do not get past within a scene, faster ones find no corridor in traffic.
_OVERTAKER_MPS = (9.0, 11.0)
_FASTER_MPS = 3.5  # than the leader: who is slower does not get past within a scene
_LEADER_SHARE, _LEADER_MPS = (0.3, 0.4), 2.8  # of the overtaker's speed: slow enough to be passed within a scene
_LEADER_SPARE_M = (0.5, 4.0, 8.0)  # beyond the gap at which the overtaker would begin to brake
#: Speeds at spawn that are tried, as shares of the one drawn: without patience, for a turn, with patience.
_SHARES, _TURN_SHARES, _PATIENT_SHARES = (1.0,), (1.0, 0.6), (1.0, 0.5, 0.0)
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
    _against: dict[Policy, Counter[str]] = field(default_factory=dict)
    _exhausted: set[Policy] = field(default_factory=set)
    _streams: dict[Policy, Iterator[tuple[Route, float] | None]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Occupancy at step 0, with the fixed vehicles in it."""
        self._sigma = self.world.occupancy.sigma[0].copy()
        self._crowded = self._crowds(self.world.traffic) | self._crowds(self.fixed)
        for row in range(len(self.fixed.ids)):
            if self.fixed.present[row, 0]:
                x, y = self.fixed.position[row, 0].tolist()
                size = BoxSize(self.fixed.length_m[row], self.fixed.width_m[row])
                self._mark(x, y, float(self.fixed.heading[row, 0]), size)
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
        object_type, own = self._draw_size()
        against: Counter[str] = Counter()
        for route, s0 in self._some(policy, attempts, against):
            wish = Wish(policy, vehicle_id, object_type, own, self._draw_trigger(policy))
            vehicle = self._try(wish, route, s0)
            if isinstance(vehicle, PlannedVehicle):
                self._add(vehicle)
                return vehicle
            against[vehicle] += 1
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
        for route, s0 in self._some(Policy.OVERTAKE, attempts, against):
            cruise = self.draws.uniform(*_OVERTAKER_MPS)
            wish = Wish(Policy.OVERTAKE, vehicle_id, object_type, own, self._draw_trigger(Policy.OVERTAKE), cruise)
            leader = self._ahead.leader_at_start(wish, self.world.path(route), s0)
            if leader is not None and leader.speed_mps + _FASTER_MPS > cruise:
                against["overtake_leader_not_slower"] += 1
                continue
            found = self._overtaker(wish, route, s0, leader_id)
            if isinstance(found, tuple):
                return found
            against[found] += 1
        self._note(Policy.OVERTAKE, against)
        return ()

    def look_again(self) -> None:
        """Take all candidates anew, with more patience."""
        self.patience += 1
        self._streams = {}

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

    def _some(self, policy: Policy, attempts: int, against: Counter[str]) -> Iterator[tuple[Route, float]]:
        """The next candidates of a policy, until `attempts` of them were turned down after a closer look."""
        if policy not in self._streams:
            self._streams[policy] = self.places.candidates(policy, self._is_free, self.patience)
        for place in self._streams[policy]:
            if place is None:
                against["cells_occupied"] += 1
                continue
            yield place
            if sum(count for reason, count in against.items() if reason not in _SEEN_AT_ONCE) >= attempts:
                return
        self._exhausted.add(policy)

    def _is_free(self, cell: int) -> bool:
        free = self._sigma[cell] == FREE and not self._crowded[cell]
        return bool(free) or "collision" in self.world.config.without

    def _crowds(self, traffic: Traffic) -> BoolArray:
        """(C,) cells in which no car, wherever it is in them, keeps its distance to somebody at step 0.

        What is common to its boxes, with the distance, all along a cell.
        """
        cells, usual = self.world.boxes, DEFAULT_SIZES["vehicle"]
        apart_m = 2 * (self.world.config.spawn.clear_gap_m - _BEND_M)
        common_m = np.maximum(usual.length_m + apart_m - cells.length_m, 0.0)
        return meet_all(traffic, 0, cells.center, cells.heading, common_m, usual.width_m)

    def _overtaker(
        self, wish: Wish, route: Route, s0: float, leader_id: str | None
    ) -> tuple[PlannedVehicle, ...] | str:
        vehicle = self._try(wish, route, s0)
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
            leader = self._try(lead, route, s0 + apart + spare)
            if not isinstance(leader, PlannedVehicle):
                reason = f"leader_{leader}"
                continue
            before = self._sigma.copy(), self._crowded, self._ahead
            self._add(leader)
            vehicle = self._try(wish, route, s0)
            if isinstance(vehicle, PlannedVehicle):
                self._add(vehicle)
                self.led_by[vehicle.vehicle_id] = leader_id
                return (vehicle, leader)
            self.planned.pop()
            self._sigma, self._crowded, self._ahead = before
            reason = vehicle
        return reason

    def _try(self, wish: Wish, route: Route, s0: float) -> PlannedVehicle | str:
        """A planned vehicle, or the reason against it."""
        world, config, size = self.world, self.world.config, wish.size
        cruise = (
            world.speed_sample(self.places.lane_at(route, s0), self.draws)
            if wish.cruise_mps is None
            else wish.cruise_mps
        )
        if wish.policy is Policy.LANE_CHANGE:
            wish = self._when_beside(wish, route, s0, cruise)
        unsuited = self.places.unsuited(wish, route, s0, cruise, self.patience)
        if unsuited is not None:
            return unsuited
        if "collision" in config.without:
            return self._unchecked(wish, route, world.path(route), s0, cruise)
        x, y, heading = self.places.pose(route, s0)
        under = cells_under(world.boxes, x, y, heading, length_m=size.length_m, width_m=0.8 * size.width_m)
        if np.any(self._sigma[under] != FREE):
            return "cells_occupied"
        if self._ahead.meets_at_start(x, y, heading, size, config.spawn.clear_gap_m - _BEND_M):
            return "box_too_close"  # seen before a path is laid and looked along
        path = world.path(route)
        turn_end = self._ahead.turn_end(wish, path, s0, cruise) if wish.policy in TURN_OF_POLICY else 0.0
        if isinstance(turn_end, str):
            return turn_end
        look = self._ahead.prospect(path, size, cruise)
        keeps = wish.steady or wish.policy is Policy.OVERTAKE
        v0 = self._entry_speed(look, s0, cruise if keeps else cruise * self.draws.uniform(0.85, 1.0))
        if isinstance(v0, str):
            return v0
        intention = self._intend(wish, path, look, s0, v0, cruise, turn_end)
        if isinstance(intention, str):
            return intention
        conflict = self._ahead.conflict(wish, intention)
        if conflict is not None:
            return conflict
        return PlannedVehicle(
            vehicle_id=wish.vehicle_id, policy=wish.policy, object_type=wish.object_type, size=size,
            own_size=wish.own_size, route=route, path=path, s0=s0, v0=float(intention.own.v[0]), cruise_mps=cruise,
            trigger_s=wish.trigger_s, plan_s=intention.own.s, plan_v=intention.own.v, sides=intention.sides,
            intended_path=intention.path, intended_s=intention.plan.s, claims=intention.claims,
        )  # fmt: skip

    def _intend(
        self, wish: Wish, path: DrivenPath, look: Prospect, s0: float, v0: float, cruise: float, turn_end: float
    ) -> Intention | str:
        """What it will do from here, starting at v0 or slower; or why nothing comes of it."""
        if wish.policy is Policy.OVERTAKE:
            if self.places.too_sharp(path, s0, s0 + cruise * self.world.num_steps * DT_S):
                return "curve_too_sharp"
            return self._ahead.overtake(wish, path, s0, v0, cruise, obstacles=self.patience > 0)
        turns = wish.policy in TURN_OF_POLICY
        shares = _PATIENT_SHARES if self.patience > 0 else _TURN_SHARES if turns else _SHARES
        speeds = [share * v0 for share in shares]
        reason = "no_safe_timing"
        while speeds:
            plan = look.plan(s0=s0, v0=speeds, a0=0.0, first_step=0, config=self.world.config)
            if plan is None:
                break
            speeds = speeds[speeds.index(float(plan.v[0])) + 1 :]  # a manoeuvre may come about from a slower start
            for unhurried in self._unhurried_first(look, plan):
                intention = self._on_plan(wish, path, look, unhurried, cruise, turn_end)
                if isinstance(intention, Intention):
                    return intention
                reason = intention
            if reason in _NO_BETTER_SLOWER:
                break
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

    def _entry_speed(self, look: Prospect, s0: float, wanted: float) -> float | str:
        """Spawn speed that suits the road and the gaps ahead and behind at step 0, or what forbids any."""
        spawn = self.world.config.spawn
        cell = int(s0 / TABLE_STEP_M + 0.5)
        occupancy = look.occupancy
        fastest, pushed = look.tables.speeds_at(0, s0)
        gentle_from = occupancy.low.shape[0] if self.patience > 0 else look.recorded_rows
        close, room, unbraked = _gaps_at_start(
            occupancy.low, occupancy.high, occupancy.along, occupancy.aligned, s0, spawn.clear_gap_m,
            spawn.clear_ahead_s, look.tables.follower, gentle_from,
        )  # fmt: skip
        if close:
            return "box_too_close"
        v0 = min(wanted, float(look.desired[cell]), fastest, room)
        return "follower_too_fast" if v0 < max(pushed, unbraked) else v0

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

    def _when_beside(self, wish: Wish, route: Route, s0: float, cruise: float) -> Wish:
        """With a moment of the range asked for at which a lane is likely to lie beside, if one of a few is such."""
        for _ in range(_TRIGGERS):
            if self.places.lies_beside(route, s0 + _PROGRESS * cruise * wish.trigger_s):
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
        under = cells_under(self.world.boxes, x, y, heading, length_m=size.length_m, width_m=0.8 * size.width_m)
        self._sigma[under[self._sigma[under] == FREE]] = GENERATED


def _foreseen(vehicle: PlannedVehicle) -> tuple[str, DrivenPath, BoxSize, FloatArray]:
    """How the next ones see it: one that will change lanes keeps the cells free that it will ask for."""
    size = vehicle.size
    if vehicle.policy in (Policy.LANE_CHANGE, Policy.OVERTAKE):
        size = BoxSize(size.length_m + 2 * _KEEP_FREE_M, size.width_m)
    return vehicle.vehicle_id, vehicle.intended_path, size, vehicle.intended_s


@njit(cache=True)
def _gaps_at_start(low, high, along, aligned, s0, clear, headway, follower, gentle_from):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Whether anybody is nearer than `clear`, m, at step 0, and the speeds, m/s, that the gaps ahead and behind allow.

    Behind: the slowest at which nobody of row gentle_from and later has to brake at once, but gently: the inverse of
    the car following's safe speed (Krauss 1998).
    """
    nearest, room, square = np.inf, np.inf, 0.0
    for a in range(low.shape[0]):
        if low[a, 0] - clear < s0 < high[a, 0] + clear:
            return True, 0.0, 0.0
        if s0 < low[a, 0] < nearest:
            nearest = low[a, 0]
            gap, speed = nearest - s0, max(0.0, along[a, 0])
            room = max(max(0.0, gap - clear) / headway, min(speed, 0.8 * gap))
        if a >= gentle_from and aligned[a, 0] and s0 - _BEHIND_M < high[a, 0] < s0:
            wanted = max(along[a, 0] - _EASES_MPS + follower.reaction_mps, 0.0)
            gap = s0 - high[a, 0] - follower.min_gap_m
            square = max(square, wanted**2 - follower.reaction_mps**2 - 2.0 * follower.decel_mps2 * gap)
    return False, room, np.sqrt(square)


def _quantile(table: tuple[tuple[float, float, float], ...], share: float) -> tuple[float, float]:
    columns = np.array(table).T
    return round(float(np.interp(share, columns[0], columns[1])), 3), round(
        float(np.interp(share, columns[0], columns[2])), 3
    )
