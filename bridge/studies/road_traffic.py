"""Minutes of traffic on a road of a file, in which vehicles change lanes by their own wish, and what is counted there.

Each vehicle asks its rule at its own moments, every ASK_S, on both sides; LC2013 is asked by SUMO itself. One with a
route over a lane beside must change, whatever it gains. Positions are along the road, which is straight.
"""

from bisect import bisect_right
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

import numpy as np

from bridge.generation.generate import sumo_seed
from bridge.recordings.recording import Recording
from bridge.recordings.road import RAMPS, ROW, Road
from bridge.sumo.drivers import model_parameters
from bridge.sumo.simulation import Simulation
from hid2.agents import BoxSize
from hid2.drivers.driver import Driver, draw_driver
from hid2.insertion.flow import headway_s
from hid2.insertion.sizes import draw_size
from hid2.params import Config
from hid2.policy.lane_change import OPEN, Gap
from hid2.policy.rules import GapView, by_own_wish, rule_arguments
from netconvert.cells import Cell, build_cell_grid
from netconvert.net_xml import net_bytes

#: Seconds between two moments at which a vehicle asks its rule, no tunable: what a driver takes to look and decide.
ASK_S = 1.0
#: Long enough for every lane of a road to be one lane of SUMO's.
_WHOLE_M = 1e6
#: After traffic has entered, so long for those counted to leave, s; so near to the ramp's nose, m, an exit is missed.
CLEAR_S, _MISSED_M = 240.0, 25.0
_STREAM = 79  # of random numbers: a name


@dataclass(eq=False, slots=True)
class RoadVehicle:
    """One that enters, and what became of it.

    start, lane, entered_lane: numbers from the left, lane 0 before it is in the net; asks: order in which vehicles ask;
    x: front, m along the road; changes: of lanes, in the section.
    """

    name: str
    start: int
    due_s: float
    leaves: bool
    driver: Driver
    size: BoxSize
    asks: int
    lane: int = 0
    x: float = 0.0
    v: float = 0.0
    entered_s: float | None = None
    entered_lane: int = 0
    left_s: float | None = None
    changes: int = 0


def arrivals(road: Road, config: Config) -> list[RoadVehicle]:
    """All that enter, by time: shifted exponential headways at the rate of the time, by lane and on the ramp.

    Every vehicle is drawn from a stream of its own, by lane and number: the same ones whatever rule is set.
    """
    request = config.request.model_copy(update={"bus_share": 0.0, "truck_share": road.trucks})
    until = [part.until_s for part in road.inflow]
    found: list[RoadVehicle] = []
    for start in range(1, road.beside_number + 1):
        ramp = start == road.beside_number
        rates = [part.on_ramp if ramp else part.veh_per_h[start - 1] for part in road.inflow]
        share = road.ramp_leaving if ramp else (road.leaving or [0.0] * road.lanes)[start - 1]
        due_s, number = 0.0, 0
        while due_s < until[-1]:
            rng = np.random.default_rng([config.request.seed, _STREAM, start, number])
            rate = rates[bisect_right(until, due_s)]
            if rate <= 0.0:
                due_s = until[bisect_right(until, due_s)]
                continue
            due_s += headway_s(rate, config.flow, rng)
            leaves = bool(rng.random() < share)
            _, size = draw_size(request, rng)
            driver = draw_driver(config, rng, lane_speed_mps=config.spawn.prior_speed_mps)
            found.append(RoadVehicle(f"{start}_{number}", start, due_s, leaves, driver, size, asks=len(found)))
            number += 1
    return sorted((one for one in found if one.due_s < until[-1]), key=lambda one: (one.due_s, one.start))


