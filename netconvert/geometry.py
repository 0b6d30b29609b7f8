"""Polylines (arc length, resampling, Frenet coordinates) and oriented boxes, all in the plane."""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

#: Corners of a unit box in its own frame (+x along the heading): front left, front right, rear right, rear left.
_UNIT_CORNERS = np.array([[0.5, 0.5], [0.5, -0.5], [-0.5, -0.5], [-0.5, 0.5]])


def arc_length(points: FloatArray) -> FloatArray:
    """Distance along a polyline from its first point to each of its points.

    points: (N, 2) m. Returns (N,) m, starting at 0.
    """
    steps = points[1:] - points[:-1]
    return np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))])


def cut_at(
    points: FloatArray, s: FloatArray, at: FloatArray, borders: FloatArray, *, farther_m: float = 0.0
) -> list[FloatArray]:
    """Pieces of a polyline, points (N, 2) m with arc lengths s (N,), each (M, 2) m with both its ends.

    at: (K + 1,) m, arc lengths of the ends, borders: (K + 1, 2) m, their places. Points as near to an end as farther_m
    are left out.
    """
    start = np.searchsorted(s, at[:-1] + farther_m, side="right").tolist()
    stop = np.searchsorted(s, at[1:] - farther_m, side="left").tolist()
    parts = enumerate(zip(start, stop, strict=True))
    return [np.concatenate([borders[k : k + 1], points[a:b], borders[k + 1 : k + 2]]) for k, (a, b) in parts]


def resample(points: FloatArray, *, step_m: float) -> FloatArray:
    """Points at equal distances of at most step_m along a polyline, both ends kept.

    points: (N, 2) m, of a length above 0. Returns (M, 2) m, M >= 2.
    """
    line = Polyline(points)
    return line.point(np.linspace(0.0, line.length_m, max(1, int(np.ceil(line.length_m / step_m - 1e-9))) + 1))


def differences(values: FloatArray, step: float) -> FloatArray:
    """Derivative along the first axis by central differences, one-sided at the ends; zeros for a single value.

    values: (T, ...) at equal steps.
    """
    found = np.zeros(values.shape)
    if len(values) > 1:  # as np.gradient, in a fifth of its time
        found[1:-1] = (values[2:] - values[:-2]) / (2.0 * step)
        found[0], found[-1] = (values[1] - values[0]) / step, (values[-1] - values[-2]) / step
    return found


def wrap_angle(angle: npt.ArrayLike) -> FloatArray:
    """The same angle in (-pi, pi], rad; any shape."""
    return np.asarray(np.pi - np.mod(np.pi - np.asarray(angle, dtype=np.float64), 2.0 * np.pi), dtype=np.float64)


def box_corners(
    center: npt.ArrayLike, heading: npt.ArrayLike, *, length_m: npt.ArrayLike, width_m: npt.ArrayLike
) -> FloatArray:
    """Corners of oriented boxes: front left, front right, rear right, rear left.

    center: (..., 2) m; heading: (...) rad; length_m, width_m: anything that broadcasts to (...). Returns (..., 4, 2) m.
    """
    center = np.asarray(center, dtype=np.float64)
    heading = np.asarray(heading, dtype=np.float64)[..., None]
    along = np.asarray(length_m, dtype=np.float64)[..., None] * _UNIT_CORNERS[:, 0]
    across = np.asarray(width_m, dtype=np.float64)[..., None] * _UNIT_CORNERS[:, 1]
    cos, sin = np.cos(heading), np.sin(heading)
    x = center[..., 0, None] + cos * along - sin * across
    y = center[..., 1, None] + sin * along + cos * across
    return np.stack(np.broadcast_arrays(x, y), axis=-1)


