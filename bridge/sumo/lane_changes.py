"""Algorithm 1 for a vehicle at a step: what it observes, the decision, what SUMO is asked for and what came of it."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from bridge.sumo.fleet import Fleet
from bridge.sumo.routes import edges_along
from bridge.sumo.simulation import Simulation
from hid2.agents import Policy
from hid2.conflicts.guard import ACROSS_S
from hid2.insertion.due import Across, Due, advance, foreseen_speeds
from hid2.motion.lane_change_path import lateral_share
from hid2.motion.route import shifted_path
from hid2.occupancy.traffic import Traffic
from hid2.policy.lane_change import SumoAnswer
from hid2.policy.overtake import Stage
from hid2.reasons import Reason

_OFF_SHARE = 0.03  # no tunable: a tenth of a metre of a lane's width, before a way across is laid anew


@dataclass(frozen=True, eq=False, slots=True)
class Attempt:
    """A lane change that SUMO has been asked for at a step.

    row: of the fleet; look: of the vehicle's gaps; lane: SUMO's name of the lane beside.
    """

    row: int
    look: int
    across: Across
    lane: str


def apply_policy(
    fleet: Fleet, simulation: Simulation, row: int, now: int, traffic: Callable[[], Traffic], on_lane: Policy
) -> Attempt | None:
    """Algorithm 1 for one vehicle that may change lanes; returns the change that SUMO is asked for, None for none.

    traffic: the fleet as it is now (one step); only a vehicle with a manoeuvre due asks for it. on_lane: what
    Algorithm 1 comes to on its lane without one.
    """
    vehicle = fleet.vehicles[row]
    due = advance(vehicle, fleet.scene, now)
    if vehicle.stage in (Stage.ENTER, Stage.RETURN):
        _keep_time(fleet, row, now)
    if not due:  # nothing to be asked: it keeps to its lane, as `decide` says
        vehicle.policies[on_lane] += 1
        return None
    fleet_now = traffic()
    others = fleet_now.rows([other for other, one in enumerate(fleet_now.ids) if one != vehicle.vehicle_id])
    scene, asked = fleet.scene, Due(fleet.scene, vehicle, now, fleet.fixed, others)
    answer = simulation.lane_change_answer
    asks = scene.config.lane_change.rule == "LC2013"
    across = asked.decided((lambda side: SumoAnswer(*answer(vehicle.vehicle_id, side))) if asks else None)
    if across is None:
        return None
    attempt = _asked(fleet, simulation, row, now, across)
    if isinstance(attempt, Reason):
        asked.refuse(attempt)
        return None
    return attempt


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
    foreseen = driven.foreseen(foreseen_speeds(vehicle, fleet.scene, now), step_s)
    path = shifted_path(foreseen, limits=fleet.scene.config.limits)
    if path is not None:
        fleet.take_path(row, path)


def _asked(fleet: Fleet, simulation: Simulation, row: int, now: int, across: Across) -> Attempt | Reason:
    """Look along the way across (conflict case 3), and ask SUMO; or the reason not to."""
    scene, vehicle = fleet.scene, fleet.vehicles[row]
    if "collision" not in scene.config.without and scene.config.lane_change.safety != "rule":
        meets = fleet.braking(
            row, across.path, now, state=(vehicle.s[-1], vehicle.v[-1], 0.0),
            desired_mps=float(vehicle.start.desired[now]), horizon_s=ACROSS_S,
        )  # fmt: skip
        if meets.forbids(vehicle.start.driver):  # ordinary braking does not solve it
            return Reason.CONFLICT_PREDICTED
    cell = scene.grid.cell_of_sumo_lane.get(simulation.lane(vehicle.vehicle_id)[0])
    if cell is None:
        return Reason.OFF_ITS_LANE
    link = scene.grid.lateral(cell, across.shift.side)
    if link is None:
        return Reason.NO_ADJACENT_LANE
    edges = edges_along(scene, across.target, link.target)
    if edges is None:
        return Reason.TARGET_NOT_BESIDE_FRONT
    simulation.change_lane(vehicle.vehicle_id, scene.grid.lane_index(link.target), edges=edges)
    return Attempt(row, len(vehicle.gaps) - 1, across, scene.grid.sumo_lane_id(link.target))


def conclude(fleet: Fleet, simulation: Simulation, attempt: Attempt, lane: str) -> None:
    """Take the new path if SUMO did change lanes; else its refusal is the answer, and the route is restored.

    lane: on which SUMO has the vehicle now.
    """
    vehicle, scene = fleet.vehicles[attempt.row], fleet.scene
    cell = scene.grid.cell_of_sumo_lane.get(lane)
    beside = {segment.lane_id for segment in attempt.across.target.segments}
    own = {segment.lane_id for segment in vehicle.path.segments if segment.end > vehicle.s[-1]}
    changed = lane == attempt.lane or (cell is not None and cell.lane_id in beside - own)
    vehicle.gaps[attempt.look] = replace(vehicle.gaps[attempt.look], sumo=changed)
    if changed:
        attempt.across.taken_by(vehicle)
        fleet.take_path(attempt.row, attempt.across.path)
        return
    vehicle.reason = Reason.SUMO_REFUSES
    edges = edges_along(scene, vehicle.path, cell) if cell is not None else None
    if edges:
        simulation.set_route(vehicle.vehicle_id, edges)
