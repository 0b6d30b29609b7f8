"""Conflict resolution, live (paper, Trajectory Generation): the three cases.

1. A transition into a cell with sigma = 1 is rejected, now and at the predicted time (`transition_rejected`).
2. Generated against generated: executing before pending, then closer before farther (in time, to the way that both
   share), then the one whose site was chosen first; one that is there already before all. In the compiled loop.
3. Future conflicts: predicted boxes over the horizon, recorded agents by their true future, generated ones by their
   state and intention at this step (`Guard.braking`): adjust timing, else another way at the next split; a manoeuvre
   does not begin meanwhile.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from hid2.agents import BoxSize, FloatArray, IntArray
from hid2.conflicts.stop_lines import ClosedLines, StopLines
from hid2.drivers.driver import Driver
from hid2.kernels.guard import SWEPT_STEP_M, needed_braking
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.motion.route import DrivenPath
from hid2.occupancy.along_path import PathOccupancy, look_along
from hid2.occupancy.sigma import ORIGINAL
from hid2.occupancy.traffic import Traffic
from hid2.once import once
from hid2.scene import Scene

#: Decelerations tried, least first, up to `conflict.brake_max_mps2`, m/s2. No tunables: `conflict` has the margins that
#: a driver keeps, `kernels/guard.py` how it brakes.
_BRAKES_MPS2 = (0.0, 0.5, 0.8, 1.1, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0)
_MARGINS_M = 10.0  # added to two boxes; not a parameter, it saves time: more than any lateral margin
#: Columns of the fleet's state.
S, V, A, EXECUTING, PRESENT = range(5)


def transition_rejected(sigma: int) -> bool:
    """Case 1: the target cell is held by an original agent."""
    return sigma == ORIGINAL


class Braking(NamedTuple):
    """What a vehicle has to do about predicted conflicts.

    decel_mps2: least constant braking without a conflict, 0 for none; conflict_s: seconds to a conflict that remains
    even so, None where none does; run_into: a recorded vehicle comes up from behind.
    """

    decel_mps2: float
    conflict_s: float | None
    run_into: bool

    def forbids(self, driver: Driver) -> bool:
        """Whether a way that a driver may or may not take has a conflict that its ordinary braking does not solve."""
        return self.conflict_s is not None or self.run_into or self.decel_mps2 > driver.decel_mps2


@dataclass(eq=False, slots=True)
class Obstacles:
    """All agents on one path: known (A, T + E) for those with a known future, swept for the fleet's others.

    swept (4, G, K): low and high m, cosine, by the other vehicle's own arc length, and low on its path by the own one;
    rows (G,) of the fleet; lines: the stop lines on the path.
    """

    known: PathOccupancy
    swept: FloatArray
    rows: IntArray
    lines: ClosedLines


class OwnMotion(NamedTuple):
    """How a vehicle goes on along a path by itself.

    state: s m, v m/s, a m/s2; road (S,): m/s at the table of the path's line, what the road allows the driver.
    """

    state: tuple[float, float, float]
    desired_mps: float
    road: FloatArray
    driver: Driver


@dataclass(eq=False)
class Guard:
    """Conflict case 3 of all vehicles that are driven together.

    inserted_known: vehicles with known motion, those kept in rounds before; in rollouts also those chosen in this one.
    """

    scene: Scene
    inserted_known: Traffic
    stop_lines: StopLines
    _known_of: tuple[Scene, Traffic] | None = field(init=False, default=None)
    _known: dict[tuple[DrivenPath, BoxSize], PathOccupancy] = field(init=False, default_factory=dict)

    @cached_property
    def brakes(self) -> FloatArray:
        """Decelerations that are tried, m/s2."""
        most_mps2 = self.scene.config.conflict.brake_max_mps2
        return np.array([*(brake for brake in _BRAKES_MPS2 if brake < most_mps2), most_mps2])

    @property
    def horizon(self) -> int:
        """Steps that are looked ahead; 0 where conflicts do not count."""
        config = self.scene.config
        return 0 if "collision" in config.without else self.scene.steps_in(config.conflict.horizon_s)

    def obstacles(self, path: DrivenPath, box: BoxSize, others: list[tuple[int, DrivenPath, BoxSize]]) -> Obstacles:
        """All agents on a path for a box; others: fleet rows with the paths and boxes of those driven together."""
        each = (
            (row, self._swept_on(path, box, other, other_box), self._swept_on(other, other_box, path, box))
            for row, other, other_box in others
        )
        found = [(row, (*swept, back[0] if back else np.full(1, np.inf))) for row, swept, back in each if swept]
        longest = max((low.size for _, swept in found for low in swept), default=1)
        every = np.empty((4, len(found), longest))
        every[0], every[1], every[2], every[3] = np.inf, -np.inf, 0.0, np.inf
        for place, (_, swept) in enumerate(found):
            for column, values in zip(every, swept, strict=True):
                column[place, : values.size] = values
        rows = np.array([row for row, _ in found], dtype=np.int64)
        return Obstacles(known=self.known_on(path, box), swept=every, rows=rows, lines=self.stop_lines.on(path, box))

    def known_on(self, path: DrivenPath, box: BoxSize) -> PathOccupancy:
        """Intervals on a path of all agents with known motion, with margins and the critical PET.

        Rows as in `Scene.with_inserted`. Inserted ones, where they cross, are kept clear of as long as cross traffic
        makes an entrance red: streams do not mingle. Worked out once, while scene and inserted ones are the same.
        """
        scene, inserted, key = self.scene, self.inserted_known, (path, box)
        if self._known_of != (scene, inserted):
            self._known_of, self._known = (scene, inserted), {}
        if key not in self._known:
            held = scene.kept_clear_on(path, box, inserted, at_least_s=scene.config.signals.before_s)
            self._known[key] = scene.with_inserted(scene.kept_clear_on(path, box, scene.lasting), held)
        return self._known[key]

    @once
    def _swept_on(
        self, path: DrivenPath, box: BoxSize, other: DrivenPath, other_box: BoxSize
    ) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """Interval on a path, and cosine between the two, for each place of another vehicle along its own path."""
        if path.line.is_beyond(other.line, 0.5 * (sum(box) + sum(other_box)) + _MARGINS_M):
            return None  # with centres so far apart no boxes touch
        width_m = box.width_m + 2 * self.scene.config.conflict.margin_lateral_m
        found = look_along(path.line, self._alone(other, other_box), box.length_m, width_m)
        return (found.low[0], found.high[0], found.along[0]) if found.agents.size else None

    @once
    def _alone(self, path: DrivenPath, box: BoxSize) -> Traffic:
        """A vehicle at each place along its own path, as steps."""
        every = slice(None, None, round(SWEPT_STEP_M / TABLE_STEP_M))
        xy = np.ascontiguousarray(path.line.table_xy[every])
        heading = np.ascontiguousarray(path.line.table_heading[every])
        forward = np.stack([np.cos(heading), np.sin(heading)], axis=1)
        return Traffic(
            ids=("other",), position=xy[None], heading=heading[None], velocity=forward[None],
            present=np.ones((1, heading.size), dtype=np.bool_), length_m=np.array([box.length_m]),
            width_m=np.array([box.width_m]),
        )  # fmt: skip

    def braking(
        self, obstacles: Obstacles, going: OwnMotion, step: int, fleet: FloatArray, *, own: int, horizon_s: float | None
    ) -> Braking:
        """Least braking from a step on, of row `own` of a fleet, that meets no agent within the horizon.

        horizon_s: another one than `conflict.horizon_s`.
        """
        scene, known, lines, driver = self.scene, obstacles.known, obstacles.lines, going.driver
        horizon = self.horizon if horizon_s is None else scene.steps_in(horizon_s)
        row, hit, *_, run_into = needed_braking(
            known.low, known.high, known.along, known.same_direction, lines.stops_m(driver), lines.closed,
            obstacles.swept, obstacles.rows, fleet, own, step, going.state, going.desired_mps, going.road, horizon,
            scene.step_s, driver.following, self.brakes,
        )  # fmt: skip
        return Braking(float(self.brakes[row]), None if hit < 0 else hit * scene.step_s, bool(run_into))
