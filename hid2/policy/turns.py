"""Speeds of straight, left-turn and right-turn lanes (paper, Straight, Left Turn and Right Turn)."""

import math
from dataclasses import dataclass

import numpy as np

from hid2.agents import FloatArray
from hid2.kernels.speed_profile import reachable
from hid2.motion.reference_line import TABLE_STEP_M, ReferenceLine
from hid2.params import Limits, Turn
from netconvert.lane_graph import TurnType

#: Slowing before a turn's entrance, m/s2. No tunable: softer than behind a leader, of which drivers differ.
_APPROACH_DECEL_MPS2 = 1.5
#: A line that bends, or changes its curvature, by less than this is straight, 1/m and 1/m2.
#: No tunable: against division by 0.
_FLAT = 1e-6


def turn_shape(alpha: FloatArray, trough: float, trough_at: float) -> FloatArray:
    """Shape v / v_0 over a turn: 1 at both ends, `trough` at alpha = trough_at, smooth, below 1 between.

    The paper's f_left and f_right are two such shapes.
    alpha (M,) in [0, 1], normalised progress s / L_l. Two half cosines, so f' = 0 at the ends and at the trough.
    """
    before = alpha < trough_at
    phase = np.where(before, alpha / trough_at, (1.0 - alpha) / (1.0 - trough_at))
    return np.asarray(1.0 - (1.0 - trough) * 0.5 * (1.0 - np.cos(np.pi * np.clip(phase, 0.0, 1.0))))


def f_left(alpha: FloatArray, turn: Turn) -> FloatArray:
    """Shaping function of left turns; slower in the early and middle segments."""
    return turn_shape(alpha, turn.left_trough, turn.trough_at)


def f_right(alpha: FloatArray, turn: Turn) -> FloatArray:
    """Shaping function of right turns: milder, above that of left turns inside the lane."""
    return turn_shape(alpha, turn.right_trough, turn.trough_at)


def hard_cap(line: ReferenceLine, limits: Limits) -> FloatArray:
    """(S,) m/s at the line's table: what yaw rate, yaw acceleration and lateral jerk allow any vehicle.

    With a margin to the limits, so that speeding up or slowing within the curve has room left.
    """
    curvature = np.maximum(np.abs(line.table_curvature), _FLAT)
    sharpness = np.maximum(np.abs(line.table_sharpness), _FLAT)
    return np.asarray(
        np.minimum.reduce([
            0.8 * limits.yaw_rate_radps / curvature,
            np.sqrt(0.5 * limits.yaw_accel_radps2 / sharpness),
            np.cbrt(0.5 * limits.jerk_mps3 / sharpness),
        ])
    )  # fmt: skip


@dataclass(frozen=True, eq=False, slots=True)
class RoadSpeeds:
    """What a road makes of any vehicle's speed, at its line's table.

    bend (S,) m/s for a lateral acceleration of 1 m/s2; others are as its root. In bends sqrt(1 / kappa); on a turning
    lane v_0 f(alpha), with the largest v_0 that keeps within sqrt(1 / kappa) on the whole lane (they touch once).
    hard (S,) m/s: `hard_cap`. shape (S,): f(alpha) = v / v_0, 1 outside of turning lanes.
    """

    bend: FloatArray
    hard: FloatArray
    shape: FloatArray

    def cap(self, lateral_accel_mps2: float) -> FloatArray:
        """(S,) m/s the road's own limit for a driver that takes so much lateral acceleration."""
        return np.minimum(self.hard, math.sqrt(lateral_accel_mps2) * self.bend)

    def desired(self, desired_mps: float, *, lateral_accel_mps2: float, accel_mps2: float) -> FloatArray:
        """(S,) m/s target speed along a route: the cruising speed, v_0 f(alpha) on turning lanes, less in bends.

        v_0, the speed at a turning lane's entrance, is the cruising speed or what the driver's lateral acceleration
        allows. Slowing begins before the entrance at _APPROACH_DECEL_MPS2; speeding up after the trough at accel_mps2.
        """
        cap = self.cap(lateral_accel_mps2)
        return reachable(cap, self.shape, desired_mps, TABLE_STEP_M, _APPROACH_DECEL_MPS2, accel_mps2)


def road_speeds(
    line: ReferenceLine, segments: list[tuple[float, float, TurnType]], *, turn: Turn, limits: Limits
) -> RoadSpeeds:
    """Speeds of a line's bends, and f_left and f_right on its turning lanes.

    segments: (start, end, turn type) of each lane in arc length of the line, m.
    """
    bend = 1.0 / np.sqrt(np.maximum(np.abs(line.table_curvature), _FLAT))
    turning, shape = bend.copy(), np.ones(bend.size)
    for start, end, kind in segments:
        if kind is TurnType.STRAIGHT or end <= start:
            continue
        cells = np.arange(max(0, int(start / TABLE_STEP_M)), min(shape.size, int(end / TABLE_STEP_M) + 2))
        s = cells * TABLE_STEP_M
        cells, s = cells[(s >= start) & (s <= end)], s[(s >= start) & (s <= end)]
        if not cells.size:
            continue
        alpha = np.asarray((s - start) / (end - start), dtype=np.float64)
        here = f_left(alpha, turn) if kind is TurnType.LEFT else f_right(alpha, turn)
        shape[cells] = np.minimum(shape[cells], here)
        turning[cells] = np.minimum(turning[cells], (bend[cells] / here).min() * here)
    return RoadSpeeds(bend=turning, hard=hard_cap(line, limits), shape=shape)
