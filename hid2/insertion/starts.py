"""Starts on a path: whether a vehicle may begin there, how fast, and a first plan from there; many in one go.

Of the places that are tried few are possible: those that are not are found out in compiled code, without a plan.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hid2.agents import FloatArray
from hid2.conflicts.cases import DT_S, Prospect, plan_accelerations
from hid2.conflicts.space_time import speed_rows
from hid2.conflicts.speed_plan import OVER_MPS, SpeedPlan, farthest, search, states
from hid2.kernels.compiled import planner_kernel
from hid2.params import Config
from hid2.policy.turns import RoadSpeeds, reachable

_BEHIND_M = 60.0
_EASES_MPS = 1.0  # by which who is behind may be too fast for its gap: it eases off the pedal
_REASONS = ("", "box_too_close", "follower_too_fast", "no_safe_timing", "turn_not_reached")
_SAFE, _CLOSE, _PUSHED, _NO_TIMING, _NOT_REACHED = range(5)


@dataclass(frozen=True, eq=False, slots=True)
class Start:
    """Fastest speed to begin with, m/s, and the best plan from there, or from a slower start; None if not asked for."""

    v0: float
    plan: SpeedPlan | None


def starts(
    look: Prospect,
    road: RoadSpeeds,
    s0: FloatArray,
    cruise_mps: FloatArray,
    wanted_mps: FloatArray,
    *,
    shares: Sequence[float],
    gentle_from: int,
    turn_end: FloatArray,
    turned_by: int,
    config: Config,
    plans: bool = True,
) -> list[Start | str]:
    """For places s0 (M,) m on one path a start, or why there is none.

    cruise_mps, wanted_mps (M,) m/s: desired speed, and the one wished for at the start. shares of the start's speed
    are tried in turn. Nobody of row gentle_from of the occupancy or later has to brake at once, but gently.
    turn_end (M,) m: to be reached by step turned_by, 0 for no turn; who cannot, whatever he does, is not planned.
    """
    following, steps = config.car_following, look.tables.num_steps
    reasons, v0, s, v, cost = _starts(
        look.tables.view(), road.cap, road.shape, look.most, s0, cruise_mps, wanted_mps,
        np.asarray(shares), config.turn.approach_decel_mps2, following.accel_mps2, config.spawn.clear_gap_m,
        config.spawn.clear_ahead_s, gentle_from, steps, plan_accelerations(config), DT_S, states(steps), plans,
        turn_end, turned_by,
    )  # fmt: skip
    found: list[Start | str] = []
    for row, reason in enumerate(reasons.tolist()):
        if reason != _SAFE:
            found.append(_REASONS[reason])
            continue
        plan = SpeedPlan(s=s[row], v=v[row], cost=float(cost[row])) if plans else None
        found.append(Start(float(v0[row]), plan))
    return found


@planner_kernel
def _starts(  # type: ignore[no-untyped-def]  # noqa: ANN202
    view, cap, shape, most, s0, cruise, wanted, shares, decel, accel, clear, headway, gentle_from, steps, accels, dt,  # noqa: ANN001
    memory, plans, turn_end, turned_by,  # noqa: ANN001
):  # fmt: skip
    cells, step = view.cells, view.cell_m
    count = s0.size
    reason, speed, cost = np.zeros(count, dtype=np.int64), np.zeros(count), np.zeros(count)
    rows = count if plans else 0
    out_s, out_v = np.empty((rows, steps)), np.empty((rows, steps))
    fastest, pushed, followed = np.empty(1), np.empty(1), np.empty(1)
    nowhere = np.empty(0)
    for i in range(count):
        close, room, unbraked = _gaps_at_start(view, s0[i], clear, headway, gentle_from)
        if close:
            reason[i] = _CLOSE
            continue
        cell = min(int(s0[i] / step + 0.5), cells - 1)
        speed_rows(fastest, pushed, followed, 0, cell, cell + 1, view)
        desired = reachable(cap, shape, cruise[i], step, decel, accel)
        speed[i] = min(wanted[i], desired[cell], fastest[0], room)
        if speed[i] < max(pushed[0], unbraked):
            reason[i] = _PUSHED
            continue
        if turn_end[i] > s0[i]:
            reach = farthest(view, s0[i], 0.0, speed[i], accels.min(), accels.max(), 0, turned_by + 1, dt)
            if reach < turn_end[i]:
                reason[i] = _NO_TIMING if reach == -np.inf else _NOT_REACHED
                continue
        if plans:
            ceiling = np.minimum(most, desired + OVER_MPS)
            found, s, v, cost[i] = search(
                view, desired, ceiling, s0[i], shares * speed[i], 0.0, 0, steps, accels, dt, nowhere, False, memory
            )
            if not found:
                reason[i] = _NO_TIMING
                continue
            out_s[i], out_v[i] = s, v
    return reason, speed, out_s, out_v, cost


@planner_kernel
def _gaps_at_start(view, s0, clear, headway, gentle_from):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Whether anybody is nearer than `clear`, m, at step 0, and the speeds, m/s, that the gaps ahead and behind allow.

    Behind: the slowest at which nobody of row gentle_from and later has to brake at once, but gently: the inverse of
    the car following's safe speed (Krauss 1998).
    """
    follower, nearest, room, square = view.follower, np.inf, np.inf, 0.0
    for a in range(view.low.shape[0]):
        low, high, along = view.low[a, 0], view.high[a, 0], view.along[a, 0]
        if low - clear < s0 < high + clear:
            return True, 0.0, 0.0
        if s0 < low < nearest:
            nearest = low
            gap, speed = nearest - s0, max(0.0, along)
            room = max(max(0.0, gap - clear) / headway, min(speed, 0.8 * gap))
        if a >= gentle_from and view.aligned[a, 0] and s0 - _BEHIND_M < high < s0:
            wanted = max(along - _EASES_MPS + follower.reaction_mps, 0.0)
            gap = s0 - high - follower.min_gap_m
            square = max(square, wanted**2 - follower.reaction_mps**2 - 2.0 * follower.decel_mps2 * gap)
    return False, room, np.sqrt(square)
