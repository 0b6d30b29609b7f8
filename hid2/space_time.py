"""Where others are along a path, at each step: the space-time view behind every check for conflicts.

Boxes of others are turned into forbidden intervals of the own centre's arc length. Recorded agents enter with their
true future, generated ones with their predicted one (paper, Trajectory Generation, conflict case 3).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numba import njit

from hid2.agents import BoxSize, FloatArray
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
        if _overlap(
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
def _overlap(
    ax: float, ay: float, ac: float, asn: float, al: float, aw: float,
    bx: float, by: float, bc: float, bs: float, bl: float, bw: float,
) -> bool:  # fmt: skip
    """Separating axes of two boxes given by centre, cosine and sine of the heading, half length and half width."""
    dx, dy = bx - ax, by - ay
    c, s = abs(ac * bc + asn * bs), abs(ac * bs - asn * bc)
    if abs(dx * ac + dy * asn) > al + bl * c + bw * s:
        return False
    if abs(-dx * asn + dy * ac) > aw + bl * s + bw * c:
        return False
    if abs(dx * bc + dy * bs) > bl + al * c + aw * s:
        return False
    return not abs(-dx * bs + dy * bc) > bw + al * s + aw * c


@njit(cache=True)
def _apart(
    ax: float, ay: float, ac: float, asn: float, al: float, aw: float,
    bx: float, by: float, bc: float, bs: float, bl: float, bw: float,
) -> float:  # fmt: skip
    """The same axes: how far apart the boxes are at least, m; not above 0 where they overlap."""
    dx, dy = bx - ax, by - ay
    c, s = abs(ac * bc + asn * bs), abs(ac * bs - asn * bc)
    return max(
        abs(dx * ac + dy * asn) - (al + bl * c + bw * s),
        abs(-dx * asn + dy * ac) - (aw + bl * s + bw * c),
        abs(dx * bc + dy * bs) - (bl + al * c + aw * s),
        abs(-dx * bs + dy * bc) - (bw + al * s + aw * c),
    )


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
                        apart = _apart(
                            xy[i, 0], xy[i, 1], cosine[i], sine[i], own_l, own_w, x, y, bc, bs, half_l, half_w
                        )
                        clear, hit = min(clear, apart), apart <= 0.0
                    else:
                        clear = 0.0
                        hit = _overlap(
                            xy[i, 0], xy[i, 1], cosine[i], sine[i], own_l, own_w, x, y, bc, bs, half_l, half_w
                        )
                    first = i
                last = i
                leap = 0
                i += 1
            if hit:  # from its other end; between the two only the distance matters
                while last > first and not _overlap(
                    xy[last, 0], xy[last, 1], cosine[last], sine[last], own_l, own_w, x, y, bc, bs, half_l, half_w
                ):
                    last -= 1
                low[a, t], high[a, t] = (first - 1) * step, (last + 1) * step
                along[a, t] = velocity[a, t, 0] * cosine[near] + velocity[a, t, 1] * sine[near]
                turned = np.cos(angle - heading[near])
                aligned[a, t], crosses[a, t] = turned > 0.7, abs(turned) <= 0.7
                nearest, spare, touched[a] = near, 0.0, True
                continue
            if leap > 0:  # from the last point looked at to the end of the path
                closest = min(closest, before - (points - 1 - (i - leap)) * step)
            spare, last_x, last_y, last_angle = min(clear, closest - reach - step) - 1e-6, x, y, angle
    return low, high, along, aligned, crosses, touched


@dataclass(frozen=True, eq=False, slots=True)
class SpaceTime:
    """What the search of a speed profile looks up, by step and by arc length in cells of TABLE_STEP_M.

    Rows are worked out where the search comes to, not for the whole scene. margin_m is kept to every interval of the
    occupancy; from cell `beyond` on the path is off the map: nobody is met there, but to be there before
    earliest_exit_step is forbidden. Before hold_until, cells from hold_from on are forbidden too.
    """

    occupancy: PathOccupancy
    num_steps: int
    cells: int
    margin_m: float
    ttc_s: float
    time_gap_s: float
    beyond: int
    earliest_exit_step: int
    hold_until: int = 0
    hold_from: int = 0

    @property
    def blocked(self) -> np.ndarray[tuple[int, int], np.dtype[np.uint8]]:
        """(T, S): the own centre may not be there then."""
        return self._tables()[0]

    @property
    def fastest(self) -> FloatArray:
        """(T, S) m/s: speed at which the TTC to the aligned leader ahead is still the critical one."""
        return self._tables()[1]

    @property
    def pushed(self) -> FloatArray:
        """(T, S) m/s: slower than this, a follower closes in too fast."""
        return self._tables()[2]

    def speeds_at(self, step: int, s: float) -> tuple[float, float]:
        """`fastest` and `pushed` at one step and arc length, m/s."""
        cell = min(int(s / TABLE_STEP_M + 0.5), self.cells - 1)
        _, fastest, pushed = self._tables(step, step + 1, cell, cell + 1)
        return float(fastest[0, 0]), float(pushed[0, 0])

    def is_blocked(self, s: FloatArray, first_step: int) -> bool:
        """Whether a driven s(t), (M,) m from first_step on, is anywhere that it may not be."""
        cells = np.clip((s / TABLE_STEP_M + 0.5).astype(np.int64), 0, self.cells - 1)
        return bool(_any_blocked(cells, first_step, self.view()))

    def held(self, until_step: int, s: float) -> "SpaceTime":
        """The same, but not beyond arc length s before until_step."""
        return replace(self, hold_until=until_step, hold_from=int(s / TABLE_STEP_M) + 1)

    def view(self) -> tuple[Any, ...]:
        """Everything as the compiled functions take it."""
        seen = self.occupancy
        return (
            seen.low, seen.high, seen.along, seen.aligned, self.cells, TABLE_STEP_M, self.margin_m, self.ttc_s,
            self.time_gap_s, self.beyond, self.earliest_exit_step, self.hold_until, self.hold_from,
        )  # fmt: skip

    def _tables(
        self, first: int = 0, last: int | None = None, left: int = 0, right: int | None = None
    ) -> tuple[np.ndarray[tuple[int, int], np.dtype[np.uint8]], FloatArray, FloatArray]:
        last = self.num_steps if last is None else last
        right = self.cells if right is None else right
        return _tables(first, last, left, right, self.view())  # type: ignore[no-any-return]


def space_time(
    occupancy: PathOccupancy,
    *,
    table_length: int,
    num_steps: int,
    margin_m: float,
    ttc_s: float,
    time_gap_s: float,
    exit_s: float,
    earliest_exit_step: int,
) -> SpaceTime:
    """View of intervals. exit_s: arc length at which the path leaves the map, not before earliest_exit_step."""
    return SpaceTime(
        occupancy=occupancy,
        num_steps=num_steps,
        cells=table_length,
        margin_m=margin_m,
        ttc_s=ttc_s,
        time_gap_s=time_gap_s,
        beyond=int(exit_s / TABLE_STEP_M),
        earliest_exit_step=earliest_exit_step,
    )


@njit(cache=True)
def _any_blocked(at, first_step, view):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    row = np.zeros(1, dtype=np.uint8)
    for k in range(at.size):
        _block_row(row, first_step + k, at[k], at[k] + 1, view)
        if row[0] == 1:
            return True
    return False


@njit(cache=True)
def _tables(start, end, left, right, view):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Rows `start` to `end` of all three tables, cells `left` to `right`."""
    blocked = np.zeros((end - start, right - left), dtype=np.uint8)
    fastest = np.empty((end - start, right - left))
    pushed = np.empty((end - start, right - left))
    for t in range(start, end):
        k = t - start
        _block_row(blocked[k], t, left, right, view)
        _speed_rows(fastest[k], pushed[k], t, left, right, view)
    return blocked, fastest, pushed


