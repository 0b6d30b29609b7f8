"""Where others are along a path: box against box at every point of the path that is near an agent, at every step."""

import numpy as np

from hid2.kernels.boxes import apart
from hid2.kernels.compiled import inner, kernel
from hid2.kernels.raster import IndexTable
from hid2.kernels.spline import TABLE_STEP_M
from netconvert.geometry import BoolArray, FloatArray, IntArray

#: Margin by which agents that stand are measured more widely, m, so that they need not be looked at again when a
#: tracker jitters. Not a parameter, it saves time.
_WIDER_M = 1.0
#: Length taken off both ends of a crossing agent's interval on a path for the times before and after it is there, m. No
#: tunable: half of a bumper's length; what PET and TTC keep is a time.
PET_MARGIN_M = 0.5
#: Cosines of the largest angle to a path of an agent that moves with it (45 degrees), and of the smallest of one that
#: crosses it (30); between the two an agent does both. No tunables: what moving with a path and crossing it mean.
SAME_WAY, _CROSSES = 0.7, 0.87


@kernel("(f8[:,::1], f8[:,::1], b1[:,::1], b1[:,::1], i8)")
def crossings_kept_clear(
    low: FloatArray, high: FloatArray, same_direction: BoolArray, crossing: BoolArray, steps: int
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """An agent that crosses also holds the path where it does so, `steps` before and after.

    All of the way across counts, also where it heads against the path still, as one that turns across it.
    """
    wide_low, wide_high, leads, across = low.copy(), high.copy(), same_direction.copy(), crossing.copy()
    agents, last = low.shape
    for a in range(agents):
        for way in (1, -1):
            for k in range(1, last):
                t = k if way > 0 else last - 1 - k
                across[a, t] |= across[a, t - way] and low[a, t] != np.inf and not same_direction[a, t]
        for t in range(last):
            if low[a, t] == np.inf:
                leads[a, t] = False
                continue
            if not across[a, t]:
                continue
            for k in range(max(0, t - steps), min(last, t + steps + 1)):
                if low[a, k] != np.inf and same_direction[a, k]:
                    continue
                if high[a, t] - low[a, t] <= 2 * PET_MARGIN_M or k == t:
                    continue
                wide_low[a, k] = min(wide_low[a, k], low[a, t] + PET_MARGIN_M)
                wide_high[a, k] = max(wide_high[a, k], high[a, t] - PET_MARGIN_M)
    return wide_low, wide_high, leads


@inner
def _gaps(
    gaps: FloatArray, points: FloatArray, begin: int, end: int, x: float, y: float, bc: float, bs: float,
    own_l: float, own_w: float, half_l: float, half_w: float,
) -> None:  # fmt: skip
    """How far the own box at points `begin` to `end` is apart from an agent's, into gaps.

    A loop without branches over contiguous columns: the compiler does several points at once.
    """
    xs, ys = points[0, begin:end], points[1, begin:end]
    cosine, sine = points[2, begin:end], points[3, begin:end]
    for i in range(xs.size):
        gaps[i] = apart(xs[i], ys[i], cosine[i], sine[i], own_l, own_w, x, y, bc, bs, half_l, half_w)


@inner
def _touched(gaps: FloatArray) -> tuple[int, int]:
    """First and last point without a gap; -1 twice where there is none."""
    for first in range(gaps.size):
        if gaps[first] <= 0.0:
            last = gaps.size - 1
            while gaps[last] > 0.0:
                last -= 1
            return first, last
    return -1, -1


@inner
def _nearest(points: FloatArray, begin: int, end: int, x: float, y: float) -> int:
    """Of points `begin` to `end` the one nearest to a place."""
    nearest, least = begin, np.inf
    for i in range(begin, end):
        square = (x - points[0, i]) ** 2 + (y - points[1, i]) ** 2
        if square < least:
            nearest, least = i, square
    return nearest


@kernel(
    "(f8[:,::1], f8[::1], f8, f8, f8, f8, i4[:,::1], i4[:,::1], f8, f8, "
    "f8[:,:,::1], f8[:,::1], f8[:,:,::1], b1[:,::1], f8[::1], f8[::1], i8)"
)
def intervals_on_path(
    points: FloatArray, heading: FloatArray, x0: float, y0: float, side: float, raster_reach: float,
    first_point: IndexTable, last_point: IndexTable, length: float, width: float, position: FloatArray,
    other_heading: FloatArray, velocity: FloatArray, present: BoolArray, lengths: FloatArray, widths: FloatArray,
    since: int,
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray, BoolArray, BoolArray]:  # fmt: skip
    """Rows of those that touch the path, and their intervals: box against box at every point of it near the agent.

    points (4, K): x, y, cosine and sine, TABLE_STEP_M apart, and their raster (see `Raster`). length, width: of the own
    box. since: the first agent looked at.
    An agent that stands, or jitters as trackers do, is not looked at again before it can have come to touch the path.
    """
    agents, steps = present.shape
    low, high, along = np.empty((agents, steps)), np.empty((agents, steps)), np.empty((agents, steps))
    same_direction, crossing = np.empty((agents, steps), dtype=np.bool_), np.empty((agents, steps), dtype=np.bool_)
    found_rows, count = np.empty(agents, dtype=np.int64), 0
    gaps = np.empty(points.shape[1])
    own_l, own_w = length / 2, width / 2
    (columns, rows), per_m = first_point.shape, 1.0 / side
    for a in range(since, agents):
        half_l, half_w = lengths[a] / 2, widths[a] / 2
        reach = np.hypot(own_l, own_w) + np.hypot(half_l, half_w) + _WIDER_M
        k, hit = count, False  # row of the result
        low[k], high[k], along[k], same_direction[k], crossing[k] = np.inf, -np.inf, 0.0, False, False
        nearest = -1  # point of the path nearest to it, where it was touched when last looked at
        spare, last_x, last_y, last_angle = -1.0, 0.0, 0.0, 0.0  # how far it may move from there and stay clear
        for t in range(steps):
            if not present[a, t]:
                continue
            x, y, angle = position[a, t, 0], position[a, t, 1], other_heading[a, t]
            begin, end = 0, points.shape[1]
            if reach <= raster_reach:
                across, up = (x - x0) * per_m, (y - y0) * per_m
                if across < 0.0 or up < 0.0 or across >= columns or up >= rows:
                    continue
                begin, end = first_point[int(across), int(up)], last_point[int(across), int(up)] + 1
                if begin < 0:
                    continue
            if spare > 0.0:
                turned = abs(angle - last_angle)
                if np.sqrt((x - last_x) ** 2 + (y - last_y) ** 2) + turned * (half_l + half_w) < spare:
                    continue
            moved = abs(x - position[a, t - 1, 0]) + abs(y - position[a, t - 1, 1]) if t > 0 else np.inf
            if moved == 0.0 and present[a, t - 1] and angle == other_heading[a, t - 1]:
                low[k, t], high[k, t] = low[k, t - 1], high[k, t - 1]
                same_direction[k, t], crossing[k, t] = same_direction[k, t - 1], crossing[k, t - 1]
                if nearest >= 0:
                    along[k, t] = velocity[a, t, 0] * points[2, nearest] + velocity[a, t, 1] * points[3, nearest]
                continue
            # between an end of the range and the first point within reach nothing needs to be looked at
            far = reach if moved < 0.1 else reach - _WIDER_M
            leap = int((np.sqrt((x - points[0, begin]) ** 2 + (y - points[1, begin]) ** 2) - far) / TABLE_STEP_M)
            begin += min(max(leap, 0), end - begin - 1)
            leap = int((np.sqrt((x - points[0, end - 1]) ** 2 + (y - points[1, end - 1]) ** 2) - far) / TABLE_STEP_M)
            end -= min(max(leap, 0), end - begin - 1)
            near = gaps[: end - begin]
            _gaps(near, points, begin, end, x, y, np.cos(angle), np.sin(angle), own_l, own_w, half_l, half_w)
            first, last = _touched(near)
            if first < 0:
                nearest = -1
                if moved < 0.1:
                    spare, last_x, last_y, last_angle = min(near.min(), _WIDER_M) - 1e-6, x, y, angle
                continue
            nearest = _nearest(points, begin, end, x, y)
            low[k, t], high[k, t] = (begin + first - 1) * TABLE_STEP_M, (begin + last + 1) * TABLE_STEP_M
            along[k, t] = velocity[a, t, 0] * points[2, nearest] + velocity[a, t, 1] * points[3, nearest]
            turned = np.cos(angle - heading[nearest])
            same_direction[k, t], crossing[k, t] = turned > SAME_WAY, abs(turned) <= _CROSSES
            spare, hit = 0.0, True
        if hit:
            found_rows[k] = a
            count += 1
    low, high, along = low[:count].copy(), high[:count].copy(), along[:count].copy()
    return found_rows[:count].copy(), low, high, along, same_direction[:count].copy(), crossing[:count].copy()