@dataclass(frozen=True, eq=False, slots=True)
class Polyline:
    """A directed polyline and the Frenet frame along it (s from its start, d positive to the left).

    Past its two ends it goes on straight: s may be negative or above length_m, in both directions of the conversion.
    """

    points: FloatArray
    """(N, 2) m, N >= 2; points that repeat the one before are dropped."""
    s: FloatArray = field(init=False, repr=False)
    """(N,) m, arc length at each point."""
    length_m: float = field(init=False, repr=False)
    """Length from the first to the last point, m."""
    _heading: FloatArray = field(init=False, repr=False)
    """(N - 1,) rad, direction of each segment."""

    def __post_init__(self) -> None:
        points = np.ascontiguousarray(self.points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2:
            raise ValueError(f"polyline of shape {points.shape}, expected (N, 2) with N >= 2")
        s = arc_length(points)
        if not 0.0 < s[-1] < np.inf:
            raise ValueError(f"polyline of length {s[-1]} m, expected a finite length above 0")
        moved = s[1:] > s[:-1]
        if not moved.all():
            keep = np.append(True, moved)
            points, s = np.ascontiguousarray(points[keep]), s[keep]
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "s", s)
        object.__setattr__(self, "length_m", float(s[-1]))
        object.__setattr__(self, "_heading", np.arctan2(*(points[1:] - points[:-1]).T[::-1]))

    def point(self, s: npt.ArrayLike) -> FloatArray:
        """Points at arc lengths s. s: (M,) m. Returns (M, 2) m."""
        s = np.asarray(s, dtype=np.float64)
        if s.size and (s.min() < 0.0 or s.max() > self.s[-1]):
            return self.xy(s, 0.0)
        return np.stack([np.interp(s, self.s, column) for column in self.points.T], axis=-1)

    def heading(self, s: npt.ArrayLike) -> FloatArray:
        """Direction at arc lengths s, that of the segment ahead where two segments meet. (M,) m. Returns (M,) rad."""
        return self._heading[self._segment(np.asarray(s, dtype=np.float64))]

    def xy(self, s: npt.ArrayLike, d: npt.ArrayLike) -> FloatArray:
        """City coordinates of Frenet coordinates, the inverse of frenet. s, d: (M,) m. Returns (M, 2) m."""
        s, d = np.broadcast_arrays(np.asarray(s, dtype=np.float64), np.asarray(d, dtype=np.float64))
        segment = self._segment(s)
        cos, sin = np.cos(self._heading[segment]), np.sin(self._heading[segment])
        along, start = s - self.s[segment], self.points[segment]
        return np.stack([start[..., 0] + along * cos - d * sin, start[..., 1] + along * sin + d * cos], axis=-1)

    def frenet(self, xy: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Frenet coordinates of points, on the nearest segment. xy: (M, 2) m. Returns s (M,) m, d (M,) m.

        Past an end of the line, s and d are those of the line's straight extension: s < 0 or s > length_m.
        """
        xy = np.ascontiguousarray(np.asarray(xy, dtype=np.float64).reshape(-1, 2))
        start, step = self.points[:-1], self.points[1:] - self.points[:-1]
        square = step[:, 0] * step[:, 0] + step[:, 1] * step[:, 1]
        from_start = xy[:, None] - start  # (M, N - 1, 2)
        along = (from_start[..., 0] * step[:, 0] + from_start[..., 1] * step[:, 1]) / square
        clipped = np.clip(along, 0.0, 1.0)
        off = from_start - clipped[..., None] * step
        distance = off[..., 0] * off[..., 0] + off[..., 1] * off[..., 1]
        rows, nearest = np.arange(len(xy)), np.argmin(distance, axis=1)
        along, clipped, from_start = along[rows, nearest], clipped[rows, nearest], from_start[rows, nearest]
        length, direction = np.sqrt(square[nearest]), step[nearest]
        cross = direction[:, 0] * from_start[:, 1] - direction[:, 1] * from_start[:, 0]
        beyond = ((nearest == 0) & (along < 0.0)) | ((nearest == len(step) - 1) & (along > 1.0))
        aside = np.sqrt(distance[rows, nearest])
        s = self.s[nearest] + np.where(beyond, along, clipped) * length
        return s, np.where(beyond, cross / length, np.where(cross >= 0.0, aside, -aside))

    def _segment(self, s: FloatArray) -> npt.NDArray[np.int64]:
        """Index of the segment that holds each s, of the one ahead where two meet."""
        return np.clip(np.searchsorted(self.s, s, side="right") - 1, 0, len(self.points) - 2)


def slopes(values: FloatArray, window: int, step: float) -> FloatArray:
    """Slopes (N, ...) of values a step apart: of parabolas fitted over an odd window, 3 or more.

    As scipy.signal.savgol_filter(values, window, 2, deriv=1, delta=step, axis=0), but its import takes longer than a
    scene. Within half a window of the ends they are those of the first or last parabola.
    """
    half = window // 2
    at = step * np.arange(-half, half + 1)
    with np.errstate(invalid="ignore"):  # of damaged values: these are refused where they are read
        inner = np.lib.stride_tricks.sliding_window_view(values, window, axis=0) @ (at / (at @ at))
    (a, b, _), (c, d, _) = (np.polyfit(at, part, 2) for part in (values[:window], values[-window:]))
    return np.concatenate(
        [2.0 * np.multiply.outer(at[:half], a) + b, inner, 2.0 * np.multiply.outer(at[-half:], c) + d]
    )
