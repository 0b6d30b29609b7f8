"""Splines of degree five through points: smoothing, interpolation, and the tables of pose and curvature along them."""

import numpy as np

from hid2.kernels.compiled import kernel
from netconvert.geometry import FloatArray

#: Spacing of the tables of pose and curvature along a line, m.
TABLE_STEP_M = 0.5
_DEGREE = 5  # no tunable: the curvature of a quintic is smooth
_END_WEIGHT = 1e4  # of the end points over that of others, as these stay where they are; no tunable


@kernel("(f8[::1], f8[:,:,::1], f8[::1])")
def along_spline(breaks: FloatArray, pieces: FloatArray, s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position (M, 2), tangent (M, 2) and pace (M,) at arc lengths s (M,); straight on beyond both ends."""
    count, last = s.size, breaks.size - 2
    xy, tangent, pace = np.empty((count, 2)), np.empty((count, 2)), np.empty(count)
    p = 0
    for i in range(count):
        inside = min(max(s[i], 0.0), breaks[last + 1])
        if not breaks[p] <= inside <= breaks[p + 1]:
            p = min(np.searchsorted(breaks, inside, side="right") - 1, last)
        u = inside - breaks[p]
        for axis in range(2):
            value, slope = pieces[p, 5, axis], 0.0
            for power in range(4, -1, -1):
                slope = slope * u + value
                value = value * u + pieces[p, power, axis]
            xy[i, axis], tangent[i, axis] = value, slope
        norm = np.hypot(tangent[i, 0], tangent[i, 1])
        pace[i] = norm if inside == s[i] else 1.0
        for axis in range(2):
            tangent[i, axis] /= norm
            xy[i, axis] += (s[i] - inside) * tangent[i, axis]
    return xy, tangent, pace


@kernel("(f8[:,::1], f8)")
def smooth_polyline(points: FloatArray, strength: float) -> FloatArray:
    """Normal equations of bandwidth three, L D L^T without square roots."""
    count = points.shape[0]
    band = np.zeros((count, 4))  # band[i, g] = A[i, i + g]
    stencil = np.array([-1.0, 3.0, -3.0, 1.0])
    for i in range(count - 3):
        for j in range(4):
            for g in range(4 - j):
                band[i + j, g] += strength * stencil[j] * stencil[j + g]
    band[:, 0] += 1.0
    band[0, 0] += _END_WEIGHT - 1.0
    band[count - 1, 0] += _END_WEIGHT - 1.0
    out = np.empty((count, 2))
    for axis in range(2):
        for i in range(count):  # from the first point, so that large coordinates cost no digits
            out[i, axis] = points[i, axis] - points[0, axis]
        out[count - 1, axis] *= _END_WEIGHT
    for i in range(count):
        for g in range(1, min(4, count - i)):
            factor = band[i, g] / band[i, 0]
            for h in range(g, min(4, count - i)):
                band[i + g, h - g] -= factor * band[i, h]
            for axis in range(2):
                out[i + g, axis] -= factor * out[i, axis]
    for axis in range(2):
        for i in range(count - 1, -1, -1):
            value = out[i, axis]
            for g in range(1, min(4, count - i)):
                value -= band[i, g] * out[i + g, axis]
            out[i, axis] = value / band[i, 0]
        for i in range(count):
            out[i, axis] += points[0, axis]
    return out


@kernel("(f8[:,::1],)")
def quintic_spline(points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Interpolating spline of degree five (not-a-knot ends) by arc length: parameter, breaks and pieces."""
    n = points.shape[0]
    x = np.zeros(n)  # arc length from chords: short by kappa^2 h^3 / 24, curvature from second differences
    chord, bend = np.empty(n - 1), np.zeros(n)
    for i in range(n - 1):
        chord[i] = np.hypot(points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1])
    for i in range(1, n - 1):
        dx = points[i + 1, 0] - 2 * points[i, 0] + points[i - 1, 0]
        dy = points[i + 1, 1] - 2 * points[i, 1] + points[i - 1, 1]
        bend[i] = np.hypot(dx, dy) / (0.5 * (chord[i] + chord[i - 1])) ** 2
    bend[0], bend[n - 1] = bend[1], bend[n - 2]
    for i in range(n - 1):
        x[i + 1] = x[i] + chord[i] * (1.0 + (0.5 * (bend[i + 1] + bend[i]) * chord[i]) ** 2 / 24.0)

    t = np.empty(n + _DEGREE + 1)
    t[: _DEGREE + 1], t[n:] = x[0], x[n - 1]
    t[_DEGREE + 1 : n] = x[3 : n - 3]
    band = np.zeros((n, 2 * _DEGREE + 1))  # band[i, j - i + 5] = B_j(x_i)
    basis, saved = np.zeros(_DEGREE + 1), 0.0
    span = _DEGREE
    for i in range(n):
        while span < n - 1 and x[i] >= t[span + 1]:
            span += 1
        basis[0] = 1.0
        for degree in range(1, _DEGREE + 1):  # Cox and de Boor
            saved = 0.0
            for r in range(degree):
                right, left = t[span + r + 1], t[span + 1 - degree + r]
                part = basis[r] / (right - left)
                basis[r] = saved + (right - x[i]) * part
                saved = (x[i] - left) * part
            basis[degree] = saved
        for r in range(_DEGREE + 1):
            band[i, span - _DEGREE + r - i + _DEGREE] = basis[r]
    c = points.copy()
    for i in range(n):  # totally positive: no pivoting is needed
        for k in range(i + 1, min(n, i + _DEGREE + 1)):
            factor = band[k, i - k + _DEGREE] / band[i, _DEGREE]
            if factor != 0.0:
                for j in range(i + 1, min(n, i + _DEGREE + 1)):
                    band[k, j - k + _DEGREE] -= factor * band[i, j - i + _DEGREE]
                c[k, 0] -= factor * c[i, 0]
                c[k, 1] -= factor * c[i, 1]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, min(n, i + _DEGREE + 1)):
            c[i, 0] -= band[i, j - i + _DEGREE] * c[j, 0]
            c[i, 1] -= band[i, j - i + _DEGREE] * c[j, 1]
        c[i, 0] /= band[i, _DEGREE]
        c[i, 1] /= band[i, _DEGREE]

    count = n - _DEGREE
    breaks, pieces = t[_DEGREE : n + 1].copy(), np.empty((count, _DEGREE + 1, 2))
    slopes, level = np.empty(_DEGREE + 1), np.empty(_DEGREE + 1)
    for p in range(count):
        at = t[p + _DEGREE]
        for axis in range(2):
            for j in range(_DEGREE + 1):
                slopes[j] = c[p + j, axis]
            scale = 1.0
            for order in range(_DEGREE + 1):  # derivative of this order at the piece's start, over its factorial
                low = _DEGREE - order
                if order > 0:
                    scale *= order
                    for j in range(_DEGREE, order - 1, -1):
                        slopes[j] = (low + 1) * (slopes[j] - slopes[j - 1]) / (t[p + j + low + 1] - t[p + j])
                level[:] = slopes
                for degree in range(1, low + 1):  # de Boor, on the spline of degree five less the order
                    for j in range(_DEGREE, order + degree - 1, -1):
                        share = (at - t[p + j]) / (t[p + j + low - degree + 1] - t[p + j])
                        level[j] = (1.0 - share) * level[j - 1] + share * level[j]
                pieces[p, order, axis] = level[_DEGREE] / scale
    return x, breaks, pieces


