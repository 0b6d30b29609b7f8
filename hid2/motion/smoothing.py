"""Frenet smoothing: s(t) as piecewise cubics within limits, and the pose at every step (paper, Trajectory Smoothing).

The lateral half, d(t), is in `lane_change`; it is already part of the reference line when s(t) is smoothed here.
"""

from dataclasses import dataclass

import numpy as np

from hid2.agents import FloatArray
from hid2.kernels.compiled import planner_kernel
from hid2.motion.reference_line import ReferenceLine

_SPEEDING_WEIGHT = 20.0
_LAST_ACCEL_MPS2 = 1.2


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


#: Rows of the constraints on (s, v, a) at a step, and behind them those on the jerk that leads to it.
_S_MOST, _S_LEAST, _V_LEAST, _A_MOST, _A_LEAST, _TTC_MOST, _TTC_LEAST, _V_SOFT, _J_MOST, _J_LEAST = range(10)
_ROWS = 10
_NO_BOUND = 1e8
_ITERATIONS_MOST = 60
_TOLERANCE = 1e-6


@planner_kernel
def _programme(target, v_target, bound, v0, a0, step, ttc, jerk_weight, soft):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Interior-point method (Mehrotra) for the nearest motion within bounds; each Newton step is a Riccati recursion.

    State (s, v, a) with the jerk as input: the dynamics hold exactly, and a step costs no more than its 110 stages.
    bound (T, rows): upper bounds on +-s, -v, +-a, +-(s + ttc v), v (soft: excess costs soft / 2 e2), +-j; inf is none.
    Returns whether it has a solution, and a (T,).
    """
    count = target.size
    b1, b2 = step**3 / 6, step**2 / 2
    s, v, a = np.zeros(count), np.zeros(count), np.zeros(count)
    v[0], a[0] = v0, a0
    for k in range(count - 1):  # any motion will do to begin with
        j = min(max(-a[k] / step, -bound[k + 1, _J_LEAST]), bound[k + 1, _J_MOST])
        s[k + 1] = s[k] + step * v[k] + b2 * a[k] + b1 * j
        v[k + 1] = v[k] + step * a[k] + b2 * j
        a[k + 1] = a[k] + step * j
    slack, dual = np.zeros((count, _ROWS)), np.zeros((count, _ROWS))
    d_slack, d_dual, comp = np.zeros((count, _ROWS)), np.zeros((count, _ROWS)), np.zeros((count, _ROWS))
    gain, scale, push = np.zeros((count, 3)), np.zeros(count), np.zeros(count)
    hess, grad = np.zeros((count, 4)), np.zeros((count, 4))
    d = np.zeros((count, 3))
    active = 0
    for k in range(1, count):
        j = (a[k] - a[k - 1]) / step
        for i in range(_ROWS):
            if bound[k, i] < _NO_BOUND:
                active += 1
                slack[k, i] = max(bound[k, i] - _row(i, s[k], v[k], a[k], j, ttc), 1.0)
                dual[k, i] = 1.0
    for _ in range(_ITERATIONS_MOST):
        mean, worst = 0.0, 0.0
        for k in range(1, count):
            j = (a[k] - a[k - 1]) / step
            for i in range(_ROWS):
                if bound[k, i] < _NO_BOUND:
                    mean += slack[k, i] * dual[k, i]
                    ease = dual[k, i] / soft if i == _V_SOFT else 0.0
                    off = abs(_row(i, s[k], v[k], a[k], j, ttc) - ease + slack[k, i] - bound[k, i])
                    worst = max(worst, off)
        mean /= active
        if mean < _TOLERANCE and worst < _TOLERANCE:
            return True, a
        aim, share = 0.0, 1.0
        for corrector in range(2):
            for k in range(1, count):
                j = (a[k] - a[k - 1]) / step
                g_s, g_v, g_a, g_j = s[k] - target[k], 0.5 * (v[k] - v_target[k]), 0.3 * a[k], 0.3 * jerk_weight * j
                h_ss, h_vv, h_aa, h_jj, h_tt = 1.0, 0.5, 0.3, 0.3 * jerk_weight, 0.0
                for i in range(_ROWS):
                    if bound[k, i] >= _NO_BOUND:
                        continue
                    t, z = slack[k, i], dual[k, i]
                    ease = 1.0 / soft if i == _V_SOFT else 0.0
                    off = _row(i, s[k], v[k], a[k], j, ttc) - z * ease + t - bound[k, i]
                    missing = aim - t * z
                    if corrector == 1:
                        missing -= d_slack[k, i] * d_dual[k, i]
                    comp[k, i] = missing
                    weight = z / (t + z * ease)
                    force = z + (missing + z * off) / (t + z * ease)
                    if i <= _S_LEAST:
                        h_ss += weight
                        g_s += force if i == _S_MOST else -force
                    elif i == _V_LEAST:
                        h_vv += weight
                        g_v -= force
                    elif i <= _A_LEAST:
                        h_aa += weight
                        g_a += force if i == _A_MOST else -force
                    elif i <= _TTC_LEAST:
                        h_tt += weight
                        force = force if i == _TTC_MOST else -force
                        g_s += force
                        g_v += ttc * force
                    elif i == _V_SOFT:
                        h_vv += weight
                        g_v += force
                    else:
                        h_jj += weight
                        g_j += force if i == _J_MOST else -force
                if corrector == 0:
                    hess[k, 0], hess[k, 1], hess[k, 2] = h_ss + h_tt, h_tt * ttc, h_vv + h_tt * ttc * ttc
                    hess[k, 3], scale[k] = h_aa, h_jj
                grad[k, 0], grad[k, 1], grad[k, 2], grad[k, 3] = g_s, g_v, g_a, g_j
            _newton(hess, grad, scale, gain, push, d, step, corrector == 0)
            most = 1.0
            for k in range(1, count):
                j, d_j = (a[k] - a[k - 1]) / step, (d[k, 2] - d[k - 1, 2]) / step
                for i in range(_ROWS):
                    if bound[k, i] >= _NO_BOUND:
                        continue
                    t, z = slack[k, i], dual[k, i]
                    ease = 1.0 / soft if i == _V_SOFT else 0.0
                    off = _row(i, s[k], v[k], a[k], j, ttc) - z * ease + t - bound[k, i]
                    moved = _row(i, d[k, 0], d[k, 1], d[k, 2], d_j, ttc)
                    d_dual[k, i] = (comp[k, i] + z * (off + moved)) / (t + z * ease)
                    d_slack[k, i] = -off - moved + d_dual[k, i] * ease
                    if d_slack[k, i] < 0 and -t / d_slack[k, i] < most:
                        most = -t / d_slack[k, i]
                    if d_dual[k, i] < 0 and -z / d_dual[k, i] < most:
                        most = -z / d_dual[k, i]
            if corrector == 0:
                ahead = 0.0
                for k in range(1, count):
                    for i in range(_ROWS):
                        if bound[k, i] < _NO_BOUND:
                            ahead += (slack[k, i] + most * d_slack[k, i]) * (dual[k, i] + most * d_dual[k, i])
                aim = mean * (ahead / active / mean) ** 3
            else:
                share = min(1.0, 0.995 * most)
        if share < 1e-7 or not np.isfinite(share):
            return False, a
        for k in range(1, count):
            s[k] += share * d[k, 0]
            v[k] += share * d[k, 1]
            a[k] += share * d[k, 2]
            for i in range(_ROWS):
                if bound[k, i] < _NO_BOUND:
                    slack[k, i] += share * d_slack[k, i]
                    dual[k, i] += share * d_dual[k, i]
                    if dual[k, i] > 1e9:
                        return False, a
    return False, a


@planner_kernel
def _row(i, s, v, a, j, ttc):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Left-hand side of a constraint."""
    if i <= _S_LEAST:
        return s if i == _S_MOST else -s
    if i == _V_LEAST:
        return -v
    if i <= _A_LEAST:
        return a if i == _A_MOST else -a
    if i <= _TTC_LEAST:
        return s + ttc * v if i == _TTC_MOST else -(s + ttc * v)
    if i == _V_SOFT:
        return v
    return j if i == _J_MOST else -j


