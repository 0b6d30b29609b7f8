"""What is exported is a selection of what was driven: how vehicles drive that are kept, and that are not."""

from collections.abc import Iterable

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from hid2.agents import FloatArray
from hid2.measures.arrays import STANDS_FOR_S, STANDS_MPS

#: Deceleration above which braking is hard, m/s2, in the mean over a time, s: a tracker's noise is shorter. As near as
#: that time to the ends of a track none counts: there trackers show a third less speed than there is.
HARD_BRAKING_MPS2, BRAKING_FOR_S = 3.0, 0.5


class Drives(BaseModel):
    """How vehicles drive: how many, those of them that brake hard at some time, and those that stand at some time.

    limited: of so many steps of all of them, those in which the guard held one below SUMO's own choice of speed for a
    conflict.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    vehicles: int = Field(ge=0)
    braking: int = Field(ge=0)
    standing: int = Field(ge=0)
    steps: int = Field(ge=0)
    limited: int = Field(ge=0)


def drives(speeds: Iterable[FloatArray], *, step_s: float, limited: int = 0) -> Drives:
    """Of vehicles by their speeds, each (T_i,) m/s at the steps that it is there; limited: steps of all of them."""
    brake, stand = round(BRAKING_FOR_S / step_s), round(STANDS_FOR_S / step_s)
    vehicles = braking = standing = steps = 0
    for speed in speeds:
        vehicles, steps = vehicles + 1, steps + max(0, len(speed) - 1)
        inner = speed[brake:-brake]
        braking += bool(np.any(inner[:-brake] - inner[brake:] > HARD_BRAKING_MPS2 * brake * step_s))
        standing += int((speed < STANDS_MPS).sum()) >= stand
    return Drives(vehicles=vehicles, braking=braking, standing=standing, steps=steps, limited=limited)
