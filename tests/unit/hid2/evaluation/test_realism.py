"""Distances of distributions and the classifier test, against scipy and cases worked by hand."""

import numpy as np
import pytest
from hand_drawn import draw_driven, draw_road
from scipy.spatial.distance import jensenshannon
from scipy.stats import wasserstein_distance
from views import lane_view

from hid2.evaluation import realism
from hid2.evaluation.kinematics import motion
from hid2.evaluation.safety import safety
from hid2.evaluation.windows import half_numbers, windows
from hid2.measures.arrays import stack
from hid2.measures.manoeuvres import Maneuver, ManeuverKind

SPEED = realism.FEATURES[0]


def test_distances_equal_scipys_also_of_equal_and_of_disjoint_distributions():
    rng = np.random.default_rng(0)
    a, b = rng.normal(10, 3, 5000).clip(0, 25), rng.normal(12, 2, 3000)
    edges = np.linspace(0, 25, 26)
    want = jensenshannon(np.histogram(a, edges)[0], np.histogram(b, edges)[0], base=2)
    assert realism.apart(SPEED, realism.histogram(SPEED, a), realism.histogram(SPEED, b))[0] == pytest.approx(
        want, abs=1e-12
    )
    a, b = rng.normal(10, 3, 5000), rng.normal(12, 2, 3000)
    _, found = realism.apart(SPEED, realism.histogram(SPEED, a), realism.histogram(SPEED, b))
    assert found == pytest.approx(wasserstein_distance(a, b), abs=25 / 25 / realism.FINE)
    a, b = realism.histogram(SPEED, [1.0, 1.0]), realism.histogram(SPEED, [20.0])
    assert realism.apart(SPEED, a, a) == (0.0, 0.0)
    assert realism.apart(SPEED, a, b)[0] == pytest.approx(1.0)
    assert realism.apart(SPEED, a, realism.histogram(SPEED, [])) is None


def test_quantiles_by_hand():
    """Of 1, 2, ..., 100 tenths the lowest 5 % end at 0.5, half at 5.0; fine bins are 1 / 40 wide. Values outside the
    range count in the bins at the ends.
    """
    counts = realism.histogram(SPEED, np.arange(1, 101) / 10.0)
    low, middle = realism.quantiles(SPEED, counts, [0.05, 0.5])
    assert low == pytest.approx(0.5, abs=1 / realism.FINE)
    assert middle == pytest.approx(5.0, abs=1 / realism.FINE)
    assert realism.quantiles(SPEED, realism.histogram(SPEED, []), [0.5]) is None
    counts = realism.histogram(SPEED, [-3.0, 99.0, 25.0])
    assert (counts[0], counts[-1]) == (1, 2)


def test_halves_are_halves_and_the_same_every_time():
    names = [f"t{k}" for k in range(4000)]
    bits = half_numbers("scene", names)[:, None] >> np.arange(16) & 1
    np.testing.assert_allclose(bits.mean(axis=0), 0.5, atol=0.04)
    assert half_numbers("scene", names[:1]) == half_numbers("scene", names)[0]


def _lanes_full(rng, prefix, speeds):
    x = np.outer(speeds, 0.1 * np.arange(70)) + rng.normal(0, 0.003, (len(speeds), 70))
    return [draw_driven(f"{prefix}{k}", np.column_stack([x[k], np.full(70, 3.5 * (k % 2))])) for k in range(len(x))]


def test_distance_of_a_faster_generator_is_above_the_floor_and_of_an_equal_one_near_it():
    """Recorded 5 to 12 m/s; one generator draws the same, one 12 to 19 m/s."""
    rng = np.random.default_rng(0)
    found = {}
    for name, low in (("equal", 5.0), ("faster", 12.0)):
        total = realism.RealismCounts()
        for scene in range(12):
            recorded = _lanes_full(rng, "r", rng.uniform(5, 12, 8))
            generated = _lanes_full(rng, "gen_", rng.uniform(low, low + 7, 8))
            arrays = stack([*recorded, *generated], step_s=0.1)
            view = lane_view(arrays, draw_road(length_m=200))
            safe = safety(view)
            driving = windows(view, safe.leaders, scene=f"s{scene}", labelled=True)
            changes = [
                Maneuver(name, ManeuverKind.LANE_CHANGE, 0.0, 2.0, end_s, 1, 2, 1, complete=True)
                for name, end_s in (("gen_0", 4.0), ("r0", 3.0))
            ]
            total.add(realism.count_scene(arrays, safe, driving, changes, scene=f"s{scene}"))
        found[name] = {distance.feature: distance for distance in total.distances()}
    assert found["equal"]["speed"].jensen_shannon < 2 * found["equal"]["speed"].jensen_shannon_floor
    assert found["faster"]["speed"].jensen_shannon > 4 * found["faster"]["speed"].jensen_shannon_floor
    assert found["faster"]["speed"].wasserstein == pytest.approx(7.0, abs=0.5)
    assert found["equal"]["lane_change_duration"].generated_samples == 12
    # windows of 41 steps within 70, a second less at both ends, every half second
    assert found["equal"]["speed"].recorded_samples == 12 * 8 * 2


def test_scene_without_tracks_has_derivatives_without_rows():
    moved = motion(stack([], step_s=0.1))
    assert moved.speed_mps.shape == moved.yaw_accel_radps2.shape == (0,)
