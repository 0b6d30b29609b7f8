"""What vehicles are told at a step: limits where SUMO is blind, another way, and Algorithm 1's lane changes."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import groupby
from typing import NamedTuple

import numpy as np

from bridge.sumo.fleet import Fleet
from bridge.sumo.simulation import Simulation
from hid2.agents import FloatArray, IntArray, Policy
from hid2.conflicts.guard import A, S
from hid2.kernels.steering import ACTS_MPS2, CAUSES, LIMIT_TOLERANCE_MPS, speed_limits
from hid2.manoeuvre import Across, ManoeuvreDue, advance, foreseen_speeds
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.motion.route import DrivenPath, shifted_path
from hid2.occupancy.traffic import BoolArray, Traffic
from hid2.policy.lane_change import SumoAnswer
from hid2.policy.overtake import Stage
from hid2.policy.roads import ways_at_next_split
from hid2.reasons import Reason
from hid2.scene import ACROSS_S, Scene
from netconvert.cells import Cell

#: Deceleration of a vehicle that waits for a gap for those beside, m/s2. No tunable: traffic behind does not notice it.
_LET_PASS_MPS2 = 0.7
#: Share of its desired speed to which such a vehicle slows down. No tunable: traffic behind does not notice it.
_LET_PASS_SHARE = 0.8
_GAP = CAUSES.index("gap")
_FASTER_MPS = 0.05  # tolerance of the speed over the road's on another way that is taken; no tunable: rounding
_OFF_SHARE = 0.03  # of the share across, from which the way is laid anew; no tunable: .1 m of a lane


class SpeedLimits(NamedTuple):
    """Of vehicles (M,) at a step, as the kernel `speed_limits` returns them; two functions change them in place."""

    mps: FloatArray
    cause: IntArray
    policy: IntArray
    waits_for: IntArray
    yields: BoolArray
    braking_fails: BoolArray


def limits_of(fleet: Fleet, rows: IntArray, now: int) -> SpeedLimits:
    """The lowest limits on the speeds of rows (M,) of the fleet for the step after `now`.

    The road's, the guard's (predicted conflicts), and those of stop lines. rows: all that are `here`, or the last of
    these, where one before them has taken another way.
    """
    first, inputs = fleet.limit_inputs(now)
    return SpeedLimits(*speed_limits(
        rows, now, fleet.state, fleet.desired_mps, fleet.drivers, fleet.yielding,
        fleet.guard.horizon, fleet.scene.step_s, fleet.guard.brakes, first[-rows.size - 1 :], *inputs,
    ))  # fmt: skip


def let_pass(fleet: Fleet, row: int, now: int, limits: SpeedLimits, place: int) -> None:
    """In place: lower the limit of a vehicle that waits for a gap, so that those beside can go ahead."""
    vehicle, step_s = fleet.vehicles[row], fleet.scene.step_s
    if vehicle.stage is Stage.WAITING and vehicle.reason in (Reason.CELLS_OCCUPIED, Reason.FRONT_GAP):
        desired, v = fleet.desired_mps[row, now], vehicle.v[-1]
        slower = max(_LET_PASS_SHARE * desired, v - _LET_PASS_MPS2 * step_s)
        if slower < desired - LIMIT_TOLERANCE_MPS and (slower, _GAP) < (limits.mps[place], limits.cause[place]):
            limits.mps[place], limits.cause[place] = slower, _GAP


def edges_along(scene: Scene, path: DrivenPath, cell: Cell) -> tuple[str, ...] | None:
    """SUMO edges from a cell on along the lanes of a path; None where the path does not use the cell's lane."""
    lanes = [segment.lane_id for segment in path.segments]
    if cell.lane_id not in lanes:
        return None
    grid, last = scene.grid, len(lanes) - 1 - lanes[::-1].index(cell.lane_id)  # an overtake comes back to its lane
    cells = [Cell(cell.lane_id, index) for index in range(cell.index, grid.count(cell.lane_id))]
    cells += [Cell(lane_id, index) for lane_id in lanes[last + 1 :] for index in range(grid.count(lane_id))]
    return tuple(edge for edge, _ in groupby(map(grid.edge_id, cells)))


def take_another_way(fleet: Fleet, simulation: Simulation, row: int, now: int) -> bool:
    """Send a vehicle another way at the next split if no agent is met there (case 3, reroute); whether it goes there.

    Only one that is to go straight: another way is no longer the turn or the change of lanes that was asked for.
    """
    vehicle, context, scene = fleet.vehicles[row], fleet.contexts[row], fleet.scene
    if vehicle.policy is not Policy.STRAIGHT or context.reroute_tried:
        return False
    context.reroute_tried = True
    s, v, a = fleet.state[row, S : A + 1].tolist()
    cell = scene.grid.cell_of_sumo_lane.get(simulation.lane(vehicle.vehicle_id)[0])
    if cell is None:
        return False
    for path in ways_at_next_split(scene, vehicle.path, s=s, from_m=s + vehicle.start.box.length_m):
        at = path.all_to_line(vehicle.path.all_to_raw(np.array(vehicle.s)))
        road = fleet.roads.speeds(path, vehicle.start.driver)
        if v > road[min(int(at[-1] / TABLE_STEP_M), road.size - 1)] + _FASTER_MPS:
            continue
        found = fleet.braking(row, path, now, (float(at[-1]), v, a))
        edges = edges_along(scene, path, cell)
        if found.conflict_s is None and found.decel_mps2 < ACTS_MPS2 and edges:
            simulation.set_route(vehicle.vehicle_id, edges)
            fleet.take_path(row, path, at)
            vehicle.rerouted_at = now
            return True
    return False


