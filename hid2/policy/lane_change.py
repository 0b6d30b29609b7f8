"""Lane change: feasibility on the grid and in metres, its duration, and its lateral motion (paper, Lane Change)."""

import math
from dataclasses import dataclass

import numpy as np

from hid2.agents import FloatArray
from hid2.motion.route import Blend
from hid2.params import LaneChange
from netconvert.geometry import Polyline, arc_length, resample


@dataclass(frozen=True, slots=True)
class Gap:
    """A neighbour on a lane path: bumper gap in m, its speed in m/s. No neighbour: gap inf."""

    distance_m: float
    speed_mps: float

    @staticmethod
    def none() -> "Gap":
        """Nobody there."""
        return Gap(math.inf, 0.0)


def safe_gap_m(follower_mps: float, leader_mps: float, *, time_gap_s: float, params: LaneChange) -> float:
    """Smallest bumper gap behind a leader: time gap plus what braking away the speed difference takes."""
    closing = max(0.0, follower_mps - leader_mps)
    return max(params.min_gap_m, time_gap_s * follower_mps) + closing * closing / (2 * params.braking_mps2)


def lane_change_reason(
    *,
    speed_mps: float,
    cells_free: bool,
    front: Gap,
    rear: Gap,
    remaining_m: float,
    params: LaneChange,
) -> str | None:
    """Why the change to l' is not feasible now; None where it is.

    cells_free: sigma = 0 in cells j-1, j, j+1 of l'. Gaps are to the new leader and follower in Frenet metres.
    """
    if speed_mps < params.min_speed_mps:
        return "too_slow"
    if remaining_m < params.min_remaining_m:
        return "lane_ends"
    if not cells_free:
        return "cells_occupied"
    if front.distance_m < safe_gap_m(speed_mps, front.speed_mps, time_gap_s=params.time_gap_front_s, params=params):
        return "front_gap"
    if rear.distance_m < safe_gap_m(rear.speed_mps, speed_mps, time_gap_s=params.time_gap_rear_s, params=params):
        return "rear_gap"
    return None


def duration_s(*, lateral_m: float, speed_mps: float, remaining_m: float, params: LaneChange) -> float:
    """How long the lateral motion takes, within the bounds of `params`.

    Peak lateral acceleration of the profile in `lateral_share` is 8 D / T^2; drivers seek a comfortable one, take a
    little longer when slow, and no longer than the lane that is left allows.
    """
    comfortable = math.sqrt(8.0 * abs(lateral_m) / params.lateral_accel_mps2)
    slow = 1.0 + 0.25 * max(0.0, 1.0 - speed_mps / 12.0)
    left = 0.8 * remaining_m / max(speed_mps, 0.1)
    return min(max(min(comfortable * slow, left), params.min_duration_s), params.max_duration_s)


def lateral_share(tau: FloatArray) -> FloatArray:
    """d(t) / D over tau = t / T in [0, 1]: four cubics with jerk +J, -J, -J, +J, J = 32 D / T^3.

    Position, speed and acceleration are continuous at the knots 1/4, 1/2 (symmetry), 3/4 and zero at both ends
    (paper: d(t) = b0 + b1 t + b2 t2 + b3 t3 from boundary conditions).
    """
    t = np.clip(tau, 0.0, 1.0)
    mirrored = np.where(t > 0.5, 1.0 - t, t)
    first = 32.0 / 6.0 * mirrored**3
    u = mirrored - 0.25
    knot = 32.0 / 6.0 * 0.25**3, 16.0 * 0.25**2, 32.0 * 0.25
    second = knot[0] + knot[1] * u + knot[2] * u**2 / 2 - 32.0 / 6.0 * u**3
    rise = np.where(mirrored < 0.25, first, second)
    return np.asarray(np.where(t > 0.5, 1.0 - rise, rise))


def blend_paths(
    current: FloatArray, target: FloatArray, *, start_m: float, length_m: float, step_m: float, max_shift_m: float
) -> Blend | None:
    """Path that follows `current`, shifts over length_m from start_m on, and follows `target` from there.

    current, target (N, 2) m. None where the two are not side by side all along (farther than max_shift_m apart), or
    the target ends before. The shift is `lateral_share` over the length driven.
    """
    source = resample(current, step_m=step_m)
    s = arc_length(source)
    aim = Polyline(target)
    end_m = start_m + length_m
    if end_m > s[-1]:
        return None
    moving = (s > start_m) & (s < end_m)
    along, lateral = aim.frenet(source[moving])
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
        shift_m=-float(lateral[-1]),
        target_offset_m=float(along[-1] - driven[at_end]),
    )
