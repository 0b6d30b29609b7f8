"""How fast vehicles may drive where SUMO is blind: one by one in a rollout, all of a fleet in one compiled call."""

import numpy as np

from hid2.kernels.compiled import inner, kernel
from hid2.kernels.guard import needed_braking, stop_ahead
from hid2.kernels.spline import TABLE_STEP_M
from netconvert.geometry import BoolArray, FloatArray, IntArray

#: Causes of limits on a speed, by number. In alphabetical order: of two equal limits the first one is named.
CAUSES = ("conflict", "crossing", "curve", "gap", "signal", "turn")
_CONFLICT, _CURVE, _TURN = CAUSES.index("conflict"), CAUSES.index("curve"), CAUSES.index("turn")
#: Tolerance of the desired speed, m/s: a limit less than this below it is none.
LIMIT_TOLERANCE_MPS = 1e-3
#: Number of the policy of lanes that do not turn, as in `policy/roads.py`.
STRAIGHT = 0
# When a driver yields. No tunables from here to _BEHIND_RATIO: chosen on the scenes of tests/real.
ACTS_MPS2 = 1.1  # least deceleration needed for a conflict at which a vehicle begins to yield, m/s2
#: Least deceleration needed for a conflict at which a vehicle that yields keeps on yielding, m/s2.
_KEEPS_YIELDING_MPS2 = 0.3
#: Ratio of deceleration needed to ACTS_MPS2 at which a vehicle yields at once, however late the conflict.
_URGENT_RATIO = 3.0
_SOON_S = 2.5  # time to a conflict up to which a vehicle begins to yield where less deceleration is needed, s
_JERK_MPS3 = 3.5  # rate at which braking for a conflict or a stop line builds up, m/s3
_LAST_BRAKE_MPS2 = 0.6  # bound of braking for a conflict or a stop line just before standing still, m/s2
_LAST_BRAKE_PER_S = 1.8  # bound of braking for a conflict or a stop line over the speed, 1/s, where that allows more
_SLOWS_MPS2 = 0.7  # deceleration behind a leader above which a vehicle may be waiting for it, m/s2
#: Ratio of the gap to a leader to that of time gap and jam gap below which a vehicle may be waiting for it.
_BEHIND_RATIO = 2.0
_TURN_AHEAD_S = 4.0  # look-ahead for a turn lane that a limit is put down to; no tunable: book-keeping


@inner
def _lane_at(ends: FloatArray, s: float) -> int:
    """Which of the lanes along a path holds an arc length, by where they end, m."""
    return min(int(np.searchsorted(ends, s, side="right")), ends.size - 1)


@inner
def limit_of(
    i: int, t: int, fleet: FloatArray, desired_mps: float, driver: tuple[float, float, float, float],
    is_yielding: bool,  # noqa: FBT001  # kernels have no keywords
    horizon: int, step_s: float, brakes: FloatArray, road: FloatArray, ends: FloatArray, lanes: IntArray,
    low: FloatArray, high: FloatArray, along: FloatArray, same_direction: BoolArray, stop_m: FloatArray,
    closed: BoolArray, causes: IntArray, others: IntArray, swept: FloatArray,
) -> tuple[float, int, int, int, bool, bool]:  # fmt: skip
    """The lowest limit on the speed of vehicle i for the step after t, and the other results of `speed_limits`."""
    s, v, a = fleet[i, 0], fleet[i, 1], fleet[i, 2]
    waits_for, yields, braking_fails = -1, False, False
    policy = lanes[_lane_at(ends, s)]
    turns = policy != STRAIGHT or lanes[_lane_at(ends, s + _TURN_AHEAD_S * v)] != STRAIGHT
    limit = road[min(int((s + v * step_s) / TABLE_STEP_M), road.size - 1)]
    cause = _TURN if turns else _CURVE
    if horizon > 0:
        tau, accel, decel, min_gap = driver
        row, hit, unbraked_hit, leader, gap, _ = needed_braking(
            low, high, along, same_direction, stop_m, closed, swept, others, fleet, i, t, (s, v, a), desired_mps, road,
            horizon, step_s, driver, brakes,
        )  # fmt: skip
        needed = brakes[row]
        braking_fails = hit >= 0 or needed > decel
        if leader >= 0 and gap < _BEHIND_RATIO * (tau * v + min_gap) and a < -_SLOWS_MPS2:
            waits_for = leader
        act = _KEEPS_YIELDING_MPS2 if is_yielding else ACTS_MPS2
        soon = unbraked_hit >= 0 and unbraked_hit * step_s <= _SOON_S
        yields = needed >= act and (is_yielding or soon or needed >= _URGENT_RATIO * act)
        softly = max(_LAST_BRAKE_MPS2, _LAST_BRAKE_PER_S * v)  # no driver stops with a jerk
        gentlest = max(min(a, 0.0) - _JERK_MPS3 * step_s, -softly)
        if yields and v + max(-needed, gentlest) * step_s <= limit:
            limit, cause = v + max(-needed, gentlest) * step_s, _CONFLICT
        line, slowing = stop_ahead(stop_m, closed, s, v, t, accel, decel)
        slower = v + max(slowing, gentlest) * step_s
        if line >= 0 and (slower < limit or (slower == limit and causes[line] < cause)):
            limit, cause = slower, causes[line]
    if limit < desired_mps - LIMIT_TOLERANCE_MPS:
        return limit, cause, policy, waits_for, yields, braking_fails
    return np.inf, -1, policy, waits_for, yields, braking_fails


