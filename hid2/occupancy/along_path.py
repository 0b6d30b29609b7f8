"""Where others are along a path, at each step: boxes turned into forbidden intervals of the own centre's arc length.

Recorded agents enter with their true future, generated ones with their predicted one (paper, Trajectory Generation,
conflict case 3).
"""

from typing import NamedTuple

import numpy as np

from hid2.agents import BoxSize, FloatArray, IntArray
from hid2.kernels.path_intervals import crossings_kept_clear, intervals_on_path
from hid2.motion.reference_line import ReferenceLine
from hid2.occupancy.traffic import BoolArray, Traffic

#: Reach of the raster of points near an agent, m: half the diagonals of a large car and of a bus, or of a car that has
#: room for a lane change, and that room. Not a parameter, it saves time: for more reach all points are looked at.
_NEAR_M = 11.0


class PathOccupancy(NamedTuple):
    """Forbidden intervals of the own box centre on one path.

    agents (A,): their rows in the traffic. low, high (A, T) m: the own box touches the agent's (with the lateral
    margin) while low < s < high; low is +inf and high is -inf where it never does. along (A, T) m/s: the agent's speed
    in the path's direction there. same_direction (A, T): it moves with the path (a leader or follower) rather than
    across or against it; crossing (A, T): it moves across, rather than with or against it.
    """

    agents: IntArray
    low: FloatArray
    high: FloatArray
    along: FloatArray
    same_direction: BoolArray
    crossing: BoolArray

    @classmethod
    def none(cls, steps: int) -> "PathOccupancy":
        """Of no agents at so many steps."""
        nowhere, never = np.zeros((0, steps)), np.zeros((0, steps), dtype=np.bool_)
        return cls(np.zeros(0, dtype=np.int64), nowhere, nowhere, nowhere, never, never)

    def rows(self, which: BoolArray | slice) -> "PathOccupancy":
        """Some of the agents."""
        return PathOccupancy._make(one[which] for one in self)

    def at(self, step: int) -> "PathOccupancy":
        """The same agents at one step, T = 1."""
        return PathOccupancy._make((self.agents, *(one[:, step : step + 1] for one in self[1:])))

    def kept_clear(self, steps: int) -> "PathOccupancy":
        """The same, with the place of crossing agents taken so many steps before and after: PET is kept at crossings.

        What is kept to a box that is there needs not be kept to one that was or will be: the place is smaller by
        PET_MARGIN_M on both sides then.
        """
        if not self.crossing.any():
            return self
        low, high, same_direction = crossings_kept_clear(self.low, self.high, self.same_direction, self.crossing, steps)
        return self._replace(low=low, high=high, same_direction=same_direction)

    def joined(self, *others: "PathOccupancy") -> "PathOccupancy":
        """Agents of all, self first; each with its row in its own traffic."""
        every = [one for one in (self, *others) if one.agents.size]
        if len(every) <= 1:
            return every[0] if every else self
        return PathOccupancy._make(map(np.concatenate, zip(*every, strict=True)))


def path_occupancy(
    line: ReferenceLine, traffic: Traffic, box: BoxSize, *, margin_m: float = 0.0, clear_steps: int = 0
) -> PathOccupancy:
    """Intervals of every agent of `traffic` on `line` for a box with a lateral margin. Only agents that ever touch it.

    clear_steps: as in `PathOccupancy.kept_clear`, unless 0. What is found is kept with the traffic, for what is joined
    to it, too: many vehicles look along the same few paths.
    """
    key = line, box, margin_m, clear_steps
    kept: PathOccupancy | None = traffic.memo.get(key)
    if kept is not None:
        return kept
    if not traffic.ids:
        return PathOccupancy.none(traffic.num_steps)
    before = traffic.extends
    while before is not None and key not in before.memo:
        before = before.extends
    kept_before = None if before is None else before.memo[key]
    if clear_steps > 0:
        plain = path_occupancy(line, traffic, box, margin_m=margin_m)
        new = plain.rows(slice(0 if kept_before is None else kept_before.agents.size, None))
        found = new.kept_clear(clear_steps)
    else:
        since = 0 if before is None else len(before.ids)
        found = look_along(line, traffic, box.length_m, box.width_m + 2 * margin_m, since)
    if kept_before is not None:
        found = kept_before.joined(found)
    traffic.memo[key] = found
    return found


def look_along(line: ReferenceLine, traffic: Traffic, length_m: float, width_m: float, since: int = 0) -> PathOccupancy:
    """Intervals of the agents, from row `since` on, that ever touch the line; width_m with all margins."""
    near, points = line.near(_NEAR_M)
    others = (traffic.position, traffic.heading, traffic.velocity, traffic.present, traffic.length_m, traffic.width_m)
    return PathOccupancy(*intervals_on_path(points, line.table_heading, *near, length_m, width_m, *others, since))
