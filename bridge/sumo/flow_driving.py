"""Vehicles that enter at the map's edge while the scene runs, beside those that start in it: for studies."""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bridge.sumo.driving import FleetSimulation, Limit
from bridge.sumo.poses import center_on_path
from bridge.sumo.steering import Attempt, edges_along
from hid2.insertion.flow import Arrival
from hid2.occupancy.gaps import gaps_from_pose
from hid2.occupancy.traffic import Traffic

#: `Fleet.near_m` of a fleet that others join, m, and time after which all vehicles look anew at those near, s: none
#: farther away gets near within the horizon.
NEAR_M, _LOOKS_S = 150.0, 1.0


@dataclass(eq=False, slots=True)
class FlowDriving(FleetSimulation):
    """`FleetSimulation`, and arrivals: each waits before the map for room, and is driven from then on.

    Room is what SUMO finds on its lane, and none of the boxes that are across: a vehicle that changes lanes is on its
    new one at once in SUMO, and for seconds on both in the world.

    trigger_after_s: s from its entry to the trigger of an arrival. entered: step at which a vehicle appeared, by its
    id; waiting_s: how long it had waited before the map.
    """

    arrivals: Sequence[Arrival] = ()
    trigger_after_s: Callable[[Arrival], float] = lambda arrival: 0.0
    entered: dict[str, int] = field(default_factory=dict)
    waiting_s: dict[str, float] = field(default_factory=dict)
    _next: int = 0
    _held: list[Arrival] = field(default_factory=list)
    _queued: dict[str, Arrival] = field(default_factory=dict)

    def _replayed(self) -> Traffic:
        """All of them at all steps: any may be ahead of a vehicle that enters."""
        return self.fleet.recorded_and_kept

    def _steer(self, step: int) -> tuple[dict[int, Attempt], dict[int, Limit]]:
        """Those that are due are let in last, when it is known which vehicles change lanes at this step."""
        if step % self.fleet.scene.steps_in(_LOOKS_S) == 0:
            self.fleet.forget_obstacles()
        attempts, limits = FleetSimulation._steer(self, step)
        while self._next < len(self.arrivals) and self.arrivals[self._next].due_s <= step * self.fleet.scene.step_s:
            self._held.append(self.arrivals[self._next])
            self._next += 1
        first = {arrival.lane_id: arrival for arrival in reversed([*self._queued.values(), *self._held])}
        across = self._across(step, attempts)
        for arrival in first.values():
            is_clear, is_queued = self._is_clear(arrival, across), arrival.vehicle_id in self._queued
            if is_clear and not is_queued:
                self._queue(arrival, step)
                self._held.remove(arrival)
            elif is_queued and not is_clear:
                self.simulation.remove(arrival.vehicle_id)
                self._held.insert(0, self._queued.pop(arrival.vehicle_id))
        return attempts, limits

    def _enter(self, step: int) -> None:
        FleetSimulation._enter(self, step)
        if self._queued:
            inside = self.simulation.vehicle_ids()
            for vehicle_id in [name for name in self._queued if name in inside]:
                self._appear(self._queued.pop(vehicle_id), step)

    def _across(self, step: int, attempts: Collection[int]) -> Traffic:
        """Recorded agents, and vehicles that change lanes, which SUMO has on one of the two: one step.

        attempts: rows of those that are to begin it now.
        """
        fleet = self.fleet
        changing = {
            vehicle.vehicle_id
            for row, vehicle in enumerate(fleet.vehicles)
            if row in attempts
            or (vehicle.path.lateral_spans and vehicle.s and vehicle.s[-1] < vehicle.path.lateral_spans[-1].end)
        }
        driven = fleet.traffic()
        rows = [row for row, name in enumerate(driven.ids) if name in changing]
        return fleet.scene.traffic.at(step).joined(driven.rows(rows))

    def _is_clear(self, arrival: Arrival, across: Traffic) -> bool:
        """Whether no box is in the way where a vehicle enters, nor too near ahead; SUMO sees to those on its lane."""
        driver, box = arrival.start.driver, arrival.start.box
        xy, forward, _ = arrival.start.path.line.motion(np.array([0.5 * box.length_m]))
        seen = gaps_from_pose(xy[0], forward[0], box, across)
        beside = seen.aside_m < self.fleet.scene.config.conflict.margin_lateral_m
        near = seen.gap_m < np.where(seen.along_m > 0.0, driver.min_gap_m + driver.tau_s * driver.desired_mps, 0.0)
        return not bool((beside & near & across.present[:, 0]).any())

    def _queue(self, arrival: Arrival, step: int) -> None:
        scene, start = self.fleet.scene, arrival.start
        cell = scene.cell_at(start.path, 0.0)
        edges = edges_along(scene, start.path, cell)
        assert edges is not None  # the route begins on its own lane
        self.simulation.queue(
            start.vehicle_id, edges=edges, lane_index=scene.grid.lane_index(cell), size=start.size,
            driver=replace(start.driver, desired_mps=float(start.desired[step])),  # it would brake for its wish
        )  # fmt: skip
        self._queued[arrival.vehicle_id] = arrival

    def _appear(self, arrival: Arrival, step: int) -> None:
        """It is in the net: from now on one of those that are driven."""
        simulation, scene, start = self.simulation, self.fleet.scene, arrival.start
        lane, front_m = simulation.lane(start.vehicle_id)
        start_m = center_on_path(scene.grid, start.path, lane, front_m, length_m=start.size.length_m, after=-math.inf)
        assert start_m is not None  # it begins on its route
        request = replace(start.request, trigger_s=step * scene.step_s + self.trigger_after_s(arrival))
        self.entered[start.vehicle_id] = step
        self.waiting_s[start.vehicle_id] = step * scene.step_s - arrival.due_s
        start_mps = simulation.speed(start.vehicle_id)
        self.fleet.add([replace(start, request=request, start_m=start_m, start_mps=start_mps)])
