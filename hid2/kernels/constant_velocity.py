"""Boxes that keep their velocity: when two of them touch, and whom one of many touches first."""

import math

from numba import njit

from hid2.agents import FloatArray


@njit(cache=True)
def contact_time(
    x: float, y: float, vx: float, vy: float, heading_a: float, length_a: float, width_a: float,
    heading_b: float, length_b: float, width_b: float,
) -> float:  # fmt: skip
    """Time until box b, at (x, y) from box a and moving at (vx, vy) relative to it, touches it; inf if never.

    Separating axes: on each of the four face normals the shadows overlap during an interval of time; the boxes
    touch when all four intervals hold at once. 0 where they overlap already.
    """
    enter, leave = 0.0, math.inf
    ca, sa = math.cos(heading_a), math.sin(heading_a)
    cb, sb = math.cos(heading_b), math.sin(heading_b)
    for k in range(4):
        nx, ny = (ca, sa) if k < 2 else (cb, sb)
        if k % 2:
            nx, ny = -ny, nx
        half = (
            abs(nx * ca + ny * sa) * length_a + abs(-nx * sa + ny * ca) * width_a
            + abs(nx * cb + ny * sb) * length_b + abs(-nx * sb + ny * cb) * width_b
        ) / 2  # fmt: skip
        distance = nx * x + ny * y
        speed = nx * vx + ny * vy
        if abs(speed) < 1e-12:
            if abs(distance) > half:
                return math.inf
            continue
        t0, t1 = (-half - distance) / speed, (half - distance) / speed
        enter = max(enter, min(t0, t1))
        leave = min(leave, max(t0, t1))
    return enter if enter <= leave else math.inf


@njit(cache=True)
def earliest_contact(
    own: int, position: FloatArray, heading: FloatArray, velocity: FloatArray, size: FloatArray, horizon_s: float
) -> tuple[float, int]:
    """Time until box `own` of many touches another one, and which; (inf, -1) where none within the horizon.

    position, velocity, size (A, 2): m, m/s, and length and width in m; heading (A,) rad.
    """
    earliest, other = math.inf, -1
    radius = math.hypot(size[own, 0], size[own, 1]) / 2
    for k in range(len(heading)):
        if k == own:
            continue
        dx, dy = position[k, 0] - position[own, 0], position[k, 1] - position[own, 1]
        vx, vy = velocity[k, 0] - velocity[own, 0], velocity[k, 1] - velocity[own, 1]
        reach = radius + math.hypot(size[k, 0], size[k, 1]) / 2
        if math.hypot(dx, dy) - reach > math.hypot(vx, vy) * horizon_s:
            continue
        seconds = contact_time(
            dx, dy, vx, vy, heading[own], size[own, 0], size[own, 1], heading[k], size[k, 0], size[k, 1]
        )
        if seconds <= horizon_s and seconds < earliest:
            earliest, other = seconds, k
    return earliest, other
