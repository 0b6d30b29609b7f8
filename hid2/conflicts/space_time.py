"""The space-time view behind every check for conflicts: where a vehicle may be when, and how fast.

Worked out from the intervals of others on a path (paper, Trajectory Generation, conflict case 3).
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hid2.agents import FloatArray
from hid2.kernels.compiled import planner_kernel
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.occupancy.along_path import PathOccupancy


class Follower(NamedTuple):
    """The car following that will drive a plan (Krauss 1998; leaders are expected to brake with the same b).

    decel_mps2: b; reaction_mps: tau b, for a reaction time tau; min_gap_m: the smallest gap.
    """

    decel_mps2: float
    reaction_mps: float
    min_gap_m: float


class View(NamedTuple):
    """A `SpaceTime` as the compiled functions take it: low, high, along and aligned (A, T) of its occupancy.

    The rest is as there, lengths in cells of cell_m.
    """

    low: FloatArray
    high: FloatArray
    along: FloatArray
    aligned: npt.NDArray[np.bool_]
    cells: int
    cell_m: float
    margin_m: float
    ttc_s: float
    time_gap_s: float
    beyond: int
    earliest_exit_step: int
    hold_until: int
    hold_from: int
    follower: Follower


@dataclass(frozen=True, eq=False, slots=True)
class SpaceTime:
    """What the search of a speed profile looks up, by step and by arc length in cells of TABLE_STEP_M.

    Rows are worked out where the search comes to, not for the whole scene. margin_m is kept to every interval of the
    occupancy; from cell `beyond` on the path is off the map: nobody is met there, but to be there before
    earliest_exit_step is forbidden. Before hold_until, cells from hold_from on are forbidden too.
    """

    occupancy: PathOccupancy
    num_steps: int
    cells: int
    margin_m: float
    ttc_s: float
    time_gap_s: float
    follower: Follower
    beyond: int
    earliest_exit_step: int
    hold_until: int = 0
    hold_from: int = 0

    @property
    def blocked(self) -> np.ndarray[tuple[int, int], np.dtype[np.uint8]]:
        """(T, S): the own centre may not be there then."""
        return self._tables()[0]

    @property
    def fastest(self) -> FloatArray:
        """(T, S) m/s: speed at which the TTC to the aligned leader ahead is still the critical one."""
        return self._tables()[1]

    @property
    def pushed(self) -> FloatArray:
        """(T, S) m/s: slower than this, a follower closes in too fast."""
        return self._tables()[2]

    @property
    def followed(self) -> FloatArray:
        """(T, S) m/s: faster than this, car following brakes for the leader ahead."""
        return np.sqrt(np.maximum(self._tables()[3], 0.0)) - self.follower.reaction_mps

    def is_blocked(self, s: FloatArray, first_step: int) -> bool:
        """Whether a driven s(t), (M,) m from first_step on, is anywhere that it may not be."""
        cells = np.clip((s / TABLE_STEP_M + 0.5).astype(np.int64), 0, self.cells - 1)
        return bool(_any_blocked(cells, first_step, self.view()))

    def held(self, until_step: int, s: float) -> "SpaceTime":
        """The same, but not beyond arc length s before until_step."""
        return replace(self, hold_until=until_step, hold_from=int(s / TABLE_STEP_M) + 1)

    def view(self) -> View:
        """Everything as the compiled functions take it."""
        seen = self.occupancy
        return View(
            seen.low, seen.high, seen.along, seen.aligned, self.cells, TABLE_STEP_M, self.margin_m, self.ttc_s,
            self.time_gap_s, self.beyond, self.earliest_exit_step, self.hold_until, self.hold_from, self.follower,
        )  # fmt: skip

    def _tables(
        self, first: int = 0, last: int | None = None, left: int = 0, right: int | None = None
    ) -> tuple[np.ndarray[tuple[int, int], np.dtype[np.uint8]], FloatArray, FloatArray, FloatArray]:
        last = self.num_steps if last is None else last
        right = self.cells if right is None else right
        return _tables(first, last, left, right, self.view())  # type: ignore[no-any-return]


def space_time(
    occupancy: PathOccupancy,
    *,
    table_length: int,
    num_steps: int,
    margin_m: float,
    ttc_s: float,
    time_gap_s: float,
    follower: Follower,
    exit_s: float,
    earliest_exit_step: int,
) -> SpaceTime:
    """View of intervals. exit_s: arc length at which the path leaves the map, not before earliest_exit_step."""
    return SpaceTime(
        occupancy=occupancy,
        num_steps=num_steps,
        cells=table_length,
        margin_m=margin_m,
        ttc_s=ttc_s,
        time_gap_s=time_gap_s,
        follower=follower,
        beyond=int(exit_s / TABLE_STEP_M),
        earliest_exit_step=earliest_exit_step,
    )


@planner_kernel
def _any_blocked(at, first_step, view):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    row = np.zeros(1, dtype=np.uint8)
    for k in range(at.size):
        block_row(row, first_step + k, at[k], at[k] + 1, view)
        if row[0] == 1:
            return True
    return False


@planner_kernel
def _tables(start, end, left, right, view):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Rows `start` to `end` of all three tables, cells `left` to `right`."""
    blocked = np.zeros((end - start, right - left), dtype=np.uint8)
    fastest = np.empty((end - start, right - left))
    pushed, followed = np.empty((end - start, right - left)), np.empty((end - start, right - left))
    for t in range(start, end):
        k = t - start
        block_row(blocked[k], t, left, right, view)
        speed_rows(fastest[k], pushed[k], followed[k], t, left, right, view)
    return blocked, fastest, pushed, followed


