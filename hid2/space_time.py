"""Where others are along a path, at each step: the space-time view behind every check for conflicts.

Boxes of others are turned into forbidden intervals of the own centre's arc length. Recorded agents enter with their
true future, generated ones with their predicted one (paper, Trajectory Generation, conflict case 3).
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from hid2.agents import FloatArray
from hid2.reference_line import TABLE_STEP_M, ReferenceLine
from hid2.traffic import Traffic


@dataclass(frozen=True, eq=False, slots=True)
class PathOccupancy:
    """Forbidden intervals of the own box centre on one path.

    low, high (A, T) m: the own box touches the agent's (with the lateral margin) while low < s < high; low is +inf and
    high is -inf where it never does. along (A, T) m/s: the agent's speed in the path's direction there.
    aligned (A, T): it moves with the path (a leader or follower) rather than across or against it.
    """

    low: FloatArray
    high: FloatArray
    along: FloatArray
    aligned: np.ndarray[tuple[int, int], np.dtype[np.bool_]]

    def joined(self, other: "PathOccupancy") -> "PathOccupancy":
        """Agents of both, self first."""
        return PathOccupancy(
            low=np.concatenate([self.low, other.low]),
            high=np.concatenate([self.high, other.high]),
            along=np.concatenate([self.along, other.along]),
            aligned=np.concatenate([self.aligned, other.aligned]),
        )


def path_occupancy(
    line: ReferenceLine, traffic: Traffic, *, length_m: float, width_m: float, margin_lateral_m: float
) -> PathOccupancy:
    """Intervals of every agent of `traffic` on `line` for a box of the given size. Only agents that ever touch it."""
    low, high, near = _intervals(
        line.table_xy,
        line.table_heading,
        TABLE_STEP_M,
        length_m,
        width_m + 2 * margin_lateral_m,
        traffic.position,
        traffic.heading,
        traffic.present,
        traffic.length_m,
        traffic.width_m,
    )
    touched = np.isfinite(low).any(axis=1)
    low, high, near = low[touched], high[touched], near[touched]
    heading = line.table_heading[near]
    velocity = traffic.velocity[touched]
    along = velocity[..., 0] * np.cos(heading) + velocity[..., 1] * np.sin(heading)
    aligned = np.cos(traffic.heading[touched] - heading) > 0.7
    return PathOccupancy(low=low, high=high, along=along, aligned=aligned)


@njit(cache=True)
def _overlap(
    ax: float, ay: float, ac: float, asn: float, al: float, aw: float,
    bx: float, by: float, bc: float, bs: float, bl: float, bw: float,
) -> bool:  # fmt: skip
    """Separating axes of two boxes given by centre, cosine and sine of the heading, half length and half width."""
    dx, dy = bx - ax, by - ay
    c, s = abs(ac * bc + asn * bs), abs(ac * bs - asn * bc)
    if abs(dx * ac + dy * asn) > al + bl * c + bw * s:
        return False
    if abs(-dx * asn + dy * ac) > aw + bl * s + bw * c:
        return False
    if abs(dx * bc + dy * bs) > bl + al * c + aw * s:
        return False
    return not abs(-dx * bs + dy * bc) > bw + al * s + aw * c


@njit(cache=True)
def _intervals(xy, heading, step, own_length, own_width, position, other_heading, present, lengths, widths):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """March along the path in steps that cannot jump over the agent, then test box against box."""
    agents, steps = present.shape
    points = xy.shape[0]
    low = np.full((agents, steps), np.inf)
    high = np.full((agents, steps), -np.inf)
    near = np.zeros((agents, steps), dtype=np.int64)
    cosine, sine = np.cos(heading), np.sin(heading)
    own_l, own_w = own_length / 2, own_width / 2
    own_radius = np.hypot(own_l, own_w)
    for a in range(agents):
        half_l, half_w = lengths[a] / 2, widths[a] / 2
        reach = own_radius + np.hypot(half_l, half_w)
        for t in range(steps):
            if not present[a, t]:
                continue
            x, y, angle = position[a, t, 0], position[a, t, 1], other_heading[a, t]
            if (
                t > 0
                and present[a, t - 1]
                and x == position[a, t - 1, 0]
                and y == position[a, t - 1, 1]
                and angle == other_heading[a, t - 1]
            ):
                low[a, t], high[a, t], near[a, t] = low[a, t - 1], high[a, t - 1], near[a, t - 1]
                continue
            bc, bs = np.cos(angle), np.sin(angle)
            i = 0
            best = np.inf
            while i < points:
                distance = np.hypot(x - xy[i, 0], y - xy[i, 1])
                if distance < best:
                    best = distance
                    near[a, t] = i
                if distance > reach:
                    i += max(1, int((distance - reach) / step))
                    continue
                if _overlap(xy[i, 0], xy[i, 1], cosine[i], sine[i], own_l, own_w, x, y, bc, bs, half_l, half_w):
                    low[a, t] = min(low[a, t], (i - 1) * step)
                    high[a, t] = max(high[a, t], (i + 1) * step)
                i += 1
    return low, high, near


@dataclass(frozen=True, eq=False, slots=True)
class SpaceTime:
    """Tables over steps and arc length (TABLE_STEP_M) for the search of a speed profile.

    blocked (T, S): the own centre may not be there then. fastest (T, S) m/s: speed at which the TTC to the aligned
    leader ahead is still the critical one. pushed (T, S) m/s: slower than this, a follower closes in too fast.
    """

    blocked: np.ndarray[tuple[int, int], np.dtype[np.uint8]]
    fastest: FloatArray
    pushed: FloatArray


def space_time(
    occupancy: PathOccupancy,
    *,
    table_length: int,
    num_steps: int,
    margin_m: float,
    ttc_s: float,
    time_gap_s: float,
    exit_s: float,
    earliest_exit_step: int,
) -> SpaceTime:
    """Tables from intervals. exit_s: arc length at which the path leaves the map, not before earliest_exit_step."""
    blocked, fastest, pushed = _tables(
        occupancy.low,
        occupancy.high,
        occupancy.along,
        occupancy.aligned,
        num_steps,
        table_length,
        TABLE_STEP_M,
        margin_m,
        ttc_s,
        time_gap_s,
    )
    beyond = int(exit_s / TABLE_STEP_M)  # off the map nobody is met; to be there too early is forbidden
    blocked[:, beyond:] = 0
    fastest[:, beyond:] = np.inf
    pushed[:, beyond:] = 0.0
    blocked[:earliest_exit_step, beyond:] = 1
    return SpaceTime(blocked=blocked, fastest=fastest, pushed=pushed)


@njit(cache=True)
def _tables(low, high, along, aligned, steps, cells, step, margin, ttc, time_gap):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    blocked = np.zeros((steps, cells), dtype=np.uint8)
    fastest = np.full((steps, cells), 99.0)
    pushed = np.zeros((steps, cells))
    for a in range(low.shape[0]):
        for t in range(steps):
            if low[a, t] == np.inf:
                continue
            front, rear = low[a, t] - margin, high[a, t] + margin
            first = min(max(0, int(np.ceil(front / step))), cells)
            last = max(-1, min(cells - 1, int(np.floor(rear / step))))
            for i in range(first, last + 1):
                blocked[t, i] = 1
            if not aligned[a, t]:
                continue
            speed = along[a, t]
            for i in range(max(0, first - int(80.0 / step)), first):
                gap = front - i * step
                limit = speed + gap / ttc
                if time_gap > 0:
                    limit = min(limit, max(speed, (gap + margin) / time_gap) if gap < speed * time_gap else limit)
                if limit < fastest[t, i]:
                    fastest[t, i] = limit
            for i in range(last + 1, min(cells, last + 1 + int(40.0 / step))):
                needed = speed - (i * step - rear) / ttc
                if needed > pushed[t, i]:
                    pushed[t, i] = needed
    return blocked, fastest, pushed


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
    v0: float,
    a0: float,
    first_step: int,
    accel_max: float,
    accel_min: float,
    step_s: float,
    reference: FloatArray | None = None,
) -> SpeedPlan | None:
    """Best speed profile on the path from (s0, v0) that meets nobody; None where there is none.

    Search over time, arc length and speed (stages of half a second, constant acceleration in each; one
    representative per bin of 1.5 m and 0.75 m/s). desired (S,) m/s: target speed, never exceeded by much.
    reference (T,) m: a driven s(t) to stay near, where given. This is "adjust timing" of conflict case 3.
    """
    steps = tables.blocked.shape[0]
    accels = np.array(
        [
            accel_min,
            0.75 * accel_min,
            0.5 * accel_min,
            0.25 * accel_min,
            0.0,
            accel_max / 3,
            accel_max * 2 / 3,
            accel_max,
        ]
    )
    use_reference = reference is not None
    ok, s, v, cost = _search(
        tables.blocked, tables.fastest, tables.pushed, desired, TABLE_STEP_M, s0, v0, a0, first_step, steps, accels,
        step_s, reference if reference is not None else np.zeros(steps), use_reference,
    )  # fmt: skip
    if not ok:
        return None
    return SpeedPlan(s=s, v=v, cost=float(cost))


STAGE_STEPS = 5
_S_BIN, _V_BIN, _V_BINS = 1.5, 0.75, 48


@njit(cache=True)
def _search(blocked, fastest, pushed, desired, step, s0, v0, a0, first, steps, accels, dt, reference, use_reference):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    cells = blocked.shape[1]
    s_bins = int(cells * step / _S_BIN) + 1
    stages = (steps - 1 - first + STAGE_STEPS - 1) // STAGE_STEPS
    out_s = np.zeros(steps - first)
    out_v = np.zeros(steps - first)
    capacity = 3000
    all_s = np.empty((stages + 1, capacity))
    all_v = np.empty((stages + 1, capacity))
    all_a = np.empty((stages + 1, capacity))
    all_c = np.empty((stages + 1, capacity))
    parent = np.empty((stages + 1, capacity), dtype=np.int32)
    counts = np.zeros(stages + 1, dtype=np.int64)
    slot = np.full((s_bins + 1) * _V_BINS, -1, dtype=np.int32)
    all_s[0, 0], all_v[0, 0], all_a[0, 0], all_c[0, 0] = s0, v0, a0, 0.0
    counts[0] = 1
    for k in range(stages):
        slot[:] = -1
        n_next = 0
        t0 = first + k * STAGE_STEPS
        sub = min(STAGE_STEPS, steps - 1 - t0)
        widen = 1.0 + 0.06 * k  # far ahead, nearby states need not be told apart as finely
        s_bin, v_bin = _S_BIN * widen, _V_BIN * widen
        for index in range(counts[k]):
            s, v, previous, cost = all_s[k, index], all_v[k, index], all_a[k, index], all_c[k, index]
            for accel in accels:
                if abs(accel - previous) > 1.7:  # what bounded jerk reaches within a stage
                    continue
                vn, sn = v, s
                good = True
                extra = 0.0
                for m in range(1, sub + 1):
                    tau = m * dt
                    vn = v + accel * tau
                    if vn <= 0.0:
                        stop = v / -accel if accel < 0 else 0.0
                        sn = s + v * stop + 0.5 * accel * stop * stop
                        vn = 0.0
                    else:
                        sn = s + v * tau + 0.5 * accel * tau * tau
                    cell = int(sn / step + 0.5)
                    if cell >= cells:
                        cell = cells - 1
                    if blocked[t0 + m, cell] == 1:
                        good = False
                        break
                    if m != sub and m != 3:  # TTC and speed change slowly: looked up twice a stage
                        continue
                    if vn > fastest[t0 + m, cell]:
                        good = False
                        break
                    if vn < pushed[t0 + m, cell]:
                        extra += 7.5 * (pushed[t0 + m, cell] - vn)
                    if vn > desired[cell] + 0.2:
                        over = vn - desired[cell]
                        if over > 4.0:
                            good = False
                            break
                        extra += 5.0 * over * over
                if not good:
                    continue
                cell = min(cells - 1, int(sn / step + 0.5))
                lag = desired[cell] - vn
                if use_reference:
                    off = sn - reference[t0 + sub]
                    new_cost = cost + 0.05 * off * off + 0.1 * lag * lag
                else:
                    new_cost = cost + 0.6 * lag * lag
                if vn < 0.5:
                    new_cost += 1.0
                new_cost += extra + 0.5 * accel * accel + 0.8 * (accel - previous) ** 2
                vb = min(_V_BINS - 1, int(vn / v_bin + 0.5))
                sb = min(s_bins, int(sn / s_bin + 0.5))
                key = sb * _V_BINS + vb
                at = slot[key]
                if at < 0:
                    if n_next >= capacity:
                        continue
                    at = n_next
                    slot[key] = at
                    n_next += 1
                elif all_c[k + 1, at] <= new_cost:
                    continue
                all_s[k + 1, at], all_v[k + 1, at], all_a[k + 1, at] = sn, vn, accel
                all_c[k + 1, at] = new_cost
                parent[k + 1, at] = index
        counts[k + 1] = n_next
        if n_next == 0:
            return False, out_s, out_v, 0.0
    best = 0
    for index in range(counts[stages]):
        if all_c[stages, index] < all_c[stages, best]:
            best = index
    total = all_c[stages, best]
    out_s[0], out_v[0] = s0, v0
    for k in range(stages, 0, -1):
        source = parent[k, best]
        s, v, accel = all_s[k - 1, source], all_v[k - 1, source], all_a[k, best]
        t0 = (k - 1) * STAGE_STEPS
        sub = min(STAGE_STEPS, steps - 1 - first - t0)
        for m in range(1, sub + 1):
            tau = m * dt
            vn = v + accel * tau
            if vn <= 0.0:
                stop = v / -accel if accel < 0 else 0.0
                out_s[t0 + m] = s + v * stop + 0.5 * accel * stop * stop
                out_v[t0 + m] = 0.0
            else:
                out_s[t0 + m] = s + v * tau + 0.5 * accel * tau * tau
                out_v[t0 + m] = vn
        best = source
    return True, out_s, out_v, total