@njit(cache=True)
def _block_row(row, t, left, right, view):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Whether cells left .. right - 1 are forbidden at step t, into row[0 .. right - left - 1]."""
    low, high, _, _, cells, step, margin, _, _, beyond, earliest, until, hold = view
    row[: right - left] = 0
    for a in range(low.shape[0]):
        if low[a, t] == np.inf:
            continue
        first = max(left, min(max(0, int(np.ceil((low[a, t] - margin) / step))), cells))
        last = min(right - 1, max(-1, min(cells - 1, int(np.floor((high[a, t] + margin) / step)))))
        for i in range(first, last + 1):
            row[i - left] = 1
    for i in range(max(left, beyond), right):  # off the map nobody is met; to be there too early is forbidden
        row[i - left] = 1 if t < earliest else 0
    if t < until:
        for i in range(max(left, hold), right):
            row[i - left] = 1


@njit(cache=True)
def _speed_rows(fastest, pushed, t, left, right, view):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Fastest and pushed speed in cells left .. right - 1 at step t, into [0 .. right - left - 1]."""
    low, high, along, aligned, cells, step, margin, ttc, time_gap, beyond, _, _, _ = view
    fastest[: right - left] = 99.0
    pushed[: right - left] = 0.0
    for a in range(low.shape[0]):
        if low[a, t] == np.inf or not aligned[a, t]:
            continue
        front, rear = low[a, t] - margin, high[a, t] + margin
        first = min(max(0, int(np.ceil(front / step))), cells)
        last = max(-1, min(cells - 1, int(np.floor(rear / step))))
        speed = along[a, t]
        for i in range(max(left, first - int(80.0 / step)), min(right, first)):
            gap = front - i * step
            limit = speed + gap / ttc
            if time_gap > 0 and gap < speed * time_gap:
                limit = min(limit, max(speed, (gap + margin) / time_gap))
            if limit < fastest[i - left]:
                fastest[i - left] = limit
        for i in range(max(left, last + 1), min(right, last + 1 + int(40.0 / step))):
            needed = speed - (i * step - rear) / ttc
            if needed > pushed[i - left]:
                pushed[i - left] = needed
    for i in range(max(left, beyond), right):
        fastest[i - left] = np.inf
        pushed[i - left] = 0.0


