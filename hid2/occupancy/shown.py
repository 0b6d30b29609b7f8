"""Agents that SUMO is shown, as its car following has them on a path: how fast, and whether it sees them at all."""

from dataclasses import dataclass

import numpy as np

from hid2.agents import FloatArray
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.motion.route import DrivenPath
from hid2.occupancy.along_path import PathOccupancy
from hid2.occupancy.traffic import BoolArray, Traffic

#: Steps for which SUMO takes a new vehicle for one that stands: until then it is seen by none.
UNSEEN_STEPS = 2
#: No tunable, half a lane and a little: an agent whose front is farther aside is ahead of none.
ASIDE_M = 2.0


@dataclass(frozen=True, eq=False, slots=True)
class Shown:
    """Agents (R,) on a path by steps (R, T): middle m, speed m/s, whether SUMO has them as leaders; length_m (R,)."""

    middle: FloatArray
    speed: FloatArray
    leads: BoolArray
    length_m: FloatArray

    def joined(self, other: "Shown") -> "Shown":
        """Agents of both."""
        if not other.length_m.size:
            return self
        return Shown(*(np.concatenate([getattr(self, name), getattr(other, name)]) for name in self.__slots__))


def shown_on(path: DrivenPath, traffic: Traffic, seen: PathOccupancy, *, standing_mps: float, step_s: float) -> Shown:
    """What SUMO has of agents of `traffic` on a path, seen: their intervals in the width that is driven.

    It knows the speed of a vehicle's front from where that was a step before, and puts it on the lane below its front.
    """
    rows, line = seen.agents, path.line
    heading, half_m = traffic.heading[rows], 0.5 * traffic.length_m[rows, None]
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    front = traffic.position[rows] + half_m[..., None] * ahead
    speed = np.hypot(*traffic.velocity[rows].transpose(2, 0, 1))
    speed[:, 1:] = np.hypot(*np.diff(front, axis=1).transpose(2, 0, 1)) / step_s
    on = np.isfinite(seen.low)
    middle = 0.5 * (np.where(on, seen.low, 0.0) + np.where(on, seen.high, 0.0))
    at = np.clip(((middle + half_m) / TABLE_STEP_M).astype(np.int64), 0, len(line.table_xy) - 1)
    (dx, dy), angle = (front - line.table_xy[at]).transpose(2, 0, 1), line.table_heading[at]
    aside = np.abs(np.cos(angle) * dy - np.sin(angle) * dx)
    present = traffic.present[rows]
    first = np.maximum(np.arange(present.shape[1]) - UNSEEN_STEPS, 0)  # those of the first step come in before it
    known = present & present[:, first]
    moves = seen.same_direction | (~seen.crossing & (np.abs(seen.along) < standing_mps))
    leads = on & moves & known & (aside < ASIDE_M) & (middle + half_m < path.exit_s)
    return Shown(middle, speed, leads, traffic.length_m[rows])
