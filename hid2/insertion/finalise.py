"""From driven to exported: smooth, and the last word on what is exported at all."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hid2.agents import FloatArray, IntArray, Track
from hid2.measures.scene_end import BoxesAtStep, first_contact
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.motion.smoothing import Motion, Trajectory, smooth_motion, trajectory
from hid2.motion.verify import first_overlap, limit_exceeded, off_road_steps
from hid2.occupancy.along_path import PathOccupancy, look_along
from hid2.occupancy.traffic import Traffic
from hid2.reasons import Reason
from hid2.scene import Scene
from hid2.vehicle import DrivenVehicle
from netconvert.geometry import arc_length

_AFTER_END_M = 120.0  # no tunable, spares time: nobody closes in from farther away within `conflict.end_horizon_s`
#: Cosine of the largest angle between a lane and who drives along it, 60 degrees. No tunable: smoothed lines are within
#: a few degrees of their lanes, and where a damaged map turns back on itself they are against them.
_WITH_LANE = 0.5


@dataclass(frozen=True, eq=False, slots=True)
class ExportedVehicle:
    """A vehicle as it is exported: T_i steps from its first on. simulated_off_m (T_i,): exported s(t) minus SUMO's."""

    driven: DrivenVehicle
    motion: Motion
    trajectory: Trajectory
    simulated_off_m: FloatArray
    min_ttc_s: float

    @property
    def num_steps(self) -> int:
        """T_i."""
        return int(self.motion.s.size)

    @property
    def span(self) -> slice:
        """Its steps among those of the scene."""
        return _span(self.driven, self.num_steps)

    def track(self, track_id: str, category: int) -> Track:
        """As it is written."""
        start, path = self.driven.start, self.trajectory
        return Track(
            track_id, start.object_type, category, np.arange(self.span.start, self.span.stop, dtype=np.int64),
            path.position, path.heading, path.velocity, start.size,
        )  # fmt: skip


def _span(vehicle: DrivenVehicle, count: int) -> slice:
    """The first `count` steps of a vehicle among those of the scene."""
    return slice(vehicle.start.step, vehicle.start.step + count)


def traffic_of_exported(vehicles: Sequence[ExportedVehicle], scene: Scene) -> Traffic:
    """Clearance boxes of exported vehicles, and beyond the scene's last step at constant velocity, (A, T + E)."""
    count, steps = len(vehicles), scene.num_steps
    position, heading = np.zeros((count, steps, 2)), np.zeros((count, steps))
    velocity, present = np.zeros((count, steps, 2)), np.zeros((count, steps), dtype=np.bool_)
    for row, vehicle in enumerate(vehicles):
        span = vehicle.span
        position[row, span], heading[row, span] = vehicle.trajectory.position, vehicle.trajectory.heading
        velocity[row, span], present[row, span] = vehicle.trajectory.velocity, True
    inside = Traffic(
        ids=tuple(vehicle.driven.vehicle_id for vehicle in vehicles), position=position, heading=heading,
        velocity=velocity, present=present,
        length_m=np.array([vehicle.driven.start.box.length_m for vehicle in vehicles]),
        width_m=np.array([vehicle.driven.start.box.width_m for vehicle in vehicles]),
    )  # fmt: skip
    return inside.extended(scene.future.num_steps - steps, step_s=scene.step_s)


