"""Where others are along a path, at each step: boxes turned into forbidden intervals of the own centre's arc length.

Recorded agents enter with their true future, generated ones with their predicted one (paper, Trajectory Generation,
conflict case 3).
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from hid2.agents import FloatArray
from hid2.kernels.boxes import apart, overlap
from hid2.motion.reference_line import TABLE_STEP_M, ReferenceLine
from hid2.occupancy.traffic import BoolArray, Traffic

_WIDER_M = 1.0  # who stands is measured more widely, so that it need not be looked at again when a tracker jitters
_NEAR_M = (
    11.0  # half the diagonals of a large car and of a bus, or of a car that keeps room for a lane change, and that
)


@dataclass(frozen=True, eq=False, slots=True)
class PathOccupancy:
    """Forbidden intervals of the own box centre on one path.

    low, high (A, T) m: the own box touches the agent's (with the lateral margin) while low < s < high; low is +inf and
    high is -inf where it never does. along (A, T) m/s: the agent's speed in the path's direction there.
    aligned (A, T): it moves with the path (a leader or follower) rather than across or against it; crosses (A, T): it
    moves across, rather than with or against it.
    """

    low: FloatArray
    high: FloatArray
    along: FloatArray
    aligned: np.ndarray[tuple[int, int], np.dtype[np.bool_]]
    crosses: np.ndarray[tuple[int, int], np.dtype[np.bool_]]

    def kept_clear(self, steps: int, *, margin_m: float) -> "PathOccupancy":
        """The same, with the place of who crosses taken so many steps before and after: PET is kept at crossings.

        margin_m: what is kept to a box that is there needs not be kept to one that was or will be: the place is
        smaller by so much on both sides then.
        """
        if not self.crosses.any():
            return self
        low, high, aligned = _kept_clear(self.low, self.high, self.aligned, self.crosses, steps, margin_m)
        return PathOccupancy(low=low, high=high, along=self.along, aligned=aligned, crosses=self.crosses)

    def joined(self, *others: "PathOccupancy") -> "PathOccupancy":
        """Agents of all, self first."""
        every = [one for one in (self, *others) if one.low.shape[0]]
        if len(every) <= 1:
            return every[0] if every else self
        return PathOccupancy(
            low=np.concatenate([one.low for one in every]),
            high=np.concatenate([one.high for one in every]),
            along=np.concatenate([one.along for one in every]),
            aligned=np.concatenate([one.aligned for one in every]),
            crosses=np.concatenate([one.crosses for one in every]),
        )


def path_occupancy(
    line: ReferenceLine,
    traffic: Traffic,
    *,
    length_m: float,
    width_m: float,
    margin_lateral_m: float,
    clear_steps: int = 0,
    clear_margin_m: float = 0.0,
) -> PathOccupancy:
    """Intervals of every agent of `traffic` on `line` for a box of the given size. Only agents that ever touch it.

    clear_steps, clear_margin_m: as in `PathOccupancy.kept_clear`, unless 0. What is found is kept with the traffic, for
    what is joined to it, too: vehicles are planned one after the other, and each looks along the same few paths.
    """
    if not traffic.ids:
        return _nobody(traffic.num_steps)
    key = line, length_m, width_m, margin_lateral_m, clear_steps, clear_margin_m
    if key not in traffic.known:
        before = traffic.joined_to
        while before is not None and key not in before.known:
            before = before.joined_to
        since = 0 if before is None else len(before.ids)
        _, new = look_along(line, traffic, length_m, width_m + 2 * margin_lateral_m, since)
        if clear_steps > 0:
            new = new.kept_clear(clear_steps, margin_m=clear_margin_m)
        traffic.known[key] = new if before is None else before.known[key].joined(new)
    found: PathOccupancy = traffic.known[key]
    return found


def _nobody(steps: int) -> PathOccupancy:
    nowhere = np.zeros((0, steps))
    never = np.zeros((0, steps), dtype=np.bool_)
    return PathOccupancy(nowhere, nowhere, nowhere, never, never)


def look_along(
    line: ReferenceLine, traffic: Traffic, length_m: float, width_m: float, since: int = 0
) -> tuple[np.ndarray[tuple[int], np.dtype[np.int64]], PathOccupancy]:
    """Rows of the agents, from `since` on, that ever touch the line, and their intervals; width_m with all margins."""
    near, points = line.near(_NEAR_M)
    others = (
        traffic.position, traffic.heading, traffic.velocity, traffic.present, traffic.length_m, traffic.width_m,
    )  # fmt: skip
    rows, *found = _intervals(points, line.table_heading, TABLE_STEP_M, near, length_m, width_m, others, since)
    return rows, PathOccupancy(*found)


def meet_all(
    traffic: Traffic, step: int, center: FloatArray, heading: FloatArray, length_m: FloatArray, width_m: float
) -> BoolArray:
    """(B,) whether each of many boxes touches any agent at a step.

    Centres (B, 2) m, headings (B,) rad, lengths (B,) m, and one width, m.
    """
    others = traffic.position, traffic.heading, traffic.present, traffic.length_m, traffic.width_m
    return _meet_all(center, heading, length_m, width_m, step, *others)  # type: ignore[no-any-return]


@njit(cache=True)
def _meet_all(center, direction, length, width, step, position, heading, present, lengths, widths):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    found = np.empty(length.size, dtype=np.bool_)
    for b in range(length.size):
        found[b] = meets(
            center[b, 0], center[b, 1], direction[b], length[b], width, step, position, heading, present, lengths,
            widths,
        )  # fmt: skip
    return found


@njit(cache=True)
def meets(x, y, direction, length, width, step, position, heading, present, lengths, widths):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Whether a box touches any agent at a step, for compiled loops."""
    cosine, sine = np.cos(direction), np.sin(direction)
    reach = np.hypot(length, width) / 2
    for a in range(present.shape[0]):
        if not present[a, step]:
            continue
        dx, dy = position[a, step, 0] - x, position[a, step, 1] - y
        if dx * dx + dy * dy > (reach + np.hypot(lengths[a], widths[a]) / 2) ** 2:
            continue
        angle = heading[a, step]
        if overlap(
            x, y, cosine, sine, length / 2, width / 2,
            x + dx, y + dy, np.cos(angle), np.sin(angle), lengths[a] / 2, widths[a] / 2,
        ):  # fmt: skip
            return True
    return False


