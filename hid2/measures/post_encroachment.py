"""Post-encroachment time (PET) at crossings of swept paths (evaluation.md; SSAM's crossing case)."""

import math
from typing import NamedTuple

import numpy as np

from hid2.kernels.box_pairs import post_encroachment
from hid2.measures.arrays import SceneArrays
from hid2.measures.time_to_collision import CAP_S

#: Paths that meet at less than this follow each other; they do not cross (SSAM's rear-end bound).
CROSSING_RAD = math.radians(30)


class Encroachment(NamedTuple):
    """A crossing of two vehicles' swept paths: post-encroachment time between them."""

    first: int
    second: int
    pet_s: float


def encroachments(arrays: SceneArrays, *, since: int = 0, cap_s: float = CAP_S) -> tuple[Encroachment, ...]:
    """PET of every pair of moving vehicles whose swept paths cross within cap_s of each other.

    since: only pairs whose second agent is this one or a later one.
    """
    moving = np.flatnonzero(arrays.vehicle & arrays.moving)
    steps = post_encroachment(
        moving,
        arrays.position,
        arrays.heading,
        arrays.length,
        arrays.width,
        arrays.first,
        arrays.step,
        round(cap_s / arrays.step_s),
        CROSSING_RAD,
        int(np.searchsorted(moving, since)),
    )
    return tuple(
        Encroachment(int(moving[p]), int(moving[q]), float(steps[p, q] * arrays.step_s))
        for p, q in np.argwhere(steps >= 0)
    )
