"""Oriented boxes against each other over a whole scene: time to collision, post-encroachment time.

Every kernel walks over pairs of agents and steps, throws far pairs out by their circumscribed circles and does the
exact test on the rest. Boxes are (x, y, heading, length, width).
"""

import math

import numpy as np

from hid2.kernels.boxes import contact_time, overlap
from hid2.kernels.compiled import inner, kernel
from netconvert.geometry import FloatArray, IntArray

#: Least displacement between two steps that has a course, m. No tunable: a smaller one is noise.
_COURSE_M = 0.1


@inner
def _extents(position: FloatArray, velocity: FloatArray, row_of: IntArray) -> tuple[FloatArray, FloatArray]:
    """Least x, y and largest x, y (A, 4) of each agent's centre, and its largest speed (A,)."""
    agents, steps = row_of.shape
    extent, fastest = np.empty((agents, 4)), np.zeros(agents)
    extent[:, :2], extent[:, 2:] = math.inf, -math.inf
    for a in range(agents):
        for t in range(steps):
            i = row_of[a, t]
            if i < 0:
                continue
            for axis in range(2):
                extent[a, axis] = min(extent[a, axis], position[i, axis])
                extent[a, axis + 2] = max(extent[a, axis + 2], position[i, axis])
            fastest[a] = max(fastest[a], math.hypot(velocity[i, 0], velocity[i, 1]))
    return extent, fastest


@inner
def _never_nearer(a: FloatArray, b: FloatArray) -> float:
    """Distance between two rectangles, each least x, y and largest x, y."""
    return math.hypot(max(a[0] - b[2], b[0] - a[2], 0.0), max(a[1] - b[3], b[1] - a[3], 0.0))


@kernel("(f8[:,::1], f8[::1], f8[:,::1], f8[::1], f8[::1], i8[:,::1], f8,)")
def time_to_collision(
    position: FloatArray,
    heading: FloatArray,
    velocity: FloatArray,
    length: FloatArray,
    width: FloatArray,
    row_of: IntArray,
    cap_s: float,
) -> tuple[FloatArray, FloatArray]:
    """Smallest TTC, at most `cap_s`, of every row to any other agent there (N,) and of each pair a, b > a (A, A)."""
    agents, rows = len(row_of), len(position)
    extent, fastest = _extents(position, velocity, row_of)
    ttc, least = np.full(rows, cap_s), np.full((agents, agents), cap_s)
    for a in range(agents):
        radius_a = math.hypot(length[a], width[a]) / 2
        for b in range(a + 1, agents):
            reach = radius_a + math.hypot(length[b], width[b]) / 2
            if _never_nearer(extent[a], extent[b]) > reach + (fastest[a] + fastest[b]) * cap_s + 1e-6:
                continue
            for t in range(row_of.shape[1]):
                i, j = row_of[a, t], row_of[b, t]
                if i < 0 or j < 0:
                    continue
                dx, dy = position[j, 0] - position[i, 0], position[j, 1] - position[i, 1]
                vx, vy = velocity[j, 0] - velocity[i, 0], velocity[j, 1] - velocity[i, 1]
                square = dx * dx + dy * dy
                closing = dx * vx + dy * vy
                if square > reach * reach:
                    if closing >= 0:
                        continue
                    speed = math.hypot(vx, vy)
                    if math.sqrt(square) - reach > speed * cap_s:
                        continue
                    # the line of relative motion must pass the circumscribed circles
                    if abs(dx * vy - dy * vx) > reach * speed:
                        continue
                seconds = contact_time(
                    dx, dy, vx, vy,
                    math.cos(heading[i]), math.sin(heading[i]), length[a] / 2, width[a] / 2,
                    math.cos(heading[j]), math.sin(heading[j]), length[b] / 2, width[b] / 2,
                )  # fmt: skip
                ttc[i], ttc[j] = min(ttc[i], seconds), min(ttc[j], seconds)
                least[a, b] = min(least[a, b], seconds)
    return ttc, least