@njit(cache=True)
def _kept_clear(low, high, aligned, crosses, steps, margin):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Who crosses also holds the path where it does so, `steps` before and after."""
    wide_low, wide_high, leads = low.copy(), high.copy(), aligned.copy()
    agents, last = low.shape
    for a in range(agents):
        for t in range(last):
            if low[a, t] == np.inf:
                leads[a, t] = False
                continue
            if not crosses[a, t]:
                continue
            for k in range(max(0, t - steps), min(last, t + steps + 1)):
                if low[a, k] != np.inf and aligned[a, k]:
                    continue
                if high[a, t] - low[a, t] <= 2 * margin or k == t:
                    continue
                wide_low[a, k] = min(wide_low[a, k], low[a, t] + margin)
                wide_high[a, k] = max(wide_high[a, k], high[a, t] - margin)
    return wide_low, wide_high, leads


@njit(cache=True)
def _gaps(gaps, points, begin, end, x, y, bc, bs, own_l, own_w, half_l, half_w) -> None:  # type: ignore[no-untyped-def]  # noqa: ANN001
    """How far the own box at points `begin` to `end` is apart from an agent's, into gaps.

    A loop without branches over contiguous columns: the compiler does several points at once.
    """
    xs, ys = points[0, begin:end], points[1, begin:end]
    cosine, sine = points[2, begin:end], points[3, begin:end]
    for i in range(xs.size):
        gaps[i] = apart(xs[i], ys[i], cosine[i], sine[i], own_l, own_w, x, y, bc, bs, half_l, half_w)


@njit(cache=True)
def _touched(gaps):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """First and last point without a gap; -1 twice where there is none."""
    for first in range(gaps.size):
        if gaps[first] <= 0.0:
            last = gaps.size - 1
            while gaps[last] > 0.0:
                last -= 1
            return first, last
    return -1, -1


@njit(cache=True)
def _nearest(points, begin, end, x, y):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Of points `begin` to `end` the one nearest to a place."""
    nearest, least = begin, np.inf
    for i in range(begin, end):
        square = (x - points[0, i]) ** 2 + (y - points[1, i]) ** 2
        if square < least:
            nearest, least = i, square
    return nearest


