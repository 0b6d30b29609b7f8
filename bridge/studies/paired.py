"""One run of a study: the same vehicles, drivers, sites and traffic for every value of what varies.

Starts are drawn with the defaults of all that only decides (lane change, overtake, conflict, signals, car following),
so that no value of these can choose other ones; they are driven with the configuration of the run. Nothing is replaced
and nothing is left out: what did not come about is an outcome. All is measured as simulated; whether a vehicle could be
exported is a column.
"""

import zlib
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from bridge.batch.batch import Run, SceneFolders, base_row
from bridge.batch.isolation import Failure, attempts
from bridge.batch.manifest import ManifestRow
from bridge.config import config_sha256
from bridge.files import rounded
from bridge.generation.gaps import gaps_bytes, look_row
from bridge.generation.generate import PreparedScene, prepare
from bridge.generation.scene import scene_of
from bridge.recordings.sources import read_recording
from bridge.recordings.ssam import trj_bytes
from bridge.studies.columns import REQUEST_COLUMNS
from bridge.studies.study import LOOKS_FILE, RUN_TABLES, write_run
from bridge.sumo.fleet import Fleet
from bridge.sumo.flow_driving import NEAR_M, FlowDriving
from hid2.agents import Policy, Track
from hid2.conflicts.stop_lines import StopLines
from hid2.drivers.driver import MIDDLE
from hid2.insertion.filling import Filling, Unmet
from hid2.insertion.finalise import ExportedVehicle, as_exported, finalise, traffic_of_exported
from hid2.insertion.flow import Arrival, arrivals, trigger_after_s
from hid2.insertion.outcome import outcome_of
from hid2.insertion.requests import draw_requests
from hid2.insertion.surroundings import Surroundings
from hid2.measures.conflicts import TrafficConflict, conflicts, pair_course
from hid2.measures.following import leaders
from hid2.measures.lane_changes import LaneChangeRow, lane_changes
from hid2.measures.lane_matching import flatten_lanes
from hid2.measures.manoeuvres import detect
from hid2.measures.surrogates import CAP_S, time_to_collision
from hid2.motion.smoothing import Motion, trajectory
from hid2.occupancy.agent_states import AgentStates, agent_states
from hid2.params import Config, LaneChange
from hid2.policy.overtake import shortest_shift_s
from hid2.policy.roads import Roads
from hid2.reasons import Reason
from hid2.scene import Scene, future_of
from hid2.vehicle import DrivenVehicle, Start

#: Detectors: length of the intervals, s.
_INTERVAL_S = 60.0


@dataclass(frozen=True, eq=False, slots=True)
class Drawn:
    """The vehicles of a run, for every value of what varies: starts, arrivals, and requests without a site."""

    scene: Scene
    starts: tuple[Start, ...]
    unmet: tuple[Unmet, ...]
    arrivals: tuple[Arrival, ...]
    seed: tuple[int, ...]


@dataclass(frozen=True, eq=False, slots=True)
class PairedRun:
    """What was measured in one run: rows of the tables.

    driven: vehicles with their looks; states: what moved, as simulated, recorded agents first.
    """

    requests: list[dict[str, Any]]
    flow: list[dict[str, Any]]
    lane_changes: list[dict[str, Any]]
    conflicts: list[dict[str, Any]]
    driven: tuple[DrivenVehicle, ...]
    states: AgentStates


def measure_runs(place: SceneFolders, runs: Sequence[Run], *, trj: bool = False) -> Iterator[ManifestRow | Failure]:
    """The work of a process: each run driven, measured and written; what the runs share is made once.

    trj: write its trajectories for SSAM, too.
    """
    prepared: PreparedScene | None = None
    drawn: dict[str, Drawn] = {}

    def row(run: Run) -> ManifestRow:
        nonlocal prepared, drawn
        config = run.config
        prepared = prepared or prepare(read_recording(place.folder), config)
        drawing = drawing_config(config)
        key, source = config_sha256(drawing), prepared.scenario
        if key not in drawn:
            drawn = {key: draw(prepared, drawing)}  # the last one is enough: runs come seed by seed
        found = paired_run(prepared, drawn[key], config)
        files = {LOOKS_FILE: gaps_bytes([(0, vehicle) for vehicle in found.driven], {}, step_s=source.step_s)}
        if trj:
            files["trajectories.trj"] = trj_bytes(found.states.arrays, found.states.matches)
        folder = write_run(place.out, source, config, {name: getattr(found, name) for name in RUN_TABLES}, files)
        done = Counter[str](one["kind"] for one in found.requests if one["status"] == "done")
        return base_row(place, run, folder)._replace(
            city=source.city, recorded=len(source.tracks), placed=len(found.driven), driven=len(found.driven),
            straight=sum(vehicle.policy is Policy.STRAIGHT for vehicle in found.driven),
            maneuvers_requested=len(found.requests), maneuvers_done=done.total(), **dict[str, Any](done),
        )  # fmt: skip

    return attempts(row, runs)


