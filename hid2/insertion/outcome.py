"""What became of the manoeuvre that a vehicle was asked for, by its exported motion."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hid2.agents import FloatArray, Policy
from hid2.insertion.finalise import ExportedVehicle
from hid2.measures.manoeuvres import LATERAL_SPEED_MPS, TURN_MARGIN_S
from hid2.motion.lane_change_path import lateral_share
from hid2.motion.route import first_turn
from hid2.occupancy.traffic import Traffic
from hid2.policy.behaviours import TURN_OF_POLICY
from hid2.policy.observation import is_on_lane, returns_to
from hid2.policy.overtake import Stage
from hid2.reasons import Reason
from hid2.scene import Scene
from netconvert.lane_graph import TURN_RAD

Status = Literal["done", "aborted", "not_feasible", "not_triggered"]


@dataclass(frozen=True, slots=True)
class Outcome:
    """Status of a manoeuvre, its reason where it was not done, and its times, s; None for what did not come about."""

    policy: Policy
    status: Status
    reason: Reason | None = None
    detail: str | None = None
    start_s: float | None = None
    crossing_s: float | None = None
    end_s: float | None = None
    source_lane: int | None = None
    target_lane: int | None = None
    leader_id: str | None = None

    @property
    def done(self) -> bool:
        """Whether it came about."""
        return self.status == "done"


def outcome_of(scene: Scene, vehicle: ExportedVehicle, traffic: Traffic) -> Outcome | None:
    """Outcome of a vehicle's request; None for one that goes straight. traffic: everybody in the scene."""
    policy = vehicle.driven.policy
    if policy in TURN_OF_POLICY:
        return _turn(scene, vehicle)
    if policy is Policy.LANE_CHANGE:
        return _lane_change(vehicle)
    if policy is Policy.OVERTAKE:
        return _overtake(scene, vehicle, traffic)
    return None


def _turn(scene: Scene, vehicle: ExportedVehicle) -> Outcome:
    """Done where the lane is driven to its end and the heading turns by 30 degrees, as a detector sees it."""
    driven, s = vehicle.driven, vehicle.motion.s
    kind, step_s = TURN_OF_POLICY[driven.policy], scene.step_s
    turn = first_turn(scene.grid.graph, driven.path, kind, after=driven.start.start_s)
    if turn is None:
        return Outcome(driven.policy, "not_feasible", Reason.TURN_NOT_SEEN)
    row = driven.path.segments.index(turn)
    source = driven.path.segments[row - 1].lane_id if row else None
    start, end = _step(s, turn.start), _step(s, turn.end)
    common = {"start_s": _time(start, step_s), "source_lane": source, "target_lane": turn.lane_id}
    if start is None:
        return Outcome(driven.policy, "not_feasible", Reason.SCENE_ENDED, **common)  # type: ignore[arg-type]
    if end is None:
        return Outcome(driven.policy, "aborted", Reason.SCENE_ENDED, **common)  # type: ignore[arg-type]
    heading, around = np.unwrap(vehicle.trajectory.heading), scene.steps_in(TURN_MARGIN_S)
    turned = heading[min(end + around, s.size - 1)] - heading[max(start - around, 0)]
    if (turned if driven.policy is Policy.LEFT_TURN else -turned) < TURN_RAD:
        return Outcome(driven.policy, "not_feasible", Reason.TURN_NOT_SEEN, **common)  # type: ignore[arg-type]
    return Outcome(driven.policy, "done", end_s=_time(end, step_s), **common)  # type: ignore[arg-type]


def _missed(vehicle: ExportedVehicle) -> Outcome:
    driven = vehicle.driven
    late = driven.start.request.trigger_s > (vehicle.num_steps - 1) * vehicle.motion.step_s
    reason = driven.reason or Reason.SCENE_ENDED
    return Outcome(driven.policy, "not_triggered" if late else "not_feasible", reason)


def _lane_change(vehicle: ExportedVehicle) -> Outcome:
    driven = vehicle.driven
    if not driven.shifts:
        return _missed(vehicle)
    start, crossing, end = _times_since_decision(vehicle)
    done = end is not None
    return Outcome(
        driven.policy, "done" if done else "aborted", None if done else Reason.SCENE_ENDED, start_s=start,
        crossing_s=crossing, end_s=end, source_lane=driven.shifts[0].source_lane,
        target_lane=driven.shifts[0].target_lane,
    )  # fmt: skip