@kernel(
    "(i8[::1], i8, f8[:,::1], f8[:,::1], f8[:,::1], b1[::1], i8, f8, f8[::1], i8[:,::1], f8[::1], f8[::1], i8[::1],"
    " f8[:,::1], f8[:,::1], f8[:,::1], b1[:,::1], f8[::1], b1[:,::1], i8[::1], i8[::1], f8[::1])"
)
def speed_limits(
    rows: IntArray, t: int, fleet: FloatArray, desired_mps: FloatArray, drivers: FloatArray, yielding: BoolArray,
    horizon: int, step_s: float, brakes: FloatArray, first: IntArray, road: FloatArray, lane_ends: FloatArray,
    lane_policies: IntArray, low: FloatArray, high: FloatArray, along: FloatArray, same_direction: BoolArray,
    stop_m: FloatArray, closed: BoolArray, causes: IntArray, others: IntArray, swept: FloatArray,
) -> tuple[FloatArray, IntArray, IntArray, IntArray, BoolArray, BoolArray]:  # fmt: skip
    """The lowest limits on the speeds of rows (M,) of fleet (N, 5) for the step after t, and what else is found.

    As in `needed_braking`: fleet, low .. closed, brakes, and horizon, which is 0 where conflicts and stop lines do not
    count. desired_mps (N, T); drivers (N, 4); yielding (N,): whether a vehicle brakes for a conflict by now. What is on
    a vehicle's way is from first[m] to first[m + 1] (M + 1, 6) of: road, m/s every TABLE_STEP_M; lanes (where they end,
    m, and their policies, of which STRAIGHT is no turn); low ..; stop lines with their causes; others, rows of the
    fleet; and what they sweep, raveled (4, G, K) of each vehicle. Returns, each (M,): limits m/s, inf where a vehicle
    desires to go no faster anyway; numbers of their causes, -1 for none; policies of the lanes; rows of leaders that a
    vehicle waits for, -1 for none; whether it yields; and whether usual braking is not enough.
    """
    limits, caused = np.full(rows.size, np.inf), np.full(rows.size, -1)
    policies, waits_for = np.empty(rows.size, dtype=np.int64), np.full(rows.size, -1)
    yields, braking_fails = np.zeros(rows.size, dtype=np.bool_), np.zeros(rows.size, dtype=np.bool_)
    for m in range(rows.size):
        i, at, to = rows[m], first[m], first[m + 1]
        tau, accel, decel, min_gap = drivers[i]
        rivals = others[at[4] : to[4]]
        reach = (to[5] - at[5]) // max(1, 4 * rivals.size)
        limits[m], caused[m], policies[m], waits_for[m], yields[m], braking_fails[m] = limit_of(
            i, t, fleet, desired_mps[i, t], (tau, accel, decel, min_gap), yielding[i], horizon, step_s, brakes,
            road[at[0] : to[0]], lane_ends[at[1] : to[1]], lane_policies[at[1] : to[1]], low[at[2] : to[2]],
            high[at[2] : to[2]], along[at[2] : to[2]], same_direction[at[2] : to[2]], stop_m[at[3] : to[3]],
            closed[at[3] : to[3]], causes[at[3] : to[3]], rivals, swept[at[5] : to[5]].reshape(4, rivals.size, reach),
        )  # fmt: skip
    return limits, caused, policies, waits_for, yields, braking_fails
