"""The next agents ahead of and behind places on a path: the loops of `occupancy/gaps.py`.

`gap_to` says which agent is ahead and how far, for other kernels too. Beside it the leaders on lanes, where a path is
known as lanes alone, and the leaders that SUMO is shown, which it has on lanes.
"""

import math

import numpy as np

from hid2.kernels.compiled import inner, kernel
from hid2.kernels.spline import TABLE_STEP_M
from netconvert.geometry import BoolArray, FloatArray, IntArray

#: Speed along a path below which an agent stands, m/s: SUMO is shown it unless it heads across. No tunable.
STANDING_MPS = 0.5
#: Least gap at which an agent that SUMO is shown leads, m; nearer it is beside. No tunable.
LEADS_FROM_M = 0.3
#: Look-ahead for agents that SUMO is shown, m: farther than any driver brakes for. No tunable.
SHOWN_M = 120.0
#: Lateral offset of its front from which an agent leads on no path, m. Not a parameter: half a lane and a little.
ASIDE_M = 2.0


@inner
def gap_to(low: float, high: float, s: float) -> tuple[float, bool]:
    """Bumper gap from a place on a path to an agent, m, negative side by side, and whether the agent is ahead.

    low, high m: as in `PathOccupancy`; inf and not ahead where the agent is not on the path.
    """
    if 0.5 * (low + high) >= s:
        return low - s, True
    return s - high, False


@kernel("(f8[:,::1], f8[:,::1], f8[:,::1], b1[:,::1], f8[::1], i8[::1])")
def next_on_path(
    low: FloatArray, high: FloatArray, along: FloatArray, counts: BoolArray, s: FloatArray, column: IntArray
) -> tuple[IntArray, FloatArray, FloatArray, IntArray, FloatArray, FloatArray]:
    """Row, gap and speed of the next agent ahead, and of the next behind, (N,) each; -1, inf and 0 for none.

    low, high m, along m/s (R, T): as in `PathOccupancy`; counts (R, T): the agents that are looked at; s (N,) m: places
    on the path, each at a step of its own, column (N,).
    """
    ahead, behind = np.full(s.size, -1, dtype=np.int64), np.full(s.size, -1, dtype=np.int64)
    lead, lag = np.full(s.size, np.inf), np.full(s.size, np.inf)
    lead_mps, lag_mps = np.zeros(s.size), np.zeros(s.size)
    for n in range(s.size):
        t = column[n]
        for row in range(low.shape[0]):
            if not counts[row, t]:
                continue
            gap, leads = gap_to(low[row, t], high[row, t], s[n])
            if leads and gap < lead[n]:
                ahead[n], lead[n], lead_mps[n] = row, gap, max(along[row, t], 0.0)
            elif not leads and gap < lag[n]:
                behind[n], lag[n], lag_mps[n] = row, gap, max(along[row, t], 0.0)
    return ahead, lead, lead_mps, behind, lag, lag_mps


