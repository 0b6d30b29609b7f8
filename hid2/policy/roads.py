"""What the road asks of a driver's speed along a path: turns, bends, and slowing in time before both."""

from dataclasses import dataclass, field

import numpy as np

from hid2.agents import FloatArray
from hid2.drivers.driver import Driver
from hid2.motion.route import DrivenPath, turn_segments
from hid2.policy.turns import RoadSpeeds, road_speeds
from hid2.scene import Scene


@dataclass(eq=False, slots=True)
class Roads:
    """Speeds along the paths of a scene; each path is worked out once."""

    scene: Scene
    _known: dict[DrivenPath, RoadSpeeds] = field(default_factory=dict)
    _last: tuple[DrivenPath, Driver, FloatArray] | None = None

    def speeds(self, path: DrivenPath, driver: Driver) -> FloatArray:
        """(S,) m/s at the table of a path's line: what a driver takes there at most; inf where nothing is asked."""
        if self._last is not None and self._last[0] is path and self._last[1] is driver:  # asked for twice at a site
            return self._last[2]
        config = self.scene.config
        if path not in self._known:
            segments = turn_segments(self.scene.grid.graph, path)
            self._known[path] = road_speeds(path.line, segments, turn=config.turn, limits=config.limits)
        most = self._known[path].desired(
            driver.desired_mps, lateral_accel_mps2=driver.turn_lateral_mps2, accel_mps2=driver.accel_mps2,
            approach_decel_mps2=config.turn.approach_decel_mps2,
        )  # fmt: skip
        found = np.where(most < driver.desired_mps - 1e-6, most, np.inf)
        self._last = path, driver, found
        return found
