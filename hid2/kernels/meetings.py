"""Compiled loops over the cells of a lane: what is met on one route at a constant speed."""

import numpy as np

from hid2.kernels.compiled import inner, kernel
from netconvert.geometry import BoolArray, FloatArray, IntArray


@inner
def _is_near(x: float, y: float, others: FloatArray, there: BoolArray, look: int, within: float) -> bool:
    for a in range(there.shape[0]):
        if there[a, look]:
            dx, dy = x - others[a, look, 0], y - others[a, look, 1]
            if dx * dx + dy * dy < within * within:
                return True
    return False


@inner
def _leader(
    at: FloatArray, start: float, pace: float, time_s: FloatArray, lane_cell: IntArray, number: IntArray,
    leads_from: float, leads_to: float, looks: int, held_s: float,
) -> tuple[int, bool]:  # fmt: skip
    """Row of the agent next ahead of a vehicle for so many looks, -1 for none; and whether one runs into it.

    An agent with a leader stays behind it. A vehicle that is run into follows no agent, nor does any after held_s.
    """
    count = lane_cell.shape[0]
    led = np.zeros(count, dtype=np.int64)
    for look in range(time_s.size):
        if time_s[look] >= held_s:
            break
        way, nearest, agent = start + pace * time_s[look], np.inf, -1
        for a in range(count):
            if lane_cell[a, look] >= 0:
                ahead = at[lane_cell[a, look]] - way
                if 0.0 < ahead < nearest:
                    nearest, agent = ahead, a
        if agent >= 0 and number[agent] >= 0 and leads_from < nearest < leads_to:
            led[agent] += 1
    leader = -1
    for a in range(count):
        if led[a] >= looks and (leader < 0 or led[a] > led[leader]):
            leader = a
    for a in range(count):
        was_behind = False
        for look in range(time_s.size):
            if lane_cell[a, look] < 0:
                continue
            own = start + pace * min(time_s[look], held_s)
            if leader >= 0 and lane_cell[leader, look] >= 0 and at[lane_cell[leader, look]] - leads_from < own:
                own = max(start, at[lane_cell[leader, look]] - leads_from)
            apart = at[lane_cell[a, look]] - own
            if apart > 0.0 and was_behind:
                return -1, True
            was_behind = was_behind or apart < 0.0
    return leader, False


@inner
def _held(start: float, pace: float, time_s: FloatArray, stop_at: FloatArray, closed: BoolArray) -> float:
    """When a vehicle comes to a stop line that is closed at that look, s; inf where it comes to none."""
    for line in range(stop_at.size):
        arrives = (stop_at[line] - start) / pace
        look = np.searchsorted(time_s, arrives, side="right") - 1
        if arrives >= 0.0 and arrives <= time_s[-1] and closed[line, look]:
            return float(arrives)
    return np.inf


@kernel(
    "(f8[:,::1], i8[::1], f8[::1], i8, f8[::1], f8, f8[:,:,::1], b1[:,::1], f8, i8[:,::1], i8[::1], f8, f8, i8,"
    " i8[::1], f8[::1], f8, f8, i8, f8[::1], b1[:,::1])"
)
def met_on_route(
    centers: FloatArray, cells: IntArray, middle: FloatArray, count: int, time_s: FloatArray, pace: float,
    targets: FloatArray, there: BoolArray, within: float, lane_cell: IntArray, number: IntArray, leads_from: float,
    leads_to: float, looks: int, crossed_from: IntArray, crossed_s: FloatArray, crossed_after: float,
    crossed_within: float, last: int, stop_at: FloatArray, closed: BoolArray,
) -> tuple[BoolArray, BoolArray, IntArray, BoolArray, BoolArray, BoolArray]:  # fmt: skip
    """What vehicles from the first `count` cells of a route meet: targets, a leader, agents crossed or running into it.

    Returns whether a target is near at some look, and at look `last`; number of the leader, -1 for none; whether
    any agent runs into it from behind; whether any is crossed; whether it comes to a stop line that is closed.
    cells, middle (K,): of the route, rows of centers (C, 2) m, and m along it; time_s (T,) of the looks; pace m/s.
    targets (A, T, 2) m, there (A, T): near within a distance, m. lane_cell (M, T): cells of the others, -1 for none,
    which lead at leads_from to leads_to m ahead for so many looks if number (M,) is not -1. crossed_s: times at which
    cells are crossed, s, those of cell c from crossed_from[c] to crossed_from[c + 1]; a crossing counts between
    crossed_after and crossed_within s. No agent is followed or crossed beyond a closed stop line, stop_at (L,) m
    in their order, closed (L, T).
    """
    near, near_last = np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=np.bool_)
    leader, crosses = np.full(count, -1, dtype=np.int64), np.zeros(count, dtype=np.bool_)
    is_run_into, is_held = np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=np.bool_)
    at = np.full(centers.shape[0], np.nan)
    at[cells] = middle
    end = middle[middle.size - 1]
    for n in range(count):
        place, held_s = 0, _held(middle[n], pace, time_s, stop_at, closed)
        is_held[n] = held_s < np.inf
        for look in range(time_s.size):
            way = middle[n] + pace * time_s[look]
            if way > end:
                break
            while place < middle.size - 1 and middle[place] < way:
                place += 1
            x, y = centers[cells[place], 0], centers[cells[place], 1]
            if (not near[n] or look == last) and _is_near(x, y, targets, there, look, within):
                near[n] = True
                near_last[n] = near_last[n] or look == last
        agent, is_run_into[n] = _leader(
            at, middle[n], pace, time_s, lane_cell, number, leads_from, leads_to, looks, held_s
        )
        leader[n] = number[agent] if agent >= 0 else -1
        for place in range(cells.size):
            arrives = (middle[place] - middle[n]) / pace
            if 0.0 < arrives < held_s and not crosses[n]:
                apart = np.inf
                for k in range(crossed_from[cells[place]], crossed_from[cells[place] + 1]):
                    apart = min(apart, abs(arrives - crossed_s[k]))
                crosses[n] = crossed_after < apart < crossed_within
    return near, near_last, leader, is_run_into, crosses, is_held
