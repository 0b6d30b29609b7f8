"""The next vehicles ahead: on the lane path of every vehicle at every step, and on one path at one step."""

import math

import numpy as np

from hid2.kernels.compiled import kernel
from netconvert.geometry import BoolArray, FloatArray, IntArray


@kernel("(i8[::1], f8[::1], f8[::1], i8[::1], i8[:,::1], i8[::1], f8[::1], f8[::1], f8[::1], i8[:,::1], i8[::1], f8,)")
def lane_leaders(
    lane: IntArray,
    s: FloatArray,
    d: FloatArray,
    agent: IntArray,
    row_of: IntArray,
    next_row: IntArray,
    length: FloatArray,
    width: FloatArray,
    lane_length: FloatArray,
    successors: IntArray,
    straight: IntArray,
    horizon: float,
) -> tuple[IntArray, FloatArray]:
    """Agent ahead (N,), -1 for none, and the gap to it (N,) m, inf for none.

    lane, s, d (N,): matches; next_row (N,): the next row of the same agent on another lane, -1 for none; successors
    (L, K), straight (L,): lanes behind each lane, -1 for none. Nobody further ahead than horizon m leads.
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


@kernel("(f8[:,::1], f8[:,::1], f8[:,::1], b1[:,::1], b1[:,::1], f8[::1], i8, f8, f8, f8, f8, f8)")
def next_two_ahead(
    low: FloatArray, high: FloatArray, along: FloatArray, aligned: BoolArray, crosses: BoolArray, lengths: FloatArray,
    step: int, s: float, length: float, standing: float, nearest: float, farthest: float,
) -> tuple[int, float, float, int, float, float]:  # fmt: skip
    """Of who moves along a path or stands on it at a step, the next two ahead of arc length s: row, gap m, middle m.

    low .. crosses (A, T): as in `PathOccupancy`; lengths (A,) m; length: of the box at s; standing m/s: slower agents
    stand; nearest, farthest m: bounds of the gap. A row of -1 for none.
    """
    first, second = -1, -1
    first_gap, second_gap, first_at, second_at = np.inf, np.inf, 0.0, 0.0
    for a in range(low.shape[0]):
        if low[a, step] == np.inf:
            continue
        if not aligned[a, step] and (crosses[a, step] or abs(along[a, step]) >= standing):
            continue
        middle = 0.5 * (low[a, step] + high[a, step])
        gap = middle - s - 0.5 * (length + lengths[a])
        if gap <= nearest or gap >= farthest or gap >= second_gap:
            continue
        if gap < first_gap:
            second, second_gap, second_at = first, first_gap, first_at
            first, first_gap, first_at = a, gap, middle
        else:
            second, second_gap, second_at = a, gap, middle
    return first, first_gap, first_at, second, second_gap, second_at
