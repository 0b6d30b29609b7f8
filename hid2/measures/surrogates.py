"""Surrogate measures of safety of two agents: two-dimensional TTC, and PET at crossings of swept paths (SSAM)."""

import math
from typing import NamedTuple

import numpy as np

from hid2.agents import FloatArray, IntArray
from hid2.kernels import box_pairs
from hid2.measures.arrays import SceneArrays

#: Cap of TTC and PET, s: larger ones are not told apart.
CAP_S = 5.0
#: Angle below which paths that meet follow each other and do not cross, deg (SSAM's rear-end bound).
REAR_END_DEG = 30.0
_REAR_END_RAD = math.radians(REAR_END_DEG)
#: Time beyond a vehicle's last step in which contacts are sought, s. No tunable: what generator and judge look at.
END_HORIZON_S = 3.0


def time_to_collision(arrays: SceneArrays, *, cap_s: float) -> tuple[FloatArray, FloatArray]:
    """Smallest TTC (N,) s of every row to any other agent present at its step, at most cap_s, and (A, A) of each pair.

    Boxes extrapolated at constant velocity. Of a pair the earlier agent is first.
    """
    return box_pairs.time_to_collision(
        arrays.position, arrays.heading, arrays.velocity, arrays.length, arrays.width, arrays.row_of, cap_s
    )


def earliest_contact(
    own: int, position: FloatArray, heading: FloatArray, velocity: FloatArray, length_m: FloatArray, width_m: FloatArray
) -> tuple[float, int]:
    """Time, s, until box `own` of many (A,) touches another one, and which; (inf, -1) where none within END_HORIZON_S.

    Leaders, followers, oncoming and crossing ones alike; 0 s where they overlap.
    """
    rows, cap_s = np.arange(len(heading))[:, None], END_HORIZON_S + 1e-9
    _, ttc_s = box_pairs.time_to_collision(position, heading, velocity, length_m, width_m, rows, cap_s)
    of_own = np.minimum(ttc_s[own], ttc_s[:, own])
    other = int(of_own.argmin())
    return (float(of_own[other]), other) if of_own[other] <= END_HORIZON_S else (math.inf, -1)


class Encroachment(NamedTuple):
    """A crossing of two vehicles' swept paths: post-encroachment time, and the steps at which each passes there."""

    first: int
    second: int
    pet_s: float
    passed: tuple[int, int]


def encroachments(
    arrays: SceneArrays, *, first_row: int = 0, cap_s: float = CAP_S, agents: IntArray | None = None,
    crossing_rad: float = _REAR_END_RAD,
) -> tuple[Encroachment, ...]:  # fmt: skip
    """PET of every pair of moving vehicles with swept paths that cross within cap_s of each other.

    first_row: of pairs with this agent or a later one as the second alone; agents (K,), ascending: those looked at,
    instead of moving vehicles; crossing_rad: paths that meet at less do not cross.
    """
    moving = np.flatnonzero(arrays.moving_vehicles) if agents is None else agents
    steps, crossed = box_pairs.post_encroachment(
        moving, arrays.position, arrays.heading, arrays.length, arrays.width, arrays.first, arrays.step,
        round(cap_s / arrays.step_s), crossing_rad, int(np.searchsorted(moving, first_row)),
    )  # fmt: skip
    found = []
    for p, q in np.argwhere(steps >= 0):
        pair = int(moving[p]), int(moving[q])
        at, then = arrays.step[arrays.first[list(pair)] + crossed[p, q]].tolist()
        found.append(Encroachment(*pair, float(steps[p, q] * arrays.step_s), (at, then)))
    return tuple(found)
