"""The gap function: who is next ahead and behind on a path, how far bumper to bumper, how fast."""

import numpy as np
import pytest
from hand_drawn import draw_box
from inserted import CAR

from hid2.motion.route import DrivenPath
from hid2.occupancy.along_path import PathOccupancy, look_along
from hid2.occupancy.gaps import gaps_from_pose, gaps_on_path, gaps_to_all


@pytest.fixture
def seen(straight_path: DrivenPath) -> PathOccupancy:
    """Four cars of 4.5 m along x, at 20 (9 m/s), 60 (6 m/s) and 90 m (5 m/s) at step 0; one stands across at 75 m."""
    cars = draw_box(20.0, 0.0, 0.0, 9.0, name="a").joined(
        draw_box(60.0, 0.0, 0.0, 6.0, name="b"),
        draw_box(90.0, 0.0, 0.0, 5.0, name="c"),
        draw_box(75.0, 0.0, np.pi / 2, name="x"),
    )
    return look_along(straight_path.line, cars, CAR.length_m, CAR.width_m)


def test_leader_and_follower_are_the_next_ones_bumper_to_bumper_with_their_speeds(seen: PathOccupancy) -> None:
    """At 40 m: 20 m of centres each way, less 4.5 m of two halves, to half a metre."""
    found = gaps_on_path(seen, np.array([40.0]), 0)
    assert (seen.agents[found.leader[0]], seen.agents[found.follower[0]]) == (1, 0)
    assert (found.lead_m[0], found.lag_m[0]) == pytest.approx((15.5, 15.5), abs=0.6)
    assert (found.lead_mps[0], found.lag_mps[0]) == pytest.approx((6.0, 9.0))


def test_each_place_is_asked_at_its_own_step_side_by_side_too_and_only_those_asked_for_count(
    seen: PathOccupancy,
) -> None:
    """After 1 s the one from 60 m is at 66 m, ahead of 65 m and behind 67 m.

    At 59 m one at 60 m is the leader, 1 - 4.5 m away; at 61 m it is the follower. Who stands across at 75 m is next on
    the path, and leads nobody: the one at 90 m does.
    """
    found = gaps_on_path(seen, np.array([65.0, 65.0, 67.0]), np.array([0, 10, 10]))
    assert seen.agents[found.follower].tolist() == [1, 0, 1]
    assert seen.agents[found.leader].tolist() == [3, 1, 3]
    found = gaps_on_path(seen, np.array([59.0, 61.0]), 0)
    assert (seen.agents[found.leader[0]], seen.agents[found.follower[1]]) == (1, 1)
    assert (found.lead_m[0], found.lag_m[1]) == pytest.approx((-3.5, -3.5), abs=0.6)
    at = np.array([70.0])
    assert seen.agents[gaps_on_path(seen, at, 0).leader[0]] == 3
    assert seen.agents[gaps_on_path(seen, at, 0, among=seen.same_direction).leader[0]] == 2


def test_nobody_is_infinitely_far_away_and_stands(seen: PathOccupancy) -> None:
    for empty in (PathOccupancy.none(1), seen.rows(np.zeros(4, dtype=np.bool_))):
        found = gaps_on_path(empty, np.array([40.0]), 0)
        assert (found.leader[0], found.follower[0]) == (-1, -1)
        assert (found.lead_m[0], found.lag_m[0], found.lead_mps[0], found.lag_mps[0]) == (np.inf, np.inf, 0.0, 0.0)


def test_one_that_comes_back_along_the_path_has_no_speed_along_it(straight_path: DrivenPath) -> None:
    oncoming = look_along(straight_path.line, draw_box(80.0, 0.0, np.pi, 5.0), CAR.length_m, CAR.width_m)
    assert gaps_on_path(oncoming, np.array([40.0]), 0).lead_mps[0] == 0.0


def test_gaps_to_all_have_the_next_ones_and_those_beyond(seen: PathOccupancy) -> None:
    """At 40 m those at 60, 75 and 90 m are ahead and the one at 20 m behind; after 1 s it is at 29 m, at 9 m/s."""
    found, next_ones = gaps_to_all(seen, np.array([40.0]), 0), gaps_on_path(seen, np.array([40.0]), 0)
    assert np.isfinite(found.lead_m[:, 0]).tolist() == [False, True, True, True]
    assert np.isfinite(found.lag_m[:, 0]).tolist() == [True, False, False, False]
    assert found.lead_m.min() == next_ones.lead_m[0]
    assert found.lag_m.min() == next_ones.lag_m[0]
    later = gaps_to_all(seen, np.array([40.0, 40.0]), np.array([0, 10]))
    assert later.lag_m[0, 0] - later.lag_m[0, 1] == pytest.approx(9.0, abs=0.6)
    assert later.along_mps[0] == pytest.approx([9.0, 9.0])


def test_gaps_from_a_pose_need_no_path() -> None:
    """Heading up from (0, 0): 10 m ahead and 3 m aside at 4 m/s, and 20 m behind; cars of 4.5 x 1.9 m."""
    here = (
        draw_box(3.0, 10.0, np.pi / 2, 4.0, name="ahead").joined(draw_box(0.0, -20.0, np.pi / 2, name="behind")).at(0)
    )
    found = gaps_from_pose(np.zeros(2), np.array([0.0, 1.0]), CAR, here)
    assert found.along_m == pytest.approx([10.0, -20.0])
    assert found.gap_m == pytest.approx([5.5, 15.5])
    assert found.aside_m == pytest.approx([1.1, -1.9])
    assert found.along_mps == pytest.approx([4.0, 0.0], abs=1e-9)
    elsewhere = gaps_from_pose(np.array([[0.0, 1.0], [0.0, 2.0]]), np.array([[0.0, 1.0], [0.0, 1.0]]), CAR, here)
    assert elsewhere.along_m == pytest.approx([9.0, -22.0])
