"""Which points of a line are near a place: looked up in a raster of squares instead of marching along the line."""

from typing import NamedTuple

import numpy as np
from numba import njit

from hid2.agents import FloatArray

_SQUARE_M = 3.0
_EVERY = 4  # points of the line between two that are entered, which are entered so much more widely


class Raster(NamedTuple):
    """first, last (X, Y): whichever point of the line is within reach_m of a place in a square is between the two.

    first is -1 in squares with none. The square [i, j] begins at (x0 + i side_m, y0 + j side_m); there is none near
    outside of them.
    """

    x0: float
    y0: float
    side_m: float
    reach_m: float
    first: np.ndarray[tuple[int, int], np.dtype[np.int32]]
    last: np.ndarray[tuple[int, int], np.dtype[np.int32]]


def raster(xy: FloatArray, *, step_m: float, reach_m: float) -> Raster:
    """Raster of a line's points xy (K, 2) m, which are at most step_m apart."""
    wide = reach_m + step_m * _EVERY
    x0, y0, first, last = _enter(xy, wide, _SQUARE_M)
    return Raster(x0, y0, _SQUARE_M, reach_m, first, last)


@njit(cache=True)
def _enter(xy, wide, side):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Enter every few points in the squares around them; the points between are nearer than what `wide` adds."""
    x0, y0 = xy[:, 0].min() - wide, xy[:, 1].min() - wide
    columns = int((xy[:, 0].max() + wide - x0) / side) + 1
    rows = int((xy[:, 1].max() + wide - y0) / side) + 1
    first = np.full((columns, rows), -1, dtype=np.int32)
    last = np.full((columns, rows), -1, dtype=np.int32)
    count = xy.shape[0]
    for k in range(0, count, _EVERY):
        end = min(k + _EVERY, count) - 1
        for i in range(int((xy[k, 0] - wide - x0) / side), int((xy[k, 0] + wide - x0) / side) + 1):
            for j in range(int((xy[k, 1] - wide - y0) / side), int((xy[k, 1] + wide - y0) / side) + 1):
                if first[i, j] < 0:
                    first[i, j] = k
                last[i, j] = end
    return x0, y0, first, last
