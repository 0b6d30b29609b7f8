"""Distances of distributions and the classifier test, against scipy and cases worked by hand."""

import numpy as np
import pytest
from scipy.spatial.distance import jensenshannon
from scipy.stats import wasserstein_distance

from hid2.agents import BoxSize, Track
from hid2.evaluation.kinematics import motion
from hid2.evaluation.realism import (
    FEATURES,
    FINE,
    RealismCounts,
    area_under_curve,
    classifier_test,
    count_scene,
    half_of,
    histogram,
    jensen_shannon,
    logistic_regression,
    row_features,
    wasserstein,
)
from hid2.evaluation.safety import prepare_map, safety
from hid2.measures.arrays import stack

SPEED = FEATURES[0]


def test_bins_are_those_of_the_challenge():
    found = {feature.name: (feature.low, feature.high, feature.bins) for feature in FEATURES}
    assert found["speed"] == (0, 25, 10)
    assert found["longitudinal_accel"] == (-12, 12, 11)
    assert found["yaw_rate"] == (-0.628, 0.628, 11)
    assert found["ttc"] == (0, 5, 10)


def test_jensen_shannon_equals_scipys():
    rng = np.random.default_rng(0)
    a, b = rng.normal(10, 3, 5000).clip(0, 25), rng.normal(12, 2, 3000)
    edges = np.linspace(0, 25, 11)
    want = jensenshannon(np.histogram(a, edges)[0], np.histogram(b, edges)[0], base=2)
    assert jensen_shannon(SPEED, histogram(SPEED, a), histogram(SPEED, b)) == pytest.approx(want, abs=1e-12)


def test_jensen_shannon_of_equal_and_of_disjoint_distributions():
    a, b = histogram(SPEED, [1.0, 1.0]), histogram(SPEED, [20.0])
    assert jensen_shannon(SPEED, a, a) == 0.0
    assert jensen_shannon(SPEED, a, b) == pytest.approx(1.0)
    assert jensen_shannon(SPEED, a, histogram(SPEED, [])) is None


def test_wasserstein_equals_scipys_to_a_fine_bin():
    rng = np.random.default_rng(0)
    a, b = rng.normal(10, 3, 5000), rng.normal(12, 2, 3000)
    found = wasserstein(SPEED, histogram(SPEED, a), histogram(SPEED, b))
    assert found == pytest.approx(wasserstein_distance(a, b), abs=25 / 10 / FINE)


def test_values_outside_the_range_count_in_the_end_bins():
    counts = histogram(SPEED, [-3.0, 99.0, 25.0])
    assert counts[0] == 1
    assert counts[-1] == 2


def test_auc_by_hand():
    """Positives 3 and 1 against negatives 2 and 1: 3 > 2, 3 > 1, 1 < 2, 1 = 1 (half): 2.5 of 4."""
    scores = np.array([3.0, 1.0, 2.0, 1.0])
    assert area_under_curve(scores, np.array([True, True, False, False])) == pytest.approx(2.5 / 4)
    assert area_under_curve(scores, np.ones(4, dtype=bool)) is None


def test_logistic_regression_finds_the_separating_direction():
    rng = np.random.default_rng(0)
    x = rng.normal(size=(4000, 3))
    p = 1 / (1 + np.exp(-(1.5 * x[:, 0] - 0.5 * x[:, 1])))
    weights = logistic_regression(x, rng.random(4000) < p)
    np.testing.assert_allclose(weights, [1.5, -0.5, 0.0, 0.0], atol=0.15)


def test_classifier_cannot_tell_what_is_equal_and_can_tell_what_is_not():
    rng = np.random.default_rng(0)
    x = rng.normal(size=(1200, 4))
    generated = np.arange(1200) % 2 == 0
    scenes = [f"s{k % 12}" for k in range(600) for _ in range(2)]
    assert classifier_test(x, generated, scenes) == pytest.approx(0.5, abs=0.06)
    assert classifier_test(x + 3 * generated[:, None], generated, scenes) > 0.99


def test_classifier_is_tested_on_scenes_that_it_has_not_seen():
    """The label hangs on the scene alone (its number is a feature): known scenes could be told apart, new ones not."""
    rng = np.random.default_rng(0)
    number = np.repeat(np.arange(40), 20)
    generated = rng.random(40)[number] < 0.5
    x = np.eye(40)[number] + rng.normal(0, 0.01, (800, 40))
    assert classifier_test(x, generated, [f"s{k}" for k in number]) < 0.7
    assert classifier_test(x, generated, ["one"] * 800) is None


def test_halves_are_halves_and_the_same_every_time():
    bits = np.array([half_of("scene", f"t{k}") for k in range(4000)])
    np.testing.assert_allclose(bits.mean(axis=0), 0.5, atol=0.04)
    assert (half_of("scene", "t1") == half_of("scene", "t1")).all()


def _lanes_full(rng, prefix, speeds):
    tracks = []
    for k, speed in enumerate(speeds):
        x = speed * 0.1 * np.arange(60) + rng.normal(0, 0.003, 60)
        position = np.column_stack([x, np.full(60, 3.5 * (k % 2))])
        velocity = np.column_stack([np.full(60, speed), np.zeros(60)])
        tracks.append(
            Track(f"{prefix}{k}", "vehicle", 1, np.arange(60), position, np.zeros(60), velocity, BoxSize(4, 2))
        )
    return tracks


def test_distance_of_a_faster_generator_is_above_the_floor_and_of_an_equal_one_near_it(road):
    """Recorded 5 to 12 m/s; one generator draws the same, one 12 to 19 m/s."""
    rng = np.random.default_rng(0)
    found = {}
    for name, low in (("equal", 5.0), ("faster", 12.0)):
        total = RealismCounts()
        for scene in range(30):
            recorded = _lanes_full(rng, "r", rng.uniform(5, 12, 8))
            generated = _lanes_full(rng, "gen_", rng.uniform(low, low + 7, 8))
            arrays = stack([*recorded, *generated])
            moved, graph = motion(arrays), road(length_m=200)
            features = row_features(arrays, moved, safety(arrays, prepare_map(graph)))
            total.add(
                count_scene(
                    f"s{scene}", arrays, features, {"gen_0": [4.0], "r0": [3.0]},
                    generated=arrays.generated, recorded=~arrays.generated,
                )
            )  # fmt: skip
        found[name] = {distance.feature.name: distance for distance in total.distances()}
    assert found["equal"]["speed"].jensen_shannon < 2 * found["equal"]["speed"].jensen_shannon_floor
    assert found["faster"]["speed"].jensen_shannon > 4 * found["faster"]["speed"].jensen_shannon_floor
    assert found["faster"]["speed"].wasserstein == pytest.approx(7.0, abs=0.5)
    assert found["equal"]["lane_change_duration"].generated == 30
    assert found["equal"]["speed"].recorded == 30 * 8 * (60 - 4)


def test_scene_without_tracks_has_derivatives_without_rows():
    moved = motion(stack([]))
    assert moved.velocity.shape == moved.jerk.shape == (0, 2)
    assert moved.speed.shape == moved.yaw_accel.shape == (0,)
