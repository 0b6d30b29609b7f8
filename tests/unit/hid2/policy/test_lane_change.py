import math
from typing import Any

import numpy as np
import pytest

from hid2.params import LaneChange
from hid2.policy.lane_change import Gap, blend_paths, duration_s, lane_change_reason, lateral_share, safe_gap_m
from netconvert.geometry import Polyline

#: Every value that a number below is worked from; the defaults may be tuned.
PARAMS = LaneChange(
    time_gap_front_s=0.6, time_gap_rear_s=0.8, min_gap_m=2.5, braking_mps2=2.0, min_remaining_m=25.0,
    min_duration_s=2.5, max_duration_s=6.0, lateral_accel_mps2=1.3, min_speed_mps=2.0,
)  # fmt: skip
#: A situation in which the change is feasible.
OPEN: dict[str, Any] = {
    "speed_mps": 10.0,
    "cells_free": True,
    "front": Gap(30.0, 10.0),
    "rear": Gap(30.0, 10.0),
    "remaining_m": 100.0,
}


def test_safe_gap_is_time_gap_plus_braking_of_the_difference() -> None:
    """Follower 14, leader 10 m/s, 0.8 s: 0.8 * 14 = 11.2 m, and (14 - 10)^2 / (2 * 2) = 4 m: 15.2 m."""
    assert safe_gap_m(14.0, 10.0, time_gap_s=0.8, params=PARAMS) == pytest.approx(15.2)


def test_safe_gap_to_a_faster_leader_is_the_time_gap() -> None:
    assert safe_gap_m(10.0, 14.0, time_gap_s=0.8, params=PARAMS) == pytest.approx(8.0)


def test_safe_gap_at_a_crawl_is_the_smallest_gap() -> None:
    """0.8 * 1 = 0.8 m is less than 2.5 m."""
    assert safe_gap_m(1.0, 1.0, time_gap_s=0.8, params=PARAMS) == pytest.approx(2.5)


def test_lane_change_into_an_open_lane_is_feasible() -> None:
    assert lane_change_reason(**OPEN, params=PARAMS) is None
    assert lane_change_reason(**{**OPEN, "front": Gap.none(), "rear": Gap.none()}, params=PARAMS) is None


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"speed_mps": 1.9}, "too_slow"),
        ({"remaining_m": 24.9}, "lane_ends"),
        ({"cells_free": False}, "cells_occupied"),
        ({"front": Gap(5.9, 10.0)}, "front_gap"),  # 0.6 s * 10 m/s = 6 m
        ({"front": Gap(30.0, 0.0)}, "front_gap"),  # 6 + 10^2 / 4 = 31 m to a standing vehicle
        ({"rear": Gap(7.9, 10.0)}, "rear_gap"),  # 0.8 s * 10 m/s = 8 m
        ({"rear": Gap(24.9, 15.0)}, "rear_gap"),  # 0.8 * 15 + 5^2 / 4 = 18.25 m: see the next test
    ],
)
def test_lane_change_waits_for_the_first_condition_that_fails(changed: dict[str, Any], reason: str) -> None:
    if changed == {"rear": Gap(24.9, 15.0)}:
        assert lane_change_reason(**{**OPEN, **changed}, params=PARAMS) is None
        changed = {"rear": Gap(18.2, 15.0)}
    assert lane_change_reason(**{**OPEN, **changed}, params=PARAMS) == reason


def test_end_of_the_lane_is_named_before_who_is_on_it() -> None:
    closed = {**OPEN, "cells_free": False, "front": Gap(0.0, 0.0), "remaining_m": 0.0}
    assert lane_change_reason(**closed, params=PARAMS) == "lane_ends"


def test_duration_is_the_comfortable_one_at_speed() -> None:
    """8 D / T^2 = 1.3 m/s2 with D = 3.5 m: T = sqrt(28 / 1.3) = 4.64 s; at 6 m/s a share 0.25 * 0.5 longer, 5.22 s."""
    assert duration_s(lateral_m=3.5, speed_mps=15.0, remaining_m=300.0, params=PARAMS) == pytest.approx(4.641, abs=1e-3)
    assert duration_s(lateral_m=-3.5, speed_mps=6.0, remaining_m=300.0, params=PARAMS) == pytest.approx(5.221, abs=1e-3)


def test_duration_fits_the_lane_that_is_left_and_its_bounds() -> None:
    """45 m left at 12 m/s: 0.8 * 45 / 12 = 3 s. 20 m left: 1.3 s would be too short, 2.5 s is the shortest."""
    assert duration_s(lateral_m=3.5, speed_mps=12.0, remaining_m=45.0, params=PARAMS) == pytest.approx(3.0)
    assert duration_s(lateral_m=3.5, speed_mps=12.0, remaining_m=20.0, params=PARAMS) == 2.5
    assert duration_s(lateral_m=9.0, speed_mps=12.0, remaining_m=900.0, params=PARAMS) == 6.0


