"""The reference line r(s) of the Frenet frame: a route's centrelines, smoothed only as far as curvature needs."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hid2.agents import FloatArray
from hid2.kernels.raster import Raster, raster
from hid2.kernels.spline import TABLE_STEP_M as TABLE_STEP_M
from hid2.kernels.spline import along_spline, quintic_spline, smooth_polyline, spline_table
from hid2.once import once
from netconvert.geometry import arc_length, resample

_BEYOND_M = 40.0  # length of tables straight on behind a line's end; not a parameter: for vehicles that leave it


@dataclass(frozen=True, eq=False)
class ReferenceLine:
    """A curve with continuous curvature, by arc length: a spline of degree five.

    breaks (P + 1,) m; pieces (P, 6, 2): coefficients of each piece in powers of s - breaks[p]. The tables stand every
    TABLE_STEP_M from 0 to some way straight on beyond the end, where a leader may still be seen: table_xy (K, 2) m,
    table_heading (K,) rad, unwrapped, table_curvature (K,) 1/m, signed, table_sharpness (K,) 1/m2 (its derivative).
    """

    breaks: FloatArray
    pieces: FloatArray
    length_m: float
    table_xy: FloatArray
    table_heading: FloatArray
    table_curvature: FloatArray
    table_sharpness: FloatArray
    points: FloatArray
    points_m: FloatArray

    @once
    def near(self, reach_m: float) -> tuple[Raster, FloatArray]:
        """Raster of the table's points, and their x, y m, cosine and sine (4, K)."""
        columns = np.stack([*self.table_xy.T, np.cos(self.table_heading), np.sin(self.table_heading)])
        return raster(self.table_xy, step_m=TABLE_STEP_M, reach_m=reach_m), columns

    def is_beyond(self, other: "ReferenceLine", reach_m: float) -> bool:
        """Whether no point of two lines' tables can be within a distance."""
        (low, high), (other_low, other_high) = self._corners, other._corners
        return bool(
            low[0] > other_high[0] + reach_m
            or low[1] > other_high[1] + reach_m
            or other_low[0] > high[0] + reach_m
            or other_low[1] > high[1] + reach_m
        )

    @cached_property
    def _corners(self) -> tuple[list[float], list[float]]:
        return self.table_xy.min(axis=0).tolist(), self.table_xy.max(axis=0).tolist()

    def position(self, s: FloatArray) -> FloatArray:
        """(M, 2) m at arc lengths s (M,); straight on beyond both ends."""
        return self.motion(s)[0]

    def motion(self, s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position (M, 2) m, tangent (M, 2) and pace |dr/ds| (M,), 1 but for an error of the parameter, at s (M,) m."""
        return along_spline(self.breaks, self.pieces, np.ascontiguousarray(s, dtype=np.float64))


def build_reference_line(
    points: FloatArray, *, step_m: float, min_radius_m: float, max_offset_m: float
) -> ReferenceLine:
    """Smooth a polyline (N, 2) m until its curvature stays below 1 / min_radius_m or it strays max_offset_m from it.

    Paper, Trajectory Smoothing: kappa <= 1 / R_min. By penalised least squares on third differences: constant curvature
    passes unchanged. Point i of `points` still belongs to arc length i * step of the input.
    """
    raw = resample(points, step_m=step_m)
    if len(raw) < 6:  # a spline of degree five needs six points
        raw = resample(points, step_m=float(arc_length(points)[-1]) / 6.01)
    strength = 300.0  # the sixth power of 2.6 points, over which a kink of the map is spread
    line = _line_through(smooth_polyline(raw, strength))
    while np.abs(line.table_curvature).max() > 0.95 / min_radius_m and strength < 3e5:
        strength *= 4.0
        smoothed = smooth_polyline(raw, strength)
        if np.hypot(*(smoothed - raw).T).max() > max_offset_m:
            break
        line = _line_through(smoothed)
    return line


def _line_through(points: FloatArray) -> ReferenceLine:
    parameter, breaks, pieces = quintic_spline(points)
    length_m = float(parameter[-1])
    count = int(length_m / TABLE_STEP_M) + 2 + int(_BEYOND_M / TABLE_STEP_M)
    tables = spline_table(breaks, pieces, count)
    return ReferenceLine(breaks, pieces, length_m, *tables, points, points_m=parameter)
