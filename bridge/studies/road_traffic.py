"""Minutes of traffic on a road of a file, in which vehicles change lanes by their own wish, and what is counted there.

Each vehicle asks its rule at its own moments, every ASK_S, on both sides; LC2013 is asked by SUMO itself. One with a
route over a lane beside must change, whatever it gains. Positions are along the road, which is straight.
"""

from bisect import bisect_right
from collections import Counter, defaultdict, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Literal

import numpy as np

from bridge.generation.generate import sumo_seed
from bridge.recordings.recording import Recording
from bridge.recordings.road import RAMPS, ROW, Beside, Road
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
#: Over which length, m, and time, s, density is counted by lane, and changes from and to it.
CELL_M, CELL_S = 250.0, 60.0
_STREAM = 79  # of random numbers: a name


@dataclass(eq=False, slots=True)
class RoadVehicle:
    """One that enters, and what became of it.

    start, lane, entered_lane: numbers from the left, lane 0 before it is in the net; asks: order in which vehicles ask;
    x: front, m along the road; changes: of lanes, in the section. Of one from the ramp lag and lead time gaps, s:
    offered: the largest between two vehicles, which it did not take; taken: what it changed lanes into.
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
    offered: dict[tuple[str | None, str | None], tuple[float, float]] = field(default_factory=dict)
    taken: tuple[float, float] | None = None


def arrivals(road: Road, config: Config) -> list[RoadVehicle]:
    """All that enter, by time: shifted exponential headways at the rate of the time, by lane and on the ramp.

    Every vehicle is drawn from a stream of its own, by lane and number: the same ones whatever rule is set.
    """
    request = config.request.model_copy(update={"bus_share": 0.0, "truck_share": road.trucks})
    until = [part.until_s for part in road.period]
    found: list[RoadVehicle] = []
    for start in range(1, road.beside_number + 1):
        ramp = start == road.beside_number
        rates = [part.on_ramp if ramp else part.veh_per_h[start - 1] for part in road.period]
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
        self._change = config.lane_change.model_copy(update={"mobil_bias_mps2": 0.0})  # no lane is asked for
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
        self._driven: dict[tuple[int, int, int], list[float]] = defaultdict(lambda: [0.0, 0.0])
        self._moved: Counter[tuple[int, int, int, int]] = Counter()
        self._stops: list[float] = []
        self._on = {lane.lane_id for lane in self._lanes.values() if lane.number <= road.lanes - bool(road.drop_m)}
        edge_of = {lane_id: self._grid.edge_id(Cell(lane_id, 0)) for lane_id in self._lanes}
        self._edges = cache(lambda start, leaves: [edge_of[lane] for lane in road.route(start, leaves=leaves)])

    def run(self) -> None:
        """All steps. Errors: SimulationError."""
        config, road = self.config, self.road
        own = config.lane_change.rule == "LC2013"
        more = model_parameters(config)
        if own:
            more["lcKeepRight"] = rule_arguments(config.lane_change).get("keep_right", 1.0)
        signals = {lane_id: (one.offset_s, one.phases) for lane_id, one in road.signals.items()}
        with Simulation(
            net_bytes(self._grid, fastest_mps=config.spawn.max_speed_mps, signals=signals), step_s=road.step_s,
            seed=sumo_seed([config.request.seed]), model=config.car_following.model, parameters=more,
            checks_gaps=config.lane_change.safety == "sumo", own_wish=own,
        ) as simulation:  # fmt: skip
            due, speeds = deque(self.vehicles), deque(self._end_speeds())
            every = max(1, round(ASK_S / road.step_s))
            steps = round((road.seconds + CLEAR_S) / road.step_s)
            red = {self._lanes[lane_id].start_m: shown for lane_id, shown in road.red(steps, road.step_s).items()}
            for step in range(steps):
                now_s = step * road.step_s
                while speeds and speeds[0][0] <= now_s:
                    simulation.limit_lane(*speeds.popleft()[1:])
                while due and due[0].due_s <= now_s:
                    self._queue(simulation, due.popleft())
                simulation.step()
                self._stops = [at_m for at_m, shown in red.items() if shown[step]]
                here = self._read(simulation, now_s)
                self._on_lane: dict[int, list[RoadVehicle]] = {number: [] for number in range(road.beside_number + 1)}
                for one in sorted(here, key=lambda one: one.x):
                    self._on_lane[one.lane].append(one)
                self._at = {number: [one.x for one in lane] for number, lane in self._on_lane.items()}
                if road.beside and road.beside.off_ramp:
                    self._give_up_exits(simulation, road.beside, here)
                self._offer()
                for one in here if not own else ():
                    if one.asks % every == step % every:
                        self._ask(simulation, one, now_s)

    def _end_speeds(self) -> Iterator[tuple[float, str, float]]:
        """From when on which lane behind the section has which limit."""
        behind = [lane for lane in self._lanes.values() if lane.start_m >= self.road.length_m]
        for since, part in zip([0.0, *(one.until_s for one in self.road.period)], self.road.period, strict=False):
            if part.end_mps:
                yield from ((since, self._sumo_lane[lane.lane_id], part.end_mps[lane.number - 1]) for lane in behind)

    def _queue(self, simulation: Simulation, one: RoadVehicle) -> None:
        ramp = one.start == self.road.beside_number
        lane_id = RAMPS[0] if ramp else one.start
        simulation.queue(
            one.name, edges=self._edges(one.start if ramp else 1, one.leaves), lane_index=self._index[lane_id],
            driver=one.driver, size=one.size,
        )  # fmt: skip

    def _read(self, simulation: Simulation, now_s: float) -> list[RoadVehicle]:
        """Take down where all are, and count; those in the net."""
        here, road = [], self.road
        minute = int((now_s - road.warm_up_s) // CELL_S)
        counted = road.warm_up_s <= now_s < road.seconds
        for name, lane_id, x, v in simulation.states(self._place_of):
            one = self._by_name[name]
            number = self._lanes[lane_id].number
            inside = 0.0 <= x < road.length_m and lane_id not in RAMPS
            if one.entered_s is None and inside:
                one.entered_s, one.entered_lane = now_s, one.start if one.start > road.lanes else number
            if one.entered_s is not None and one.left_s is None:
                one.changes += one.lane not in (0, number)
                if not inside:
                    one.left_s = now_s
            if inside and counted:
                self.driven_m += v * road.step_s
                self.driven_s += road.step_s
                piece = int(x // CELL_M)
                cell = self._driven[minute, piece, number]
                cell[0] += road.step_s
                cell[1] += v * road.step_s
                if one.lane not in (0, number):
                    self._moved[minute, piece, one.lane, number] += 1
            one.lane, one.x, one.v = number, x, v
            self._lane_id[name] = lane_id
            here.append(one)
        return here

    def _give_up_exits(self, simulation: Simulation, aside: Beside, here: Sequence[RoadVehicle]) -> None:
        """Those that have not come to the lane beside in time go straight on, and do not stop for the exit."""
        for one in here:
            if one.leaves and one.lane <= self.road.lanes and aside.to_m - _MISSED_M < one.x < aside.to_m:
                row = self._lane_id[one.name] // ROW
                simulation.set_route(one.name, self._edges(1, False)[row:])
                one.leaves = False
                self.missed_exits += 1

    def _offer(self) -> None:
        """Which gaps those of the ramp have beside them, and which they have taken, once they are on the lane there."""
        last = self.road.lanes
        for one in [*self._on_lane[last], *self._on_lane[last + 1]]:
            if one.start <= last or one.leaves or one.taken or self._lane_id[one.name] in RAMPS:
                continue
            front, rear = self._around(one, last)
            gaps = _time_gap_s(rear, rear.speed_mps), _time_gap_s(front, one.v)
            between = front.track_id, rear.track_id
            if one.lane == last:
                one.taken = gaps
                one.offered.pop(between, None)
            else:
                before = one.offered.get(between, gaps)
                one.offered[between] = max(before[0], gaps[0]), max(before[1], gaps[1])

    def _ask(self, simulation: Simulation, one: RoadVehicle, now_s: float) -> None:
        """A vehicle is told by its rule whether it changes lanes."""
        lane, wanted = self._lanes[self._lane_id[one.name]], self._must(one)
        if lane.closed:
            return
        sides: list[Literal["left", "right"]] = ["left", "right"] if one.asks % 2 else ["right", "left"]
        own_front, own_rear = self._around(one, one.lane)
        for side in [wanted] if wanted else sides:
            target = lane.left if side == "left" else lane.right
            if target is None or (wanted is None and target not in self._on):
                continue
            number = self._lanes[target].number
            front, rear = self._around(one, number)
            if wanted is None and front.distance_m <= 0.0:
                continue
            view = GapView(
                time_s=now_s, waited_s=now_s - (one.entered_s or now_s), side=side, speed_mps=one.v,
                desired_mps=one.driver.desired_mps, length_m=one.size.length_m, tau_s=one.driver.tau_s,
                accel_mps2=one.driver.accel_mps2, decel_mps2=one.driver.decel_mps2,
                min_gap_m=one.driver.min_gap_m, cells_free=front.distance_m > 0.0 and rear.distance_m > 0.0,
                front=front, rear=rear, own_front=own_front, own_rear=own_rear,
                remaining_m=self._end_m(number, leaves=one.leaves) - one.x, vehicle_id=one.name,
            )  # fmt: skip
            if by_own_wish(view, self._change, must=wanted is not None):
                simulation.change_lane(one.name, self._index[target])
                break

    def _around(self, one: RoadVehicle, number: int) -> tuple[Gap, Gap]:
        """Gaps to the next ahead and behind on a lane, by fronts; negative where they overlap.

        A closed stop line is like a leader that stands.
        """
        lane, place = self._on_lane[number], bisect_right(self._at[number], one.x)
        back = place - 1 - (number == one.lane)
        front = rear = OPEN
        if place < len(lane):
            front = Gap(lane[place].x - lane[place].size.length_m - one.x, lane[place].v, lane[place].name)
        for stop_m in self._stops:
            if 0.0 <= stop_m - one.x < front.distance_m:
                front = Gap(stop_m - one.x, 0.0)
        if back >= 0:
            rear = Gap(one.x - one.size.length_m - lane[back].x, lane[back].v, lane[back].name)
        return front, rear

    def _must(self, one: RoadVehicle) -> Literal["left", "right"] | None:
        """The side to which its route leads; None where the lane does."""
        aside = self.road.beside
        if one.leaves and aside is not None and one.x < aside.to_m:
            return None if one.lane == self.road.beside_number else "right"
        return None if self._lane_id[one.name] in self._on else "left"

    def _end_m(self, number: int, *, leaves: bool) -> float:
        """Where a lane ends on the vehicle's route."""
        road, aside = self.road, self.road.beside
        if aside and number > road.lanes:
            return aside.to_m + leaves * road.ramp_m
        return road.drop_m if road.drop_m and number == road.lanes else road.length_m + road.run_out_m

    def told(self) -> dict[str, Any]:
        """What a run says of those that entered the section while it was counted, and have left it.

        ratios: by measure, what is counted and what it is divided by; start_to_end: vehicles by start and end lane;
        cells: densities of a lane and of one beside, veh/km, changes from one to the other, veh-km on the first; lag,
        lead: of each vehicle that merged the largest gap rejected below the one accepted (0: none), and that, s.
        """
        road, top = self.road, self.road.beside_number
        first_s, last_s = road.warm_up_s, road.seconds
        entered = [one for one in self.vehicles if one.entered_s is not None and first_s <= one.entered_s < last_s]
        changes, table = np.zeros(top, dtype=int), np.zeros((top, top), dtype=int)
        for one in entered:
            if one.left_s is not None:
                changes[one.entered_lane - 1] += one.changes
                table[one.entered_lane - 1, one.lane - 1] += 1
        counts, vehicles, veh_km = changes.tolist(), table.sum(axis=1).tolist(), self.driven_m / 1000.0
        gaps: dict[str, list[tuple[float, float]]] = {"lag": [], "lead": []}
        for side, own in enumerate(gaps.values()):
            for one in entered:
                accepted = one.taken[side] if one.taken else np.inf
                rejected = max((gap[side] for gap in one.offered.values() if gap[side] < accepted), default=0.0)
                own += [(max(rejected, 0.0), accepted)] if 0.0 < accepted < np.inf else []
        ratios = {
            "flow_veh_per_h": (len(entered), (last_s - first_s) / 3600.0),
            "speed_mps": (self.driven_m, self.driven_s), "changes_per_vehicle": (sum(counts), sum(vehicles)),
            "changes_per_veh_km": (sum(counts), veh_km), "missed_exits": (self.missed_exits, 1),
            "not_left": (len(entered) - sum(vehicles), 1),
            **dict(zip(road.from_lanes, zip(counts, vehicles, strict=True), strict=False)),
        }  # fmt: skip
        return {"ratios": ratios, "start_to_end": table.tolist(), "cells": list(self._rates()), **gaps}

    def _rates(self) -> Iterator[tuple[float, float, int, float]]:
        def density(minute: int, piece: int, number: int) -> float:
            km = min(CELL_M, self.road.length_m - piece * CELL_M) / 1000.0
            return round(self._driven[minute, piece, number][0] / (CELL_S * km), 3)

        for minute, piece, number in list(self._driven):
            for other in (number - 1, number + 1):
                if max(number, other) <= self.road.lanes and other > 0:
                    own, there = (density(minute, piece, lane) for lane in (number, other))
                    driven_km = self._driven[minute, piece, number][1] / 1000.0
                    yield own, there, self._moved[minute, piece, number, other], driven_km


def _time_gap_s(gap: Gap, follower_mps: float) -> float:
    """Of a follower that stands, or of none: inf."""
    return gap.distance_m / follower_mps if follower_mps > 0.1 else np.inf
