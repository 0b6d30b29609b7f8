"""SUMO's car-following laws, without their noise: what a driver makes of a leader and of its wish in one step."""

import numpy as np

from hid2.kernels.compiled import inner


@inner
def idm_speed(
    v: float, wished: float, gap: float, lead_v: float, driver: tuple[float, float, float, float], step_s: float
) -> float:
    """Speed after a step by the IDM, m/s: own speed, wished speed, bumper gap (inf: no leader) and leader's speed.

    driver: tau s, acceleration and deceleration m/s2, gap at standstill m.
    """
    tau, accel, decel, min_gap = driver
    a: float = accel * (1.0 - (v / max(wished, 0.1)) ** 4)
    if gap < np.inf:
        star = min_gap + max(0.0, v * tau + v * (v - lead_v) / (2.0 * np.sqrt(accel * decel)))
        a -= accel * (star / max(gap, 0.1)) ** 2
    return max(0.0, v + max(a, -9.0) * step_s)
