"""Compiled loops of conflict case 3: predicted motion in the space-time (ST) graph of one path."""

import numpy as np

from hid2.kernels.compiled import inner, kernel
from hid2.kernels.gaps import gap_to
from hid2.kernels.path_intervals import PET_MARGIN_M, SAME_WAY
from hid2.kernels.spline import TABLE_STEP_M
from netconvert.geometry import BoolArray, FloatArray, IntArray

# How a driver brakes for what SUMO does not see. No tunables from here to _EASES_BELOW_MPS: chosen on tests' scenes.
STRIDE = 2  # steps from one look at the predicted motion to the next
_PREDICTED_JERK_MPS3 = 4.0  # rate at which predicted braking builds up, m/s3
_BRAKING_LASTS_S = 1.0  # time for which an inserted vehicle that brakes is predicted to brake on, s
_HARDEST_RATIO = 0.9  # hardest braking for an agent that appears ahead, over the driver's deceleration
_LINES_WITHIN_M = 60.0  # look-ahead for closed stop lines, m: those farther off matter to no driver yet
_AMBER_RATIO = 0.85  # braking, over the driver's deceleration, above which a closed line is crossed, as at amber
_ROLLS_MPS = 0.1  # least speed by which it is told which of two vehicles comes first, m/s: of two that stand the nearer
SWEPT_STEP_M = 1.0  # spacing of the places along generated vehicles' ways at which what they sweep is known, m
#: Share of its deceleration at which a driver rolls up to a line; time to take up the speed for that, s. No tunables.
ROLLS_UP_SHARE, _TAKES_UP_S = 0.6, 0.5
_PASSED_M = 0.3  # tolerance: distance beyond a stop line above which it is passed; no tunable
#: Stopping at a line, never at a constant deceleration: it builds up and eases. Ratio of needed to usual braking at
#: which a driver begins, and of its own braking to the needed one then; rise of the second ratio for each usual braking
#: needed, its bound, and what is added to it at standstill, growing from 0 at a speed, m/s. No tunables.
_BEGINS, _BUILDS_UP, _AT_MOST, _EASES, _EASES_BELOW_MPS = 0.7, 1.2, 1.3, 0.4, 5.0


@inner
def predicted_s(s: float, v: float, a: float, ahead_s: float) -> float:
    """Arc length of a vehicle ahead_s from now: constant speed, or braking on for a while and then constant speed."""
    if a >= 0.0:
        return s + v * ahead_s
    braking = min(ahead_s, _BRAKING_LASTS_S, v / -a)
    slower = max(0.0, v + a * min(ahead_s, _BRAKING_LASTS_S))
    return s + v * braking + 0.5 * a * braking * braking + slower * (ahead_s - braking)


@inner
def _accel_towards_stop(ahead_m: float, speed_mps: float, accel_mps2: float, decel_mps2: float) -> float:
    """Acceleration of a driver that comes to stand ahead_m from here, m/s2.

    Kinematic rather than IDM: a driver lets the car roll up to a line, and does not begin far before it.
    """
    if ahead_m <= 0.1:
        return -decel_mps2
    needed = speed_mps * speed_mps / (2.0 * ahead_m)
    usual = ROLLS_UP_SHARE * decel_mps2
    if needed < _BEGINS * usual:
        reach: float = np.sqrt(2.0 * _BEGINS * usual * ahead_m)  # from which so little braking ends at the line
        return min(accel_mps2, (reach - speed_mps) / _TAKES_UP_S)
    builds_up = min(_BEGINS + _BUILDS_UP * (needed / usual - _BEGINS), _AT_MOST)
    return -needed * (builds_up + _EASES * max(0.0, 1.0 - speed_mps / _EASES_BELOW_MPS))


@inner
def _line_ahead(stop_m: FloatArray, closed: BoolArray, s: float, v: float, step: int, decel_mps2: float) -> int:
    """Row of the next stop line that is closed at a step and at which the driver can stop, -1 for none.

    A line at which the driver can no longer stop without braking hard is driven across, as an amber light is.
    """
    for row in range(stop_m.size):
        ahead = stop_m[row] - s
        if ahead < -_PASSED_M or not closed[row, min(step, closed.shape[1] - 1)]:
            continue
        if ahead > _LINES_WITHIN_M:
            return -1
        if v * v <= 2.0 * (_AMBER_RATIO * decel_mps2) * max(ahead, 0.05) or v <= 1.0:
            return row
    return -1


@kernel("(f8[::1], b1[:,::1], f8, f8, i8, f8, f8)")
def stop_ahead(
    stop_m: FloatArray, closed: BoolArray, s: float, v: float, step: int, accel_mps2: float, decel_mps2: float
) -> tuple[int, float]:
    """Row of the next closed stop line ahead at which a driver can stop, -1 for none, and the acceleration, m/s2."""
    row = _line_ahead(stop_m, closed, s, v, step, decel_mps2)
    return row, _accel_towards_stop(stop_m[row] - s, v, accel_mps2, decel_mps2) if row >= 0 else 0.0


