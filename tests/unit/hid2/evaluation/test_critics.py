"""Critics: matching, AUC, and that they tell what differs, do not tell what does not, and see no scene twice."""

from dataclasses import replace

import numpy as np
import pytest
from hand_drawn import draw_road
from views import lane_view

from hid2.agents import BoxSize, Track
from hid2.evaluation import critics
from hid2.evaluation.windows import WINDOW, windows
from hid2.measures.arrays import stack
from hid2.measures.following import leaders

CRITICS = [("logistic", "all"), ("trees", "all")]


def drawn(count=900, scenes=6, *, shift=0.0, seed=0):
    """Windows of cars at 3 to 12 m/s with accelerations of SD 0.6; those of generated ones have `shift` more."""
    rng = np.random.default_rng(seed)
    found = np.zeros(count, dtype=WINDOW)
    found["generated"] = rng.random(count) < 0.5
    found["speed_mps"] = rng.uniform(3, 12, count)
    found["accel_mps2"] = rng.normal(0, 0.6, count) + shift * found["generated"]
    found["offset_m"], found["drift_mps"] = rng.normal(0, 0.3, count), rng.normal(0, 0.1, count)
    found["gap_m"], found["halves"] = 60.0, rng.integers(0, 2**16, count)
    found["scene"] = rng.integers(0, scenes, count)
    return found


def test_auc_by_hand():
    """Positives 3 and 1 against negatives 2 and 1: 3 > 2, 3 > 1, 1 < 2, 1 = 1 (half): 2.5 of 4.

    Of double weight, the positive 3 wins 4 and the other half of 1: 4.5 of 6.
    """
    scores, labels = np.array([3.0, 1.0, 2.0, 1.0]), np.array([True, True, False, False])
    assert critics.weighted_auc(scores, labels, np.ones(4)) == pytest.approx(2.5 / 4)
    assert critics.weighted_auc(scores, labels, np.array([2.0, 1.0, 1.0, 1.0])) == pytest.approx(4.5 / 6)
    assert critics.weighted_auc(scores, np.ones(4, dtype=bool), np.ones(4)) is None


def test_both_kinds_weigh_the_same_in_each_stratum_and_strata_with_one_kind_count_for_nothing():
    """Stratum 0: four generated and two recorded, each side counts 2. Stratum 1: nobody recorded."""
    stratum = np.array([0, 0, 0, 0, 0, 0, 1, 1])
    generated = np.array([1, 1, 1, 1, 0, 0, 1, 1], dtype=bool)
    assert critics.matched_weights(stratum, generated).tolist() == [0.5] * 4 + [1.0] * 2 + [0.0] * 2


@pytest.mark.parametrize(("critic", "view"), CRITICS)
def test_critics_tell_what_differs_and_not_what_is_equal(critic, view):
    """Means two standard deviations apart: an AUC of Phi(2 / sqrt 2) = 0.92. Constant speed on the middle is found."""
    assert critics.judge(drawn(shift=1.2), critic, view).auc == pytest.approx(0.92, abs=0.05)
    assert critics.judge(critics.constant_on_the_middle(drawn()), critic, view).auc > 0.90
    verdict = critics.judge(drawn(), critic, view)
    assert verdict.auc == pytest.approx(0.5, abs=0.06)
    assert verdict.low < 0.53
    assert verdict.high > 0.47
    assert verdict.scenes == 6


def test_trees_see_only_their_view_what_betrays_most_is_named_first_and_one_scene_cannot_be_judged():
    assert critics.judge(drawn(scenes=1), "trees", "all") is None
    found = drawn(shift=1.2)
    name, auc = critics.betrayals(found)[0]
    assert "acceleration" in name or "speed" in name
    assert auc > 0.85
    assert critics.judge(found, "trees", "lateral").auc == pytest.approx(0.5, abs=0.06)
    assert critics.judge(found, "trees", "speed").auc > 0.85


def test_halves_of_the_recorded_tracks_are_not_told_apart():
    found = drawn(shift=3.0)
    apart = critics.halves_apart(found, 3)
    assert len(apart) == int((~found["generated"]).sum())
    assert critics.judge(apart, "trees", "all").auc == pytest.approx(0.5, abs=0.1)


def test_a_scene_is_never_judged_by_a_critic_that_was_trained_on_it():
    """Which side of the lane tells hangs on the scene: a critic that knew it would tell, one that does not cannot."""
    found = drawn(scenes=30)
    side = np.where(np.random.default_rng(1).random(30) < 0.5, 1.0, -1.0)[found["scene"].astype(int)]
    found["offset_m"] = side * np.where(found["generated"], 1.0, -1.0)
    found["drift_mps"] = found["scene"]  # by which a critic would know the scene again
    assert critics.judge(found, "trees", "lateral").auc < 0.75


def drive(speed, accel, offset, *, steps=80, rng=None, track_id="r1"):
    time = 0.1 * np.arange(steps)
    x = 10.0 + speed * time + accel * time**2 / 2
    noise = rng.normal(0, 0.05, (steps, 2)) if rng is not None else 0.0
    velocity = np.column_stack([speed + accel * time, np.zeros(steps)])
    position = np.column_stack([x, np.full(steps, offset)]) + noise
    return Track(track_id, "vehicle", 1, np.arange(steps), position, np.zeros(steps), velocity, BoxSize(4, 2))


def windows_of(tracks):
    view = lane_view(stack(tracks, step_s=0.1), draw_road(length_m=250))
    return windows(view, leaders(view), scene="s", labelled=True)


def test_windows_find_speed_acceleration_and_place_through_the_noise_of_a_tracker():
    """6 m/s at 0 s, 0.8 m/s2, 0.4 m left of the middle, noise of 5 cm; the first window's middle is at 3 s: 8.4 m/s."""
    found = windows_of([drive(6.0, 0.8, 0.4, rng=np.random.default_rng(0))])
    assert len(found) == 4
    assert found["speed_mps"][0] == pytest.approx(8.4, abs=0.05)
    assert found["accel_mps2"] == pytest.approx(0.8, abs=0.05)
    assert found["jerk_mps3"] == pytest.approx(0.0, abs=0.15)
    assert found["offset_m"] == pytest.approx(0.4, abs=0.04)
    assert not found["led"].any()


def test_windows_know_the_leader():
    """A leader 20 m ahead, boxes of 4 m, that drives 1 m/s slower: at 3 s a gap of 16 - 3 = 13 m."""
    ahead = drive(7.0, 0.0, 0.0, track_id="r2")
    ahead = replace(ahead, position=ahead.position + np.array([20.0, 0.0]))
    found = windows_of([drive(8.0, 0.0, 0.0), ahead])
    own = found[found["agent"] == 0]
    assert own["led"].all()
    assert own["gap_m"][0] == pytest.approx(13.0, abs=0.1)
    assert own["closing_mps"] == pytest.approx(1.0, abs=0.02)
    shown = dict(zip(critics.FEATURE_NAMES, critics.features(own)[0], strict=True))
    assert shown["time gap"] == pytest.approx(13.0 / 8.0, abs=0.02)