def finalise(scene: Scene, vehicle: DrivenVehicle, others: Traffic) -> ExportedVehicle | Reason:
    """Smooth a driven vehicle and check it against everything recorded and `others`; or why it is not exported."""
    if vehicle.objection is not None:
        return vehicle.objection
    start, config = vehicle.start, scene.config
    s, v = np.array(vehicle.s), np.array(vehicle.v)
    missing = scene.num_steps - start.step - s.size
    if "topology" in config.without and missing > 0:  # off the grid it goes on as it was
        s = np.concatenate([s, s[-1] + v[-1] * scene.step_s * np.arange(1, missing + 1)])
        v = np.concatenate([v, np.full(missing, v[-1])])
    end = vehicle.path.exit_s - start.size.length_m / 2
    steps = int((s <= end).sum())
    if steps < scene.steps_to_stay(start.step):
        return Reason.LEAVES_TOO_EARLY
    if s[steps - 1] - s[0] < config.export.moves_m and "collision" not in config.without:
        return Reason.STANDS_THROUGHOUT
    if "smoothing" in config.without:
        return _grid_path(scene, vehicle, s[:steps], v[:steps], others)
    verdict: ExportedVehicle | Reason = Reason.LIMIT_JERK
    ratios = config.export.filter_ratios
    for ratio, eased in [(ratios[0], False), *((ratio, True) for ratio in ratios)]:  # ends are eased where they must be
        motion = smooth_motion(
            s[:steps], v[:steps], filter_s=ratio * config.smoothing.filter_s, step_s=scene.step_s,
            end_jerk_mps3=config.limits.longitudinal_jerk_mps3 if eased else None,
        )  # fmt: skip
        for share in config.export.offset_shares:
            path = trajectory(vehicle.path.line, motion, start.offset.scaled(share))
            verdict = _checked(scene, vehicle, motion, path, motion.s - s[:steps], others)
            if isinstance(verdict, ExportedVehicle) or verdict not in _LATERAL:
                break
        if isinstance(verdict, ExportedVehicle) or verdict not in _STEEP:
            break
    return verdict


#: Verdicts that another place in the lane, or a wider filter, may change.
_LATERAL = frozenset({
    Reason.OFF_ROAD, Reason.MEETS_RECORDED, Reason.MEETS_GENERATED, Reason.LIMIT_JERK, Reason.LIMIT_YAW_ACCEL,
    Reason.LIMIT_YAW_RATE,
})  # fmt: skip
_STEEP = frozenset({
    Reason.LIMIT_ACCEL, Reason.LIMIT_DECEL, Reason.LIMIT_LONGITUDINAL_JERK, Reason.LIMIT_JERK, Reason.LIMIT_YAW_ACCEL,
})  # fmt: skip


def _checked(
    scene: Scene, vehicle: DrivenVehicle, motion: Motion, path: Trajectory, off_m: FloatArray, others: Traffic
) -> ExportedVehicle | Reason:
    """Limits of motion, drivable area, boxes, the end of the scene; cheap ones first."""
    config, export = scene.config, scene.config.export
    start = vehicle.start
    cells = slice(int(motion.s[0] / TABLE_STEP_M), int(motion.s[-1] / TABLE_STEP_M) + 2)
    if np.abs(vehicle.path.line.table_curvature[cells]).max() > export.limit_share / config.limits.min_radius_m:
        return Reason.LIMIT_CURVATURE
    if _against_its_lanes(vehicle, motion.s):
        return Reason.AGAINST_LANE
    exceeded = limit_exceeded(path, config.limits, step_s=scene.step_s)
    if exceeded is not None:
        return exceeded
    ttc_s = np.inf
    if "collision" not in config.without:
        tolerance = export.drivable_share * config.limits.drivable_tolerance_m
        drivable = scene.grid.graph.drivable
        if (
            "topology" not in config.without
            and off_road_steps(path.position, path.heading, start.size, drivable, tolerance_m=tolerance).any()
        ):
            return Reason.OFF_ROAD
        for traffic, reason in ((scene.traffic, Reason.MEETS_RECORDED), (others, Reason.MEETS_GENERATED)):
            there = traffic.since(start.step)
            if traffic.ids and first_overlap(path, start.box, there, margin_m=export.box_margin_m) is not None:
                return reason
        everybody = scene.future.joined(others)
        _, seen = _seen_from(scene, vehicle, motion, path, everybody)
        ttc_s = float(_leader_ttcs(scene, vehicle, motion, seen).min(initial=np.inf))  # inf: never closing in
        if ttc_s < config.conflict.ttc_min_s:
            return Reason.TTC_LANE_LEADER
        if _meets_after_end(scene, vehicle, path, others) or not _avoids_after_end(scene, vehicle, motion, seen):
            return Reason.TTC_AT_END
        if "topology" not in config.without:
            verdict = scene.recorded.conflict_with(
                ExportedVehicle(vehicle, motion, path, off_m, ttc_s).track("own", 1),
                ttc_s=config.conflict.follower_ttc_min_s,
                pet_s=config.conflict.pet_min_s,
            )
            if verdict is not None:
                return verdict
    return ExportedVehicle(vehicle, motion, path, off_m, ttc_s)