#: The same with trajectories.
measure_runs_for_ssam = partial(measure_runs, trj=True)


def drawing_config(config: Config) -> Config:
    """The part of a configuration that decides which vehicles take part; the rest has its defaults."""
    request = config.request.model_copy(
        update={"sites": "any", "trigger_min_s": 0.0, "trigger_max_s": 0.0, "trigger_list_s": ()}
    )
    flow = config.flow.model_copy(update={"warm_up_s": 0.0})
    spawn = config.spawn.model_copy(update={"reseed_rounds": 1})  # a study may vary it
    change = LaneChange(min_duration_s=1.5, max_duration_s=15.0)  # as wide as may be: each run has its own
    kept = {name: getattr(config, name) for name in ("grid", "drivers", "turn", "limits", "smoothing", "without")}
    return Config(request=request, spawn=spawn, lane_change=change, flow=flow, **kept)


def draw(prepared: PreparedScene, config: Config) -> Drawn:
    """Vehicles, drivers and sites for a `drawing_config`."""
    scene = scene_of(prepared.scenario, config, prepared.grid)
    seed = config.request.seed, 0, zlib.crc32(prepared.scenario.scenario_id.encode())
    surroundings = Surroundings(scene)
    filling, count = Filling(surroundings, seed), config.request.agents
    assert count != "max"  # refused by `read_study`
    starts = filling.first_starts(count) if count else []
    comers = tuple(arrivals(scene, surroundings.routes, seed))
    return Drawn(scene, starts=tuple(starts), unmet=tuple(filling.unmet), arrivals=comers, seed=seed)


def paired_run(prepared: PreparedScene, drawn: Drawn, config: Config) -> PairedRun:
    """Drive the vehicles with a configuration, and measure. Errors: SimulationError, ConfigError."""
    scene = replace(drawn.scene, config=config)
    if config.conflict.horizon_s > drawn.scene.config.conflict.horizon_s:
        scene = replace(scene, future=future_of(scene.traffic, config, step_s=scene.step_s))
    trigger_s, last_s = triggers(config, drawn), scene.last_s
    asked = [replace(one.request, trigger_s=trigger_s[one.request.number]) for one in drawn.starts]
    starts = [_as_in_run(replace(one, request=ask), config) for one, ask in zip(drawn.starts, asked, strict=True)]
    comers = [replace(one, start=_as_in_run(one.start, config)) for one in drawn.arrivals]
    with prepared.simulation(config, drawn.seed) as simulation:
        fleet = Fleet(scene, starts, traffic_of_exported([], scene), Roads(scene), StopLines(scene), near_m=NEAR_M)
        after_s = partial(trigger_after_s, request=config.request, seed=drawn.seed, duration_s=last_s)
        driving = FlowDriving(fleet, simulation, checked=False, arrivals=comers, trigger_after_s=after_s)
        vehicles = driving.run()
    recorded: Sequence[Track] = prepared.scenario.tracks
    if driving.reactions is not None:
        recorded = driving.reactions.tracks(recorded)
        scene = scene_of(prepared.scenario, config, scene.grid, tracks=recorded)
    return _measured(scene, drawn, driving, vehicles, recorded, trigger_s)


def _as_in_run(start: Start, config: Config) -> Start:
    """The same start, with a lane change of its driver no shorter and no longer than the run allows."""
    driver, change = start.driver, config.lane_change
    lasts_s = min(max(driver.lane_change_s, change.min_duration_s), change.max_duration_s)
    return replace(start, driver=replace(driver, lane_change_s=lasts_s))


def triggers(config: Config, drawn: Drawn) -> dict[int, float]:
    """Trigger times by the number of the request, drawn as those of a scene are."""
    count = config.request.agents
    assert count != "max"
    last_s = drawn.scene.last_s
    requests = draw_requests(config, np.random.default_rng([*drawn.seed, 0]), count=count, duration_s=last_s)
    return {request.number: request.trigger_s for request in requests}


def begins_by_s(last_s: float, config: Config, kind: str) -> float:
    """When the shortest change of a kind has to begin so that it ends by last_s, s; a turn by then."""
    shortest_s = {"lane_change": config.lane_change.min_duration_s, "overtake": shortest_shift_s(config)}
    return last_s - shortest_s.get(kind, 0.0)


