"""Algorithm 1 for a vehicle at a step: what it observes, what it decides, and its path across; live and in rollouts."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from hid2.agents import FloatArray, Policy
from hid2.drivers.driver import free_speeds
from hid2.motion.route import DrivenPath
from hid2.occupancy.traffic import Traffic
from hid2.policy.decision import Observation, decide, is_due
from hid2.policy.lane_change import OPEN, Gap, LaneOption, SumoAnswer
from hid2.policy.observation import (
    Foreseen,
    Inserted,
    gap_to_passed,
    gaps_on,
    lane_options,
    lay_across,
    leader_on,
    returns_to,
)
from hid2.policy.overtake import SHIFT_RATIO, Stage
from hid2.reasons import Reason
from hid2.scene import Scene
from hid2.vehicle import DrivenVehicle, GapLook, Shift
from netconvert.lane_graph import Side

#: Answer of SUMO's own lane-change model for a side; that model decides with `lane_change.rule = LC2013` alone.
AskSumo = Callable[[Side], SumoAnswer]


@dataclass(frozen=True, eq=False, slots=True)
class Across:
    """A lane change that is decided. path: the way across.

    shift, stage: what becomes of the vehicle if it is carried out; overtaken_id: what it then overtakes.
    """

    path: DrivenPath
    shift: Shift
    stage: Stage
    overtaken_id: str | None

    def taken_by(self, vehicle: DrivenVehicle) -> None:
        """The vehicle changes lanes."""
        vehicle.shifts.append(self.shift)
        vehicle.stage, vehicle.reason, vehicle.overtaken_id = self.stage, None, self.overtaken_id


def advance(vehicle: DrivenVehicle, scene: Scene, now: int) -> bool:
    """Take a manoeuvre on to its next stage by where the vehicle is; whether Algorithm 1 is to be asked now."""
    time_s, trigger_s = now * scene.step_s, vehicle.start.request.trigger_s
    if vehicle.stage in (Stage.ENTER, Stage.RETURN) and vehicle.s[-1] >= vehicle.path.lateral_spans[-1].end:
        passing = vehicle.stage is Stage.ENTER and vehicle.policy is Policy.OVERTAKE
        vehicle.stage = Stage.PASS if passing else Stage.DONE
    waits_s = max(scene.config.lane_change.give_up_s, scene.step_s)  # one look at least
    if vehicle.stage is Stage.WAITING and time_s > trigger_s + waits_s + 1e-9:  # sums of steps
        vehicle.stage = Stage.ABORTED
        if vehicle.reason is Reason.NO_ADJACENT_LANE and vehicle.gaps:  # the last refusal of a lane says more
            vehicle.reason = vehicle.gaps[-1].rule or vehicle.gaps[-1].guard or Reason.SUMO_REFUSES
    return is_due(vehicle.stage, time_s, trigger_s)


def foreseen_speeds(vehicle: DrivenVehicle, scene: Scene, now: int) -> FloatArray:
    """(M,) m/s of a vehicle at the steps to come: up to its desired speed on a free road."""
    free = free_speeds(vehicle.start.driver, vehicle.start.desired[now:], speed_mps=vehicle.v[-1], step_s=scene.step_s)
    return np.maximum(free, scene.config.lane_change.min_speed_mps)


@dataclass(frozen=True, eq=False, slots=True)
class ManoeuvreDue:
    """A vehicle at a step for which a manoeuvre is due.

    inserted_known: vehicles with known motion (T steps); others: those driven with it, as they are now (one step).
    """

    scene: Scene
    vehicle: DrivenVehicle
    now: int
    inserted_known: Traffic
    others: Traffic

    @property
    def _inserted(self) -> Inserted:
        return Inserted(self.now, self.inserted_known, self.others)

    def observe_and_decide(self, ask_sumo: AskSumo | None = None) -> Across | None:
        """Algorithm 1; the way across where the decision is a lane change. Each look at a gap is recorded."""
        vehicle, config = self.vehicle, self.scene.config
        options = self._options(ask_sumo)
        leader = self._leader() if options else None
        seen = self._observation(tuple(option for option, _ in options.values()), leader)
        decision = decide(seen, lane_change=config.lane_change, overtake=config.overtake)
        vehicle.policies[vehicle.policy if vehicle.stage is Stage.PASS else decision.policy] += 1
        for (option, _), answer in zip(options.values(), decision.answers, strict=False):  # those not looked at: none
            vehicle.gaps.append(GapLook(self.now, option, vehicle.v[-1], answer))
        if decision.side is None:
            vehicle.reason = decision.reason
            return None
        option, target = options[decision.side]
        path = self._lay(option, target)
        if isinstance(path, Reason):
            self.refuse(path)
            return None
        source_lane = vehicle.path.segment_at(vehicle.s[-1]).lane_id
        shift = Shift(option.side, source_lane, option.target.lane_id, self.now, target)
        if vehicle.stage is Stage.PASS:
            return Across(path, shift, Stage.RETURN, vehicle.overtaken_id)
        return Across(path, shift, Stage.ENTER, None if leader is None else leader.track_id)

    def refuse(self, reason: Reason) -> None:
        """The rule took the last gap, but there is no safe path into it, for a reason of the path."""
        self.vehicle.reason = reason
        self.vehicle.gaps[-1] = replace(self.vehicle.gaps[-1], guard=reason)

    def _options(self, ask_sumo: AskSumo | None) -> dict[Side, tuple[LaneOption, DrivenPath]]:
        """Adjacent lanes with their paths; with what SUMO's own model makes of them, where that decides."""
        vehicle, start, scene = self.vehicle, self.vehicle.start, self.scene
        sides = start.sides
        if vehicle.stage is Stage.PASS:
            sides = ("right",) if vehicle.shifts[-1].side == "left" else ("left",)
        found = lane_options(
            scene, vehicle.path, start.box, s=vehicle.s[-1], sides=sides, inserted=self._inserted,
            speed_mps=vehicle.v[-1], desired_mps=start.driver.desired_mps,
        )  # fmt: skip
        if ask_sumo is not None:
            found = [(replace(option, sumo=ask_sumo(option.side)), target) for option, target in found]
        return {option.side: (option, target) for option, target in found}

    def _leader(self) -> Gap | None:
        """For an overtake that may begin: the next vehicle ahead, if it may be within d_obs."""
        if self.vehicle.policy is not Policy.OVERTAKE or self.vehicle.stage is Stage.PASS:
            return None
        path, box, s = self.vehicle.path, self.vehicle.start.box, self.vehicle.s[-1]
        return leader_on(path, box, s=s, d_obs_m=self.scene.config.overtake.d_obs_m, here=self._vehicles())

    def passed_gap_m(self) -> float:
        """From the rear bumper to the overtaken vehicle behind, m; -inf unless it is passed."""
        vehicle = self.vehicle
        if vehicle.stage is not Stage.PASS or vehicle.overtaken_id is None:
            return -math.inf
        return gap_to_passed(
            vehicle.path, vehicle.start.box, s=vehicle.s[-1], lane=vehicle.start.path, passed_id=vehicle.overtaken_id,
            here=self._vehicles(),
        )  # fmt: skip

    def _vehicles(self) -> Traffic:
        """Vehicles that can be overtaken, as they are now (one step)."""
        recorded = self.scene.traffic.at(self.now).rows(self.scene.vehicle_rows.tolist())
        return recorded.joined(self.inserted_known.at(self.now), self.others)

    def _observation(self, options: tuple[LaneOption, ...], leader: Gap | None) -> Observation:
        vehicle, start, scene = self.vehicle, self.vehicle.start, self.scene
        cell = scene.cell_at(vehicle.path, vehicle.s[-1])
        own_front, own_rear = OPEN, OPEN
        if scene.config.lane_change.rule not in ("paper", "LC2013"):  # those two read no own gaps
            own_front, own_rear = gaps_on(scene, vehicle.path, start.box, at=vehicle.s[-1], inserted=self._inserted)
        return Observation(
            time_s=self.now * scene.step_s, next_cell=scene.grid.longitudinal(cell),
            lane_turn=scene.grid.graph.lanes[cell.lane_id].turn, speed_mps=vehicle.v[-1],
            driver=start.driver, request=vehicle.policy, trigger_s=start.request.trigger_s,
            stage=vehicle.stage, leader=leader, options=options, passed_gap_m=self.passed_gap_m(),
            length_m=start.box.length_m, own_front=own_front, own_rear=own_rear,
            vehicle_id=vehicle.vehicle_id,
        )  # fmt: skip

    def _lay(self, option: LaneOption, target: DrivenPath) -> DrivenPath | Reason:
        """The path across to a lane beside; or why there is none."""
        vehicle, scene, start = self.vehicle, self.scene, self.vehicle.start
        own = Foreseen(vehicle.path, vehicle.s[-1], self.now, foreseen_speeds(vehicle, scene, self.now))
        ratio, room_m = SHIFT_RATIO if vehicle.policy is Policy.OVERTAKE else 1.0, option.remaining_m
        path = lay_across(scene, own, target, side=option.side, remaining_m=room_m, driver=start.driver, ratio=ratio)
        if isinstance(path, DrivenPath) and vehicle.stage is Stage.PASS and not returns_to(start.path, path):
            return Reason.LANES_PART
        return path
