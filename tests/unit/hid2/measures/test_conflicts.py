"""Conflicts in SSAM's terms and rows of lane changes, by hand. All cars are 4 m by 2 m, steps 0.1 s."""

from dataclasses import replace

import numpy as np
import pytest
from hand_drawn import draw_driven, draw_road

from hid2.agents import Track
from hid2.measures.arrays import stack
from hid2.measures.conflicts import _following_pet, conflicts, pair_course
from hid2.measures.following import leaders
from hid2.measures.lane_changes import lane_changes
from hid2.measures.lane_matching import flatten_lanes
from hid2.measures.manoeuvres import detect
from hid2.measures.surrogates import encroachments
from hid2.occupancy.agent_states import agent_states


def _straight(name: str, at: tuple[float, float], speed_mps: float, heading_deg: float, *, steps: int = 60) -> Track:
    angle = np.radians(heading_deg)
    way = 0.1 * speed_mps * np.arange(steps)[:, None] * [np.cos(angle), np.sin(angle)]
    return draw_driven(name, np.array(at) + way)


def test_rear_end_conflict_by_hand() -> None:
    """Bumpers 12 m apart, 2 m/s closing: TTC below 1.5 s while the gap is below 3 m, from step 46 (2.8 m) on.

    At the last step 0.2 m are left: TTC 0.1 s, DRAC 2^2 / (2 * 0.2) = 10 m/s2. The follower's front is where the
    leader's rear was within a step. What a tracker states, the follower to stand, is another thing.
    """
    follower = _straight("b", (0, 0), 10.0, 0)
    follower = replace(follower, velocity=0.0 * follower.velocity)
    (found,) = conflicts(stack([follower, _straight("a", (16, 0), 8.0, 0)], step_s=0.1))
    assert (found.first_id, found.second_id, found.kind, found.start_s, found.end_s) == ("a", "b", "rear_end", 4.6, 5.9)
    assert (found.ttc_s, found.time_s) == (pytest.approx(0.1), 5.9)
    assert (found.drac_mps2, found.pet_s) == (pytest.approx(10.0), pytest.approx(0.1))
    passes = _straight("b", (-10, 2.5), 10.0, 0)  # beside; once 20 m on it turns, and has the place behind it in line
    turns = replace(passes, heading=np.where(passes.timesteps < 30, 0.0, np.radians(10)))
    assert _following_pet(stack([_straight("a", (0, 0), 0.0, 0), turns], step_s=0.1), 0, 1, (0, 9)) is None
    assert (found.max_s_mps, found.delta_s_mps, found.angle_deg) == pytest.approx((10.0, 2.0, 0.0))


def test_crossing_conflict_by_hand() -> None:
    """From the south, there at step 20, from the west 13 steps later: 1.3 s less 3 m each at 10 m/s, and half a step
    of swept box to each side: PET 0.6 s. TTC is never below 1.5 s: the first is gone before. It comes from the left.

    If the first ends at step 25 and the second begins at step 27, passing times are the same.
    """
    first, second = _straight("a", (0, -20), 10.0, 90), _straight("b", (-33, 0), 10.0, 0)
    (found,) = conflicts(stack([first, second], step_s=0.1))
    assert (found.first_id, found.second_id, found.kind, found.ttc_s) == ("a", "b", "crossing", None)
    assert (found.start_s, found.end_s) == pytest.approx((2.0, 3.3), abs=0.11)
    assert found.pet_s == pytest.approx(0.6, abs=0.11)
    assert (found.angle_deg, found.delta_s_mps) == pytest.approx((-90.0, 10.0 * 2**0.5))
    first, second = _straight("a", (0, -20), 10.0, 90, steps=26), _straight("b", (-6, 0), 10.0, 0)
    (found,) = conflicts(stack([first, replace(second, timesteps=second.timesteps + 27)], step_s=0.1))
    assert (found.first_id, found.second_id, found.kind, found.ttc_s) == ("a", "b", "crossing", None)
    assert (found.start_s, found.time_s, found.end_s) == pytest.approx((2.0, 2.0, 3.3), abs=0.11)
    assert (found.drac_mps2, found.max_s_mps) == (0.0, pytest.approx(10.0))
    assert (found.angle_deg, found.delta_s_mps) == pytest.approx((-90.0, 10.0 * 2**0.5))
    assert (found.x_m, found.y_m) == pytest.approx((0.0, 0.0), abs=1.1)


def test_crossings_are_those_of_all_pairs_whenever_the_vehicles_are_there() -> None:
    """Twelve from the south at random times, one from the west: PETs of all pairs at once are those of each alone."""
    rng = np.random.default_rng(0)
    tracks = [_straight("w", (-60, 0), 10.0, 0, steps=120)]
    for number, start in enumerate(rng.integers(0, 150, size=12).tolist()):
        track = _straight(f"s{number}", (rng.uniform(-5, 5), -20), 8.0, 90)
        tracks.append(replace(track, timesteps=track.timesteps + start))
    arrays = stack(tracks, step_s=0.1)
    found = encroachments(arrays, cap_s=5.0)
    assert 3 < len(found) < 12
    alone = [encroachments(arrays.agents([0, other]), cap_s=30.0) for other in range(1, arrays.num_agents)]
    assert [(one.pet_s, one.passed) for (one,) in filter(None, alone) if one.pet_s <= 5.0] == [
        (one.pet_s, one.passed) for one in found
    ]


