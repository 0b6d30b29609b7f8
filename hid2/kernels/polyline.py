"""Points on polylines, compiled for loops over many of them: the rule of `netconvert.geometry.Polyline.frenet`."""

import math

import numpy as np

from hid2.kernels.compiled import inner, kernel
from netconvert.geometry import FloatArray


@inner
def project_on_polyline(
    x: float, y: float, points: FloatArray, s: FloatArray, first: int, last: int
) -> tuple[float, float, float, float]:
    """(s, d, heading, distance) of the nearest point on points[first:last], s and d as of `Polyline.frenet`."""
    best, nearest, share = math.inf, -1, 0.0
    for k in range(first, last - 1):
        ax, ay = points[k, 0], points[k, 1]
        ex, ey = points[k + 1, 0] - ax, points[k + 1, 1] - ay
        square = ex * ex + ey * ey
        if square <= 0:
            continue
        r = min(1.0, max(0.0, ((x - ax) * ex + (y - ay) * ey) / square))
        px, py = x - ax - r * ex, y - ay - r * ey
        if px * px + py * py < best:
            best, nearest, share = px * px + py * py, k, r
    if nearest < 0:
        return 0.0, 0.0, 0.0, math.inf
    ex, ey = points[nearest + 1, 0] - points[nearest, 0], points[nearest + 1, 1] - points[nearest, 1]
    fx, fy = x - points[nearest, 0], y - points[nearest, 1]
    square = ex * ex + ey * ey
    length, free = math.sqrt(square), (fx * ex + fy * ey) / square
    cross, distance = ex * fy - ey * fx, math.sqrt(best)
    angle = math.atan2(ey, ex)
    if (nearest == first and free < 0.0) or (nearest == last - 2 and free > 1.0):
        return s[nearest] + free * length, cross / length, angle, distance
    return s[nearest] + share * length, distance if cross >= 0.0 else -distance, angle, distance


@kernel("(f8[:,::1], f8[:,::1], f8[::1])")
def frenet(xy: FloatArray, points: FloatArray, s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """`Polyline.frenet` of places (M, 2) m on a polyline's points (N, 2) m with arc lengths (N,) m: s, d (M,) m."""
    along, aside = np.empty(xy.shape[0]), np.empty(xy.shape[0])
    for row in range(xy.shape[0]):
        along[row], aside[row], _, _ = project_on_polyline(xy[row, 0], xy[row, 1], points, s, 0, points.shape[0])
    return along, aside
