"""Speeds of straight, left-turn and right-turn lanes (paper, Straight, Left Turn and Right Turn)."""

from dataclasses import dataclass

import numpy as np

from hid2.agents import FloatArray, Policy
from hid2.kernels.compiled import planner_kernel
from hid2.motion.reference_line import TABLE_STEP_M, ReferenceLine
from hid2.params import Limits, Turn
from netconvert.lane_graph import TurnType

TURN_OF_POLICY = {Policy.LEFT_TURN: TurnType.LEFT, Policy.RIGHT_TURN: TurnType.RIGHT}


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


def speed_cap(line: ReferenceLine, turn: Turn, limits: Limits) -> FloatArray:
    """(S,) m/s at the line's table: what its curvature and sharpness allow.

    v <= sqrt(a_y / kappa) with the comfortable a_y of `turn`; yaw rate, yaw acceleration and lateral jerk with a
    margin to the limits, so that speeding up or slowing within the curve has room left.
    """
    curvature = np.maximum(np.abs(line.table_curvature), 1e-6)
    sharpness = np.maximum(np.abs(line.table_sharpness), 1e-6)
    return np.asarray(
        np.minimum.reduce([
            np.sqrt(turn.lateral_accel_mps2 / curvature),
            0.8 * limits.yaw_rate_radps / curvature,
            np.sqrt(0.5 * limits.yaw_accel_radps2 / sharpness),
            np.cbrt(0.5 * limits.jerk_mps3 / sharpness),
        ])
    )  # fmt: skip


@dataclass(frozen=True, eq=False, slots=True)
class RoadSpeeds:
    """What a road makes of anybody's speed, at its line's table. cap (S,) m/s: `speed_cap`; shape (S,): v / v_0."""

    cap: FloatArray
    shape: FloatArray

    def desired(self, cruise_mps: float, *, turn: Turn, accel_mps2: float) -> FloatArray:
        """(S,) m/s target speed along a route: cruise, shaped on turn lanes, capped by curvature, reachable.

        Slowing begins before the entrance at approach_decel_mps2; speeding up after the exit at accel_mps2.
        """
        decel_mps2 = turn.approach_decel_mps2
        return np.asarray(reachable(self.cap, self.shape, cruise_mps, TABLE_STEP_M, decel_mps2, accel_mps2))


def road_speeds(
    line: ReferenceLine, segments: list[tuple[float, float, TurnType]], *, turn: Turn, limits: Limits
) -> RoadSpeeds:
    """Cap of a line's curvature, and f_left and f_right on its turning lanes.

    segments: (start, end, turn type) of each lane in arc length of the line, m.
    """
    shape = np.ones(line.table_curvature.size)
    for start, end, kind in segments:
        if kind is TurnType.STRAIGHT or end <= start:
            continue
        cells = np.arange(max(0, int(start / TABLE_STEP_M)), min(shape.size, int(end / TABLE_STEP_M) + 2))
        s = cells * TABLE_STEP_M
        cells, s = cells[(s >= start) & (s <= end)], s[(s >= start) & (s <= end)]
        alpha = np.asarray((s - start) / (end - start), dtype=np.float64)
        here = f_left(alpha, turn) if kind is TurnType.LEFT else f_right(alpha, turn)
        shape[cells] = np.minimum(shape[cells], here)
    return RoadSpeeds(cap=speed_cap(line, turn, limits), shape=shape)


@planner_kernel
def reachable(cap, shape, cruise, step, decel, accel):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Backward pass for slowing in time, forward pass for speeding up, both in squares of speed."""
    out = np.empty_like(cap)
    slowing, speeding = 2 * decel * step, 2 * accel * step
    square = np.inf
    for i in range(out.size - 1, -1, -1):
        wanted = min(cap[i], cruise * shape[i])
        square = min(wanted * wanted, square + slowing)
        out[i] = square
    square = np.inf
    for i in range(out.size):
        square = min(out[i], square + speeding)
        out[i] = np.sqrt(square)
    return out
