"""Trajectories: the first box that one meets, and values that trail others from step to step."""

import numpy as np

from hid2.kernels.boxes import overlap
from hid2.kernels.compiled import inner, kernel
from netconvert.geometry import BoolArray, FloatArray


@kernel("(f8[:,::1], f8[::1], f8, f8, f8[:,:,::1], f8[:,::1], b1[:,::1], f8[::1], f8[::1])")
def first_overlapping(
    xy: FloatArray, heading: FloatArray, length: float, width: float, position: FloatArray, other: FloatArray,
    present: BoolArray, lengths: FloatArray, widths: FloatArray,
) -> tuple[int, int]:  # fmt: skip
    """Agent and step of the first box that a driven box (T,) meets, at the steps and halfway; -1 twice for none."""
    steps = min(xy.shape[0], present.shape[1])
    own_radius = np.hypot(length, width) / 2
    for a in range(present.shape[0]):
        reach = own_radius + np.hypot(lengths[a], widths[a]) / 2
        for t in range(steps):
            if not present[a, t]:
                continue
            for half in range(2):
                x, y, angle = xy[t, 0], xy[t, 1], heading[t]
                ox, oy, o_angle = position[a, t, 0], position[a, t, 1], other[a, t]
                if half == 1:
                    if t + 1 >= steps or not present[a, t + 1]:
                        continue
                    x, y = (x + xy[t + 1, 0]) / 2, (y + xy[t + 1, 1]) / 2
                    angle += _turned(angle, heading[t + 1]) / 2
                    ox, oy = (ox + position[a, t + 1, 0]) / 2, (oy + position[a, t + 1, 1]) / 2
                    o_angle += _turned(o_angle, other[a, t + 1]) / 2
                if np.hypot(ox - x, oy - y) > reach:
                    continue
                if overlap(
                    x, y, np.cos(angle), np.sin(angle), length / 2, width / 2,
                    ox, oy, np.cos(o_angle), np.sin(o_angle), lengths[a] / 2, widths[a] / 2,
                ):  # fmt: skip
                    return a, t
    return -1, -1


@inner
def _turned(before: float, after: float) -> float:
    """From one heading of a box to another, the short way round: half a turn makes the same box."""
    return (after - before + np.pi / 2) % np.pi - np.pi / 2


@kernel("(f8, f8[::1], f8[::1])")
def trailing(at: float, kept: FloatArray, gained: FloatArray) -> FloatArray:
    """Values (K + 1,) from one on: at each step a share kept (K,) of the one before, and what is gained (K,)."""
    found = np.empty(gained.size + 1)
    found[0] = at
    for k in range(gained.size):
        found[k + 1] = kept[k] * found[k] + gained[k]
    return found
