"""Contacts at constant velocity, worked by hand: cars of 4 x 2 m along x, across it, and standing."""

import numpy as np
import pytest

from hid2.agents import FloatArray
from hid2.measures.surrogates import earliest_contact

Box = tuple[float, float, float, float]
Boxes = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]


def boxes(*rows: Box) -> Boxes:
    """Cars of 4 x 2 m, each x, y (m), heading (degrees) and speed (m/s)."""
    x, y, degrees, speed = np.array(rows, dtype=np.float64).T
    heading = np.radians(degrees)
    velocity = speed[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
    return np.column_stack([x, y]), heading, velocity, np.full(len(rows), 4.0), np.full(len(rows), 2.0)


@pytest.mark.parametrize(
    ("other", "ttc_s"),
    [
        # own car at the origin, eastward at 10 m/s; its front is at x = 2
        pytest.param((24.0, 0.0, 0.0, 0.0), 2.0, id="standing leader: 20 m at 10 m/s"),
        pytest.param((24.0, 0.0, 180.0, 10.0), 1.0, id="oncoming: 20 m at 20 m/s"),
        # front (y = -3) reaches own side (y = -1) at 0.4 s, but own front comes to x = 5 only at 0.3 s: 0.4
        pytest.param((6.0, -5.0, 90.0, 5.0), 0.4, id="crossing: 2 m at 5 m/s"),
        pytest.param((-14.0, 0.0, 0.0, 30.0), 0.5, id="follower: 10 m at 20 m/s"),
        pytest.param((3.0, 0.0, 0.0, 10.0), 0.0, id="overlap"),
        pytest.param((24.0, 2.1, 180.0, 10.0), np.inf, id="oncoming on the next lane"),
        pytest.param((35.0, 0.0, 0.0, 0.0), np.inf, id="3.1 s away"),
        pytest.param((10.0, 0.0, 0.0, 10.0), np.inf, id="leader at the same speed"),
        pytest.param((6.0, -40.0, 90.0, 5.0), np.inf, id="crosses after the vehicle has passed"),
    ],
)
def test_time_to_the_first_contact_within_the_horizon_is_that_of_the_boxes(other: Box, ttc_s: float) -> None:
    met = 1 if np.isfinite(ttc_s) else -1
    assert earliest_contact(0, *boxes((0, 0, 0, 10), other)) == (pytest.approx(ttc_s), met)


def test_the_first_of_several_contacts_counts_for_each_vehicle() -> None:
    """The eastward car meets the oncoming one (20 m at 20 m/s) before the standing one; the fourth is far away."""
    scene = boxes((0, 0, 0, 10), (34, 0, 0, 0), (24, 0, 180, 10), (0, 500, 0, 10))
    found = [earliest_contact(own, *scene) for own in range(4)]
    assert [(other, round(ttc_s, 9)) for ttc_s, other in found] == [(2, 1.0), (0, 3.0), (0, 1.0), (-1, np.inf)]


def test_contact_is_the_same_from_any_place_and_direction() -> None:
    """Turned by 2 rad and moved by kilometres, as city frames are."""
    position, heading, velocity, *sizes = boxes((0, 0, 0, 10), (6, -5, 90, 5), (24, 0, 180, 10))
    c, s = np.cos(2.0), np.sin(2.0)
    matrix = np.array([[c, s], [-s, c]])
    turned = position @ matrix + [4000.0, -3000.0], heading + 2.0, velocity @ matrix, *sizes
    for own in range(3):
        ttc_s, other = earliest_contact(own, position, heading, velocity, *sizes)
        assert earliest_contact(own, *turned) == (pytest.approx(ttc_s, abs=1e-6), other)
