"""What the road asks along a path: speeds in turns, in bends and before both, and the policy on each lane."""

from dataclasses import dataclass, field

import numpy as np

from hid2.agents import FloatArray, IntArray, Policy
from hid2.drivers.driver import Driver
from hid2.motion.route import DrivenPath, turn_segments
from hid2.policy.decision import policy_on
from hid2.policy.turns import RoadSpeeds, road_speeds
from hid2.scene import Scene

#: Policies by their numbers in arrays.
POLICIES = tuple(Policy)
STRAIGHT = POLICIES.index(Policy.STRAIGHT)


@dataclass(eq=False, slots=True)
class Roads:
    """Speeds along the paths of a scene; each path is worked out once."""

    scene: Scene
    _known: dict[DrivenPath, RoadSpeeds] = field(default_factory=dict)
    _lanes: dict[DrivenPath, tuple[FloatArray, IntArray]] = field(default_factory=dict)
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
        )  # fmt: skip
        found = np.where(most < driver.desired_mps - 1e-6, most, np.inf)
        self._last = path, driver, found
        return found

    def lanes(self, path: DrivenPath) -> tuple[FloatArray, IntArray]:
        """Where the lanes of a path end, (L,) m, and numbers of what Algorithm 1 comes to on each without a request."""
        if path not in self._lanes:
            lanes = self.scene.grid.graph.lanes
            policies = [POLICIES.index(policy_on(lanes[segment.lane_id].turn)) for segment in path.segments]
            ends = np.array([segment.end for segment in path.segments])
            self._lanes[path] = ends, np.array(policies, dtype=np.int64)
        return self._lanes[path]
