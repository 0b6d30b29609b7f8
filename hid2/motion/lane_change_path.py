"""The lateral motion of a lane change: d(t) as four cubics, and its path (paper, Trajectory Smoothing)."""

from dataclasses import dataclass

import numpy as np

from hid2.agents import FloatArray
from hid2.kernels.polyline import frenet
from netconvert.geometry import Polyline, arc_length, resample


def lateral_share(tau: FloatArray) -> FloatArray:
    """d(t) / D over tau = t / T in [0, 1]: cubics with jerk +J, -J, 0, 0, -J, +J, J = 54 D / T^3.

    The lateral speed rises for a third of the time to 1.5 D / T, keeps it for a third, and falls: drivers cross a lane
    at an even pace. Position, speed and acceleration are continuous at the knots 1/6, 1/3, 2/3, 5/6 and zero at both
    ends (paper: d(t) = b0 + b1 t + b2 t2 + b3 t3 from boundary conditions).
    """
    t = np.clip(tau, 0.0, 1.0)
    mirrored = np.where(t > 0.5, 1.0 - t, t)
    u = mirrored - 1.0 / 6.0
    rising = 1.0 / 24.0 + 0.75 * u + 4.5 * u**2 - 9.0 * u**3
    even = 0.25 + 1.5 * (mirrored - 1.0 / 3.0)
    rise = np.where(mirrored < 1.0 / 6.0, 9.0 * mirrored**3, np.where(mirrored < 1.0 / 3.0, rising, even))
    return np.asarray(np.where(t > 0.5, 1.0 - rise, rise))


@dataclass(frozen=True, eq=False, slots=True)
class Blend:
    """A path that leaves one lane path for another.

    points (N, 2) m, evenly spaced before smoothing; start_m, end_m: arc length of the lateral motion on it;
    target_offset_m: arc length on the target minus arc length on the blend, behind its end.
    """

    points: FloatArray
    start_m: float
    end_m: float
    target_offset_m: float


def even_line(points: FloatArray, *, step_m: float) -> tuple[FloatArray, FloatArray]:
    """Points (N, 2) m at equal distances, and their arc lengths (N,) m."""
    source = resample(points, step_m=step_m)
    return source, arc_length(source)


def blend_paths(
    current: tuple[FloatArray, FloatArray], aim: Polyline, *, start_m: float, length_m: float, step_m: float,
    max_shift_m: float,
) -> Blend | None:  # fmt: skip
    """Path that follows `current`, an `even_line`, shifts over length_m from start_m on, and follows `aim` from there.

    None where the two are not side by side all along (farther than max_shift_m apart), or the target ends before. The
    shift is `lateral_share` over the length driven.
    """
    source, s = current
    end_m = start_m + length_m
    if end_m > s[-1]:
        return None
    moving = (s > start_m) & (s < end_m)
    along, lateral = frenet(source[moving], aim.points, aim.s)
    if along.size < 2 or np.abs(lateral).max() > max_shift_m or along[-1] >= aim.length_m - 0.5:
        return None
    if np.any(np.diff(along) <= 0) or along[0] <= 0.0:
        return None
    share = lateral_share((s[moving] - start_m) / length_m)[:, None]
    shifted = source[moving] * (1.0 - share) + aim.point(along) * share
    rest_s = np.arange(along[-1] + step_m, aim.length_m, step_m)
    rest = np.concatenate([aim.point(rest_s), aim.point(np.array([aim.length_m]))])
    points = np.concatenate([source[s <= start_m], shifted, rest])
    driven = arc_length(points)
    at_end = int((s <= start_m).sum() + shifted.shape[0] - 1)
    return Blend(
        points=points,
        start_m=float(driven[max(0, int((s <= start_m).sum()) - 1)]),
        end_m=float(driven[at_end]),
        target_offset_m=float(along[-1] - driven[at_end]),
    )