@planner_kernel
def block_row(row, t, left, right, view) -> None:  # type: ignore[no-untyped-def]  # noqa: ANN001
    """Whether cells left .. right - 1 are forbidden at step t, into row[0 .. right - left - 1]."""
    cells, step, margin = view.cells, view.cell_m, view.margin_m
    row[: right - left] = 0
    for a in range(view.low.shape[0]):
        if view.low[a, t] == np.inf:
            continue
        first = max(left, min(max(0, int(np.ceil((view.low[a, t] - margin) / step))), cells))
        last = min(right - 1, max(-1, min(cells - 1, int(np.floor((view.high[a, t] + margin) / step)))))
        for i in range(first, last + 1):
            row[i - left] = 1
    for i in range(max(left, view.beyond), right):  # off the map nobody is met; to be there too early is forbidden
        row[i - left] = 1 if t < view.earliest_exit_step else 0
    if t < view.hold_until:
        for i in range(max(left, view.hold_from), right):
            row[i - left] = 1


@planner_kernel
def speed_rows(fastest, pushed, followed, t, left, right, view) -> None:  # type: ignore[no-untyped-def]  # noqa: ANN001
    """Fastest and pushed speed in cells left .. right - 1 at step t, into [0 .. right - left - 1].

    followed: (v + tau b)^2 of the speed v at which car following begins to brake, which saves a root for every cell.
    """
    cells, step, margin, ttc, time_gap = view.cells, view.cell_m, view.margin_m, view.ttc_s, view.time_gap_s
    follower = view.follower
    fastest[: right - left] = 99.0
    pushed[: right - left] = 0.0
    followed[: right - left] = 1e4
    for a in range(view.low.shape[0]):
        if view.low[a, t] == np.inf or not view.aligned[a, t]:
            continue
        front, rear = view.low[a, t] - margin, view.high[a, t] + margin
        first = min(max(0, int(np.ceil(front / step))), cells)
        last = max(-1, min(cells - 1, int(np.floor(rear / step))))
        speed = view.along[a, t]
        slack = 2.0 * follower.decel_mps2
        still = follower.reaction_mps**2 + max(speed, 0.0) ** 2 + slack * (margin - follower.min_gap_m)
        for i in range(max(left, first - int(80.0 / step)), min(right, first)):
            gap = front - i * step
            followed[i - left] = min(followed[i - left], still + slack * gap)
            limit = speed + gap / ttc
            if time_gap > 0 and gap < speed * time_gap:
                limit = min(limit, max(speed, (gap + margin) / time_gap))
            if limit < fastest[i - left]:
                fastest[i - left] = limit
        for i in range(max(left, last + 1), min(right, last + 1 + int(40.0 / step))):
            needed = speed - (i * step - rear) / ttc
            if needed > pushed[i - left]:
                pushed[i - left] = needed
    for i in range(max(left, view.beyond), right):
        fastest[i - left] = np.inf
        pushed[i - left] = 0.0
        followed[i - left] = 1e4
