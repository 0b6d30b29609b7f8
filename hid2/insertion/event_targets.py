"""Targets of events: recorded vehicles with the lanes that they drive, and the lanes that they cross."""

import math
from dataclasses import dataclass

import numpy as np

from hid2.agents import FloatArray, Track
from hid2.insertion.meetings import moving_vehicles, named_rows
from hid2.insertion.routes import Routes
from hid2.measures.driven_lanes import LaneView, Run, runs_of
from hid2.measures.encounters import CROSSING_RAD
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.motion.route import DrivenPath
from hid2.occupancy.traffic import BoolArray
from hid2.scene import Scene

#: A target is beside a path up to this distance, m, and this cosine of the angle to it; a path that it crosses comes
#: this near to its positions, m. No tunables: a lane and a half, 37 degrees, more than a car drives in a step.
_BESIDE_M, _ALONG, _NEAR_M = 6.0, 0.8, 3.0


@dataclass(frozen=True, eq=False, slots=True)
class Target:
    """A recorded vehicle that an event is about: its track, lanes in the order driven, and way driven (T,) m.

    row: of the scene's traffic; present (T,); position (T, 2) m, heading (T,) rad and speed (T,) m/s as dense arrays,
    steps step_s apart; runs: lane ids with first and last step.
    """

    track: Track
    row: int
    present: BoolArray
    position: FloatArray
    heading: FloatArray
    speed: FloatArray
    way: FloatArray
    runs: tuple[tuple[int, int, int], ...]
    step_s: float

    def lane_at(self, step: int) -> int | None:
        """Lane id at a step, None off every lane."""
        return next((lane for lane, first, last in self.runs if first <= step <= last), None)

    def lanes_from(self, step: int) -> tuple[int, ...]:
        """Lane ids driven from a step on."""
        return tuple(lane for lane, _, last in self.runs if last >= step)

    def lanes_before(self, step: int) -> tuple[int, ...]:
        """Lane ids driven before a step, the last one first."""
        return tuple(lane for lane, _, last in reversed(self.runs) if last < step)

    def along(self, path: DrivenPath, at: int) -> FloatArray | None:
        """(T,) m, where it is along a path by the way it drives; None where it is not beside that path at a step."""
        offset = path.line.table_xy - self.position[at]
        cell = int(np.argmin(np.square(offset).sum(axis=1)))
        heading = float(path.line.table_heading[cell])
        forward = math.cos(heading), math.sin(heading)
        aside = abs(-offset[cell, 0] * forward[1] + offset[cell, 1] * forward[0])
        if aside > _BESIDE_M or math.cos(heading - float(self.heading[at])) < _ALONG:
            return None
        along = -float(offset[cell] @ np.array(forward))
        return np.asarray(cell * TABLE_STEP_M + along + self.way - self.way[at])

    def crossed_lanes(self, routes: Routes) -> list[tuple[int, float, int]]:
        """Lanes that it crosses: lane id, arc length there, m, and the step at which it does."""
        steps = np.flatnonzero(self.present)
        xy = self.position[steps]
        found: list[tuple[int, float, int]] = []
        own = {lane for lane, _, _ in self.runs}
        for lane_id in (n for n in routes.lanes if n not in own):
            path = routes.scene.grid.graph.lanes[lane_id].path
            s, d = path.frenet(xy)
            inside = (s[1:] > 0.0) & (s[1:] < path.length_m) & (d[1:] * d[:-1] < 0.0) & (np.abs(d[1:]) < _NEAR_M)
            for row in np.flatnonzero(inside).tolist():
                lane_heading = float(path.heading(s[row + 1 : row + 2])[0])
                angle = abs(math.sin(lane_heading - float(self.heading[steps[row + 1]])))
                if angle > math.sin(CROSSING_RAD):
                    found.append((lane_id, float(s[row + 1]), int(steps[row + 1])))
                    break
        return found


def candidate_rows(scene: Scene, name: str) -> list[int]:
    """Rows of `scene.traffic` that an event may have as its target, by the name asked for: moving vehicles."""
    moving = moving_vehicles(scene).tolist()
    return moving if name == "any" else [row for row in named_rows(scene, name).tolist() if row in moving]


def target_of(scene: Scene, row: int) -> Target | None:
    """A recorded vehicle as a target; None where it is never on a lane. row: of `scene.traffic`."""
    traffic, alone = scene.traffic, scene.states.rows([row])
    if not alone.arrays.vehicle[0]:
        return None
    arrays, lanes = alone.arrays, alone.lanes
    runs: list[Run] = [run for run in runs_of(LaneView(arrays, lanes, alone.matches), 0) if run.lane >= 0]
    if not runs:
        return None
    step = np.hypot(*np.diff(traffic.position[row], axis=0).T)
    step[~(traffic.present[row, 1:] & traffic.present[row, :-1])] = 0.0
    return Target(
        track=scene.tracks[row], row=row, present=traffic.present[row], position=traffic.position[row],
        heading=traffic.heading[row], speed=np.hypot(*traffic.velocity[row].T),
        way=np.concatenate([[0.0], np.cumsum(step)]),
        runs=tuple(
            (int(lanes.lane_ids[run.lane]), int(arrays.step[run.first]), int(arrays.step[run.last])) for run in runs
        ),
        step_s=scene.step_s,
    )  # fmt: skip