@kernel("(f8[:,::1], f8[:,::1], f8[:,::1], f8[::1], i8[::1])")
def all_on_path(
    low: FloatArray, high: FloatArray, along: FloatArray, s: FloatArray, column: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Gaps to every agent ahead and to every one behind, inf for the others, and speeds, (R, N) each."""
    lead, lag = np.full((low.shape[0], s.size), np.inf), np.full((low.shape[0], s.size), np.inf)
    speed = np.empty((low.shape[0], s.size))
    for row in range(low.shape[0]):
        for n in range(s.size):
            t = column[n]
            gap, leads = gap_to(low[row, t], high[row, t], s[n])
            if leads:
                lead[row, n] = gap
            else:
                lag[row, n] = gap
            speed[row, n] = max(along[row, t], 0.0)
    return lead, lag, speed


@kernel("(i8[::1], f8[::1], f8[::1], i8[:,::1], i8[::1], f8[::1], f8[::1], f8[::1], i8[:,::1], i8[::1], f8,)")
def lane_leaders(
    lane: IntArray, s: FloatArray, d: FloatArray, row_of: IntArray, next_row: IntArray, length: FloatArray,
    width: FloatArray, lane_length: FloatArray, successors: IntArray, straight: IntArray, horizon: float,
) -> tuple[IntArray, FloatArray]:  # fmt: skip
    """Agent ahead (N,), -1 for none, and the gap to it (N,) m, inf for none.

    lane, s, d (N,): matches; next_row (N,): the next row of the same agent on another lane, -1 for none; successors
    (L, K), straight (L,): lanes behind each lane, -1 for none. No agent further ahead than horizon m leads.
    """
    agents, steps = row_of.shape
    lanes = len(lane_length)
    leader = np.full(len(lane), -1, dtype=np.int64)
    gap = np.full(len(lane), math.inf)
    head = np.full(lanes, -1, dtype=np.int64)
    chain = np.full(agents, -1, dtype=np.int64)
    for t in range(steps):
        head[:] = -1
        for a in range(agents):
            i = row_of[a, t]
            if i >= 0 and lane[i] >= 0:
                chain[a] = head[lane[i]]
                head[lane[i]] = a
        for a in range(agents):
            i = row_of[a, t]
            if i < 0 or lane[i] < 0:
                continue
            current, row, offset = lane[i], i, -s[i]
            best, best_distance = -1, math.inf
            for _ in range(200):
                b = head[current]
                while b >= 0:
                    j = row_of[b, t]
                    distance = offset + s[j]
                    if b != a and 0 < distance < best_distance and abs(d[j] - d[i]) < (width[a] + width[b]) / 2:
                        best, best_distance = b, distance
                    b = chain[b]
                offset += lane_length[current]
                if best >= 0 or offset > horizon:
                    break
                # own future lanes where they go on from here, else the straightest successor
                target = -1
                if row >= 0:
                    row = next_row[row]
                    wanted = lane[row] if row >= 0 else -1
                    if wanted >= 0:
                        for n in successors[current]:
                            if n == wanted:
                                target = n
                    if target < 0:
                        row = -1
                if target < 0:
                    target = straight[current]
                if target < 0:
                    break
                current = target
            if best >= 0 and best_distance <= horizon:
                leader[i] = best
                gap[i] = best_distance - (length[a] + length[best]) / 2
    return leader, gap


@kernel(
    "(f8[:,::1], f8[:,::1], f8[:,::1], b1[:,::1], b1[:,::1], i8[::1], f8[::1], f8[:,:,::1], b1[:,::1], f8[:,::1],"
    " f8[::1], f8)"
)
def leading_in_sumo(
    low: FloatArray, high: FloatArray, along: FloatArray, same_direction: BoolArray, crossing: BoolArray,
    agents: IntArray, lengths: FloatArray, front: FloatArray, known: BoolArray, table_xy: FloatArray,
    table_heading: FloatArray, exit_m: float,
) -> tuple[FloatArray, BoolArray]:  # fmt: skip
    """Middles of agents that lead on a path (R, T), m, 0 for others, and whether SUMO has their fronts on its lanes.

    As in `PathOccupancy`; front (A, T, 2) m; known (A, T): whether SUMO knows its speed; table_*: of the path's line,
    which ends at exit_m m. Agents slower than STANDING_MPS lead unless they head across.
    """
    middle, leads = np.zeros(low.shape), np.zeros(low.shape, dtype=np.bool_)
    for row, agent in enumerate(agents):
        for t in range(low.shape[1]):
            moves = same_direction[row, t] or (not crossing[row, t] and abs(along[row, t]) < STANDING_MPS)
            if low[row, t] < np.inf and moves and known[agent, t]:
                middle[row, t] = 0.5 * (low[row, t] + high[row, t])
                front_m = middle[row, t] + 0.5 * lengths[agent]
                at = min(max(int(front_m / TABLE_STEP_M), 0), table_heading.size - 1)
                dx, dy = front[agent, t, 0] - table_xy[at, 0], front[agent, t, 1] - table_xy[at, 1]
                off = abs(np.cos(table_heading[at]) * dy - np.sin(table_heading[at]) * dx)
                leads[row, t] = off < ASIDE_M and front_m < exit_m
    return middle, leads


@inner
def _next_two_ahead(
    low: FloatArray, high: FloatArray, along: FloatArray, same_direction: BoolArray, crossing: BoolArray,
    agents: IntArray, lengths: FloatArray, rows: tuple[int, int], step: int, s: float, length: float,
) -> tuple[int, float, float, int, float, float]:  # fmt: skip
    """Of agents that move along a path or stand on it at a step, the next two ahead of s m: agent, gap m, middle m.

    An agent of -1 for none. The gap is the one that SUMO will see: it has the agent's length along the path from the
    middle on, at whatever angle the agent is.
    """
    first, second = -1, -1
    first_gap, second_gap, first_at, second_at = np.inf, np.inf, 0.0, 0.0
    for row in range(rows[0], rows[1]):
        if low[row, step] == np.inf:
            continue
        if not same_direction[row, step] and (crossing[row, step] or abs(along[row, step]) >= STANDING_MPS):
            continue
        middle = 0.5 * (low[row, step] + high[row, step])
        gap = middle - s - 0.5 * (length + lengths[agents[row]])
        if gap <= LEADS_FROM_M or gap >= SHOWN_M or gap >= second_gap:
            continue
        if gap < first_gap:
            second, second_gap, second_at = first, first_gap, first_at
            first, first_gap, first_at = agents[row], gap, middle
        else:
            second, second_gap, second_at = agents[row], gap, middle
    return first, first_gap, first_at, second, second_gap, second_at


@inner
def _is_beside(
    agent: int, x: float, y: float, length: float, centre: FloatArray, own_lengths: FloatArray, low: FloatArray,
    agents: IntArray, first: IntArray, step: int,
) -> bool:  # fmt: skip
    """Whether an agent at a place is on the path of some vehicle, so near that their boxes are beside each other."""
    for vehicle in range(own_lengths.size):
        dx, dy = centre[vehicle, 0] - x, centre[vehicle, 1] - y
        reach = 0.5 * (own_lengths[vehicle] + length)
        if dx * dx + dy * dy < reach * reach:
            for row in range(first[vehicle], first[vehicle + 1]):
                if agents[row] == agent and low[row, step] < np.inf:
                    return True
    return False


@kernel(
    "(f8[:,::1], f8[:,::1], f8[:,::1], b1[:,::1], b1[:,::1], i8[::1], i8[::1], f8[::1], f8[:,:,::1], f8[:,:,::1], i8,"
    " f8[::1], f8[:,::1], f8[::1])"
)
def shown_ahead(
    low: FloatArray, high: FloatArray, along: FloatArray, same_direction: BoolArray, crossing: BoolArray,
    agents: IntArray, first: IntArray, lengths: FloatArray, recorded: FloatArray, kept: FloatArray, step: int,
    s: FloatArray, centre: FloatArray, own_lengths: FloatArray,
) -> tuple[IntArray, IntArray, FloatArray]:  # fmt: skip
    """Agents that vehicles (N,) have ahead of them at a step, two each at most, none beside one with it on the path.

    Returns agents (M,), the vehicle nearest behind each, and where the agent's middle is on its path, m.
    low .. crossing (R, T): as in `PathOccupancy`, of agents (R,) on the paths; those of vehicle i are the rows from
    first[i] to first[i + 1]. lengths (A,) m, of recorded (., T, 2) m, then kept ones. s (N,) m, NaN for those not
    there; centre (N, 2) m; own_lengths (N,) m.
    """
    count = recorded.shape[0]
    nearest = np.full(lengths.size, np.inf)
    behind = np.full(lengths.size, -1, dtype=np.int64)
    middle = np.empty(lengths.size)
    for vehicle in range(s.size):
        if np.isnan(s[vehicle]) or first[vehicle] == first[vehicle + 1]:
            continue
        one, gap, at, other, other_gap, other_at = _next_two_ahead(
            low, high, along, same_direction, crossing, agents, lengths, (first[vehicle], first[vehicle + 1]), step,
            s[vehicle], own_lengths[vehicle],
        )  # fmt: skip
        if one >= 0 and gap < nearest[one]:
            nearest[one], behind[one], middle[one] = gap, vehicle, at
        if other >= 0 and other_gap < nearest[other]:
            nearest[other], behind[other], middle[other] = other_gap, vehicle, other_at
    found = np.empty(lengths.size, dtype=np.int64)
    size = 0
    for agent in range(lengths.size):
        if behind[agent] < 0:
            continue
        x, y = recorded[agent, step] if agent < count else kept[agent - count, step]
        if not _is_beside(agent, x, y, lengths[agent], centre, own_lengths, low, agents, first, step):
            found[size] = agent
            size += 1
    shown = found[:size].copy()
    return shown, behind[shown], middle[shown]
