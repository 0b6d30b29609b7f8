import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.sumo.poses import box_poses, sumo_poses


@pytest.mark.parametrize(
    ("heading", "front", "degrees"),
    [
        (0.0, (12.0, 20.0), 90.0),  # east
        (math.pi / 2, (10.0, 22.0), 0.0),  # north
        (math.pi, (8.0, 20.0), 270.0),  # west
        (-math.pi / 2, (10.0, 18.0), 180.0),  # south
    ],
)
def test_front_bumper_and_angle_of_a_box_of_four_metres(
    heading: float, front: tuple[float, float], degrees: float
) -> None:
    """Centre (10, 20), half a length of 2 m ahead; SUMO's angle is clockwise from north.

        N 0
    270 W + E 90
        S 180
    """
    where, angle = sumo_poses(np.array([10.0, 20.0]), np.array(heading), np.array(4.0))
    assert where == pytest.approx(np.array(front))
    assert float(angle) == pytest.approx(degrees)


@settings(derandomize=True, deadline=None)
@given(
    x=st.floats(-1e4, 1e4), y=st.floats(-1e4, 1e4), heading=st.floats(-3.14159, 3.14159), length=st.floats(0.3, 20.0)
)
def test_round_trip_gives_the_box_back(x: float, y: float, heading: float, length: float) -> None:
    front, angle = sumo_poses(np.array([[x, y]]), np.array([heading]), np.array([length]))
    assert 0.0 <= angle[0] < 360.0 or angle[0] == pytest.approx(360.0)
    center, back = box_poses(front, angle, np.array([length]))
    assert center[0] == pytest.approx([x, y], abs=1e-8)
    assert math.remainder(float(back[0]) - heading, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)