def _against_its_lanes(vehicle: DrivenVehicle, s: FloatArray) -> bool:
    """Whether the smoothed line runs against the lanes below it: those of a damaged map turn back on themselves."""
    path = vehicle.path
    raw_s = arc_length(path.raw)
    along = np.interp(s, path.line.points_s, path.raw_s)
    piece = np.clip(np.searchsorted(raw_s, along, side="right") - 1, 0, len(path.raw) - 2)
    forward = path.raw[piece + 1] - path.raw[piece]
    share = (forward * path.line.tangent(s)).sum(axis=1)
    return bool(np.any(share < _WITH_LANE * np.hypot(forward[:, 0], forward[:, 1])))


def _seen_from(
    scene: Scene, vehicle: DrivenVehicle, motion: Motion, path: Trajectory, traffic: Traffic
) -> tuple[IntArray, PathOccupancy]:
    """Rows and intervals of others on a vehicle's path, with the lateral margin, from where it drives in its lane.

    Beyond its last step it is as far aside as it was then.
    """
    line, box, span = vehicle.path.line, vehicle.start.box, _span(vehicle, motion.s.size)
    aside = np.zeros((traffic.num_steps, 2))
    aside[span] = path.position - line.position(motion.s)
    aside[span.stop :] = aside[span.stop - 1]
    width_m = box.width_m + 2 * scene.config.conflict.margin_lateral_m
    return look_along(line, replace(traffic, position=traffic.position - aside), box.length_m, width_m)


def _leader_ttcs(scene: Scene, vehicle: DrivenVehicle, motion: Motion, seen: PathOccupancy) -> FloatArray:
    """(A,) smallest TTC, s, to each of those seen on the vehicle's path while they move ahead with it; else inf."""
    span, export = _span(vehicle, motion.s.size), scene.config.export
    gap = seen.low[:, span] - motion.s
    closing = motion.v - seen.along[:, span]
    ahead = np.isfinite(gap) & (gap > -export.touching_m) & (seen.along[:, span] >= -export.rolls_back_mps)
    leads = ahead & seen.same_direction[:, span] & (closing > 1e-3)
    ttc_s = np.full(gap.shape, np.inf)
    ttc_s[leads] = gap[leads] / closing[leads]
    return np.asarray(ttc_s.min(axis=1, initial=np.inf))


def _meets_after_end(scene: Scene, vehicle: DrivenVehicle, path: Trajectory, others: Traffic) -> bool:
    """Whether everybody at the velocity stated for its own last step meets it within the critical time."""
    conflict, last = scene.config.conflict, _span(vehicle, path.s.size).stop - 1
    recorded = replace(scene.traffic.at(last), velocity=scene.stated_velocity[:, last : last + 1])
    everybody = recorded.joined(others.at(last)) if others.ids else recorded
    here = np.flatnonzero(everybody.present[:, 0])
    here = here[np.hypot(*(everybody.position[here, 0] - path.position[-1]).T) < _AFTER_END_M]
    size = np.column_stack([everybody.length_m[here], everybody.width_m[here]])
    boxes = BoxesAtStep(
        position=np.concatenate([path.position[-1:], everybody.position[here, 0]]),
        heading=np.concatenate([path.heading[-1:], everybody.heading[here, 0]]),
        velocity=np.concatenate([path.velocity[-1:], everybody.velocity[here, 0]]),
        size=np.concatenate([np.array([[vehicle.start.box.length_m, vehicle.start.box.width_m]]), size]),
    )
    contact = first_contact(0, boxes, horizon_s=conflict.end_horizon_s)
    return contact is not None and contact.ttc_s < conflict.end_ttc_min_s + scene.config.export.end_spare_s


def _avoids_after_end(scene: Scene, vehicle: DrivenVehicle, motion: Motion, seen: PathOccupancy) -> bool:
    """Whether a vehicle that is there at the last step can go on along its path without contact.

    Everybody else at constant velocity, itself at its speed or braking, at most as its driver does (evaluation.md).
    Who comes from behind brakes too: TTC says whether there is time for it.
    """
    last, steps = scene.num_steps, scene.steps_in(scene.config.conflict.end_horizon_s)
    if _span(vehicle, motion.s.size).stop < last:  # its last step is the map's edge
        return True
    time_s = scene.step_s * np.arange(1, steps + 1)
    follows = seen.same_direction[:, last - 1] & (seen.low[:, last - 1] < motion.s[-1])
    low, high = seen.low[~follows, last : last + steps], seen.high[~follows, last : last + steps]
    for share in scene.config.export.end_braking_shares:
        decel = share * vehicle.start.driver.decel_mps2
        moving_s = np.minimum(time_s, motion.v[-1] / max(decel, 1e-9))
        s = motion.s[-1] + motion.v[-1] * moving_s - 0.5 * decel * moving_s**2
        if not np.any((low < s) & (s < high)):
            return True
    return False


