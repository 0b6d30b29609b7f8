"""Targets of events: recorded vehicles with the lanes that they drive."""

from dataclasses import dataclass

import numpy as np

from hid2.agents import FloatArray, Track
from hid2.insertion.meetings import moving_vehicles, named_rows
from hid2.measures.driven_lanes import runs_of
from hid2.occupancy.traffic import BoolArray
from hid2.scene import Scene


@dataclass(frozen=True, eq=False, slots=True)
class Target:
    """A recorded vehicle that an event is about: its track, lanes in the order driven, and way driven (T,) m.

    present (T,); position (T, 2) m, heading (T,) rad and speed (T,) m/s, by the positions, as dense arrays;
    runs: lane ids with first and last step.
    """

    track: Track
    present: BoolArray
    position: FloatArray
    heading: FloatArray
    speed: FloatArray
    way: FloatArray
    runs: tuple[tuple[int, int, int], ...]

    def lane_at(self, step: int) -> int | None:
        """Lane id at a step, None off every lane."""
        return next((lane for lane, first, last in self.runs if first <= step <= last), None)

    def lanes_from(self, step: int) -> tuple[int, ...]:
        """Lane ids driven from a step on."""
        return tuple(lane for lane, _, last in self.runs if last >= step)

    def lanes_before(self, step: int) -> tuple[int, ...]:
        """Lane ids driven before a step, the last one first."""
        return tuple(lane for lane, _, last in reversed(self.runs) if last < step)


def candidate_rows(scene: Scene, name: str) -> list[int]:
    """Rows of `scene.traffic` that an event may have as its target, by the name asked for: moving vehicles."""
    moving = moving_vehicles(scene).tolist()
    return moving if name == "any" else [row for row in named_rows(scene, name).tolist() if row in moving]


def target_of(scene: Scene, row: int) -> Target | None:
    """A recorded vehicle as a target; None where it is never on a lane, or its box points against its motion.

    Of such a box, which a tracker has turned round, it is not told what is ahead. row: of `scene.traffic`.
    """
    traffic, alone = scene.traffic, scene.states.rows([row])
    if not alone.arrays.vehicle[0]:
        return None
    arrays, lanes = alone.arrays, alone.lanes
    runs = [run for run in runs_of(alone, 0) if run.lane >= 0]
    if not runs:
        return None
    moved, stated = np.diff(traffic.position[row], axis=0), traffic.heading[row].copy()
    stated[arrays.step] = arrays.heading  # in traffic it points along the motion
    moved[~(traffic.present[row, 1:] & traffic.present[row, :-1])] = 0.0
    step = np.hypot(*moved.T)
    if (moved[:, 0] * np.cos(stated[1:]) + moved[:, 1] * np.sin(stated[1:])).sum() < 0.5 * step.sum():
        return None
    return Target(
        track=scene.tracks[row], present=traffic.present[row], position=traffic.position[row],
        heading=traffic.heading[row], speed=np.hypot(*alone.traffic.velocity[0].T),
        way=np.concatenate([[0.0], np.cumsum(step)]),
        runs=tuple(
            (int(lanes.lane_ids[run.lane]), int(arrays.step[run.first]), int(arrays.step[run.last])) for run in runs
        ),
    )  # fmt: skip
