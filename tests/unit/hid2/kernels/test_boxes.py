"""The separating axis test."""

import math

import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from separating_axes import boxes_overlap

from hid2.kernels import boxes as kernels
from netconvert.geometry import box_corners


@pytest.mark.parametrize(
    ("x", "y", "heading", "overlap"),
    [
        (3.9, 0.0, 0.0, True),  # bumper 0.1 m into the other
        (4.0, 0.0, 0.0, True),  # bumpers touch
        (4.1, 0.0, 0.0, False),
        (0.0, 1.9, 0.0, True),
        (0.0, 2.1, 0.0, False),
        (2.9, 0.0, math.pi / 2, True),  # crosswise: half of 4 m and half of 2 m
        (3.1, 0.0, math.pi / 2, False),
        # At 45 degrees only the turned box's own axes separate the corners: the boxes' bounds do overlap.
        (3.0, 2.0, math.pi / 4, True),
        (3.6, 2.6, math.pi / 4 * 3, False),
    ],
)
def test_boxes_overlap_where_they_share_ground(x: float, y: float, heading: float, overlap: bool) -> None:
    """A 4 m x 2 m box at the origin against one of the same size."""
    a, b = (0.0, 0.0, 1.0, 0.0, 2.0, 1.0), (x, y, math.cos(heading), math.sin(heading), 2.0, 1.0)
    assert kernels.overlap(*a, *b) is overlap
    assert kernels.overlap(*b, *a) is overlap


@settings(deadline=None)
@given(st.floats(-6.0, 6.0), st.floats(-6.0, 6.0), st.floats(-4.0, 4.0), st.floats(-4.0, 4.0))
def test_distance_along_an_axis_agrees_with_polygons(x: float, y: float, heading_a: float, heading_b: float) -> None:
    """Boxes that lie apart along an axis share nothing, and lie at least so far from each other; others touch."""
    apart = kernels.apart(
        0.0, 0.0, math.cos(heading_a), math.sin(heading_a), 2.25, 0.95,
        x, y, math.cos(heading_b), math.sin(heading_b), 1.1, 0.45,
    )  # fmt: skip
    corners = (
        box_corners([0.0, 0.0], heading_a, length_m=4.5, width_m=1.9),
        box_corners([x, y], heading_b, length_m=2.2, width_m=0.9),
    )
    a, b = (shapely.Polygon(box) for box in corners)
    if apart > 1e-9:
        assert shapely.distance(a, b) >= apart - 1e-9
    elif apart < -1e-9:
        assert shapely.distance(a, b) == 0.0
        assert bool(boxes_overlap(*corners))
