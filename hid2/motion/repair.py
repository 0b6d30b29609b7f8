"""From driven traces to exported motion: smoothing, the last word, and re-timing of what does not hold.

Vehicles are settled one after the other, leaders before followers; each one settled is an obstacle to the next.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hid2.agents import FloatArray
from hid2.conflicts.cases import DT_S, Prospect, min_leader_ttc_s, priority
from hid2.kernels.compiled import planner_kernel
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.motion.route import DrivenPath, first_turn
from hid2.motion.smoothing import Motion, SpeedBounds, SpeedLimits, Trajectory, poses, smooth_speed
from hid2.motion.verify import first_overlap, limit_exceeded, off_road_steps
from hid2.occupancy.along_path import path_occupancy
from hid2.occupancy.traffic import Traffic
from hid2.policy.turns import TURN_OF_POLICY
from hid2.scene import PlannedVehicle, World, predicted_traffic
from netconvert.geometry import Polyline

#: Share of the limits that the smoothing aims at: differences of sampled positions see a little more than the cubics.
_AIM = 0.9
_BOX_MARGIN_M = 0.05
_UNSEEN_SHARE = 0.04
_NEAR_M = 2.0  # beyond the gap at which a TTC is critical: boxes at an angle, and curves
_ALIGNED = 0.7  # of its speed, at least, a leader makes along the follower's path
_SPEEDING_MPS = 0.2
_STANDING_MPS, _EDGE_M = 0.5, 5.0  # nobody waits there for the step from which it may leave the map
#: Shares of the cruising speed that are tried in turn.
_CAPS = (1.0, 1.0, 0.85, 0.65)
_AROUND_M = 30.0  # between centres, within which one may have to give way


@dataclass(frozen=True, eq=False, slots=True)
class DrivenVehicle:
    """What SUMO made of a planned vehicle: s (T,) m and v (T,) m/s on the path that it ended up with."""

    spec: PlannedVehicle
    path: DrivenPath
    s: FloatArray
    v: FloatArray


@dataclass(frozen=True, eq=False, slots=True)
class SettledVehicle:
    """A vehicle as it is exported: trajectory of steps 0 .. T_i - 1. retimed: profiles tried beyond the driven one."""

    driven: DrivenVehicle
    motion: Motion
    trajectory: Trajectory
    retimed: int
    min_ttc_s: float

    @property
    def num_steps(self) -> int:
        """T_i."""
        return int(self.motion.s.size)


def settle(
    world: World, driven: Sequence[DrivenVehicle], earlier: Sequence[SettledVehicle], fixed: Traffic
) -> tuple[list[SettledVehicle], list[tuple[PlannedVehicle, str]]]:
    """Smooth and check every driven vehicle; those that cannot be made safe come back with the reason.

    earlier: vehicles settled in rounds before, the agents of `fixed`. Who is settled first has its way: where that
    leaves some without, they and those around them are settled once more, they first, and the better of the two holds.
    """
    settled, failed = _settle_in_order(world, _leaders_first(driven), earlier, fixed)
    if not failed:
        return settled, failed
    without = {spec.vehicle_id for spec, _ in failed}
    first = [vehicle for vehicle in driven if vehicle.spec.vehicle_id in without]
    near = _ever_near(world, first, settled)
    kept = [vehicle for vehicle, is_near in zip(settled, near, strict=True) if not is_near]
    around = [vehicle.driven for vehicle, is_near in zip(settled, near, strict=True) if is_near]
    anew, still_failed = _settle_in_order(
        world, [*first, *around], [*earlier, *kept], fixed.joined(settled_traffic(kept, world.num_steps))
    )
    return ([*kept, *anew], still_failed) if len(still_failed) < len(failed) else (settled, failed)


def settle_as_planned(world: World, vehicle: SettledVehicle, others: Sequence[SettledVehicle]) -> SettledVehicle | None:
    """A vehicle on the motion that was planned for it among others, not the one that SUMO drove; None if not safe.

    Who comes up behind was looked at when it was planned, and SUMO may have been a little slower.
    """
    driven, spec = vehicle.driven, vehicle.driven.spec
    if driven.path.shifts:
        return None
    planned = replace(driven, s=spec.plan_s, v=spec.plan_v)
    found = _settle_one(world, planned, settled_traffic(others, world.num_steps), others)
    return None if isinstance(found, str) else replace(found, driven=driven, retimed=found.retimed + 1)


def _settle_in_order(
    world: World, order: Sequence[DrivenVehicle], earlier: Sequence[SettledVehicle], fixed: Traffic
) -> tuple[list[SettledVehicle], list[tuple[PlannedVehicle, str]]]:
    settled: list[SettledVehicle] = []
    failed: list[tuple[PlannedVehicle, str]] = []
    others = fixed
    for vehicle in order:
        result = _settle_one(world, vehicle, others, [*earlier, *settled])
        if isinstance(result, str):
            failed.append((vehicle.spec, result))
            continue
        settled.append(result)
        others = others.joined(settled_traffic([result], world.num_steps))
    return settled, failed


def _ever_near(world: World, driven: Sequence[DrivenVehicle], settled: Sequence[SettledVehicle]) -> list[bool]:
    """Which settled vehicles are ever near where others were driven."""
    rows = [(v.spec.vehicle_id, v.path, v.spec.size, v.s) for v in driven]
    theirs = predicted_traffic(rows, world.num_steps)
    ours = settled_traffic(settled, world.num_steps)
    together = theirs.present[:, None] & ours.present[None]
    apart_m = np.hypot(*np.moveaxis(theirs.position[:, None] - ours.position[None], -1, 0))
    return np.any(together & (apart_m < _AROUND_M), axis=(0, 2)).tolist()  # type: ignore[no-any-return]


def settled_traffic(vehicles: Sequence[SettledVehicle], num_steps: int) -> Traffic:
    """Boxes of settled vehicles."""
    rows = [(v.driven.spec.vehicle_id, v.driven.path, v.driven.spec.size, v.motion.s) for v in vehicles]
    return predicted_traffic(rows, num_steps)


def _leaders_first(driven: Sequence[DrivenVehicle]) -> list[DrivenVehicle]:
    """Executing before pending, then who has fewer of the others ahead of it (conflict case 2), then the lower id."""
    start = np.array([v.path.line.position(v.s[:1])[0] for v in driven]).reshape(-1, 2)
    ahead = []
    for row, vehicle in enumerate(driven):
        heading = vehicle.path.line.heading(vehicle.s[:1])[0]
        offset = start - start[row]
        along = offset[:, 0] * np.cos(heading) + offset[:, 1] * np.sin(heading)
        across = np.abs(-offset[:, 0] * np.sin(heading) + offset[:, 1] * np.cos(heading))
        ahead.append(float(((along > 0.5) & (along < 40.0) & (across < 2.5)).sum()))
    order = sorted(
        range(len(driven)),
        key=lambda row: priority(
            executing=bool(driven[row].path.shifts) or driven[row].spec.policy in TURN_OF_POLICY,
            distance_m=ahead[row],
            vehicle_id=driven[row].spec.vehicle_id,
        ),
    )
    return [driven[row] for row in order]


def _settle_one(
    world: World, vehicle: DrivenVehicle, others: Traffic, known: Sequence[SettledVehicle]
) -> SettledVehicle | str:
    config = world.config
    spec = vehicle.spec
    if "smoothing" in config.without:
        return _unsmoothed(world, vehicle, others)
    unchecked = "collision" in config.without
    look = world.prospect(vehicle.path, spec.size, cruise_mps=spec.cruise_mps, others=() if unchecked else (others,))
    if vehicle.path.shifts and not unchecked:
        # a manoeuvre does not begin before its trigger; the first part of the shift is no more than millimetres wide
        start, end = vehicle.path.shifts[0]
        look = look.held_back(int(np.ceil(spec.trigger_s / DT_S)), start + _UNSEEN_SHARE * (end - start))
    limits = SpeedLimits(
        accel_min=_AIM * config.limits.accel_min_mps2,
        accel_max=_AIM * config.limits.accel_max_mps2,
        jerk=0.8 * config.limits.longitudinal_jerk_mps3,
    )
    reason = "no_safe_timing"
    aim = _aim(world, vehicle)
    for attempt, cap in enumerate(_CAPS):
        reference, speed = (vehicle.s, vehicle.v) if attempt == 0 else (aim, vehicle.v)
        if cap < 1.0:
            slower = np.minimum(look.desired, np.maximum(cap * spec.cruise_mps, 0.0))
            slower[: int(spec.s0 / 0.5) + 1] = np.maximum(slower[: int(spec.s0 / 0.5) + 1], spec.v0)
            look = _with_desired(look, slower)
        if not unchecked and (attempt > 0 or aim is not reference or look.is_blocked(reference, 0)):
            plan = look.plan(
                s0=spec.s0, v0=spec.v0, a0=0.0, first_step=0, config=config, reference=aim if cap == 1.0 else None
            )
            if plan is None:
                continue
            reference, speed = plan.s, plan.v
        result = _smooth_and_check(world, vehicle, look, reference, speed, limits, others, unchecked=unchecked)
        if isinstance(result, str):
            reason = result
            continue
        candidate = SettledVehicle(vehicle, result[0], result[1], attempt, result[2])
        if not unchecked and not vehicle.path.shifts and _closes_in_straight_on(world, candidate, others):
            reason = "ttc_at_split"
            continue
        if unchecked or "topology" in config.without or not _presses_anybody(world, candidate, known):
            return candidate
        reason = "ttc_of_follower"
    return reason


def _closes_in_straight_on(world: World, candidate: SettledVehicle, others: Traffic) -> bool:
    """Whether the candidate, at a split when its track ends, would be closing in on somebody on the other branch.

    Nobody who sees the track alone can tell that it was about to turn off: its leader is who is straight ahead.
    """
    graph, path, spec = world.grid.graph, candidate.driven.path, candidate.driven.spec
    last = path.segment_at(float(candidate.motion.s[-1]))
    lanes = [segment.lane_id for segment in path.segments if segment.start <= last.start]
    ahead = graph.straightest_successor(lanes[-1])
    if ahead is None or (len(lanes) < len(path.segments) and path.segments[len(lanes)].lane_id == ahead):
        return False
    branch = world.path((*lanes, ahead))
    on_lane = candidate.motion.s >= last.start
    traffic = others.joined(world.traffic)
    found = path_occupancy(
        branch.line, traffic, length_m=spec.size.length_m, width_m=spec.size.width_m, margin_lateral_m=0.0
    )
    speed = np.where(on_lane, candidate.motion.v, -np.inf)
    return min_leader_ttc_s(found, candidate.motion.s, speed) < world.config.conflict.ttc_min_s


def _presses_anybody(world: World, candidate: SettledVehicle, known: Sequence[SettledVehicle]) -> bool:
    """Whether a settled vehicle would have the candidate as a leader at less than the critical TTC on its own path."""
    conflict = world.config.conflict
    box: Traffic | None = None
    for follower in known:
        spec = follower.driven.spec
        if not _comes_near(
            follower.trajectory.position, candidate.trajectory.position, follower.motion.v, candidate.motion.v,
            (spec.size.length_m + candidate.driven.spec.size.length_m) / 2, conflict.ttc_min_s,
        ):  # fmt: skip
            continue
        box = settled_traffic([candidate], world.num_steps) if box is None else box
        found = path_occupancy(
            follower.driven.path.line, box, length_m=spec.size.length_m, width_m=spec.size.width_m,
            margin_lateral_m=conflict.margin_lateral_m,
        )  # fmt: skip
        if min_leader_ttc_s(found, follower.motion.s, follower.motion.v) < conflict.ttc_min_s:
            return True
    return False


@planner_kernel
def _comes_near(xy, leader_xy, v, leader_v, boxes, ttc):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Whether two are ever so near that one may close in on the other at a critical TTC, wherever they head."""
    for t in range(min(v.size, leader_v.size)):
        between = np.hypot(xy[t, 0] - leader_xy[t, 0], xy[t, 1] - leader_xy[t, 1]) - boxes
        if between < max(ttc * (v[t] - _ALIGNED * leader_v[t]), 0.0) + _NEAR_M:
            return True
    return False


