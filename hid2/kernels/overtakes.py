"""Compiled loops: motions out, past and back between everybody known, and slower vehicles that drive on."""

import math

import numpy as np

from hid2.kernels.compiled import inner, kernel
from hid2.kernels.gaps import gap_to
from netconvert.geometry import BoolArray, FloatArray, IntArray

# No tunables: half widths of usual cars and of lanes, on the curve of `motion/lane_change_path.py`, with some to spare.
#: Shares of a lateral motion: the lane entered is touched from the first on, the lane left up to the second.
_ENTERS, _LEAVES = 0.25, 0.7
#: Share of a lateral motion after which two usual cars do not overlap any more; kept to who is behind there, m.
_OUT_OF_THE_WAY, _TOUCHES_M = 0.6, 1.0


@inner
def _is_free(
    s: float, v: float, look: int, spans: FloatArray, same_direction: BoolArray, first: IntArray, stop_s: FloatArray,
    closed: BoolArray, keeps: FloatArray,
) -> bool:  # fmt: skip
    """Whether a box at s, m, with v, m/s, touches nobody, closes in on nobody, and can stop where it has to."""
    margin, headway, ttc, stops = keeps[0], keeps[1], keeps[2], keeps[3]
    for row in range(first[look], first[look + 1]):
        gap, leads = gap_to(spans[row, 0], spans[row, 1], s)
        closing = v - spans[row, 2] if leads else spans[row, 2] - v
        kept = margin + headway * v if leads else margin
        if gap <= margin or (same_direction[row] and gap < max(kept, ttc * closing)):
            return False
    for line in range(stop_s.size):
        room = stop_s[line] - s
        if closed[line, look] and room > 0.0 and v * v > 2.0 * stops * room:
            return False
    return True


@inner
def _may_enter(
    at: float, look: int, spans: FloatArray, first: IntArray, desired: float, exit_s: float, gaps: FloatArray
) -> bool:
    """Whether Algorithm 1 lets a vehicle onto the lane beside at a place there, m."""
    corridor, front, rear = gaps[2], gaps[3], gaps[4]
    if exit_s - at < corridor:
        return False
    for row in range(first[look], first[look + 1]):
        gap, leads = gap_to(spans[row, 0], spans[row, 1], at)
        if gap < ((front if spans[row, 2] >= desired else corridor) if leads else rear):
            return False
    return True


@inner
def _next_speed(
    v: float, gap: float, closing: float, look_s: float, driver: FloatArray, bend_mps: float, most: float
) -> float:
    """Speed of a driver at the next look by the intelligent driver model, m/s; gap inf: nobody is followed.

    bend_mps: to which it brakes in a lateral motion; most: what the road allows.
    """
    desired, accel, decel, tau, min_gap = driver[0], driver[1], driver[2], driver[3], driver[4]
    gap_m = min_gap + max(0.0, v * tau + v * closing / (2.0 * math.sqrt(accel * decel)))
    asked = accel * (1.0 - (v / desired) ** 4 - (gap_m / max(gap, 0.5)) ** 2)
    faster = max(0.0, v + min(max(asked, -decel), accel) * look_s)
    if faster > bend_mps:
        faster = max(bend_mps, v - decel * look_s)
    return float(min(faster, most))


@kernel("(f8[::1], f8[::1], i8, f8, f8, f8[:,::1], b1[::1], i8[::1], f8[::1], b1[:,::1], f8[::1],)")
def drives_on(
    start_s: FloatArray, speed: FloatArray, looks: int, look_s: float, exit_s: float, spans: FloatArray,
    same_direction: BoolArray, first: IntArray, stop_s: FloatArray, closed: BoolArray, keeps: FloatArray,
) -> BoolArray:  # fmt: skip
    """(N,) whether vehicles at constant speeds, m/s, from places, m, meet nobody up to the end of path or scene.

    Everybody on the path at each of so many looks, look_s apart: spans (M, 3) low and high, m, and speed along, m/s;
    same_direction (M,); those at look k are the rows from first[k] to first[k + 1]. stop_s (L,) m, closed (L, K): stop
    lines. keeps: margin m, headway s, TTC s, braking m/s2.
    """
    free = np.ones(start_s.size, dtype=np.bool_)
    for n in range(start_s.size):
        for look in range(looks):
            s = start_s[n] + speed[n] * look_s * look
            if s > exit_s:
                break
            if not _is_free(s, speed[n], look, spans, same_direction, first, stop_s, closed, keeps):
                free[n] = False
                break
    return free


