"""Frenet smoothing: s(t) as piecewise cubics within limits, and the pose at every step (paper, Trajectory Smoothing).

The lateral half, d(t), is in `lane_change`; it is already part of the reference line when s(t) is smoothed here.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import osqp
import scipy.sparse as sparse

from hid2.agents import FloatArray
from hid2.reference_line import ReferenceLine

_FREE = 1e4
_SPEEDING_WEIGHT = 20.0


@dataclass(frozen=True, eq=False, slots=True)
class SpeedBounds:
    """Constraints on s(t), each (T,).

    low, high m. fastest m/s, soft: comfort in curves gives way to safety. ttc_room m: s + ttc_s * v stays below it, the
    leader's; ttc_need m: and above it, the follower's.
    """

    low: FloatArray
    high: FloatArray
    fastest: FloatArray
    ttc_room: FloatArray
    ttc_need: FloatArray
    ttc_s: float


@dataclass(frozen=True, slots=True)
class SpeedLimits:
    """Limits that the smoothing aims at, a little inside those of the last check."""

    accel_min: float
    accel_max: float
    jerk: float


@dataclass(frozen=True, eq=False, slots=True)
class Motion:
    """s (T,) m, v (T,) m/s, a (T,) m/s2 at every step: knots of cubics, jerk constant between them."""

    s: FloatArray
    v: FloatArray
    a: FloatArray


@lru_cache(maxsize=64)
def _problem(
    count: int, step_s: float, ttc_s: float, jerk_weight: float
) -> tuple[sparse.csc_matrix, sparse.csc_matrix]:
    """Hessian (upper) and constraint rows over (s, v, a, e): dynamics, jerk, boxes, TTC, soft speed (v - e)."""
    eye, zero = np.eye(count), np.zeros((count, count))
    first, second = np.eye(count - 1, count), np.eye(count - 1, count, k=1)
    change, none = second - first, np.zeros((count - 1, count))
    rows = np.block([
        [change, -step_s * first, -(step_s**2) * (first / 3 + second / 6), none],
        [none, change, -step_s / 2 * (first + second), none],
        [none, none, change / step_s, none],
        [eye, zero, zero, zero],
        [zero, eye, zero, zero],
        [zero, zero, eye, zero],
        [eye, ttc_s * eye, zero, zero],
        [zero, eye, zero, -eye],
    ])  # fmt: skip
    hessian = np.zeros((4 * count, 4 * count))
    jerk = change / step_s
    weights = (eye, 0.5 * eye, 0.3 * eye + 0.3 * jerk_weight * (jerk.T @ jerk), _SPEEDING_WEIGHT * eye)
    for place, block in enumerate(weights):
        span = slice(place * count, (place + 1) * count)
        hessian[span, span] = block
    return sparse.csc_matrix(np.triu(hessian)), sparse.csc_matrix(rows)


def smooth_speed(
    s_driven: FloatArray,
    v_driven: FloatArray,
    bounds: SpeedBounds,
    limits: SpeedLimits,
    *,
    a0: float,
    step_s: float,
    jerk_weight: float,
) -> Motion | None:
    """Nearest s(t) to the driven one with bounded jerk and acceleration inside the bounds; None where there is none.

    s_driven, v_driven (T,). s(0) and v(0) are kept, a(0) = a0; the last acceleration is kept small, since a
    difference at the end of a track sees half of it. Cubics: paper, s(t) = a0 + a1 t + a2 t2 + a3 t3 in each step.
    """
    count = s_driven.size
    hessian, rows = _problem(count, step_s, bounds.ttc_s, jerk_weight)
    origin = float(s_driven[0])
    target = s_driven - origin
    linear = np.concatenate([-target, -0.5 * v_driven, np.zeros(2 * count)])
    edge = np.zeros(count)
    edge[-1] = 1.0
    room = np.minimum(bounds.ttc_room - origin, _FREE)
    lower = np.concatenate([
        np.zeros(2 * (count - 1)),
        np.full(count - 1, -limits.jerk),
        np.maximum(bounds.low - origin, -_FREE),
        np.zeros(count),
        np.where(edge > 0, -1.2, limits.accel_min),
        np.maximum(bounds.ttc_need - origin, -_FREE),
        np.full(count, -_FREE),
    ])  # fmt: skip
    upper = np.concatenate([
        np.zeros(2 * (count - 1)),
        np.full(count - 1, limits.jerk),
        np.minimum(bounds.high - origin, _FREE),
        np.full(count, _FREE),
        np.where(edge > 0, 1.2, limits.accel_max),
        room,
        bounds.fastest,
    ])  # fmt: skip
    at_s, at_v, at_a = 3 * (count - 1), 3 * (count - 1) + count, 3 * (count - 1) + 2 * count
    v0 = float(v_driven[0])
    for index, value in ((at_s, 0.0), (at_v, v0), (at_a, a0)):
        lower[index] = upper[index] = value
    at_ttc = at_a + count  # the first state is given, not chosen
    upper[at_ttc] = max(upper[at_ttc], bounds.ttc_s * v0)
    lower[at_ttc] = min(lower[at_ttc], bounds.ttc_s * v0)
    if np.any(lower > upper):
        return None
    solver = osqp.OSQP()
    solver.setup(
        hessian, linear, rows, lower, upper,
        verbose=False, eps_abs=2e-4, eps_rel=2e-4, max_iter=1500, rho=0.01, adaptive_rho_interval=50,
        check_termination=25, polishing=False,
    )  # fmt: skip
    result = solver.solve()
    if result.info.status not in ("solved", "solved inaccurate"):
        return None
    accel = result.x[2 * count : 3 * count].copy()
    accel[0] = a0
    return integrate(origin, v0, accel, step_s=step_s, jerk=limits.jerk)


def integrate(s0: float, v0: float, accel: FloatArray, *, step_s: float, jerk: float) -> Motion:
    """Exact cubics from accelerations at the knots; jerk is clipped, and a vehicle that would roll back stands."""
    count = accel.size
    s, v, a = np.empty(count), np.empty(count), np.empty(count)
    s[0], v[0], a[0] = s0, v0, accel[0]
    most = jerk * step_s
    for k in range(count - 1):
        now = a[k]
        then = min(max(accel[k + 1], now - most), now + most)
        speed = v[k] + step_s * (now + then) / 2
        if speed < 0.0:  # solver residue at standstill
            then = -now - 2 * v[k] / step_s if v[k] > 0 else 0.0
            speed, then = 0.0, max(then, now - most)
            step = max(0.0, v[k] * step_s / 2)
        else:
            step = step_s * v[k] + step_s**2 * (now / 3 + then / 6)
        s[k + 1], v[k + 1], a[k + 1] = s[k] + max(0.0, step), speed, then
    return Motion(s=s, v=v, a=a)


@dataclass(frozen=True, eq=False, slots=True)
class Trajectory:
    """A smoothed vehicle, tau_i of the paper: position (T, 2) m, heading (T,) rad, velocity (T, 2) m/s, from step 0."""

    position: FloatArray
    heading: FloatArray
    velocity: FloatArray
    s: FloatArray

    def first(self, steps: int) -> "Trajectory":
        """Its first steps."""
        return Trajectory(self.position[:steps], self.heading[:steps], self.velocity[:steps], self.s[:steps])


def poses(line: ReferenceLine, motion: Motion) -> Trajectory:
    """Pose p = r(s) on the driven line; heading from its tangent, velocity its time derivative."""
    tangent = line.tangent(motion.s)
    return Trajectory(
        position=line.position(motion.s),
        heading=np.asarray(np.arctan2(tangent[:, 1], tangent[:, 0]), dtype=np.float64),
        velocity=np.asarray(tangent * (motion.v * line.pace(motion.s))[:, None], dtype=np.float64),
        s=motion.s,
    )