@planner_kernel
def _newton(hess, grad, scale, gain, push, d, step, factor):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Riccati recursion backwards, motion forwards: d (T, 3). factor: gains too, else those of the last call hold."""
    count = d.shape[0]
    b1, b2, b3 = step**3 / 6, step**2 / 2, step
    p11, p12, p13, p22, p23, p33 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    q1, q2, q3 = 0.0, 0.0, 0.0
    for k in range(count - 1, 0, -1):
        q1, q2, q3 = q1 + grad[k, 0], q2 + grad[k, 1], q3 + grad[k, 2]
        if factor:
            p11, p12, p22, p33 = p11 + hess[k, 0], p12 + hess[k, 1], p22 + hess[k, 2], p33 + hess[k, 3]
            w1 = p11 * b1 + p12 * b2 + p13 * b3
            w2 = p12 * b1 + p22 * b2 + p23 * b3
            w3 = p13 * b1 + p23 * b2 + p33 * b3
            total = scale[k] + b1 * w1 + b2 * w2 + b3 * w3
            # B'P A
            k1, k2, k3 = w1, w1 * step + w2, w1 * b2 + w2 * step + w3
            gain[k, 0], gain[k, 1], gain[k, 2] = k1 / total, k2 / total, k3 / total
            scale[k] = total
            # A'P A
            c12 = p11 * step + p12
            c13 = p11 * b2 + p12 * step + p13
            d22 = p12 * step + p22
            d23 = p12 * b2 + p22 * step + p23
            e33 = p13 * b2 + p23 * step + p33
            n22 = c12 * step + d22
            n23 = c13 * step + d23
            n33 = c13 * b2 + d23 * step + e33
            p12, p13, p22, p23, p33 = c12, c13, n22, n23, n33
            p11 -= k1 * k1 / total
            p12 -= k1 * k2 / total
            p13 -= k1 * k3 / total
            p22 -= k2 * k2 / total
            p23 -= k2 * k3 / total
            p33 -= k3 * k3 / total
        pull = grad[k, 3] + b1 * q1 + b2 * q2 + b3 * q3
        push[k] = pull / scale[k]
        q3 = q1 * b2 + q2 * step + q3 - gain[k, 2] * pull
        q2 = q1 * step + q2 - gain[k, 1] * pull
        q1 -= gain[k, 0] * pull
    for k in range(1, count):
        s, v, a = d[k - 1, 0], d[k - 1, 1], d[k - 1, 2]
        j = -(gain[k, 0] * s + gain[k, 1] * v + gain[k, 2] * a) - push[k]
        d[k, 0] = s + step * v + b2 * a + b1 * j
        d[k, 1] = v + step * a + b2 * j
        d[k, 2] = a + step * j


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
    origin, v0 = float(s_driven[0]), float(v_driven[0])
    bound = np.empty((s_driven.size, _ROWS))
    bound[:, _S_MOST] = bounds.high - origin
    bound[:, _S_LEAST] = origin - bounds.low
    bound[:, _V_LEAST] = 0.0
    bound[:, _A_MOST] = limits.accel_max
    bound[:, _A_LEAST] = -limits.accel_min
    bound[-1, [_A_MOST, _A_LEAST]] = _LAST_ACCEL_MPS2
    bound[:, _TTC_MOST] = bounds.ttc_room - origin
    bound[:, _TTC_LEAST] = origin - bounds.ttc_need
    bound[:, _V_SOFT] = bounds.fastest
    bound[:, [_J_MOST, _J_LEAST]] = limits.jerk
    if np.any(bound[1:, _S_MOST] + bound[1:, _S_LEAST] < 0) or np.any(bound[1:, _TTC_MOST] + bound[1:, _TTC_LEAST] < 0):
        return None
    solved, accel = _programme(
        s_driven - origin, v_driven, bound, v0, a0, step_s, bounds.ttc_s, jerk_weight, _SPEEDING_WEIGHT
    )
    return integrate(origin, v0, accel, step_s=step_s, jerk=limits.jerk) if solved else None


def integrate(s0: float, v0: float, accel: FloatArray, *, step_s: float, jerk: float) -> Motion:
    """Exact cubics from accelerations at the knots; jerk is clipped, and a vehicle that would roll back stands."""
    s, v, a = _integrate(s0, v0, accel, step_s, jerk)
    return Motion(s=s, v=v, a=a)


@planner_kernel
def _integrate(s0, v0, accel, step_s, jerk):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
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
    return s, v, a


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
