"""Stop lines ahead of a vehicle: entrances that are red, and pedestrian crossings that are used."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import shapely

from hid2.agents import BoxSize, FloatArray, IntArray
from hid2.conflicts.signals import InferredSignals
from hid2.drivers.driver import Driver
from hid2.kernels.guard import ROLLS_UP_SHARE
from hid2.kernels.steering import CAUSES
from hid2.measures.encounters import CROSSING_RAD
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.motion.route import DrivenPath
from hid2.occupancy.traffic import BoolArray, Traffic
from hid2.once import once
from hid2.scene import Scene

# No tunables: where a driver stops.
_CROSSING_GAP_M = 0.5  # least gap from a standing vehicle's front to where pedestrians cross, m
_PASSED_M = 1.0  # distance past its place to stand at which a vehicle has passed the line, m
# No tunables from here to _DIRECTED_MPS: what crossing is.
_NEAR_M = 1.0  # distance to a crossing up to which an agent that comes towards it counts, m
_TOWARDS_MPS = 0.3  # least speed of an agent that comes towards a crossing, m/s
_AHEAD_S = 1.5  # time before an agent is on the crossing from which on it counts, s
_STRIP_M = 1.0  # width of a strip on each side of the swept width without agents as a vehicle passes, m
_STRIP_S = 3.0  # time within which no agent comes into the strip as a vehicle passes, s
#: Speed below which an agent has no direction, m/s; one along the path (CROSSING_RAD) does not cross.
_DIRECTED_MPS = 0.5
#: Recorded object types that use crossings.
CROSSING_TYPES = frozenset({"pedestrian", "cyclist", "riderless_bicycle"})


class CrossingOnPath(NamedTuple):
    """A crossing that a swept width touches from entry_m to exit_m, m; occupied (T,): see `PedestrianCrossings.on`."""

    entry_m: float
    exit_m: float
    occupied: BoolArray


@dataclass(frozen=True, eq=False)
class PedestrianCrossings:
    """The pedestrian crossings of a scene, (P, 4, 2) m, and the recorded agents of CROSSING_TYPES, which use them."""

    corners: FloatArray
    traffic: Traffic
    step_s: float

    @cached_property
    def _areas(self) -> shapely.STRtree:
        return shapely.STRtree(shapely.polygons(self.corners))

    @cached_property
    def _at(self) -> BoolArray:
        """(P, A, T) which agents are on a crossing, or will be within _AHEAD_S, or are near and move towards it."""
        traffic = self.traffic
        agent, step = np.nonzero(traffic.present)
        near = self._near(traffic.position[agent, step], _NEAR_M)
        agent, step = agent[near], step[near]
        points = shapely.points(traffic.position[agent, step])
        row, crossing = self._areas.query(points, predicate="dwithin", distance=_NEAR_M)
        agent, step, ways = agent[row], step[row], shapely.shortest_line(points[row], self._areas.geometries[crossing])
        way = np.diff(shapely.get_coordinates(ways).reshape(-1, 2, 2), axis=1)[:, 0]
        distance_m, closing = np.hypot(*way.T), (traffic.velocity[agent, step] * way).sum(axis=1)
        on, comes = np.zeros((2, len(self.corners), *traffic.present.shape), dtype=np.bool_)
        for found, which in ((on, distance_m == 0.0), (comes, closing > _TOWARDS_MPS * distance_m)):
            found[crossing[which], agent[which], step[which]] = True
        soon = on.copy()
        for ahead in range(1, round(_AHEAD_S / self.step_s) + 1):
            soon[..., :-ahead] |= on[..., ahead:]
        return np.asarray(soon & traffic.present | comes)

    def used(self) -> "PedestrianCrossings":
        """Those alone that an agent uses: the others close no line."""
        return replace(self, corners=self.corners[self._at.any(axis=(1, 2))])

    def _near(self, xy: FloatArray, reach_m: float) -> IntArray:
        """Which of the places (N, 2) m can be so near to a crossing."""
        low, high, at = self.corners.min(axis=1) - reach_m, self.corners.max(axis=1) + reach_m, xy[:, None]
        along_x, along_y = ((low[:, one] <= at[..., one]) & (at[..., one] <= high[:, one]) for one in (0, 1))
        return np.flatnonzero((along_x & along_y).any(axis=1))

    @once
    def _users(self, crossing: int) -> tuple[BoolArray, Traffic]:
        """When agents use a crossing (R, T), as `_at` has it, and these agents alone."""
        rows = np.flatnonzero(self._at[crossing].any(axis=1))
        return self._at[crossing, rows], self.traffic.rows(rows.tolist())

    @once
    def on(self, path: DrivenPath, width_m: float) -> list[CrossingOnPath]:
        """Crossings along a path in the order in which a vehicle of a width comes to them.

        Occupied: an agent is on the crossing, or will be within _AHEAD_S by its recorded future, or is within _NEAR_M
        of it and moves towards it; and is within _STRIP_M of the swept width within _STRIP_S. No vehicle waits for
        agents that have passed, nor for those that move along the path, as cyclists on the road do.
        """
        line = path.line
        count = min(int(path.exit_m / TABLE_STEP_M) + 1, len(line.table_xy))
        xy, heading = line.table_xy[:count], line.table_heading[:count]
        left = width_m / 2 * np.stack([-np.sin(heading), np.cos(heading)], axis=1)
        near = self._near(xy, width_m)
        if not near.size:
            return []
        across = shapely.linestrings(np.stack([xy[near] - left[near], xy[near] + left[near]], axis=1))
        point, crossed = self._areas.query(across, predicate="intersects")
        point, found = near[point], []
        for crossing in np.unique(crossed).tolist():
            touched = np.sort(point[crossed == crossing])
            for run in np.split(touched, np.flatnonzero(np.diff(touched) > 1) + 1):
                first, last = int(run[0]), int(run[-1])
                middle = (first + last) // 2
                occupied = self._occupied(crossing, xy[middle], heading[middle], width_m / 2 + _STRIP_M)
                found.append(CrossingOnPath(first * TABLE_STEP_M, last * TABLE_STEP_M, occupied))
        return sorted(found, key=lambda one: one.entry_m)

    def _occupied(self, crossing: int, xy: FloatArray, heading: float, aside_m: float) -> BoolArray:
        """(T,) as `on` has it, where the path's middle is at xy (2,) m; aside_m: half of the width and the strip."""
        used, users = self._users(crossing)
        forward, left = np.array([[math.cos(heading), math.sin(heading)], [-math.sin(heading), math.cos(heading)]])
        on_strip = users.present & (np.abs((users.position - xy) @ left) <= aside_m)
        steps, speed = np.arange(users.num_steps), users.speed
        comes = np.minimum.accumulate(np.where(on_strip, steps, np.inf)[:, ::-1], axis=1)[:, ::-1]
        passes = (speed > _DIRECTED_MPS) & (np.abs(users.velocity @ forward) > math.cos(CROSSING_RAD) * speed)
        return np.asarray((used & (comes - steps <= round(_STRIP_S / self.step_s)) & ~passes).any(axis=0))