@dataclass(frozen=True, eq=False, slots=True)
class SpeedPlan:
    """s (T,) m and v (T,) m/s at every step from the first one planned, and its cost."""

    s: FloatArray
    v: FloatArray
    cost: float


def plan_speed(
    tables: SpaceTime,
    desired: FloatArray,
    *,
    s0: float,
    v0: float | Sequence[float],
    a0: float,
    first_step: int,
    accel_max: float,
    accel_min: float,
    step_s: float,
    most: FloatArray | None = None,
    reference: FloatArray | None = None,
) -> SpeedPlan | None:
    """Best speed profile on the path from (s0, v0) that meets nobody; None where there is none.

    Search over time, arc length and speed (stages of half a second, constant acceleration in each but the first, in
    which it builds up; one representative per bin of 1.5 m and 0.75 m/s).
    desired (S,) m/s: target speed, exceeded by at most 4 m/s; most (S,) m/s: what the road allows at all.
    v0: speed at the start, or several, of which the first that is possible is taken.
    reference (T,) m: a driven s(t) to stay near, where given. This is "adjust timing" of conflict case 3.
    """
    accels = np.array(
        [
            accel_min,
            0.75 * accel_min,
            0.5 * accel_min,
            0.25 * accel_min,
            0.0,
            accel_max / 3,
            accel_max * 2 / 3,
            accel_max,
        ]
    )
    use_reference = reference is not None
    ok, s, v, cost = _search(
        tables.view(), desired, desired + _OVER_MPS if most is None else np.minimum(most, desired + _OVER_MPS),
        s0, np.atleast_1d(np.asarray(v0, dtype=np.float64)), a0, first_step, tables.num_steps, accels, step_s,
        reference if reference is not None else np.zeros(tables.num_steps), use_reference,
    )  # fmt: skip
    if not ok:
        return None
    return SpeedPlan(s=s, v=v, cost=float(cost))


STAGE_STEPS = 5
_STEEPEST = 1.65  # m/s2 by which the acceleration changes within a stage: a jerk that the smoothing allows too
_OVER_MPS = 4.0
_S_BIN, _V_BIN, _V_BINS = 1.5, 0.75, 48
_STATES_MOST = 3000
_SECOND_CHOICE = 1e3  # cost of a start that is not the first one named


@njit(cache=True)
def _advance(s, v, a, ramp, dt):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """One step at a constant jerk `ramp`; who would roll back stands."""
    then = v + a * dt + 0.5 * ramp * dt * dt
    if then <= 0.0:
        return s + (0.5 * v * dt * v / (v - then) if v > 0.0 else 0.0), 0.0, 0.0
    return s + v * dt + 0.5 * a * dt * dt + ramp * dt * dt * dt / 6.0, then, a + ramp * dt


