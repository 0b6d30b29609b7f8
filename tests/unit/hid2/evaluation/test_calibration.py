"""Calibration: parameters of drivers that are known are found again; what nothing tells stays and says so."""

import numpy as np
import pytest
from synthetic_driving import KNOWN, synthetic_driving

from hid2.evaluation.calibration import LEAST, SceneDriving, _bounded, calibrate, drivers_of, robust_sd
from hid2.evaluation.windows import WINDOW
from hid2.params import Drivers


@pytest.fixture(scope="module")
def found():
    seen = synthetic_driving(KNOWN, drivers=150, seed=3)
    return {quantity.parameter: quantity for quantity in calibrate([seen], prior=Drivers())}


@pytest.mark.parametrize(
    "name",
    ["desired_sd", "tau_mean_s", "tau_sd_s", "offset_mean_m", "offset_sd_m", "lateral_wander_sd_m",
     "lateral_wander_time_s", "lateral_wander_spread", "wander_sd_mps", "wander_time_s", "min_gap_mean_m",
     "lane_change_mean_s", "lane_change_sd_s"],
)  # fmt: skip
def test_known_parameter_is_found_within_its_interval(found, name):
    """Cut off at 2 SD, draws spread up to 12 % less: slack but for means. Time gaps begin at the measured jam gap."""
    quantity, known = found[name], getattr(KNOWN, name)
    assert quantity.source == "measured"
    slack = 0.0 if "mean" in name else 0.12 * abs(known)
    assert quantity.low - slack <= known <= quantity.high + slack, quantity
    assert quantity.low <= quantity.value <= quantity.high


def test_what_the_data_cannot_tell_keeps_its_prior(found):
    """No turns, no accelerations from rest, and no positions that show a reaction time."""
    for name in ("reaction_s", "error", "turn_lateral_min_mps2"):
        assert found[name].source == "prior"
        assert found[name].value == getattr(Drivers(), name)
    assert not {"reaction_s", "turn_lateral_max_mps2"} & drivers_of(list(found.values())).keys()
    assert drivers_of(list(found.values()))["tau_mean_s"] == found["tau_mean_s"].value


@pytest.mark.parametrize(
    ("accels", "wanted"),
    [(np.linspace(0.6, 2.6, 21), ("measured", 0.6)), (np.repeat([0.5, 4.5], [18, 3]), ("prior", 1.5))],
)
def test_range_that_would_begin_at_no_lateral_acceleration_keeps_its_prior(accels, wanted):
    """0.8 to 2.4 in the middle 80 %: 0.6 to 2.6; 0.5 to 4.5: from 0 on. Vehicles in a turn's lane that do not turn."""
    seen = np.zeros(2 * accels.size, dtype=WINDOW)
    seen["agent"], seen["speed_mps"], seen["turning"], seen["scene"] = np.arange(seen.size), 5.0, True, "s"
    seen["yaw_radps"][: accels.size], seen["gap_m"] = accels / 5.0, np.inf
    found = calibrate([SceneDriving("s", "c", False, seen, np.zeros(0), np.zeros(0))], prior=Drivers())
    (one,) = [one for one in found if one.parameter == "turn_lateral_min_mps2"]
    assert (one.source, one.value) == (wanted[0], pytest.approx(wanted[1]))


def test_a_window_that_stops_in_its_middle_leaves_the_desired_speeds_measurable():
    """A cubic through a stop may be at -.1 m/s there, which has no logarithm: the vehicle counts with 1 m/s."""
    seen = np.zeros(13, dtype=WINDOW)
    seen["agent"], seen["scene"], seen["gap_m"], seen["speed_mps"] = np.arange(13), "s", np.inf, [-0.1, *[8.0, 9.0] * 6]
    found = calibrate([SceneDriving("s", "c", False, seen, np.zeros(0), np.zeros(0))], prior=Drivers())
    (one,) = [one for one in found if one.parameter == "desired_sd"]
    assert (one.source, one.value) == ("measured", pytest.approx(1.4826 * np.log(9 / 8), abs=1e-4))


def test_value_at_a_bound_that_is_excluded_stays_inside():
    assert (_bounded("turn_lateral_min_mps2", 0.0), _bounded("offset_sd_m", -1.0)) == (1e-4, 0.0)


def test_too_few_drivers_tell_nothing_and_robust_spread_by_hand():
    """Distances from the median 3: 2, 1, 0, 1, 97; their median is 1."""
    assert robust_sd(np.array([1.0, 2.0, 3.0, 4.0, 100.0])) == pytest.approx(1.4826)
    seen = synthetic_driving(KNOWN, drivers=LEAST - 1, seed=0)
    few = calibrate([seen._replace(standing_gap_m=np.zeros(0), lane_change_s=np.array([4.0]))], prior=Drivers())
    assert {quantity.source for quantity in few} == {"prior"}
