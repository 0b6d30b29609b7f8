"""Boxes that keep their velocity: which one each of many touches first."""

import math

from hid2.kernels.boxes import contact_time
from hid2.kernels.compiled import kernel
from netconvert.geometry import FloatArray


@kernel("(i8, f8[:,::1], f8[::1], f8[:,::1], f8[:,::1], f8)")
def earliest_contact(
    own: int, position: FloatArray, heading: FloatArray, velocity: FloatArray, size: FloatArray, horizon_s: float
) -> tuple[float, int]:
    """Time until box `own` of many touches another one, and which; (inf, -1) where none within the horizon.

    position, velocity, size (A, 2): m, m/s, and length and width in m; heading (A,) rad.
    """
    earliest, other = math.inf, -1
    radius = math.hypot(size[own, 0], size[own, 1]) / 2
    for k in range(len(heading)):
        if k == own:
            continue
        dx, dy = position[k, 0] - position[own, 0], position[k, 1] - position[own, 1]
        vx, vy = velocity[k, 0] - velocity[own, 0], velocity[k, 1] - velocity[own, 1]
        reach = radius + math.hypot(size[k, 0], size[k, 1]) / 2
        if math.hypot(dx, dy) - reach > math.hypot(vx, vy) * horizon_s:
            continue
        seconds = contact_time(
            dx, dy, vx, vy,
            math.cos(heading[own]), math.sin(heading[own]), size[own, 0] / 2, size[own, 1] / 2,
            math.cos(heading[k]), math.sin(heading[k]), size[k, 0] / 2, size[k, 1] / 2,
        )  # fmt: skip
        if seconds <= horizon_s and seconds < earliest:
            earliest, other = seconds, k
    return earliest, other
