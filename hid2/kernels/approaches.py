"""Recorded vehicles at the approaches of intersections: which of them come from where, enter, wait, and cross."""

import numpy as np
import numpy.typing as npt

from hid2.kernels.boxes import overlap
from hid2.kernels.compiled import inner, kernel
from hid2.kernels.polyline import nearest_on
from netconvert.geometry import BoolArray, FloatArray, IntArray

ByteArray = npt.NDArray[np.uint8]


@kernel("(f8[:,:,::1], f8[:,:,::1], f8[:,::1], b1[:,::1], f8, f8, f8)")
def vehicle_states(
    position: FloatArray, velocity: FloatArray, heading: FloatArray, present: BoolArray,
    flow: float, standing: float, parked: float,
) -> tuple[FloatArray, FloatArray, ByteArray, BoolArray, FloatArray, BoolArray]:  # fmt: skip
    """What `watch_approach` and `crossing_steps` need of each vehicle.

    pose (A, T, 4): x, y m, cosine and sine of the heading; way (A, T, 2): unit vector of the motion; state (A, T): 0
    absent, 1 there, 2 standing; flows (A, T): faster than `flow`, m/s; bounds (A, 4): lowest and highest x, y, m;
    moves (A,): the bounds' diagonal is longer than `parked`, m.
    """
    agents, steps = present.shape
    pose, way = np.zeros((agents, steps, 4)), np.zeros((agents, steps, 2))
    state, flows = np.zeros((agents, steps), dtype=np.uint8), np.zeros((agents, steps), dtype=np.bool_)
    bounds, moves = np.empty((agents, 4)), np.zeros(agents, dtype=np.bool_)
    for a in range(agents):
        bounds[a, :2], bounds[a, 2:] = np.inf, -np.inf
        for t in range(steps):
            if present[a, t]:
                for axis in range(2):
                    bounds[a, axis] = min(bounds[a, axis], position[a, t, axis])
                    bounds[a, axis + 2] = max(bounds[a, axis + 2], position[a, t, axis])
        moves[a] = np.hypot(bounds[a, 2] - bounds[a, 0], bounds[a, 3] - bounds[a, 1]) > parked
        for t in range(steps):
            if not present[a, t]:
                continue
            pose[a, t, 0], pose[a, t, 1] = position[a, t, 0], position[a, t, 1]
            if t > 0 and heading[a, t] == heading[a, t - 1] and present[a, t - 1]:
                pose[a, t, 2], pose[a, t, 3] = pose[a, t - 1, 2], pose[a, t - 1, 3]
            else:
                pose[a, t, 2], pose[a, t, 3] = np.cos(heading[a, t]), np.sin(heading[a, t])
            speed = np.sqrt(velocity[a, t, 0] ** 2 + velocity[a, t, 1] ** 2)
            if speed > 0:
                way[a, t, 0], way[a, t, 1] = velocity[a, t, 0] / speed, velocity[a, t, 1] / speed
            state[a, t] = 2 if speed < standing else 1
            flows[a, t] = moves[a] and speed > flow
    return pose, way, state, flows, bounds, moves


@inner
def _on_lane(
    points: FloatArray, s: FloatArray, reach: float, cos_agrees: float, x: float, y: float, co: float, si: float
) -> tuple[float, float]:
    """Arc length on a centreline and distance from it, m; inf beyond its ends, its reach, or in another direction."""
    nearest, share, best = nearest_on(x, y, points, 0, points.shape[0])
    at_end = (nearest == 0 and share <= 0.0) or (nearest == points.shape[0] - 2 and share >= 1.0)
    if at_end or best > reach * reach:
        return 0.0, np.inf
    ex, ey = points[nearest + 1, 0] - points[nearest, 0], points[nearest + 1, 1] - points[nearest, 1]
    length = np.sqrt(ex * ex + ey * ey)
    if co * ex + si * ey <= cos_agrees * length:
        return 0.0, np.inf
    return s[nearest] + share * length, np.sqrt(best)


