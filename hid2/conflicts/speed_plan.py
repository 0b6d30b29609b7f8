"""The best speed profile on a path that meets nobody (paper, Trajectory Generation, conflict case 3: adjust timing)."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hid2.agents import FloatArray
from hid2.conflicts.space_time import SpaceTime, block_row, speed_rows
from hid2.kernels.compiled import planner_kernel

#: Steps of a stage of the search.
STAGE_STEPS = 5
_STEEPEST = 1.65  # m/s2 by which the acceleration changes within a stage: a jerk that the smoothing allows too
OVER_MPS = 4.0  # above the desired speed, at most
_S_BIN, _V_BIN, _V_BINS = 1.5, 0.75, 48
_STATES_MOST = 3000
_FARTHEST_STEPS = 3  # between two looks of `farthest`
_STAGES_ROUNDED = 32
_SLOW_MPS = 3.0  # the cost of going slower than desired is linear beyond: nobody slows early to go at the mean speed
_UNFOLLOWED = 10.0  # cost of a speed above the one at which car following brakes, per (m/s)^2
_SECOND_CHOICE = 1e3  # cost of a start that is not the first one named


@dataclass(frozen=True, eq=False, slots=True)
class SpeedPlan:
    """s (T,) m and v (T,) m/s at every step from the first one planned, and its cost."""

    s: FloatArray
    v: FloatArray
    cost: float


def plan_speed(
    tables: SpaceTime,
    desired: FloatArray,
    *,
    s0: float,
    v0: float | Sequence[float],
    a0: float,
    first_step: int,
    accels: FloatArray,
    step_s: float,
    most: FloatArray | None = None,
    reference: FloatArray | None = None,
) -> SpeedPlan | None:
    """Best speed profile on the path from (s0, v0) that meets nobody; None where there is none.

    Search over time, arc length and speed (stages of half a second, constant acceleration in each but the first, in
    which it builds up; one representative per bin of 1.5 m and 0.75 m/s).
    desired (S,) m/s: target speed, exceeded by at most 4 m/s; most (S,) m/s: what the road allows at all.
    accels (N,) m/s2: constant accelerations that a profile is made of, as of `accelerations`.
    v0: speed at the start, or several, of which the first that is possible is taken.
    reference (T,) m: a driven s(t) to stay near, where given. This is "adjust timing" of conflict case 3.
    """
    use_reference = reference is not None
    ok, s, v, cost = search(
        tables.view(), desired, desired + OVER_MPS if most is None else np.minimum(most, desired + OVER_MPS),
        s0, np.atleast_1d(np.asarray(v0, dtype=np.float64)), a0, first_step, tables.num_steps,
        accels, step_s,
        reference if reference is not None else np.zeros(tables.num_steps), use_reference,
        states(tables.num_steps),
    )  # fmt: skip
    if not ok:
        return None
    return SpeedPlan(s=s, v=v, cost=float(cost))


@cache
def accelerations(accel_max: float, accel_min: float) -> FloatArray:
    """(N,) m/s2 that a plan is made of."""
    return np.array([
        accel_min, 0.75 * accel_min, 0.5 * accel_min, 0.25 * accel_min,
        0.0, accel_max / 3, accel_max * 2 / 3, accel_max,
    ])  # fmt: skip


class States(NamedTuple):
    """States of a search, those of all stages one behind the other."""

    s: FloatArray
    v: FloatArray
    a: FloatArray
    cost: FloatArray
    parent: npt.NDArray[np.int32]
    key: npt.NDArray[np.int32]


def states(num_steps: int) -> States:
    """Memory for searches of so many steps, kept: to be given new pages costs a fifth of a search."""
    return _kept((num_steps // STAGE_STEPS + 2) // _STAGES_ROUNDED + 1)


@cache
def _kept(rounded: int) -> States:
    room = _STATES_MOST * _STAGES_ROUNDED * rounded
    return States(
        s=np.empty(room),
        v=np.empty(room),
        a=np.empty(room),
        cost=np.empty(room),
        parent=np.empty(room, dtype=np.int32),
        key=np.empty(room, dtype=np.int32),
    )


@planner_kernel
def _advance(s, v, a, ramp, dt):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """One step at a constant jerk `ramp`; who would roll back stands."""
    then = v + a * dt + 0.5 * ramp * dt * dt
    if then <= 0.0:
        return s + (0.5 * v * dt * v / (v - then) if v > 0.0 else 0.0), 0.0, 0.0
    return s + v * dt + 0.5 * a * dt * dt + ramp * dt * dt * dt / 6.0, then, a + ramp * dt


@planner_kernel
def farthest(view, s0, slowest, fastest, hardest, most, first, steps, dt):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Arc length that nobody gets beyond before step `steps`, m; -inf where others leave no room at some step.

    Much cheaper than a search, whatever is done: what is reached lies between two arc lengths, and who is at either
    takes of it what his interval covers for sure, half a cell less, as places are rounded to cells. Every third step
    is enough to see it. slowest, fastest m/s: of the speeds to begin with; hardest, most m/s2: of the accelerations.
    """
    span = _FARTHEST_STEPS * dt
    low, high, spare = s0, s0, view.margin_m - 0.5 * view.cell_m
    beyond = (view.beyond - 0.5) * view.cell_m
    for t in range(first + _FARTHEST_STEPS, steps, _FARTHEST_STEPS):
        slowest = max(0.0, slowest + hardest * span)
        low += slowest * span
        high += fastest * span + 0.5 * most * span * span
        fastest += most * span
        if low >= beyond and t >= view.earliest_exit_step:
            return np.inf
        if t < view.earliest_exit_step:
            high = min(high, beyond)
        for a in range(view.low.shape[0]):
            rear, front = view.low[a, t] - spare, view.high[a, t] + spare
            if rear < low < front and low < beyond:
                low = front
            if rear < high < front and high < beyond:
                high = rear
        if low > high:
            return -np.inf
    return high + fastest * span + 0.5 * most * span * span


