"""The lateral motion of a lane change: d(t) as cubics, and its path (paper, Trajectory Smoothing)."""

import math
from dataclasses import dataclass

import numpy as np

from hid2.agents import FloatArray
from hid2.kernels.polyline import frenet
from hid2.measures.manoeuvres import LATERAL_SPEED_MPS, LATERAL_WINDOW_S
from hid2.params import LaneChange
from netconvert.geometry import Polyline, arc_length

#: Share of a lateral motion in which its speed rises, and falls. No tunable: measured, recorded ones peak at .87 m/s.
_RAMP_SHARE = 0.27


def lateral_share(tau: FloatArray, ramp: float) -> FloatArray:
    """d(t) / D over tau = t / T in [0, 1]: cubics with jerk +J, -J, 0, -J, +J.

    The lateral speed rises over a share `ramp` of the time to D / T / (1 - ramp), keeps it, and falls: drivers cross a
    lane at an even pace. Position, speed and acceleration are continuous at the knots ramp / 2, ramp and those
    mirrored, and zero at both ends (paper: d(t) = b0 + b1 t + b2 t2 + b3 t3 from boundary conditions).
    """
    t = np.clip(tau, 0.0, 1.0)
    mirrored = np.minimum(t, 1.0 - t)
    u = mirrored / ramp
    rising = np.where(u < 0.5, 2.0 / 3.0 * u**3, u - 0.5 + 2.0 / 3.0 * (1.0 - u) ** 3)
    rise = ramp / (1.0 - ramp) * np.where(u < 1.0, rising, u - 0.5)
    return np.asarray(np.where(t > 0.5, 1.0 - rise, rise))


@dataclass(frozen=True, slots=True)
class LateralTiming:
    """How long a driver takes for a lateral motion, by its clock tau in [0, 1].

    lasting_s: from end to end; ramp: of `lateral_share`; slow_mps: slower than this, tau goes with the length driven,
    so that the heading stays within `lane_change.heading_deg` of the lane.
    """

    lasting_s: float
    ramp: float
    slow_mps: float

    @staticmethod
    def of(wanted_s: float, apart_m: float, change: LaneChange) -> "LateralTiming":
        """Of a motion over apart_m that is to last wanted_s between the moments at which |d'| passes .1 m/s.

        As measured: over LATERAL_WINDOW_S. A share u of the ramp is over then, or left: 2 u^2 of the peak
        D / T / (1 - ramp), and so much as the window's spread adds to it.
        """
        ramp, lasting_s, spread_s2 = _RAMP_SHARE, wanted_s, (0.5 * LATERAL_WINDOW_S) ** 2 / 5.0
        for _ in range(3):  # it settles at once: the ends, where |d'| is less, depend little on the whole
            peak_mps = apart_m / lasting_s / (1.0 - ramp)
            u2 = 0.5 * LATERAL_SPEED_MPS / peak_mps - spread_s2 / (ramp * lasting_s) ** 2
            lasting_s = wanted_s / (1.0 - 2.0 * ramp * math.sqrt(min(max(u2, 0.0), 0.125)))
        peak_mps = apart_m / lasting_s / (1.0 - ramp)
        return LateralTiming(lasting_s, ramp, peak_mps / math.tan(math.radians(change.heading_deg)))

    def gained(self, speed_mps: FloatArray, step_s: float) -> FloatArray:
        """What tau gains in steps that are driven at speeds, m/s; of any shape."""
        return np.asarray(np.minimum(speed_mps / self.slow_mps, 1.0) * (step_s / self.lasting_s))


@dataclass(frozen=True, eq=False, slots=True)
class Blend:
    """A path that leaves one lane path for another.

    points (N, 2) m, evenly spaced before smoothing; start_m, middle_m, end_m: arc length on it where the lateral motion
    begins, is half done, and ends; target_offset_m: arc length on the target minus arc length on the blend, behind its
    end.
    """

    points: FloatArray
    start_m: float
    middle_m: float
    end_m: float
    target_offset_m: float


def blend_paths(
    current: tuple[FloatArray, FloatArray], aim: Polyline, *, along_m: FloatArray, tau: FloatArray, ramp: float,
    step_m: float, max_shift_m: float,
) -> Blend | None:  # fmt: skip
    """Path that follows `current`, as `DrivenPath.even`, shifts to `aim`, and follows that one from there.

    tau (K,), ramp: of `lateral_share`, at arc lengths along_m (K,) m of `current`; from 0 to 1. None where the two are
    not side by side all along (farther than max_shift_m apart), or the target ends before.
    """
    source, s = current
    start_m, end_m = along_m[0], along_m[-1]
    if end_m > s[-1]:
        return None
    moving = (s > start_m) & (s < end_m)
    along, lateral = frenet(source[moving], aim.points, aim.s)
    if along.size < 2 or np.abs(lateral).max() > max_shift_m or along[-1] >= aim.length_m - 0.5:
        return None
    if np.any(np.diff(along) <= 0) or along[0] <= 0.0:
        return None
    across = lateral_share(np.interp(s[moving], along_m, tau), ramp)
    shifted = source[moving] * (1.0 - across[:, None]) + aim.point(along) * across[:, None]
    rest_m = np.arange(along[-1] + step_m, aim.length_m, step_m)
    rest = np.concatenate([aim.point(rest_m), aim.point(np.array([aim.length_m]))])
    points = np.concatenate([source[s <= start_m], shifted, rest])
    driven = arc_length(points)
    first = int((s <= start_m).sum())
    at_end = first + shifted.shape[0] - 1
    return Blend(
        points=points,
        start_m=float(driven[max(0, first - 1)]),
        middle_m=float(np.interp(0.5, across, driven[first : at_end + 1])),
        end_m=float(driven[at_end]),
        target_offset_m=float(along[-1] - driven[at_end]),
    )
