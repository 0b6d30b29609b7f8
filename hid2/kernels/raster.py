"""Which points of a line are near a place: looked up in a raster of squares instead of marching along the line."""

from typing import NamedTuple

import numpy as np

from hid2.kernels.compiled import kernel
from netconvert.geometry import FloatArray

#: Side of a square, m. Not a parameter, it saves time: the raster says where to look, what is found there is measured.
_SQUARE_M = 3.0
_EVERY = 4  # spacing, in points of the line, of those entered, each as much more widely; not a parameter, it saves time


IndexTable = np.ndarray[tuple[int, int], np.dtype[np.int32]]


class Raster(NamedTuple):
    """first, last (X, Y): whichever point of the line is within reach_m of a place in a square is between the two.

    first is -1 in squares with none. The square [i, j] begins at (x0 + i side_m, y0 + j side_m); there is none near
    outside of them.
    """

    x0: float
    y0: float
    side_m: float
    reach_m: float
    first: IndexTable
    last: IndexTable

    def last_near(self, xy: FloatArray) -> IndexTable:
        """(A, T) last point of the line that may be within reach_m of places (A, T, 2) m, -1 where there is none."""
        square = np.floor((xy - (self.x0, self.y0)) / self.side_m).astype(np.int64)
        inside = np.asarray(((square >= 0) & (square < self.last.shape)).all(axis=-1))
        column, row = np.moveaxis(np.where(inside[..., None], square, 0), -1, 0)
        return np.where(inside, self.last[column, row], -1)


def raster(xy: FloatArray, *, step_m: float, reach_m: float) -> Raster:
    """Raster of a line's points xy (K, 2) m, which are at most step_m apart."""
    wide = reach_m + step_m * _EVERY
    x0, y0, first, last = _enter(xy, wide, _SQUARE_M)
    return Raster(x0, y0, _SQUARE_M, reach_m, first, last)


@kernel("(f8[:,::1], f8, f8,)")
def _enter(xy: FloatArray, wide: float, side: float) -> tuple[float, float, IndexTable, IndexTable]:
    """Enter every few points in the squares around them; the points between are nearer than what `wide` adds."""
    count = xy.shape[0]
    x0, y0, x1, y1 = xy[0, 0], xy[0, 1], xy[0, 0], xy[0, 1]
    for k in range(count):
        x0, y0, x1, y1 = min(x0, xy[k, 0]), min(y0, xy[k, 1]), max(x1, xy[k, 0]), max(y1, xy[k, 1])
    x0, y0 = x0 - wide, y0 - wide
    columns, rows = int((x1 + wide - x0) / side) + 1, int((y1 + wide - y0) / side) + 1
    first = np.full((columns, rows), -1, dtype=np.int32)
    last = np.full((columns, rows), -1, dtype=np.int32)
    for k in range(0, count, _EVERY):
        end = min(k + _EVERY, count) - 1
        for i in range(int((xy[k, 0] - wide - x0) / side), int((xy[k, 0] + wide - x0) / side) + 1):
            for j in range(int((xy[k, 1] - wide - y0) / side), int((xy[k, 1] + wide - y0) / side) + 1):
                if first[i, j] < 0:
                    first[i, j] = k
                last[i, j] = end
    return x0, y0, first, last