def _measured(
    scene: Scene, drawn: Drawn, driving: FlowDriving, vehicles: Sequence[DrivenVehicle], recorded: Sequence[Track],
    trigger_s: dict[int, float],
) -> PairedRun:  # fmt: skip
    moved = [vehicle for vehicle in vehicles if len(vehicle.s) > 1]
    entered_at = {vehicle.vehicle_id: driving.entered.get(vehicle.vehicle_id, 0) for vehicle in vehicles}
    simulated = {one.vehicle_id: _as_simulated(scene, one, entered_at[one.vehicle_id]) for one in moved}
    exported = _exported(scene, [vehicle for vehicle in vehicles if vehicle.vehicle_id not in driving.entered])
    tracks = [*recorded, *(one.track(vehicle_id, 1) for vehicle_id, one in simulated.items())]
    states = agent_states(tracks, flatten_lanes(scene.grid.graph), num_steps=scene.num_steps, step_s=scene.step_s)
    arrays = states.arrays
    ttc_s, met = time_to_collision(arrays, cap_s=CAP_S)[0], conflicts(arrays)
    rows = []
    for vehicle in vehicles:
        if vehicle.policy is Policy.STRAIGHT:
            continue
        entered = entered_at[vehicle.vehicle_id]
        row = _request_row(scene, vehicle, first=entered)
        row["source"] = "flow" if vehicle.vehicle_id in driving.entered else "start"
        row["exported"] = exported.get(vehicle.vehicle_id)
        one = simulated.get(vehicle.vehicle_id)
        outcome = outcome_of(scene, one, simulated.values()) if one is not None else None
        if outcome is not None:
            row |= {name: getattr(outcome, name) for name in ("status", "start_s", "crossing_s", "end_s")}
            row["reason"] = None if outcome.reason is None else str(outcome.reason.value)
        if row["start_s"] is not None:
            first = round(row["start_s"] / scene.step_s)
            last = round((row["end_s"] or (entered + len(vehicle.s) - 1) * scene.step_s) / scene.step_s)
            own = arrays.row_of[arrays.track_ids.index(vehicle.vehicle_id)][first : last + 1]
            ttc = float(ttc_s[own].min())
            row["min_ttc_s"] = None if ttc >= CAP_S else rounded(ttc)
            row["overlaps"] = row["min_ttc_s"] == 0.0
            lag_id = next((look.seen.rear.track_id for look in vehicle.gaps if look.sumo), None)
            if lag_id in arrays.track_ids:
                pair = (arrays.track_ids.index(str(name)) for name in (lag_id, vehicle.vehicle_id))
                course = pair_course(arrays, *pair).during(first, last)
                row |= {name: rounded(value) for name, value in course.of_follower().items()}
        if row["start_s"] is not None and row["end_s"] is not None:
            row["lateral_s"] = round(row["end_s"] - row["start_s"], 6)
        rows.append(row)
    missed = [("start", f"v{one.request.number}_0", one.request, one.reason) for one in drawn.unmet]
    held = (one for one in driving.arrivals if one.vehicle_id not in driving.entered)
    missed += [("flow", one.vehicle_id, one.start.request, Reason.NO_ROOM_AT_EDGE) for one in held]
    rows += [
        dict.fromkeys(REQUEST_COLUMNS) | {
            "vehicle": name, "source": source, "kind": request.policy.value, "status": "not_placed",
            "reason": reason.value, "trigger_s": trigger_s[request.number] if source == "start" else None,
        }
        for source, name, request, reason in missed if request.policy is not Policy.STRAIGHT
    ]  # fmt: skip
    since_s = scene.config.flow.counted_from_s
    changes = lane_changes(states, leaders(states), detect(states))
    return PairedRun(
        rows, _detectors(scene, driving, states), _told(changes, since_s), _told(met, since_s), tuple(vehicles), states
    )


def _told(found: Iterable[LaneChangeRow | TrafficConflict], since_s: float) -> list[dict[str, Any]]:
    """Rows of what begins after the warm-up."""
    rows = (asdict(one) for one in found if one.start_s >= since_s)
    return [{key: rounded(value) if isinstance(value, float) else value for key, value in row.items()} for row in rows]


