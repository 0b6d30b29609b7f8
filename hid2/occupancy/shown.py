"""Agents that SUMO is shown, as its car following has them on a path: how fast, and whether it sees them at all."""

from dataclasses import dataclass

import numpy as np

from hid2.agents import FloatArray
from hid2.kernels.gaps import leading_in_sumo
from hid2.motion.route import DrivenPath
from hid2.occupancy.along_path import PathOccupancy
from hid2.occupancy.traffic import BoolArray, Traffic

#: Steps until SUMO knows speed and acceleration of a vehicle that is new to it; before, no other vehicle sees it.
UNSEEN_STEPS = 3


@dataclass(frozen=True, eq=False, slots=True)
class Shown:
    """Agents (R,) on a path by steps (R, T): middle m, speed m/s, whether SUMO has them as leaders; length_m (R,)."""

    middle: FloatArray
    speed: FloatArray
    leads: BoolArray
    length_m: FloatArray

    def joined(self, other: "Shown") -> "Shown":
        """Agents of both."""
        return Shown(*(np.concatenate([getattr(self, name), getattr(other, name)]) for name in self.__slots__))


def shown_on(path: DrivenPath, traffic: Traffic, seen: PathOccupancy, *, step_s: float) -> Shown:
    """What SUMO has of agents of `traffic` on a path, by their fronts; seen: their intervals in the driven width."""
    front, speed, has_speed = _fronts(traffic, step_s)
    middle, leads = leading_in_sumo(
        seen.low, seen.high, seen.along, seen.same_direction, seen.crossing, seen.agents, traffic.length_m, front,
        has_speed, path.line.table_xy, path.line.table_heading, path.exit_m,
    )  # fmt: skip
    return Shown(middle, speed[seen.agents], leads, traffic.length_m[seen.agents])


def _fronts(traffic: Traffic, step_s: float) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Fronts (A, T, 2) m, their speeds (A, T) m/s, and whether SUMO knows these (A, T); kept with the traffic."""
    key = _fronts, step_s
    if key not in traffic.memo:
        ahead = np.stack([np.cos(traffic.heading), np.sin(traffic.heading)], axis=-1)
        front = traffic.position + 0.5 * traffic.length_m[:, None, None] * ahead
        speed = traffic.speed
        moved = np.diff(front, axis=1)
        speed[:, 1:] = np.hypot(moved[..., 0], moved[..., 1]) / step_s
        first = np.maximum(np.arange(traffic.num_steps) - UNSEEN_STEPS, 0)  # those of step 0 come in before it
        traffic.memo[key] = front, speed, traffic.present & traffic.present[:, first]
    found: tuple[FloatArray, FloatArray, BoolArray] = traffic.memo[key]
    return found
