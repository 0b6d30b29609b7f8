"""What became of every vehicle and manoeuvre that was asked for, as rows of the sidecar."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from typing import Any, cast

import numpy as np

from bridge.files import rounded
from bridge.generation.program import code_sha256, libraries
from bridge.recordings import sidecar
from hid2.agents import Policy
from hid2.insertion.events import EventOutcome
from hid2.insertion.filling import Filling, Rejection, Unmet
from hid2.insertion.finalise import ExportedVehicle
from hid2.insertion.meetings import moving_vehicles, target_rows
from hid2.insertion.outcome import Outcome, gaps_at_request
from hid2.judge.events import brakes_for
from hid2.measures.driven_lanes import runs_of
from hid2.measures.selection import drives
from hid2.occupancy.traffic import Traffic
from hid2.policy.behaviours import BEHAVIOURS
from hid2.policy.lane_change import OPEN
from hid2.reasons import Reason
from hid2.scene import Scene


def generator_record() -> sidecar.GeneratorRecord:
    """Record of this program."""
    return sidecar.GeneratorRecord(version=version("hid2-sumo"), code_sha256=code_sha256(), libraries=libraries())


def _kind(policy: Policy) -> sidecar.ManeuverKind:
    return cast(sidecar.ManeuverKind, BEHAVIOURS[policy].seen_as[0].value)


def agent_record(
    scene: Scene, vehicle: ExportedVehicle, outcome: Outcome | None, names: Mapping[str, str], others: Traffic
) -> sidecar.AgentRecord:
    """Record of one exported vehicle.

    names: track ids of the generated vehicles by their ids in the simulation; others: these, but for this one.
    """
    driven = vehicle.driven
    start, driver = driven.start, driven.start.driver
    cell, lanes = scene.cell_at(start.path, start.start_m), vehicle.states.lanes.lane_ids
    route = dict.fromkeys(int(lanes[run.lane]) for run in runs_of(vehicle.states, 0) if run.lane >= 0)
    steps = max(driven.policies.total(), 1)  # at which it was steered
    return sidecar.AgentRecord(
        track_id=names[driven.vehicle_id],
        object_type="bus" if start.request.object_type == "bus" else "vehicle",
        length_m=start.size.length_m,
        width_m=start.size.width_m,
        policy=driven.policy,
        spawn=sidecar.SpawnRecord(
            lane_segment_id=cell.lane_id, cell=cell.index, speed_mps=round(start.start_mps, 6), timestep=start.step
        ),
        route=tuple(route),
        maneuvers=() if outcome is None else (maneuver_record(scene, vehicle, outcome, names, others),),
        driver=sidecar.DriverRecord(
            model=scene.config.car_following.model,
            parameters={name: round(value, 6) for name, value in asdict(driver).items()},
        ),
        limited={cause: round(count / steps, 6) for cause, count in sorted(driven.limited.items())},
        policies={policy: round(count / steps, 6) for policy, count in sorted(driven.policies.items())},
        gaps=sidecar.GapsRecord(
            looked_at=len(driven.gaps),
            refused_by_rule=sum((look.rule or look.guard) is not None for look in driven.gaps),
            refused_by_sumo=sum(look.sumo is False for look in driven.gaps),
        ),
        rerouted_s=None if driven.rerouted_at is None else round(driven.rerouted_at * scene.step_s, 6),
        simulated=sidecar.SimulatedRecord(max_off_m=round(float(abs(vehicle.simulated_off_m).max()), 6)),
        end_reason="map_edge" if vehicle.span.stop < scene.num_steps else None,
    )


def maneuver_record(
    scene: Scene, vehicle: ExportedVehicle, outcome: Outcome, names: Mapping[str, str], others: Traffic
) -> sidecar.ManeuverRecord:
    """Record of one manoeuvre; times and gaps are those of the exported motion."""
    driven, is_turn = vehicle.driven, BEHAVIOURS[outcome.policy].turn is not None
    shift, front, rear = driven.shifts[0] if driven.shifts else None, OPEN, OPEN
    if shift is not None:
        front, rear = gaps_at_request(scene, vehicle, shift, others)
    requested_s = None if shift is None else round(shift.requested_step * vehicle.motion.step_s, 6)
    leader, told = outcome.leader_id, asdict(outcome)
    return sidecar.ManeuverRecord(
        **{name: told[name] for name in ("status", "start_s", "crossing_s", "end_s", "source_lane", "target_lane")},
        kind=_kind(outcome.policy),
        reason=_with_detail(outcome.reason, outcome.detail),
        trigger_s=0.0 if is_turn else round(driven.start.request.trigger_s, 6),
        requested_s=0.0 if is_turn else requested_s,
        leader_track_id=None if leader is None else names.get(leader, leader),
        gap_front_m=rounded(front.distance_m, 6),
        gap_rear_m=rounded(rear.distance_m, 6),
        min_ttc_s=rounded(vehicle.min_ttc_s, 6),
    )


def event_record(found: EventOutcome, names: Mapping[str, str]) -> sidecar.EventRecord:
    """Record of one event that was asked for; names: as of `agent_record`."""
    asked: Any = {"kind": found.event.kind, "target": found.event.target, "tries": found.tries}
    seen = found.seen
    if found.vehicle is None or seen is None:
        most = next((one for one in found.tried if one is not found.reason), None)
        tried = {reason.value: count for reason, count in found.tried.items()}
        return sidecar.EventRecord(**asked, status="not_feasible", reason=_with_detail(found.reason, most), tried=tried)
    figures: Any = {name: None if value is None else round(value, 6) for name, value in asdict(seen.measures).items()}
    return sidecar.EventRecord(
        **asked,
        **figures,
        status="done",
        track_id=names[found.vehicle.driven.vehicle_id],
        target_track_id=found.target_id,
        at_s=round(seen.at_step * found.vehicle.motion.step_s, 6),
        ahead=seen.order > 0,
        human_brakes=brakes_for(figures["min_ttc_s"], figures["drac_mps2"]),
    )


def unmet_record(missed: Unmet) -> sidecar.ManeuverRecord:
    """Record of a manoeuvre that no vehicle does."""
    kind, reason, trigger_s = _kind(missed.request.policy), missed.reason.value, round(missed.request.trigger_s, 6)
    return sidecar.ManeuverRecord(kind=kind, status="not_feasible", reason=reason, trigger_s=trigger_s)


def _with_detail(reason: Reason | None, detail: str | None) -> str | None:
    return None if reason is None else ":".join(filter(None, (reason.value, detail)))


def rejected_records(filling: Filling) -> tuple[sidecar.RejectedRecord, ...]:
    """Vehicles and sites that were tried in vain, counted by reason."""
    counts = Counter(one.reason for one in filling.rejected) + filling.no_site
    return tuple(sidecar.RejectedRecord(reason=reason.value, count=count) for reason, count in sorted(counts.items()))


def replaced_record(rejection: Rejection) -> sidecar.ReplacedRecord:
    """One vehicle that was driven and not kept."""
    return sidecar.ReplacedRecord(
        vehicle=rejection.vehicle.vehicle_id, policy=rejection.vehicle.policy, reason=rejection.reason.value,
        detail=None if rejection.detail is None else str(rejection.detail), round=rejection.round_number,
        lane_segment_id=rejection.cell.lane_id, cell=rejection.cell.index, last_step=rejection.vehicle.last_step,
    )  # fmt: skip


def selection_record(scene: Scene, filling: Filling) -> sidecar.SelectionRecord:
    """How vehicles that are kept drive, those that are not, and recorded vehicles that move."""
    traffic = scene.traffic
    speeds = [np.hypot(*traffic.velocity[row, traffic.present[row]].T) for row in moving_vehicles(scene).tolist()]
    driven = {"kept": [one.driven for one in filling.kept], "dropped": [one.vehicle for one in filling.rejected]}
    told = {"recorded": drives(speeds, step_s=scene.step_s)}
    for name, vehicles in driven.items():
        limited = sum(one.limited["conflict"] for one in vehicles)
        told[name] = drives((np.array(one.v) for one in vehicles), step_s=scene.step_s, limited=limited)
    return sidecar.SelectionRecord(**told)


def near_count(scene: Scene, vehicles: Sequence[ExportedVehicle]) -> int:
    """Vehicles with a centre within request.within_m of what request.near names: at the last observed step, or any."""
    request, traffic = scene.config.request, scene.traffic
    rows, count = target_rows(scene), 0
    for one in vehicles:
        apart = traffic.position[rows][:, one.span] - one.trajectory.position
        is_near = traffic.present[rows][:, one.span] & (np.hypot(*np.moveaxis(apart, -1, 0)) <= request.within_m)
        if request.is_near_agents:
            is_near = is_near[:, np.arange(one.span.start, one.span.stop) == scene.last_observed_step]
        count += bool(is_near.any())
    return count
