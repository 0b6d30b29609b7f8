"""The rollout: how a vehicle would drive on by SUMO's car following and the guard, and what it would meet.

Each step is that of the simulation, but for slowing down for a gap and taking another way: limits of speed as
`steering` has them, the car-following law without its noise, the same ballistic step. What it meets is told by the
intervals of agents with known motion.
"""

import numpy as np

from hid2.kernels.car_following import DRIVER_STATE, PREVIEW_S, eidm_speed, new_driver
from hid2.kernels.compiled import inner, kernel
from hid2.kernels.gaps import LEADS_FROM_M, SHOWN_M, gap_to
from hid2.kernels.steering import limit_of
from netconvert.geometry import BoolArray, FloatArray, IntArray

#: Columns of the table that `met_by` returns.
CONTACT, LEAD_TTC, LAG_TTC = range(3)


@inner
def _leader(
    middle: FloatArray, speed: FloatArray, leads: BoolArray, lengths: FloatArray, t: int, s: float, moved: float,
    length: float, step_s: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Gap, m, speed, m/s, and acceleration, m/s2, of the next agent ahead that SUMO is shown; inf, 0, inf for none.

    moved m: since the step before; the agents shown are chosen by the place at that step.
    """
    least, lead_v, lead_a = np.inf, 0.0, np.inf
    for row in range(lengths.size):
        if not leads[row, t]:
            continue
        gap = middle[row, t] - s - 0.5 * (length + lengths[row])
        if LEADS_FROM_M < gap + moved < SHOWN_M and gap < least:
            least, lead_v, lead_a = gap, speed[row, t], 0.0
            if t > 0:
                lead_a = (speed[row, t] - speed[row, t - 1]) / step_s
    return least, lead_v, lead_a


@inner
def _looks_m(v: float, length: float, driver: tuple[float, float, float, float], cell_m: float) -> float:
    """How far ahead SUMO looks for a leader, m: to where it could stop, five lengths at least, to the end of a cell."""
    tau, _, decel, _ = driver
    return max(v * (tau + 0.5 * v / (decel + 1.0)), 5.0 * length + 0.5 * cell_m) + 0.5 * cell_m


@inner
def _desired_ahead(desired: float, v: float, front: float, lane: int, ends: FloatArray, turns: FloatArray) -> float:
    """Desired speed that SUMO's driver takes up, m/s: for the links of turns ahead a lower one."""
    for link in range(lane, ends.size - 1):
        if ends[link] - front >= max(PREVIEW_S * v, 0.5 * PREVIEW_S * desired):
            break
        desired = min(desired, turns[link + 1])
    return desired


@inner
def _is_met(low: FloatArray, high: FloatArray, same_direction: BoolArray, t: int, s: float, before_m: float) -> bool:
    """Whether the box meets another at the step after t; an agent that runs into it from behind does not count."""
    for row in range(low.shape[0]):
        is_met = low[row, t + 1] < s < high[row, t + 1]
        if is_met and (not same_direction[row, t] or gap_to(low[row, t], high[row, t], before_m)[1]):
            return True
    return False


@kernel(
    "(UniTuple(i8, 2), UniTuple(f8, 3), f8[::1], UniTuple(f8, 4), f8, f8, i8, f8, f8[::1], f8[::1], f8[::1], i8[::1],"
    " f8[:,::1], f8[:,::1], f8[:,::1], b1[:,::1], f8[::1], b1[:,::1], i8[::1], f8[:,::1], f8[:,::1], b1[:,::1],"
    " f8[::1], f8[::1], f8[::1], f8[::1], f8[::1], f8)"
)
def roll(
    span: tuple[int, int], start: tuple[float, float, float], desired_mps: FloatArray,
    driver: tuple[float, float, float, float], reaction: float, length: float, horizon: int, step_s: float,
    brakes: FloatArray, road: FloatArray, lane_ends: FloatArray, lane_policies: IntArray, low: FloatArray,
    high: FloatArray, along: FloatArray, same_direction: BoolArray, stop_m: FloatArray, closed: BoolArray,
    causes: IntArray, shown_middle: FloatArray, shown_speed: FloatArray, shown_leads: BoolArray,
    shown_lengths: FloatArray, link_m: FloatArray, paces: FloatArray, turns: FloatArray, memory: FloatArray,
    cell_m: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """Place s and speed v at the steps of a span, first to last, (K,) each, from a start s m, v m/s, a m/s2.

    No further than to where the boxes of the vehicle and another agent meet. Third, the state of the driver's EIDM at
    each step (K, M); memory (M,): that at the first one, empty for a driver that has just come.

    desired_mps (T,) by the scene's steps; driver .. causes: as in `speed_limits`, of one vehicle; reaction s; length m:
    own, of the box that SUMO has. shown_* (R, T): the agents that SUMO is shown, as in `Shown`.
    Of the map's lanes along the path as SUMO has it (L,): link_m, where they end; paces, metres of path per metre of
    lane; turns, m/s, largest desired speed on the way to each. cell_m: usual length of a cell, which is a SUMO lane.
    """
    first, last = span
    s_at, v_at = np.empty(last - first + 1), np.empty(last - first + 1)
    fleet = np.array([[start[0], start[1], start[2], 0.0, 1.0]])
    others, swept = np.zeros(0, dtype=np.int64), np.zeros((4, 0, 1))
    s_at[0], v_at[0] = start[0], start[1]
    yields, state = False, np.empty(DRIVER_STATE)
    new_driver(state, desired_mps[first])
    if memory.size:
        state[:] = memory
    before_m, memories = start[0], np.empty((last - first + 1, DRIVER_STATE))
    memories[0] = state
    tau, accel, decel, min_gap = driver
    in_sumo = round(tau, 2), round(accel, 2), round(decel, 2), min_gap  # it keeps two digits of these
    for k in range(1, last - first + 1):
        t = first + k - 1
        desired = desired_mps[t]
        limit, _, _, _, yields, _ = limit_of(
            0, t, fleet, desired, driver, yields, horizon, step_s, brakes, road, lane_ends, lane_policies, low, high,
            along, same_direction, stop_m, closed, causes, others, swept,
        )  # fmt: skip
        s, v, a = fleet[0, 0], fleet[0, 1], fleet[0, 2]
        front = s + 0.5 * length
        lane = min(int(np.searchsorted(link_m, front, side="right")), link_m.size - 1)
        gap, lead_v, lead_a = _leader(
            shown_middle, shown_speed, shown_leads, shown_lengths, t, s, s - before_m, length, step_s
        )
        if gap > _looks_m(v, length, in_sumo, cell_m):
            gap = np.inf
        ahead = _desired_ahead(desired, v, front, lane, link_m, turns)
        v_next = eidm_speed(
            state, v, a, (desired, ahead), (gap, lead_v, lead_a), max(limit, 0.0), in_sumo, reaction, step_s,
            t * step_s,
        )  # fmt: skip
        before_m = s
        s += 0.5 * (v + v_next) * step_s * paces[lane]
        fleet[0, 0], fleet[0, 1], fleet[0, 2] = s, v_next, (v_next - v) / step_s
        s_at[k], v_at[k], memories[k] = s, v_next, state
        if _is_met(low, high, same_direction, t, s, before_m):
            return s_at[: k + 1].copy(), v_at[: k + 1].copy(), memories[: k + 1].copy()
    return s_at, v_at, memories


@kernel("(f8[::1], f8[::1], i8, f8[:,::1], f8[:,::1], f8[:,::1], b1[:,::1], f8)")
def met_by(
    s: FloatArray, v: FloatArray, first: int, low: FloatArray, high: FloatArray, along: FloatArray,
    same_direction: BoolArray, step_s: float,
) -> FloatArray:  # fmt: skip
    """What each of R agents is to a motion (K,) from a step on, (R, 3): contact, TTC ahead and behind; inf for none.

    CONTACT: time of the first step at which the boxes meet, seconds; LEAD_TTC: least TTC, seconds, to it as a
    leader; LAG_TTC: of it as a follower, 0 where it runs in from behind. low .. same_direction (R, T): as in
    `PathOccupancy`.
    """
    found = np.full((low.shape[0], 3), np.inf)
    for row in range(low.shape[0]):
        from_behind = False
        for k in range(s.size):
            t = first + k
            if low[row, t] == np.inf:  # it is not on the path
                continue
            if low[row, t] < s[k] < high[row, t]:
                found[row, LAG_TTC if from_behind else CONTACT] = 0.0 if from_behind else t * step_s
                break
            if not same_direction[row, t]:
                from_behind = False
                continue
            gap, leads = gap_to(low[row, t], high[row, t], s[k])
            from_behind = not leads
            closing = v[k] - along[row, t] if leads else along[row, t] - v[k]
            if closing > 0.0:
                column = LEAD_TTC if leads else LAG_TTC
                found[row, column] = min(found[row, column], max(gap, 0.0) / closing)
    return found