@njit(cache=True)
def _intervals(points, heading, step, raster, length, width, others, since):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Rows of those who touch the path, and their intervals: box against box at every point of it near the agent.

    points (4, K): x, y, cosine and sine. length, width: of the own box. since: the first agent looked at.
    Who stands, or jitters as trackers do, is not looked at again before it can have come to touch the path.
    """
    position, other_heading, velocity, present, lengths, widths = others
    agents, steps = present.shape
    low, high, along = np.empty((agents, steps)), np.empty((agents, steps)), np.empty((agents, steps))
    aligned, crosses = np.empty((agents, steps), dtype=np.bool_), np.empty((agents, steps), dtype=np.bool_)
    who, count = np.empty(agents, dtype=np.int64), 0
    gaps = np.empty(points.shape[1])
    own_l, own_w = length / 2, width / 2
    (columns, rows), per_m = raster.first.shape, 1.0 / raster.side_m
    for a in range(since, agents):
        half_l, half_w = lengths[a] / 2, widths[a] / 2
        reach = np.hypot(own_l, own_w) + np.hypot(half_l, half_w) + _WIDER_M
        k, hit = count, False  # row of the result
        low[k], high[k], along[k], aligned[k], crosses[k] = np.inf, -np.inf, 0.0, False, False
        nearest = -1  # point of the path nearest to it, where it was touched when last looked at
        spare, last_x, last_y, last_angle = -1.0, 0.0, 0.0, 0.0  # how far it may move from there and stay clear
        for t in range(steps):
            if not present[a, t]:
                continue
            x, y, angle = position[a, t, 0], position[a, t, 1], other_heading[a, t]
            begin, end = 0, points.shape[1]
            if reach <= raster.reach_m:
                across, up = (x - raster.x0) * per_m, (y - raster.y0) * per_m
                if across < 0.0 or up < 0.0 or across >= columns or up >= rows:
                    continue
                begin, end = raster.first[int(across), int(up)], raster.last[int(across), int(up)] + 1
                if begin < 0:
                    continue
            if spare > 0.0:
                turned = abs((angle - last_angle + np.pi) % (2 * np.pi) - np.pi)
                if np.sqrt((x - last_x) ** 2 + (y - last_y) ** 2) + turned * (half_l + half_w) < spare:
                    continue
            if (
                t > 0
                and present[a, t - 1]
                and x == position[a, t - 1, 0]
                and y == position[a, t - 1, 1]
                and angle == other_heading[a, t - 1]
            ):
                low[k, t], high[k, t] = low[k, t - 1], high[k, t - 1]
                aligned[k, t], crosses[k, t] = aligned[k, t - 1], crosses[k, t - 1]
                if nearest >= 0:
                    along[k, t] = velocity[a, t, 0] * points[2, nearest] + velocity[a, t, 1] * points[3, nearest]
                continue
            # between an end of the range and the first point within reach nothing needs to be looked at
            leap = int((np.sqrt((x - points[0, begin]) ** 2 + (y - points[1, begin]) ** 2) - reach) / step)
            begin += min(max(leap, 0), end - begin - 1)
            leap = int((np.sqrt((x - points[0, end - 1]) ** 2 + (y - points[1, end - 1]) ** 2) - reach) / step)
            end -= min(max(leap, 0), end - begin - 1)
            near = gaps[: end - begin]
            _gaps(near, points, begin, end, x, y, np.cos(angle), np.sin(angle), own_l, own_w, half_l, half_w)
            first, last = _touched(near)
            if first < 0:
                nearest = -1
                if t > 0 and abs(x - position[a, t - 1, 0]) + abs(y - position[a, t - 1, 1]) < 0.1:
                    spare, last_x, last_y, last_angle = min(near.min(), _WIDER_M) - 1e-6, x, y, angle
                continue
            nearest = _nearest(points, begin, end, x, y)
            low[k, t], high[k, t] = (begin + first - 1) * step, (begin + last + 1) * step
            along[k, t] = velocity[a, t, 0] * points[2, nearest] + velocity[a, t, 1] * points[3, nearest]
            turned = np.cos(angle - heading[nearest])
            aligned[k, t], crosses[k, t] = turned > 0.7, abs(turned) <= 0.87
            spare, hit = 0.0, True
        if hit:
            who[k] = a
            count += 1
    found = (
        low[:count].copy(),
        high[:count].copy(),
        along[:count].copy(),
        aligned[:count].copy(),
        crosses[:count].copy(),
    )
    return who[:count].copy(), *found
