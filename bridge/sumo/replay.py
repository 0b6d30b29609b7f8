"""Recorded agents as fixed vehicles: every state at its exact pose, every step."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from bridge.sumo.poses import box_poses, sumo_poses
from bridge.sumo.simulation import Simulation
from hid2.occupancy.shown import UNSEEN_STEPS
from hid2.occupancy.traffic import Traffic
from netconvert.geometry import wrap_angle


@dataclass(frozen=True, slots=True)
class ReplayErrors:
    """What SUMO made of the replayed states."""

    states: int = 0
    max_position_error_m: float = 0.0
    max_heading_error_rad: float = 0.0


@dataclass(slots=True)
class Replay:
    """Drives the agents of a `Traffic` along their states. Call `place` before and `check` after each step.

    checked: of so many, the first ones, poses are compared. names: ids in the simulation.
    """

    simulation: Simulation
    traffic: Traffic
    step_s: float
    checked: int = sys.maxsize
    _in: set[int] = field(default_factory=set)
    names: list[str] = field(init=False)
    _poses: list[tuple[list[float], list[float], list[float]]] = field(init=False)
    _here: list[list[int]] = field(init=False)
    errors: ReplayErrors = field(init=False, default=ReplayErrors())
    _placed: int = 0
    _since: dict[int, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """No agent is in the simulation yet."""
        self.names = [f"r{row}" for row in range(len(self.traffic.ids))]
        self.take(self.traffic)

    def take(self, traffic: Traffic) -> None:
        """The same agents with other states from the coming step on; all poses of those there are turned at once."""
        self.traffic = traffic
        step, row = np.nonzero(traffic.present.T)
        front, angle = sumo_poses(traffic.position[row, step], traffic.heading[row, step], traffic.length_m[row])
        columns = [column.tolist() for column in (row, front[:, 0], front[:, 1], angle)]
        ends = np.cumsum(traffic.present.sum(axis=0)).tolist()
        spans = [slice(begin, end) for begin, end in zip([0, *ends], ends, strict=False)]
        self._here, *poses = ([column[span] for span in spans] for column in columns)
        self._poses = list(zip(*poses, strict=True))

    def warm_up(self, back: int) -> None:
        """Place those of step 0 where they were `back` steps before, seen by no vehicle.

        SUMO knows speed and acceleration of a vehicle that it is shown only after it has moved it for UNSEEN_STEPS.
        """
        rows, traffic = self._here[0], self.traffic
        position = traffic.position[:, 0] - back * self.step_s * traffic.velocity[:, 0]
        xy, angle = sumo_poses(position, traffic.heading[:, 0], traffic.length_m)
        self._put(rows, [column[rows].tolist() for column in (*xy.T, angle)], {})

    def place(self, step: int, seen: Mapping[int, tuple[str, int]]) -> None:
        """Add, move and remove vehicles so that the coming step has the states of `step`.

        seen: rows of those that SUMO's car following is to see, with the edge and lane index on which; the others are
        put on no lane, for to SUMO a vehicle on a lane has no width: it would brake for agents that stand beside. A
        new agent is not seen before SUMO knows its speed.
        """
        self._put(self._here[step], self._poses[step], seen)

    def _put(self, rows: list[int], poses: Sequence[list[float]], seen: Mapping[int, tuple[str, int]]) -> None:
        here, names, traffic = set(rows), self.names, self.traffic
        for row in sorted(self._in - here):
            self.simulation.remove(names[row])
        for row in sorted(here - self._in):
            length_m, width_m = float(traffic.length_m[row]), float(traffic.width_m[row])
            self.simulation.add_replayed(names[row], length_m=length_m, width_m=width_m)
            self._since[row] = self._placed
        self._in = here
        known, since = self._placed - UNSEEN_STEPS, self._since
        lanes = (seen.get(row) if since[row] <= known else None for row in rows)
        self.simulation.place_all(list(zip([names[row] for row in rows], *poses, lanes, strict=True)))
        self._placed += 1

    def check(self, step: int) -> None:
        """Take down SUMO's poses, where they are to be compared with the recorded ones."""
        if not self.checked:
            return
        rows, before = np.array([row for row in self._here[step] if row < self.checked], dtype=np.int64), self.errors
        found = self.simulation.poses([self.names[row] for row in rows])
        there = rows[[pose is not None for pose in found]]
        poses = np.array([pose for pose in found if pose is not None]).reshape(-1, 3)
        center, heading = box_poses(poses[:, :2], poses[:, 2], self.traffic.length_m[there])
        off = np.hypot(*(center - self.traffic.position[there, step]).T)
        turned = np.abs(wrap_angle(heading - self.traffic.heading[there, step]))
        most_m = float(off.max(initial=before.max_position_error_m))
        most_rad = float(turned.max(initial=before.max_heading_error_rad))
        self.errors = ReplayErrors(before.states + there.size, most_m, most_rad)
