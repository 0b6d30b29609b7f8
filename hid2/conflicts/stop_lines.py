"""Stop lines ahead of a vehicle: entrances that are red, and pedestrian crossings that are used."""

import math
from dataclasses import dataclass, field

from hid2.agents import BoxSize
from hid2.conflicts.crossings import PedestrianCrossings, crossing_rows
from hid2.conflicts.signals import InferredSignals, signalled_rows
from hid2.drivers.driver import Driver
from hid2.motion.route import DrivenPath
from hid2.occupancy.traffic import BoolArray
from hid2.scene import DT_S, Scene

#: Lines farther ahead than this are no business of a driver yet, m.
_AHEAD_M = 60.0
#: Whoever has passed a line by this has passed it, m.
_PASSED_M = 0.3


@dataclass(frozen=True, eq=False, slots=True)
class StopLine:
    """Where a vehicle's centre has to stand at the latest, m on its path, at the steps (T,) at which it is closed."""

    stop_s: float
    closed: BoolArray
    cause: str


@dataclass(eq=False, slots=True)
class StopLines:
    """The stop lines of a scene's paths, each path worked out once."""

    scene: Scene
    _signals: InferredSignals = field(init=False)
    _crossings: PedestrianCrossings = field(init=False)
    _known: dict[tuple[DrivenPath, BoxSize], list[StopLine]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Signals and crossings of the recorded traffic."""
        scene, config = self.scene, self.scene.config
        signalled = scene.traffic.rows(signalled_rows(scene.object_types).tolist())
        walking = scene.traffic.rows(crossing_rows(scene.object_types).tolist())
        self._signals = InferredSignals(scene.grid, signalled, config.signals, DT_S)
        self._crossings = PedestrianCrossings(scene.grid.graph.pedestrian_crossings, walking, config.crossings, DT_S)

    def on(self, path: DrivenPath, box: BoxSize) -> list[StopLine]:
        """Lines along a path that are closed at some step, in the order in which a vehicle comes to them."""
        key = path, box
        if key not in self._known:
            before = box.length_m / 2 + self.scene.config.conflict.stop_margin_m
            found = []
            for segment in path.segments:
                red = self._signals.red(segment.lane_id) if segment.lane_start < 1.0 else None
                if red is not None and red.any():
                    found.append(StopLine(segment.start - before, red, "signal"))
            found.extend(
                StopLine(crossing.entry_s - before, crossing.occupied, "crossing")
                for crossing in self._crossings.on(path, width_m=box.width_m)
                if crossing.occupied.any()
            )
            self._known[key] = sorted(found, key=lambda line: line.stop_s)
        return self._known[key]

    def braking(
        self, path: DrivenPath, box: BoxSize, driver: Driver, *, s: float, speed_mps: float, step: int
    ) -> tuple[float, str] | None:
        """Acceleration, m/s2, at which a driver comes to stand at the next closed line, and its cause; None for none.

        A line at which the driver can no longer stop without braking hard is driven across, as an amber light is.
        """
        hardest = 1.3 * driver.decel_mps2
        for line in self.on(path, box):
            ahead = line.stop_s - s
            if ahead < -_PASSED_M or not line.closed[min(step, line.closed.size - 1)]:
                continue
            if ahead > _AHEAD_M:
                return None
            if speed_mps * speed_mps > 2.0 * hardest * max(ahead, 0.05) and speed_mps > 1.0:
                continue
            return accel_towards_stop(ahead, speed_mps, driver), line.cause
        return None


def accel_towards_stop(ahead_m: float, speed_mps: float, driver: Driver) -> float:
    """Acceleration of a driver who comes to stand ahead_m from here, m/s2: constant braking as it is needed.

    Kinematic rather than IDM: a driver lets the car roll up to a line, and does not begin far before it.
    """
    if ahead_m <= 0.1:
        return -driver.decel_mps2
    needed = speed_mps * speed_mps / (2.0 * ahead_m)
    comfortable = 0.6 * driver.decel_mps2
    if needed < comfortable:
        reach = math.sqrt(2.0 * comfortable * ahead_m)  # the speed from which comfortable braking ends at the line
        return min(driver.accel_mps2, (reach - speed_mps) / 0.5)
    return -needed
