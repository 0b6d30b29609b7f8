"""One trajectory: its derivatives, and the first box of the others that it meets."""

import numpy as np

from hid2.kernels.boxes import overlap
from hid2.kernels.compiled import inner, kernel
from netconvert.geometry import BoolArray, FloatArray


@kernel("(f8[:,::1], f8[::1], f8)")
def derivatives_of_motion(
    velocity: FloatArray, heading: FloatArray, step: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """In the order of `MotionProfile`: short arrays, for which a compiled loop takes a tenth of the time of numpy's."""
    count = heading.size
    cosine, sine = np.cos(heading), np.sin(heading)
    unwrapped = heading.copy()
    for t in range(1, count):
        unwrapped[t] = unwrapped[t - 1] + _turn(heading[t] - heading[t - 1], 2 * np.pi)
    accel_x, accel_y = slopes(velocity[:, 0], step), slopes(velocity[:, 1], step)
    jerk_x, jerk_y = slopes(accel_x, step), slopes(accel_y, step)
    along = accel_x * cosine + accel_y * sine
    rate = slopes(unwrapped, step)
    return (
        np.hypot(velocity[:, 0], velocity[:, 1]),
        along,
        accel_y * cosine - accel_x * sine,
        slopes(along, step),
        np.hypot(jerk_x, jerk_y),
        rate,
        slopes(rate, step),
    )


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
                    angle += _turn(heading[t + 1] - angle, np.pi) / 2
                    ox, oy = (ox + position[a, t + 1, 0]) / 2, (oy + position[a, t + 1, 1]) / 2
                    o_angle += _turn(other[a, t + 1] - o_angle, np.pi) / 2
                if np.hypot(ox - x, oy - y) > reach:
                    continue
                if overlap(
                    x, y, np.cos(angle), np.sin(angle), length / 2, width / 2,
                    ox, oy, np.cos(o_angle), np.sin(o_angle), lengths[a] / 2, widths[a] / 2,
                ):  # fmt: skip
                    return a, t
    return -1, -1


@inner
def _turn(angle: float, period: float) -> float:
    """The short way round; period: by so much it is the same, a box by half a turn."""
    return (angle + period / 2) % period - period / 2


@inner
def slopes(values: FloatArray, step: float) -> FloatArray:
    """Derivative of a quantity (T,) at equal steps by central differences, one-sided at the ends."""
    count = values.size
    slope = np.zeros(count)
    for t in range(count if count > 1 else 0):
        before, after = max(t - 1, 0), min(t + 1, count - 1)
        slope[t] = (values[after] - values[before]) / ((after - before) * step)
    return slope