@kernel("(f8[:,::1], f8[::1], f8[:,::1], f8[::1], f8)")
def paths_cross(
    xy_a: FloatArray, heading_a: FloatArray, xy_b: FloatArray, heading_b: FloatArray, min_sine: float
) -> tuple[int, int]:
    """Rows before which the paths of two centres first cut each other, -1 twice where they do not.

    Headings or courses differ there by the given angle at least.
    """
    longest = 1e-9  # step of b; nothing is cut before b can have come near, and so many steps are passed over
    for j in range(len(xy_b) - 1):
        longest = max(longest, math.hypot(xy_b[j + 1, 0] - xy_b[j, 0], xy_b[j + 1, 1] - xy_b[j, 1]))
    for i in range(len(xy_a) - 1):
        ax, ay = xy_a[i, 0], xy_a[i, 1]
        ux, uy = xy_a[i + 1, 0] - ax, xy_a[i + 1, 1] - ay
        near = math.hypot(ux, uy) + longest + 1e-6
        j = -1
        while j + 1 < len(xy_b) - 1:
            j += 1
            dx, dy = xy_b[j, 0] - ax, xy_b[j, 1] - ay
            square = dx * dx + dy * dy
            if square > near * near:
                j += int((math.sqrt(square) - near) / longest)
                continue
            vx, vy = xy_b[j + 1, 0] - xy_b[j, 0], xy_b[j + 1, 1] - xy_b[j, 1]
            across = ux * vy - uy * vx
            if across == 0.0:
                continue
            r = (dx * vy - dy * vx) / across
            q = (dx * uy - dy * ux) / across
            if not (0.0 <= r <= 1.0 and 0.0 <= q <= 1.0):
                continue
            driven_a, driven_b = math.hypot(ux, uy), math.hypot(vx, vy)
            by_course = min(driven_a, driven_b) > _COURSE_M and abs(across) >= min_sine * driven_a * driven_b
            if by_course or abs(math.sin(heading_a[i] - heading_b[j])) >= min_sine:
                return i, j
    return -1, -1


@inner
def _between_bumpers(xy: FloatArray, heading: FloatArray, length: float) -> tuple[FloatArray, FloatArray]:
    """The path of a centre from the rear bumper at its first row to the front bumper at its last one, two rows more."""
    last, half = len(xy) - 1, length / 2
    longer, turned = np.empty((last + 3, 2)), np.empty(last + 3)
    longer[1:-1], turned[1:-1] = xy, heading
    longer[0, 0], longer[0, 1] = xy[0, 0] - half * math.cos(heading[0]), xy[0, 1] - half * math.sin(heading[0])
    longer[-1, 0] = xy[last, 0] + half * math.cos(heading[last])
    longer[-1, 1] = xy[last, 1] + half * math.sin(heading[last])
    turned[0], turned[-1] = heading[0], heading[last]
    return longer, turned


@kernel("(f8[:,::1], f8[::1], f8, f8[:,::1], f8[::1], f8, f8)")
def swept_paths_cross(
    xy_a: FloatArray, heading_a: FloatArray, length_a: float,
    xy_b: FloatArray, heading_b: FloatArray, length_b: float, min_sine: float,
) -> tuple[int, int]:  # fmt: skip
    """Rows before which swept paths first cut each other, as `paths_cross`: from rear to front bumper at the ends.

    A vehicle with its centre not across at its last step may be with its front.
    """
    a, turned_a = _between_bumpers(xy_a, heading_a, length_a)
    b, turned_b = _between_bumpers(xy_b, heading_b, length_b)
    i, j = paths_cross(a, turned_a, b, turned_b, min_sine)
    if i < 0:
        return -1, -1
    return max(0, min(i - 1, len(xy_a) - 1)), max(0, min(j - 1, len(xy_b) - 1))


@inner
def _swept_lengths(xy: FloatArray, length: float) -> FloatArray:
    """Length of the box at each step, longer by what its vehicle drives in a step."""
    last = len(xy) - 1
    out = np.empty(last + 1)
    for i in range(last + 1):
        before, after = max(0, i - 1), min(last, i + 1)
        driven = math.hypot(xy[after, 0] - xy[before, 0], xy[after, 1] - xy[before, 1])
        out[i] = length + driven / max(1, after - before)
    return out


@inner
def _bounds(xy: FloatArray, length: float) -> FloatArray:
    """Least x and y and largest x and y (4,) that the boxes of a track come to, along their length."""
    half = length / 2
    return np.array([xy[:, 0].min() - half, xy[:, 1].min() - half, xy[:, 0].max() + half, xy[:, 1].max() + half])


