"""Derivatives along the tracks of a scene."""

import numpy as np

from hid2.kernels.compiled import kernel
from netconvert.geometry import FloatArray, IntArray


@kernel("(f8[:,::1], i8[::1], i8[::1], f8,)")
def track_derivative(values: FloatArray, first: IntArray, step: IntArray, step_s: float) -> FloatArray:
    """Time derivative of values (N, K), track by track: rows first[a]:first[a + 1] at steps step (N,), step_s apart."""
    out = np.zeros_like(values)
    for agent in range(len(first) - 1):
        start, end = first[agent], first[agent + 1] - 1
        if end <= start:
            continue
        for k in range(values.shape[1]):
            out[start, k] = (values[start + 1, k] - values[start, k]) / (step[start + 1] - step[start]) / step_s
            out[end, k] = (values[end, k] - values[end - 1, k]) / (step[end] - step[end - 1]) / step_s
            for i in range(start + 1, end):
                before, after = float(step[i] - step[i - 1]), float(step[i + 1] - step[i])
                rise = (
                    before**2 * values[i + 1, k] + (after**2 - before**2) * values[i, k] - after**2 * values[i - 1, k]
                )
                out[i, k] = rise / (before * after * (before + after)) / step_s
    return out
