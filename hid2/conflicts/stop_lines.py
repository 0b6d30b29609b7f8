"""Stop lines ahead of a vehicle: entrances that are red, and pedestrian crossings that are used."""

import math
from dataclasses import dataclass, field

import numpy as np

from hid2.agents import BoxSize, FloatArray, IntArray
from hid2.conflicts.crossings import CROSSING_TYPES, PedestrianCrossings
from hid2.conflicts.signals import InferredSignals
from hid2.drivers.driver import Driver
from hid2.kernels.guard import stop_ahead
from hid2.kernels.steering import CAUSES
from hid2.motion.route import DrivenPath
from hid2.occupancy.traffic import BoolArray
from hid2.scene import Scene

#: No tunables, how a driver stops: kept to a line, m; closed lines farther ahead matter to none yet, m; share of its
#: deceleration with which it rolls up, s in which it takes up the speed for that, and over its deceleration the braking
#: beyond which it crosses, as at amber.
STOP_MARGIN_M, _STOPS = 1.0, (60.0, 0.6, 0.5, 1.3)
#: No tunable: s for which a light is amber about, in which one passes that can no longer stop.
AMBER_S = 1.5


@dataclass(frozen=True, eq=False, slots=True)
class StopLine:
    """Where a vehicle's centre has to stand at the latest, m on its path, at the steps (T,) at which it is closed.

    end_s: of what it is before, m.
    """

    stop_s: float
    end_s: float
    closed: BoolArray
    cause: str


@dataclass(frozen=True, eq=False, slots=True)
class ClosedLines:
    """The stop lines of one path, in their order: where (L,) m, whether they are closed (L, T), and why.

    end_s (L,): as in `StopLine`.
    cause (L,): numbers of those; stops: how drivers stop at them, as in the kernel `stop_ahead`.
    """

    stop_s: FloatArray
    end_s: FloatArray
    closed: BoolArray
    causes: tuple[str, ...]
    cause: IntArray
    stops: tuple[float, float, float, float]

    def braking(self, driver: Driver, *, s: float, speed_mps: float, step: int) -> tuple[float, str] | None:
        """Acceleration, m/s2, that stops a driver at the next closed line, and its cause; None for none."""
        if not self.causes:
            return None
        row, accel = stop_ahead(
            self.stop_s, self.closed, s, speed_mps, step, driver.accel_mps2, driver.decel_mps2, self.stops
        )
        return None if row < 0 else (float(accel), self.causes[row])

    def room_m(self, s: float, step: int) -> float:
        """From a place on the path to the next closed line, m, inf for none.

        Negative past a closed line, on what that is before: a vehicle there came on red.
        """
        ahead_m, closed = self.stop_s - s, self.closed[:, step]
        if (closed & (ahead_m < 0.0) & (s < self.end_s)).any():
            return -1.0
        return float(ahead_m[closed & (ahead_m >= 0.0)].min(initial=math.inf))

    def towards_mps(self, driver: Driver, room_m: float) -> float:
        """Fastest speed, m/s, from which a driver brakes as usual to stand at a line."""
        return math.sqrt(2.0 * self.stops[1] * driver.decel_mps2 * room_m)

    def is_passed(self, s: FloatArray, *, first: int, closed_steps: int) -> bool:
        """Whether a motion (K,) m from a step on has its front pass a line that has been closed for so many steps."""
        for closed, at in zip(self.closed, np.searchsorted(s, self.stop_s + STOP_MARGIN_M).tolist(), strict=True):
            if 0 < at < s.size and closed[max(0, first + at - closed_steps) : first + at + 1].all():
                return True
        return False


@dataclass(eq=False, slots=True)
class StopLines:
    """The stop lines of a scene's paths, each path worked out once."""

    scene: Scene
    signals: InferredSignals = field(init=False)
    _crossings: PedestrianCrossings = field(init=False)
    _known: dict[tuple[DrivenPath, BoxSize], list[StopLine]] = field(default_factory=dict)
    _arrays: dict[tuple[DrivenPath, BoxSize], ClosedLines] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Signals and crossings of the recorded traffic."""
        scene = self.scene
        self.signals = InferredSignals(scene.grid.graph, scene.states, scene.config.signals)
        walking = scene.traffic.rows([row for row, kind in enumerate(scene.object_types) if kind in CROSSING_TYPES])
        self._crossings = PedestrianCrossings(scene.grid.graph.pedestrian_crossings, walking, scene.step_s)

    def on(self, path: DrivenPath, box: BoxSize) -> list[StopLine]:
        """Lines along a path that are closed at some step, in the order in which a vehicle comes to them."""
        key = path, box
        if key not in self._known:
            before = box.length_m / 2 + STOP_MARGIN_M
            found = []
            for segment in path.segments:
                red = self.signals.red(segment.lane_id) if segment.lane_start < 1.0 else None
                if red is not None and red.any():
                    found.append(StopLine(segment.start - before, segment.end, red, "signal"))
            found.extend(
                StopLine(crossing.entry_s - before, crossing.exit_s, crossing.occupied, "crossing")
                for crossing in self._crossings.on(path, width_m=box.width_m)
                if crossing.occupied.any()
            )
            self._known[key] = sorted(found, key=lambda line: line.stop_s)
        return self._known[key]

    def arrays(self, path: DrivenPath, box: BoxSize) -> ClosedLines:
        """The same as arrays."""
        key = path, box
        if key not in self._arrays:
            lines = self.on(path, box)
            closed = np.zeros((len(lines), self.scene.num_steps), dtype=np.bool_)
            for row, line in enumerate(lines):
                closed[row] = line.closed
            stop_s = np.array([line.stop_s for line in lines], dtype=np.float64)
            cause = np.array([CAUSES.index(line.cause) for line in lines], dtype=np.int64)
            end_s = np.array([line.end_s for line in lines], dtype=np.float64)
            causes = tuple(line.cause for line in lines)
            self._arrays[key] = ClosedLines(stop_s, end_s, closed, causes, cause, self.stops)
        return self._arrays[key]

    @property
    def stops(self) -> tuple[float, float, float, float]:
        """How drivers stop at them, as in the kernel `stop_ahead`."""
        return _STOPS
