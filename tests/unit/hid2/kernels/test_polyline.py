"""Projections on polylines: the compiled rule and the one of the map side."""

import numpy as np
import pytest

from hid2.kernels.polyline import frenet, project_on_polyline
from netconvert.geometry import Polyline


@pytest.mark.parametrize("seed", range(2))
def test_compiled_projection_agrees_with_polyline_frenet_on_random_polylines(seed: int) -> None:
    """Points beside segments, outside and inside of bends, and past both ends."""
    rng = np.random.default_rng(seed)
    line = Polyline(np.cumsum(rng.normal([3.0, 0.0], 2.0, (12, 2)), axis=0) + 5000.0)
    points = line.points[rng.integers(0, len(line.points), 400)] + rng.normal(0.0, 6.0, (400, 2))
    s, d = line.frenet(points)
    assert ((s < 0.0) | (s > line.length_m)).any()
    compiled = frenet(points, line.points, line.s)
    assert np.array_equal(compiled[0], s)
    assert np.array_equal(compiled[1], d)
    assert np.isin(s, line.s[1:-1]).any()


def test_projection_skips_points_that_repeat_the_one_before() -> None:
    """A line along x to (4, 0), whose second point stands twice; the point (3, 1) is 1 m to its left."""
    points, s = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 0.0], [4.0, 0.0]]), np.array([0.0, 2.0, 2.0, 4.0])
    assert project_on_polyline(3.0, 1.0, points, s, 0, 4) == (3.0, 1.0, 0.0, 1.0)