def _aim(world: World, vehicle: DrivenVehicle) -> FloatArray:
    """s(t) to stay near: the driven one, or where that misses the turn that was planned, the planned one."""
    spec = vehicle.spec
    if spec.policy not in TURN_OF_POLICY:
        return vehicle.s
    turn = first_turn(world.grid.graph, spec.path, TURN_OF_POLICY[spec.policy], after=spec.s0)
    return vehicle.s if turn is None or vehicle.s[-1] > turn.end + 0.5 else spec.plan_s


def _smooth_and_check(
    world: World, vehicle: DrivenVehicle, look: Prospect, reference: FloatArray, speed: FloatArray,
    limits: SpeedLimits, others: Traffic, *, unchecked: bool,
) -> tuple[Motion, Trajectory, float] | str:  # fmt: skip
    config, spec = world.config, vehicle.spec
    motion: Motion | None = None
    target, target_v = reference, speed
    for _ in range(2):  # the speed cap is by place, the programme by time: once more from where it came out
        bounds = look.speed_bounds_only(target) if unchecked else look.bounds(target)
        if bounds is None:
            return "no_safe_timing"
        motion = smooth_speed(
            target, target_v, _eased(bounds, spec.v0), limits, a0=0.0, step_s=DT_S,
            jerk_weight=config.smoothing.jerk_weight,
        )  # fmt: skip
        if motion is None:
            return "no_smooth_timing"
        cells = np.clip((motion.s / TABLE_STEP_M + 0.5).astype(np.int64), 0, look.desired.size - 1)
        if np.all(motion.v <= np.maximum(look.desired[cells], bounds.fastest) + _SPEEDING_MPS):
            break
        target, target_v = motion.s, motion.v
    if motion is None:
        return "no_smooth_timing"
    end = vehicle.path.exit_s - spec.size.length_m / 2
    steps = int((motion.s <= end).sum())
    if steps < min(world.earliest_exit_step, world.num_steps):
        return "leaves_too_early"
    motion = Motion(s=motion.s[:steps], v=motion.v[:steps], a=motion.a[:steps])
    if np.any((motion.v < _STANDING_MPS) & (motion.s > end - _EDGE_M)):
        return "stops_at_map_edge"
    trajectory = poses(vehicle.path.line, motion)
    cells = np.arange(int(motion.s[0] / TABLE_STEP_M), int(motion.s[-1] / TABLE_STEP_M) + 2)
    if np.abs(vehicle.path.line.table_curvature[cells]).max() > world.curvature_most:
        return "limit_curvature"
    exceeded = limit_exceeded(trajectory, config.limits, step_s=DT_S)
    if exceeded is not None:
        return f"limit_{exceeded}"
    ttc = np.inf
    if not unchecked:
        checked = trajectory
        if "topology" in config.without:  # off the grid there are no cells to look conflicts up in
            checked = trajectory.first(int((motion.s <= vehicle.path.grid_end_s).sum()))
        if first_overlap(checked, spec.size, world.traffic, margin_m=_BOX_MARGIN_M) is not None:
            return "meets_recorded"
        if first_overlap(checked, spec.size, others, margin_m=_BOX_MARGIN_M) is not None:
            return "meets_generated"
        on_grid = checked.s.size
        ttc = look.min_ttc_s(motion.s[:on_grid], motion.v[:on_grid])
        if min(ttc, look.min_follower_ttc_s(motion.s[:on_grid], motion.v[:on_grid])) < config.conflict.ttc_min_s:
            return "ttc"
    if "topology" not in config.without:
        off = off_road_steps(
            trajectory.position, trajectory.heading, spec.size, world.grid.graph.drivable,
            tolerance_m=world.road_tolerance_m,
        )  # fmt: skip
        if off.any():
            return "off_road"
    return motion, trajectory, ttc


