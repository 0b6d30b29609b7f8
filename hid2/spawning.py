"""Where generated vehicles start, how fast, and on which route: free cells with a clear approach.

Paper: generated agents can be placed in any unoccupied cell (sigma = 0). Here the whole box is free, nobody recorded
would run into it, nobody appears inside it, and a speed profile exists that meets nobody on the way.
"""

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice

import numpy as np

from hid2.agents import DEFAULT_SIZES, BoxSize, FloatArray, Policy
from hid2.conflicts import DT_S, Prospect
from hid2.decision import LaneOption, Side
from hid2.lane_change import lane_change_reason
from hid2.maneuver import admissible_neighbor, gap_ahead_of, lane_options, lay_across, leader_on
from hid2.occupancy import FREE, GENERATED, cells_under
from hid2.overtake import Leader, enter_reason, return_reason
from hid2.reference_line import TABLE_STEP_M
from hid2.route import DrivenPath, Route, routes_from
from hid2.space_time import SpeedPlan
from hid2.traffic import Traffic
from hid2.world import DRIVABLE_TYPES, PlannedVehicle, World, predicted_traffic
from netconvert.cells import Cell
from netconvert.lane_graph import TurnType

#: Quantiles of labelled boxes (share, length m, width m): cars, box trucks, buses.
_CAR = ((0.0, 3.8, 1.72), (0.1, 4.0, 1.76), (0.5, 4.2, 1.87), (0.9, 5.2, 2.05), (1.0, 5.6, 2.12))
_TRUCK = ((0.0, 7.0, 2.3), (0.5, 9.6, 2.6), (1.0, 10.5, 2.7))
_BUS = ((0.0, 10.5, 2.7), (0.5, 11.6, 2.9), (1.0, 12.3, 2.95))
_TURN = {Policy.LEFT_TURN: TurnType.LEFT, Policy.RIGHT_TURN: TurnType.RIGHT}
_ROUTE_LONGEST_M = 260.0
_MIN_MOVE_M = 10.0
_FASTEST_MPS = 9.0  # mean over approach and turn
_MIN_MOVE_LATE_M = 3.0
_SLOWEST_MPS = (6.0, 3.0)  # a candidate's road lasts until the last observed step at this speed; with patience
_KEEP_FREE_M = 4.0
_SPARE_LANE_M = 12.0  # of the lane beside, for a change that begins a little later than foreseen
_LENGTH_STEP_M, _WIDTH_STEP_M = 0.5, 0.1
_OVERTAKER_MPS = (11.0, 14.0)
_SPARE_STEPS = 4  # a foreseen manoeuvre ends this long before the scene does: SUMO will be a little later
_RETURN_STEPS = 32
_RETURN_SPARE_M = 1.5
_LEAVING_S = 1.6  # until the box is out of the leader's way


@dataclass(frozen=True, eq=False, slots=True)
class _Intention:
    """What a vehicle is foreseen to do: path with its manoeuvre, s (T,) m on it; sides where it looks for a lane."""

    path: DrivenPath
    s: FloatArray
    sides: tuple[Side, ...] = ()


@dataclass(frozen=True, eq=False, slots=True)
class _Wish:
    """A vehicle that is looked for a place."""

    policy: Policy
    vehicle_id: str
    object_type: str
    own_size: BoxSize
    trigger_s: float
    cruise_mps: float | None = None
    steady: bool = False

    @property
    def size(self) -> BoxSize:
        """Box that covers the vehicle and what a reader without the sidecar takes it for."""
        assumed, own = DEFAULT_SIZES[self.object_type], self.own_size
        # rounded up, so that vehicles of nearly the same size share what was computed about a path
        length = math.ceil(max(own.length_m, assumed.length_m) / _LENGTH_STEP_M) * _LENGTH_STEP_M
        return BoxSize(length, math.ceil(max(own.width_m, assumed.width_m) / _WIDTH_STEP_M) * _WIDTH_STEP_M)


