"""The separating axis test."""

import math

import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from hid2.kernels import boxes as kernels
from netconvert.geometry import box_corners


@settings(deadline=None)
@given(st.floats(-6.0, 6.0), st.floats(-6.0, 6.0), st.floats(-4.0, 4.0), st.floats(-4.0, 4.0))
def test_overlap_and_distance_along_an_axis_agree_with_polygons(
    x: float, y: float, heading_a: float, heading_b: float
) -> None:
    """Boxes that lie apart along an axis share nothing, and lie at least so far from each other; others touch."""
    one = (0.0, 0.0, math.cos(heading_a), math.sin(heading_a), 2.25, 0.95)
    other = (x, y, math.cos(heading_b), math.sin(heading_b), 1.1, 0.45)
    apart = kernels.apart(*one, *other)
    a = shapely.Polygon(box_corners([0.0, 0.0], heading_a, length_m=4.5, width_m=1.9))
    b = shapely.Polygon(box_corners([x, y], heading_b, length_m=2.2, width_m=0.9))
    if apart > 1e-9:
        assert shapely.distance(a, b) >= apart - 1e-9
    if abs(apart) > 1e-9:
        assert kernels.overlap(*one, *other) == (apart < 0.0) == shapely.intersects(a, b)