@planner_kernel
def search(view, desired, ceiling, s0, v0, a0, first, steps, accels, dt, reference, use_reference, memory):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """The search of `plan_speed`, with its arguments; whether there is a profile, s, v, and its cost."""
    cells, step, reaction = view.cells, view.cell_m, view.follower.reaction_mps
    hardest, most = accels.min(), accels.max()
    if farthest(view, s0, v0.min(), v0.max(), min(hardest, a0), max(most, a0), first, steps, dt) == -np.inf:
        return False, np.empty(0), np.empty(0), 0.0
    s_bins = int(cells * step / _S_BIN) + 1
    stages = (steps - 1 - first + STAGE_STEPS - 1) // STAGE_STEPS
    out_s = np.zeros(steps - first)
    out_v = np.zeros(steps - first)
    all_s, all_v, all_a, all_c, parent, keys = memory
    begin = np.zeros(stages + 2, dtype=np.int64)
    slot = np.full((s_bins + 1) * _V_BINS, -1, dtype=np.int32)
    blocked = np.empty((STAGE_STEPS + 1, cells), dtype=np.uint8)
    fastest, pushed = np.empty((STAGE_STEPS + 1, cells)), np.empty((STAGE_STEPS + 1, cells))
    followed = np.empty((STAGE_STEPS + 1, cells))
    for i in range(v0.size):
        all_s[i], all_v[i], all_a[i], all_c[i] = s0, v0[i], a0, i * _SECOND_CHOICE
    begin[1] = v0.size
    for k in range(stages):
        t0 = first + k * STAGE_STEPS
        sub = min(STAGE_STEPS, steps - 1 - t0)
        here, there = begin[k], begin[k + 1]
        n_next = 0
        lasting = sub * dt
        left, right = all_s[here], 0.0
        for index in range(here, there):
            left = min(left, all_s[index])
            right = max(right, all_s[index] + all_v[index] * lasting)
        right += 0.5 * most * lasting * lasting
        left_cell = min(cells - 1, max(0, int(left / step + 0.5) - 1))
        right_cell = min(cells, int(right / step + 0.5) + 2)
        for m in range(1, sub + 1):
            block_row(blocked[m], t0 + m, left_cell, right_cell, view)
            if m == sub or m == 3:
                speed_rows(fastest[m], pushed[m], followed[m], t0 + m, left_cell, right_cell, view)
        widen = 1.0 + 0.06 * k  # far ahead, nearby states need not be told apart as finely
        s_bin, v_bin = _S_BIN * widen, _V_BIN * widen
        for index in range(here, there):
            s, v, previous, cost = all_s[index], all_v[index], all_a[index], all_c[index]
            for accel in accels:
                if abs(accel - previous) > _STEEPEST:
                    continue
                # nothing can be prepared before the first stage: there the acceleration needs its time to build up
                sn, vn, an = s, v, previous if k == 0 else accel
                ramp = (accel - previous) / (STAGE_STEPS * dt) if k == 0 else 0.0
                good = True
                extra = 0.0
                for m in range(1, sub + 1):
                    sn, vn, an = _advance(sn, vn, an, ramp, dt)
                    cell = int(sn / step + 0.5)
                    if cell >= cells:
                        cell = cells - 1
                    if blocked[m, cell - left_cell] == 1:
                        good = False
                        break
                    if m != sub and m != 3:  # TTC and speed change slowly: looked up twice a stage
                        continue
                    if vn > fastest[m, cell - left_cell]:
                        good = False
                        break
                    if vn < pushed[m, cell - left_cell]:
                        extra += 7.5 * (pushed[m, cell - left_cell] - vn)
                    if vn > desired[cell] + 0.2:
                        over = vn - desired[cell]
                        if vn > ceiling[cell]:
                            good = False
                            break
                        extra += 5.0 * over * over
                if not good:
                    continue
                cell = min(cells - 1, int(sn / step + 0.5))
                braked = (vn + reaction) ** 2 - followed[sub, cell - left_cell]
                if braked > 0.0:  # car following will not drive this
                    extra += _UNFOLLOWED * (braked / (2.0 * (vn + reaction))) ** 2
                lag = desired[cell] - vn
                if use_reference:
                    off = sn - reference[t0 + sub]
                    new_cost = cost + 0.05 * off * off + 0.1 * lag * lag
                else:
                    slow = abs(lag)
                    new_cost = cost + 0.6 * (slow * slow if slow < _SLOW_MPS else _SLOW_MPS * (2.0 * slow - _SLOW_MPS))
                if vn < 0.5:
                    new_cost += 1.0
                new_cost += extra + 0.5 * accel * accel + 0.8 * (accel - previous) ** 2
                vb = min(_V_BINS - 1, int(vn / v_bin + 0.5))
                sb = min(s_bins, int(sn / s_bin + 0.5))
                key = sb * _V_BINS + vb
                at = slot[key] if k > 0 else -1
                if at < 0:
                    if n_next >= _STATES_MOST:
                        continue
                    at = there + n_next
                    slot[key] = at
                    n_next += 1
                elif all_c[at] <= new_cost:
                    continue
                all_s[at], all_v[at], all_a[at] = sn, vn, accel
                all_c[at] = new_cost
                parent[at] = index
                keys[at] = key
        begin[k + 2] = there + n_next
        if n_next == 0:
            return False, out_s, out_v, 0.0
        for index in range(there, there + n_next):
            slot[keys[index]] = -1
    best = begin[stages]
    for index in range(begin[stages], begin[stages + 1]):
        if all_c[index] < all_c[best]:
            best = index
    total = all_c[best]
    out_s[0] = s0
    for k in range(stages, 0, -1):
        source = parent[best]
        s, v, accel, ramp = all_s[source], all_v[source], all_a[best], 0.0
        if k == 1:
            accel, ramp = all_a[source], (accel - all_a[source]) / (STAGE_STEPS * dt)
        t0 = (k - 1) * STAGE_STEPS
        sub = min(STAGE_STEPS, steps - 1 - first - t0)
        for m in range(1, sub + 1):
            s, v, accel = _advance(s, v, accel, ramp, dt)
            out_s[t0 + m], out_v[t0 + m] = s, v
        best = source
    out_v[0] = all_v[best]
    return True, out_s, out_v, total
