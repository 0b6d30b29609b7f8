"""Calibration: parameters of drivers that are known are found again; what nothing tells stays and says so."""

import numpy as np
import pytest
from synthetic_driving import KNOWN, synthetic_driving

from hid2.evaluation.calibration import LEAST, calibrate, drivers_of, robust_sd
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
    """Draws are cut off at two deviations, which makes spreads smaller by up to 12 %: so much slack."""
    quantity, known = found[name], getattr(KNOWN, name)
    assert quantity.source == "measured"
    slack = 0.12 * abs(known)
    assert quantity.low - slack <= known <= quantity.high + slack, quantity
    assert quantity.low <= quantity.value <= quantity.high


def test_what_the_data_cannot_tell_keeps_its_prior(found):
    """No turns, no accelerations from rest, and no positions that show a reaction time."""
    for name in ("reaction_s", "error", "turn_lateral_min_mps2"):
        assert found[name].source == "prior"
        assert found[name].value == getattr(Drivers(), name)
    assert not {"reaction_s", "turn_lateral_max_mps2"} & drivers_of(list(found.values())).keys()
    assert drivers_of(list(found.values()))["tau_mean_s"] == found["tau_mean_s"].value


def test_too_few_drivers_tell_nothing_and_robust_spread_by_hand():
    """Distances from the median 3: 2, 1, 0, 1, 97; their median is 1."""
    assert robust_sd(np.array([1.0, 2.0, 3.0, 4.0, 100.0])) == pytest.approx(1.4826)
    seen = synthetic_driving(KNOWN, drivers=LEAST - 1, seed=0)
    few = calibrate([seen._replace(standing_gap_m=np.zeros(0), lane_change_s=np.array([4.0]))], prior=Drivers())
    assert {quantity.source for quantity in few} == {"prior"}