@inner
def _has_priority(low: FloatArray, own_low: FloatArray, fleet: FloatArray, j: int, own: int, own_m: float) -> bool:
    """Whether generated vehicle j goes first (case 2): one of two does, as both compare the same distances and speeds.

    Closer in time: by metres alone the right would change over while a faster one comes up, too late for the other to
    brake. low, own_low (K,): of each on the way of the other; own_m: own arc length.
    """
    theirs, mine = _metres_to(low, fleet[j, 0]), _metres_to(own_low, own_m)
    if min(theirs, mine) > 0.0:
        if fleet[j, 3] != fleet[own, 3]:
            return bool(fleet[j, 3] > fleet[own, 3])
        theirs, mine = theirs * max(fleet[own, 1], _ROLLS_MPS), mine * max(fleet[j, 1], _ROLLS_MPS)
    return theirs < mine or (theirs == mine and j < own)


@inner
def _metres_to(low: FloatArray, s: float) -> float:
    """Metres from an arc length to where the way is shared from; negative once it is shared: the farther in leads."""
    begin = max(int(s / SWEPT_STEP_M), 0)
    while begin < low.size and low[begin] == np.inf:
        begin += 1
    while 0 < begin < low.size and low[begin - 1] != np.inf:
        begin -= 1
    return begin * SWEPT_STEP_M - s


@inner
def _is_on(low: FloatArray, cosine: FloatArray, s: float) -> bool:
    """Whether a generated vehicle is on the way that it shares, so that SUMO's car following sees it."""
    at = int(s / SWEPT_STEP_M)
    return bool(0 <= at < low.size and low[at] != np.inf and cosine[at] > SAME_WAY)


@inner
def _ahead_within(low: FloatArray, high: FloatArray, s: float, begin: int, end: int) -> IntArray:
    """Agents ahead of s, with some of their length, at some of the steps from `begin` to before `end`.

    low, high (A, T): as in `gap_to`. No motion that goes on from s meets an agent that stays behind it.
    """
    found, count = np.empty(low.shape[0], dtype=np.int64), 0
    for a in range(low.shape[0]):
        for t in range(begin, end):
            if low[a, t] != np.inf and high[a, t] > s:
                found[count] = a
                count += 1
                break
    return found[:count]


@inner
def _first_conflict(
    low: FloatArray, high: FloatArray, along: FloatArray, same_direction: BoolArray, stop_m: FloatArray,
    closed: BoolArray, swept: FloatArray, rows: IntArray, fleet: FloatArray, agents: IntArray, goes_first: BoolArray,
    t: int, start: tuple[float, float, float], desired_mps: float, road: FloatArray, last: int, step_s: float,
    driver: tuple[float, float, float, float], brakes: FloatArray, row: int,
) -> tuple[int, bool, bool, int, float, bool]:  # fmt: skip
    """Steps from t to the first conflict of motion with one of `brakes`, -1 for none; arguments as `needed_braking`.

    One long loop: in functions of its own, which numba does not inline, a rollout takes up to 1.9 times as long.
    agents: rows of `low` that matter; goes_first (G,): whether each of `rows` does. Returns also whether the conflict
    is with a leader, whether a known agent comes up from behind, the generated leader and the gap to it, as there, and
    whether harder braking than that of the row would be another motion.
    """
    g_low, g_high, g_cos, _ = swept
    s, v, a_cmd = start
    tau, accel, decel, min_gap = driver
    margin, hardest, dt = PET_MARGIN_M, _HARDEST_RATIO * decel, STRIDE * step_s
    struck, leader, leader_gap, is_bound = False, -1, np.inf, row == 0
    for k in range(last + 1):
        now, ahead_s = min(t + k * STRIDE, low.shape[1] - 1), k * STRIDE * step_s
        gap_least, closing, met, seen, is_leader = np.inf, 0.0, False, False, False
        for a in agents:
            lo, hi = low[a, now], high[a, now]
            if lo == np.inf:
                continue
            gap, leads = gap_to(lo, hi, s)
            if (lo < s < hi and k > 0) or (lo - margin < s < hi and k > 0 and not same_direction[a, now]):
                if (same_direction[a, now] or along[a, now] > 1.0) and not leads:
                    struck = True
                    continue
                met, is_leader = True, abs(along[a, now]) < 0.5  # it stands: brake as hard as is allowed
                break
            if same_direction[a, now] and leads and gap < gap_least:
                gap_least, closing = gap, v - along[a, now]
                seen = same_direction[a, t] and gap_to(low[a, t], high[a, t], start[0])[1]
        if met:
            return k * STRIDE, is_leader, struck, leader, leader_gap, is_bound
        for g in range(rows.size):
            j = rows[g]
            at = int(predicted_s(fleet[j, 0], fleet[j, 1], fleet[j, 2], ahead_s) / SWEPT_STEP_M)
            if fleet[j, 4] == 0.0 or at < 0 or at >= g_low.shape[1] or g_low[g, at] == np.inf:
                continue
            lo, hi = g_low[g, at], g_high[g, at]
            gap, leads = gap_to(lo, hi, s)
            if g_cos[g, at] > SAME_WAY and (leads or gap >= 0.0):  # the one behind it has its driver
                if leads and gap < gap_least and goes_first[g]:
                    gap_least, closing = gap, v - fleet[j, 1] * g_cos[g, at]
                    seen = _is_on(g_low[g], g_cos[g], fleet[j, 0])
                    if k == 0:
                        leader, leader_gap = j, gap
            elif lo - 2 * margin < s < hi + 2 * margin and k > 0 and goes_first[g]:  # both move between looks
                return k * STRIDE, False, struck, leader, leader_gap, is_bound
        wanted = min(desired_mps, road[min(int(s / TABLE_STEP_M), road.size - 1)])
        a_next = max(-decel, accel * (1.0 - (v / max(wanted, 0.1)) ** 4))
        if gap_least < 1e3:
            star = min_gap + max(0.0, v * tau + v * closing / (2.0 * np.sqrt(accel * decel)))
            a_next = min(a_next, accel * (1.0 - (star / max(gap_least, 0.1)) ** 2))
            # for a leader that it sees SUMO brakes by itself, in time
            most = max(hardest, brakes[-1]) if seen else hardest
            if a_next < -most and k > 0 and not (seen and start[1] < 0.1):
                # one that appears ahead, or stands, asks for more than a driver would brake
                return k * STRIDE, True, struck, leader, leader_gap, is_bound
            a_next = max(a_next, -most)
        line = _line_ahead(stop_m, closed, s, v, now, decel)
        if line >= 0:
            a_next = min(a_next, _accel_towards_stop(stop_m[line] - s, v, accel, decel))
        if row > 0:
            a_cmd = max(min(a_cmd, 0.0) - _PREDICTED_JERK_MPS3 * STRIDE * step_s, -brakes[row])
            a_next = min(a_next, a_cmd)
        v_next = max(0.0, v + a_next * dt)
        is_bound |= a_cmd == -brakes[row] and v_next > 0.0
        s, v = s + 0.5 * (v + v_next) * dt, v_next
    return -1, False, struck, leader, leader_gap, is_bound


