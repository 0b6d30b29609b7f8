"""Vehicles that enter at the map's edge while the scene runs, beside those that start in it: for studies."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from bridge.sumo.driving import Driving
from bridge.sumo.poses import center_on_path
from bridge.sumo.routes import edges_along
from hid2.drivers.driver import MIDDLE
from hid2.insertion.flow import Arrival
from hid2.occupancy.gaps import gaps_on_path
from hid2.occupancy.traffic import Traffic
from hid2.vehicle import Start, VehicleRequest

#: `Fleet.near_m` of a fleet that others join: at every entry all vehicles look anew at those near, as none farther
#: away gets there within the horizon.
NEAR_M = 150.0


@dataclass(eq=False, slots=True)
class FlowDriving(Driving):
    """`Driving`, and arrivals: each waits before the map until SUMO finds room for it, and is driven from then on.

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

    def _replayed(self) -> tuple[Traffic, Traffic]:
        """All of them at all steps: any may be ahead of a vehicle that enters."""
        return self.fleet.scene.traffic, self.fleet.fixed

    def _enter(self, step: int) -> None:
        Driving._enter(self, step)
        if not self.arrivals:
            return
        inside = self.simulation.driven()
        for vehicle_id in [name for name in self._queued if name in inside]:
            self._appear(self._queued.pop(vehicle_id), step)
        while self._next < len(self.arrivals) and self.arrivals[self._next].due_s <= step * self.fleet.scene.step_s:
            self._held.append(self.arrivals[self._next])
            self._next += 1
        held, blocked = [], set()
        for arrival in self._held:
            if arrival.lane_id in blocked or not self._is_clear(arrival, step):
                blocked.add(arrival.lane_id)
                held.append(arrival)
            else:
                self._queue(arrival)
        self._held = held

    def _is_clear(self, arrival: Arrival, step: int) -> bool:
        """Whether no recorded agent is too near ahead; those driven are SUMO's business."""
        seen = self.fleet.scene.recorded_on(arrival.path, arrival.box)
        edge = np.array([-arrival.box.length_m])  # no agent on the path is behind it
        room_m = arrival.driver.min_gap_m + arrival.driver.tau_s * arrival.driver.desired_mps
        return bool(gaps_on_path(seen, edge, step).lead_m[0] >= room_m + 1.5 * arrival.box.length_m)

    def _queue(self, arrival: Arrival) -> None:
        scene = self.fleet.scene
        cell = scene.cell_at(arrival.path, 0.0)
        edges = edges_along(scene, arrival.path, cell)
        assert edges is not None  # the route begins on its own lane
        self.simulation.queue(
            arrival.vehicle_id, edges=edges, lane_index=scene.grid.lane_index(cell), driver=arrival.driver,
            size=arrival.size,
        )  # fmt: skip
        self._queued[arrival.vehicle_id] = arrival

    def _appear(self, arrival: Arrival, step: int) -> None:
        """It is in the net: from now on one of those that are driven."""
        simulation, scene = self.simulation, self.fleet.scene
        lane, front_m = simulation.lane(arrival.vehicle_id)
        start_s = center_on_path(
            scene.grid, arrival.path, lane, front_m, length_m=arrival.size.length_m, after=-math.inf
        )
        assert start_s is not None  # it begins on its route
        trigger_s = step * scene.step_s + self.trigger_after_s(arrival)
        start = Start(
            vehicle_id=arrival.vehicle_id, request=VehicleRequest(arrival.number, arrival.policy, trigger_s),
            object_type=arrival.object_type, size=arrival.size, box=arrival.box, route=arrival.route,
            path=arrival.path, start_s=start_s,
            start_mps=simulation.speed(arrival.vehicle_id), driver=arrival.driver, desired=arrival.desired,
            offset=MIDDLE, sides=arrival.sides,
        )  # fmt: skip
        self.entered[arrival.vehicle_id] = step
        self.waiting_s[arrival.vehicle_id] = step * scene.step_s - arrival.due_s
        self.fleet.add([start])
