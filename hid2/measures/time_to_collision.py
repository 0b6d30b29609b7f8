"""Two-dimensional time to collision (TTC): boxes extrapolated at constant velocity."""

from hid2.agents import FloatArray
from hid2.kernels.box_pairs import time_to_collision
from hid2.measures.arrays import SceneArrays

#: TTC and PET above this are not told apart.
CAP_S = 5.0


def ttc_to_anything(arrays: SceneArrays, *, cap_s: float = CAP_S) -> FloatArray:
    """(N,) s, smallest TTC of every row to any other agent present at its step, at most cap_s."""
    return ttc_of_rows_and_pairs(arrays, cap_s=cap_s)[0]


def ttc_of_rows_and_pairs(arrays: SceneArrays, *, cap_s: float) -> tuple[FloatArray, FloatArray]:
    """The same, and (A, A) s that of each pair of agents, the earlier one first."""
    return time_to_collision(
        arrays.position, arrays.heading, arrays.velocity, arrays.length, arrays.width, arrays.row_of, cap_s
    )
