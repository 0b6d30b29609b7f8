from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from inserted import DRIVER

from hid2.agents import FloatArray
from hid2.drivers.driver import (
    Driver,
    LaneOffset,
    desired_speeds,
    draw_driver,
    free_speeds,
    lane_offset,
    place_of_lane,
    start_speed,
)
from hid2.params import Config, Drivers, Limits, Spawn

#: Every value that a number below is worked from; the defaults may be tuned.
CONFIG = Config(
    drivers=Drivers(
        desired_mean=1.1, desired_sd=0.1, wander_sd_mps=0.6, wander_time_s=3.0, tau_mean_s=1.15, tau_sd_s=0.25,
        offset_mean_m=0.0, offset_sd_m=0.25, lateral_wander_sd_m=0.15, lateral_wander_spread=0.5,
        lateral_wander_time_s=3.0,
    ),
    spawn=Spawn(min_speed_mps=4.0, max_speed_mps=20.0),
    limits=Limits(),
)  # fmt: skip


#: Wanders 0.15 m about the middle of the lane; desires more than the 10 m/s that it drives at.
WEAVES = replace(DRIVER, desired_mps=14.0, offset_m=0.0, wander_m=0.15)


def _offset(driver: Driver, seed: int, usual: Callable[[FloatArray], FloatArray] = np.zeros_like) -> LaneOffset:
    return lane_offset(driver, CONFIG, np.random.default_rng(seed), length_m=200.0, pace_mps=10.0, usual=usual)


@pytest.mark.parametrize("lane_speed", [3.0, 19.0])
def test_draws_stay_within_two_standard_deviations_and_the_bounds(lane_speed: float) -> None:
    """Desired speed: 10 m/s times 0.9 to 1.3, and never below 4 or above 20 m/s; tau 0.65 to 1.65 s."""
    rng = np.random.default_rng(0)
    drivers = [draw_driver(CONFIG, rng, lane_speed_mps=lane_speed) for _ in range(400)]
    desired = np.array([driver.desired_mps for driver in drivers])
    assert desired.min() >= max(4.0, 0.9 * lane_speed) - 1e-9
    assert desired.max() <= min(20.0, max(1.2 * 4.0, 1.3 * lane_speed)) + 1e-9
    assert (desired == 4.0).mean() < 0.1  # they do not all wish the least
    assert all(0.65 - 1e-9 <= driver.tau_s <= 1.65 + 1e-9 for driver in drivers)
    assert all(abs(driver.offset_m) <= 0.5 for driver in drivers)
    # SD of the wandering: 0.15 m times exp(-1) to exp(1)
    assert all(0.055 < driver.wander_m < 0.41 for driver in drivers)
    assert all(driver.accel_mps2 <= 2.40 for driver in drivers)
    assert all(driver.decel_mps2 <= 4.05 for driver in drivers)
    assert all(2.5 <= driver.lane_change_s <= 6.0 for driver in drivers)


def test_none_is_drawn_beyond_what_drivers_do() -> None:
    """Two SD below the means come to 0.2 s, 0.1 and 0.2 m/s2 and 0.2 m: cut off at 0.6 s, 0.6 and 0.8 m/s2 and 1 m."""
    law = Drivers(
        tau_mean_s=0.8, tau_sd_s=0.3, accel_mean_mps2=0.7, accel_sd_mps2=0.3, decel_mean_mps2=1.0, decel_sd_mps2=0.4,
        min_gap_mean_m=1.2, min_gap_sd_m=0.5,
    )  # fmt: skip
    rng, config = np.random.default_rng(0), CONFIG.model_copy(update={"drivers": law})
    drivers = [draw_driver(config, rng, lane_speed_mps=10.0) for _ in range(100)]
    assert min(driver.tau_s for driver in drivers) == 0.6
    assert min(driver.accel_mps2 for driver in drivers) == 0.6
    assert min(driver.decel_mps2 for driver in drivers) == 0.8
    assert min(driver.min_gap_m for driver in drivers) == 1.0