def test_lateral_share_has_jerk_plus_minus_minus_plus_of_32() -> None:
    """d / D over tau, by hand at the knots: 1/12 at 1/4, 1/2 at 1/2, 11/12 at 3/4.

    jerk          +32 |-32     -32 |+32           first quarter: 32 / 6 tau^3 = 5.333 / 64 = 1/12
    acceleration   0 -> 8 -> 0 -> -8 -> 0         8 at 1/4: 8 D / T^2
    speed          0 -> 1 -> 2 ->  1 -> 0         2 at 1/2: 2 D / T
    """
    assert lateral_share(np.array([0, 0.25, 0.5, 0.75, 1.0])) == pytest.approx([0, 1 / 12, 0.5, 11 / 12, 1])
    h = 1e-3
    tau = np.arange(0.0, 1.0 + h / 2, h)
    d = lateral_share(tau)
    jerk = np.diff(d, 3) / h**3
    for quarter, sign in enumerate((1, -1, -1, 1)):
        inside = jerk[250 * quarter + 3 : 250 * (quarter + 1) - 3]
        assert inside == pytest.approx(np.full(inside.size, 32.0 * sign), abs=1e-3)
    speed, acceleration = np.gradient(d, h), np.gradient(np.gradient(d, h), h)
    assert speed.max() == pytest.approx(2.0, abs=1e-3)
    assert np.abs(acceleration).max() == pytest.approx(8.0, abs=0.05)


def test_lateral_share_rests_outside_its_window() -> None:
    assert lateral_share(np.array([-1.0, 0.0, 1.0, 2.0])).tolist() == [0.0, 0.0, 1.0, 1.0]


CURRENT = np.array([[0.0, 0.0], [200.0, 0.0]])
LEFT = np.array([[0.0, 3.5], [200.0, 3.5]])


def test_blend_leaves_one_lane_for_the_other() -> None:
    """Shift from 50 to 90 m: on the old lane until 50, half way (1.75 m) at 70, on the new one from 90 on.

    y = 3.5 - - - - - - - - - ______________
                         ____/
    y = 0   ____________/ - - - - - - - - -
            0           50   70   90      200
    """
    blend = blend_paths(CURRENT, LEFT, start_m=50.0, length_m=40.0, step_m=1.0, max_shift_m=5.5)
    assert blend is not None
    y = np.interp([0.0, 50.0, 70.0, 90.0, 200.0], blend.points[:, 0], blend.points[:, 1])
    assert y == pytest.approx([0.0, 0.0, 1.75, 3.5, 3.5], abs=0.02)
    assert blend.start_m == pytest.approx(50.0, abs=1.0)
    assert blend.end_m == pytest.approx(90.0, abs=1.5)
    assert blend.shift_m == pytest.approx(3.5)


def test_blend_to_the_right_shifts_the_other_way() -> None:
    blend = blend_paths(LEFT, CURRENT, start_m=50.0, length_m=40.0, step_m=1.0, max_shift_m=5.5)
    assert blend is not None
    assert blend.shift_m == pytest.approx(-3.5)
    assert np.all(np.diff(blend.points[:, 1]) <= 1e-9)


def test_blend_knows_how_far_the_target_is_ahead_of_it() -> None:
    """The target begins 30 m before the current lane: its arc length is 30 m more, less a detour of 0.2 m."""
    blend = blend_paths(CURRENT, LEFT - np.array([30.0, 0.0]), start_m=50.0, length_m=40.0, step_m=1.0, max_shift_m=5.5)
    assert blend is not None
    assert blend.target_offset_m == pytest.approx(30.0, abs=0.3)
    onward = Polyline(LEFT - np.array([30.0, 0.0])).point(np.array([150.0 + blend.target_offset_m]))
    assert Polyline(blend.points).point(np.array([150.0])) == pytest.approx(onward, abs=0.02)


@pytest.mark.parametrize(
    ("target", "start", "length"),
    [
        (LEFT * [0.4, 1.0], 50.0, 40.0),  # the target ends at 80 m
        (LEFT + np.array([0.0, 3.5]), 50.0, 40.0),  # 7 m away: not the adjacent lane
        (LEFT, 180.0, 40.0),  # the own lane ends first
        (LEFT[::-1], 50.0, 40.0),  # oncoming
        (LEFT + np.array([60.0, 0.0]), 50.0, 40.0),  # begins only at 60 m
    ],
)
def test_no_blend_where_the_lanes_are_not_side_by_side(target: np.ndarray, start: float, length: float) -> None:
    assert blend_paths(CURRENT, target, start_m=start, length_m=length, step_m=1.0, max_shift_m=5.5) is None


def test_no_gap_is_an_infinite_one() -> None:
    assert Gap.none().distance_m == math.inf