def _overtake(scene: Scene, vehicle: ExportedVehicle, traffic: Traffic) -> Outcome:
    """Done where the vehicle is back in its lane ahead of the leader, by the exported motion of both."""
    driven = vehicle.driven
    if not driven.shifts:
        return _missed(vehicle)
    enter = driven.shifts[0]
    start, crossing, entered = _times_since_decision(vehicle)
    _, back_s, end = shift_times(vehicle, 1) if len(driven.shifts) > 1 else (None, None, None)
    leader_id = driven.leader_id if driven.leader_id in traffic.ids else None
    reason: Reason | None = None
    detail: str | None = None
    if leader_id is None:
        reason = Reason.LEADER_NOT_KEPT
    elif entered is None:
        reason = Reason.SCENE_ENDED_ENTERING
    elif len(driven.shifts) == 1 and driven.stage is Stage.PASS and driven.reason is Reason.NOT_AHEAD:
        reason = Reason.NOT_PASSED
    elif len(driven.shifts) == 1:
        reason, detail = Reason.PASSED_WITHOUT_RETURN, driven.reason or Reason.SCENE_ENDED
    elif end is None or back_s is None:
        reason = Reason.SCENE_ENDED_RETURNING
    elif not returns_to(driven.start.path, driven.path):
        reason = Reason.RETURNED_ELSEWHERE
    elif not _is_ahead(vehicle, round(back_s / scene.step_s), leader_id, traffic):
        reason = Reason.RETURNED_BEHIND
    done = reason is None
    if done and leader_id is not None and _stands(leader_id, traffic, scene.config.overtake.parked_mps):
        reason = Reason.OBSTACLE_AVOIDANCE
    return Outcome(
        driven.policy, "done" if done else "aborted", reason, detail, start_s=start, crossing_s=crossing,
        end_s=end if done else None, source_lane=enter.source_lane, target_lane=enter.target_lane, leader_id=leader_id,
    )  # fmt: skip


def _is_ahead(vehicle: ExportedVehicle, step: int, leader_id: str, traffic: Traffic) -> bool:
    """Whether the whole box is ahead of the leader's at a step, along the own heading; or was when it was last there.

    A leader that left the lane path on which it was followed has not been overtaken.
    """
    row = traffic.ids.index(leader_id)
    there = np.flatnonzero(traffic.present[row, : step + 1])
    if there.size == 0:
        return False
    seen = int(there[-1])
    if not is_on_lane(vehicle.driven.start.path, traffic.position[row, seen]):
        return False
    offset = vehicle.trajectory.position[seen] - traffic.position[row, seen]
    heading = float(vehicle.trajectory.heading[seen])
    along = float(offset[0] * math.cos(heading) + offset[1] * math.sin(heading))
    return along > 0.5 * (vehicle.driven.start.size.length_m + float(traffic.length_m[row]))


def _stands(track_id: str, traffic: Traffic, parked_mps: float) -> bool:
    row = traffic.ids.index(track_id)
    speed = np.hypot(*traffic.velocity[row, traffic.present[row]].T)
    return bool(np.all(speed < parked_mps))


def _times_since_decision(vehicle: ExportedVehicle) -> tuple[float | None, float | None, float | None]:
    """Times of the first lateral motion of a vehicle that is there from step 0 on.

    It starts with its decision at the earliest: differences of positions and the smoothing show it a step before.
    """
    start, crossing, end = shift_times(vehicle, 0)
    decided_s = _time(vehicle.driven.shifts[0].requested_step, vehicle.motion.step_s)
    return None if start is None or decided_s is None else max(start, decided_s), crossing, end


def shift_times(vehicle: ExportedVehicle, index: int) -> tuple[float | None, float | None, float | None]:
    """Start, crossing and end of a lateral motion, s: where |d'| passes 0.1 m/s, and half way between the lanes."""
    start_m, end_m = vehicle.driven.path.shifts[index]
    s, step_s = vehicle.motion.s, vehicle.motion.step_s
    share = lateral_share((s - start_m) / max(end_m - start_m, 1e-9))
    lateral_mps = np.abs(np.gradient(share * 3.5, step_s))
    moving = np.flatnonzero(lateral_mps > LATERAL_SPEED_MPS)
    start = _time(int(moving[0]), step_s) if moving.size else None
    finished = float(share[-1]) > 0.98
    end = _time(min(int(moving[-1]) + 1, s.size - 1), step_s) if finished and moving.size else None
    return start, _time(_step(s, 0.5 * (start_m + end_m)), step_s), end


def _step(s: FloatArray, place: float) -> int | None:
    """First step at which s(t) has passed a place; None where it never does."""
    passed = np.flatnonzero(s >= place)
    return int(passed[0]) if passed.size else None


def _time(step: int | None, step_s: float) -> float | None:
    return None if step is None else round(step * step_s, 6)