@pytest.mark.parametrize(
    ("heading_deg", "kind"), [(20, "rear_end"), (50, "lane_change"), (80, "lane_change"), (88, "crossing")]
)
def test_class_is_that_of_the_angle(heading_deg: float, kind: str) -> None:
    """Both are at the origin after 3 s, in each other's box."""
    angle = np.radians(heading_deg)
    other = _straight("b", (-30 * np.cos(angle), -30 * np.sin(angle)), 10.0, heading_deg)
    (found,) = conflicts(stack([_straight("a", (-30, 0), 10.0, 0), other], step_s=0.1))
    assert (found.kind, found.ttc_s, found.pet_s) == (kind, 0.0, 0.0)
    assert abs(found.angle_deg) == pytest.approx(heading_deg)


def test_vehicles_that_keep_apart_or_stand_have_no_conflict() -> None:
    """30 m behind at the same speed; side by side on the next lane; two that stand in each other's box."""
    moving = [_straight("a", (0, 0), 10.0, 0), _straight("b", (-34, 0), 10.0, 0), _straight("c", (0, 3.5), 10.0, 0)]
    standing = [_straight("d", (500, 0), 0.0, 0), _straight("e", (501, 0), 0.0, 0)]
    assert conflicts(stack([*moving, *standing], step_s=0.1)) == []
    assert conflicts(stack([], step_s=0.1)) == []


def test_two_conflicts_of_a_pair_more_than_five_seconds_apart_are_two() -> None:
    """Gap 1 m, 1 m/s closing for a tenth of a second, in the first second and after 8 s."""
    close = [_straight("a", (0, 0), 10.0, 0, steps=120)]
    speed = np.full(120, 10.0)
    speed[5:8] = speed[85:88] = 11.0
    way = -5.0 + 0.1 * np.cumsum(speed) - 1.0
    close.append(draw_driven("b", np.stack([way, np.zeros(120)], axis=1)))
    assert [one.start_s < 1.0 for one in conflicts(stack(close, step_s=0.1))] == [True, False]


def test_follower_of_a_vehicle_that_comes_from_beside_has_a_drac_though_the_boxes_would_pass() -> None:
    """12 m/s behind 10 m/s, 16 m between the bumpers, 3 m beside: 2^2 / (2 * 16) at first; boxes of 2 m never touch."""
    course = pair_course(stack([_straight("a", (0, 0), 12.0, 0), _straight("b", (20, 3), 10.0, 0)], step_s=0.1), 0, 1)
    assert (course.drac_mps2.max(), course.ttc_s.min()) == (0.0, np.inf)
    assert course.follower_drac_mps2[0] == pytest.approx(4.0 / 32.0, rel=1e-3)
    course = pair_course(stack([_straight("a", (0, 0), 8.0, 0), _straight("b", (20, 0), 10.0, 0)], step_s=0.1), 0, 1)
    assert (course.drac_mps2.max(), course.ttc_s.min()) == (0.0, np.inf)  # not closing in
    assert course.gap_m[0] == pytest.approx(16.0)
    assert course.headway_s[0] == pytest.approx(20.0 / 8.0)


def test_lane_change_has_its_gaps_and_what_its_follower_had_to_do() -> None:
    """From lane 1 to lane 2, 3.5 m in 4 s, at 10 m/s. 20 m ahead on lane 1 another of 10 m/s: 16 m bumper to bumper.

    On lane 2 one of 9 m/s begins 30 m behind and brakes with 1 m/s2 from 3 to 5 s.
    """
    time = np.arange(80) * 0.1
    share = np.clip((time - 2.0) / 4.0, 0.0, 1.0)
    across = 3.5 * (share - np.sin(2 * np.pi * share) / (2 * np.pi))
    own = draw_driven("own", np.stack([40.0 + 10.0 * time, across], axis=1))
    speed = 9.0 - np.clip(time - 3.0, 0.0, 2.0)
    lag = draw_driven(
        "lag", np.stack([10.0 + 0.1 * np.concatenate([[0.0], np.cumsum(speed)[:-1]]), np.full(80, 3.5)], axis=1)
    )
    lead = _straight("lead", (60, 0), 10.0, 0, steps=80)
    lanes = flatten_lanes(draw_road(lanes=2, length_m=200.0))
    states = agent_states([own, lag, lead], lanes, num_steps=80, step_s=0.1)
    led = leaders(states)
    (row,) = lane_changes(states, led, detect(states))
    assert (row.track_id, row.source_lane, row.target_lane, row.side, row.complete) == ("own", 1, 2, 1, True)
    assert row.crossing_s == pytest.approx(4.0, abs=0.05)
    assert row.duration_s == pytest.approx(row.end_s - row.start_s)
    assert (row.start_mps, row.end_mps) == pytest.approx((10.0, 10.0), abs=0.1)
    assert (row.lead_before_id, row.lead_before_m) == ("lead", pytest.approx(16.0, abs=0.1))
    assert (row.lag_before_id, row.lead_after_id) == (None, None)
    behind_m = own.position[round(row.end_s * 10), 0] - lag.position[round(row.end_s * 10), 0] - 4.0
    assert (row.lag_id, row.lag_after_m) == ("lag", pytest.approx(behind_m, abs=0.1))
    assert row.lag_brakes_mps2 == pytest.approx(1.0, abs=0.05)
    assert (row.lag_drac_mps2, row.lag_headway_s) == (0.0, pytest.approx(32.0 / 9.0, abs=0.2))
