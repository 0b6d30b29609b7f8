"""Where others are along a path, at each step: boxes turned into forbidden intervals of the own centre's arc length.

Recorded agents enter with their true future, generated ones with their predicted one (paper, Trajectory Generation,
conflict case 3).
"""

from dataclasses import dataclass

import numpy as np

from hid2.agents import FloatArray
from hid2.kernels.path_intervals import crossings_kept_clear, intervals_on_path
from hid2.motion.reference_line import TABLE_STEP_M, ReferenceLine
from hid2.occupancy.traffic import Traffic

#: Half the diagonals of a large car and of a bus, or of a car that keeps room for a lane change, and that. No tunable:
#: a bound that spares time.
_NEAR_M = 11.0


@dataclass(frozen=True, eq=False, slots=True)
class PathOccupancy:
    """Forbidden intervals of the own box centre on one path.

    low, high (A, T) m: the own box touches the agent's (with the lateral margin) while low < s < high; low is +inf and
    high is -inf where it never does. along (A, T) m/s: the agent's speed in the path's direction there.
    same_direction (A, T): it moves with the path (a leader or follower) rather than across or against it; crossing
    (A, T): it moves across, rather than with or against it.
    """

    low: FloatArray
    high: FloatArray
    along: FloatArray
    same_direction: np.ndarray[tuple[int, int], np.dtype[np.bool_]]
    crossing: np.ndarray[tuple[int, int], np.dtype[np.bool_]]

    @classmethod
    def nobody(cls, steps: int) -> "PathOccupancy":
        """Of no agents at so many steps."""
        nowhere, never = np.zeros((0, steps)), np.zeros((0, steps), dtype=np.bool_)
        return cls(nowhere, nowhere, nowhere, never, never)

    def rows(self, which: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> "PathOccupancy":
        """Some of the agents."""
        return PathOccupancy(
            self.low[which], self.high[which], self.along[which], self.same_direction[which], self.crossing[which]
        )

    def at(self, step: int) -> "PathOccupancy":
        """The same agents at one step, T = 1."""
        span = slice(step, step + 1)
        return PathOccupancy(
            self.low[:, span],
            self.high[:, span],
            self.along[:, span],
            self.same_direction[:, span],
            self.crossing[:, span],
        )

    def kept_clear(self, steps: int, *, margin_m: float) -> "PathOccupancy":
        """The same, with the place of who crosses taken so many steps before and after: PET is kept at crossings.

        margin_m: what is kept to a box that is there needs not be kept to one that was or will be: the place is
        smaller by so much on both sides then.
        """
        if not self.crossing.any():
            return self
        low, high, same_direction = crossings_kept_clear(
            self.low, self.high, self.same_direction, self.crossing, steps, margin_m
        )
        return PathOccupancy(
            low=low, high=high, along=self.along, same_direction=same_direction, crossing=self.crossing
        )

    def joined(self, *others: "PathOccupancy") -> "PathOccupancy":
        """Agents of all, self first."""
        every = [one for one in (self, *others) if one.low.shape[0]]
        if len(every) <= 1:
            return every[0] if every else self
        return PathOccupancy(
            low=np.concatenate([one.low for one in every]),
            high=np.concatenate([one.high for one in every]),
            along=np.concatenate([one.along for one in every]),
            same_direction=np.concatenate([one.same_direction for one in every]),
            crossing=np.concatenate([one.crossing for one in every]),
        )


def path_occupancy(
    line: ReferenceLine,
    traffic: Traffic,
    *,
    length_m: float,
    width_m: float,
    margin_lateral_m: float,
    clear_steps: int = 0,
    clear_margin_m: float = 0.0,
) -> PathOccupancy:
    """Intervals of every agent of `traffic` on `line` for a box of the given size. Only agents that ever touch it.

    clear_steps, clear_margin_m: as in `PathOccupancy.kept_clear`, unless 0. What is found is kept with the traffic, for
    what is joined to it, too: many vehicles look along the same few paths.
    """
    if not traffic.ids:
        return PathOccupancy.nobody(traffic.num_steps)
    key = line, length_m, width_m, margin_lateral_m, clear_steps, clear_margin_m
    if key not in traffic.known:
        before = traffic.extends
        while before is not None and key not in before.known:
            before = before.extends
        since = 0 if before is None else len(before.ids)
        _, new = look_along(line, traffic, length_m, width_m + 2 * margin_lateral_m, since)
        if clear_steps > 0:
            new = new.kept_clear(clear_steps, margin_m=clear_margin_m)
        traffic.known[key] = new if before is None else before.known[key].joined(new)
    found: PathOccupancy = traffic.known[key]
    return found


def look_along(
    line: ReferenceLine, traffic: Traffic, length_m: float, width_m: float, since: int = 0
) -> tuple[np.ndarray[tuple[int], np.dtype[np.int64]], PathOccupancy]:
    """Rows of the agents, from `since` on, that ever touch the line, and their intervals; width_m with all margins."""
    near, points = line.near(_NEAR_M)
    others = (
        traffic.position, traffic.heading, traffic.velocity, traffic.present, traffic.length_m, traffic.width_m,
    )  # fmt: skip
    rows, low, high, along, same_direction, crossing = intervals_on_path(
        points, line.table_heading, TABLE_STEP_M, *near, length_m, width_m, *others, since
    )
    return rows, PathOccupancy(low, high, along, same_direction, crossing)
