"""Points on polylines, compiled for loops over many of them: the rule of `netconvert.geometry.Polyline.frenet`."""

import math

import numpy as np

from hid2.kernels.compiled import inner, kernel
from netconvert.geometry import FloatArray


@inner
def nearest_on(x: float, y: float, points: FloatArray, first: int, last: int) -> tuple[int, float, float]:
    """Segment of points[first:last], share of it, and square of the distance, m2, of the nearest point; -1 for none."""
    best, nearest, share = math.inf, -1, 0.0
    for k in range(first, last - 1):
        ax, ay = points[k, 0], points[k, 1]
        ex, ey = points[k + 1, 0] - ax, points[k + 1, 1] - ay
        square = ex * ex + ey * ey
        if square <= 0:
            continue
        r = min(1.0, max(0.0, ((x - ax) * ex + (y - ay) * ey) / square))
        px, py = x - ax - r * ex, y - ay - r * ey
        distance = px * px + py * py
        if distance < best:
            best, nearest, share = distance, k, r
    return nearest, share, best


@inner
def project_on_polyline(
    x: float, y: float, points: FloatArray, s: FloatArray, first: int, last: int
) -> tuple[float, float, float, float]:
    """(s, d, heading, distance) of the nearest point on points[first:last]; d positive to the left.

    As `Polyline.frenet`, except that s past an end is that of the end.
    """
    nearest, share, square = nearest_on(x, y, points, first, last)
    if nearest < 0:
        return 0.0, 0.0, 0.0, math.inf
    ax, ay = points[nearest, 0], points[nearest, 1]
    ex, ey = points[nearest + 1, 0] - ax, points[nearest + 1, 1] - ay
    length, distance = math.sqrt(ex * ex + ey * ey), math.sqrt(square)
    cross = ex * (y - ay) - ey * (x - ax)
    d = distance if cross >= 0.0 else -distance
    if (nearest == first and share <= 0.0) or (nearest == last - 2 and share >= 1.0):
        d = cross / length
    return s[nearest] + share * length, d, math.atan2(ey, ex), distance


@kernel("(f8[:,::1], f8[:,::1], f8[::1])")
def frenet(xy: FloatArray, points: FloatArray, s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """`Polyline.frenet` of places (M, 2) m on a polyline's points (N, 2) m with arc lengths (N,) m: s, d (M,) m."""
    along, aside = np.empty(xy.shape[0]), np.empty(xy.shape[0])
    for row in range(xy.shape[0]):
        x, y = xy[row, 0], xy[row, 1]
        nearest, share, square = nearest_on(x, y, points, 0, points.shape[0])
        ex, ey = points[nearest + 1, 0] - points[nearest, 0], points[nearest + 1, 1] - points[nearest, 1]
        fx, fy = x - points[nearest, 0], y - points[nearest, 1]
        length_square = ex * ex + ey * ey
        length, free = math.sqrt(length_square), (fx * ex + fy * ey) / length_square
        cross, apart = ex * fy - ey * fx, math.sqrt(square)
        if (nearest == 0 and free < 0.0) or (nearest == points.shape[0] - 2 and free > 1.0):
            along[row], aside[row] = s[nearest] + free * length, cross / length
        else:
            along[row], aside[row] = s[nearest] + share * length, apart if cross >= 0.0 else -apart
    return along, aside
