"""What the road asks along a path: speeds in turns, in bends and before both, and the policy on each lane."""

from dataclasses import dataclass

import numpy as np

from hid2.agents import FloatArray, IntArray, Policy
from hid2.drivers.driver import Driver
from hid2.motion.route import DrivenPath
from hid2.once import once
from hid2.policy.decision import policy_on
from hid2.policy.turns import RoadSpeeds, road_speeds
from hid2.scene import Scene

#: Policies by their numbers in arrays.
POLICIES = tuple(Policy)
STRAIGHT = POLICIES.index(Policy.STRAIGHT)


@dataclass(eq=False)
class Roads:
    """Speeds along the paths of a scene."""

    scene: Scene
    _last: tuple[DrivenPath, Driver, FloatArray] | None = None

    def speeds(self, path: DrivenPath, driver: Driver) -> FloatArray:
        """(S,) m/s at the table of a path's line: what a driver takes there at most; inf where nothing is asked."""
        if self._last is not None and self._last[0] is path and self._last[1] is driver:  # asked for twice at a site
            return self._last[2]
        most = self._of_any(path).desired(
            driver.desired_mps, lateral_accel_mps2=driver.turn_lateral_mps2, accel_mps2=driver.accel_mps2,
        )  # fmt: skip
        found = np.where(most < driver.desired_mps - 1e-6, most, np.inf)
        self._last = path, driver, found
        return found

    @once
    def _of_any(self, path: DrivenPath) -> RoadSpeeds:
        config, lanes = self.scene.config, self.scene.grid.graph.lanes
        segments = [(one.start, one.end, lanes[one.lane_id].turn) for one in path.segments]
        return road_speeds(path.line, segments, turn=config.turn, limits=config.limits)

    @once
    def lanes(self, path: DrivenPath) -> tuple[FloatArray, IntArray]:
        """Where the lanes of a path end, (L,) m, and numbers of what Algorithm 1 comes to on each without a request."""
        lanes = self.scene.grid.graph.lanes
        policies = [POLICIES.index(policy_on(lanes[segment.lane_id].turn)) for segment in path.segments]
        return np.array([segment.end for segment in path.segments]), np.array(policies, dtype=np.int64)