@dataclass(slots=True)
class Spawner:
    """Chooses vehicles one after the other; each one planned is an obstacle to the next.

    last_reasons: what was said most often against the candidates of the last call that found none, by policy.

    fixed: generated vehicles of earlier rounds, with their final motion. patience: 0 takes only places where a vehicle
    drives as it likes; from 1 on it may start slowly, from 2 on it may stand in a queue. reasons counts what was turned
    down. packed: fill each lane from its downstream end, so that everybody can adapt to who is ahead.
    """

    world: World
    rng: np.random.Generator
    fixed: Traffic
    patience: int = 0
    packed: bool = False
    planned: list[PlannedVehicle] = field(default_factory=list)
    reasons: Counter[str] = field(default_factory=Counter)
    _sigma: np.ndarray[tuple[int], np.dtype[np.uint8]] = field(init=False)
    _lanes: tuple[int, ...] = field(init=False)
    _predicted: Traffic = field(init=False)
    last_reasons: dict[Policy, str] = field(default_factory=dict)
    _known_routes: dict[tuple[TurnType, int, int], tuple[Route, ...]] = field(default_factory=dict)
    _streams: dict[Policy, Iterator[tuple[Route, float]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Occupancy at step 0, with the fixed vehicles in it."""
        self._sigma = self.world.occupancy.sigma[0].copy()
        graph = self.world.grid.graph
        self._lanes = tuple(i for i, lane in graph.lanes.items() if lane.lane_type in DRIVABLE_TYPES)
        for row in range(len(self.fixed.ids)):
            if self.fixed.present[row, 0]:
                x, y = self.fixed.position[row, 0].tolist()
                size = BoxSize(self.fixed.length_m[row], self.fixed.width_m[row])
                self._mark(x, y, float(self.fixed.heading[row, 0]), size)
        self._predicted = predicted_traffic([], self.world.num_steps)

    def spawn(self, policy: Policy, vehicle_id: str, *, attempts: int) -> PlannedVehicle | None:
        """Plan one vehicle for a policy; None, with the reasons counted, where no candidate of `attempts` holds.

        Candidates that were turned down are not tried again by this spawner: there is only less room later.
        """
        object_type, own = self._draw_size()
        wish = _Wish(policy, vehicle_id, object_type, own, self._draw_trigger(policy))
        against: Counter[str] = Counter()
        for route, s0 in self._some(policy, attempts):
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
        trigger_s = self._draw_trigger(Policy.OVERTAKE)
        against: Counter[str] = Counter()
        for route, s0 in self._some(Policy.OVERTAKE, attempts):
            cruise = max(self.world.speed_sample(route[0], self.rng), float(self.rng.uniform(*_OVERTAKER_MPS)))
            wish = _Wish(Policy.OVERTAKE, vehicle_id, object_type, own, trigger_s, cruise)
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

    def _note(self, policy: Policy, against: Counter[str]) -> None:
        self.reasons.update(against)
        self.last_reasons[policy] = against.most_common(1)[0][0] if against else "no_free_cell"

    def _some(self, policy: Policy, attempts: int) -> Iterator[tuple[Route, float]]:
        """The next candidates of a policy; occupied cells are passed over and do not count."""
        if policy not in self._streams:
            self._streams[policy] = self._candidates(policy)
        yield from islice(self._streams[policy], attempts)

    def offers(self, policy: Policy) -> bool:
        """Whether the map has any place at all for a policy, whoever is on it."""
        if policy is Policy.STRAIGHT:
            return bool(self._lanes)
        graph = self.world.grid.graph
        if policy in _TURN:
            return any(self._turn(lane_id) is _TURN[policy] and graph.predecessors(lane_id) for lane_id in self._lanes)
        return any(self._may_start(policy, lane_id) for lane_id in self._lanes)

    def _overtaker(
        self, wish: _Wish, route: Route, s0: float, leader_id: str | None
    ) -> tuple[PlannedVehicle, ...] | str:
        vehicle = self._try(wish, route, s0)
        if isinstance(vehicle, PlannedVehicle):
            self._add(vehicle)
            return (vehicle,)
        if vehicle != "no_leader" or leader_id is None or wish.cruise_mps is None:
            return vehicle
        slow = float(np.clip(0.28 * wish.cruise_mps, 2.8, 4.0))
        closing = wish.cruise_mps - slow
        lead = _Wish(
            Policy.STRAIGHT,
            leader_id,
            "vehicle",
            BoxSize(*_quantile(_CAR, float(self.rng.random()))),
            0.0,
            slow,
            steady=True,
        )
        ttc_s = self.world.config.conflict.ttc_min_s + 0.2
        ahead = s0 + 6.0 + closing * (ttc_s + wish.trigger_s + _LEAVING_S)
        leader = self._try(lead, route, ahead)
        if not isinstance(leader, PlannedVehicle):
            return f"leader_{leader}"
        self._add(leader)
        vehicle = self._try(wish, route, s0)
        if isinstance(vehicle, PlannedVehicle):
            self._add(vehicle)
            return (vehicle, leader)
        self._drop_last()
        return vehicle

    def _try(self, wish: _Wish, route: Route, s0: float) -> PlannedVehicle | str:
        """A planned vehicle, or the reason against it."""
        world, config, size = self.world, self.world.config, wish.size
        cruise = world.speed_sample(route[0], self.rng) if wish.cruise_mps is None else wish.cruise_mps
        unsuited = self._unsuited(wish, route, s0, cruise)
        if unsuited is not None:
            return unsuited
        path = world.path(route)
        if "collision" in config.without:
            return self._unchecked(wish, route, path, s0, cruise)
        xy, heading = path.line.position(np.array([s0]))[0], float(path.line.heading(np.array([s0]))[0])
        under = cells_under(
            world.boxes, float(xy[0]), float(xy[1]), heading, length_m=size.length_m, width_m=0.8 * size.width_m
        )
        if np.any(self._sigma[under] != FREE):
            return "cells_occupied"
        look = world.prospect(path, size, cruise_mps=cruise, others=(self.fixed, self._predicted))
        v0 = self._entry_speed(look, s0, cruise if wish.steady else cruise * float(self.rng.uniform(0.85, 1.0)))
        if isinstance(v0, str):
            return v0
        plan: SpeedPlan | None = None
        for share in (1.0,) if self.patience == 0 else (1.0, 0.5, 0.0):
            plan = look.plan(s0=s0, v0=share * v0, a0=0.0, first_step=0, config=config)
            if plan is not None:
                v0 = share * v0
                break
        if plan is None:
            return "no_safe_timing"
        moved = float(plan.s[-1] - plan.s[0])
        enough = moved >= _MIN_MOVE_M or (self.patience >= 1 and moved > _MIN_MOVE_LATE_M)
        if not enough and (self.patience < 2 or not self._queues(look, s0)):
            return "would_stand"
        if self._too_sharp(path, s0, float(plan.s[-1])):
            return "curve_too_sharp"
        intention = self._intend(wish, path, look, plan, s0, cruise)
        if isinstance(intention, str):
            return intention
        return PlannedVehicle(
            vehicle_id=wish.vehicle_id, policy=wish.policy, object_type=wish.object_type, size=size,
            own_size=wish.own_size, route=route, path=path, s0=s0, v0=v0, cruise_mps=cruise, trigger_s=wish.trigger_s,
            plan_s=plan.s, plan_v=plan.v, sides=intention.sides, intended_path=intention.path, intended_s=intention.s,
        )  # fmt: skip

    def _unchecked(self, wish: _Wish, route: Route, path: DrivenPath, s0: float, cruise: float) -> PlannedVehicle:
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
        low, high = occupancy.low[:, 0], occupancy.high[:, 0]
        if np.any((low - spawn.clear_gap_m < s0) & (s0 < high + spawn.clear_gap_m)):
            return "box_too_close"
        fastest, pushed = look.tables.speeds_at(0, s0)
        v0 = min(wanted, float(look.desired[cell]), fastest)
        ahead = np.isfinite(low) & (low > s0)
        if ahead.any():
            row = int(np.argmin(np.where(ahead, low, np.inf)))
            gap, speed = low[row] - s0, max(0.0, float(occupancy.along[row, 0]))
            room = max(0.0, gap - spawn.clear_gap_m) / spawn.clear_ahead_s
            v0 = min(v0, max(room, min(speed, 0.8 * gap)))
        if v0 < max(0.0, pushed):
            return "follower_too_fast"
        return v0

    def _intend(
        self, wish: _Wish, path: DrivenPath, look: Prospect, plan: SpeedPlan, s0: float, cruise: float
    ) -> _Intention | str:
        """The manoeuvre as it can be foreseen, or why it would not come about in the scene."""
        if wish.policy in _TURN:
            turn = next(
                (g for g in path.segments if self._turn(g.lane_id) is _TURN[wish.policy] and g.start > s0), None
            )
            if turn is None or plan.s[-_SPARE_STEPS] < turn.end + 1.0:
                return "turn_not_reached"
        if wish.policy is Policy.LANE_CHANGE:
            return self._intend_lane_change(wish, path, plan, cruise)
        if wish.policy is Policy.OVERTAKE:
            return self._intend_overtake(wish, path, plan, cruise)
        return _Intention(path, plan.s)

    def _intend_lane_change(self, wish: _Wish, path: DrivenPath, plan: SpeedPlan, cruise: float) -> _Intention | str:
        """Try the change at the trigger, then a little later."""
        change = self.world.config.lane_change
        sides: tuple[Side, ...] = ("left", "right") if self.rng.random() < 0.5 else ("right", "left")
        trigger = int(np.ceil(wish.trigger_s / DT_S))
        reason = "scene_too_short"
        for step in (trigger, trigger + 8, trigger + 20):
            if step >= plan.s.size - int(change.min_duration_s / DT_S):
                break
            speed = float(plan.v[step])
            for option, target in self._options(wish, path, step, float(plan.s[step]), sides, cruise):
                unmet = lane_change_reason(
                    speed_mps=speed, cells_free=option.cells_free, allowed=option.allowed, front=option.front,
                    rear=option.rear, remaining_m=option.remaining_m - _SPARE_LANE_M, params=change,
                )  # fmt: skip
                later = path.segment_at(float(plan.s[step]) + _SPARE_LANE_M).lane_id
                if unmet is None and admissible_neighbor(self.world, later, option.side) is None:
                    unmet = "lane_ends"
                if unmet is not None:
                    reason = unmet
                    continue
                across = self._across(wish, path, target, plan, step, option.remaining_m, cruise)
                if isinstance(across, str):
                    reason = across
                    continue
                other: Side = "right" if option.side == "left" else "left"
                return _Intention(across[0], across[1].s, (option.side, other))
            reason = reason if reason != "scene_too_short" else "no_adjacent_lane"
        return f"lane_change_{reason}"

    def _intend_overtake(self, wish: _Wish, path: DrivenPath, plan: SpeedPlan, cruise: float) -> _Intention | str:
        """Enter at the trigger or a little later, pass, and find room to return before the scene ends."""
        overtake = self.world.config.overtake
        everybody = self.world.traffic.joined(self.fixed).joined(self._predicted)
        trigger = int(np.ceil(wish.trigger_s / DT_S))
        reason = "scene_too_short"
        for step in (trigger, trigger + 8, trigger + 16):
            if step >= plan.s.size - 50:
                break
            s = float(plan.s[step])
            leader = leader_on(path, wish.size, s=s, step=step, d_obs_m=overtake.d_obs_m, everybody=everybody)
            if leader is None or leader.speed_mps < overtake.parked_mps:
                reason = "no_leader"
                continue
            for option, target in self._options(wish, path, step, s, ("left", "right"), cruise):
                unmet = enter_reason(
                    leader=leader, desired_mps=cruise, lane_available=option.allowed and option.cells_free,
                    ahead=option.front, behind=option.rear, free_corridor_m=option.corridor_m, params=overtake,
                )  # fmt: skip
                if unmet is not None:
                    reason = unmet
                    continue
                across = self._across(wish, path, target, plan, step, option.remaining_m, cruise)
                if isinstance(across, str):
                    reason = across
                    continue
                back: Side = "right" if option.side == "left" else "left"
                done = self._return(wish, across[0], across[1], leader, back, everybody, cruise)
                if isinstance(done, str):
                    reason = done
                    continue
                return _Intention(done[0], done[1].s, (option.side, back))
        return "no_leader" if reason == "no_leader" else f"overtake_{reason}"

    def _return(
        self,
        wish: _Wish,
        path: DrivenPath,
        plan: SpeedPlan,
        leader: Leader,
        side: Side,
        everybody: Traffic,
        cruise: float,
    ) -> tuple[DrivenPath, SpeedPlan] | str:
        """Third stage, foreseen: the first steps at which the passed vehicle is far enough behind."""
        overtake = self.world.config.overtake
        passed = np.flatnonzero(plan.s >= path.shifts[-1][1])
        reason = "not_passed"
        for step in passed[::4].tolist():
            if step >= plan.s.size - _RETURN_STEPS:
                break
            s = float(plan.s[step])
            gap = gap_ahead_of(path, wish.size, s=s, step=step, passed_id=leader.track_id, everybody=everybody)
            if gap < overtake.return_gap_m + _RETURN_SPARE_M:
                continue
            for option, target in self._options(wish, path, step, s, (side,), cruise):
                unmet = return_reason(
                    lead_gap_m=gap,
                    lane_available=option.allowed and option.cells_free,
                    ahead=option.front,
                    params=overtake,
                )
                if unmet is not None:
                    reason = f"return_{unmet}"
                    continue
                back = self._across(wish, path, target, plan, step, option.remaining_m, cruise)
                if not isinstance(back, str):
                    return back
                reason = f"return_{back}"
        return reason

    def _options(
        self, wish: _Wish, path: DrivenPath, step: int, s: float, sides: tuple[Side, ...], cruise: float
    ) -> list[tuple[LaneOption, DrivenPath]]:
        return lane_options(
            self.world,
            path,
            wish.size,
            s=s,
            step=step,
            sides=sides,
            others=(self.fixed, self._predicted),
            desired_mps=cruise,
        )

    def _across(
        self,
        wish: _Wish,
        path: DrivenPath,
        target: DrivenPath,
        plan: SpeedPlan,
        step: int,
        remaining_m: float,
        cruise: float,
    ) -> tuple[DrivenPath, SpeedPlan] | str:
        """The path across from a step of a plan on, and the plan on it; or why there is none."""
        speed, s = float(plan.v[step]), float(plan.s[step])
        pace = max(speed, 0.5 * (speed + float(plan.v[min(step + 20, plan.v.size - 1)])))
        across = lay_across(
            self.world, path, target, s=s, step=step, pace_mps=pace, remaining_m=remaining_m, policy=wish.policy
        )
        if isinstance(across, str):
            return across
        look = self.world.prospect(across, wish.size, cruise_mps=cruise, others=(self.fixed, self._predicted))
        accel = float(np.clip((plan.v[step] - plan.v[max(step - 1, 0)]) / DT_S, -2.0, 1.5))
        onward = look.plan(s0=s, v0=speed, a0=accel, first_step=step, config=self.world.config)
        if onward is None:
            return "conflict_predicted"
        spare = _SPARE_STEPS if wish.policy is Policy.LANE_CHANGE else 2 * _SPARE_STEPS
        if onward.s[-spare] < across.shifts[-1][1]:
            return "would_not_complete"
        return across, SpeedPlan(
            s=np.concatenate([plan.s[:step], onward.s]), v=np.concatenate([plan.v[:step], onward.v]), cost=onward.cost
        )

    def _unsuited(self, wish: _Wish, route: Route, s0: float, cruise: float) -> str | None:
        """What the map alone says against a candidate, before a path is laid and anybody is looked at."""
        lanes = self.world.grid.graph.lanes
        ends = np.cumsum([lanes[lane_id].length_m for lane_id in route])
        half_m = wish.size.length_m / 2
        run_on = "topology" in self.world.config.without
        if s0 < half_m or (s0 + half_m > ends[-1] - 1.0 and not run_on):
            return "no_room_on_lane"
        slowest = _SLOWEST_MPS[min(self.patience, 1)]
        stay_m = 0.75 * min(cruise, slowest) * self.world.earliest_exit_step * DT_S
        if ends[-1] - s0 < 2 * half_m + stay_m and not run_on:
            return "leaves_too_early"
        starts = np.concatenate([[0.0], ends[:-1]])
        if wish.policy is Policy.STRAIGHT and self.patience == 0:
            reached = (ends > s0) & (starts < s0 + cruise * self.world.num_steps * DT_S)
            if any(self._turn(route[row]) is not TurnType.STRAIGHT for row in np.flatnonzero(reached).tolist()):
                return "would_turn"
        if wish.policy in (Policy.LANE_CHANGE, Policy.OVERTAKE):
            first = s0 + 0.3 * cruise * wish.trigger_s
            last = s0 + cruise * (wish.trigger_s + 3.0)
            if not any(self._beside(route[row]) for row in np.flatnonzero((ends > first) & (starts < last)).tolist()):
                return "no_lane_beside_at_trigger"
        return None

    def _beside(self, lane_id: int) -> bool:
        return any(admissible_neighbor(self.world, lane_id, side) is not None for side in ("left", "right"))

    def _too_sharp(self, path: DrivenPath, start: float, end: float) -> bool:
        """Whether the path bends more than kappa_max = 1 / R_min between two arc lengths (Trajectory Smoothing)."""
        cells = slice(int(start / TABLE_STEP_M), int(end / TABLE_STEP_M) + 2)
        return bool(
            np.abs(path.line.table_curvature[cells]).max(initial=0.0) > 1.0 / self.world.config.limits.min_radius_m
        )

    def _turn(self, lane_id: int) -> TurnType:
        return self.world.grid.graph.lanes[lane_id].turn

    def _queues(self, look: Prospect, s0: float) -> bool:
        """Whether somebody standing ahead explains standing."""
        low, along = look.occupancy.low[:, 0], np.abs(look.occupancy.along[:, 0])
        return bool(np.any((low > s0) & (low < s0 + 15.0) & (along < 1.0) & look.occupancy.aligned[:, 0]))

    def _candidates(self, policy: Policy) -> Iterator[tuple[Route, float]]:
        """(route, s0) in random order, suited to the policy by the map alone."""
        cells = [
            Cell(lane_id, index)
            for lane_id in self._lanes
            if policy is Policy.STRAIGHT or self._may_start(policy, lane_id)
            for index in range(self.world.grid.count(lane_id))
        ]
        place_of = [self.world.grid.index_of[cell] for cell in cells]
        order = self.rng.permutation(len(cells)).tolist()
        if self.packed and policy is Policy.STRAIGHT:
            left_m = self._distance_to_exit()
            order.sort(
                key=lambda place: (
                    left_m[cells[place].lane_id] - self.world.grid.edges_s(cells[place].lane_id)[cells[place].index]
                )
            )
        for place in order:
            cell = cells[place]
            borders = self.world.grid.edges_s(cell.lane_id)
            s0 = float(self.rng.uniform(borders[cell.index], borders[cell.index + 1]))
            if "collision" not in self.world.config.without and self._sigma[place_of[place]] != FREE:
                self.reasons["cells_occupied"] += 1
                continue
            for route in self._routes(policy, cell.lane_id, s0):
                if self._sigma[place_of[place]] != FREE and "collision" not in self.world.config.without:
                    break  # taken meanwhile: by the vehicle that the route before was for
                yield self._with_run_up(route, s0)

    def _with_run_up(self, route: Route, s0: float) -> tuple[Route, float]:
        """Start on the lane before where the box would stand out behind the first."""
        if s0 >= 3.0 or "topology" in self.world.config.without:
            return route, s0
        graph = self.world.grid.graph
        before = [p for p in graph.predecessors(route[0]) if p in self._lanes and p not in route]
        if not before:
            return route, s0
        first = before[int(self.rng.integers(len(before)))]
        return (first, *route), s0 + self.world.path((first,)).line.length_m

    def _distance_to_exit(self) -> dict[int, float]:
        """From the start of each lane to the nearest edge of the map, m; lanes that only lead back count as far."""
        graph = self.world.grid.graph
        left = dict.fromkeys(self._lanes, 1e6)
        for _ in range(len(left)):  # Bellman-Ford; maps are a few lanes deep
            changed = False
            for lane_id in self._lanes:
                onward = [left[n] for n in graph.successors(lane_id) if n in left]
                new = graph.lanes[lane_id].length_m + (min(onward) if onward else 0.0)
                if new < left[lane_id]:
                    left[lane_id], changed = new, True
            if not changed:
                break
        return left

    def _may_start(self, policy: Policy, lane_id: int) -> bool:
        if policy in _TURN:
            return self._turn(lane_id) is TurnType.STRAIGHT
        return self._beside(lane_id)

    def _routes(self, policy: Policy, lane_id: int, s0: float) -> Iterator[Route]:
        """Routes from a place that serve the policy; more than one only where patience asks for it (reroute)."""
        graph = self.world.grid.graph
        if "topology" in self.world.config.without:
            yield (lane_id,)
            return
        wanted = _TURN.get(policy, TurnType.STRAIGHT)

        def choose(onward: tuple[int, ...]) -> tuple[int, ...]:
            order = self.rng.permutation(len(onward)).tolist()
            return tuple(sorted((onward[i] for i in order), key=lambda n: self._turn(n) is not wanted))

        most = 6 if policy in _TURN else 1 if self.patience == 0 else 3
        key = wanted, lane_id, most
        if key not in self._known_routes:
            usable = set(self._lanes).__contains__
            found = routes_from(graph, lane_id, choose=choose, usable=usable, most=most, longest_m=_ROUTE_LONGEST_M)
            self._known_routes[key] = tuple(found)
        for route in self._known_routes[key]:
            if policy not in _TURN or self._leads_into(route, wanted, s0):
                yield route
                if policy in _TURN and self.patience == 0:
                    return

    def _leads_into(self, route: Route, wanted: TurnType, s0: float) -> bool:
        """Whether the first turn of a route is the wanted one and may be through before the scene ends."""
        graph = self.world.grid.graph
        travelled = graph.lanes[route[0]].length_m - s0
        for lane_id in route[1:]:
            kind, length = self._turn(lane_id), graph.lanes[lane_id].length_m
            if kind is not TurnType.STRAIGHT:
                return (
                    kind is wanted
                    and travelled > 3.0
                    and travelled + length < _FASTEST_MPS * self.world.num_steps * DT_S
                )
            travelled += length
        return False

    def _draw_size(self) -> tuple[str, BoxSize]:
        request = self.world.config.request
        kind, share = float(self.rng.random()), float(self.rng.random())
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
        return float(self.rng.uniform(low, high)) if high > low else low

    def _add(self, vehicle: PlannedVehicle) -> None:
        self.planned.append(vehicle)
        start = np.array([vehicle.s0])
        xy = vehicle.path.line.position(start)[0]
        self._mark(float(xy[0]), float(xy[1]), float(vehicle.path.line.heading(start)[0]), vehicle.size)
        one = predicted_traffic([_foreseen(vehicle)], self.world.num_steps)
        self._predicted = self._predicted.joined(one)

    def _drop_last(self) -> None:
        """Take the vehicle planned last back."""
        self.planned.pop()
        entries = [_foreseen(vehicle) for vehicle in self.planned]
        self._predicted = predicted_traffic(entries, self.world.num_steps)

    def _mark(self, x: float, y: float, heading: float, size: BoxSize) -> None:
        under = cells_under(self.world.boxes, x, y, heading, length_m=size.length_m, width_m=0.8 * size.width_m)
        self._sigma[under[self._sigma[under] == FREE]] = GENERATED


def _foreseen(vehicle: PlannedVehicle) -> tuple[str, DrivenPath, BoxSize, FloatArray]:
    """How the next ones see it: one that will change lanes keeps the cells free that it will ask for."""
    size = vehicle.size
    if vehicle.policy in (Policy.LANE_CHANGE, Policy.OVERTAKE):
        size = BoxSize(size.length_m + 2 * _KEEP_FREE_M, size.width_m)
    return vehicle.vehicle_id, vehicle.intended_path, size, vehicle.intended_s


def _quantile(table: tuple[tuple[float, float, float], ...], share: float) -> tuple[float, float]:
    columns = np.array(table).T
    return round(float(np.interp(share, columns[0], columns[1])), 3), round(
        float(np.interp(share, columns[0], columns[2])), 3
    )
