"""Minutes of traffic on a road of a file, in which vehicles change lanes by their own wish, and what is counted there.

Each vehicle asks its rule at its own moments, every ASK_S, on both sides; LC2013 is asked by SUMO itself. One with a
route over a lane beside must change, whatever it gains. Positions are along the road, which is straight.
"""

from bisect import bisect_right
from collections import defaultdict, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Literal

import numpy as np
import pandas as pd

from bridge.batch.batch import Run, SceneFolders, base_row
from bridge.batch.isolation import Failure, attempts
from bridge.batch.manifest import ManifestRow
from bridge.generation.gaps import neighbour_row
from bridge.generation.generate import sumo_seed
from bridge.recordings.recording import Recording
from bridge.recordings.road import RAMPS, ROAD_FILE, ROW, Lane, Road, read_road
from bridge.recordings.sources import read_recording
from bridge.studies.gap_acceptance import gaps_of, largest_rejected
from bridge.studies.paired import measure_runs
from bridge.studies.study import write_run
from bridge.sumo.drivers import model_parameters
from bridge.sumo.simulation import Simulation
from hid2.agents import BoxSize, FloatArray
from hid2.drivers.driver import Driver, draw_driver
from hid2.insertion.flow import headway_s
from hid2.insertion.requests import draw_size
from hid2.params import Config
from hid2.policy.lane_change import OPEN, Gap
from hid2.policy.rules import GapView, refusals_unasked, rule_arguments
from netconvert.cells import Cell, build_cell_grid
from netconvert.net_xml import net_bytes

#: Seconds between two moments at which a vehicle asks its rule, no tunable: what a driver takes to look and decide.
ASK_S = 1.0
#: Time for the vehicles counted to leave after traffic has entered, s; distance to the ramp's nose of a missed exit, m.
CLEAR_S, _MISSED_M = 240.0, 25.0
#: Length, m, and time, s, over which density is counted by lane, and changes from and to it.
CELL_M, CELL_S = 250.0, 60.0
_STREAM = 79  # of random numbers: a name
#: Of each vehicle in the net at each step; inside: 1 in the section, 0 before and behind it, and on ramps.
_SEEN = ["now_s", "asks", "start", "lane", "x", "v", "inside"]
#: Columns of looks of a study that are the same for all of a run.
_ALIKE = {"scene": "", "city": "", "point": 0, "seed": 0, "replay": "", "guard": None, "sumo": None}
_NOWHERE = Lane(0, 0, 0.0, 0.0, True, None, None, ())


@dataclass(eq=False, slots=True)
class RoadVehicle:
    """One that enters, and where it is: on no lane before it is in the net. x: front, m along the road.

    start: number of its lane, the ramp's the last; asks: order in which vehicles ask.
    """

    name: str
    start: int
    due_s: float
    leaves: bool
    driver: Driver
    size: BoxSize
    asks: int
    lane: Lane = _NOWHERE
    x: float = 0.0
    v: float = 0.0


def measure_roads(place: SceneFolders, runs: Sequence[Run]) -> Iterator[ManifestRow | Failure]:
    """The work of a process: each run driven and counted on a corridor that was made of a road's file.

    Where none enters by the file vehicles are asked for lane changes, as in a study.
    """
    recording = read_recording(place.folder)
    road = read_road(recording.folder / ROAD_FILE)

    def row(run: Run) -> ManifestRow:
        traffic = RoadTraffic(recording, road, run.config)
        traffic.run()
        told = traffic.told()
        folder = write_run(place.out, recording, run.config, told)
        placed = told["ratios"]["changes_per_vehicle"][1]
        return base_row(place, run, folder)._replace(city=recording.city, placed=placed)

    yield from measure_runs(place, runs) if road.asked else attempts(row, runs)


