"""What the road asks along a path: speeds on turning lanes (paper, Straight, Left and Right Turn) and in bends.

And other ways at the next split, the paper's answer to a predicted conflict (case 3) that timing does not solve.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from hid2.agents import FloatArray, IntArray, Policy
from hid2.drivers.driver import Driver
from hid2.kernels.speed_profile import reachable
from hid2.kernels.steering import STRAIGHT
from hid2.motion.reference_line import TABLE_STEP_M, ReferenceLine
from hid2.motion.route import DrivenPath, is_drivable, is_simple, routes_from, straightest_first
from hid2.once import once
from hid2.params import Limits, Turn
from hid2.policy.decision import policy_on
from hid2.scene import Scene
from netconvert.lane_graph import TurnType

#: Policies by their numbers in arrays; `kernels/steering.py` knows the number of going straight.
POLICIES = tuple(Policy)
assert POLICIES[STRAIGHT] is Policy.STRAIGHT
_SAME_M = 0.02  # book-keeping: tolerance between two paths with the same first lanes
_EVERY_M = 2.0  # book-keeping: spacing of the points at which two such paths are compared
#: Deceleration before a turn's entrance, m/s2. No tunable: softer than behind a leader, where drivers differ.
_APPROACH_DECEL_MPS2 = 1.5
#: Curvature, 1/m, and its change, 1/m2, below which a line is straight. No tunable: against division by 0.
_FLAT = 1e-6


def turn_shape(alpha: FloatArray, trough: float, trough_at: float) -> FloatArray:
    """Shape v / v_0 over a turn, alpha (M,) = s / L_l: 1 at both ends, `trough` at trough_at, smooth, below 1 between.

    The paper's f_left and f_right are two such shapes, here of two half cosines: f' = 0 at the ends and at the trough.
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
    """(S,) m/s at a line's table: what yaw rate, yaw acceleration and lateral jerk allow any vehicle, with a margin."""
    curvature = np.maximum(np.abs(line.table_curvature), _FLAT)
    sharpness = np.maximum(np.abs(line.table_sharpness), _FLAT)
    by_yaw_accel = np.sqrt(0.5 * limits.yaw_accel_radps2 / sharpness)
    by_jerk = np.cbrt(0.5 * limits.jerk_mps3 / sharpness)
    return np.asarray(np.minimum.reduce([0.8 * limits.yaw_rate_radps / curvature, by_yaw_accel, by_jerk]))


@dataclass(frozen=True, eq=False, slots=True)
class RoadSpeeds:
    """What a road makes of any vehicle's speed, at its line's table.

    bend (S,) m/s for a lateral acceleration of 1 m/s2; others are as its root. In bends sqrt(1 / kappa); on a turning
    lane v_0 f(alpha), with the largest v_0 that keeps within sqrt(1 / kappa) on the whole lane (they touch once).
    hard (S,) m/s: `hard_cap`. shape (S,): f(alpha) = v / v_0, 1 outside of turning lanes; turning: where it is less.
    """

    bend: FloatArray
    hard: FloatArray
    shape: FloatArray
    turning: IntArray

    def cap(self, lateral_accel_mps2: float) -> FloatArray:
        """(S,) m/s the road's own limit for a driver that takes so much lateral acceleration."""
        return np.minimum(self.hard, math.sqrt(lateral_accel_mps2) * self.bend)

    def desired(self, desired_mps: float, *, lateral_accel_mps2: float, accel_mps2: float) -> FloatArray:
        """(S,) m/s a driver takes along a route at most: v_0 f(alpha) on turning lanes, elsewhere what bends allow.

        v_0, the desired speed at a turning lane's entrance, is the cruising speed or what the driver's lateral
        acceleration allows; one that enters slowly speeds up. Slowing begins before the entrance at
        _APPROACH_DECEL_MPS2; speeding up after the trough at accel_mps2.
        """
        most, on = self.cap(lateral_accel_mps2), self.turning
        most[on] = np.minimum(most[on], desired_mps * self.shape[on])
        return reachable(most, _APPROACH_DECEL_MPS2, accel_mps2)


def road_speeds(
    line: ReferenceLine, segments: list[tuple[float, float, TurnType]], *, turn: Turn, limits: Limits
) -> RoadSpeeds:
    """Speeds of bends, and f_left and f_right on turning lanes; segments: (start, end, turn type) of each lane, m."""
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
    return RoadSpeeds(turning, hard_cap(line, limits), shape, np.flatnonzero(shape < 1.0))


@dataclass(eq=False)
class Roads:
    """Speeds along the paths of a scene."""

    scene: Scene

    def speeds(self, path: DrivenPath, driver: Driver) -> FloatArray:
        """(S,) m/s at the table of a path's line: what a driver takes there at most, also where it desires less."""
        return self._of_any(path).desired(
            driver.desired_mps, lateral_accel_mps2=driver.turn_lateral_mps2, accel_mps2=driver.accel_mps2
        )

    @once
    def _of_any(self, path: DrivenPath) -> RoadSpeeds:
        config, lanes = self.scene.config, self.scene.grid.graph.lanes
        segments = [(one.start, one.end, lanes[one.lane_id].turn) for one in path.segments]
        return road_speeds(path.line, segments, turn=config.turn, limits=config.limits)

    @once
    def lanes(self, path: DrivenPath) -> tuple[FloatArray, IntArray]:
        """Where the lanes of a path end, (L,) m, and numbers of what Algorithm 1 comes to on each without a request."""
        lanes = self.scene.grid.graph.lanes
        policies = [POLICIES.index(policy_on(lanes[segment.lane_id].turn)) for segment in path.segments]
        return np.array([segment.end for segment in path.segments]), np.array(policies, dtype=np.int64)


def ways_at_next_split(scene: Scene, path: DrivenPath, *, s: float, from_m: float) -> Iterator[DrivenPath]:
    """Paths that leave the present one at the next split, those that go straight on first.

    s: driven so far, m, the same on them; from_m: no turn off before it. None after a change of lanes, which is not the
    middle of its lanes, nor where nothing links lanes (ablation).
    """
    if path.lateral_spans or "topology" in scene.config.without:
        return
    graph, route = scene.grid.graph, tuple(segment.lane_id for segment in path.segments)
    straight_first = partial(straightest_first, graph)
    for row, segment in enumerate(path.segments[:-1]):
        others = tuple(n for n in graph.successors(segment.lane_id) if n not in route and is_drivable(graph, n))
        if segment.end < from_m or not others:
            continue
        for lane_id in straight_first(segment.lane_id, others):
            for rest in routes_from(graph, lane_id, choose=straight_first, most=1):
                whole = (*route[: row + 1], *rest)
                other = scene.paths.along(whole)
                if is_simple(graph, whole) and _is_the_same_until(path, other, s):
                    yield other
        return


def _is_the_same_until(path: DrivenPath, other: DrivenPath, s: float) -> bool:
    own = np.arange(0.0, s + _EVERY_M, _EVERY_M)
    apart = path.line.position(own) - other.line.position(other.all_to_line(path.all_to_raw(own)))
    return bool(np.hypot(apart[:, 0], apart[:, 1]).max() < _SAME_M)