def _eased(bounds: SpeedBounds, v0: float) -> SpeedBounds:
    """Bounds whose speed cap can be reached from v0 by braking gently: a start above it is given, not chosen."""
    slowing = v0 - 1.0 * DT_S * np.arange(bounds.fastest.size)
    return replace(bounds, fastest=np.maximum(bounds.fastest, slowing))


def _with_desired(look: Prospect, desired: FloatArray) -> Prospect:
    return replace(look, desired=desired)


def _unsmoothed(world: World, vehicle: DrivenVehicle, others: Traffic) -> SettledVehicle | str:
    """Ablation without smoothing: the grid's polyline, straight from point to point, at SUMO's own speeds."""
    path, spec = vehicle.path, vehicle.spec
    end = path.exit_s - spec.size.length_m / 2
    steps = int((vehicle.s <= end).sum())
    if steps < world.earliest_exit_step:
        return "leaves_too_early"
    s, v = vehicle.s[:steps], vehicle.v[:steps]
    motion = Motion(s=s, v=v, a=np.gradient(v, DT_S))
    raw = Polyline(path.raw)
    at = np.array([path.to_raw(float(value)) for value in s])
    at = np.minimum(at, raw.length_m)
    heading = raw.heading(at)
    direction = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    trajectory = Trajectory(position=raw.point(at), heading=heading, velocity=direction * v[:, None], s=s)
    if "collision" not in world.config.without:
        for met, traffic in (("meets_recorded", world.traffic), ("meets_generated", others)):
            if first_overlap(trajectory, spec.size, traffic, margin_m=_BOX_MARGIN_M) is not None:
                return met
    return SettledVehicle(vehicle, motion, trajectory, 0, float("inf"))