def arrivals(road: Road, config: Config) -> list[RoadVehicle]:
    """All that enter, by time: shifted exponential headways at the rate of the time, by lane and on the ramp.

    Every vehicle is drawn from a stream of its own, by lane and number: the same ones whatever rule is set.
    """
    request = config.request.model_copy(update={"bus_share": 0.0, "truck_share": road.trucks})
    until = [part.until_s for part in road.period]
    found: list[RoadVehicle] = []
    for start in range(1, len(road.from_lanes) + 1):
        due_s, number = 0.0, 0
        while due_s < until[-1]:
            part = road.period[bisect_right(until, due_s)]
            if part.veh_per_h[start - 1] <= 0.0:
                due_s = part.until_s
                continue
            rng = np.random.default_rng([config.request.seed, _STREAM, start, number])
            due_s += headway_s(part.veh_per_h[start - 1], config.flow, rng)
            leaves = bool(rng.random() < (road.leaving[start - 1] if road.leaving else 0.0))
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
        self._grid = build_cell_grid(recording.graph, cell_m=1e6)  # every lane of a road is one lane of SUMO's
        self._lanes = {lane.lane_id: lane for lane in road.stretches()}
        self._end_m = {lane.number: lane.end_m for lane in sorted(road.stretches(), key=attrgetter("end_m"))}
        self._named = {self._grid.sumo_lane_id(Cell(lane_id, 0)): lane for lane_id, lane in self._lanes.items()}
        self.vehicles = arrivals(road, config)
        self._by_name = {one.name: one for one in self.vehicles}
        self.missed_exits = 0
        self._seen: list[FloatArray] = []
        self._looks: list[dict[str, Any]] = []
        self._stops: list[float] = []
        self._on_lane: dict[int, list[RoadVehicle]] = {}
        self._last_kept = road.lanes - bool(road.drop_m)

    def _edges(self, *, ramp: bool, leaves: bool) -> list[str]:
        return [self._grid.edge_id(Cell(lane_id, 0)) for lane_id in self.road.route(ramp=ramp, leaves=leaves)]

    def run(self) -> None:
        """All steps. Errors: SimulationError."""
        config, road = self.config, self.road
        own, more = config.lane_change.rule == "LC2013", model_parameters(config)
        if own:
            more["lcKeepRight"] = rule_arguments(config.lane_change).get("keep_right", 1.0)
        signals = {lane_id: (one.offset_s, one.phases) for lane_id, one in road.signals.items()}
        with Simulation(
            net_bytes(self._grid, fastest_mps=config.spawn.max_speed_mps, signals=signals), step_s=road.step_s,
            seed=sumo_seed([config.request.seed]), model=config.car_following.model, parameters=more,
            checks_gaps=config.lane_change.safety == "sumo", own_wish=own,
        ) as simulation:  # fmt: skip
            due, since_s = deque(self.vehicles), [0.0, *(one.until_s for one in road.period)]
            parts = deque(zip(since_s, road.period, strict=False))
            behind = [name for name, lane in self._named.items() if lane.start_m >= road.length_m]
            every = max(1, round(ASK_S / road.step_s))
            steps = round((road.seconds + CLEAR_S) / road.step_s)
            red = [(one.at_m, one.shown(road.step_s, steps) != "G") for one in road.signal]
            for step in range(steps):
                now_s = step * road.step_s
                while parts and parts[0][0] <= now_s:
                    for lane_name, limit_mps in zip(behind, parts.popleft()[1].end_mps, strict=False):
                        simulation.limit_lane(lane_name, limit_mps)
                while due and due[0].due_s <= now_s:
                    self._queue(simulation, due.popleft())
                simulation.step()
                self._stops = [at_m for at_m, shown in red if shown[step]]
                here = self._read(simulation, now_s)
                self._on_lane = defaultdict(list)
                for one in sorted(here, key=attrgetter("x")):
                    self._on_lane[one.lane.number].append(one)
                self._give_up_exits(simulation, here)
                for one in here if not own else ():
                    if one.asks % every == step % every:
                        self._ask(simulation, one, now_s)

    def _queue(self, simulation: Simulation, one: RoadVehicle) -> None:
        ramp = one.start > self.road.lanes
        lane_index = self._grid.lane_index(Cell(RAMPS[0] if ramp else one.start, 0))
        edges = self._edges(ramp=ramp, leaves=one.leaves)
        simulation.queue(one.name, edges=edges, lane_index=lane_index, driver=one.driver, size=one.size)

    def _read(self, simulation: Simulation, now_s: float) -> list[RoadVehicle]:
        """Take down where all in the net are."""
        here, rows = [], []
        for name, lane, on_it_m, v in simulation.states():
            one = self._by_name[name]
            one.lane, one.v = self._named[lane], v
            one.x = one.lane.start_m + on_it_m
            inside = 0.0 <= one.x < self.road.length_m and one.lane.lane_id not in RAMPS
            here.append(one)
            rows.append((now_s, one.asks, one.start, one.lane.number, one.x, v, inside))
        self._seen.append(np.array(rows, dtype=np.float64).reshape(-1, len(_SEEN)))
        return here

    def _give_up_exits(self, simulation: Simulation, here: Sequence[RoadVehicle]) -> None:
        """Those that have not come to the lane beside in time go straight on, and do not stop for the exit."""
        nose_m = self.road.beside.to_m if self.road.beside else 0.0
        for one in here:
            if one.leaves and one.lane.number <= self.road.lanes and nose_m - _MISSED_M < one.x < nose_m:
                simulation.set_route(one.name, self._edges(ramp=False, leaves=False)[one.lane.lane_id // ROW :])
                one.leaves = False
                self.missed_exits += 1

    def _ask(self, simulation: Simulation, one: RoadVehicle, now_s: float) -> None:
        """A vehicle is told by its rule whether it changes lanes."""
        wanted = self._must(one)
        sides: list[Literal["left", "right"]] = ["left", "right"] if one.asks % 2 else ["right", "left"]
        own_front, own_rear = self._around(one, one.lane.number)
        for side in [wanted] if wanted else sides:
            target = self._lanes.get((one.lane.left if side == "left" else one.lane.right) or 0)
            if target is None or one.lane.closed or (wanted is None and target.number > self._last_kept):
                continue
            front, rear = self._around(one, target.number)
            if wanted is None and front.distance_m <= 0.0:
                continue
            view = GapView(
                time_s=now_s, waited_s=now_s - one.due_s, side=side, speed_mps=one.v,
                desired_mps=one.driver.desired_mps, length_m=one.size.length_m, tau_s=one.driver.tau_s,
                accel_mps2=one.driver.accel_mps2, decel_mps2=one.driver.decel_mps2,
                min_gap_m=one.driver.min_gap_m, cells_free=front.distance_m > 0.0 and rear.distance_m > 0.0,
                front=front, rear=rear, own_front=own_front, own_rear=own_rear,
                remaining_m=self._end_m[target.number] - one.x, vehicle_id=one.name,
            )  # fmt: skip
            refusals = refusals_unasked(view, self._change, mandatory=wanted is not None)
            if one.lane.number > self.road.lanes:
                said = {"rule": str(next(iter(refusals), "yes")), "refusals": " ".join(refusals)}
                said |= neighbour_row("lead", front, follower_mps=one.v, leader_mps=front.speed_mps)
                said |= neighbour_row("lag", rear, follower_mps=rear.speed_mps, leader_mps=one.v)
                self._looks.append(_ALIKE | said | {"vehicle": one.asks, "time_s": now_s, "side": side})
            if not refusals:
                simulation.change_lane(one.name, self._grid.lane_index(Cell(target.lane_id, 0)))
                break

    def _around(self, one: RoadVehicle, number: int) -> tuple[Gap, Gap]:
        """Gaps to the next ahead and behind on a lane, by fronts; negative where they overlap.

        A closed stop line is like a leader that stands.
        """
        lane = self._on_lane[number]
        place = bisect_right(lane, one.x, key=attrgetter("x"))
        back = place - 1 - (number == one.lane.number)
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
        if one.leaves and self.road.beside and one.x < self.road.beside.to_m:
            return "right" if one.lane.number <= self.road.lanes else None
        return "left" if one.lane.number > self._last_kept else None

    def told(self) -> dict[str, Any]:
        """What a run says of those that entered the section while it was counted, and have left it.

        ratios: by measure, what is counted and what it is divided by; start_to_end: vehicles by start and end lane;
        cells: densities of a lane and of one beside, veh/km, changes from one to the other, veh-km on the first; lag,
        lead: of each vehicle from the ramp the largest time gap, s, that its rule refused for this side alone (0:
        none), and that which it took (None: without a vehicle there); inconsistent: it refused a larger one.
        """
        road, first_s, numbers = self.road, self.road.warm_up_s, range(1, self.road.lanes + 2)
        seen = pd.DataFrame(np.concatenate(self._seen), columns=_SEEN)
        before = seen.groupby("asks")[["lane", "inside"]].shift()
        seen["origin"] = before["lane"].where(before["lane"] != seen["lane"])  # the lane that is left, else NaN
        seen["change"] = seen["origin"].notna() & ((seen["inside"] == 1.0) | (before["inside"] == 1.0))
        inside = seen[seen["inside"] == 1.0]
        counted, entered = (
            rows[rows["now_s"].between(first_s, road.seconds, inclusive="left")]
            for rows in (inside, inside.drop_duplicates("asks"))
        )
        whole = seen.groupby("asks").agg(end=("lane", "last"), still=("inside", "last"), changes=("change", "sum"))
        vehicles = entered.set_index("asks").join(whole)
        vehicles["start"] = vehicles["start"].where(vehicles["start"] > road.lanes, vehicles["lane"])
        left = vehicles[vehicles["still"] == 0.0]
        table = pd.crosstab(left["start"], left["end"]).reindex(index=numbers, columns=numbers, fill_value=0)
        changes = left.groupby("start")["changes"].sum().reindex(numbers, fill_value=0)
        driven_m, every = sum((counted["v"] * road.step_s).tolist()), int(changes.sum())
        gaps = gaps_of(pd.DataFrame([look for look in self._looks if look["vehicle"] in vehicles.index]), [])
        found = {side: largest_rejected(gaps, side) for side in ("lag", "lead")}
        ratios = {
            "flow_veh_per_h": (len(vehicles), (road.seconds - first_s) / 3600.0),
            "speed_mps": (driven_m, len(counted) * road.step_s),
            "changes_per_vehicle": (every, len(left)),
            "changes_per_veh_km": (int(counted["change"].sum()), driven_m / 1000.0),
            "missed_exits": (self.missed_exits, 1),
            "not_left": (len(vehicles) - len(left), 1),
            **{f"inconsistent_{side}": (one[2], 1) for side, one in found.items()},
            **dict(zip(road.from_lanes, zip(changes.tolist(), table.sum(axis=1).tolist(), strict=True), strict=False)),
        }
        told = {"ratios": ratios, "start_to_end": table.to_numpy().tolist(), "cells": list(self._rates(counted))}
        return told | {
            side: [(r, a if a < np.inf else None) for r, a in zip(*one[:2], strict=True)] for side, one in found.items()
        }

    def _rates(self, counted: pd.DataFrame) -> Iterator[tuple[float, float, int, float]]:
        """Of `told`, from where vehicles were seen in the section while it was counted."""
        minute, piece = (counted["now_s"] - self.road.warm_up_s) // CELL_S, counted["x"] // CELL_M
        cell = counted.groupby([minute, piece, "lane"], sort=False)["v"].agg(["size", "sum"]) * self.road.step_s
        moved = counted.groupby([minute, piece, "origin", "lane"]).size().to_dict()
        km = np.minimum(CELL_M, self.road.length_m - cell.index.get_level_values("x") * CELL_M) / 1000.0
        lasts_s = self.road.seconds - self.road.warm_up_s - cell.index.get_level_values("now_s") * CELL_S
        density = (cell["size"] / (np.minimum(CELL_S, lasts_s) * km)).round(3).to_dict()
        for *place, number, _, driven_m in cell.reset_index().itertuples(index=False):
            for other in (number - 1, number + 1):
                if max(number, other) <= self.road.lanes and other > 0:
                    there, changes = density.get((*place, other), 0.0), moved.get((*place, number, other), 0)
                    yield density[*place, number], there, changes, driven_m / 1000.0
