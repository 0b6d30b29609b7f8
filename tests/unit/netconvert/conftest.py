"""Hand-drawn lanes: straight or bent centrelines with boundaries half a width to both sides."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import pytest
from hand_drawn import draw_lane

from netconvert.lane_graph import LaneGraph, LaneSegment

Points = Sequence[tuple[float, float]]


def _json_points(points: Any) -> list[dict[str, float]]:
    return [{"x": float(x), "y": float(y), "z": 0.0} for x, y in points]


@pytest.fixture
def lane() -> Callable[..., LaneSegment]:
    """lane(id, points, successors=(...), left=..., right=..., ...) -> LaneSegment, 4 m wide."""
    return partial(draw_lane, width_m=4.0)


@pytest.fixture
def graph() -> Callable[..., LaneGraph]:
    """graph(lane, lane, ...) -> LaneGraph."""
    return lambda *lanes: LaneGraph({lane.lane_id: lane for lane in lanes})


@pytest.fixture
def lane_json() -> Callable[..., dict[str, Any]]:
    """lane_json(id, points, **fields) -> one lane segment as Argoverse 2 writes it, 4 m wide along +x."""

    def make(lane_id: int, points: Points, **fields: Any) -> dict[str, Any]:
        return {
            "id": lane_id,
            "centerline": _json_points(points),
            "is_intersection": False,
            "lane_type": "VEHICLE",
            "left_lane_boundary": _json_points([(x, y + 2.0) for x, y in points]),
            "right_lane_boundary": _json_points([(x, y - 2.0) for x, y in points]),
            "left_lane_mark_type": "DASHED_WHITE",
            "right_lane_mark_type": "SOLID_WHITE",
            "left_neighbor_id": None,
            "right_neighbor_id": None,
            "predecessors": [],
            "successors": [],
            **fields,
        }

    return make


@pytest.fixture
def map_json() -> Callable[..., dict[str, Any]]:
    """map_json(segment, segment, ...) -> a map with one drivable area of 100 m x 20 m."""

    def make(*segments: dict[str, Any]) -> dict[str, Any]:
        corners = [(0.0, -10.0), (100.0, -10.0), (100.0, 10.0), (0.0, 10.0)]
        return {
            "lane_segments": {str(segment["id"]): segment for segment in segments},
            "drivable_areas": {"7": {"id": 7, "area_boundary": _json_points(corners)}},
            "pedestrian_crossings": {},
        }

    return make
