"""Stop lines ahead of a vehicle: entrances that are red, and pedestrian crossings that are used."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hid2.agents import BoxSize, FloatArray, IntArray
from hid2.conflicts.crossings import CROSSING_TYPES, PedestrianCrossings
from hid2.conflicts.signals import InferredSignals
from hid2.drivers.driver import Driver
from hid2.kernels.steering import CAUSES
from hid2.motion.route import DrivenPath
from hid2.occupancy.traffic import BoolArray
from hid2.once import once
from hid2.scene import Scene

#: No tunables, how a driver stops: closed lines farther ahead matter to none yet, m; share of its deceleration with
#: which it rolls up, s in which it takes up the speed for that, and over its deceleration the braking beyond which it
#: crosses, as at amber. So far, m, it keeps at least to where pedestrians cross, and so far past where it would stand
#: it has passed the line.
STOPS, _CROSSING_GAP_M, _PASSED_M = (60.0, 0.6, 0.5, 1.3), 0.5, 1.0
#: No tunable: s for which a light is amber about, in which one passes that can no longer stop.
AMBER_S = 1.5


@dataclass(frozen=True, eq=False, slots=True)
class ClosedLines:
    """The lines along a path that are closed at some step, in the order in which a vehicle comes to them.

    line_s (L,) m: where its centre is with its front at the line; end_s (L,) m: of what the line is before; closed
    (L, T); cause (L,): numbers of CAUSES.
    """

    line_s: FloatArray
    end_s: FloatArray
    closed: BoolArray
    cause: IntArray

    def stops_s(self, driver: Driver) -> FloatArray:
        """(L,) m: where the centre of a driver's vehicle stands."""
        if not self.line_s.size:
            return self.line_s
        at_crossing_m = max(driver.line_gap_m, _CROSSING_GAP_M)
        return self.line_s - np.where(self.cause == CAUSES.index("crossing"), at_crossing_m, driver.line_gap_m)

    def gap_m(self, s: float, step: int) -> float:
        """From the front of a vehicle on the path to the nearest closed line, m, negative past it; inf for none."""
        gap_m = (self.line_s - s)[self.closed[:, step]]
        return float(gap_m[np.abs(gap_m).argmin()]) if gap_m.size else math.inf

    def room_m(self, s: float, step: int, driver: Driver) -> float:
        """From a place on the path to where a driver stands before the next closed line, m, inf for none.

        Negative past a closed line, on what that is before: a vehicle there came on red.
        """
        ahead_m, closed = self.stops_s(driver) - s, self.closed[:, step]
        if (closed & (ahead_m < 0.0) & (s < self.end_s)).any():
            return -1.0
        return float(ahead_m[closed & (ahead_m >= 0.0)].min(initial=math.inf))

    def towards_mps(self, driver: Driver, room_m: float) -> float:
        """Fastest speed, m/s, from which a driver brakes as usual to stand at a line."""
        return math.sqrt(2.0 * STOPS[1] * driver.decel_mps2 * room_m)

    def is_passed(self, s: FloatArray, driver: Driver, *, first: int, closed_steps: int) -> bool:
        """Whether a driver's motion (K,) m from a step on passes a line that has been closed for so many steps."""
        for closed, at in zip(self.closed, np.searchsorted(s, self.stops_s(driver) + _PASSED_M).tolist(), strict=True):
            if 0 < at < s.size and closed[max(0, first + at - closed_steps) : first + at + 1].all():
                return True
        return False


@dataclass(frozen=True, eq=False)
class StopLines:
    """The stop lines of a scene's paths."""

    scene: Scene

    @cached_property
    def signals(self) -> InferredSignals:
        """Signals by the recorded traffic."""
        return InferredSignals(self.scene.grid.graph, self.scene.states, self.scene.config.signals)

    @cached_property
    def _crossings(self) -> PedestrianCrossings:
        scene = self.scene
        kinds = scene.states.arrays.object_types
        walking = scene.traffic.rows([row for row, kind in enumerate(kinds) if kind in CROSSING_TYPES])
        return PedestrianCrossings(scene.grid.graph.pedestrian_crossings, walking, scene.step_s)

    @once
    def on(self, path: DrivenPath, box: BoxSize) -> ClosedLines:
        """Lines along a path for a vehicle of a size."""
        before = box.length_m / 2
        found: list[tuple[float, float, BoolArray, str]] = []
        for segment in path.segments:
            red = self.signals.red(segment.lane_id) if segment.lane_start < 1.0 else None
            if red is not None and red.any():
                found.append((segment.start - before, segment.end, red, "signal"))
        found += [
            (crossing.entry_s - before, crossing.exit_s, crossing.occupied, "crossing")
            for crossing in self._crossings.on(path, box.width_m)
            if crossing.occupied.any()
        ]
        found.sort(key=lambda line: line[0])
        return ClosedLines(
            np.array([line_s for line_s, _, _, _ in found], dtype=np.float64),
            np.array([end_s for _, end_s, _, _ in found], dtype=np.float64),
            np.array([closed for _, _, closed, _ in found], dtype=np.bool_).reshape(-1, self.scene.num_steps),
            np.array([CAUSES.index(cause) for _, _, _, cause in found], dtype=np.int64),
        )
