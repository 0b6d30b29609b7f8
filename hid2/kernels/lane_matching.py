"""Directions of motion, the lanes near every position, and the likeliest sequence of lanes (Viterbi)."""

import math

import numpy as np

from hid2.kernels.compiled import inner, kernel
from hid2.kernels.polyline import project_on_polyline
from netconvert.geometry import BoolArray, FloatArray, IntArray

# The one rule by which generator and judge tell lanes: no tunables, with numbers of their own the two would differ.
#: Tolerance beyond a lane's edge, m: as each counts with one width, lanes of varying width leave slivers between them.
SLIVER_M = 0.3
#: Largest angle between a lane and the direction of motion at which they agree.
_AGREE_RAD = math.radians(60)
#: Candidates of a place, at most: those of least cost, by distance and angle.
_MOST = 10
#: Least displacement that tells a direction of motion, m.
_MIN_CHORD_M = 1.0
_OFFSET_SIGMA_M = 1.0
_HEADING_SIGMA_RAD = 0.35
#: Costs (negative log likelihoods, up to a constant) of the Viterbi pass.
_OFF_LANE = 4.5
_CHANGE = 4.0
_JUMP = 12.0
_TO_OFF_LANE = 2.0


@kernel("(f8[:,::1], f8[::1], i8[::1], i8)")
def motion_directions(position: FloatArray, heading: FloatArray, first: IntArray, half: int) -> FloatArray:
    """Direction of motion (N,) rad from the chord `half` steps either side.

    Rows first[a]:first[a + 1] are agent a's. Chords shorter than _MIN_CHORD_M take the direction before them; an agent
    that stands has its heading.
    """
    out = np.empty(len(position))
    for a in range(len(first) - 1):
        start, end = first[a], first[a + 1] - 1
        last = -1
        for i in range(start, end + 1):
            j, k = max(start, i - half), min(end, i + half)
            dx, dy = position[k, 0] - position[j, 0], position[k, 1] - position[j, 1]
            if dx * dx + dy * dy >= _MIN_CHORD_M * _MIN_CHORD_M:
                out[i] = math.atan2(dy, dx)
                if last < 0:
                    for m in range(start, i):
                        out[m] = out[i]
                last = i
            elif last >= 0:
                out[i] = out[last]
        if last < 0:
            out[start : end + 1] = heading[start : end + 1]
    return out


@kernel("(f8[:,::1], f8[::1], f8[:,::1], f8[::1], i8[::1], f8[::1], f8[:,::1], b1[::1], f8)")
def lane_candidates(
    position: FloatArray,
    direction: FloatArray,
    points: FloatArray,
    s: FloatArray,
    first: IntArray,
    half_width: FloatArray,
    box: FloatArray,
    wanted: BoolArray,
    beyond_m: float,
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray, IntArray]:
    """Lane, s, d, cost (N, _MOST) of the lanes near each wanted row, and their number (N,).

    points, s, first, half_width, box: as of `FlatLanes`.
    """
    rows = len(position)
    lane = np.full((rows, _MOST), -1, dtype=np.int64)
    at_m, at_d = np.zeros((rows, _MOST)), np.zeros((rows, _MOST))
    cost = np.full((rows, _MOST), math.inf)
    count = np.zeros(rows, dtype=np.int64)
    for i in range(rows):
        if not wanted[i]:
            continue
        x, y = position[i, 0], position[i, 1]
        for k in range(len(half_width)):
            if x < box[k, 0] or y < box[k, 1] or x > box[k, 2] or y > box[k, 3]:
                continue
            along, offset, angle, distance = project_on_polyline(x, y, points, s, first[k], first[k + 1])
            if distance > half_width[k] + beyond_m:
                continue
            turn = abs(direction[i] - angle) % (2 * math.pi)
            turn = min(turn, 2 * math.pi - turn)
            if turn > _AGREE_RAD:
                continue
            value = 0.5 * (distance / _OFFSET_SIGMA_M) ** 2 + 0.5 * (turn / _HEADING_SIGMA_RAD) ** 2
            slot = count[i]
            if slot == _MOST:
                slot = int(np.argmax(cost[i]))
                if cost[i, slot] <= value:
                    continue
            else:
                count[i] += 1
            along = min(max(along, s[first[k]]), s[first[k + 1] - 1])
            lane[i, slot], at_m[i, slot], at_d[i, slot], cost[i, slot] = k, along, offset, value
    return lane, at_m, at_d, cost, count


@inner
def _viterbi(lane: IntArray, at_m: FloatArray, cost: FloatArray, count: IntArray, link: IntArray) -> IntArray:
    """Slot (R,) of the likeliest lane of each row of an agent, -1 for none."""
    rows, most = lane.shape
    total = np.full((rows, most + 1), math.inf)
    back = np.zeros((rows, most + 1), dtype=np.int64)
    for i in range(rows):
        for c in range(count[i] + 1):
            is_off = c == count[i]
            here = _OFF_LANE if is_off else cost[i, c]
            slot = most if is_off else c
            if i == 0:
                total[0, slot] = here
                continue
            best, best_from = math.inf, 0
            for p in range(count[i - 1] + 1):
                was_off = p == count[i - 1]
                from_slot = most if was_off else p
                if was_off and is_off:
                    move = 0.0
                elif was_off or is_off:
                    move = _TO_OFF_LANE
                else:
                    kind = link[lane[i - 1, p], lane[i, c]]
                    move = 0.0 if kind == 0 else _CHANGE if kind == 1 else _JUMP
                    # the same lane backwards by metres is no driving
                    if lane[i - 1, p] == lane[i, c] and at_m[i, c] < at_m[i - 1, p] - 5.0:
                        move = _JUMP
                if total[i - 1, from_slot] + move < best:
                    best, best_from = total[i - 1, from_slot] + move, from_slot
            total[i, slot] = best + here
            back[i, slot] = best_from
    chosen, slot = np.empty(rows, dtype=np.int64), int(np.argmin(total[rows - 1]))
    for i in range(rows - 1, -1, -1):
        chosen[i] = -1 if slot == most else slot
        slot = back[i, slot]
    return chosen


@kernel("(i8[::1], i8[::1], i8[:,::1], f8[:,::1], f8[:,::1], i8[::1], i8[:,::1],)")
def likeliest_lanes(
    agents: IntArray, first: IntArray, lane: IntArray, at_m: FloatArray, cost: FloatArray, count: IntArray,
    link: IntArray,
) -> IntArray:  # fmt: skip
    """Slot (N,) of the likeliest lane of every row of the agents, -1 for none; link: as of `FlatLanes`."""
    chosen = np.full(len(lane), -1, dtype=np.int64)
    for a in agents:
        own = slice(first[a], first[a + 1])
        chosen[own] = _viterbi(lane[own], at_m[own], cost[own], count[own], link)
    return chosen