def test_desired_speed_wanders_slowly_about_the_own_one() -> None:
    """SD 0.6 m/s at every step alike; eased over 0.8 s, the process keeps sqrt(3 / 3.8) = 89 % of it: 0.53 m/s.

    Ornstein-Uhlenbeck with 3 s: correlated by exp(-1) = .37 after 3 s, more with the easing; hardly after 9 s. Its rate
    has an SD of 0.6 sqrt(0.8 / 3.8) / 0.8 = 0.34 m/s2 as recorded vehicles have it, from the first step on.
    """
    rng = np.random.default_rng(0)
    rows = [desired_speeds(DRIVER, CONFIG, rng, num_steps=110, step_s=0.1, at_least_mps=0.0) for _ in range(400)]
    wander = np.array(rows) - DRIVER.desired_mps
    assert abs(wander.mean()) < 0.05
    assert 0.45 < wander[:, 60:].std() <= 0.66
    assert 0.45 < wander[:, :10].std() <= 0.66

    def correlation(steps: int) -> float:
        return float(np.corrcoef(wander[:, 10:-steps].ravel(), wander[:, 10 + steps :].ravel())[0, 1])

    assert correlation(1) > 0.98
    assert 0.3 < correlation(30) < 0.6
    assert correlation(90) < 0.25
    rate = np.diff(wander, axis=1) / 0.1
    assert rate[:, 60:].std() == pytest.approx(0.34, abs=0.05)
    assert (np.abs(rate[:, 0]) > 0.05).mean() > 0.9


def test_a_share_of_the_vehicles_begins_while_it_gains_speed() -> None:
    """DRIVER wants 10 m/s, SD of the wandering .6: 2 SD about it or, a share, 1 to 6 SD below it, from .3 of it on."""
    rng = np.random.default_rng(0)
    even, wild = (CONFIG.model_copy(update={"drivers": Drivers(wander_sd_mps=sd)}) for sd in (0.0, 3.0))

    def speeds(config: Config, share: float) -> FloatArray:
        found = [start_speed(DRIVER, config, rng, gaining_share=share) for _ in range(1000)]
        return np.array(found, dtype=np.float64)

    assert (speeds(CONFIG, 0.0).min(), speeds(CONFIG, 0.0).max()) == pytest.approx((8.8, 11.2), abs=0.02)
    assert (speeds(CONFIG, 1.0).min(), speeds(CONFIG, 1.0).max()) == pytest.approx((6.4, 9.4), abs=0.02)
    assert (speeds(CONFIG, 0.5) < 8.8 - 1e-9).mean() == pytest.approx(0.5 * 0.8, abs=0.04)
    assert set(speeds(even, 1.0)) == {10.0}
    assert speeds(wild, 1.0).min() == pytest.approx(3.0)


def test_nobody_begins_above_the_desired_speed_which_never_falls_below_four_fifths() -> None:
    """A start at 10.5 m/s of a driver who wants 10: the wandering begins at + 0.5 m/s or above."""
    rng = np.random.default_rng(0)
    speeds = [desired_speeds(DRIVER, CONFIG, rng, num_steps=110, step_s=0.1, at_least_mps=10.5) for _ in range(100)]
    assert min(one[0] for one in speeds) == pytest.approx(10.5)
    wild = CONFIG.model_copy(update={"drivers": Drivers(wander_sd_mps=3.0)})
    speeds = [desired_speeds(DRIVER, wild, rng, num_steps=110, step_s=0.1, at_least_mps=0.0) for _ in range(100)]
    assert min(one.min() for one in speeds) >= 8.0
    assert np.mean([np.isclose(np.diff(one), 0.0).mean() for one in speeds]) < 0.01  # none drives on at just that


def test_free_speed_goes_towards_the_wish_as_the_model_has_it() -> None:
    """1.6 m/s2 for .1 s. From 5 m/s to 10: 5 + .16 (1 - .5^4) = 5.15, then 5.15 + .16 (1 - .515^4) = 5.2987 m/s.

    From 20 m/s the share 1 - 2^4 is cut off at -1: 19.84 m/s. From .1 m/s to a wish of .01 it stands, at 0.
    """
    assert free_speeds(DRIVER, np.full(2, 10.0), speed_mps=5.0, step_s=0.1) == pytest.approx([5.15, 5.2987], abs=1e-4)
    assert free_speeds(DRIVER, np.array([10.0]), speed_mps=20.0, step_s=0.1) == pytest.approx([19.84])
    assert free_speeds(DRIVER, np.array([0.01]), speed_mps=0.1, step_s=0.1).tolist() == [0.0]


