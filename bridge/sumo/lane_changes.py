"""Algorithm 1 for a vehicle at a step: what it observes, the decision, what SUMO is asked for and what came of it."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from bridge.sumo.fleet import Fleet
from bridge.sumo.routes import edges_along
from bridge.sumo.simulation import Simulation
from hid2.agents import FloatArray, Policy
from hid2.drivers.driver import free_speeds
from hid2.motion.lane_change_path import lateral_share
from hid2.motion.route import DrivenPath
from hid2.occupancy.traffic import Traffic
from hid2.policy.behaviours import BEHAVIOURS
from hid2.policy.decision import LaneOption, Observation, Side, decide
from hid2.policy.observation import gap_ahead_of, lane_options, lay, lay_across, leader_on, own_gaps, returns_to
from hid2.policy.overtake import Leader, Stage
from hid2.policy.rules import SumoAnswer
from hid2.reasons import Reason
from hid2.scene import Scene
from hid2.vehicle import DrivenVehicle, GapLook, Shift

_OFF_SHARE = 0.03  # no tunable: a tenth of a metre of a lane's width, before a way across is laid anew


@dataclass(frozen=True, eq=False, slots=True)
class Attempt:
    """A lane change that SUMO has been asked for at a step.

    row: of the fleet; look: of the vehicle's gaps; path: the way across, target: that of the lane beside; lane: SUMO's
    name of it; shift, stage: the vehicle's, if SUMO does it.
    """

    row: int
    look: int
    path: DrivenPath
    target: DrivenPath
    lane: str
    shift: Shift
    stage: Stage


def apply_policy(
    fleet: Fleet, simulation: Simulation, row: int, now: int, traffic: Callable[[], Traffic], on_lane: Policy
) -> Attempt | None:
    """Algorithm 1 for one vehicle at step `now`; returns the lane change that SUMO is asked for, None for none.

    traffic: the fleet as it is now (one step); only a vehicle with a manoeuvre due asks for it. on_lane: what
    Algorithm 1 comes to on its lane without one.
    """
    vehicle, config = fleet.vehicles[row], fleet.scene.config
    request, shifts = vehicle.start.request, vehicle.path.shifts
    if shifts and vehicle.stage in (Stage.ENTER, Stage.RETURN):
        if vehicle.s[-1] >= shifts[-1][1]:
            passing = vehicle.stage is Stage.ENTER and vehicle.policy is Policy.OVERTAKE
            vehicle.stage = Stage.PASS if passing else Stage.DONE
        else:
            _keep_time(fleet, row, now)
    time_s = now * fleet.scene.step_s
    asks = BEHAVIOURS[vehicle.policy].changes_lanes
    due = asks and time_s >= request.trigger_s and vehicle.stage in (Stage.WAITING, Stage.PASS)
    if due and vehicle.stage is Stage.WAITING and time_s > request.trigger_s + config.lane_change.give_up_s:
        vehicle.stage, due = Stage.ABORTED, False
    if not due:  # nothing to be asked: it keeps to its lane, as `decide` says
        vehicle.policies[on_lane] += 1
        return None
    everybody = traffic()
    others = everybody.rows([other for other, one in enumerate(everybody.ids) if one != vehicle.vehicle_id])
    return _Due(fleet, simulation, row, vehicle, now, others).decided()


def _keep_time(fleet: Fleet, row: int, now: int) -> None:
    """Lay the way across anew where a vehicle is farther, or less far, than its driver would be by now."""
    vehicle, step_s = fleet.vehicles[row], fleet.scene.step_s
    motion = vehicle.path.lateral
    assert motion is not None
    since = len(vehicle.s) - 1 - (now - vehicle.shifts[-1].requested_step)
    tau = np.concatenate([[0.0], np.cumsum(motion.timing.gained(np.array(vehicle.v[since + 1 :]), step_s))])
    share = lateral_share(tau[-1:], motion.timing.ramp)[0]
    if tau[-1] >= 1.0 or abs(share - motion.share_at(vehicle.s[-1])) < _OFF_SHARE:
        return
    driven = replace(motion, along_m=np.array(vehicle.s[since:]), tau=tau)
    path = lay(fleet.scene, driven.foreseen(_foreseen_speeds(vehicle, fleet.scene, now), step_s))
    if path is not None:
        fleet.take_path(row, path)


def _foreseen_speeds(vehicle: DrivenVehicle, scene: Scene, now: int) -> FloatArray:
    """(M,) m/s of a vehicle at the steps to come: as it is held to, else up to its wish on a free road."""
    start = vehicle.start
    wished = start.desired[now:]
    if not start.is_held:
        wished = free_speeds(start.driver, wished, speed_mps=vehicle.v[-1], step_s=scene.step_s)
    return np.maximum(wished, scene.config.lane_change.min_speed_mps)


@dataclass(frozen=True, eq=False, slots=True)
class _Due:
    """A vehicle at a step for which a manoeuvre is due; others: those driven with it, as they are now (one step)."""

    fleet: Fleet
    simulation: Simulation
    row: int
    vehicle: DrivenVehicle
    now: int
    others: Traffic

    def decided(self) -> Attempt | None:
        """Observe, decide, and ask SUMO where the decision is a lane change; each look at a gap is recorded."""
        vehicle, config = self.vehicle, self.fleet.scene.config
        options, leader = self._options(), self._leader()
        seen = self._observation(tuple(option for option, _ in options.values()), leader)
        decision = decide(seen, lane_change=config.lane_change, overtake=config.overtake)
        vehicle.policies[decision.policy] += 1
        for (option, _), answer in zip(options.values(), decision.answers, strict=False):  # those not looked at: none
            vehicle.gaps.append(self._look(option, answer))
        if decision.side is None:
            vehicle.reason = decision.reason
            return None
        attempt = self._attempt(*options[decision.side], leader)
        if isinstance(attempt, Reason):
            vehicle.reason = attempt
            vehicle.gaps[-1] = replace(vehicle.gaps[-1], guard=attempt)
            return None
        return attempt

    def _options(self) -> dict[Side, tuple[LaneOption, DrivenPath]]:
        """Adjacent lanes with their paths; with what SUMO's own model makes of them, where that decides."""
        vehicle, start, scene = self.vehicle, self.vehicle.start, self.fleet.scene
        sides = start.sides
        if vehicle.stage is Stage.PASS:
            sides = ("right",) if vehicle.shifts[-1].side == "left" else ("left",)
        found = lane_options(
            scene, vehicle.path, start.box, s=vehicle.s[-1], step=self.now, sides=sides, fixed=self.fleet.fixed,
            fleet=self.others, speed_mps=vehicle.v[-1], desired_mps=start.driver.desired_mps,
        )  # fmt: skip
        if scene.config.lane_change.rule == "LC2013":
            answer = self.simulation.lane_change_answer
            found = [
                (replace(option, sumo=SumoAnswer(*answer(vehicle.vehicle_id, option.side))), target)
                for option, target in found
            ]
        return {option.side: (option, target) for option, target in found}

    def _leader(self) -> Leader | None:
        """For an overtake the leader within d_obs."""
        if self.vehicle.policy is not Policy.OVERTAKE:
            return None
        d_obs_m = self.fleet.scene.config.overtake.d_obs_m
        path, box, s = self.vehicle.path, self.vehicle.start.box, self.vehicle.s[-1]
        return leader_on(path, box, s=s, d_obs_m=d_obs_m, here=self._vehicles())

    def _passed_gap_m(self) -> float:
        """How far the overtaken vehicle is behind, m; -1 where there is none."""
        vehicle = self.vehicle
        if vehicle.stage is not Stage.PASS or vehicle.leader_id is None:
            return -1.0
        return gap_ahead_of(
            vehicle.path, vehicle.start.box, s=vehicle.s[-1], lane=vehicle.start.path, passed_id=vehicle.leader_id,
            here=self._vehicles(),
        )  # fmt: skip

    def _vehicles(self) -> Traffic:
        """Vehicles that can be overtaken, as they are now (one step)."""
        scene, fixed = self.fleet.scene, self.fleet.fixed
        recorded = scene.traffic.at(self.now).rows(scene.vehicle_rows.tolist())
        return recorded.joined(fixed.at(self.now), self.others) if fixed.ids else recorded.joined(self.others)

    def _observation(self, options: tuple[LaneOption, ...], leader: Leader | None) -> Observation:
        vehicle, start, scene = self.vehicle, self.vehicle.start, self.fleet.scene
        cell = scene.cell_at(vehicle.path, vehicle.s[-1])
        own_front, own_rear = own_gaps(
            scene, vehicle.path, start.box, s=vehicle.s[-1], step=self.now, fixed=self.fleet.fixed, fleet=self.others
        )
        return Observation(
            time_s=self.now * scene.step_s, cell=cell, next_cell=scene.grid.longitudinal(cell),
            lane_turn=scene.grid.graph.lanes[cell.lane_id].turn, speed_mps=vehicle.v[-1],
            desired_mps=start.driver.desired_mps, request=vehicle.policy, trigger_s=start.request.trigger_s,
            stage=vehicle.stage, leader=leader, options=options, passed_gap_m=self._passed_gap_m(),
            length_m=start.box.length_m, driver=start.driver, own_front=own_front, own_rear=own_rear,
        )  # fmt: skip

    def _look(self, option: LaneOption, rule: Reason | None) -> GapLook:
        """What is recorded of one look at a gap."""
        return GapLook(
            step=self.now, side=option.side, target=option.target, front=option.front, rear=option.rear,
            own_mps=self.vehicle.v[-1], remaining_m=option.remaining_m, cells_free=option.cells_free, rule=rule,
        )  # fmt: skip

    def _attempt(self, option: LaneOption, target: DrivenPath, leader: Leader | None) -> Attempt | Reason:
        """Lay the path across, look along it (conflict case 3), and ask SUMO; or the reason not to."""
        vehicle, scene, now, start = self.vehicle, self.fleet.scene, self.now, self.vehicle.start
        s, grid, overtakes = vehicle.s[-1], scene.grid, vehicle.policy is Policy.OVERTAKE
        path = lay_across(
            scene, vehicle.path, target, s=s, step=now, speed_mps=_foreseen_speeds(vehicle, scene, now),
            remaining_m=option.remaining_m, driver=start.driver,
            ratio=scene.config.overtake.shift_ratio if overtakes else 1.0,
        )  # fmt: skip
        if isinstance(path, Reason):
            return path
        if vehicle.stage is Stage.PASS and not returns_to(start.path, path):
            return Reason.LANES_PART
        if "collision" not in scene.config.without and self._meets_on(path):
            return Reason.CONFLICT_PREDICTED
        cell = grid.cell_of_sumo_lane.get(self.simulation.lane(vehicle.vehicle_id)[0])
        if cell is None:
            return Reason.OFF_ITS_LANE
        link = grid.lateral(cell, option.side)
        if link is None:
            return Reason.NO_ADJACENT_LANE
        edges = edges_along(scene, target, link.target)
        if edges is None:
            return Reason.TARGET_NOT_BESIDE_FRONT
        self.simulation.change_lane(vehicle.vehicle_id, grid.lane_index(link.target), edges=edges)
        shift = Shift(
            side=option.side, source_lane=vehicle.path.segment_at(s).lane_id, target_lane=option.target.lane_id,
            requested_step=now, gap_front_m=option.front.distance_m, gap_rear_m=option.rear.distance_m,
        )  # fmt: skip
        stage = Stage.RETURN if vehicle.stage is Stage.PASS else Stage.ENTER
        if leader is not None and stage is Stage.ENTER:
            vehicle.leader_id = leader.track_id
        look = len(vehicle.gaps) - 1
        return Attempt(self.row, look, path, target, grid.sumo_lane_id(link.target), shift, stage)

    def _meets_on(self, path: DrivenPath) -> bool:
        """Whether a path across has a predicted conflict that ordinary braking does not solve."""
        vehicle, start, scene = self.vehicle, self.vehicle.start, self.fleet.scene
        across_s, wished = scene.config.driving.across_s, self.now
        if start.is_held:  # planned among everybody known: it will go as fast as it wishes
            across_s = min(across_s, start.driver.lane_change_s + scene.config.event_search.across_more_s)
            wished = min(self.now + scene.steps_in(across_s), start.desired.size - 1)
        found = self.fleet.braking(
            self.row, path, self.now, state=(vehicle.s[-1], vehicle.v[-1], 0.0),
            desired_mps=float(start.desired[wished]), horizon_s=across_s,
        )  # fmt: skip
        return found.conflict_s is not None or found.run_into or found.decel_mps2 > start.driver.decel_mps2


def conclude(fleet: Fleet, simulation: Simulation, attempt: Attempt, lane: str) -> None:
    """Take the new path if SUMO did change lanes; else its refusal is the answer, and the route is restored.

    lane: on which SUMO has the vehicle now.
    """
    vehicle, scene = fleet.vehicles[attempt.row], fleet.scene
    cell = scene.grid.cell_of_sumo_lane.get(lane)
    beside = {segment.lane_id for segment in attempt.target.segments}
    own = {segment.lane_id for segment in vehicle.path.segments if segment.end > vehicle.s[-1]}
    changed = lane == attempt.lane or (cell is not None and cell.lane_id in beside - own)
    vehicle.gaps[attempt.look] = replace(vehicle.gaps[attempt.look], sumo=changed)
    if changed:
        vehicle.shifts.append(attempt.shift)
        vehicle.stage, vehicle.reason = attempt.stage, None
        fleet.take_path(attempt.row, attempt.path)
        return
    vehicle.reason = Reason.SUMO_REFUSES
    edges = edges_along(scene, vehicle.path, cell) if cell is not None else None
    if edges:
        simulation.set_route(vehicle.vehicle_id, edges)
