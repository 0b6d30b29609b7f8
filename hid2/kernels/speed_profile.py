"""Speeds along a path that a driver can keep to."""

import numpy as np

from hid2.kernels.compiled import kernel
from hid2.kernels.spline import TABLE_STEP_M
from netconvert.geometry import FloatArray


@kernel("(f8[::1], f8, f8)")
def reachable(cap: FloatArray, decel: float, accel: float) -> FloatArray:
    """Highest speed (S,) m/s at the points of a table that keeps below cap (S,) m/s.

    Backward pass for slowing in time, forward pass for speeding up, both in squares of speed.
    """
    out = np.empty_like(cap)
    slowing, speeding = 2 * decel * TABLE_STEP_M, 2 * accel * TABLE_STEP_M
    square = np.inf
    for i in range(out.size - 1, -1, -1):
        out[i] = square = min(cap[i] * cap[i], square + slowing)
    square = np.inf
    for i in range(out.size):
        square = min(out[i], square + speeding)
        out[i] = np.sqrt(square)
    return out