@inner
def _encroachment(
    step_a: IntArray, xy_a: FloatArray, heading_a: FloatArray, length_a: float, width_a: float,
    step_b: IntArray, xy_b: FloatArray, heading_b: FloatArray, length_b: float, width_b: float,
    cap_steps: int, min_sine: float,
) -> tuple[int, int, int]:  # fmt: skip
    """PET of two tracks in steps, -1 where it is above cap_steps or their paths do not cross; rows where they do."""
    if step_a[0] - step_b[-1] > cap_steps or step_b[0] - step_a[-1] > cap_steps:
        return -1, -1, -1
    at, then = swept_paths_cross(xy_a, heading_a, length_a, xy_b, heading_b, length_b, min_sine)
    if at < 0:
        return -1, -1, -1
    long_a, long_b = _swept_lengths(xy_a, length_a), _swept_lengths(xy_b, length_b)
    reach = (math.hypot(length_a, width_a) + math.hypot(length_b, width_b)) / 2
    best, least_cosine = cap_steps + 1, math.sqrt(1.0 - min_sine * min_sine)
    for i in range(len(step_a)):
        for j in range(len(step_b)):
            apart = abs(step_a[i] - step_b[j])
            if apart >= best:
                continue
            dx, dy = xy_b[j, 0] - xy_a[i, 0], xy_b[j, 1] - xy_a[i, 1]
            if math.hypot(dx, dy) > reach + (long_a[i] - length_a + long_b[j] - length_b) / 2:
                continue
            if math.cos(heading_a[i] - heading_b[j]) > least_cosine:
                continue
            if overlap(
                0.0, 0.0, math.cos(heading_a[i]), math.sin(heading_a[i]), long_a[i] / 2, width_a / 2,
                dx, dy, math.cos(heading_b[j]), math.sin(heading_b[j]), long_b[j] / 2, width_b / 2,
            ):  # fmt: skip
                best = apart
    return (best if best <= cap_steps else -1), at, then


@kernel("(i8[::1], f8[:,::1], f8[::1], f8[::1], f8[::1], i8[::1], i8[::1], i8, f8, i8,)")
def post_encroachment(
    agents: IntArray,
    position: FloatArray,
    heading: FloatArray,
    length: FloatArray,
    width: FloatArray,
    first: IntArray,
    step: IntArray,
    cap_steps: int,
    min_angle: float,
    first_row: int = 0,
) -> tuple[IntArray, IntArray]:
    """PET in steps for every pair of `agents` (K, K), upper triangle, -1 where their paths do not cross in time.

    Beside it rows of the two tracks before which their paths cut each other (K, K, 2). Only pairs with their second one
    among agents[first_row:].

    Paths cross where the centres' paths, with the bumpers at their ends, cut each other at `min_angle` at least
    (and at most pi - min_angle: meeting head-on is no crossing). PET is then the smallest |t1 - t2| at which the
    box of one at t1 covers ground of the box of the other at t2 while their headings differ by `min_angle` at
    least, so also before one of them has turned. Each box is longer by what its vehicle drives in a step, so that
    the boxes of all steps cover the swept path: right to a step.
    """
    count = len(agents)
    bounds = np.empty((count, 4))
    for k, a in enumerate(agents):
        bounds[k] = _bounds(position[first[a] : first[a + 1]], length[a])
    out, crossed = np.full((count, count), -1, dtype=np.int64), np.full((count, count, 2), -1, dtype=np.int64)
    for p, a in enumerate(agents):
        of_a = slice(first[a], first[a + 1])
        for q in range(max(p + 1, first_row), count):
            if _never_nearer(bounds[p], bounds[q]) > 0.0:
                continue
            b = agents[q]
            of_b = slice(first[b], first[b + 1])
            out[p, q], crossed[p, q, 0], crossed[p, q, 1] = _encroachment(
                step[of_a], position[of_a], heading[of_a], length[a], width[a],
                step[of_b], position[of_b], heading[of_b], length[b], width[b],
                cap_steps, math.sin(min_angle),
            )  # fmt: skip
    return out, crossed
