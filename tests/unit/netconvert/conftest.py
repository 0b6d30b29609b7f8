"""Hand-drawn lanes: straight or bent centrelines with boundaries half a width to both sides."""

from collections.abc import Callable
from functools import partial

import pytest
from hand_drawn import draw_lane

from netconvert.lane_graph import LaneGraph, LaneSegment


@pytest.fixture
def lane() -> Callable[..., LaneSegment]:
    """lane(id, points, successors=(...), left=..., right=..., ...) -> LaneSegment, 4 m wide."""
    return partial(draw_lane, width_m=4.0)


@pytest.fixture
def graph() -> Callable[..., LaneGraph]:
    """graph(lane, lane, ...) -> LaneGraph."""
    return lambda *lanes: LaneGraph({lane.lane_id: lane for lane in lanes})
