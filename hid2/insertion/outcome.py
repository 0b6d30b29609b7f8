"""What became of the manoeuvre that a vehicle was asked for: what the judge sees in its states, else why not."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from hid2.agents import Policy
from hid2.insertion.finalise import ExportedVehicle, together
from hid2.judge.claims import manoeuvres, overtake_of
from hid2.measures.manoeuvres import Maneuver, ManeuverKind
from hid2.motion.route import first_turn
from hid2.occupancy.agent_states import AgentStates
from hid2.occupancy.traffic import Traffic
from hid2.policy.behaviours import BEHAVIOURS, is_shown
from hid2.policy.lane_change import OPEN, Gap
from hid2.policy.observation import Inserted, gaps_on, returns_to
from hid2.policy.overtake import Stage
from hid2.policy.rules import refusal_of_lane
from hid2.reasons import Reason
from hid2.scene import Scene
from hid2.vehicle import Shift
from netconvert.lane_graph import TurnType

_NONE = Traffic.none(1)
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


def outcome_of(scene: Scene, vehicle: ExportedVehicle, kept: Iterable[ExportedVehicle]) -> Outcome | None:
    """Outcome of a vehicle's request beside what is recorded and kept; None for one that goes straight."""
    policy = vehicle.driven.policy
    kind = BEHAVIOURS[policy].turn
    if kind is not None:
        return _turn(scene, vehicle, kind)
    if BEHAVIOURS[policy].sides:
        return _lane_change(vehicle)
    if policy is Policy.OVERTAKE:
        return _overtake(vehicle, together(scene, (one for one in kept if one is not vehicle)))
    return None


def takes_gap(scene: Scene, kept: ExportedVehicle, inserted: Traffic) -> bool:
    """Whether others (A, T + E) are in a gap that a vehicle kept before took, nearer than the rule allows."""
    for shift in kept.driven.shifts:
        step = shift.requested_step
        if not inserted.present[:, step].any():
            continue
        front, rear = (
            one if one.track_id in inserted.ids else OPEN for one in gaps_at_request(scene, kept, shift, inserted)
        )
        driver, speed_mps = kept.driven.start.driver, float(kept.motion.v[step - kept.span.start])
        refused = partial(refusal_of_lane, driver, scene.config.lane_change, speed_mps=speed_mps, side=shift.side)
        if refused(front=front, rear=rear) is not None and refused() is None:
            return True
    return False


def gaps_at_request(scene: Scene, vehicle: ExportedVehicle, shift: Shift, inserted: Traffic) -> tuple[Gap, Gap]:
    """Gaps of an exported vehicle ahead and behind on the lane that it changes to, when it decided to.

    inserted: others (A, T + E), beside recorded agents.
    """
    step = shift.requested_step
    own, target = vehicle.trajectory.position[step - vehicle.span.start], shift.target
    at, _ = target.frenet(own[None])
    return gaps_on(scene, target, vehicle.driven.start.box, at=float(at[0]), inserted=Inserted(step, inserted, _NONE))


def _done(vehicle: ExportedVehicle, seen: Maneuver, **more: object) -> Outcome:
    """A manoeuvre as it is seen, done where the behaviour's predicate holds. It starts with its decision or later."""
    driven = vehicle.driven
    decided_s = driven.shifts[0].requested_step * vehicle.motion.step_s if driven.shifts else 0.0
    found = Outcome(
        driven.policy, "done", start_s=round(max(seen.start_s, decided_s), 6), crossing_s=round(seen.crossing_s, 6),
        end_s=round(seen.end_s, 6), source_lane=seen.source_lane, target_lane=seen.target_lane, **more,  # type: ignore[arg-type]
    )  # fmt: skip
    as_asked = is_shown(driven.policy, vehicle.states, seen)
    return found if as_asked else replace(found, status="aborted", reason=Reason.NOT_AS_ASKED)


