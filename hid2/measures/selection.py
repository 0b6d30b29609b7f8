"""What is exported is a selection of what was driven: how vehicles drive that are kept, and that are not."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from hid2.agents import FloatArray
from hid2.measures.encounters import STANDS_FOR_S, STANDS_MPS

#: Deceleration above which braking is hard, m/s2, in the mean over a time, s: a tracker's noise is shorter. As near as
#: that time to the ends of a track none counts: there trackers show a third less speed than there is.
HARD_BRAKING_MPS2, BRAKING_FOR_S = 3.0, 0.5


class Drives(NamedTuple):
    """How vehicles drive: how many, those of them that brake hard at some time, and those that stand at some time.

    limited: of so many steps of all of them, those in which the guard held one below SUMO's own choice of speed for a
    conflict.
    """

    vehicles: int
    braking: int
    standing: int
    steps: int
    limited: int


def drives(speeds: Iterable[FloatArray], *, step_s: float, limited: int = 0) -> Drives:
    """Of vehicles by their speeds, each (T_i,) m/s at the steps that it is there; limited: steps of all of them."""
    brake, stand = round(BRAKING_FOR_S / step_s), round(STANDS_FOR_S / step_s)
    vehicles = braking = standing = steps = 0
    for speed in speeds:
        vehicles, steps = vehicles + 1, steps + max(0, len(speed) - 1)
        inner = speed[brake:-brake]
        braking += bool(np.any(inner[:-brake] - inner[brake:] > HARD_BRAKING_MPS2 * brake * step_s))
        standing += int((speed < STANDS_MPS).sum()) >= stand
    return Drives(vehicles, braking, standing, steps, limited)