@kernel(
    "(f8[:,::1], f8[::1], i8[::1], f8[::1], f8[::1], i8, f8[:,:,::1], u1[:,::1], f8[:,::1], b1[::1], UniTuple(f8, 5))"
)
def watch_approach(
    points: FloatArray, s: FloatArray, first: IntArray, half_width: FloatArray, ahead: FloatArray, fan: int,
    pose: FloatArray, state: ByteArray, bounds: FloatArray, moves: BoolArray,
    rule: tuple[float, float, float, float, float],
) -> tuple[BoolArray, BoolArray, BoolArray]:  # fmt: skip
    """What recorded vehicles do at an approach: comes_from (A,), enters (K, T), waits (K, T).

    Lanes k = 0 .. K - 1 have points[first[k] : first[k + 1]] (m, arc lengths s) and a half width (K,) m. The first
    K - fan of them lead to the entrance, which is ahead[k] m behind their end; the last `fan` begin there.
    comes_from: the vehicle is on a lane directly before the entrance (ahead 0), or on the first third of one behind it,
    at some step. enters: a vehicle that was before the entrance is seen behind it for the first time, on the lane of
    the fan that it is nearest to on average, or on those that are hardly farther. waits: a vehicle stands near the
    entrance, and moves at another time or is in the lane's middle third. rule: beyond the edge m, cosine of agreeing
    headings, queue m, beyond the entrance m, alike m.
    """
    beyond_edge, cos_agrees, queue, beyond, alike = rule
    agents, steps = state.shape
    count = half_width.size
    comes = np.zeros(agents, dtype=np.bool_)
    enters = np.zeros((count, steps), dtype=np.bool_)
    waits = np.zeros((count, steps), dtype=np.bool_)
    box = np.empty((count, 4))
    for k in range(count):
        mine, reach = points[first[k] : first[k + 1]], half_width[k] + beyond_edge
        box[k, 0], box[k, 1] = mine[:, 0].min() - reach, mine[:, 1].min() - reach
        box[k, 2], box[k, 3] = mine[:, 0].max() + reach, mine[:, 1].max() + reach
    total = np.empty(count)
    for a in range(agents):
        entered, inside = -1, 0
        before = False
        total[:] = 0.0
        for k in range(count):
            if (
                bounds[a, 0] <= box[k, 2] and bounds[a, 2] >= box[k, 0]
                and bounds[a, 1] <= box[k, 3] and bounds[a, 3] >= box[k, 1]
            ):  # fmt: skip
                break
        else:
            continue
        distance = np.full((count, steps), np.inf)
        for t in range(steps):
            if state[a, t] == 0:
                continue
            x, y, co, si = pose[a, t]
            on_fan = False
            for k in range(count):
                if x < box[k, 0] or x > box[k, 2] or y < box[k, 1] or y > box[k, 3]:
                    continue
                low, high = first[k], first[k + 1]
                reach = half_width[k] + beyond_edge
                along, beside = _on_lane(points[low:high], s[low:high], reach, cos_agrees, x, y, co, si)
                if beside == np.inf:
                    continue
                distance[k, t] = beside
                length = s[high - 1]
                if k < count - fan:
                    near = length - along + ahead[k] <= queue
                    before = before or ahead[k] == 0.0
                else:
                    near = along < beyond
                    on_fan = True
                    comes[a] = comes[a] or along < length / 3
                if near and state[a, t] == 2 and (moves[a] or beside <= half_width[k] / 3):
                    waits[k, t] = True
            if on_fan and before:
                if entered < 0:
                    entered = t
                inside += 1
                for k in range(count - fan, count):
                    total[k] += min(distance[k, t], half_width[k] + beyond_edge)
        comes[a] = comes[a] or before
        if entered >= 0:
            least = total[count - fan :].min() / inside
            for k in range(count - fan, count):
                if total[k] / inside <= least + alike:
                    enters[k, entered] = True
    return comes, enters, waits


