"""Recorded agents as fixed vehicles: every state at its exact pose, every step."""

from dataclasses import dataclass, field

import numpy as np

from bridge.poses import box_poses, sumo_poses
from bridge.simulation import Simulation
from hid2.traffic import Traffic
from netconvert.geometry import wrap_angle


@dataclass(slots=True)
class ReplayErrors:
    """What SUMO made of the replayed states."""

    states: int = 0
    max_position_error_m: float = 0.0
    max_heading_error_rad: float = 0.0
    lost: int = 0


@dataclass(slots=True)
class Replay:
    """Drives the agents of a `Traffic` along their states. Call `place` before and `check` after each step.

    checked: compare poses; a scene's first simulation does, later ones replay the same states.
    """

    simulation: Simulation
    traffic: Traffic
    prefix: str
    checked: bool = True
    errors: ReplayErrors = field(default_factory=ReplayErrors)
    _in: set[int] = field(default_factory=set)
    _front: np.ndarray[tuple[int, ...], np.dtype[np.float64]] = field(init=False)
    _angle: np.ndarray[tuple[int, ...], np.dtype[np.float64]] = field(init=False)

    def __post_init__(self) -> None:
        """Turn all poses at once."""
        self._front, self._angle = sumo_poses(
            self.traffic.position, self.traffic.heading, self.traffic.length_m[:, None]
        )

    def place(self, step: int) -> None:
        """Add, move and remove vehicles so that the coming step has the states of `step`."""
        here = set(np.flatnonzero(self.traffic.present[:, step]).tolist())
        for row in sorted(self._in - here):
            self.simulation.remove(self._name(row))
        for row in sorted(here - self._in):
            self.simulation.add_replayed(
                self._name(row),
                length_m=float(self.traffic.length_m[row]),
                width_m=float(self.traffic.width_m[row]),
            )
        for row in sorted(here):
            x, y = self._front[row, step].tolist()
            self.simulation.place(self._name(row), x, y, float(self._angle[row, step]))
        self._in = here

    def check(self, step: int) -> None:
        """Compare SUMO's poses with the recorded ones, where that is asked for."""
        if not self.checked:
            return
        rows = sorted(self._in)
        inside = self.simulation.driven()
        kept = [row for row in rows if self._name(row) in inside]
        self.errors.lost += len(rows) - len(kept)
        if not kept:
            return
        poses = np.array([self.simulation.pose(self._name(row)) for row in kept])
        center, heading = box_poses(poses[:, :2], poses[:, 2], self.traffic.length_m[kept])
        off = np.hypot(*(center - self.traffic.position[kept, step]).T)
        turned = np.abs(wrap_angle(heading - self.traffic.heading[kept, step]))
        self.errors.states += len(kept)
        self.errors.max_position_error_m = max(self.errors.max_position_error_m, float(off.max()))
        self.errors.max_heading_error_rad = max(self.errors.max_heading_error_rad, float(turned.max()))

    def _name(self, row: int) -> str:
        return f"{self.prefix}{row}"
