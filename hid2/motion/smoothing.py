"""Frenet smoothing: p = r(s(t)) + d(t) n with s(t) piecewise cubic between the steps (paper, Trajectory Smoothing).

The filter takes out what SUMO's steps put in, not the driver: a Gaussian over the speed, which bounds the jerk. d(t) is
the driver's place in the lane; that of a lane change is part of the path already.
"""

import math
from dataclasses import dataclass

import numpy as np

from hid2.agents import REAR_AXLE_SHARE, FloatArray
from hid2.drivers.driver import LaneOffset
from hid2.kernels.trajectory import trailing
from hid2.motion.reference_line import TABLE_STEP_M, ReferenceLine
from netconvert.geometry import wrap_angle

_TRUNCATED_AT = 3.0  # reach of the filter, standard deviations; no tunable: 0.3 % of its weight is beyond
#: Largest acceleration at the first and last step over the jerk limit, fifths of a step, and its growth over the jerk
#: limit from step to step, steps: derived, not tuned. Positions differentiated three times, one-sided at the ends, give
#: there a jerk of a quarter of the acceleration for each step, plus .8 times the jerk.
_EDGE_FIFTHS, _EDGE_GROWTH = 7.0, 0.7
_STANDS_M = 1e-6  # way of a step below which a box does not turn by rolling; no tunable: none at all


@dataclass(frozen=True, eq=False, slots=True)
class Motion:
    """s (T,) m, v (T,) m/s, a (T,) m/s2 at every step, step_s apart: knots of cubics."""

    s: FloatArray
    v: FloatArray
    a: FloatArray
    step_s: float


@dataclass(frozen=True, eq=False, slots=True)
class Trajectory:
    """A smoothed vehicle, tau_i of the paper: position (T, 2) m, heading (T,) rad, velocity (T, 2) m/s, from step 0."""

    position: FloatArray
    heading: FloatArray
    velocity: FloatArray


def smooth_motion(
    s_driven: FloatArray, *, filter_s: float, step_s: float, end_jerk_mps3: float | None = None
) -> Motion:
    """s(t) nearest to a driven one (T,) m with a speed that has passed a Gaussian of standard deviation filter_s.

    end_jerk_mps3: bound on the jerk that differences of positions show at both ends; None: the ends are left as driven.
    The way of a step is the mean of those of two cubics s(t), by position, speed and acceleration (of differences of
    speed, as in the paper) at one of its ends and the speed at the other.
    """
    v_driven = np.gradient(s_driven, step_s, edge_order=2)
    reach = math.ceil(_TRUNCATED_AT * filter_s / step_s)
    before = 2.0 * v_driven[0] - v_driven[reach:0:-1]
    after = 2.0 * v_driven[-1] - v_driven[-2 : -reach - 2 : -1]
    longer = np.maximum(np.concatenate([before, v_driven, after]), 0.0)
    v = np.maximum(_gaussian_filter(longer, filter_s / step_s)[before.size :], 0.0)
    v = v[: v_driven.size]
    if end_jerk_mps3 is not None:
        v = _with_eased_ends(v, end_jerk_mps3, step_s)
    a = np.gradient(v, step_s)
    moved = 0.5 * step_s * (v[1:] + v[:-1]) - step_s * step_s / 12.0 * np.diff(a)
    s = np.concatenate([[0.0], np.cumsum(np.maximum(moved, 0.0))])
    drift = float(np.mean(s_driven - s_driven[0] - s))
    return Motion(s=s_driven[0] + s + np.clip(drift, -0.2, 0.2), v=v, a=a, step_s=step_s)


def _with_eased_ends(v: FloatArray, jerk_mps3: float, step_s: float) -> FloatArray:
    """Speed (T,) with an acceleration that is small at both ends, where one-sided differences show jerk."""
    a, step = np.gradient(v, step_s), np.arange(v.size)
    bound = jerk_mps3 * (_EDGE_FIFTHS * step_s / 5.0 + _EDGE_GROWTH * step_s * np.minimum(step, step[::-1]))
    change = np.clip(a, -bound, bound) - a
    gained = np.concatenate([[0.0], np.cumsum(0.5 * step_s * (change[1:] + change[:-1]))])
    return np.asarray(np.maximum(v + gained - gained[v.size // 2], 0.0), dtype=np.float64)


def trajectory(line: ReferenceLine, motion: Motion, offset: LaneOffset, length_m: float) -> Trajectory:
    """Pose p = r(s) + d(s) n(s) of a box so long at every step; velocity its time derivative, heading as `_rolling`."""
    centre, tangent, pace = line.motion(motion.s)
    d, slope = offset.at(motion.s)
    at = motion.s / TABLE_STEP_M
    curvature = np.interp(at, np.arange(line.table_curvature.size), line.table_curvature)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    along = 1.0 - curvature * d
    direction, position = along[:, None] * tangent + slope[:, None] * normal, centre + d[:, None] * normal
    return Trajectory(
        position=position,
        heading=_rolling(np.unwrap(np.arctan2(direction[:, 1], direction[:, 0])), position, REAR_AXLE_SHARE * length_m),
        velocity=direction * (motion.v * pace)[:, None],
    )


def _rolling(course: FloatArray, position: FloatArray, axle_m: float) -> FloatArray:
    """Headings (T,) rad of a box with a rear axle, axle_m behind its middle, that rolls and does not slide.

    It trails the course (T,) rad of the middle, within the length of the box by axle_m times the curvature, as boxes of
    recorded vehicles do; at first as if the curve had begun before.
    """
    moved_m = np.maximum(np.hypot(*np.diff(position, axis=0).T), _STANDS_M)
    turned, kept = np.diff(course), np.exp(-moved_m / axle_m)
    settles = axle_m / moved_m * turned
    trails = trailing(float(settles[:1].sum()), kept, (1.0 - kept) * settles)
    return np.asarray(wrap_angle(course - trails), dtype=np.float64)


def _gaussian_filter(values: FloatArray, deviation: float) -> FloatArray:
    """(T,) convolved with a Gaussian of a standard deviation in steps, mirrored at the ends.

    As scipy.ndimage.gaussian_filter1d, but its import takes longer than all of a scene's smoothing.
    """
    reach = int(_TRUNCATED_AT * deviation + 0.5)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / deviation) ** 2)
    return np.convolve(np.pad(values, reach, mode="symmetric"), weights / weights.sum(), mode="valid")
