"""Likelihoods of what was recorded among rollouts, worked by hand. Steps 11 to 90 are scored: 80 of them."""

import math

import numpy as np
import pytest
from hand_drawn import draw_box, draw_road

from hid2.evaluation.likelihood import FEATURES, Features, beyond_edge, features, likelihoods, scene_scores

NAMES = [feature.name.split(",")[0] for feature in FEATURES]
SPEED, NEAREST, COLLISION = NAMES.index("speed"), 4, NAMES.index("collision")


def of(speed, nearest=9.0, known=True):
    """Features of one agent with a constant speed and distance."""
    values = np.zeros((7, 1, 110))
    values[SPEED], values[NEAREST] = speed, nearest
    return Features(values, np.broadcast_to(known, values.shape))


def test_likelihood_of_a_speed_by_hand():
    """Ten bins of 2.5 m/s: 3 of 4 rollouts in that of 1 m/s, so 240.1 of 4 x 80 + 10 x .1 counts. Out of range a value
    is in the bin at the end.
    """
    found = likelihoods(of(1.0), [of(1.0), of(2.4), of(0.0), of(2.6)])
    assert found[SPEED, 0] == pytest.approx(math.log(240.1 / 321.0))
    assert likelihoods(of(99.0), [of(24.0)])[SPEED, 0] == pytest.approx(math.log(80.1 / 81.0))


def test_indication_counts_rollouts_in_which_it_ever_holds():
    """One of 4 rollouts touches at one step, which the recording does not: 3.001 of 4.002."""
    touches = of(1.0)
    touches.values[NEAREST, 0, 50] = 0.0
    found = likelihoods(of(1.0), [touches, of(1.0), of(1.0), of(1.0)])
    assert found[COLLISION, 0] == pytest.approx(math.log(3.001 / 4.002))


def test_steps_outside_of_those_scored_and_unknown_ones_do_not_count():
    known = np.zeros((7, 1, 110), dtype=bool)
    known[:, :, 40:60] = True
    recorded = of(1.0)._replace(known=known)
    recorded.values[SPEED, 0, :40] = recorded.values[SPEED, 0, 60:] = 20.0
    rolled = of(1.0)
    rolled.values[SPEED, 0, :11] = rolled.values[SPEED, 0, 91:] = 20.0
    assert likelihoods(recorded, [rolled])[SPEED, 0] == pytest.approx(math.log(80.1 / 81.0))


def test_agent_that_is_never_known_has_no_likelihood_and_none_in_its_scene():
    both = Features(*(np.concatenate(pair, axis=1) for pair in zip(of(1.0), of(1.0, known=False), strict=True)))
    found = likelihoods(both, [both])
    assert np.isnan(found[:, 1]).all()
    assert scene_scores(found)[SPEED] == pytest.approx(80.1 / 81.0)


def test_sum_is_weighted_as_in_the_challenge():
    """Logarithms 0 but for the collision at 1/2: weights .05 x 5, .1 x 2, .25 x 2 sum to .95, objects to .45."""
    found = np.zeros((9, 1))
    found[COLLISION] = math.log(0.5)
    kinematics, objects, road, every = scene_scores(found)[9:]
    assert (kinematics, road) == (1.0, 1.0)
    assert objects == pytest.approx(1.0 - 0.5 * 0.25 / 0.45)
    assert every == pytest.approx(1.0 - 0.5 * 0.25 / 0.95)


def test_features_of_two_cars_by_hand():
    """The follower at 10 m/s, the leader standing 30 m ahead of it at first; cars of 4.5 x 1.9 m, a road to y = -1.75.

        [F >]   30 m between centres   [L]

    At step 10 the centres are 20 m apart, 15.5 m between the bumpers, 1.55 s. At step 26 they touch. Half of 1.9 m
    beyond y = -2 a box is 2.95 m out, against the edge at 1.75 m.
    """
    traffic = draw_box(20.0, 0.0, speed=10.0, name="follower").joined(draw_box(50.0, 0.0, name="leader"))
    traffic.heading[0, :10] = np.pi  # a tracker has turned it round
    values, known = features(traffic, np.array([0]), beyond_edge(draw_road(lanes=1)), step_s=0.1)
    speed, acceleration, yaw, _, nearest, ttc, edge = values[:, 0]
    assert speed[10] == pytest.approx(10.0)
    assert (acceleration[10], yaw[10]) == pytest.approx((0.0, 0.0))
    assert nearest[10] == pytest.approx(15.5)
    assert nearest[26] == 0.0
    assert ttc[10] == pytest.approx(1.55)
    assert edge[10] == pytest.approx(-0.8, abs=0.05)
    assert known[SPEED, 0].sum() == 108
    values, _ = features(draw_box(50.0, -2.0), np.array([0]), beyond_edge(draw_road(lanes=1)), step_s=0.1)
    assert values[6, 0, 10] == pytest.approx(1.2, abs=0.05)