class RoadTraffic:
    """One simulation of a road. Use: `RoadTraffic(recording, road, config).run()`."""

    def __init__(self, recording: Recording, road: Road, config: Config) -> None:
        self.road, self.config = road, config
        self._grid = build_cell_grid(recording.graph, cell_m=_WHOLE_M)
        self._lanes = {lane.lane_id: lane for lane in road.stretches()}
        self._index = {lane_id: self._grid.lane_index(Cell(lane_id, 0)) for lane_id in self._lanes}
        self._sumo_lane = {lane_id: self._grid.sumo_lane_id(Cell(lane_id, 0)) for lane_id in self._lanes}
        self._place_of = {name: (lane_id, self._lanes[lane_id].start_m) for lane_id, name in self._sumo_lane.items()}
        self.vehicles = arrivals(road, config)
        self._by_name = {one.name: one for one in self.vehicles}
        self.driven_m = self.driven_s = 0.0
        self.missed_exits = 0
        self._lane_id: dict[str, int] = {}
        self._on = {lane_id for lane_id in self._lanes if self._leads_on(lane_id)}
        edge_of = {lane_id: self._grid.edge_id(Cell(lane_id, 0)) for lane_id in self._lanes}
        self._edges = cache(lambda start, leaves: [edge_of[lane] for lane in road.route(start, leaves=leaves)])

    def run(self) -> None:
        """All steps. Errors: SimulationError."""
        config, road = self.config, self.road
        own = config.lane_change.rule == "LC2013"
        more = model_parameters(config)
        if own:
            more["lcKeepRight"] = rule_arguments(config.lane_change).get("keep_right", 1.0)
        with Simulation(
            net_bytes(self._grid, fastest_mps=config.spawn.max_speed_mps), seed=sumo_seed([config.request.seed]),
            step_s=road.step_s, model=config.car_following.model, parameters=more,
            checks_gaps=config.lane_change.safety == "sumo", own_wish=own,
        ) as simulation:  # fmt: skip
            due, speeds = deque(self.vehicles), deque(self._end_speeds())
            every = max(1, round(ASK_S / road.step_s))
            for step in range(round((road.seconds + CLEAR_S) / road.step_s)):
                now_s = step * road.step_s
                while speeds and speeds[0][0] <= now_s:
                    simulation.limit_lane(*speeds.popleft()[1:])
                while due and due[0].due_s <= now_s:
                    self._queue(simulation, due.popleft())
                simulation.step()
                here = self._read(simulation, now_s)
                if road.beside and road.beside.off_ramp:
                    self._give_up_exits(simulation, here)
                if not own:
                    asking = [one for one in here if one.asks % every == step % every]
                    self._ask(simulation, here, asking, now_s)

    def _end_speeds(self) -> Iterator[tuple[float, str, float]]:
        """From when on which lane behind the section has which limit."""
        since_s = 0.0
        behind = [lane for lane in self._lanes.values() if lane.start_m >= self.road.length_m]
        for part in self.road.end_speed:
            yield from ((since_s, self._sumo_lane[lane.lane_id], part.mps[lane.number - 1]) for lane in behind)
            since_s = part.until_s

    def _queue(self, simulation: Simulation, one: RoadVehicle) -> None:
        ramp = one.start == self.road.beside_number
        lane_id = RAMPS[0] if ramp else one.start
        simulation.queue(
            one.name, edges=self._edges(one.start if ramp else 1, one.leaves), lane_index=self._index[lane_id],
            driver=one.driver, size=one.size,
        )  # fmt: skip

    def _read(self, simulation: Simulation, now_s: float) -> list[RoadVehicle]:
        """Take down where all are, and count; those in the net."""
        here, length_m = [], self.road.length_m
        for name, lane_id, x, v in simulation.states(self._place_of):
            one = self._by_name[name]
            number = self._lanes[lane_id].number
            inside = 0.0 <= x < length_m and lane_id not in RAMPS
            if one.entered_s is None and inside:
                one.entered_s, one.entered_lane = now_s, one.start if one.start > self.road.lanes else number
            if one.entered_s is not None and one.left_s is None:
                one.changes += one.lane not in (0, number)
                if not inside:
                    one.left_s = now_s
            one.lane, one.x, one.v = number, x, v
            self._lane_id[name] = lane_id
            if inside and now_s >= self.road.warm_up_s and now_s < self.road.seconds:
                self.driven_m += v * self.road.step_s
                self.driven_s += self.road.step_s
            here.append(one)
        return here

    def _give_up_exits(self, simulation: Simulation, here: Sequence[RoadVehicle]) -> None:
        """Those that have not come to the lane beside in time go straight on, and do not stop for the exit."""
        aside = self.road.beside
        assert aside is not None
        for one in here:
            if one.leaves and one.lane <= self.road.lanes and aside.to_m - _MISSED_M < one.x < aside.to_m:
                row = self._lane_id[one.name] // ROW
                simulation.set_route(one.name, self._edges(1, False)[row:])
                one.leaves = False
                self.missed_exits += 1

    def _ask(
        self, simulation: Simulation, here: Sequence[RoadVehicle], asking: Sequence[RoadVehicle], now_s: float
    ) -> None:
        """Each that asks now is told by its rule whether it changes lanes."""
        order: dict[int, list[RoadVehicle]] = {number: [] for number in range(self.road.beside_number + 1)}
        for one in sorted(here, key=lambda one: one.x):
            order[one.lane].append(one)
        at = {number: [one.x for one in lane] for number, lane in order.items()}
        for one in asking:
            lane = self._lanes[self._lane_id[one.name]]
            if lane.closed:
                continue
            wanted = self._must(one)
            sides: list[Literal["left", "right"]] = ["left", "right"] if one.asks % 2 else ["right", "left"]
            own_front, own_rear = _around(order[one.lane], at[one.lane], one, own=True)
            for side in [wanted] if wanted else sides:
                target = lane.left if side == "left" else lane.right
                if target is None or (wanted is None and target not in self._on):
                    continue
                number = self._lanes[target].number
                front, rear = _around(order[number], at[number], one, own=False)
                if wanted is None and front.distance_m <= 0.0:
                    continue
                view = GapView(
                    time_s=now_s, waited_s=now_s - (one.entered_s or now_s), side=side, speed_mps=one.v,
                    desired_mps=one.driver.desired_mps, length_m=one.size.length_m, tau_s=one.driver.tau_s,
                    accel_mps2=one.driver.accel_mps2, decel_mps2=one.driver.decel_mps2,
                    min_gap_m=one.driver.min_gap_m, cells_free=front.distance_m > 0.0 and rear.distance_m > 0.0,
                    front=front, rear=rear, own_front=own_front, own_rear=own_rear,
                    remaining_m=self._remaining_m(one, target), vehicle_id=one.name,
                )  # fmt: skip
                if by_own_wish(view, self.config.lane_change, must=wanted is not None):
                    simulation.change_lane(one.name, self._index[target])
                    break

    def _must(self, one: RoadVehicle) -> Literal["left", "right"] | None:
        """The side to which its route leads; None where the lane does."""
        aside = self.road.beside
        if one.leaves and aside is not None and one.x < aside.to_m:
            return None if one.lane == self.road.beside_number else "right"
        return None if self._lane_id[one.name] in self._on else "left"

    def _leads_on(self, lane_id: int) -> bool:
        """Whether a lane leads to the road's end, and to no ramp."""
        lane = self._lanes[lane_id]
        if lane.number == self.road.beside_number:
            return False
        return lane.start_m >= self.road.length_m or any(map(self._leads_on, lane.successors))

    def _remaining_m(self, one: RoadVehicle, target: int) -> float:
        """Length of a lane beside that is left on the vehicle's route."""
        lane = self._lanes[target]
        while lane.successors and (lane.number <= self.road.lanes or one.leaves):
            lane = self._lanes[lane.successors[0]]
        return lane.end_m - one.x

    def told(self) -> dict[str, Any]:
        """What a run says of those that entered the section while it was counted, and have left it: by start lane."""
        top, first_s, last_s = self.road.beside_number, self.road.warm_up_s, self.road.seconds
        entered = [one for one in self.vehicles if one.entered_s is not None and first_s <= one.entered_s < last_s]
        changes, table = np.zeros(top, dtype=int), np.zeros((top, top), dtype=int)
        for one in entered:
            if one.left_s is not None:
                changes[one.entered_lane - 1] += one.changes
                table[one.entered_lane - 1, one.lane - 1] += 1
        return {
            "vehicles": table.sum(axis=1).tolist(), "changes": changes.tolist(), "start_to_end": table.tolist(),
            "not_left": len(entered) - int(table.sum()), "flow_veh_per_h": 3600.0 * len(entered) / (last_s - first_s),
            "speed_mps": self.driven_m / max(self.driven_s, 1e-9), "veh_km": self.driven_m / 1000.0,
            "missed_exits": self.missed_exits,
        }  # fmt: skip


def _around(lane: Sequence[RoadVehicle], at: Sequence[float], one: RoadVehicle, *, own: bool) -> tuple[Gap, Gap]:
    """Gaps to the next ahead and behind on a lane, by fronts (sorted); negative where they overlap."""
    place = bisect_right(at, one.x)
    ahead = lane[place] if place < len(lane) else None
    back = place - 1 - own
    behind = lane[back] if back >= 0 else None
    return (
        OPEN if ahead is None else Gap(ahead.x - ahead.size.length_m - one.x, ahead.v),
        OPEN if behind is None else Gap(one.x - one.size.length_m - behind.x, behind.v),
    )