@kernel(
    "(f8[::1], f8[::1], f8[:,::1], f8, f8[::1], f8[::1], f8[::1], f8[::1], f8[::1], f8, f8[::1], f8, "
    "f8[:,::1], b1[::1], i8[::1], f8[::1], b1[:,::1], f8[:,::1], b1[::1], i8[::1], f8[::1], b1[:,::1],)"
)
def overtakes_done(
    start_s: FloatArray, start_mps: FloatArray, leader: FloatArray, look_s: float, driver: FloatArray,
    stretch: FloatArray, times: FloatArray, gaps: FloatArray, road: FloatArray, road_step: float, beside_s: FloatArray,
    beside_step: float, spans: FloatArray, same_direction: BoolArray, first: IntArray, stop_s: FloatArray,
    closed: BoolArray, beside_spans: FloatArray, beside_same_direction: BoolArray, beside_first: IntArray,
    beside_stop_s: FloatArray, beside_closed: BoolArray,
) -> FloatArray:  # fmt: skip
    """(N,) time, s, at which vehicles are back in their lane ahead of their leader; inf where somebody is met before.

    start_s, m, and start_mps of each; leader (N, K) m: centres at each look, -inf where there is none. driver: desired
    speed, acceleration, deceleration, time gap, gap at a standstill, m/s in a lateral motion for each m/s at which it
    is laid out, speed below which one goes with the length driven, length of a box. stretch: begin and end side by
    side, and the ends of both paths, m. times: trigger, how long it may wait, lasting of a lateral motion, latest end,
    s; then what `drives_on` keeps. gaps: d_obs, gap of the return,
    corridor, front and rear, m. road (S,) m/s at each road_step of the path, beside_s (G,) m at each beside_step.
    Then everybody and the stop lines on both paths, as in `drives_on`.
    """
    desired, bend, slow, length = driver[0], driver[5], driver[6], driver[7]
    begin, end, exit_s, beside_exit = stretch
    trigger, waits, lasting, latest = times[:4]
    keeps, ttc = times[4:], times[6]
    looks = leader.shape[1]
    done = np.full(start_s.size, np.inf)
    for n in range(start_s.size):
        s, v = start_s[n], start_mps[n]
        laid = 0.0
        out, back, back_in_lane = -1.0, -1.0, np.inf  # of the lateral motions: their clocks, -1 before they begin
        for look in range(looks):
            time_s, ahead = look * look_s, leader[n, look]
            there = math.isfinite(ahead)
            if not there and back < 0.0:
                back_in_lane = np.inf
                break
            gap = ahead - s - length if there else 0.0
            place = min(s / beside_step, beside_s.size - 1.0)
            knot = min(int(place), beside_s.size - 2)
            beside = beside_s[knot] + (place - knot) * (beside_s[knot + 1] - beside_s[knot])
            if out < 0.0 and time_s >= trigger - 1e-9:
                if (
                    s >= begin
                    and gap < gaps[0]
                    and _may_enter(beside, look, beside_spans, beside_first, desired, beside_exit, gaps)
                ):
                    out, laid = 0.0, max(0.5 * (v + max(v, desired)), slow)
                elif time_s > trigger + waits:
                    break
            if out >= 1.0 and back < 0.0 and -gap - 2.0 * length > gaps[1]:
                back, laid = 0.0, max(0.5 * (v + max(v, desired)), slow)
            if back >= 1.0:
                back_in_lane = min(back_in_lane, time_s)
            if not math.isfinite(back_in_lane) and (s >= end or time_s > latest):
                break
            before, after = leader[n, max(look - 1, 0)], leader[n, min(look + 1, looks - 1)]
            leads = there and math.isfinite(before) and math.isfinite(after)
            span_s = look_s * (min(look + 1, looks - 1) - max(look - 1, 0))
            closing = v - (after - before) / span_s if leads else v
            behind = out < _OUT_OF_THE_WAY
            if behind and gap <= max(_TOUCHES_M, ttc * closing):
                back_in_lane = np.inf
                break
            on_own = out < _LEAVES or back > _ENTERS
            if on_own and s <= exit_s and not _is_free(s, v, look, spans, same_direction, first, stop_s, closed, keeps):
                back_in_lane = np.inf
                break
            on_beside = out > _ENTERS and back < _LEAVES
            if on_beside and not _is_free(
                beside, v, look, beside_spans, beside_same_direction, beside_first, beside_stop_s, beside_closed, keeps
            ):
                back_in_lane = np.inf
                break
            moves = 0.0 <= out < 1.0 or 0.0 <= back < 1.0
            most = road[min(int(s / road_step), road.size - 1)]
            faster = _next_speed(
                v, gap if out < 0.0 else np.inf, closing, look_s, driver, bend * laid if moves else np.inf, most
            )
            gained = min(v / slow, 1.0) * look_s / lasting
            out, back = out + gained if out >= 0.0 else out, back + gained if back >= 0.0 else back
            s, v = s + 0.5 * (v + faster) * look_s, faster
        if back_in_lane <= latest:
            done[n] = back_in_lane
    return done