@kernel("(f8[:,::1], f8[::1], f8, f8[:,:,::1], f8[:,:,::1], b1[:,::1], b1[::1], f8[::1], f8[::1], f8[:,::1])")
def crossing_steps(
    borders: FloatArray, half_width: FloatArray, cos_crossing: float, pose: FloatArray, way: FloatArray,
    flows: BoolArray, others: BoolArray, half_l: FloatArray, half_w: FloatArray, bounds: FloatArray,
) -> BoolArray:  # fmt: skip
    """(T,) whether the box of one of `others` (A,) crosses the ground of a lane at each step.

    borders (C + 1, 2) m: where the lane's cells begin and end; half_width (C,) m. A vehicle crosses where its motion
    makes an angle, forwards or backwards, with a cosine of at most cos_crossing with every cell that its box covers.
    """
    cells = half_width.size
    agents, steps = flows.shape
    found = np.zeros(steps, dtype=np.bool_)
    box = np.empty((cells, 6))
    widest = 0.0
    for c in range(cells):
        dx, dy = borders[c + 1, 0] - borders[c, 0], borders[c + 1, 1] - borders[c, 1]
        length = max(np.sqrt(dx * dx + dy * dy), 1e-9)
        box[c, 0], box[c, 1] = (borders[c, 0] + borders[c + 1, 0]) / 2, (borders[c, 1] + borders[c + 1, 1]) / 2
        box[c, 2], box[c, 3], box[c, 4], box[c, 5] = dx / length, dy / length, length / 2, half_width[c]
        widest = max(widest, np.hypot(length / 2, half_width[c]))
    x0, x1 = borders[:, 0].min() - widest, borders[:, 0].max() + widest
    y0, y1 = borders[:, 1].min() - widest, borders[:, 1].max() + widest
    for a in range(agents):
        reach = np.hypot(half_l[a], half_w[a])
        if (
            not others[a]
            or bounds[a, 2] < x0 - reach or bounds[a, 0] > x1 + reach
            or bounds[a, 3] < y0 - reach or bounds[a, 1] > y1 + reach
        ):  # fmt: skip
            continue
        for t in range(steps):
            if found[t] or not flows[a, t]:
                continue
            x, y, co, si = pose[a, t]
            if x < x0 - reach or x > x1 + reach or y < y0 - reach or y > y1 + reach:
                continue
            covers, crosses = False, True
            for c in range(cells):
                dx, dy = x - box[c, 0], y - box[c, 1]
                if dx * dx + dy * dy > (reach + widest) ** 2:
                    continue
                if overlap(
                    x, y, co, si, half_l[a], half_w[a],
                    box[c, 0], box[c, 1], box[c, 2], box[c, 3], box[c, 4], box[c, 5],
                ):  # fmt: skip
                    covers = True
                    if abs(way[a, t, 0] * box[c, 2] + way[a, t, 1] * box[c, 3]) > cos_crossing:
                        crosses = False
                        break
            found[t] = covers and crosses
    return found


@kernel("(b1[::1], b1[::1], b1[::1], i8, i8, i8, i8, i8)")
def red_steps(
    crossed: BoolArray, entered: BoolArray, queued: BoolArray,
    before: int, after: int, entry_before: int, entry_after: int, clear: int,
) -> BoolArray:  # fmt: skip
    """(T,) red: `crossed` spread over steps before and after it, or `queued`; not near an entry.

    An entry takes away the red of a queue, and that of cross traffic that is more than `clear` steps away; that of
    cross traffic to come only up to itself, as the light has turned since. crossed, entered, queued (T,); the rest in
    steps.
    """
    steps = crossed.size
    flow, close, green = np.zeros(steps, np.bool_), np.zeros(steps, np.bool_), np.zeros(steps, np.bool_)
    to_come, entering = np.zeros(steps, np.bool_), np.zeros(steps, np.bool_)
    for t in range(steps):
        if crossed[t]:
            to_come[max(0, t - before) : t] = True
            flow[t : t + after + 1] = True
            close[max(0, t - clear) : t + clear + 1] = True
        if entered[t]:
            entering[max(0, t - entry_before) : t + 1] = True
            green[max(0, t - entry_before) : t + entry_after + 1] = True
    return close | ((flow | queued) & ~green) | (to_come & ~entering)