def _grid_path(
    scene: Scene, vehicle: DrivenVehicle, s: FloatArray, v: FloatArray, others: Traffic
) -> ExportedVehicle | Reason:
    """Without smoothing the paper exports the grid path: piecewise linear from cell centre to cell centre."""
    knots: list[float] = []
    for segment in vehicle.path.segments:
        if segment.end < s[0] - 10.0 or segment.start > s[-1] + 10.0:
            continue
        borders = scene.grid.edges_s(segment.lane_id)
        middles = 0.5 * (borders[1:] + borders[:-1])
        inside = middles[(middles >= segment.lane_start) & (middles <= segment.lane_end)]
        share = (inside - segment.lane_start) / max(segment.lane_end - segment.lane_start, 1e-9)
        knots += (segment.start + share * (segment.end - segment.start)).tolist()
    if len(knots) < 2:
        return Reason.NO_SITE
    at = np.array(knots)
    centre = vehicle.path.line.position(at)
    place = np.clip(np.searchsorted(at, s, side="right") - 1, 0, at.size - 2)
    chord = centre[place + 1] - centre[place]
    share = ((s - at[place]) / (at[place + 1] - at[place]))[:, None]
    forward = chord / np.hypot(chord[:, 0], chord[:, 1])[:, None]
    path = Trajectory(
        position=centre[place] + share * chord,
        heading=np.arctan2(forward[:, 1], forward[:, 0]),
        velocity=forward * v[:, None],
        s=s,
    )
    if "collision" not in scene.config.without:
        for traffic, reason in ((scene.traffic, Reason.MEETS_RECORDED), (others, Reason.MEETS_GENERATED)):
            there = traffic.since(vehicle.start.step)
            if traffic.ids and first_overlap(path, vehicle.start.box, there, margin_m=0.0) is not None:
                return reason
    motion = Motion(s=s, v=v, a=np.gradient(v, scene.step_s), step_s=scene.step_s)
    return ExportedVehicle(vehicle, motion, path, np.zeros(s.size), float("inf"))


def conflicting(scene: Scene, exported: Sequence[ExportedVehicle]) -> list[tuple[int, Reason]]:
    """Rows of exported vehicles that, as whoever reads the positions sees them, come too near to somebody together.

    TTC to the leader on the lane path, and PET; of two generated ones the later row.
    """
    config = scene.config
    if not exported or {"collision", "topology"} & config.without:
        return []
    tracks = [vehicle.track(f"gen_{row}", 1) for row, vehicle in enumerate(exported)]
    positions = scene.recorded.with_generated(tracks)
    leaving = [bool(vehicle.driven.shifts) for vehicle in exported]
    found: dict[int, Reason] = {}
    for row, leader in positions.following_conflicts(leaving, critical_s=config.conflict.ttc_min_s):
        found[max(row, -1 if leader is None else leader)] = Reason.TTC_LANE_LEADER
    for row, leader in _closing_in(scene, exported):
        found.setdefault(max(row, leader), Reason.TTC_LANE_LEADER)
    for row, _ in positions.crossing_conflicts(critical_s=config.conflict.pet_min_s):
        found.setdefault(row, Reason.PET)
    return sorted(found.items())


def _closing_in(scene: Scene, exported: Sequence[ExportedVehicle]) -> list[tuple[int, int]]:
    """(follower, leader) rows of exported vehicles with a critical TTC on the path that the follower really drives.

    One that was kept before another one was driven ahead of it does not react to that one.
    """
    everybody = traffic_of_exported(exported, scene)
    found = []
    for row, vehicle in enumerate(exported):
        others = [other for other in range(len(exported)) if other != row]
        rows, seen = _seen_from(scene, vehicle.driven, vehicle.motion, vehicle.trajectory, everybody.rows(others))
        near = _leader_ttcs(scene, vehicle.driven, vehicle.motion, seen) < scene.config.conflict.ttc_min_s
        found += [(row, others[leader]) for leader in rows[near].tolist()]
    return found
