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
from hid2.occupancy import ORIGINAL
from hid2.params import Config
from hid2.path_occupancy import PathOccupancy, path_occupancy
from hid2.reference_line import TABLE_STEP_M, ReferenceLine
from hid2.route import DrivenPath
from hid2.smoothing import SpeedBounds
from hid2.space_time import Follower, SpaceTime, space_time
from hid2.speed_plan import SpeedPlan, accelerations, plan_speed
from hid2.traffic import Traffic

#: The last observed step of the forecasting task is given by the scene; a vehicle may leave the map only behind it.
DT_S = 0.1
_PET_MARGIN_M = 0.2
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
        steps = s.size
        low = self.occupancy.low[:, :steps] - self.margin_m
        high = self.occupancy.high[:, :steps] + self.margin_m
        along, aligned = self.occupancy.along[:, :steps], self.occupancy.aligned[:, :steps]
        touched = np.isfinite(self.occupancy.low[:, :steps])
        middle = np.where(touched, low, 0.0) / 2 + np.where(touched, high, 0.0) / 2
        ahead = touched & (s[None, :] < middle)
        behind = touched & ~ahead
        upper = np.where(ahead, low, np.inf).min(axis=0, initial=np.inf)
        lower = np.where(behind, high, -np.inf).max(axis=0, initial=-np.inf)
        leads = ahead & aligned
        room = np.where(leads, low + self.ttc_s * along, np.inf).min(axis=0, initial=np.inf)
        needs = behind & aligned
        needs[: self.recorded_rows] = False
        need = np.where(needs, high + self.ttc_s * along, -np.inf).max(axis=0, initial=-np.inf)
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
        steps, rows = s.size, slice(self.recorded_rows, None)
        high, along = self.occupancy.high[rows, :steps], self.occupancy.along[rows, :steps]
        behind = np.isfinite(high) & self.occupancy.aligned[rows, :steps] & (s[None, :] > high - 1.0)
        closing = along - v[None, :]
        with np.errstate(divide="ignore", invalid="ignore"):
            ttc = np.where(behind & (closing > 1e-3), (s[None, :] - high) / closing, np.inf)
        return float(ttc.min(initial=np.inf))


def _road_most(line: ReferenceLine, config: Config) -> FloatArray:
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
    steps = s.size
    low, along = occupancy.low[:, :steps], occupancy.along[:, :steps]
    ahead = np.isfinite(low) & occupancy.aligned[:, :steps] & (s[None, :] < low + 1.0)
    closing = v[None, :] - along
    with np.errstate(divide="ignore", invalid="ignore"):
        ttc = np.where(ahead & (closing > 1e-3), (low - s[None, :]) / closing, np.inf)
    return float(ttc.min(initial=np.inf))


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
    others: tuple[Traffic, ...],
    *,
    config: Config,
    num_steps: int,
    earliest_exit_step: int,
    known: PathOccupancy | None = None,
    seen_to_s: float | None = None,
) -> Prospect:
    """Look along a path: everybody in `others`, after `known` (computed before, and kept clear), is an obstacle.

    seen_to_s: nobody is seen beyond it, m (the ablation without topology: conflicts are looked up in linked cells).
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
        path=path, size=size, desired=desired, most=_road_most(path.line, config), occupancy=occupancy, tables=tables,
        margin_m=0.6 * config.conflict.margin_front_m, ttc_s=ttc_s,
        recorded_rows=0 if known is None else known.low.shape[0],
    )  # fmt: skip
