"""Lanes and lines for the tests of the method: everything in metres, along +x."""

from collections.abc import Callable

import numpy as np
import pytest
from hand_drawn import draw_lane, draw_road

from hid2.motion.reference_line import ReferenceLine, build_reference_line
from hid2.motion.route import DrivenPath, LanePaths
from hid2.params import Limits
from netconvert.lane_graph import LaneGraph, LaneSegment


@pytest.fixture(scope="session")
def lane() -> Callable[..., LaneSegment]:
    """lane(id, points, successors=(...), left=..., right=..., ...) -> LaneSegment, 3.5 m wide."""
    return draw_lane


@pytest.fixture(scope="session")
def road() -> Callable[..., LaneGraph]:
    """road(lanes=2, length_m=200) -> lanes 1, 2, ... along +x from the right, 3.5 m apart, lane 1 at y = 0."""
    return draw_road


@pytest.fixture(scope="session")
def straight_line() -> ReferenceLine:
    """The x axis from 0 to 200 m."""
    return build_reference_line(np.array([[0.0, 0.0], [200.0, 0.0]]), step_m=1.0, min_radius_m=5.0, max_offset_m=0.6)


@pytest.fixture(scope="session")
def straight_path(road: Callable[..., LaneGraph]) -> DrivenPath:
    """The middle of the right lane of a two-lane road of 200 m."""
    return LanePaths(road(), Limits()).along((1,))
