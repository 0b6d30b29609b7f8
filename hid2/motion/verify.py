"""The last word on a smoothed trajectory: limits of motion, the drivable area, and boxes against boxes."""

from dataclasses import dataclass

import numpy as np
import shapely

from hid2.agents import BoxSize, FloatArray
from hid2.kernels.trajectory import derivatives_of_motion, first_overlapping
from hid2.motion.smoothing import Trajectory
from hid2.occupancy.traffic import Traffic
from hid2.params import Limits
from netconvert.geometry import box_corners, differences


@dataclass(frozen=True, eq=False, slots=True)
class MotionProfile:
    """What a reader of positions would compute, by differences at the steps, each (T,): the names say the units."""

    speed_mps: FloatArray
    accel_mps2: FloatArray
    lateral_accel_mps2: FloatArray
    longitudinal_jerk_mps3: FloatArray
    jerk_mps3: FloatArray
    yaw_rate_radps: FloatArray
    yaw_accel_radps2: FloatArray


def motion_profile(velocity: FloatArray, heading: FloatArray, *, step_s: float) -> MotionProfile:
    """Derivatives of velocity (T, 2) and heading (T,) by central differences, split along the heading."""
    return MotionProfile(*derivatives_of_motion(np.ascontiguousarray(velocity), np.ascontiguousarray(heading), step_s))


def limit_exceeded(trajectory: Trajectory, limits: Limits, *, step_s: float) -> str | None:
    """Name of the first limit that some step exceeds, from the exported velocity and from the positions alone."""
    derived = differences(trajectory.position, step_s)
    for velocity in (trajectory.velocity, derived):
        profile = motion_profile(velocity, trajectory.heading, step_s=step_s)
        checks = (
            ("accel", profile.accel_mps2.max() > limits.accel_max_mps2),
            ("decel", profile.accel_mps2.min() < limits.accel_min_mps2),
            ("lateral_accel", np.abs(profile.lateral_accel_mps2).max() > limits.lateral_accel_mps2),
            ("longitudinal_jerk", np.abs(profile.longitudinal_jerk_mps3).max() > limits.longitudinal_jerk_mps3),
            ("jerk", profile.jerk_mps3.max() > limits.jerk_mps3),
            ("yaw_rate", np.abs(profile.yaw_rate_radps).max() > limits.yaw_rate_radps),
            ("yaw_accel", np.abs(profile.yaw_accel_radps2).max() > limits.yaw_accel_radps2),
        )
        for name, exceeded in checks:
            if exceeded:
                return name
    return None


def off_road_steps(
    position: FloatArray, heading: FloatArray, size: BoxSize, drivable: shapely.Geometry, *, tolerance_m: float
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """(T,) some corner of the box is farther than tolerance_m outside the drivable area (prepared geometry).

    position (T, 2) m; heading (T,) rad.
    """
    corners = box_corners(position, heading, length_m=size.length_m, width_m=size.width_m).reshape(-1, 2)
    outside = ~shapely.contains_xy(drivable, corners[:, 0], corners[:, 1])
    if outside.any():
        points = shapely.points(corners[outside])
        outside[outside] = shapely.distance(drivable, points) > tolerance_m
    return np.asarray(outside.reshape(-1, 4).any(axis=1))


def first_overlap(
    trajectory: Trajectory, size: BoxSize, traffic: Traffic, *, margin_m: float
) -> tuple[int, int] | None:
    """(agent row, step) of the first box that the trajectory's box meets, at the steps and halfway between them.

    margin_m is added to each side of the own box. None: nobody is met.
    """
    agent, step = first_overlapping(
        trajectory.position, trajectory.heading, size.length_m + 2 * margin_m, size.width_m + 2 * margin_m,
        traffic.position, traffic.heading, traffic.present, traffic.length_m, traffic.width_m,
    )  # fmt: skip
    return None if agent < 0 else (int(agent), int(step))
