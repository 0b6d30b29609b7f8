"""How fast a vehicle may drive where SUMO is blind: turns, predicted conflicts, stop lines, gaps to wait for."""

from bridge.sumo.fleet import Fleet
from bridge.sumo.routes import take_another_way
from bridge.sumo.simulation import Simulation
from hid2.agents import Policy
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.policy.overtake import Stage
from hid2.reasons import Reason

#: m/s, and its cause.
Limit = tuple[float, str]

_TURN_AHEAD_S = 4.0  # book-keeping: a limit this long before a turn lane is put down to the turn
#: Refusals of a gap in which waiting for those beside to go ahead helps.
_LETS_PASS = frozenset({Reason.CELLS_OCCUPIED, Reason.FRONT_GAP})


def speed_limit(fleet: Fleet, simulation: Simulation, row: int, now: int, desired_mps: float) -> Limit | None:
    """The lowest limit on a vehicle's speed for the step after `now`; None where it wishes to go no faster anyway."""
    vehicle, way, scene = fleet.vehicles[row], fleet.ways[row], fleet.scene
    driving, (s, v, _) = scene.config.driving, fleet.motion(row)
    on_road = float(way.road[min(int((s + v * scene.step_s) / TABLE_STEP_M), way.road.size - 1)])
    turns = (way.policy_at(s), way.policy_at(s + _TURN_AHEAD_S * v)) != (Policy.STRAIGHT, Policy.STRAIGHT)
    limits = [(on_road, "turn" if turns else "curve")]
    if "collision" not in scene.config.without:
        limits += _guarded(fleet, simulation, row, now, desired_mps)
    if vehicle.stage is Stage.WAITING and vehicle.reason in _LETS_PASS:
        limits.append((max(driving.let_pass_share * desired_mps, v - driving.let_pass_mps2 * scene.step_s), "gap"))
    lowest = min(limits)
    return lowest if lowest[0] < desired_mps - 1e-3 else None


def _guarded(fleet: Fleet, simulation: Simulation, row: int, now: int, desired_mps: float) -> list[Limit]:
    """Limits of the guard: predicted conflicts (case 3, timing) and stop lines; who finds no timing may be rerouted."""
    vehicle, config, step_s = fleet.vehicles[row], fleet.scene.config, fleet.scene.step_s
    driving, driver = config.driving, vehicle.start.driver
    found = fleet.braking(row, vehicle.path, now, state=fleet.motion(row), desired_mps=desired_mps)
    if found.conflict_s is not None or found.decel_mps2 > driver.decel_mps2:
        found = take_another_way(fleet, simulation, row, now, desired_mps) or found
    s, v, a = fleet.motion(row)
    near_m = driving.behind_ratio * (driver.tau_s * v + driver.min_gap_m)
    if found.leader >= 0 and found.leader_gap_m < near_m and a < -driving.slows_mps2:
        vehicle.waited_for.add(fleet.vehicles[found.leader].vehicle_id)
    act = driving.keep_yielding_mps2 if vehicle.yielding else config.conflict.act_mps2
    soon = found.free_conflict_s is not None and found.free_conflict_s <= driving.soon_s
    urgent = vehicle.yielding or soon or found.decel_mps2 >= driving.urgent_ratio * act
    vehicle.yielding = found.decel_mps2 >= act and urgent
    accelerations = [(-found.decel_mps2, "conflict")] if vehicle.yielding else []
    stop = fleet.obstacles(row, vehicle.path).lines.braking(driver, s=s, speed_mps=v, step=now)
    if stop is not None:
        accelerations.append(stop)
    eased = min(a, 0.0) - driving.brake_jerk_mps3 * step_s
    gentle = -max(driving.last_brake_mps2, driving.last_brake_per_s * v)  # nobody stops with a jerk
    return [(v + max(accel, eased, gentle) * step_s, cause) for accel, cause in accelerations]
