"""Conflict resolution (paper, Trajectory Generation): the three cases.

1. A transition into a cell with sigma = 1 is rejected, now and at the predicted time (`transition_rejected`).
2. Generated against generated: executing before pending, then closer before farther, then the lower id (`priority`).
3. Future conflicts: predicted boxes over the horizon, recorded agents by their true future. `Prospect.plan` adjusts the
   timing on a path; where it finds none the caller reroutes, then aborts the manoeuvre.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hid2.agents import BoxSize, FloatArray
from hid2.conflicts.space_time import Follower, SpaceTime, space_time
from hid2.conflicts.speed_plan import SpeedPlan, accelerations, plan_speed
from hid2.kernels.compiled import planner_kernel
from hid2.motion.reference_line import TABLE_STEP_M, ReferenceLine
from hid2.motion.route import DrivenPath
from hid2.motion.smoothing import SpeedBounds
from hid2.occupancy.along_path import PathOccupancy, path_occupancy
from hid2.occupancy.sigma import ORIGINAL
from hid2.occupancy.traffic import Traffic
from hid2.params import Config

#: The last observed step of the forecasting task is given by the scene; a vehicle may leave the map only behind it.
DT_S = 0.1
_PET_MARGIN_M = 0.2
_CLOSING_MPS = 1e-3  # at which anybody closes in on who is ahead
_INTO_M = 1.0  # that the own centre may be inside an interval and its agent still count as ahead, or behind
#: Of the lateral acceleration allowed that a plan may use: some 3 m/s2, which is still comfortable.
_LATERAL_SHARE = 0.62


def transition_rejected(sigma: int) -> bool:
    """Case 1: the target cell is held by an original agent."""
    return sigma == ORIGINAL


def priority(*, executing: bool, distance_m: float, vehicle_id: str) -> tuple[bool, float, str]:
    """Case 2: sort key, first wins."""
    return (not executing, distance_m, vehicle_id)


@dataclass(frozen=True, eq=False, slots=True)
class Prospect:
    """A path with everybody who will be on it: what timing can be chosen from.

    low, high and the rest in arc length of the box centre; desired (S,) m/s at the line's table; most (S,) m/s there:
    what its curvature allows at all. The first recorded_rows agents of the occupancy are recorded, the rest generated.
    """

    path: DrivenPath
    size: BoxSize
    desired: FloatArray
    most: FloatArray
    occupancy: PathOccupancy
    tables: SpaceTime
    margin_m: float
    ttc_s: float
    recorded_rows: int

    def held_back(self, until_step: int, s: float) -> "Prospect":
        """The same, but not beyond arc length s before until_step."""
        held = self.occupancy.joined(_barrier(self.tables.num_steps, until_step, s + self.margin_m))
        return replace(self, occupancy=held, tables=self.tables.held(until_step, s))

    def plan(
        self,
        *,
        s0: float,
        v0: float | Sequence[float],
        a0: float,
        first_step: int,
        config: Config,
        reference: FloatArray | None = None,
    ) -> SpeedPlan | None:
        """Case 3, adjust timing: the best speed profile from the state at first_step on; None where all collide.

        v0: speed then, or several, of which the first that is possible is taken.
        """
        return plan_speed(
            self.tables,
            self.desired,
            most=self.most,
            s0=s0,
            v0=v0,
            a0=a0,
            first_step=first_step,
            accels=plan_accelerations(config),
            step_s=DT_S,
            reference=reference,
        )

    def is_blocked(self, s: FloatArray, first_step: int) -> bool:
        """Whether a driven s(t), (T - first_step,) m, meets anybody or comes closer than the margin."""
        return self.tables.is_blocked(s, first_step)

    def bounds(self, s: FloatArray) -> SpeedBounds | None:
        """Constraints that keep a driven s(t) (T,) on the same side of everybody; None where it is inside somebody."""
        seen = self.occupancy
        lower, upper, need, room = _bounds(
            seen.low, seen.high, seen.along, seen.aligned, s, self.margin_m, self.ttc_s, self.recorded_rows
        )
        edge = self.path.exit_s - self.size.length_m / 2
        gone = s >= edge
        upper[gone], room[gone] = np.inf, np.inf
        early = slice(0, self.tables.earliest_exit_step)
        upper[early] = np.minimum(upper[early], edge)
        lower[gone], need[gone] = -np.inf, -np.inf
        if np.any(lower >= upper) or np.any(need >= room):
            return None
        cells = np.clip((s / TABLE_STEP_M + 0.5).astype(np.int64), 0, self.desired.size - 1)
        fastest = self.desired[cells]
        return SpeedBounds(low=lower, high=upper, fastest=fastest, ttc_room=room, ttc_need=need, ttc_s=self.ttc_s)

    def speed_bounds_only(self, s: FloatArray) -> SpeedBounds:
        """Constraints of the road alone, nobody's box (the ablation without collision checks)."""
        cells = np.clip((s / TABLE_STEP_M + 0.5).astype(np.int64), 0, self.desired.size - 1)
        nowhere = np.full(s.size, np.inf)
        return SpeedBounds(
            low=-nowhere,
            high=nowhere,
            fastest=self.desired[cells],
            ttc_room=nowhere,
            ttc_need=-nowhere,
            ttc_s=self.ttc_s,
        )

    def min_ttc_s(self, s: FloatArray, v: FloatArray) -> float:
        """Smallest TTC to an aligned leader on the path over a driven (T,) s(t), v(t); inf when never closing."""
        return min_leader_ttc_s(self.occupancy, s, v)

    def min_follower_ttc_s(self, s: FloatArray, v: FloatArray) -> float:
        """Smallest TTC of an aligned generated follower to this vehicle; inf when none ever closes in."""
        seen, rows = self.occupancy, slice(self.recorded_rows, None)
        return float(_least_ttc(seen.high[rows], seen.along[rows], seen.aligned[rows], s, v, -1.0))


