"""LO, LA, JE of the paper (section Realism and Safety), and the series they come from.

All derivatives are taken from positions and headings by second-order central differences (one-sided at the ends of
a track, as `numpy.gradient`), at the true times of the steps.
"""

from dataclasses import dataclass

import numpy as np

from hid2.agents import FloatArray
from hid2.judge.findings import MotionProfile
from hid2.measures.arrays import BoolArray, SceneArrays

#: Least steps of a track that counts in LO, LA and JE: the third derivative needs five samples.
MIN_STEPS = 5


@dataclass(frozen=True, eq=False, slots=True)
class Kinematics:
    """LO, LA, JE and speed by agent (A,): means over an agent's steps; `counted`: tracks of at least MIN_STEPS."""

    speed_mps: FloatArray
    lo: FloatArray
    la: FloatArray
    je: FloatArray
    counted: BoolArray


def motion(arrays: SceneArrays) -> MotionProfile:
    """Derivatives at every row of a scene, from positions and headings."""
    heading = np.concatenate([np.zeros(0), *map(np.unwrap, np.split(arrays.heading, arrays.first[1:-1]))])
    return MotionProfile.of(arrays.derivative(arrays.position), heading, arrays.derivative)


def kinematics(arrays: SceneArrays, moved: MotionProfile) -> Kinematics:
    """LO = |a_x cos + a_y sin|, LA = |-a_x sin + a_y cos|, JE = |da/dt|: mean over each agent's steps (paper, 4.2)."""
    return Kinematics(
        speed_mps=arrays.mean_per_agent(moved.speed_mps),
        lo=arrays.mean_per_agent(np.abs(moved.accel_mps2)),
        la=arrays.mean_per_agent(np.abs(moved.lateral_accel_mps2)),
        je=arrays.mean_per_agent(moved.jerk_mps3),
        counted=arrays.rows_per_agent >= MIN_STEPS,
    )
