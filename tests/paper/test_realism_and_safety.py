"""Section "Realism and Safety": LO, LA, JE, SCR and ORR on motion that can be worked by hand."""

import numpy as np
import pytest
from hand_drawn import draw_track

from hid2.agents import BoxSize
from hid2.evaluation.kinematics import kinematics, motion
from hid2.evaluation.safety import colliding, off_road, overlaps
from hid2.measures.arrays import stack
from netconvert.lane_graph import LaneGraph


def make_track(x, y=0.0, heading=0.0, *, name="t"):
    return draw_track(range(len(x)), x, y, heading, track_id=name, size=BoxSize(4.0, 2.0))


def measured(track):
    arrays = stack([track], step_s=0.1)
    return kinematics(arrays, motion(arrays))


def test_constant_acceleration_seen_from_a_turned_heading():
    """x = 3 t^2 / 2, theta = 30 degrees: LO = 3 cos 30 = 2.598, LA = |-3 sin 30| = 1.5. Exact but near the ends."""
    time = 0.1 * np.arange(60)
    arrays = stack([make_track(1.5 * time**2, heading=np.pi / 6)], step_s=0.1)
    moved = motion(arrays)
    np.testing.assert_allclose(moved.accel_mps2[2:-2], 3 * np.cos(np.pi / 6), atol=1e-9)
    np.testing.assert_allclose(moved.lateral_accel_mps2[2:-2], -1.5, atol=1e-9)


def test_circle_has_lateral_acceleration_v_squared_over_r():
    """R = 20 m at 10 m/s: 5 m/s2 inwards, and a turns at 0.5 rad/s: JE = 2.5 m/s3. Headings across pi are no turn."""
    angle = 0.5 * 0.1 * np.arange(80)
    track = make_track(20 * np.sin(angle), 20 * (1 - np.cos(angle)), angle)
    moved = motion(stack([track], step_s=0.1))
    np.testing.assert_allclose(moved.lateral_accel_mps2[2:-2], 5.0, rtol=2e-3)
    np.testing.assert_allclose(moved.accel_mps2[2:-2], 0.0, atol=1e-9)
    np.testing.assert_allclose(moved.jerk_mps3[3:-3], 2.5, rtol=3e-3)
    np.testing.assert_allclose(moved.yaw_rate_radps, 0.5, rtol=1e-9)
    moved = motion(stack([make_track(np.arange(6.0), heading=[3.1, 3.14, -3.13, -3.1, -3.08, -3.05])], step_s=0.1))
    assert np.abs(moved.yaw_rate_radps).max() < 1.0


def test_tracks_of_less_than_five_steps_are_not_counted_and_missing_steps_keep_their_time():
    """Steady 10 m/s with a gap of three steps: no acceleration, though positions jump."""
    arrays = stack([make_track(np.arange(4.0), name="a"), make_track(np.arange(5.0), name="b")], step_s=0.1)
    assert kinematics(arrays, motion(arrays)).counted.tolist() == [False, True]
    steps = np.array([0, 1, 2, 3, 7, 8, 9, 10])
    track = draw_track(steps, steps)
    assert measured(track).lo[0] == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(motion(stack([track], step_s=0.1)).speed_mps, 10.0)


def test_lo_la_je_are_means_over_the_steps_of_a_track():
    rng = np.random.default_rng(0)
    track = make_track(np.cumsum(rng.normal(size=30)), np.cumsum(rng.normal(size=30)), rng.uniform(-3, 3, 30))
    a = np.gradient(np.gradient(track.position, 0.1, axis=0), 0.1, axis=0)
    j = np.gradient(a, 0.1, axis=0)
    cos, sin = np.cos(track.heading), np.sin(track.heading)
    found = measured(track)
    assert found.lo[0] == pytest.approx(np.abs(a[:, 0] * cos + a[:, 1] * sin).mean(), rel=1e-12)
    assert found.la[0] == pytest.approx(np.abs(-a[:, 0] * sin + a[:, 1] * cos).mean(), rel=1e-12)
    assert found.je[0] == pytest.approx(np.hypot(*j.T).mean(), rel=1e-12)


def test_scr_is_the_share_of_vehicles_that_collide_at_any_step():
    """Of four cars two meet head-on, one more overlaps them by less than an IoU of 0.02: 2 of 4.

    Boxes of 4 x 2 m. a drives from x = 0 to 9, b stands at 10: overlap at the last steps. c stands at x = 13.9 beside
    b's end: 0.1 x 2 m shared, IoU 0.2 / 15.8 = 0.013. d is far away.
    """
    still = np.full(10, 1.0)
    tracks = [
        make_track(np.arange(10.0), name="a"),
        make_track(10 * still, name="b"),
        make_track(13.9 * still, name="c"),
        make_track(100 * still, name="d"),
    ]
    arrays = stack(tracks, step_s=0.1)
    pairs = overlaps(arrays)
    assert [(p.first, p.second) for p in pairs] == [(0, 1), (1, 2)]
    assert pairs[1].iou == pytest.approx(0.2 / 15.8)
    assert np.argwhere(colliding(arrays, pairs)).tolist() == [[0, 1], [1, 0]]


def test_orr_counts_centres_outside_the_union_of_drivable_areas():
    """Two squares side by side: their common edge is no gap; a point in neither is off the road."""
    left = np.array([(0, 0), (10, 0), (10, 10), (0, 10), (0, 0)], dtype=float)
    graph = LaneGraph({}, drivable_areas=(left, left + np.array([10.0, 0.0])))
    points = np.array([[5.0, 5.0], [10.0, 5.0], [15.0, 5.0], [21.0, 5.0]])
    assert off_road(points, graph).tolist() == [False, False, False, True]
