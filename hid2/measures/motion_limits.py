"""Limits of motion: which quantity must not exceed which parameter, for the judge and the last check."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hid2.agents import FloatArray
from hid2.params import Limits
from hid2.reasons import Reason


@dataclass(frozen=True, eq=False, slots=True)
class MotionProfile:
    """What a reader of positions would compute, by differences at the steps, each (N,): the names say the units."""

    speed_mps: FloatArray
    accel_mps2: FloatArray
    lateral_accel_mps2: FloatArray
    longitudinal_jerk_mps3: FloatArray
    jerk_mps3: FloatArray
    yaw_rate_radps: FloatArray
    yaw_accel_radps2: FloatArray


class MotionLimit(NamedTuple):
    """One limit of motion. value: of the profile, exceeded above the bound; bound: of the parameters, positive."""

    name: str
    reason: Reason
    value: Callable[[MotionProfile], FloatArray]
    bound: Callable[[Limits], float]


#: In the order in which the last check names the first one that is exceeded.
MOTION_LIMITS = (
    MotionLimit("accel", Reason.LIMIT_ACCEL, lambda p: p.accel_mps2, lambda m: m.accel_max_mps2),
    MotionLimit("decel", Reason.LIMIT_DECEL, lambda p: -p.accel_mps2, lambda m: -m.accel_min_mps2),
    MotionLimit("lateral_accel", Reason.LIMIT_LATERAL_ACCEL,
                lambda p: np.abs(p.lateral_accel_mps2), lambda m: m.lateral_accel_mps2),
    MotionLimit("longitudinal_jerk", Reason.LIMIT_LONGITUDINAL_JERK,
                lambda p: np.abs(p.longitudinal_jerk_mps3), lambda m: m.longitudinal_jerk_mps3),
    MotionLimit("jerk", Reason.LIMIT_JERK, lambda p: p.jerk_mps3, lambda m: m.jerk_mps3),
    MotionLimit("yaw_rate", Reason.LIMIT_YAW_RATE, lambda p: np.abs(p.yaw_rate_radps), lambda m: m.yaw_rate_radps),
    MotionLimit("yaw_accel", Reason.LIMIT_YAW_ACCEL,
                lambda p: np.abs(p.yaw_accel_radps2), lambda m: m.yaw_accel_radps2),
)  # fmt: skip