@dataclass(frozen=True, eq=False, slots=True)
class Attempt:
    """A lane change that SUMO has been asked for at a step.

    row: of the fleet; look: index into the vehicle's `gaps`; lane: SUMO's name of the lane beside.
    """

    row: int
    look: int
    across: Across
    lane: str


def apply_policy(
    fleet: Fleet, simulation: Simulation, row: int, now: int, traffic: Callable[[], Traffic], lane_policy: Policy
) -> Attempt | None:
    """Algorithm 1 for one vehicle that may change lanes; returns the change that SUMO is asked for, None for none.

    traffic: the fleet as it is now (one step); only a vehicle with a manoeuvre due asks for it. lane_policy: that
    of the type of its lane, which Algorithm 1 comes to where no manoeuvre is due.
    """
    vehicle = fleet.vehicles[row]
    is_due = advance(vehicle, fleet.scene, now)
    if vehicle.stage in (Stage.ENTER, Stage.RETURN):
        _keep_time(fleet, row, now)
    if not is_due:  # nothing to be asked: it keeps to its lane, as `decide` says
        vehicle.policies[vehicle.policy if vehicle.stage in (Stage.ENTER, Stage.RETURN) else lane_policy] += 1
        return None
    fleet_now = traffic()
    others = fleet_now.rows([other for other, one in enumerate(fleet_now.ids) if one != vehicle.vehicle_id])
    scene, due = fleet.scene, ManoeuvreDue(fleet.scene, vehicle, now, fleet.kept, others)
    answer, asks = simulation.lane_change_answer, scene.config.lane_change.rule == "LC2013"
    across = due.observe_and_decide((lambda side: SumoAnswer(*answer(vehicle.vehicle_id, side))) if asks else None)
    if across is None:
        return None
    attempt = _ask_sumo(fleet, simulation, row, now, across)
    if isinstance(attempt, Reason):
        due.refuse(attempt)
        return None
    return attempt


def _keep_time(fleet: Fleet, row: int, now: int) -> None:
    """Lay the way across anew where the share of it that is driven is off its driver's timing, as the speed changed."""
    vehicle, step_s = fleet.vehicles[row], fleet.scene.step_s
    motion = vehicle.path.lateral
    assert motion is not None
    since = len(vehicle.s) - 1 - (now - vehicle.shifts[-1].requested_step)
    tau = np.concatenate([[0.0], np.cumsum(motion.timing.gained(np.array(vehicle.v[since + 1 :]), step_s))])
    if tau[-1] >= 1.0 or motion.share_off(vehicle.s[-1], tau[-1]) < _OFF_SHARE:
        return
    driven = replace(motion, along_m=np.array(vehicle.s[since:]), tau=tau)
    foreseen = driven.foreseen(foreseen_speeds(vehicle, fleet.scene, now), step_s)
    path = shifted_path(foreseen, limits=fleet.scene.config.limits)
    if path is not None:
        fleet.take_path(row, path)


def _ask_sumo(fleet: Fleet, simulation: Simulation, row: int, now: int, across: Across) -> Attempt | Reason:
    """Look along the way across for predicted conflicts, and ask SUMO for the lane change; or the reason not to."""
    scene, vehicle = fleet.scene, fleet.vehicles[row]
    if "collision" not in scene.config.without and scene.config.lane_change.safety != "rule":
        meets = fleet.braking(row, across.path, now, (vehicle.s[-1], vehicle.v[-1], 0.0), ACROSS_S)
        if meets.forbids(vehicle.start.driver):  # ordinary braking does not solve it
            return Reason.CONFLICT_PREDICTED
    cell = scene.grid.cell_of_sumo_lane.get(simulation.lane(vehicle.vehicle_id)[0])
    if cell is None:
        return Reason.OFF_ITS_LANE
    facing = scene.grid.lateral(cell, across.shift.side)
    if facing is None:
        return Reason.NO_ADJACENT_LANE
    edges = edges_along(scene, across.shift.target, facing)
    if edges is None:
        return Reason.TARGET_NOT_BESIDE_FRONT
    simulation.change_lane(vehicle.vehicle_id, scene.grid.lane_index(facing), edges=edges)
    return Attempt(row, len(vehicle.gaps) - 1, across, scene.grid.sumo_lane_id(facing))


def conclude(fleet: Fleet, simulation: Simulation, attempt: Attempt, lane: str) -> None:
    """Take the new path if SUMO did change lanes; else its refusal is the answer, and the route is restored.

    lane: on which SUMO has the vehicle now.
    """
    vehicle, scene = fleet.vehicles[attempt.row], fleet.scene
    cell = scene.grid.cell_of_sumo_lane.get(lane)
    beside = {segment.lane_id for segment in attempt.across.shift.target.segments}
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
