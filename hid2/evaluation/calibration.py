"""How people drive, measured: the parameters of `params.Drivers` from windows of recorded driving.

Each parameter is estimated from one value a driver (track), so that a longer track counts no more,
with a bootstrap over drivers. The two wanderings are found by simulated moments: the law itself is run for many
drivers, and the one with windows that vary as recorded is taken. What fewer than LEAST drivers tell keeps its
documented prior and says so.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from functools import cache
from typing import Literal, NamedTuple

import numpy as np

from hid2.agents import FloatArray, IntArray
from hid2.drivers.driver import TRUNCATED_AT, Driver, desired_speeds, lane_offset
from hid2.evaluation.windows import TURNS_RAD, WINDOW_S, Windows, lateral_accel_mps2, polynomial_fit, windows
from hid2.measures.arrays import STANDS_MPS
from hid2.measures.following import MIN_SPEED_MPS, leaders
from hid2.measures.manoeuvres import detect, whole_lane_changes
from hid2.occupancy.agent_states import AgentStates
from hid2.params import Config, Drivers
from hid2.resampling import interval, redrawn

# Which windows tell what, which moments are measured, and how finely laws are compared: no tunables. Calibrations with
# other numbers differ, and would not match the sources in `params.Drivers`, which are figures made with these.
LEAST = 12  # least number of drivers that tell something: with fewer the prior stays
_QUEUE_M = 10.0  # gap below which a leader that stands is in the same queue, m
_SHOWS_MPS2 = 0.7  # acceleration or deceleration in some window above which a driver shows how it drives, m/s2
_UNIT_MPS = 0.3  # SD of the wandering at which moments of the speed are simulated, m/s: too small for bounds to matter
#: Steady following: most closing speed, m/s, and acceleration, m/s2; least speed, m/s; most time gap, s. No tunables.
_STEADY_MPS, _STEADY_MPS2, _FOLLOWS_MPS, _FOLLOWS_S = 1.0, 0.5, 3.0, 3.0
#: Drivers simulated for a moment; half of a window, s, and its intervals: finer ones change no fit. No tunables.
_SIMULATED, _HALF_S, _HALF = 250, 2.0, 20
_EVERY_S = _HALF_S / _HALF
_TIME_S = np.asarray(_EVERY_S * np.arange(2 * _HALF + 1) - _HALF_S, dtype=np.float64)
#: Cruising: least share of the usual speed, and bound of the acceleration, m/s2: no signal decides. No tunables.
_CRUISES, _CRUISES_MPS2 = 0.7, 1.0
#: Candidates for the time constants, s, and for the spread of the lateral wandering. No tunables.
_TIMES_S = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0)
_SPREADS = (0.0, 0.3, 0.6, 0.9, 1.2)


class SceneDriving(NamedTuple):
    """What a recorded scene shows of driving.

    standing_gap_m: gaps to standing leaders, one a driver; lane_change_s: durations of lane changes seen whole.
    """

    name: str
    city: str
    labelled: bool
    windows: Windows
    standing_gap_m: FloatArray
    lane_change_s: FloatArray


class CalibratedQuantity(NamedTuple):
    """One parameter: its value, and, where it was measured, a 95 % interval and from how many drivers."""

    parameter: str
    value: float
    low: float | None
    high: float | None
    drivers: int
    source: Literal["measured", "prior"]
    what: str


def observe(states: AgentStates, *, name: str, city: str, labelled: bool) -> SceneDriving:
    """What the clean tracks of moving vehicles of a recorded scene show."""
    arrays, led = states.arrays, leaders(states)
    speed = np.hypot(arrays.velocity[:, 0], arrays.velocity[:, 1])
    rows = np.flatnonzero((led.agent >= 0) & arrays.clean[arrays.agent] & (speed < STANDS_MPS))
    ahead, gap = arrays.row_of[led.agent[rows], arrays.step[rows]], led.gap_m[rows]
    queue = (ahead >= 0) & (speed[ahead] < STANDS_MPS) & (gap > 0.0) & (gap < _QUEUE_M)
    return SceneDriving(
        name, city, labelled, windows(states, led, scene=name, labelled=labelled),
        standing_gap_m=_by_driver(arrays.agent[rows[queue]], gap[queue], np.median),
        lane_change_s=np.array([one.duration_s for one in whole_lane_changes(detect(states))], dtype=np.float64),
    )  # fmt: skip


def calibrate(scenes: Sequence[SceneDriving], *, prior: Drivers) -> list[CalibratedQuantity]:
    """Every parameter that recorded scenes can tell, in the order of `params.Drivers`."""
    seen = np.concatenate([one.windows for one in scenes])
    standing_gap_m, lane_change_s = (np.concatenate(parts) for parts in list(zip(*scenes, strict=True))[-2:])
    # drivers of all scenes are numbered through
    scene = np.unique(seen["scene"], return_inverse=True)[1]
    seen["agent"] += scene * (1 + seen["agent"].max(initial=0))
    seen["speed_mps"] = np.maximum(seen["speed_mps"], MIN_SPEED_MPS)  # one that stops has none in the middle, or less
    # of turns those that are driven: in a lane flagged as one, and at the edge of one, many hardly turn
    straight, turns = seen[~seen["turning"]], seen[np.abs(seen["yaw_radps"]) * WINDOW_S > TURNS_RAD]
    is_free = np.isinf(straight["gap_m"]) | (straight["gap_m"] > 4.0 * straight["speed_mps"])
    free, usual_mps = straight[is_free], _usual_mps(straight)[is_free]
    cruising = (free["speed_mps"] > _CRUISES * usual_mps) & (np.abs(free["accel_mps2"]) < _CRUISES_MPS2)
    ratio = _by_driver(free["agent"], np.log(free["speed_mps"] / usual_mps), np.median)
    jam_gap_m = float(np.median(standing_gap_m)) if len(standing_gap_m) >= LEAST else prior.min_gap_mean_m
    time_gap = (seen["gap_m"] - jam_gap_m) / seen["speed_mps"]
    follows = (seen["speed_mps"] > _FOLLOWS_MPS) & (time_gap > 0.0) & (time_gap < _FOLLOWS_S)
    steady = follows & (np.abs(seen["closing_mps"]) < _STEADY_MPS) & (np.abs(seen["accel_mps2"]) < _STEADY_MPS2)
    gaps = _by_driver(seen["agent"][steady], time_gap[steady], np.median)
    strongest = _by_driver(seen["agent"], seen["accel_mps2"], np.max)
    hardest = -_by_driver(seen["agent"], seen["accel_mps2"], np.min)
    turning = _by_driver(turns["agent"], np.abs(lateral_accel_mps2(turns)), np.max)
    offsets = _by_driver(straight["agent"], straight["offset_m"], np.median)
    cruises, positions = free[cruising], "positions do not tell it"
    measured: list[tuple[tuple[str, ...], str, Sequence[FloatArray], Callable[..., Sequence[float]]]] = [
        (("desired_sd",), "desired speed over the traffic's, logarithm", [ratio], lambda one: [robust_sd(one)]),
        (("wander_sd_mps", "wander_time_s"), "wandering of the desired speed: acceleration in windows, m/s2",
         [_rms(cruises["agent"], cruises[name]) for name in ("accel_mps2", "jerk_mps3")], _speed_wander),
        (("tau_mean_s", "tau_sd_s"), "time gap in steady following, s", [gaps], _median_and_sd),
        (("accel_mean_mps2", "accel_sd_mps2"), "strongest acceleration of a driver, m/s2",
         [strongest[strongest > _SHOWS_MPS2]], _median_and_sd),
        (("decel_mean_mps2", "decel_sd_mps2"), "hardest braking of a driver, m/s2",
         [hardest[hardest > _SHOWS_MPS2]], _median_and_sd),
        (("min_gap_mean_m", "min_gap_sd_m"), "gap to a standing leader, m", [standing_gap_m], _median_and_sd),
        (("turn_lateral_min_mps2", "turn_lateral_max_mps2"), "lateral acceleration in turns, m/s2", [turning], _range),
        (("offset_mean_m", "offset_sd_m"), "place in the lane, m, left positive", [offsets], _median_and_sd),
        (("lateral_wander_sd_m", "lateral_wander_time_s", "lateral_wander_spread"),
         "wandering about the place in the lane: drift in windows, m/s",
         [_rms(straight["agent"], straight[name]) for name in ("drift_mps", "bend_mps2")], _lateral_wander),
        (("lane_change_mean_s", "lane_change_sd_s"), "duration of lane changes, s", [lane_change_s], _median_and_sd),
    ]  # fmt: skip
    return [
        *(one for quantities in measured for one in _measured(*quantities, prior)),
        _kept("desired_mean", f"desired speed over the cruising speed: {positions}", prior),
        _kept("reaction_s", f"reaction time: {positions}", prior),
        _kept("error", f"perception error: {positions}", prior),
    ]


def _usual_mps(seen: Windows) -> FloatArray:
    """(M,) of each window what its scene's traffic drives: the median over drivers of the median speed of each.

    Drivers are numbered through all scenes.
    """
    number, first = np.unique(seen["scene"], return_inverse=True)[1], np.unique(seen["agent"], return_index=True)[1]
    medians = _by_driver(seen["agent"], seen["speed_mps"], np.median)
    return np.maximum(1.0, _by_driver(number[first], medians, np.median))[number]


def drivers_of(found: Sequence[CalibratedQuantity]) -> dict[str, float]:
    """Values of the parameters, by name, as `params.Drivers` has them; those that were measured."""
    return {quantity.parameter: quantity.value for quantity in found if quantity.source == "measured"}


def _kept(name: str, what: str, prior: Drivers, drivers: int = 0) -> CalibratedQuantity:
    """A parameter that keeps its prior."""
    return CalibratedQuantity(name, float(getattr(prior, name)), None, None, drivers, "prior", what)


def _by_driver(driver: IntArray, values: FloatArray, pool: Callable[[FloatArray], float]) -> FloatArray:
    """(D,) one value a driver, in the order of their numbers."""
    order = np.argsort(driver, kind="stable")
    parts = np.split(values[order], np.flatnonzero(np.diff(driver[order])) + 1)
    return np.array([pool(one) for one in parts if one.size], dtype=np.float64)


def robust_sd(values: FloatArray) -> float:
    """1.4826 times the median distance from the median: the SD of a normal distribution, whatever its outliers do."""
    return float(1.4826 * np.median(np.abs(values - np.median(values))))


def _bounded(name: str, value: float) -> float:
    """A value inside what `params.Drivers` allows, to four digits: a digit above a bound that it excludes."""
    bounds = {kind: bound for one in Drivers.model_fields[name].metadata for kind, bound in asdict(one).items()}
    return round(float(np.clip(value, bounds.get("ge", bounds.get("gt", 0.0) + 1e-4), bounds["le"])), 4)


def _measured(
    names: Sequence[str], what: str, values: Sequence[FloatArray], law: Callable[..., Sequence[float]], prior: Drivers
) -> list[CalibratedQuantity]:
    """Parameters that are measured together; of too few drivers, or where draws give no number, they keep their prior.

    values: (D,) each, of every driver; law: the parameters by the values of some drivers.
    """
    drivers = len(values[0])
    if drivers < LEAST:
        return [_kept(name, what, prior, drivers) for name in names]
    every = np.arange(drivers)

    def of_drawn(times: FloatArray) -> FloatArray:
        drawn = np.repeat(every, times.astype(np.int64))
        return np.asarray(law(*(one[drawn] for one in values)))

    estimates = [
        interval(value, column) for value, column in zip(law(*values), redrawn(of_drawn, drivers).T, strict=True)
    ]
    found = []
    for name, (value, low, high) in zip(names, estimates, strict=True):
        if value is None or low is None or high is None:
            return [_kept(name, what, prior, drivers) for name in names]
        low, high = _bounded(name, low), _bounded(name, high)
        found.append(CalibratedQuantity(name, _bounded(name, value), low, high, drivers, "measured", what))
    return found


def _median_and_sd(values: FloatArray) -> tuple[float, float]:
    """Median and robust SD."""
    return float(np.median(values)), robust_sd(values)


def _range(values: FloatArray) -> tuple[float, float]:
    """Ends of a uniform distribution: between the 10th and 90th percentile, widened to the whole; NaN if below 0."""
    low, high = np.percentile(values, [10, 90])
    low, high = low - (high - low) / 8.0, high + (high - low) / 8.0
    return float(low) if low > 0.0 else np.nan, float(high)


_DRIVER = Driver(
    desired_mps=8.0, tau_s=1.2, accel_mps2=1.6, decel_mps2=2.0, min_gap_m=2.0, turn_lateral_mps2=2.0, offset_m=0.0,
    lane_change_s=5.5, wander_m=1.0,
)  # fmt: skip


class _Moments(NamedTuple):
    """Size of a rate and of its change, medians over drivers of the root mean square; spread of the logarithm."""

    size: float
    ratio: float
    spread: float


def _rms(driver: IntArray, values: FloatArray) -> FloatArray:
    """(D,) root mean square of the values of each driver."""
    return np.maximum(_by_driver(driver, values, lambda v: float(np.sqrt(np.mean(v * v)))), 1e-4)


def _moments(rates: FloatArray, changes: FloatArray) -> _Moments:
    """Moments of two quantities, one value (D,) a driver."""
    return _Moments(float(np.median(rates)), float(np.median(changes) / np.median(rates)), robust_sd(np.log(rates)))


def _simulated(drive: Callable[[], Sequence[tuple[float, float]]]) -> _Moments:
    """Moments of many simulated drivers. drive: rate and change in each window of the next one."""
    windows = [(number, *window) for number in range(_SIMULATED) for window in drive()]
    number, rate, change = (np.array(column) for column in zip(*windows, strict=True))
    return _moments(_rms(number, rate), _rms(number, change))


@cache
def speed_moments(time_s: float) -> _Moments:
    """Moments of acceleration and jerk in windows of simulated drivers: desired speeds wander by _UNIT_MPS."""
    config, rng = Config(drivers=Drivers(wander_time_s=time_s, wander_sd_mps=_UNIT_MPS)), np.random.default_rng(1)
    cubic = polynomial_fit(_TIME_S, 3)

    def drive() -> list[tuple[float, float]]:
        v = desired_speeds(_DRIVER, config, rng, num_steps=4 * _HALF + 1, step_s=_EVERY_S, at_least_mps=0.0)
        s = np.concatenate([[0.0], np.cumsum(0.5 * _EVERY_S * (v[1:] + v[:-1]))])
        fits = [cubic @ s[begin : begin + 2 * _HALF + 1] for begin in (0, _HALF, 2 * _HALF)]
        return [(2.0 * fit[2], 6.0 * fit[3]) for fit in fits]

    return _simulated(drive)


@cache
def lateral_moments(time_s: float, spread: float) -> _Moments:
    """Moments of drift and bend in windows of simulated drivers that wander by 1 m in the median, without a bound.

    The speed does not matter: the place in the lane changes with the way driven in a correlation time.
    """
    config, rng = Config(drivers=Drivers(lateral_wander_time_s=time_s)), np.random.default_rng(2)
    speed_mps = _DRIVER.desired_mps
    parabola = polynomial_fit(_TIME_S, 2)
    length_m = speed_mps * _EVERY_S * (4 * _HALF + 1) + 10.0

    def drive() -> list[tuple[float, float]]:
        # a hundredth, so that the bound on the offset does not matter
        wander = 0.01 * float(np.exp(spread * np.clip(rng.standard_normal(), -TRUNCATED_AT, TRUNCATED_AT)))
        offset = lane_offset(
            replace(_DRIVER, wander_m=wander), config, rng, length_m=length_m, pace_mps=speed_mps, usual=np.zeros_like
        )
        middles = (_HALF_S, 2.0 * _HALF_S, 3.0 * _HALF_S)
        fits = [parabola @ offset.at(5.0 + speed_mps * (middle + _TIME_S))[0] for middle in middles]
        return [(100.0 * fit[1], 100.0 * fit[2]) for fit in fits]

    return _simulated(drive)


def _speed_wander(rates: FloatArray, changes: FloatArray) -> tuple[float, float]:
    """SD and time of the wandering of the desired speed, by acceleration and jerk in free driving."""
    table, moments = [speed_moments(time_s) for time_s in _TIMES_S], _moments(rates, changes)
    time_s = _time_of(moments.ratio, np.array([one.ratio for one in table]))
    return moments.size / float(np.interp(time_s, _TIMES_S, [one.size / _UNIT_MPS for one in table])), time_s


def _lateral_wander(rates: FloatArray, changes: FloatArray) -> tuple[float, float, float]:
    """SD, time and spread of the wandering about the place in the lane, by drift and bend."""
    moments = _moments(rates, changes)
    spread = 0.6
    for _ in range(3):
        near = min(_SPREADS, key=lambda w: abs(w - spread))
        time_s = _time_of(moments.ratio, np.array([lateral_moments(t, near).ratio for t in _TIMES_S]))
        nearest = min(_TIMES_S, key=lambda t: abs(t - time_s))
        spreads = np.maximum.accumulate([lateral_moments(nearest, w).spread for w in _SPREADS])
        spread = float(np.interp(moments.spread, spreads, _SPREADS))
    near = min(_SPREADS, key=lambda w: abs(w - spread))
    size = float(np.interp(time_s, _TIMES_S, [lateral_moments(t, near).size for t in _TIMES_S]))
    return moments.size / size, time_s, spread


def _time_of(ratio: float, ratios: FloatArray) -> float:
    """Time constant with the seen ratio of change to rate in simulation; ratios fall with time."""
    return float(np.interp(-ratio, -np.minimum.accumulate(ratios), _TIMES_S))
