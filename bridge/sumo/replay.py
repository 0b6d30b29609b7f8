"""Recorded agents as fixed vehicles: every state at its exact pose, every step."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from bridge.sumo.poses import box_poses, sumo_poses
from bridge.sumo.simulation import Simulation
from hid2.agents import FloatArray
from hid2.kernels.compiled import planner_kernel
from hid2.occupancy.traffic import BoolArray, Traffic
from hid2.scene import PlannedVehicle, World
from netconvert.geometry import wrap_angle

_ASIDE_M = 16.0  # the own lane and those beside it, with room for what SUMO matches to them
_AROUND_M = 100.0  # looking ahead, and what the driving may be off the plan


@dataclass(frozen=True, slots=True)
class ReplayErrors:
    """What SUMO made of the replayed states."""

    states: int = 0
    max_position_error_m: float = 0.0
    max_heading_error_rad: float = 0.0
    lost: int = 0


@dataclass(slots=True)
class Replay:
    """Drives the agents of a `Traffic` along their states. Call `place` before and `check` after each step.

    checked: compare poses; a scene's first simulation does, later ones replay the same states. in_the_way (A,): the
    others are put on no lane, for SUMO, to whom a vehicle there has no width, would brake for them; all unless told.
    """

    simulation: Simulation
    traffic: Traffic
    prefix: str
    checked: bool = True
    in_the_way: BoolArray | None = None
    _in: set[int] = field(default_factory=set)
    _names: list[str] = field(init=False)
    _aside: frozenset[str] = field(init=False)
    _poses: list[tuple[list[float], list[float], list[float]]] = field(init=False)
    _here: list[list[int]] = field(init=False)
    _seen: list[tuple[int, list[int], FloatArray]] = field(default_factory=list)
    _lost: int = 0

    def __post_init__(self) -> None:
        """Turn all poses at once."""
        front, angle = sumo_poses(self.traffic.position, self.traffic.heading, self.traffic.length_m[:, None])
        self._names = [f"{self.prefix}{row}" for row in range(len(self.traffic.ids))]
        aside = [] if self.in_the_way is None else np.flatnonzero(~self.in_the_way).tolist()
        self._aside = frozenset(self._names[row] for row in aside)
        by_step = zip(front[..., 0].T.tolist(), front[..., 1].T.tolist(), angle.T.tolist(), strict=True)
        self._poses = list(by_step)
        self._here = [np.flatnonzero(column).tolist() for column in self.traffic.present.T]

    def place(self, step: int) -> None:
        """Add, move and remove vehicles so that the coming step has the states of `step`."""
        rows, names = self._here[step], self._names
        here = set(rows)
        if here != self._in:
            for row in sorted(self._in - here):
                self.simulation.remove(names[row])
            for row in sorted(here - self._in):
                self.simulation.add_replayed(
                    names[row],
                    length_m=float(self.traffic.length_m[row]),
                    width_m=float(self.traffic.width_m[row]),
                )
            self._in = here
        x, y, angle = self._poses[step]
        self.simulation.place_all([(names[row], x[row], y[row], angle[row]) for row in rows], aside=self._aside)

    def check(self, step: int) -> None:
        """Take down SUMO's poses, where they are to be compared with the recorded ones."""
        if not self.checked:
            return
        rows = self._here[step]
        found = self.simulation.poses([self._names[row] for row in rows])
        kept = [number for number, pose in enumerate(found) if pose is not None]
        self._lost += len(rows) - len(kept)
        self._seen.append(
            (step, [rows[number] for number in kept], np.array([found[number] for number in kept]).reshape(-1, 3))
        )

    @property
    def errors(self) -> ReplayErrors:
        """What SUMO made of the states checked so far."""
        row = np.array([row for _, rows, _ in self._seen for row in rows], dtype=np.int64)
        if row.size == 0:
            return ReplayErrors(lost=self._lost)
        step = np.array([step for step, rows, _ in self._seen for _ in rows])
        poses = np.concatenate([poses for _, _, poses in self._seen])
        center, heading = box_poses(poses[:, :2], poses[:, 2], self.traffic.length_m[row])
        off = np.hypot(*(center - self.traffic.position[row, step]).T)
        turned = np.abs(wrap_angle(heading - self.traffic.heading[row, step]))
        return ReplayErrors(row.size, float(off.max()), float(turned.max()), self._lost)


def met_by(traffic: Traffic, planned: Sequence[PlannedVehicle]) -> Traffic:
    """Those of `traffic` that SUMO's car following and lane changing of the planned vehicles may have to do with.

    They come within _ASIDE_M of a planned path, and within _AROUND_M of where the vehicle is meant to be then. The
    others need no replay.
    """
    met = np.zeros(len(traffic.ids), dtype=np.bool_)
    for spec in planned:
        for path, s in ((spec.path, spec.plan_s), (spec.intended_path, spec.intended_s)):
            if path is not spec.path or s is spec.plan_s:
                _meet(traffic.position, traffic.present, path.line.table_xy, path.line.position(s), met)
    return traffic if met.all() else traffic.rows(np.flatnonzero(met).tolist())


def in_the_way(world: World, planned: Sequence[PlannedVehicle]) -> BoolArray:
    """Which recorded agents, (A,), the box of a planned vehicle, with its margin, ever touches on its way."""
    met = np.zeros(len(world.traffic.ids), dtype=np.bool_)
    for spec in planned:
        for path in (spec.path, spec.intended_path):
            met[world.met_on(path, spec.size)] = True
    return met


@planner_kernel
def _meet(position, present, path, plan, met):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Set met where it comes about; agents that are set already are passed over."""
    steps = min(present.shape[1], plan.shape[0])
    for a in range(met.size):
        last_x, last_y = np.inf, np.inf
        for t in range(steps):
            if met[a]:
                break
            x, y = position[a, t, 0], position[a, t, 1]
            if not present[a, t] or (x - plan[t, 0]) ** 2 + (y - plan[t, 1]) ** 2 > _AROUND_M**2:
                continue
            if (x - last_x) ** 2 + (y - last_y) ** 2 < 1.0:
                continue
            last_x, last_y = x, y
            for i in range(0, path.shape[0], 4):
                if (x - path[i, 0]) ** 2 + (y - path[i, 1]) ** 2 < _ASIDE_M**2:
                    met[a] = True
                    break