@dataclass(frozen=True, eq=False, slots=True)
class ClosedLines:
    """The lines along a path that are closed at some step, in the order in which a vehicle comes to them.

    line_m (L,) m: where its centre is with its front at the line; end_m (L,) m: of what the line is before; closed
    (L, T); cause (L,): numbers of CAUSES.
    """

    line_m: FloatArray
    end_m: FloatArray
    closed: BoolArray
    cause: IntArray

    def stops_m(self, driver: Driver) -> FloatArray:
        """(L,) m: where the centre of a driver's vehicle stands."""
        if driver.line_gap_m >= _CROSSING_GAP_M:
            return self.line_m - driver.line_gap_m
        return self.line_m - np.where(self.cause == CAUSES.index("crossing"), _CROSSING_GAP_M, driver.line_gap_m)

    def gap_m(self, s: float, step: int) -> float:
        """From the front of a vehicle on the path to the nearest closed line, m, negative past it; inf for none."""
        gap_m = (self.line_m - s)[self.closed[:, step]]
        return float(gap_m[np.abs(gap_m).argmin()]) if gap_m.size else math.inf

    def room_m(self, s: float, step: int, driver: Driver) -> float:
        """From a place on the path to where a driver stands before the next closed line, m, inf for none.

        -1 past a closed line, on what that is before: a vehicle there came on red.
        """
        ahead_m, closed = self.stops_m(driver) - s, self.closed[:, step]
        if (closed & (ahead_m < 0.0) & (s < self.end_m)).any():
            return -1.0
        return float(ahead_m[closed & (ahead_m >= 0.0)].min(initial=math.inf))

    def towards_mps(self, driver: Driver, room_m: float) -> float:
        """Fastest speed, m/s, from which a driver brakes as usual to stand at a line."""
        return math.sqrt(2.0 * ROLLS_UP_SHARE * driver.decel_mps2 * room_m)

    def is_passed(self, s: FloatArray, driver: Driver, *, first: int, closed_steps: int) -> bool:
        """Whether a driver's motion (K,) m from a step on passes a line that has been closed for so many steps."""
        for closed, at in zip(self.closed, np.searchsorted(s, self.stops_m(driver) + _PASSED_M).tolist(), strict=True):
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
        scene, kinds = self.scene, self.scene.states.arrays.object_types
        walking = scene.traffic.rows([row for row, kind in enumerate(kinds) if kind in CROSSING_TYPES])
        corners = np.array(scene.grid.graph.pedestrian_crossings, dtype=np.float64).reshape(-1, 4, 2)
        return PedestrianCrossings(corners, walking, scene.step_s).used()

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
            (crossing.entry_m - before, crossing.exit_m, crossing.occupied, "crossing")
            for crossing in self._crossings.on(path, box.width_m)
            if crossing.occupied.any()
        ]
        found.sort(key=lambda line: line[0])
        return ClosedLines(
            np.array([line_m for line_m, _, _, _ in found], dtype=np.float64),
            np.array([end_m for _, end_m, _, _ in found], dtype=np.float64),
            np.array([closed for _, _, closed, _ in found], dtype=np.bool_).reshape(-1, self.scene.num_steps),
            np.array([CAUSES.index(cause) for _, _, _, cause in found], dtype=np.int64),
        )