def _request_row(scene: Scene, vehicle: DrivenVehicle, *, first: int) -> dict[str, Any]:
    """What the looks at gaps tell of one request. first: step at which the vehicle began."""
    start, trigger_s = vehicle.start, vehicle.start.request.trigger_s
    last_s = (first + max(len(vehicle.s) - 1, 0)) * scene.step_s
    shift = vehicle.shifts[0] if vehicle.shifts else None
    accepted_s = None if shift is None else shift.requested_step * scene.step_s
    # until when it could have accepted: it gave up, or it left, or the scene had no time left for a change
    gives_up_s = trigger_s + scene.config.lane_change.give_up_s
    too_late_s = begins_by_s(scene.last_s, scene.config, vehicle.policy.value)
    until_s = min(last_s, too_late_s, gives_up_s) if accepted_s is None else accepted_s
    row = dict.fromkeys(REQUEST_COLUMNS) | {
        "vehicle": vehicle.vehicle_id, "kind": vehicle.policy.value, "entered_s": rounded(first * scene.step_s),
        "desired_mps": rounded(start.driver.desired_mps), "trigger_s": rounded(trigger_s),
        "accepted": shift is not None, "accepted_s": rounded(accepted_s), "observed_to_s": rounded(until_s),
        "waited_s": None if until_s < trigger_s else rounded(until_s - trigger_s),
        "looks": len(vehicle.gaps),
    }  # fmt: skip
    took = next((look for look in vehicle.gaps if look.sumo), None)
    if took is not None:
        row |= {name: told for name, told in look_row(took).items() if name in REQUEST_COLUMNS}
    row["status"] = "not_triggered" if trigger_s > last_s else "not_feasible"
    row["reason"] = str(vehicle.not_inserted or vehicle.reason or Reason.SCENE_ENDED)
    return row


def _as_simulated(scene: Scene, vehicle: DrivenVehicle, first: int) -> ExportedVehicle:
    """A vehicle as SUMO moved it since a step, unsmoothed, unchecked, and in the middle of its lane.

    Its driver's wandering in the lane is unknown to SUMO: vehicles side by side would touch that have not met.
    """
    vehicle = replace(vehicle, start=replace(vehicle.start, step=first))
    s, v = np.array(vehicle.s), np.array(vehicle.v)
    motion = Motion(s=s, v=v, a=np.gradient(v, scene.step_s), step_s=scene.step_s)
    path = trajectory(vehicle.path.line, motion, MIDDLE, vehicle.start.size.length_m)
    return as_exported(scene, vehicle, motion, path, np.zeros(s.size))


def _exported(scene: Scene, vehicles: Sequence[DrivenVehicle]) -> dict[str, str]:
    """Whether each could be exported, one after the other: yes, or the reason."""
    kept: list[ExportedVehicle] = []
    verdicts = {}
    for vehicle in vehicles:
        found = finalise(scene, vehicle, kept)
        if isinstance(found, ExportedVehicle):
            kept.append(found)
        verdicts[vehicle.vehicle_id] = "yes" if isinstance(found, ExportedVehicle) else str(found.value)
    return verdicts


def _detectors(scene: Scene, driving: FlowDriving, states: AgentStates) -> list[dict[str, Any]]:
    """Flow, density and speed of driven vehicles by entry lane and minute (Edie 1963), after the warm-up.

    A rest of half a minute or more is a row too, and so is a shorter scene. Nothing where no traffic enters.
    """
    arrays, step_s = states.arrays, scene.step_s
    first, whole = round(scene.config.flow.warm_up_s / step_s), round(_INTERVAL_S / step_s)
    cuts = [*range(first, scene.num_steps, whole)]
    if len(cuts) < 2 or scene.num_steps - cuts[-1] >= whole / 2:
        cuts.append(scene.num_steps)
    driven = ~np.isin(arrays.track_ids, scene.traffic.ids)[arrays.agent]
    on_lane = np.where(driven & (states.matches.lane >= 0), states.lanes.lane_ids[states.matches.lane], -1)
    speed, rows = np.hypot(*arrays.velocity.T), []
    for lane in sorted({arrival.lane_id for arrival in driving.arrivals}):
        for begin, end in pairwise(cuts):
            there = (on_lane == lane) & (arrays.step >= begin) & (arrays.step < end)
            area = scene.grid.graph.lanes[lane].length_m / 1000.0 * (end - begin) * step_s / 3600.0  # km h
            flow, density = speed[there].sum() * step_s / 1000.0 / area, there.sum() * step_s / 3600.0 / area
            ids = [one.vehicle_id for one in driving.arrivals if one.lane_id == lane]
            waited = [driving.waiting_s[one] for one in ids if begin <= driving.entered.get(one, -1) < end]
            rows.append({
                "lane": lane, "from_s": rounded(begin * step_s), "to_s": rounded(end * step_s),
                "flow_veh_per_h_lane": rounded(flow), "density_veh_per_km_lane": rounded(density),
                "speed_kmph": rounded(flow / density) if density > 0 else None,
                "waiting_to_enter_s": rounded(float(np.mean(waited))) if waited else None,
            })  # fmt: skip
    return rows
