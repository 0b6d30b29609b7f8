"""The last word on a smoothed trajectory: limits of motion, the drivable area, and boxes against boxes."""

from typing import Protocol

import numpy as np
import shapely
from numba import njit

from hid2.agents import BoxSize, FloatArray
from hid2.kernels.boxes import overlap
from hid2.measures.arrays import BoolArray
from hid2.measures.motion_limits import MotionProfile, exceeded
from hid2.motion.smoothing import Trajectory
from hid2.params import Limits
from netconvert.geometry import box_corners, differences, slopes


class OtherBoxes(Protocol):
    """What the last check reads of others, as `occupancy.traffic.Traffic` has it: A agents at T steps."""

    @property
    def position(self) -> FloatArray:
        """(A, T, 2) m, box centres."""

    @property
    def heading(self) -> FloatArray:
        """(A, T) rad."""

    @property
    def present(self) -> BoolArray:
        """(A, T)."""

    @property
    def length_m(self) -> FloatArray:
        """(A,)."""

    @property
    def width_m(self) -> FloatArray:
        """(A,)."""


def motion_profile(velocity: FloatArray, heading: FloatArray, *, step_s: float) -> MotionProfile:
    """Derivatives of velocity (T, 2) and heading (T,) by central differences, split along the heading."""
    return MotionProfile(*_profile(np.ascontiguousarray(velocity), np.ascontiguousarray(heading), step_s))


@njit(cache=True)
def _profile(velocity, heading, step):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """In the order of `MotionProfile`: short arrays, for which a compiled loop takes a tenth of the time of numpy's."""
    count = heading.size
    cosine, sine = np.cos(heading), np.sin(heading)
    unwrapped = heading.copy()
    for t in range(1, count):
        unwrapped[t] = unwrapped[t - 1] + _turn(heading[t] - heading[t - 1])
    accel_x, accel_y = slopes(velocity[:, 0], step), slopes(velocity[:, 1], step)
    jerk_x, jerk_y = slopes(accel_x, step), slopes(accel_y, step)
    along = accel_x * cosine + accel_y * sine
    rate = slopes(unwrapped, step)
    return (
        np.hypot(velocity[:, 0], velocity[:, 1]),
        along,
        accel_y * cosine - accel_x * sine,
        slopes(along, step),
        np.hypot(jerk_x, jerk_y),
        rate,
        slopes(rate, step),
    )


def limit_exceeded(trajectory: Trajectory, limits: Limits, *, step_s: float) -> str | None:
    """Name of the first limit that some step exceeds, from the exported velocity and from the positions alone."""
    derived = differences(trajectory.position, step_s)
    for velocity in (trajectory.velocity, derived):
        profile = motion_profile(velocity, trajectory.heading, step_s=step_s)
        for name, steps in exceeded(profile, limits).items():
            if steps.any():
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
    trajectory: Trajectory, size: BoxSize, traffic: OtherBoxes, *, margin_m: float
) -> tuple[int, int] | None:
    """(agent row, step) of the first box that the trajectory's box meets, at the steps and halfway between them.

    margin_m is added to each side of the own box. None: nobody is met.
    """
    agent, step = _first_overlap(
        trajectory.position, trajectory.heading, size.length_m + 2 * margin_m, size.width_m + 2 * margin_m,
        traffic.position, traffic.heading, traffic.present, traffic.length_m, traffic.width_m,
    )  # fmt: skip
    return None if agent < 0 else (int(agent), int(step))


@njit(cache=True)
def _first_overlap(xy, heading, length, width, position, other, present, lengths, widths):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    steps = min(xy.shape[0], present.shape[1])
    own_radius = np.hypot(length, width) / 2
    for a in range(present.shape[0]):
        reach = own_radius + np.hypot(lengths[a], widths[a]) / 2
        for t in range(steps):
            if not present[a, t]:
                continue
            for half in range(2):
                x, y, angle = xy[t, 0], xy[t, 1], heading[t]
                ox, oy, o_angle = position[a, t, 0], position[a, t, 1], other[a, t]
                if half == 1:
                    if t + 1 >= steps or not present[a, t + 1]:
                        continue
                    x, y = (x + xy[t + 1, 0]) / 2, (y + xy[t + 1, 1]) / 2
                    angle += _turn(heading[t + 1] - angle) / 2
                    ox, oy = (ox + position[a, t + 1, 0]) / 2, (oy + position[a, t + 1, 1]) / 2
                    o_angle += _turn(other[a, t + 1] - o_angle) / 2
                if np.hypot(ox - x, oy - y) > reach:
                    continue
                if overlap(
                    x, y, np.cos(angle), np.sin(angle), length / 2, width / 2,
                    ox, oy, np.cos(o_angle), np.sin(o_angle), lengths[a] / 2, widths[a] / 2,
                ):  # fmt: skip
                    return a, t
    return -1, -1


@njit(cache=True)
def _turn(angle: float) -> float:
    """The short way round."""
    return (angle + np.pi) % (2 * np.pi) - np.pi
