"""Two-dimensional time to collision (TTC): boxes extrapolated at constant velocity."""

from hid2.agents import FloatArray
from hid2.kernels import box_pairs
from hid2.measures.arrays import SceneArrays

#: TTC and PET above this are not told apart.
CAP_S = 5.0


def time_to_collision(arrays: SceneArrays, *, cap_s: float) -> tuple[FloatArray, FloatArray]:
    """Smallest TTC (N,) s of every row to any other agent present at its step, at most cap_s, and (A, A) of each pair.

    Of a pair the earlier agent is first.
    """
    return box_pairs.time_to_collision(
        arrays.position, arrays.heading, arrays.velocity, arrays.length, arrays.width, arrays.row_of, cap_s
    )
