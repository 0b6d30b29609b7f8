"""A driver: the parameters of one inserted vehicle, drawn from the distributions of `params.Drivers`."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hid2.agents import FloatArray
from hid2.kernels.trajectory import trailing
from hid2.params import Config, Drivers

# No tunables from here to OFFSET_MAX_M: shapes of distributions.
TRUNCATED_AT = 2.0  # SD from the mean at which draws are cut off
_EASED_S = 0.8  # time constant that eases the wandering of the speed, s, as feet do not jump
_WANDERS_TO = 0.8  # least share of the desired speed as it wanders, as none crawls without a cause
_GAINING_SD = 1.0, 6.0  # by how much vehicles that gain speed begin below the desired one, in SDs of its wandering
_BEGINS_FROM = 0.3  # least share of the desired speed to begin with, but for what is ahead
_OFFSET_SPACING_M = 6.0  # least distance along the way between two knots of the lateral offset, m
OFFSET_MAX_M = 0.9  # largest lateral offset from the middle of the lane, m: a car is no bicycle
#: Least and largest gap from a driver's front to the line, m, negative past it. No tunable: of 21 recorded ones that
#: stand first before an intersection 19 do at -3.2 to 3.6 m (fourteen scenes), farther past it cross traffic is near.
LINE_GAP_M = -1.5, 3.0


@dataclass(frozen=True, slots=True)
class Driver:
    """The driver of one vehicle.

    desired_mps m/s; tau_s s, time gap; accel_mps2, decel_mps2 m/s2, comfortable; min_gap_m m to a standing leader;
    turn_lateral_mps2 m/s2, what the driver takes in turns; offset_m m, mean place beside that of others on the lane,
    left positive; lane_change_s s, duration of a lane change; wander_m m, SD of the wandering about the place;
    line_gap_m m from the front to the line at which it stands, negative past it.
    """

    desired_mps: float
    tau_s: float
    accel_mps2: float
    decel_mps2: float
    min_gap_m: float
    turn_lateral_mps2: float
    offset_m: float
    lane_change_s: float
    wander_m: float = 0.0
    line_gap_m: float = 1.0

    @property
    def following(self) -> tuple[float, float, float, float]:
        """What the guard predicts it by: tau s, acceleration and deceleration m/s2, gap at standstill m."""
        return self.tau_s, self.accel_mps2, self.decel_mps2, self.min_gap_m


#: Points along the way over which the usual place in the lane is averaged. Not a parameter: a sum for an integral.
_AROUND = 9
#: The distributions by default.
_USUAL = Drivers()


def usual_driver(desired_mps: float) -> Driver:
    """The mean driver of the defaults, with a desired speed, m/s."""
    law = _USUAL
    return Driver(
        desired_mps=desired_mps, tau_s=law.tau_mean_s, accel_mps2=law.accel_mean_mps2,
        decel_mps2=law.decel_mean_mps2, min_gap_m=law.min_gap_mean_m,
        turn_lateral_mps2=0.5 * (law.turn_lateral_min_mps2 + law.turn_lateral_max_mps2), offset_m=0.0,
        lane_change_s=law.lane_change_mean_s,
    )  # fmt: skip


def _clipped(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


def draw_driver(config: Config, rng: np.random.Generator, *, lane_speed_mps: float) -> Driver:
    """A driver on a lane with traffic that drives at lane_speed_mps, m/s."""
    law, spawn, change = config.drivers, config.spawn, config.lane_change

    def draws(count: int) -> list[float]:
        return [_clipped(one, -TRUNCATED_AT, TRUNCATED_AT) for one in rng.standard_normal(count).tolist()]

    desired, tau, accel, decel, min_gap = draws(5)
    turn_lateral_mps2 = float(rng.uniform(law.turn_lateral_min_mps2, law.turn_lateral_max_mps2))
    offset, lane_change, wander = draws(3)
    desired_mps = lane_speed_mps * (law.desired_mean + law.desired_sd * desired)
    if desired_mps < spawn.min_speed_mps:  # they do not all desire the same
        desired_mps = spawn.min_speed_mps * (1.0 + law.desired_sd * abs(desired))
    return Driver(
        desired_mps=min(desired_mps, spawn.max_speed_mps),
        tau_s=max(0.6, law.tau_mean_s + law.tau_sd_s * tau),
        accel_mps2=_clipped(law.accel_mean_mps2 + law.accel_sd_mps2 * accel, 0.6, config.limits.accel_max_mps2),
        decel_mps2=_clipped(law.decel_mean_mps2 + law.decel_sd_mps2 * decel, 0.8, -config.limits.accel_min_mps2),
        min_gap_m=max(1.0, law.min_gap_mean_m + law.min_gap_sd_m * min_gap),
        turn_lateral_mps2=turn_lateral_mps2,
        offset_m=law.offset_sd_m * math.sqrt(1.0 - law.offset_lane_share) * offset,
        lane_change_s=_clipped(
            law.lane_change_mean_s + law.lane_change_sd_s * lane_change, change.min_duration_s, change.max_duration_s
        ),
        wander_m=law.lateral_wander_sd_m * float(np.exp(law.lateral_wander_spread * wander)),
        line_gap_m=float(rng.uniform(*LINE_GAP_M)),
    )


def start_speed(driver: Driver, config: Config, rng: np.random.Generator, *, gaining_share: float) -> float:
    """Speed at which a vehicle begins, m/s: about the desired one or, for a share of them, on the way to it."""
    above_sd = _clipped(float(rng.standard_normal()), -TRUNCATED_AT, TRUNCATED_AT)
    if rng.random() < gaining_share:
        above_sd = -float(rng.uniform(*_GAINING_SD))
    return max(_BEGINS_FROM * driver.desired_mps, driver.desired_mps + config.drivers.wander_sd_mps * above_sd)


def desired_speeds(
    driver: Driver, config: Config, rng: np.random.Generator, *, num_steps: int, step_s: float, at_least_mps: float
) -> FloatArray:
    """(T,) m/s desired speed at every step: the driver's own, with its wandering around it.

    at_least_mps: what the vehicle begins with; at the first step it is not above the desired speed.
    """
    wander = wandering(config, rng, num_steps=num_steps, step_s=step_s, at_least_mps=at_least_mps - driver.desired_mps)
    return with_wander(driver.desired_mps, wander)


def with_wander(desired_mps: FloatArray | float, wander_mps: FloatArray) -> FloatArray:
    """Desired speeds with their wandering, m/s."""
    least_mps = _WANDERS_TO * desired_mps
    return least_mps + np.abs(desired_mps + wander_mps - least_mps)  # turned back: none drives on at the very least


def wandering(
    config: Config, rng: np.random.Generator, *, num_steps: int, step_s: float, at_least_mps: float = -math.inf
) -> FloatArray:
    """(T,) m/s by which a desired speed wanders at every step (Ornstein-Uhlenbeck); at_least_mps: at the first one."""
    law = config.drivers
    kept, eased = float(np.exp(-step_s / law.wander_time_s)), float(np.exp(-step_s / _EASED_S))
    kick = law.wander_sd_mps * np.sqrt(1.0 - kept * kept) * rng.standard_normal(num_steps)
    at = max(law.wander_sd_mps * float(rng.standard_normal()), at_least_mps)
    level = at + law.wander_sd_mps * float(rng.standard_normal())  # no vehicle begins at a constant speed
    levels = trailing(level, np.full(num_steps - 1, kept), kick[1:])[1:]
    return trailing(at, np.full(num_steps - 1, eased), (1.0 - eased) * levels)


def free_speeds(driver: Driver, desired_mps: FloatArray, *, speed_mps: float, step_s: float) -> FloatArray:
    """(M,) m/s at the steps to come from a speed towards desired ones (M,) with no leader, as the IDM has it."""
    found = []
    for desired in desired_mps.tolist():
        gained = driver.accel_mps2 * max(1.0 - (speed_mps / desired) ** 4, -1.0) * step_s
        speed_mps = max(speed_mps + gained, 0.0)
        found.append(speed_mps)
    return np.array(found, dtype=np.float64)


@dataclass(frozen=True, eq=False, slots=True)
class LaneOffset:
    """d(s), the place in the lane along a path: cubic between knots (K,) m with values and slopes (K,).

    It is a function of the way driven, so that a vehicle that stands does not slide aside.
    """

    knots_m: FloatArray
    offset_m: FloatArray
    slope: FloatArray

    def at(self, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """D m and d' at arc lengths s (T,) m; straight on beyond the knots."""
        inside = np.clip(s, self.knots_m[0], self.knots_m[-1])
        row = np.clip(np.searchsorted(self.knots_m, inside, side="right") - 1, 0, self.knots_m.size - 2)
        width = self.knots_m[row + 1] - self.knots_m[row]
        u = (inside - self.knots_m[row]) / width
        y0, y1 = self.offset_m[row], self.offset_m[row + 1]
        m0, m1 = self.slope[row] * width, self.slope[row + 1] * width
        rise = 3.0 * (y1 - y0) - 2.0 * m0 - m1
        fall = 2.0 * (y0 - y1) + m0 + m1
        return (
            np.asarray(y0 + u * (m0 + u * (rise + u * fall))),
            np.asarray((m0 + u * (2.0 * rise + 3.0 * u * fall)) / width),
        )

    def scaled(self, share: float) -> "LaneOffset":
        """The same with a share of the offset."""
        return LaneOffset(self.knots_m, share * self.offset_m, share * self.slope)

    def shifted(self, aside_m: float) -> "LaneOffset":
        """The same so far to the left, as far as a driver goes aside."""
        aside = np.clip(self.offset_m + aside_m, -OFFSET_MAX_M, OFFSET_MAX_M)
        return LaneOffset(self.knots_m, aside, np.where(np.abs(aside) < OFFSET_MAX_M, self.slope, 0.0))

    def held(self, start_m: float, end_m: float) -> "LaneOffset":
        """The same, waiting over a stretch: a vehicle that changes lanes does not weave besides."""
        row = max(int(np.searchsorted(self.knots_m, start_m, side="right")) - 1, 0)
        waits_m = max(end_m - float(self.knots_m[row]), 0.0)
        slope = np.insert(self.slope, row + 1, 0.0)
        slope[row] = 0.0
        return LaneOffset(
            np.concatenate([self.knots_m[: row + 1], self.knots_m[row:] + waits_m]),
            np.insert(self.offset_m, row + 1, self.offset_m[row]),
            slope,
        )


