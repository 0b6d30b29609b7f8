from typing import Any

import pytest

from hid2.params import Overtake
from hid2.policy.lane_change import Gap
from hid2.policy.overtake import enter_reason, return_reason

#: Every value that a number below is worked from; the defaults may be tuned.
PARAMS = Overtake(
    d_obs_m=40.0, d_overtake_m=40.0, speed_advantage_mps=1.5, safe_front_m=6.0, safe_rear_m=8.0, return_gap_m=5.0
)
OPEN: dict[str, Any] = {
    "leader": Gap(20.0, 5.0, "7"),
    "desired_mps": 10.0,
    "lane_available": True,
    "ahead": Gap(40.0, 10.0),
    "behind": Gap(20.0, 10.0),
    "free_corridor_m": 40.0,
}


def test_overtake_begins_when_the_three_conditions_hold() -> None:
    assert enter_reason(**OPEN, params=PARAMS) is None


@pytest.mark.parametrize(
    "changed",
    [{"leader": Gap(40.0, 8.5, "7")}, {"ahead": Gap(6.0, 10.0)}, {"behind": Gap(8.0, 10.0)}],
)
def test_what_is_asked_for_is_enough(changed: dict[str, Any]) -> None:
    """A leader 40 m ahead that is 10 - 8.5 = 1.5 m/s slower, gaps of 6 and 8 m: no more is asked for."""
    assert enter_reason(**{**OPEN, **changed}, params=PARAMS) is None


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"leader": None}, "no_leader"),
        ({"leader": Gap(40.1, 5.0, "7")}, "no_leader"),  # d_obs = 40 m
        ({"leader": Gap(20.0, 8.6, "7")}, "leader_not_slower"),  # 10 - 8.6 = 1.4, below 1.5 m/s
        ({"lane_available": False}, "no_lane"),
        ({"ahead": Gap(5.9, 10.0)}, "front_gap"),
        ({"behind": Gap(7.9, 10.0)}, "rear_gap"),
        ({"free_corridor_m": 39.9}, "corridor_short"),
    ],
)
def test_overtake_waits_for_the_first_condition_that_fails(changed: dict[str, Any], reason: str) -> None:
    assert enter_reason(**{**OPEN, **changed}, params=PARAMS) == reason


def test_return_waits_until_the_leader_is_behind() -> None:
    """return_gap 5 m: at 4.9 m ahead of it not yet, beside it (-3 m) neither."""
    open_return: dict[str, Any] = {"lane_available": True, "ahead": Gap(50.0, 10.0), "params": PARAMS}
    assert return_reason(lead_gap_m=-3.0, **open_return) == "not_ahead"
    assert return_reason(lead_gap_m=4.9, **open_return) == "not_ahead"
    assert return_reason(lead_gap_m=5.0, **open_return) is None
    assert return_reason(lead_gap_m=9.0, **{**open_return, "lane_available": False}) == "no_lane"
    assert return_reason(lead_gap_m=9.0, **{**open_return, "ahead": Gap(5.9, 0.0)}) == "front_gap"