@kernel(
    "(f8[:,::1], f8[:,::1], f8[:,::1], b1[:,::1], f8[::1], b1[:,::1], f8[:,:,::1], i8[::1], f8[:,::1], i8, i8,"
    " UniTuple(f8, 3), f8, f8[::1], i8, f8, UniTuple(f8, 4), f8[::1])"
)
def needed_braking(
    low: FloatArray, high: FloatArray, along: FloatArray, same_direction: BoolArray, stop_m: FloatArray,
    closed: BoolArray, swept: FloatArray, rows: IntArray, fleet: FloatArray, own: int, t: int,
    start: tuple[float, float, float], desired_mps: float, road: FloatArray, horizon: int, step_s: float,
    driver: tuple[float, float, float, float], brakes: FloatArray,
) -> tuple[int, int, int, int, float, bool]:  # fmt: skip
    """Smallest constant braking (of `brakes`, m/s2, ascending from 0) that meets no agent; if all do, about the latest.

    low, high, along, same_direction (A, T): agents with a known future, as in `PathOccupancy`. stop_m (L,) m, closed
    (L, T): stop lines. swept (4, G, K): as in `Obstacles`, of rows (G,) of fleet (N, 5): s, v, a, executing, present.
    start: own s, v, a; driver: tau s, acceleration, deceleration m/s2, gap at standstill m. Returns (row of brakes,
    step of its first conflict or -1, step of the first conflict without braking or -1, fleet row of the nearest
    generated leader or -1, gap to it m, whether some known agent comes up from behind).
    """
    last, steps = horizon // STRIDE, low.shape[1]
    agents = _ahead_within(low, high, start[0], min(t, steps - 1), min(t + last * STRIDE, steps - 1) + 1)
    goes_first = np.empty(rows.size, dtype=np.bool_)
    for g in range(rows.size):
        goes_first[g] = _has_priority(swept[0, g], swept[3, g], fleet, rows[g], own, start[0])
    best, best_step, free_step, leader, leader_gap, run_into, is_bound = 0, 0, -1, -1, np.inf, False, True
    for row in range(brakes.size):
        if is_bound:
            hit, behind_leader, struck, ahead, gap, is_bound = _first_conflict(
                low, high, along, same_direction, stop_m, closed, swept, rows, fleet, agents, goes_first, t, start,
                desired_mps, road, last, step_s, driver, brakes, row,
            )  # fmt: skip
        if row == 0:
            free_step, leader, leader_gap = hit, ahead, gap
        if hit < 0:
            return row, -1, free_step, leader, leader_gap, struck
        if row == 0 or hit > best_step + STRIDE or (hit >= best_step and (behind_leader or not struck)):
            best, best_step, run_into = row, hit, struck
    return best, best_step, free_step, leader, leader_gap, run_into
