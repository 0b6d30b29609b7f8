"""Pedestrians on crossings, and crossings on paths: compiled loops over corners, agents and steps."""

import numpy as np

from hid2.kernels.compiled import inner, kernel
from netconvert.geometry import BoolArray, FloatArray, IntArray


@inner
def _to_quad(corners: FloatArray, x: float, y: float) -> tuple[float, float]:
    """Vector from a point to the nearest one of a quadrilateral (4, 2), m; zero inside."""
    inside = False
    best, best_x, best_y = np.inf, 0.0, 0.0
    for k in range(4):
        ax, ay = corners[k - 1]
        bx, by = corners[k]
        if (ay > y) != (by > y) and x < ax + (y - ay) / (by - ay) * (bx - ax):
            inside = not inside
        ex, ey = bx - ax, by - ay
        square = ex * ex + ey * ey
        share = min(1.0, max(0.0, ((x - ax) * ex + (y - ay) * ey) / square)) if square > 0 else 0.0
        dx, dy = ax + share * ex - x, ay + share * ey - y
        if dx * dx + dy * dy < best:
            best, best_x, best_y = dx * dx + dy * dy, dx, dy
    return (0.0, 0.0) if inside else (best_x, best_y)


@kernel("(f8[:,:,::1], f8[:,:,::1], f8[:,:,::1], b1[:,::1], f8, f8, i8)")
def at_crossings(
    corners: FloatArray, position: FloatArray, velocity: FloatArray, present: BoolArray,
    near: float, towards: float, ahead: int,
) -> BoolArray:  # fmt: skip
    """(Q, A, T) which agents are on a crossing or will be within `ahead` steps, or near (m) and moving to it (m/s).

    corners (Q, 4, 2) m.
    """
    agents, steps = present.shape
    found = np.zeros((corners.shape[0], agents, steps), dtype=np.bool_)
    for q in range(corners.shape[0]):
        x0, x1 = corners[q, :, 0].min() - near, corners[q, :, 0].max() + near
        y0, y1 = corners[q, :, 1].min() - near, corners[q, :, 1].max() + near
        for a in range(agents):
            for t in range(steps):
                x, y = position[a, t]
                if not present[a, t] or x < x0 or x > x1 or y < y0 or y > y1:
                    continue
                dx, dy = _to_quad(corners[q], x, y)
                distance = np.sqrt(dx * dx + dy * dy)
                if distance <= 0.0:
                    for before in range(max(0, t - ahead), t + 1):
                        found[q, a, before] = found[q, a, before] or present[a, before]
                elif distance <= near:
                    closing = (velocity[a, t, 0] * dx + velocity[a, t, 1] * dy) / distance
                    found[q, a, t] = found[q, a, t] or closing > towards
    return found


@inner
def _meets(corners: FloatArray, ax: float, ay: float, bx: float, by: float) -> bool:
    """Whether the segment from a to b touches a quadrilateral."""
    for x, y in ((ax, ay), (bx, by)):
        dx, dy = _to_quad(corners, x, y)
        if dx == 0.0 and dy == 0.0:
            return True
    ex, ey = bx - ax, by - ay
    for k in range(4):
        px, py = corners[k - 1]
        qx, qy = corners[k]
        p = ex * (py - ay) - ey * (px - ax)
        q = ex * (qy - ay) - ey * (qx - ax)
        a = (qx - px) * (ay - py) - (qy - py) * (ax - px)
        b = (qx - px) * (by - py) - (qy - py) * (bx - px)
        if p * q <= 0.0 and a * b <= 0.0 and (p != 0.0 or q != 0.0):
            return True
    return False


@kernel("(f8[:,:,::1], f8[:,::1], f8[::1], f8)")
def crossings_swept(corners: FloatArray, xy: FloatArray, heading: FloatArray, half_width: float) -> IntArray:
    """(N, 3) crossing, first and last point of a line, at which its swept width touches the crossing.

    xy (K, 2) m, heading (K,) rad: points of the line.
    """
    found = np.empty((4 * corners.shape[0], 3), dtype=np.int64)
    count = 0
    for q in range(corners.shape[0]):
        x0, x1 = corners[q, :, 0].min() - half_width, corners[q, :, 0].max() + half_width
        y0, y1 = corners[q, :, 1].min() - half_width, corners[q, :, 1].max() + half_width
        first = -1
        for k in range(xy.shape[0] + 1):
            meets = False
            if k < xy.shape[0]:
                x, y = xy[k]
                if x0 <= x <= x1 and y0 <= y <= y1:
                    nx, ny = -half_width * np.sin(heading[k]), half_width * np.cos(heading[k])
                    meets = _meets(corners[q], x - nx, y - ny, x + nx, y + ny)
            if meets and first < 0:
                first = k
            elif not meets and first >= 0:
                if count < found.shape[0]:
                    found[count] = q, first, k - 1
                    count += 1
                first = -1
    return found[:count]
