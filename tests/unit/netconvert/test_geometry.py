import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import savgol_filter

from netconvert.geometry import Polyline, box_corners, resample, slopes, wrap_angle

# An L: 10 m east, then 10 m north.
#        |
#     ---+
BEND = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]])


def test_resampled_line_keeps_both_ends_and_never_steps_farther_than_asked() -> None:
    """20 m in steps of at most 6 m: four of 5 m; of at most 5 m: no step more."""
    points = resample(BEND, step_m=6.0)
    assert len(resample(BEND, step_m=5.0)) == 5
    assert points.tolist() == [[0.0, 0.0], [5.0, 0.0], [10.0, 0.0], [10.0, 5.0], [10.0, 10.0]]


@pytest.mark.parametrize(
    ("angle", "wrapped"),
    [(0.0, 0.0), (math.pi, math.pi), (-math.pi, math.pi), (1.5 * math.pi, -0.5 * math.pi), (-7.0, -7.0 + 2 * math.pi)],
)
def test_wrapped_angle_lies_above_minus_pi_up_to_pi(angle: float, wrapped: float) -> None:
    assert wrap_angle(angle) == pytest.approx(wrapped)


def test_point_and_heading_change_at_the_bend() -> None:
    line = Polyline(BEND)
    assert line.length_m == 20.0
    assert line.point([5.0, 10.0, 15.0]).tolist() == [[5.0, 0.0], [10.0, 0.0], [10.0, 5.0]]
    assert line.heading([5.0, 10.0, 15.0]).tolist() == pytest.approx([0.0, math.pi / 2, math.pi / 2])


def test_a_point_left_of_the_line_has_positive_d() -> None:
    """(4, 2) is 2 m left of the first leg; (12, 6) is 2 m right of the second, 6 m up it.

    (13, -4) is 5 m from the corner, right of both legs. Past its ends the line goes on straight.
    """
    line = Polyline(BEND)
    s, d = line.frenet([[4.0, 2.0], [12.0, 6.0], [13.0, -4.0], [-3.0, 1.0], [9.0, 14.0]])
    assert s.tolist() == pytest.approx([4.0, 16.0, 10.0, -3.0, 24.0])
    assert d.tolist() == pytest.approx([2.0, -2.0, -5.0, 1.0, 1.0])
    assert line.point([-3.0, 24.0]).tolist() == [[-3.0, 0.0], pytest.approx([10.0, 14.0])]


def test_repeated_points_do_not_disturb_the_frame() -> None:
    line = Polyline(np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 5.0], [0.0, 5.0], [0.0, 10.0], [0.0, 10.0]]))
    s, d = line.frenet([[-1.0, 5.0], [-1.0, -1.0], [-1.0, 12.0]])
    assert s.tolist() == pytest.approx([5.0, -1.0, 12.0])
    assert d.tolist() == pytest.approx([1.0, 1.0, 1.0])
    assert line.heading([0.0, 5.0, 10.0]).tolist() == pytest.approx([math.pi / 2] * 3)


@pytest.mark.parametrize(
    "points", [[[1.0, 2.0]], [[1.0, 2.0], [1.0, 2.0]], [[0.0, 0.0], [np.nan, 1.0]], [[1.0], [2.0]]]
)
def test_a_line_without_direction_is_refused(points: list[list[float]]) -> None:
    with pytest.raises(ValueError, match="polyline of"):
        Polyline(np.array(points))


def _arc(radius_m: float, angle: float) -> np.ndarray:
    phi = np.linspace(0.0, abs(angle), 40)
    return radius_m * np.column_stack([np.sin(phi), np.copysign(1.0, angle) * (1.0 - np.cos(phi))])


@settings(deadline=None)
@given(
    radius_m=st.floats(20.0, 200.0),
    angle=st.floats(-2.0, 2.0).filter(lambda angle: abs(angle) > 0.05),
    along=st.floats(-0.2, 1.2),
    d=st.floats(-6.0, 6.0),
)
def test_city_coordinates_come_back_from_frenet_coordinates(
    radius_m: float, angle: float, along: float, d: float
) -> None:
    """Off a vertex of the outer side a point has no (s, d) of its own: start from xy, and from points on a segment."""
    line = Polyline(_arc(radius_m, angle))
    xy = line.xy([along * line.length_m], [d])
    s, back = line.frenet(xy)
    returned = line.xy(s, back)
    segment_m = line.length_m / 39
    # In the wedge outside a vertex the normal turns by at most the angle between two segments.
    assert np.abs(returned - xy).max() <= abs(d) * abs(angle) / 39 + 1e-9
    assert abs(s[0] - along * line.length_m) <= segment_m
    assert abs(back[0] - d) <= max(1e-3, 1.0 - np.cos(angle / 39)) * abs(d) + 1e-9


def test_box_corners_go_round_from_the_front_left_and_sizes_broadcast_over_centers() -> None:
    r"""A 4 m x 2 m box at (10, 20) that faces north: its front is up, its left is west.

    (9, 22) +--+ (11, 22)
            |  |
    (9, 18) +--+ (11, 18)
    """
    corners = box_corners([10.0, 20.0], math.pi / 2, length_m=4.0, width_m=2.0)
    assert corners == pytest.approx(np.array([[9.0, 22.0], [11.0, 22.0], [11.0, 18.0], [9.0, 18.0]]))
    corners = box_corners(np.zeros((3, 5, 2)), np.zeros((3, 5)), length_m=np.array([[2.0], [4.0], [6.0]]), width_m=1.0)
    assert corners.shape == (3, 5, 4, 2)
    assert corners[:, 0, 0, 0].tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize(("count", "window"), [(3, 3), (40, 11), (11, 11)])
def test_slopes_of_parabolas_are_those_of_scipy(count: int, window: int) -> None:
    values = np.random.default_rng(7).normal(size=(count, 2))
    for columns in (values, values[:, 0]):
        assert np.allclose(
            slopes(columns, window, 0.1), savgol_filter(columns, window, 2, deriv=1, delta=0.1, axis=0), atol=1e-9
        )