#: The middle of the lane, all along.
MIDDLE = LaneOffset(np.array([0.0, 1.0]), np.zeros(2), np.zeros(2))


def place_of_lane(law: Drivers, lane_id: int) -> float:
    """Place of vehicles in a lane that none is recorded on, d m, left positive: drawn for the lane, one for all."""
    drawn = float(np.random.default_rng(abs(lane_id)).standard_normal())
    return law.offset_mean_m + law.offset_sd_m * math.sqrt(law.offset_lane_share) * drawn


def lane_offset(
    driver: Driver, config: Config, rng: np.random.Generator, *, length_m: float, pace_mps: float,
    usual: Callable[[FloatArray], FloatArray],
) -> LaneOffset:  # fmt: skip
    """The driver's place along a path of length_m: beside the usual one there, with a wandering about it.

    pace_mps: at which it drives about, as the wandering has a correlation time; usual: d m of the lanes' vehicles at
    arc lengths m; a driver goes from one to the next no quicker than it wanders.
    """
    spacing = max(_OFFSET_SPACING_M, pace_mps * config.drivers.lateral_wander_time_s)
    count = max(4, int(length_m / spacing) + 3)
    knots = spacing * (np.arange(count) - rng.uniform())
    kept = float(np.exp(-1.0))
    value, rest = rng.standard_normal(count).tolist(), math.sqrt(1.0 - kept * kept)
    for row in range(1, count):
        value[row] = kept * value[row - 1] + rest * value[row]
    around = knots[:, None] + spacing * np.linspace(-1.0, 1.0, _AROUND)
    offset = usual(around.ravel()).reshape(around.shape).mean(axis=1) + driver.offset_m
    offset += driver.wander_m * np.clip(value, -TRUNCATED_AT, TRUNCATED_AT)
    offset = np.clip(offset, -OFFSET_MAX_M, OFFSET_MAX_M)
    return LaneOffset(
        np.asarray(knots, dtype=np.float64), offset, np.asarray(np.gradient(offset, knots), dtype=np.float64)
    )
