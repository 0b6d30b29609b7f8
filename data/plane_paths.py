"""Paths in the plane, of which the lanes and the ways of a synthetic scene are made."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


def smoothstep(u: FloatArray | float) -> FloatArray:
    """0 to 1 with two continuous derivatives, constant outside [0, 1]."""
    u = np.clip(u, 0.0, 1.0)
    return np.asarray(u * u * u * (10.0 + u * (6.0 * u - 15.0)))


@dataclass(frozen=True, eq=False)
class Path2d:
    """A densely sampled path. xy (N, 2) m; s (N,) m, arc length; heading (N,) rad, not wrapped."""

    xy: FloatArray
    s: FloatArray
    heading: FloatArray

    @classmethod
    def through(cls, xy: FloatArray) -> "Path2d":
        """The path along dense points."""
        ahead = np.gradient(xy, axis=0)
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1))])
        return cls(xy, s, np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0])))

    @classmethod
    def joined(cls, *parts: "Path2d") -> "Path2d":
        """One path along several that follow each other."""
        return cls.through(np.vstack([parts[0].xy, *(part.xy[1:] for part in parts[1:])]))

    def at(self, s: FloatArray, *, offset_m: FloatArray | float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Points (M, 2) and headings (M,) of the path at arc lengths, offset to the left."""
        heading = np.interp(s, self.s, self.heading)
        xy = np.column_stack([np.interp(s, self.s, self.xy[:, 0]), np.interp(s, self.s, self.xy[:, 1])])
        return xy + np.column_stack([-np.sin(heading), np.cos(heading)]) * np.reshape(offset_m, (-1, 1)), heading

    def reverse(self) -> "Path2d":
        """The same path driven the other way."""
        return Path2d.through(self.xy[::-1])


def line(start: Sequence[float], end: Sequence[float]) -> Path2d:
    """A straight path."""
    first, last = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    count = int(np.linalg.norm(last - first) / 0.02) + 2
    u = np.arange(count) / (count - 1)
    return Path2d.through(np.vstack([first + u[:-1, None] * (last - first), last]))


def bend(curvature: Callable[[FloatArray], FloatArray], length_m: float) -> Path2d:
    """A path from the origin, eastward at first, by its curvature (1/m) over arc length."""
    s = np.arange(int(length_m / 0.02) + 1) * 0.02
    heading = np.concatenate([[0.0], np.cumsum(curvature(s[:-1] + 0.01)) * 0.02])
    middle = (heading[:-1] + heading[1:]) / 2
    steps = np.column_stack([np.cos(middle), np.sin(middle)]) * 0.02
    return Path2d(np.vstack([[0.0, 0.0], np.cumsum(steps, axis=0)]), s, heading)


def turn(start: Sequence[float], start_to: Sequence[float], end: Sequence[float], end_to: Sequence[float]) -> Path2d:
    """A turn by 90 degrees between two points with unit directions.

    Its curvature rises, stays and falls (30, 40 and 30 % of the way) over the shorter leg; what the other leg is
    longer by is straight.
    """
    p, q, t, n = (np.asarray(value, dtype=np.float64) for value in (start, end, start_to, end_to))
    u = (np.arange(2000) + 0.5) / 2000
    heading = np.concatenate([[0.0], np.cumsum(np.clip(np.minimum(u, 1 - u) / 0.3, 0.0, 1.0))])
    heading = heading / heading[-1] * np.pi / 2
    middle = (heading[:-1] + heading[1:]) / 2
    along = np.concatenate([[0.0], np.cumsum(np.cos(middle))])
    across = np.concatenate([[0.0], np.cumsum(np.sin(middle))])
    legs = float((q - p) @ t), float((q - p) @ n)
    scale = min(legs) / float(along[-1])
    xy = p + scale * (along[:, None] * t + across[:, None] * n)
    longer = float(abs(legs[0] - legs[1]))
    if longer > 0.05:
        straight = (np.arange(int(longer / 0.02)) + 1)[:, None] * (longer / int(longer / 0.02))
        xy = np.vstack([xy, xy[-1] + straight * n] if legs[1] > legs[0] else [p, p + straight * t, xy[1:] + longer * t])
    xy[0], xy[-1] = p, q
    return Path2d.through(xy)


def sideways(base: Path2d, offset: Callable[[FloatArray], FloatArray] | float) -> Path2d:
    """The path at an offset to the left of another, constant or over its arc length."""
    offsets = offset(base.s) if callable(offset) else np.full(len(base.s), offset)
    normal = np.column_stack([-np.sin(base.heading), np.cos(base.heading)])
    return Path2d.through(base.xy + normal * offsets[:, None])