def _turn(scene: Scene, vehicle: ExportedVehicle, kind: TurnType) -> Outcome:
    """Done where the lane is driven to its end and the direction turns by 30 degrees."""
    driven, s = vehicle.driven, vehicle.motion.s
    wanted = BEHAVIOURS[driven.policy].seen_as[0]
    seen = next((one for one in manoeuvres(vehicle.states) if one.kind is wanted and one.complete), None)
    turn = first_turn(scene.grid.graph, driven.path, kind, after=driven.start.start_m)
    before = driven.path.segments.index(turn) - 1 if turn is not None else -1
    if seen is not None:
        source = driven.path.segments[before].lane_id if before >= 0 else None
        return replace(_done(vehicle, seen), start_s=round(seen.start_s, 6), crossing_s=None, source_lane=source)
    if turn is None or s[-1] >= turn.end:
        return Outcome(driven.policy, "not_feasible", Reason.TURN_NOT_SEEN)
    if s[-1] < turn.start:
        return Outcome(driven.policy, "not_feasible", Reason.SCENE_ENDED)
    start_s = (driven.start.step + int(np.searchsorted(s, turn.start))) * vehicle.motion.step_s
    return Outcome(driven.policy, "aborted", Reason.SCENE_ENDED, start_s=round(start_s, 6), target_lane=turn.lane_id)


def _missed(vehicle: ExportedVehicle) -> Outcome:
    driven = vehicle.driven
    late = driven.start.request.trigger_s > (driven.start.step + vehicle.num_steps - 1) * vehicle.motion.step_s
    return Outcome(driven.policy, "not_triggered" if late else "not_feasible", driven.reason or Reason.SCENE_ENDED)


def _changes(vehicle: ExportedVehicle) -> list[Maneuver]:
    """Lane changes that are seen since the first one was decided, by the time of their crossing."""
    decided_s = vehicle.driven.shifts[0].requested_step * vehicle.motion.step_s
    found = [one for one in manoeuvres(vehicle.states) if one.kind is ManeuverKind.LANE_CHANGE]
    return sorted((one for one in found if one.crossing_s >= decided_s), key=lambda one: one.crossing_s)


def _lane_change(vehicle: ExportedVehicle) -> Outcome:
    if not vehicle.driven.shifts:
        return _missed(vehicle)
    seen = next(iter(_changes(vehicle)), None)
    if seen is None:
        return _begun(vehicle, Reason.SCENE_ENDED)
    found = _done(vehicle, seen)
    return found if seen.ended else replace(found, status="aborted", reason=Reason.SCENE_ENDED, end_s=None)


def _begun(vehicle: ExportedVehicle, reason: Reason, **more: object) -> Outcome:
    """A manoeuvre that SUMO began and that the states do not show to its end."""
    shift = vehicle.driven.shifts[0]
    start_s = round(shift.requested_step * vehicle.motion.step_s, 6)
    return Outcome(
        vehicle.driven.policy, "aborted", reason, start_s=start_s, source_lane=shift.source_lane,
        target_lane=shift.target_lane, **more,  # type: ignore[arg-type]
    )  # fmt: skip


def _overtake(vehicle: ExportedVehicle, others: AgentStates) -> Outcome:
    """Done where the vehicle is behind its leader, beside it, ahead of it and back, by the states of both."""
    driven = vehicle.driven
    if not driven.shifts:
        return _missed(vehicle)
    ids = others.arrays.track_ids
    leader_id = driven.overtaken_id if driven.overtaken_id in ids else None
    changes, begun = _changes(vehicle), {"leader_id": leader_id}
    if leader_id is None:
        return _begun(vehicle, Reason.LEADER_NOT_KEPT, **begun)
    pair = others.joined(vehicle.states)
    seen = overtake_of(pair, len(ids), ids.index(leader_id))
    if seen is not None and seen[1].complete:
        stood = seen[0].kind is ManeuverKind.OBSTACLE_AVOIDANCE
        found = _done(vehicle, seen[0], **begun)
        return replace(
            found, crossing_s=round(changes[0].crossing_s, 6), reason=Reason.OBSTACLE_AVOIDANCE if stood else None
        )
    reason, detail = Reason.SCENE_ENDED_RETURNING, None
    if not changes or not changes[0].complete:
        reason = Reason.SCENE_ENDED_ENTERING
    elif len(driven.shifts) == 1 and driven.stage is Stage.PASS and driven.reason is Reason.NOT_AHEAD:
        reason = Reason.NOT_PASSED
    elif len(driven.shifts) == 1:
        reason, detail = Reason.PASSED_WITHOUT_RETURN, str(driven.reason or Reason.SCENE_ENDED)
    elif not returns_to(driven.start.path, driven.path):
        reason = Reason.RETURNED_ELSEWHERE
    elif len(changes) > 1 and seen is None:
        reason = Reason.RETURNED_BEHIND
    return _begun(vehicle, reason, detail=detail, **begun)
