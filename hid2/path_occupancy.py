"""Where others are along a path, at each step: boxes turned into forbidden intervals of the own centre's arc length.

Recorded agents enter with their true future, generated ones with their predicted one (paper, Trajectory Generation,
conflict case 3).
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from hid2.agents import BoxSize, FloatArray
from hid2.boxes import apart, overlap
from hid2.reference_line import TABLE_STEP_M, ReferenceLine
from hid2.traffic import Traffic


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

    def rows(self, rows: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> "PathOccupancy":
        """Some of the agents, (A,) mask."""
        return PathOccupancy(self.low[rows], self.high[rows], self.along[rows], self.aligned[rows], self.crosses[rows])

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
    line: ReferenceLine, traffic: Traffic, *, length_m: float, width_m: float, margin_lateral_m: float
) -> PathOccupancy:
    """Intervals of every agent of `traffic` on `line` for a box of the given size. Only agents that ever touch it.

    What is found is kept with the traffic, part by part: vehicles are planned one after the other, and each looks along
    the same few paths.
    """
    key = line, length_m, width_m, margin_lateral_m
    parts = traffic.parts
    missing = [part for part in parts if key not in part.known]
    if missing:
        others = traffic if len(missing) == len(parts) else missing[0].joined(*missing[1:])
        touched, found = look_along(line, others, length_m, width_m + 2 * margin_lateral_m)
        if len(missing) == 1:
            missing[0].known[key] = found if touched.size else None
        else:
            part_of = np.repeat(np.arange(len(missing)), [len(part.ids) for part in missing])[touched]
            for part in missing:
                part.known[key] = None
            for number in np.unique(part_of).tolist():
                missing[number].known[key] = found.rows(part_of == number)
        if others is traffic:
            return found
    seen = [one for one in (part.known[key] for part in parts) if one is not None]
    return seen[0].joined(*seen[1:]) if seen else _nobody(traffic.num_steps)


def _nobody(steps: int) -> PathOccupancy:
    nowhere = np.zeros((0, steps))
    never = np.zeros((0, steps), dtype=np.bool_)
    return PathOccupancy(nowhere, nowhere, nowhere, never, never)


def look_along(
    line: ReferenceLine, traffic: Traffic, length_m: float, width_m: float
) -> tuple[np.ndarray[tuple[int], np.dtype[np.int64]], PathOccupancy]:
    """Rows of the agents that ever touch the line, and their intervals; width_m with all margins."""
    low, high, along, aligned, crosses, touched = _intervals(
        line.table_xy,
        line.table_heading,
        TABLE_STEP_M,
        length_m,
        width_m,
        traffic.position,
        traffic.heading,
        traffic.velocity,
        traffic.present,
        traffic.length_m,
        traffic.width_m,
    )
    rows = np.flatnonzero(touched)
    if rows.size == len(traffic.ids):
        return rows, PathOccupancy(low, high, along, aligned, crosses)
    return rows, PathOccupancy(low[rows], high[rows], along[rows], aligned[rows], crosses[rows])


def meets(traffic: Traffic, step: int, x: float, y: float, heading: float, size: BoxSize) -> bool:
    """Whether a box with its centre at x, y m, heading in rad, touches any agent at a step."""
    return bool(
        _meets(
            x, y, heading, size.length_m, size.width_m, step,
            traffic.position, traffic.heading, traffic.present, traffic.length_m, traffic.width_m,
        )
    )  # fmt: skip


@njit(cache=True)
def _meets(x, y, direction, length, width, step, position, heading, present, lengths, widths):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
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
def _intervals(xy, heading, step, own_length, own_width, position, other_heading, velocity, present, lengths, widths):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """March along the path in steps that cannot jump over the agent, then test box against box.

    An agent that is clear of the whole path is not looked at again before it can have come to touch it.
    """
    agents, steps = present.shape
    points = xy.shape[0]
    low = np.full((agents, steps), np.inf)
    high = np.full((agents, steps), -np.inf)
    along, aligned = np.zeros((agents, steps)), np.zeros((agents, steps), dtype=np.bool_)
    crosses = np.zeros((agents, steps), dtype=np.bool_)
    touched = np.zeros(agents, dtype=np.bool_)
    cosine, sine = np.cos(heading), np.sin(heading)
    own_l, own_w = own_length / 2, own_width / 2
    own_radius = np.hypot(own_l, own_w)
    left, right, bottom, top = xy[:, 0].min(), xy[:, 0].max(), xy[:, 1].min(), xy[:, 1].max()
    for a in range(agents):
        half_l, half_w = lengths[a] / 2, widths[a] / 2
        reach = own_radius + np.hypot(half_l, half_w)
        nearest = -1  # point of the path nearest to it, where it was touched when last looked at
        spare, last_x, last_y, last_angle = -1.0, 0.0, 0.0, 0.0  # how far it may move from there and stay clear
        for t in range(steps):
            if not present[a, t]:
                continue
            x, y, angle = position[a, t, 0], position[a, t, 1], other_heading[a, t]
            if x < left - reach or x > right + reach or y < bottom - reach or y > top + reach:
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
                low[a, t], high[a, t] = low[a, t - 1], high[a, t - 1]
                aligned[a, t], crosses[a, t] = aligned[a, t - 1], crosses[a, t - 1]
                if nearest >= 0:
                    along[a, t] = velocity[a, t, 0] * cosine[nearest] + velocity[a, t, 1] * sine[nearest]
                continue
            nearest = -1
            bc, bs = np.cos(angle), np.sin(angle)
            i, near = 0, 0
            best, closest, clear = np.inf, np.inf, np.inf
            before, leap = 0.0, 0  # distance at the point last looked at, and how many points behind that lies
            hit, first, last = False, 0, 0
            # who stands, or jitters as trackers do, is measured more widely, once for as long as it stands
            still = t > 0 and abs(x - position[a, t - 1, 0]) + abs(y - position[a, t - 1, 1]) < 0.1
            far = reach + 2.0 if still else reach
            while i < points:
                dx, dy = x - xy[i, 0], y - xy[i, 1]
                square = dx * dx + dy * dy
                if square < best:
                    best, near = square, i
                if square > far * far:
                    distance = np.sqrt(square)
                    if leap > 0:  # no point between two is nearer than half of what is left of the detour
                        closest = min(closest, (before + distance - leap * step) / 2)
                    before, leap = distance, max(1, int((distance - far) / step))
                    i += leap
                    continue
                if not hit:
                    if still:
                        between = apart(
                            xy[i, 0], xy[i, 1], cosine[i], sine[i], own_l, own_w, x, y, bc, bs, half_l, half_w
                        )
                        clear, hit = min(clear, between), between <= 0.0
                    else:
                        clear = 0.0
                        hit = overlap(
                            xy[i, 0], xy[i, 1], cosine[i], sine[i], own_l, own_w, x, y, bc, bs, half_l, half_w
                        )
                    first = i
                last = i
                leap = 0
                i += 1
            if hit:  # from its other end; between the two only the distance matters
                while last > first and not overlap(
                    xy[last, 0], xy[last, 1], cosine[last], sine[last], own_l, own_w, x, y, bc, bs, half_l, half_w
                ):
                    last -= 1
                low[a, t], high[a, t] = (first - 1) * step, (last + 1) * step
                along[a, t] = velocity[a, t, 0] * cosine[near] + velocity[a, t, 1] * sine[near]
                turned = np.cos(angle - heading[near])
                aligned[a, t], crosses[a, t] = turned > 0.7, abs(turned) <= 0.87
                nearest, spare, touched[a] = near, 0.0, True
                continue
            if leap > 0:  # from the last point looked at to the end of the path
                closest = min(closest, before - (points - 1 - (i - leap)) * step)
            spare, last_x, last_y, last_angle = min(clear, closest - reach - step) - 1e-6, x, y, angle
    return low, high, along, aligned, crosses, touched
