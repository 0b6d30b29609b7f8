"""Where generated vehicles start, how fast, and on which route: free cells with a clear approach.

Paper: generated agents can be placed in any unoccupied cell (sigma = 0). Here the whole box is free, nobody recorded
would run into it, nobody appears inside it, and a speed profile exists that meets nobody on the way.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from hid2.agents import DEFAULT_SIZES, BoxSize, Policy
from hid2.conflicts import DT_S, Prospect
from hid2.occupancy import FREE, GENERATED, cells_under
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


@dataclass(slots=True)
class Spawner:
    """Chooses vehicles one after the other; each one planned is an obstacle to the next.

    fixed: generated vehicles of earlier rounds, with their final motion. reasons counts what was turned down.
    """

    world: World
    rng: np.random.Generator
    fixed: Traffic
    planned: list[PlannedVehicle] = field(default_factory=list)
    reasons: Counter[str] = field(default_factory=Counter)
    _sigma: np.ndarray[tuple[int], np.dtype[np.uint8]] = field(init=False)
    _lanes: tuple[int, ...] = field(init=False)
    _predicted: Traffic = field(init=False)

    def __post_init__(self) -> None:
        """Occupancy at step 0, with the fixed vehicles in it."""
        self._sigma = self.world.occupancy.sigma[0].copy()
        graph = self.world.grid.graph
        self._lanes = tuple(i for i, lane in graph.lanes.items() if lane.lane_type in DRIVABLE_TYPES)
        for row in range(len(self.fixed.ids)):
            if self.fixed.present[row, 0]:
                x, y = self.fixed.position[row, 0].tolist()
                self._mark(x, y, float(self.fixed.heading[row, 0]), BoxSize(self.fixed.length_m[row], self.fixed.width_m[row]))
        self._predicted = predicted_traffic([], self.world.num_steps)

    def spawn(self, policy: Policy, vehicle_id: str, *, attempts: int, allow_standing: bool = False) -> PlannedVehicle | None:
        """Plan one vehicle for a policy; None, with the reasons counted, where no candidate of `attempts` holds."""
        object_type, own = self._draw_size()
        trigger_s = self._draw_trigger(policy)
        offered = False
        for tried, (route, s0) in enumerate(self._candidates(policy)):
            offered = True
            if tried >= attempts:
                break
            vehicle = self._try(policy, vehicle_id, object_type, own, route, s0, trigger_s, allow_standing=allow_standing)
            if isinstance(vehicle, PlannedVehicle):
                self._add(vehicle)
                return vehicle
            self.reasons[vehicle] += 1
        if not offered:
            self.reasons[f"map_offers_no_{policy.value}"] += 1
        return None

    def spawn_overtake(self, vehicle_id: str, leader_id: str, *, attempts: int) -> tuple[PlannedVehicle, ...]:
        """Plan an overtaker, behind a slower vehicle that is there or, if allowed, behind a new slow leader."""
        trigger_s = self._draw_trigger(Policy.OVERTAKE)
        object_type, own = self._draw_size()
        tried = 0
        for route, s0 in self._candidates(Policy.OVERTAKE):
            tried += 1
            if tried > attempts:
                break
            cruise = max(self.world.speed_sample(route[0], self.rng), 9.0)
            found = self._overtake_pair(vehicle_id, leader_id, object_type, own, route, s0, trigger_s, cruise)
            if isinstance(found, tuple):
                return found
            self.reasons[found] += 1
        if tried == 0:
            self.reasons["map_offers_no_overtake"] += 1
        return ()

    def _overtake_pair(
        self, vehicle_id: str, leader_id: str, object_type: str, own: BoxSize, route: Route, s0: float,
        trigger_s: float, cruise: float,
    ) -> tuple[PlannedVehicle, ...] | str:  # fmt: skip
        path, size = self.world.path(route), _safe_size(object_type, own)
        look = self.world.prospect(path, size, cruise_mps=cruise, others=(self.fixed, self._predicted))
        step = min(int(trigger_s / DT_S), self.world.num_steps - 1)
        low = np.where(look.occupancy.aligned[:, step], look.occupancy.low[:, step], np.inf)
        gaps = low - s0
        row = int(np.argmin(np.where(gaps > 0, gaps, np.inf))) if gaps.size else -1
        overtake = self.world.config.overtake
        if row >= 0 and 4.0 < gaps[row] < overtake.d_obs_m:
            slow = float(np.median(look.occupancy.along[row, step:]))
            if overtake.parked_mps < slow < 0.6 * cruise:
                vehicle = self._try(Policy.OVERTAKE, vehicle_id, object_type, own, route, s0, trigger_s, cruise=cruise)
                if isinstance(vehicle, PlannedVehicle):
                    self._add(vehicle)
                    return (vehicle,)
                return vehicle
        if not self.world.config.request.spawn_leaders:
            return "no_slower_leader"
        slow = min(0.38 * cruise, 4.5)
        lead_type, lead_own = "vehicle", BoxSize(*_quantile(_CAR, float(self.rng.random())))
        ahead = s0 + 14.0 + 1.6 * (cruise - slow) + (cruise - slow) * trigger_s * 0.5
        leader = self._try(Policy.STRAIGHT, leader_id, lead_type, lead_own, route, ahead, 0.0, cruise=slow, steady=True)
        if not isinstance(leader, PlannedVehicle):
            return leader
        self._add(leader)
        vehicle = self._try(Policy.OVERTAKE, vehicle_id, object_type, own, route, s0, trigger_s, cruise=cruise)
        if isinstance(vehicle, PlannedVehicle):
            self._add(vehicle)
            return (vehicle, leader)
        self._drop_last()
        return vehicle

    def _try(
        self, policy: Policy, vehicle_id: str, object_type: str, own: BoxSize, route: Route, s0: float,
        trigger_s: float, *, cruise: float | None = None, allow_standing: bool = False, steady: bool = False,
    ) -> PlannedVehicle | str:  # fmt: skip
        """A planned vehicle, or the reason against it."""
        world, config = self.world, self.world.config
        path = world.path(route)
        size = _safe_size(object_type, own)
        if s0 < size.length_m / 2 or s0 + size.length_m / 2 > path.exit_s - 1.0:
            return "no_room_on_lane"
        xy, heading = path.line.position(np.array([s0]))[0], float(path.line.heading(np.array([s0]))[0])
        under = cells_under(world.boxes, float(xy[0]), float(xy[1]), heading, length_m=size.length_m, width_m=0.8 * size.width_m)
        if "collision" not in config.without and np.any(self._sigma[under] != FREE):
            return "cells_occupied"
        if cruise is None:
            cruise = world.speed_sample(route[0], self.rng)
        stay_s = world.earliest_exit_step * DT_S
        if path.exit_s - s0 < size.length_m + 0.75 * min(cruise, 6.0) * stay_s:
            return "leaves_too_early"
        look = world.prospect(path, size, cruise_mps=cruise, others=(self.fixed, self._predicted))
        if "collision" in config.without:
            return self._unchecked(policy, vehicle_id, object_type, own, size, route, path, s0, cruise, trigger_s, look)
        v0 = self._entry_speed(look, s0, cruise if steady else cruise * float(self.rng.uniform(0.85, 1.0)))
        if isinstance(v0, str):
            return v0
        plan = look.plan(s0=s0, v0=v0, a0=0.0, first_step=0, config=config)
        if plan is None:
            return "no_safe_timing"
        moved = float(plan.s[-1] - plan.s[0])
        if moved < _MIN_MOVE_M and not (allow_standing and self._queues(look, s0)):
            return "would_stand"
        reason = self._misses(policy, path, plan, s0, trigger_s)
        if reason is not None:
            return reason
        return PlannedVehicle(
            vehicle_id=vehicle_id, policy=policy, object_type=object_type, size=size, own_size=own, route=route,
            path=path, s0=s0, v0=v0, cruise_mps=cruise, trigger_s=trigger_s, plan_s=plan.s, plan_v=plan.v,
        )  # fmt: skip

    def _unchecked(
        self, policy: Policy, vehicle_id: str, object_type: str, own: BoxSize, size: BoxSize, route: Route,
        path: DrivenPath, s0: float, cruise: float, trigger_s: float, look: Prospect,
    ) -> PlannedVehicle:  # fmt: skip
        """Ablation without collision checks: any cell, the desired speed, nobody looked at."""
        steps = self.world.num_steps
        s, v = np.empty(steps), np.empty(steps)
        s[0] = s0
        for k in range(steps):
            v[k] = look.desired[min(int(s[k] / 0.5), look.desired.size - 1)]
            if k + 1 < steps:
                s[k + 1] = s[k] + v[k] * DT_S
        return PlannedVehicle(
            vehicle_id=vehicle_id, policy=policy, object_type=object_type, size=size, own_size=own, route=route,
            path=path, s0=s0, v0=float(v[0]), cruise_mps=cruise, trigger_s=trigger_s, plan_s=s, plan_v=v,
        )  # fmt: skip

    def _entry_speed(self, look: Prospect, s0: float, wanted: float) -> float | str:
        """Spawn speed that suits the road and the gaps ahead and behind at step 0, or what forbids any."""
        spawn = self.world.config.spawn
        cell = int(s0 / 0.5 + 0.5)
        occupancy = look.occupancy
        low, high = occupancy.low[:, 0], occupancy.high[:, 0]
        if np.any((low - spawn.clear_gap_m < s0) & (s0 < high + spawn.clear_gap_m)):
            return "box_too_close"
        v0 = min(wanted, float(look.desired[cell]), float(look.tables.fastest[0, cell]))
        ahead = np.isfinite(low) & (low > s0)
        if ahead.any():
            row = int(np.argmin(np.where(ahead, low, np.inf)))
            gap, speed = low[row] - s0, max(0.0, float(occupancy.along[row, 0]))
            room = max(0.0, gap - self.world.config.car_following.min_gap_m) / self.world.config.car_following.tau_s
            v0 = min(v0, max(room, min(speed, 0.8 * gap)))
        if v0 < float(look.tables.pushed[0, cell]):
            return "follower_too_fast"
        return v0

    def _misses(self, policy: Policy, path: DrivenPath, plan: SpeedPlan, s0: float, trigger_s: float) -> str | None:
        """Why the plan does not let the policy come about in the scene."""
        if policy in _TURN:
            turn = next((g for g in path.segments if self._turn(g.lane_id) is _TURN[policy] and g.start > s0), None)
            if turn is None or plan.s[-1] < turn.end + 1.0:
                return "turn_not_reached"
            done = float(np.searchsorted(plan.s, turn.end + 1.0))
            if done * DT_S > self.world.num_steps * DT_S - 0.3:
                return "turn_not_reached"
        if policy in (Policy.LANE_CHANGE, Policy.OVERTAKE):
            change = self.world.config.lane_change
            at = min(int(trigger_s / DT_S), self.world.num_steps - 1)
            if plan.v[at] < change.min_speed_mps and plan.v[min(at + 15, plan.v.size - 1)] < change.min_speed_mps:
                return "too_slow_at_trigger"
            reach = plan.s[at] + max(change.min_remaining_m, 3.0 * plan.v[at])
            if not self._side_by_side(path, float(plan.s[at]), float(reach)):
                return "no_lane_beside_at_trigger"
        return None

    def _side_by_side(self, path: DrivenPath, start: float, end: float) -> bool:
        """Whether one side of the path has an admissible lane all the way from start to end."""
        for side in ("left", "right"):
            if all(
                self.world_neighbor(segment.lane_id, side) is not None
                for segment in path.segments
                if segment.end > start and segment.start < end
            ) and end < path.exit_s:
                return True
        return False

    def world_neighbor(self, lane_id: int, side: str) -> int | None:
        """Adjacent lane on which a lane change is admissible."""
        return admissible_neighbor(self.world, lane_id, side)

    def _turn(self, lane_id: int) -> TurnType:
        return self.world.grid.graph.lanes[lane_id].turn

    def _queues(self, look: Prospect, s0: float) -> bool:
        """Whether somebody standing ahead explains standing."""
        low, along = look.occupancy.low[:, 0], np.abs(look.occupancy.along[:, 0])
        return bool(np.any((low > s0) & (low < s0 + 15.0) & (along < 1.0) & look.occupancy.aligned[:, 0]))

    def _candidates(self, policy: Policy) -> Iterator[tuple[Route, float]]:
        """(route, s0) in random order, suited to the policy by the map alone."""
        graph = self.world.grid.graph
        cells = [
            Cell(lane_id, index)
            for lane_id in self._lanes
            if policy is Policy.STRAIGHT or self._may_start(policy, lane_id)
            for index in range(self.world.grid.count(lane_id))
        ]
        for place in self.rng.permutation(len(cells)).tolist():
            cell = cells[place]
            borders = self.world.grid.edges_s(cell.lane_id)
            s0 = float(self.rng.uniform(borders[cell.index], borders[cell.index + 1]))
            route = self._route(policy, cell.lane_id, s0)
            if route is None:
                continue
            if s0 < 3.0:  # start on the lane before, so that the box lies on the path
                before = [p for p in graph.predecessors(cell.lane_id) if p in self._lanes and p not in route]
                if before:
                    first = before[int(self.rng.integers(len(before)))]
                    s0 += self.world.path((first,)).line.length_m
                    route = (first, *route)
            yield route, s0

    def _may_start(self, policy: Policy, lane_id: int) -> bool:
        if policy in _TURN:
            return self._turn(lane_id) is TurnType.STRAIGHT
        return any(admissible_neighbor(self.world, lane_id, side) is not None for side in ("left", "right"))

    def _route(self, policy: Policy, lane_id: int, s0: float) -> Route | None:
        """Route that serves the policy, None where none does."""
        graph = self.world.grid.graph
        wanted = _TURN.get(policy, TurnType.STRAIGHT)

        def choose(onward: tuple[int, ...]) -> tuple[int, ...]:
            order = self.rng.permutation(len(onward)).tolist()
            return tuple(sorted((onward[i] for i in order), key=lambda n: self._turn(n) is not wanted))

        usable = set(self._lanes).__contains__
        most = 6 if policy in _TURN else 1
        for route in routes_from(graph, lane_id, choose=choose, usable=usable, most=most, longest_m=_ROUTE_LONGEST_M):
            if policy not in _TURN:
                return route
            travelled = graph.lanes[lane_id].length_m - s0
            for lane in route[1:]:
                kind = self._turn(lane)
                if kind is wanted and travelled > 3.0 and travelled + graph.lanes[lane].length_m < 9.0 * self.world.num_steps * DT_S:
                    return route
                if kind is not TurnType.STRAIGHT:
                    break
                travelled += graph.lanes[lane].length_m
        return None

    def _draw_size(self) -> tuple[str, BoxSize]:
        request = self.world.config.request
        kind, share = float(self.rng.random()), float(self.rng.random())
        if kind < request.bus_share:
            return "bus", BoxSize(*_quantile(_BUS, share))
        if kind < request.bus_share + request.truck_share:
            return "vehicle", BoxSize(*_quantile(_TRUCK, share))
        return "vehicle", BoxSize(*_quantile(_CAR, share))

    def _draw_trigger(self, policy: Policy) -> float:
        """t_trigger, uniform in the range asked for; overtakes, which need most of a scene, from its first quarter."""
        request = self.world.config.request
        low, high = request.trigger_min_s, request.trigger_max_s
        if policy is Policy.OVERTAKE:
            high = low + 0.25 * (high - low)
        return float(self.rng.uniform(low, high)) if high > low else low

    def _add(self, vehicle: PlannedVehicle) -> None:
        self.planned.append(vehicle)
        start = np.array([vehicle.s0])
        xy = vehicle.path.line.position(start)[0]
        self._mark(float(xy[0]), float(xy[1]), float(vehicle.path.line.heading(start)[0]), vehicle.size)
        one = predicted_traffic([(vehicle.vehicle_id, vehicle.path, vehicle.size, vehicle.plan_s)], self.world.num_steps)
        self._predicted = self._predicted.joined(one)

    def _drop_last(self) -> None:
        """Take the vehicle planned last back."""
        self.planned.pop()
        entries = [(v.vehicle_id, v.path, v.size, v.plan_s) for v in self.planned]
        self._predicted = predicted_traffic(entries, self.world.num_steps)

    def _mark(self, x: float, y: float, heading: float, size: BoxSize) -> None:
        under = cells_under(self.world.boxes, x, y, heading, length_m=size.length_m, width_m=0.8 * size.width_m)
        self._sigma[under[self._sigma[under] == FREE]] = GENERATED


def admissible_neighbor(world: World, lane_id: int, side: str) -> int | None:
    """Same-direction neighbour that a vehicle may change to: of a drivable type, and the marking allows it."""
    graph = world.grid.graph
    neighbor = graph.neighbor(lane_id, "left" if side == "left" else "right")
    if neighbor is None or graph.lanes[neighbor].lane_type not in DRIVABLE_TYPES:
        return None
    return neighbor if graph.may_change(lane_id, "left" if side == "left" else "right") else None


def _safe_size(object_type: str, own: BoxSize) -> BoxSize:
    """Box that covers the vehicle and what a reader without the sidecar takes it for."""
    assumed = DEFAULT_SIZES[object_type]
    return BoxSize(max(own.length_m, assumed.length_m), max(own.width_m, assumed.width_m))


def _quantile(table: tuple[tuple[float, float, float], ...], share: float) -> tuple[float, float]:
    columns = np.array(table).T
    return round(float(np.interp(share, columns[0], columns[1])), 3), round(float(np.interp(share, columns[0], columns[2])), 3)