@njit(cache=True)
def _search(view, desired, ceiling, s0, v0, a0, first, steps, accels, dt, reference, use_reference):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    cells, step = view[4], view[5]
    s_bins = int(cells * step / _S_BIN) + 1
    stages = (steps - 1 - first + STAGE_STEPS - 1) // STAGE_STEPS
    out_s = np.zeros(steps - first)
    out_v = np.zeros(steps - first)
    room = _STATES_MOST * (stages + 1)  # states of all stages one behind the other: memory is touched as it is used
    all_s, all_v, all_a, all_c = np.empty(room), np.empty(room), np.empty(room), np.empty(room)
    parent, keys = np.empty(room, dtype=np.int32), np.empty(room, dtype=np.int32)
    begin = np.zeros(stages + 2, dtype=np.int64)
    slot = np.full((s_bins + 1) * _V_BINS, -1, dtype=np.int32)
    blocked = np.empty((STAGE_STEPS + 1, cells), dtype=np.uint8)
    fastest, pushed = np.empty((STAGE_STEPS + 1, cells)), np.empty((STAGE_STEPS + 1, cells))
    most = accels.max()
    for i in range(v0.size):
        all_s[i], all_v[i], all_a[i], all_c[i] = s0, v0[i], a0, i * _SECOND_CHOICE
    begin[1] = v0.size
    for k in range(stages):
        t0 = first + k * STAGE_STEPS
        sub = min(STAGE_STEPS, steps - 1 - t0)
        here, there = begin[k], begin[k + 1]
        n_next = 0
        lasting = sub * dt
        left, right = all_s[here], 0.0
        for index in range(here, there):
            left = min(left, all_s[index])
            right = max(right, all_s[index] + all_v[index] * lasting)
        right += 0.5 * most * lasting * lasting
        left_cell = min(cells - 1, max(0, int(left / step + 0.5) - 1))
        right_cell = min(cells, int(right / step + 0.5) + 2)
        for m in range(1, sub + 1):
            _block_row(blocked[m], t0 + m, left_cell, right_cell, view)
            if m == sub or m == 3:
                _speed_rows(fastest[m], pushed[m], t0 + m, left_cell, right_cell, view)
        widen = 1.0 + 0.06 * k  # far ahead, nearby states need not be told apart as finely
        s_bin, v_bin = _S_BIN * widen, _V_BIN * widen
        for index in range(here, there):
            s, v, previous, cost = all_s[index], all_v[index], all_a[index], all_c[index]
            for accel in accels:
                if abs(accel - previous) > _STEEPEST:
                    continue
                # nothing can be prepared before the first stage: there the acceleration needs its time to build up
                sn, vn, an = s, v, previous if k == 0 else accel
                ramp = (accel - previous) / (STAGE_STEPS * dt) if k == 0 else 0.0
                good = True
                extra = 0.0
                for m in range(1, sub + 1):
                    sn, vn, an = _advance(sn, vn, an, ramp, dt)
                    cell = int(sn / step + 0.5)
                    if cell >= cells:
                        cell = cells - 1
                    if blocked[m, cell - left_cell] == 1:
                        good = False
                        break
                    if m != sub and m != 3:  # TTC and speed change slowly: looked up twice a stage
                        continue
                    if vn > fastest[m, cell - left_cell]:
                        good = False
                        break
                    if vn < pushed[m, cell - left_cell]:
                        extra += 7.5 * (pushed[m, cell - left_cell] - vn)
                    if vn > desired[cell] + 0.2:
                        over = vn - desired[cell]
                        if vn > ceiling[cell]:
                            good = False
                            break
                        extra += 5.0 * over * over
                if not good:
                    continue
                cell = min(cells - 1, int(sn / step + 0.5))
                lag = desired[cell] - vn
                if use_reference:
                    off = sn - reference[t0 + sub]
                    new_cost = cost + 0.05 * off * off + 0.1 * lag * lag
                else:
                    new_cost = cost + 0.6 * lag * lag
                if vn < 0.5:
                    new_cost += 1.0
                new_cost += extra + 0.5 * accel * accel + 0.8 * (accel - previous) ** 2
                vb = min(_V_BINS - 1, int(vn / v_bin + 0.5))
                sb = min(s_bins, int(sn / s_bin + 0.5))
                key = sb * _V_BINS + vb
                at = slot[key] if k > 0 else -1
                if at < 0:
                    if n_next >= _STATES_MOST:
                        continue
                    at = there + n_next
                    slot[key] = at
                    n_next += 1
                elif all_c[at] <= new_cost:
                    continue
                all_s[at], all_v[at], all_a[at] = sn, vn, accel
                all_c[at] = new_cost
                parent[at] = index
                keys[at] = key
        begin[k + 2] = there + n_next
        if n_next == 0:
            return False, out_s, out_v, 0.0
        for index in range(there, there + n_next):
            slot[keys[index]] = -1
    best = begin[stages]
    for index in range(begin[stages], begin[stages + 1]):
        if all_c[index] < all_c[best]:
            best = index
    total = all_c[best]
    out_s[0] = s0
    for k in range(stages, 0, -1):
        source = parent[best]
        s, v, accel, ramp = all_s[source], all_v[source], all_a[best], 0.0
        if k == 1:
            accel, ramp = all_a[source], (accel - all_a[source]) / (STAGE_STEPS * dt)
        t0 = (k - 1) * STAGE_STEPS
        sub = min(STAGE_STEPS, steps - 1 - first - t0)
        for m in range(1, sub + 1):
            s, v, accel = _advance(s, v, accel, ramp, dt)
            out_s[t0 + m], out_v[t0 + m] = s, v
        best = source
    out_v[0] = all_v[best]
    return True, out_s, out_v, total
