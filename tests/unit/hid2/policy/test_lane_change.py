from typing import Any

import pytest

from hid2.params import LaneChange
from hid2.policy.lane_change import OPEN as NO_GAP
from hid2.policy.lane_change import Gap, gap_refusals, safe_gap_m
from hid2.reasons import Reason

#: Every value that a number below is worked from; the defaults may be tuned.
PARAMS = LaneChange(time_gap_front_s=0.6, time_gap_rear_s=0.8, min_gap_m=2.5, braking_mps2=2.0)
#: A situation in which the change is feasible.
OPEN: dict[str, Any] = {"speed_mps": 10.0, "cells_free": True, "front": Gap(30.0, 10.0), "rear": Gap(30.0, 10.0)}


def _first(params: LaneChange, **seen: Any) -> Reason | None:
    return next(gap_refusals(params=params, **seen), None)


@pytest.mark.parametrize(
    ("follower_mps", "leader_mps", "gap_m"),
    [
        (14.0, 10.0, 15.2),  # 0.8 * 14 = 11.2 m, and (14 - 10)^2 / (2 * 2) = 4 m
        (10.0, 14.0, 8.0),  # to a faster leader the time gap
        (1.0, 1.0, 2.5),  # 0.8 * 1 = 0.8 m is less than 2.5 m
    ],
)
def test_safe_gap_is_time_gap_plus_braking_of_the_difference(
    follower_mps: float, leader_mps: float, gap_m: float
) -> None:
    assert safe_gap_m(follower_mps, leader_mps, time_gap_s=0.8, params=PARAMS) == pytest.approx(gap_m)


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({}, None),
        ({"front": NO_GAP, "rear": NO_GAP}, None),
        ({"cells_free": False}, "cells_occupied"),
        ({"front": Gap(5.9, 10.0)}, "front_gap"),  # 0.6 s * 10 m/s = 6 m
        ({"front": Gap(30.0, 0.0)}, "front_gap"),  # 6 + 10^2 / 4 = 31 m to a standing vehicle
        ({"rear": Gap(7.9, 10.0)}, "rear_gap"),  # 0.8 s * 10 m/s = 8 m
        ({"rear": Gap(18.2, 15.0)}, "rear_gap"),  # 0.8 * 15 + 5^2 / 4 = 18.25 m
        ({"rear": Gap(18.3, 15.0)}, None),
    ],
)
def test_lane_change_waits_for_the_first_condition_that_fails(changed: dict[str, Any], reason: str | None) -> None:
    assert _first(**{**OPEN, **changed}, params=PARAMS) == reason
