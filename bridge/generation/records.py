"""What became of every manoeuvre that was asked for, as rows of the sidecar."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from bridge.recordings.sidecar import AgentRecord, ManeuverKind, ManeuverRecord, ManeuverStatus, SpawnRecord
from bridge.sumo.steering import Driver
from hid2.agents import FloatArray, Policy
from hid2.conflicts.cases import DT_S
from hid2.motion.repair import SettledVehicle
from hid2.motion.route import first_turn
from hid2.occupancy.traffic import Traffic
from hid2.policy.lane_change import lateral_share
from hid2.policy.maneuver import is_on_lane, returns_to
from hid2.policy.overtake import Stage
from hid2.policy.turns import TURN_OF_POLICY
from hid2.scene import World
from netconvert.lane_graph import TurnType

#: Reason of a finished overtake whose leader stood all the while: evaluation counts it apart.
OBSTACLE_AVOIDANCE = "obstacle_avoidance"
_VISIBLE_MPS = 0.1
_KIND: Mapping[Policy, ManeuverKind] = {
    Policy.LEFT_TURN: "left_turn",
    Policy.RIGHT_TURN: "right_turn",
    Policy.LANE_CHANGE: "lane_change",
    Policy.OVERTAKE: "overtake",
}


def agent_record(
    vehicle: SettledVehicle, driver: Driver, world: World, traffic: Traffic, names: Mapping[str, str]
) -> AgentRecord:
    """Record of one exported vehicle; times are those of the exported motion.

    traffic: everybody in the scene; names: track ids of the generated vehicles by their ids in `traffic`.
    """
    spec = vehicle.driven.spec
    cell = world.cell_at(spec.path, spec.s0)
    end_s = float(vehicle.motion.s[-1])
    route = [
        segment.lane_id for segment in vehicle.driven.path.segments if spec.s0 < segment.end and segment.start <= end_s
    ]
    return AgentRecord(
        track_id=names[spec.vehicle_id],
        object_type="bus" if spec.object_type == "bus" else "vehicle",
        length_m=spec.own_size.length_m,
        width_m=spec.own_size.width_m,
        policy=spec.policy,
        spawn=SpawnRecord(lane_segment_id=cell.lane_id, cell=cell.index, speed_mps=round(spec.v0, 6)),
        route=tuple(route),
        maneuvers=tuple(
            record.model_copy(update={"leader_track_id": names.get(record.leader_track_id, record.leader_track_id)})
            if record.leader_track_id is not None
            else record
            for record in outcomes(vehicle, driver, world, traffic)
        ),
        end_reason="map_edge" if vehicle.num_steps < world.num_steps else None,
        retimed=vehicle.retimed,
        standing=bool(end_s - spec.s0 < 2.0),
    )


def with_unmet(agents: Sequence[AgentRecord], unmet: Sequence[tuple[Policy, str]]) -> list[AgentRecord]:
    """Give each manoeuvre that found no place a record, on a vehicle that was placed to go straight instead of it."""
    records, left = [], list(unmet)
    for record in agents:
        if left and record.policy is Policy.STRAIGHT and not record.maneuvers:
            policy, reason = left.pop(0)
            if policy is not Policy.STRAIGHT:
                missed = ManeuverRecord(kind=_KIND[policy], status="not_feasible", reason=reason)
                record = record.model_copy(update={"maneuvers": (missed,)})
        records.append(record)
    return records


def outcomes(vehicle: SettledVehicle, driver: Driver, world: World, traffic: Traffic) -> list[ManeuverRecord]:
    """What became of the manoeuvre that a vehicle was placed for; none for one that goes straight.

    traffic: everybody in the scene. A leader's id is the one that it has there.
    """
    policy = vehicle.driven.spec.policy
    if policy in TURN_OF_POLICY:
        return [_turn(vehicle, world)]
    if policy is Policy.LANE_CHANGE:
        return [_lane_change(vehicle, driver)]
    if policy is Policy.OVERTAKE:
        return [_overtake(vehicle, driver, world, traffic)]
    return []


def _turn(vehicle: SettledVehicle, world: World) -> ManeuverRecord:
    spec, s = vehicle.driven.spec, vehicle.motion.s
    kind = TURN_OF_POLICY[spec.policy]
    segments = vehicle.driven.path.segments
    turn = first_turn(world.grid.graph, vehicle.driven.path, kind, after=spec.s0)
    name: ManeuverKind = "left_turn" if kind is TurnType.LEFT else "right_turn"
    if turn is None:  # nobody looked ahead: the ablation without collision checks
        return ManeuverRecord(kind=name, status="not_feasible", reason="turn_leaves_map", trigger_s=0.0)
    row = segments.index(turn)
    start, end = _time(s, turn.start), _time(s, turn.end)
    return ManeuverRecord(
        kind=name,
        status="done" if end is not None else "aborted" if start is not None else "not_feasible",
        reason=None if end is not None else "scene_ended",
        trigger_s=0.0,
        requested_s=0.0,
        start_s=start,
        end_s=end,
        source_lane=segments[row - 1].lane_id if row else None,
        target_lane=turn.lane_id,
        min_ttc_s=_finite(vehicle.min_ttc_s),
    )


def _lane_change(vehicle: SettledVehicle, driver: Driver) -> ManeuverRecord:
    spec = vehicle.driven.spec
    trigger = round(spec.trigger_s, 6)
    if not driver.shifts:
        missed: ManeuverStatus = "not_triggered" if trigger > (vehicle.num_steps - 1) * DT_S else "not_feasible"
        return ManeuverRecord(
            kind="lane_change", status=missed, reason=driver.reason or "scene_ended", trigger_s=trigger
        )
    shift = driver.shifts[0]
    start, crossing, end = _shift_times(vehicle, 0)
    done = end is not None
    return ManeuverRecord(
        kind="lane_change", status="done" if done else "aborted", reason=None if done else "scene_ended",
        trigger_s=trigger, requested_s=round(shift.requested_step * DT_S, 6),
        start_s=start, crossing_s=crossing, end_s=end,
        source_lane=shift.source_lane, target_lane=shift.target_lane, gap_front_m=_finite(shift.gap_front_m),
        gap_rear_m=_finite(shift.gap_rear_m), min_ttc_s=_finite(vehicle.min_ttc_s),
    )  # fmt: skip


def _overtake(vehicle: SettledVehicle, driver: Driver, world: World, traffic: Traffic) -> ManeuverRecord:
    """Done where the vehicle is back in its lane ahead of the leader, by the exported motion of both."""
    spec = vehicle.driven.spec
    trigger = round(spec.trigger_s, 6)
    if not driver.shifts:
        missed: ManeuverStatus = "not_triggered" if trigger > (vehicle.num_steps - 1) * DT_S else "not_feasible"
        return ManeuverRecord(kind="overtake", status=missed, reason=driver.reason or "scene_ended", trigger_s=trigger)
    enter = driver.shifts[0]
    start, crossing, entered = _shift_times(vehicle, 0)
    _, back_s, end = _shift_times(vehicle, 1) if len(driver.shifts) > 1 else (None, None, None)
    leader_id = driver.leader_id if driver.leader_id in traffic.ids else None
    reason: str | None = None
    if leader_id is None:
        reason = "leader_not_kept"
    elif entered is None:
        reason = "scene_ended_entering"
    elif len(driver.shifts) == 1 and driver.stage is Stage.PASS and driver.reason == "not_ahead":
        reason = "not_passed"
    elif len(driver.shifts) == 1:
        reason = f"passed_without_return:{driver.reason or 'scene_ended'}"
    elif end is None or back_s is None:
        reason = "scene_ended_returning"
    elif not returns_to(spec.path, vehicle.driven.path):
        reason = "returned_elsewhere"
    elif not _is_ahead(vehicle, round(back_s / DT_S), leader_id, traffic):
        reason = "returned_behind"
    done = reason is None
    if done and leader_id is not None and _stands(leader_id, traffic, world.config.overtake.parked_mps):
        reason = OBSTACLE_AVOIDANCE
    return ManeuverRecord(
        kind="overtake", status="done" if done else "aborted", reason=reason, trigger_s=trigger,
        requested_s=round(enter.requested_step * DT_S, 6), start_s=start, crossing_s=crossing,
        end_s=end if done else None, source_lane=enter.source_lane, target_lane=enter.target_lane,
        leader_track_id=leader_id, gap_front_m=_finite(enter.gap_front_m), gap_rear_m=_finite(enter.gap_rear_m),
        min_ttc_s=_finite(vehicle.min_ttc_s),
    )  # fmt: skip


def _is_ahead(vehicle: SettledVehicle, step: int, leader_id: str, traffic: Traffic) -> bool:
    """Whether the whole box is ahead of the leader's at a step, along the own heading; or was when it was last there.

    A leader that left the lane path on which it was followed has not been overtaken.
    """
    row = traffic.ids.index(leader_id)
    there = np.flatnonzero(traffic.present[row, : step + 1])
    if there.size == 0:
        return False
    seen = int(there[-1])
    if not is_on_lane(vehicle.driven.spec.path, traffic.position[row, seen]):
        return False
    offset = vehicle.trajectory.position[seen] - traffic.position[row, seen]
    heading = float(vehicle.trajectory.heading[seen])
    along = float(offset[0] * math.cos(heading) + offset[1] * math.sin(heading))
    return along > 0.5 * (vehicle.driven.spec.own_size.length_m + float(traffic.length_m[row]))


def _stands(track_id: str, traffic: Traffic, parked_mps: float) -> bool:
    row = traffic.ids.index(track_id)
    speed = np.hypot(*traffic.velocity[row, traffic.present[row]].T)
    return bool(np.all(speed < parked_mps))


def _shift_times(vehicle: SettledVehicle, index: int) -> tuple[float | None, float | None, float | None]:
    """Start, crossing and end of a lateral motion: where |d'| passes 0.1 m/s, and half way between the lanes."""
    start_m, end_m = vehicle.driven.path.shifts[index]
    s = vehicle.motion.s
    share = lateral_share((s - start_m) / max(end_m - start_m, 1e-9))
    lateral_mps = np.abs(np.gradient(share * 3.5, DT_S))
    moving = np.flatnonzero(lateral_mps > _VISIBLE_MPS)
    start = round(float(moving[0]) * DT_S, 6) if moving.size else None
    crossing = _time(s, 0.5 * (start_m + end_m))
    finished = float(share[-1]) > 0.98
    end = round(min(float(moving[-1]) + 1, s.size - 1) * DT_S, 6) if finished and moving.size else None
    return start, crossing, end


def _time(s: FloatArray, place: float) -> float | None:
    """First time at which s(t) has passed a place, s; None where it never does."""
    passed = np.flatnonzero(s >= place)
    return round(float(passed[0]) * DT_S, 6) if passed.size else None


def _finite(value: float) -> float | None:
    return round(float(value), 6) if math.isfinite(value) else None