@kernel("(f8[::1], f8[:,:,::1], i8)")
def spline_table(
    breaks: FloatArray, pieces: FloatArray, count: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Position, unwrapped heading, curvature and sharpness every TABLE_STEP_M; straight on behind the end."""
    xy, heading, curvature, sharpness = np.empty((count, 2)), np.empty(count), np.zeros(count), np.zeros(count)
    last = breaks.size - 2
    length = breaks[last + 1]
    d = np.empty((4, 2))
    p = 0
    for i in range(count):
        s = min(i * TABLE_STEP_M, length)
        while p < last and s >= breaks[p + 1]:
            p += 1
        u = s - breaks[p]
        d[:] = 0.0
        for axis in range(2):
            for power in range(_DEGREE, -1, -1):
                for order in range(3, 0, -1):
                    d[order, axis] = d[order, axis] * u + order * d[order - 1, axis]
                d[0, axis] = d[0, axis] * u + pieces[p, power, axis]
        norm = np.hypot(d[1, 0], d[1, 1])
        over = i * TABLE_STEP_M - s
        xy[i, 0], xy[i, 1] = d[0, 0] + over * d[1, 0] / norm, d[0, 1] + over * d[1, 1] / norm
        angle = np.arctan2(d[1, 1], d[1, 0])
        if i > 0:
            turned = (angle - heading[i - 1] + np.pi) % (2 * np.pi) - np.pi
            angle = heading[i - 1] + turned
        heading[i] = angle
        if over <= 0.0:
            curvature[i] = (d[1, 0] * d[2, 1] - d[1, 1] * d[2, 0]) / norm**3
            sharpness[i] = (d[1, 0] * d[3, 1] - d[1, 1] * d[3, 0]) / norm**4
    return xy, heading, curvature, sharpness