def road_most(line: ReferenceLine, config: Config) -> FloatArray:
    """(S,) m/s at the line's table: what its curvature allows a plan at all."""
    bend = np.maximum(np.abs(line.table_curvature), 1e-6)
    return np.asarray(np.sqrt(_LATERAL_SHARE * config.limits.lateral_accel_mps2 / bend), dtype=np.float64)


def plan_accelerations(config: Config) -> FloatArray:
    """(N,) m/s2 that plans are made of."""
    return accelerations(
        accel_max=min(config.car_following.accel_mps2, config.limits.accel_max_mps2),
        accel_min=max(-config.car_following.decel_mps2 - 0.7, config.limits.accel_min_mps2),
    )


def min_leader_ttc_s(occupancy: PathOccupancy, s: FloatArray, v: FloatArray) -> float:
    """Smallest TTC to an aligned leader over a driven (T,) s(t) m, v(t) m/s; inf when never closing."""
    return float(_least_ttc(occupancy.low, occupancy.along, occupancy.aligned, s, v, 1.0))


@planner_kernel
def _bounds(low, high, along, aligned, s, margin, ttc, recorded):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """At each step the ends of the room between who is behind and who is ahead, and of the room for s + ttc v."""
    steps = s.size
    lower, upper, need, room = np.empty(steps), np.empty(steps), np.empty(steps), np.empty(steps)
    lower[:], upper[:], need[:], room[:] = -np.inf, np.inf, -np.inf, np.inf
    for a in range(low.shape[0]):
        for t in range(steps):
            if not np.isfinite(low[a, t]):
                continue
            rear, front = low[a, t] - margin, high[a, t] + margin
            if s[t] < rear / 2 + front / 2:
                upper[t] = min(upper[t], rear)
                if aligned[a, t]:
                    room[t] = min(room[t], rear + ttc * along[a, t])
            else:
                lower[t] = max(lower[t], front)
                if aligned[a, t] and a >= recorded:
                    need[t] = max(need[t], front + ttc * along[a, t])
    return lower, upper, need, room


