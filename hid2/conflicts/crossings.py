"""Pedestrian crossings on a path, and when an agent on or at them has to be yielded to."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from hid2.agents import FloatArray
from hid2.kernels.crossings import at_crossings, crossings_swept
from hid2.measures.encounters import CROSSING_RAD
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.motion.route import DrivenPath
from hid2.occupancy.traffic import BoolArray, Traffic
from hid2.once import once

# No tunables, here and below: when an agent walks over a crossing. It counts so near to it, m, if it comes towards it
# this fast, m/s, or is on it within so long, s.
_NEAR_M, _TOWARDS_MPS, _AHEAD_S = 1.0, 0.3, 1.5
#: No agent may be within the strip to each side of the swept width, m, within so long, s, while a vehicle passes; one
#: that moves along the path within CROSSING_RAD does not cross it, and slower ones have no direction, m/s.
_STRIP_M, _STRIP_S, _DIRECTED_MPS = 1.0, 3.0, 0.5
#: Recorded object types that use crossings.
CROSSING_TYPES = frozenset({"pedestrian", "cyclist", "riderless_bicycle"})


class CrossingOnPath(NamedTuple):
    """A crossing that a path's swept width touches from entry_s to exit_s, m of the path.

    occupied (T,): an agent is on it or about to be, and on the vehicle's way.
    """

    entry_s: float
    exit_s: float
    occupied: BoolArray


@dataclass(frozen=True, eq=False)
class PedestrianCrossings:
    """The pedestrian crossings of a scene and which agents use them when.

    polygons: (4, 2) m each, `LaneGraph.pedestrian_crossings`; traffic: the recorded agents of CROSSING_TYPES alone;
    step_s: seconds from one step to the next.
    """

    polygons: Sequence[FloatArray]
    traffic: Traffic
    step_s: float

    @cached_property
    def _corners(self) -> FloatArray:
        return np.array(self.polygons, dtype=np.float64).reshape(-1, 4, 2)

    @cached_property
    def _at(self) -> BoolArray:
        traffic = self.traffic
        return at_crossings(
            self._corners, traffic.position, traffic.velocity, traffic.present,
            _NEAR_M, _TOWARDS_MPS, round(_AHEAD_S / self.step_s),
        )  # fmt: skip

    @once
    def on(self, path: DrivenPath, width_m: float) -> list[CrossingOnPath]:
        """Crossings along a path in the order in which a vehicle of a width comes to them.

        Occupied: an agent is on the crossing, or will be within _AHEAD_S by its recorded future, or is within _NEAR_M
        of it and moves towards it; and is within _STRIP_M of the swept width within _STRIP_S. No vehicle waits for
        agents that have passed, nor for those that move along the path, as cyclists on the road do.
        """
        line = path.line
        count = min(int(path.exit_s / TABLE_STEP_M) + 1, len(line.table_xy))
        xy, heading = line.table_xy[:count], line.table_heading[:count]
        found = []
        for crossing, first, last in crossings_swept(self._corners, xy, heading, width_m / 2).tolist():
            middle = (first + last) // 2
            occupied = self._occupied(crossing, xy[middle], heading[middle], width_m / 2 + _STRIP_M)
            found.append(CrossingOnPath(first * TABLE_STEP_M, last * TABLE_STEP_M, occupied))
        return sorted(found, key=lambda one: one.entry_s)

    def _occupied(self, crossing: int, xy: FloatArray, heading: float, aside_m: float) -> BoolArray:
        """(T,) as `on` has it, where the path's middle is at xy (2,) m; aside_m: half of the width and the strip."""
        rows = np.flatnonzero(self._at[crossing].any(axis=1))
        position, velocity = self.traffic.position[rows], self.traffic.velocity[rows]
        forward, left = np.array([[math.cos(heading), math.sin(heading)], [-math.sin(heading), math.cos(heading)]])
        on_strip = self.traffic.present[rows] & (np.abs((position - xy) @ left) <= aside_m)
        steps = np.arange(on_strip.shape[1])
        comes = np.minimum.accumulate(np.where(on_strip, steps, np.inf)[:, ::-1], axis=1)[:, ::-1]
        speed = np.hypot(velocity[..., 0], velocity[..., 1])
        passes = (speed > _DIRECTED_MPS) & (np.abs(velocity @ forward) > math.cos(CROSSING_RAD) * speed)
        soon = comes - steps <= round(_STRIP_S / self.step_s)
        return np.asarray((self._at[crossing, rows] & soon & ~passes).any(axis=0))
