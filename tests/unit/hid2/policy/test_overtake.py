from dataclasses import replace
from typing import Any

import pytest

from hid2.params import Overtake
from hid2.policy.lane_change import Gap, LaneOption
from hid2.policy.overtake import enter_reason, return_reason
from hid2.reasons import Reason
from netconvert.cells import Cell

#: Every value that a number below is worked from; the defaults may be tuned.
PARAMS = Overtake(
    d_obs_m=40.0, d_overtake_m=40.0, speed_advantage_mps=1.5, safe_front_m=6.0, safe_rear_m=8.0, return_gap_m=5.0
)
OPEN = LaneOption(
    "left", Cell(2, 10), cells_free=True, front=Gap(40.0, 10.0), rear=Gap(20.0, 10.0), remaining_m=150.0,
    corridor_m=40.0,
)  # fmt: skip


def _enter(leader: Gap | None = Gap(20.0, 5.0, "7"), **changed: Any) -> Reason | None:  # noqa: B008
    return enter_reason(replace(OPEN, **changed), leader=leader, desired_mps=10.0, params=PARAMS)


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({}, None),
        ({"leader": Gap(40.0, 8.5, "7")}, None),  # 10 - 8.5 = 1.5 m/s slower
        ({"front": Gap(6.0, 10.0)}, None),
        ({"rear": Gap(8.0, 10.0)}, None),
        ({"leader": None}, "no_leader"),
        ({"leader": Gap(40.1, 5.0, "7")}, "no_leader"),  # d_obs = 40 m
        ({"leader": Gap(20.0, 8.6, "7")}, "leader_not_slower"),  # 10 - 8.6 = 1.4, below 1.5 m/s
        ({"cells_free": False}, "no_lane"),
        ({"front": Gap(5.9, 10.0)}, "front_gap"),
        ({"rear": Gap(7.9, 10.0)}, "rear_gap"),
        ({"corridor_m": 39.9}, "corridor_short"),
    ],
)
def test_overtake_waits_for_the_first_condition_that_fails(changed: dict[str, Any], reason: str | None) -> None:
    assert _enter(**changed) == reason


def test_return_waits_until_the_leader_is_behind() -> None:
    """return_gap 5 m: at 4.9 m ahead of it not yet, beside it (-3 m) neither."""
    assert return_reason(OPEN, passed_gap_m=-3.0, params=PARAMS) == "not_ahead"
    assert return_reason(OPEN, passed_gap_m=4.9, params=PARAMS) == "not_ahead"
    assert return_reason(OPEN, passed_gap_m=5.0, params=PARAMS) is None
    assert return_reason(replace(OPEN, cells_free=False), passed_gap_m=9.0, params=PARAMS) == "no_lane"
    assert return_reason(replace(OPEN, front=Gap(5.9, 0.0)), passed_gap_m=9.0, params=PARAMS) == "front_gap"
