"""The next agents ahead of and behind places on a path: the loop of `occupancy/gaps.py`."""

import numpy as np

from hid2.kernels.compiled import kernel
from netconvert.geometry import BoolArray, FloatArray, IntArray


@kernel("(f8[:,::1], f8[:,::1], b1[:,::1], f8[::1], i8[::1])")
def next_on_path(
    low: FloatArray, high: FloatArray, counts: BoolArray, s: FloatArray, column: IntArray
) -> tuple[IntArray, FloatArray, IntArray, FloatArray]:
    """Rows of the next agent ahead and its gap, of the next behind and its gap, (N,) each; -1 and inf for none.

    low, high (R, T) m: as in `PathOccupancy`; counts (R, T): the agents that are looked at; s (N,) m: places on the
    path, each at a step of its own, column (N,).
    """
    ahead, behind = np.full(s.size, -1, dtype=np.int64), np.full(s.size, -1, dtype=np.int64)
    lead, lag = np.full(s.size, np.inf), np.full(s.size, np.inf)
    for n in range(s.size):
        t = column[n]
        for row in range(low.shape[0]):
            if low[row, t] == np.inf or not counts[row, t]:
                continue
            if 0.5 * (low[row, t] + high[row, t]) >= s[n]:
                if low[row, t] - s[n] < lead[n]:
                    ahead[n], lead[n] = row, low[row, t] - s[n]
            elif s[n] - high[row, t] < lag[n]:
                behind[n], lag[n] = row, s[n] - high[row, t]
    return ahead, lead, behind, lag
