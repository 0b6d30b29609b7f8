"""The reference line r(s) of the Frenet frame: a route's centrelines, smoothed only as far as curvature needs."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.linalg import solveh_banded

from hid2.agents import FloatArray
from netconvert.geometry import arc_length, resample

#: Spacing of the tables of pose and curvature along a line, m.
TABLE_STEP_M = 0.5
_BEYOND_M = 40.0


@dataclass(frozen=True, eq=False, slots=True)
class ReferenceLine:
    """A curve with continuous curvature, by arc length.

    spline: s (m) -> (2,) m. The tables stand every TABLE_STEP_M from 0 to some
    way straight on beyond the end, where a leader may still be seen: table_xy (K, 2) m, table_heading (K,) rad,
    unwrapped, table_curvature (K,) 1/m, signed, table_sharpness (K,) 1/m2 (its derivative).
    """

    spline: BSpline
    length_m: float
    table_xy: FloatArray
    table_heading: FloatArray
    table_curvature: FloatArray
    table_sharpness: FloatArray
    points: FloatArray
    points_s: FloatArray

    def position(self, s: FloatArray) -> FloatArray:
        """(M, 2) m at arc lengths s (M,); straight on beyond both ends."""
        inside = np.clip(s, 0.0, self.length_m)
        over = np.asarray(s) - inside
        xy = self.spline(inside)
        if np.any(over):
            xy = xy + over[:, None] * self.tangent(s)
        return np.asarray(xy, dtype=np.float64)

    def tangent(self, s: FloatArray) -> FloatArray:
        """(M, 2) unit vectors in driving direction."""
        derivative = self.spline(np.clip(s, 0.0, self.length_m), nu=1)
        return np.asarray(derivative / np.linalg.norm(derivative, axis=1, keepdims=True), dtype=np.float64)

    def heading(self, s: FloatArray) -> FloatArray:
        """(M,) rad in (-pi, pi]."""
        tangent = self.tangent(s)
        return np.asarray(np.arctan2(tangent[:, 1], tangent[:, 0]), dtype=np.float64)

    def pace(self, s: FloatArray) -> FloatArray:
        """(M,) |dr/ds|: 1 up to the error of the arc-length parameter; 1 beyond the ends."""
        inside = np.clip(s, 0.0, self.length_m)
        norm = np.linalg.norm(self.spline(inside, nu=1), axis=1)
        return np.where(inside == s, norm, 1.0)


def smooth_points(points: FloatArray, *, strength: float, pin_ends: bool = True) -> FloatArray:
    """Penalised least squares on third differences: parabolas, so constant curvature, pass unchanged.

    points (N, 2) m evenly spaced; strength: the sixth power of the length, in points, over which kinks are spread.
    """
    count = len(points)
    if count < 5 or strength <= 0:
        return points
    weight = np.ones(count)
    if pin_ends:
        weight[[0, -1]] = 1e4
    banded = np.zeros((4, count))  # upper form: row 3 is the diagonal
    stencil = np.array([-1.0, 3.0, -3.0, 1.0])
    for lag in range(4):
        products = stencil[: 4 - lag] * stencil[lag:]
        for offset, product in enumerate(products):
            banded[3 - lag, offset + lag : offset + lag + count - 3] += strength * product
    banded[3] += weight
    return np.asarray(solveh_banded(banded, weight[:, None] * points, overwrite_ab=True), dtype=np.float64)


def build_reference_line(
    points: FloatArray, *, step_m: float, min_radius_m: float, max_offset_m: float, strength: float = 300.0
) -> ReferenceLine:
    """Smooth a polyline (N, 2) m until its curvature stays below 1 / min_radius_m or it strays max_offset_m from it.

    Paper, Trajectory Smoothing: kappa <= 1 / R_min. The result's points keep the order and number of the resampled
    input's, so that index i of `points` still belongs to arc length i * step of the input.
    """
    raw = resample(points, step_m=step_m)
    if len(raw) < 6:  # a spline of degree five needs six points
        raw = resample(points, step_m=float(arc_length(points)[-1]) / 6.01)
    line = _line_through(smooth_points(raw, strength=strength))
    while np.abs(line.table_curvature).max() > 0.95 / min_radius_m and strength < 3e5:
        strength *= 4.0
        smoothed = smooth_points(raw, strength=strength)
        if np.hypot(*(smoothed - raw).T).max() > max_offset_m:
            break
        line = _line_through(smoothed)
    return line


def _line_through(points: FloatArray) -> ReferenceLine:
    # arc length from chords: a chord is short by kappa^2 h^3 / 24, curvature from second differences
    chord = np.diff(arc_length(points))
    bend = np.zeros(len(points))
    bend[1:-1] = np.hypot(*np.diff(points, n=2, axis=0).T) / (0.5 * (chord[1:] + chord[:-1])) ** 2
    bend[0], bend[-1] = bend[1], bend[-2]
    pace = 1.0 + (0.5 * (bend[1:] + bend[:-1]) * chord) ** 2 / 24.0
    parameter = np.concatenate([[0.0], np.cumsum(chord * pace)])
    spline = make_interp_spline(parameter, points, k=5)
    length = float(parameter[-1])
    table_s = np.arange(int(length / TABLE_STEP_M) + 2 + int(_BEYOND_M / TABLE_STEP_M)) * TABLE_STEP_M
    over = np.maximum(table_s - length, 0.0)
    first, second, third = (spline(table_s - over, nu=order) for order in (1, 2, 3))
    second[over > 0], third[over > 0] = 0.0, 0.0
    norm = np.linalg.norm(first, axis=1)
    curvature = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / norm**3
    sharpness = (first[:, 0] * third[:, 1] - first[:, 1] * third[:, 0]) / norm**4
    return ReferenceLine(
        spline=spline,
        length_m=length,
        table_xy=np.ascontiguousarray(spline(table_s - over) + over[:, None] * first / norm[:, None]),
        table_heading=np.unwrap(np.arctan2(first[:, 1], first[:, 0])),
        table_curvature=curvature,
        table_sharpness=sharpness,
        points=points,
        points_s=parameter,
    )