def test_place_in_the_lane_is_smooth_correlated_and_within_two_standard_deviations_and_the_bound() -> None:
    """At most 2 SD = 0.3 m beside the driver's own place (here the middle), knots 3 s apart; d' is that of d.

    From knot to knot correlated by exp(-1) = .37, exp(-2) = .14 with that before; SD .15 m, cut off at two SD: .13 m.
    Place 0.8 m to the left and a wandering of 0.4 m: cut off at 0.9 m.
    """
    for seed in range(30):
        offset = _offset(WEAVES, seed)
        assert np.diff(offset.knots_m) == pytest.approx(np.full(offset.knots_m.size - 1, 30.0))
        assert np.abs(offset.offset_m).max() <= 0.3 + 1e-9
        s = np.arange(5.0, 195.0, 0.1)
        d, slope = offset.at(s)
        assert np.gradient(d, 0.1)[1:-1] == pytest.approx(slope[1:-1], abs=2e-4)
        assert np.abs(slope).max() < 0.05
    d = np.array([_offset(WEAVES, seed).offset_m[:8] for seed in range(300)])
    one, two = (np.corrcoef(d[:, :-lag].ravel(), d[:, lag:].ravel())[0, 1] for lag in (1, 2))
    assert [one, two, d.std()] == pytest.approx([0.37, 0.14, 0.14], abs=0.06)
    wide = replace(DRIVER, offset_m=0.8, wander_m=0.4)
    assert max(np.abs(_offset(wide, seed).offset_m).max() for seed in range(30)) == pytest.approx(0.9)


def test_place_is_beside_the_usual_one_and_goes_over_to_another_no_quicker_than_it_wanders() -> None:
    """Usual place 0 m, from 100 m on .5 m, the own .1 m beside it; over two of the 30 m between knots at the least."""
    own = replace(DRIVER, offset_m=0.1, wander_m=0.0)
    offset = _offset(own, 0, usual=lambda s: np.where(s < 100.0, 0.0, 0.5))
    assert offset.at(np.array([5.0, 195.0]))[0] == pytest.approx([0.1, 0.6], abs=2e-3)
    assert 0.3 / 60.0 < np.abs(offset.at(np.arange(0.0, 200.0))[1]).max() < 0.5 / 30.0


def test_lanes_differ_from_each_other_by_their_share() -> None:
    """SD .39 m in all, .62 of its variance the lane's: .31 m between lanes, .24 m between vehicles on one."""
    law = Drivers(offset_mean_m=0.1, offset_sd_m=0.39, offset_lane_share=0.62)
    places = np.array([place_of_lane(law, lane_id) for lane_id in range(2000)])
    assert [places.mean(), places.std()] == pytest.approx([0.1, 0.307], abs=0.02)
    config = CONFIG.model_copy(update={"drivers": law})
    drawn = [draw_driver(config, np.random.default_rng(seed), lane_speed_mps=9.0).offset_m for seed in range(2000)]
    assert [np.mean(drawn), np.std(drawn)] == pytest.approx([0.0, 0.24], abs=0.02)


def test_wandering_waits_over_a_lane_change() -> None:
    """Knots at 0, 20, 40 m with 0, .4, .2 m: held over 30 to 60 m it stays at .4 from 20 m on, and is at .2 at 80 m."""
    offset = LaneOffset(np.array([0.0, 20.0, 40.0]), np.array([0.0, 0.4, 0.2]), np.array([0.0, 0.01, 0.0]))
    held = offset.held(30.0, 60.0)
    assert offset.scaled(0.5).at(np.array([20.0]))[0] == pytest.approx([0.2])
    d, slope = held.at(np.array([20.0, 30.0, 45.0, 60.0, 80.0]))
    assert d == pytest.approx([0.4, 0.4, 0.4, 0.4, 0.2])
    assert slope == pytest.approx(np.zeros(5))
    before = np.linspace(0.0, 20.0, 9)
    assert np.ptp(np.diff(held.at(before)[0])) < 0.06


def test_some_hold_the_lane_and_some_weave() -> None:
    """Truncated at two deviations, the logarithm of the wandering has an SD of 0.88 * 0.5 = 0.44."""
    rng = np.random.default_rng(0)
    weave = [draw_driver(CONFIG, rng, lane_speed_mps=10.0).wander_m for _ in range(2000)]
    assert np.log(weave).std() == pytest.approx(0.47, abs=0.03)
