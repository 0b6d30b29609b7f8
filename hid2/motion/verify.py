"""The last word on a smoothed trajectory: limits of motion, the drivable area, and boxes against boxes."""

import math
from typing import Protocol

import numpy as np
import shapely

from hid2.agents import BoxSize, FloatArray
from hid2.kernels.trajectory import derivatives_of_motion, first_overlapping
from hid2.measures.arrays import BoolArray
from hid2.measures.motion_limits import MOTION_LIMITS, MotionProfile, exceeded
from hid2.motion.smoothing import Trajectory
from hid2.params import Limits
from hid2.reasons import Reason
from netconvert.geometry import box_corners, differences

_OUTLINE_STEP_M = 0.6  # no tunable: between two points a side leaves the road by less than what the tolerance spares


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
    return MotionProfile(*derivatives_of_motion(np.ascontiguousarray(velocity), np.ascontiguousarray(heading), step_s))


def limit_exceeded(trajectory: Trajectory, limits: Limits, *, step_s: float) -> Reason | None:
    """The first limit that some step exceeds, from the exported velocity and from the positions alone."""
    derived = differences(trajectory.position, step_s)
    for velocity in (trajectory.velocity, derived):
        profile = motion_profile(velocity, trajectory.heading, step_s=step_s)
        beyond = exceeded(profile, limits)
        for limit in MOTION_LIMITS:
            if beyond[limit.name].any():
                return limit.reason
    return None


def off_road_steps(
    position: FloatArray, heading: FloatArray, size: BoxSize, drivable: shapely.Geometry, *, tolerance_m: float
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """(T,) some point of the box's outline is farther than tolerance_m outside the drivable area (prepared geometry).

    Corners, and points along the sides: where the road's edge has a corner, a side reaches farther out than its ends.
    position (T, 2) m; heading (T,) rad.
    """
    corners = box_corners(position, heading, length_m=size.length_m, width_m=size.width_m)
    off = ~shapely.contains(drivable, shapely.polygons(corners))
    if off.any():
        off[off] = _is_outline_off(corners[off], drivable, tolerance_m)
    return np.asarray(off)


def _is_outline_off(
    corners: FloatArray, drivable: shapely.Geometry, tolerance_m: float
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """(M,) of boxes with corners (M, 4, 2) m: whether a point along their sides is too far outside."""
    sides = np.linalg.norm(corners[0] - np.roll(corners[0], -1, axis=0), axis=1)
    outline = np.concatenate(
        [
            corners[:, [row]] + _shares(side_m) * (corners[:, [(row + 1) % 4]] - corners[:, [row]])
            for row, side_m in enumerate(sides.tolist())
        ],
        axis=1,
    )
    points = outline.reshape(-1, 2)
    outside = ~shapely.contains_xy(drivable, points[:, 0], points[:, 1])
    if outside.any():
        outside[outside] = shapely.distance(drivable, shapely.points(points[outside])) > tolerance_m
    return np.asarray(outside.reshape(outline.shape[:2]).any(axis=1))


def _shares(side_m: float) -> FloatArray:
    """(P, 1) of a side: from its corner to before the next."""
    points = math.ceil(side_m / _OUTLINE_STEP_M)
    return np.asarray((np.arange(points) / points)[:, None])


def first_overlap(
    trajectory: Trajectory, size: BoxSize, traffic: OtherBoxes, *, margin_m: float
) -> tuple[int, int] | None:
    """(agent row, step) of the first box that the trajectory's box meets, at the steps and halfway between them.

    margin_m is added to each side of the own box. None: nobody is met.
    """
    agent, step = first_overlapping(
        trajectory.position, trajectory.heading, size.length_m + 2 * margin_m, size.width_m + 2 * margin_m,
        traffic.position, traffic.heading, traffic.present, traffic.length_m, traffic.width_m,
    )  # fmt: skip
    return None if agent < 0 else (int(agent), int(step))