@planner_kernel
def _least_ttc(edge, along, aligned, s, v, side):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Smallest TTC to the near edges of those ahead (side 1), or of those behind to the vehicle (side -1)."""
    least = np.inf
    for a in range(edge.shape[0]):
        for t in range(s.size):
            gap, closing = side * (edge[a, t] - s[t]), side * (v[t] - along[a, t])
            if np.isfinite(edge[a, t]) and aligned[a, t] and gap > -_INTO_M and closing > _CLOSING_MPS:
                least = min(least, gap / closing)
    return least


def _barrier(num_steps: int, until_step: int, s: float) -> PathOccupancy:
    """An obstacle across the path from s on, gone from until_step on. It is nobody's leader."""
    low = np.full((1, num_steps), np.inf)
    high = np.full((1, num_steps), -np.inf)
    low[0, :until_step], high[0, :until_step] = s, s + 1e3
    never = np.zeros((1, num_steps), dtype=np.bool_)
    return PathOccupancy(low=low, high=high, along=np.zeros((1, num_steps)), aligned=never, crosses=never)


def kept_clear(config: Config) -> tuple[int, float]:
    """Steps for which, and margin, m, with which, the place of who crosses is kept clear before and after: PET."""
    return round(config.conflict.pet_min_s / DT_S), config.conflict.margin_front_m - _PET_MARGIN_M


def prospect(
    path: DrivenPath,
    size: BoxSize,
    desired: FloatArray,
    most: FloatArray,
    others: tuple[Traffic, ...],
    *,
    config: Config,
    num_steps: int,
    earliest_exit_step: int,
    known: PathOccupancy | None = None,
    seen_to_s: float | None = None,
) -> Prospect:
    """Look along a path: everybody in `others`, after `known` (computed before, and kept clear), is an obstacle.

    desired, most (S,) m/s: as of `Prospect`. seen_to_s: nobody is seen beyond it, m (the ablation without topology:
    conflicts are looked up in linked cells).
    """
    clear_steps, clear_margin_m = kept_clear(config)
    seen = [] if known is None else [known]
    seen += [
        path_occupancy(
            path.line,
            traffic,
            length_m=size.length_m,
            width_m=size.width_m,
            margin_lateral_m=config.conflict.margin_lateral_m,
            clear_steps=clear_steps,
            clear_margin_m=clear_margin_m,
        )
        for traffic in others
    ]
    if not seen:
        raise ValueError("prospect: neither others nor known")
    occupancy = seen[0].joined(*seen[1:])
    if seen_to_s is not None:
        unseen = occupancy.low > seen_to_s
        occupancy = replace(
            occupancy, low=np.where(unseen, np.inf, occupancy.low), high=np.where(unseen, -np.inf, occupancy.high)
        )
    ttc_s, following = config.conflict.ttc_min_s + 0.2, config.car_following
    tables = space_time(
        occupancy,
        table_length=path.line.table_xy.shape[0],
        num_steps=num_steps,
        margin_m=config.conflict.margin_front_m,
        ttc_s=ttc_s,
        time_gap_s=config.conflict.follow_time_s,
        follower=Follower(
            decel_mps2=following.decel_mps2,
            reaction_mps=min(following.tau_s, config.conflict.follow_time_s) * following.decel_mps2,
            min_gap_m=following.min_gap_m,
        ),
        exit_s=path.exit_s - size.length_m / 2,
        earliest_exit_step=earliest_exit_step,
    )
    return Prospect(
        path=path, size=size, desired=desired, most=most, occupancy=occupancy, tables=tables,
        margin_m=0.6 * config.conflict.margin_front_m, ttc_s=ttc_s,
        recorded_rows=0 if known is None else known.low.shape[0],
    )  # fmt: skip
