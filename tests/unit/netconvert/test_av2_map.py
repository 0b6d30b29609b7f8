from collections.abc import Sequence
from typing import Any

import pytest

from bridge.recordings.map_rules import graph_of
from netconvert.errors import MapError
from netconvert.lane_graph import TurnType

STRAIGHT = [(0.0, 0.0), (50.0, 0.0)]


def _json_points(points: Any) -> list[dict[str, float]]:
    return [{"x": float(x), "y": float(y), "z": 0.0} for x, y in points]


def lane_json(lane_id: int, points: Sequence[tuple[float, float]], **fields: Any) -> dict[str, Any]:
    """One lane segment as Argoverse 2 writes it, 4 m wide along +x."""
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


def map_json(*segments: dict[str, Any]) -> dict[str, Any]:
    """A map with one drivable area of 100 m x 20 m."""
    corners = [(0.0, -10.0), (100.0, -10.0), (100.0, 10.0), (0.0, 10.0)]
    return {
        "lane_segments": {str(segment["id"]): segment for segment in segments},
        "drivable_areas": {"7": {"id": 7, "area_boundary": _json_points(corners)}},
        "pedestrian_crossings": {},
    }


def test_a_lane_segment_has_its_points_once_its_width_and_turn_and_an_area_is_closed() -> None:
    """What the file says else is compared with av2's reading of real maps."""
    graph = graph_of(
        map_json(lane_json(5, [(0.0, 0.0), (0.0, 0.0), (20.0, 0.0), (20.0, 0.0), (50.0, 0.0)])), name="map"
    )
    lane = graph.lanes[5]
    assert lane.centerline.tolist() == [[0.0, 0.0], [20.0, 0.0], [50.0, 0.0]]
    assert (lane.left_mark_type, lane.right_mark_type) == ("DASHED_WHITE", "SOLID_WHITE")
    assert (lane.width_m, lane.length_m, lane.turn) == (4.0, 50.0, TurnType.STRAIGHT)
    assert graph.drivable_areas[0].shape == (5, 2)
    assert (graph.drivable_areas[0][0] == graph.drivable_areas[0][-1]).all()


@pytest.mark.parametrize("second", [[(13.0, -5.0), (13.0, 5.0)], [(13.0, 5.0), (13.0, -5.0)]])
def test_pedestrian_crossings_keep_their_corners_in_turn(second: list[tuple[float, float]]) -> None:
    """Two edges of 10 m, 3 m apart, whichever way the second one runs."""
    document = map_json(lane_json(5, STRAIGHT))
    crossing = {"id": 1, "edge1": _json_points([(10.0, -5.0), (10.0, 5.0)]), "edge2": _json_points(second)}
    document["pedestrian_crossings"] = {"1": crossing}
    (corners,) = graph_of(document, name="map").pedestrian_crossings
    assert corners.tolist() == [[10.0, -5.0], [10.0, 5.0], [13.0, 5.0], [13.0, -5.0]]


# Each case: what is wrong, the field changed, and what the message must say beside the file's name.
BAD_LANES = {
    "zero length": (
        {"centerline": [{"x": 1, "y": 2, "z": 0}] * 2},
        r"lane 5: centerline is 0\.000000 m long, expected",
    ),
    "beside its boundaries": (
        {"centerline": [{"x": x, "y": 3.5, "z": 0} for x in (0, 50)]},
        r"lane 5: centerline is 1\.5 m outside of its boundaries, expected it between them, or none",
    ),
    "backwards": ({"centerline": [{"x": x, "y": 0, "z": 0} for x in (50, 0)]}, "lane 5: centerline is 48.* m outside"),
    "mirrored": (
        {
            f"{side}_lane_boundary": [{"x": x, "y": y, "z": 0} for x in (0, 50)]
            for side, y in (("left", -2), ("right", 2))
        },
        "lane 5: left boundary is on the right of its lane, expected it on the left",
    ),
    "one point": ({"centerline": [{"x": 1, "y": 2, "z": 0}]}, "lane 5: centerline: 1 points, expected at least 2"),
    "boundary of one point": (
        {"left_lane_boundary": [{"x": 1, "y": 2, "z": 0}]},
        "lane 5: left_lane_boundary: 1 points, expected at least 2",
    ),
    "NaN": (
        {"centerline": [{"x": 1, "y": 2, "z": 0}, {"x": float("nan"), "y": 2, "z": 0}]},
        r"lane 5: centerline\[1\]\.x: nan, expected a finite number",
    ),
    "no y": ({"centerline": [{"x": 1}, {"x": 2}]}, r"lane 5: no centerline\[0\]\.y, expected the fields"),
    "words": (
        {"centerline": [{"x": 2, "y": 1, "z": 0}, {"x": "2", "y": 1, "z": 0}]},
        r"lane 5: centerline\[1\]\.x: '2', expected a valid number",
    ),
    "no points": ({"right_lane_boundary": None}, "lane 5: right_lane_boundary: None, expected a valid list"),
    "lane type": ({"lane_type": "TRAM"}, "lane 5: lane_type: 'TRAM', expected one of BIKE, BUS, VEHICLE"),
    "mark type": ({"left_lane_mark_type": None}, "lane 5: left_lane_mark_type: None, expected one of DASHED_WHITE"),
    "intersection": ({"is_intersection": "no"}, "lane 5: is_intersection: 'no', expected a valid boolean"),
    "successors": ({"successors": "7"}, "lane 5: successors: '7', expected a valid list"),
    "neighbour": ({"left_neighbor_id": 1.5}, "lane 5: left_neighbor_id: 1.5, expected a valid integer"),
    "id": ({"id": "5"}, "lane 5: id: '5', expected a valid integer"),
}


@pytest.mark.parametrize("case", BAD_LANES)
def test_a_broken_lane_is_refused_with_its_id_and_value(case: str) -> None:
    change, message = BAD_LANES[case]
    data = map_json(lane_json(5, STRAIGHT) | change)
    with pytest.raises(MapError, match=f"^the/map.json: {message}"):
        graph_of(data, name="the/map.json")


EMPTY: dict[str, Any] = {"lane_segments": {}, "drivable_areas": {}, "pedestrian_crossings": {}}
BIKES_AND_BUSES = map_json(lane_json(5, STRAIGHT, lane_type="BIKE"), lane_json(6, STRAIGHT, lane_type="BUS"))
LANE = map_json(lane_json(5, STRAIGHT))
ONE_EDGE = {"id": 77, "edge1": _json_points([(0.0, 0.0), (1.0, 0.0)])}
LACKING = {key: value for key, value in lane_json(5, STRAIGHT).items() if key not in ("successors", "lane_type")}


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ([], "no object 'lane_segments'"),
        ({"lane_segments": {}}, "no object 'drivable_areas'"),
        ({"lane_segments": {}, "drivable_areas": {}}, "no object 'pedestrian_crossings'"),
        (EMPTY, "no lane of type VEHICLE among 0 lane segments"),
        (EMPTY | {"lane_segments": {"5": None}}, "lane 5: NoneType, expected an object"),
        (BIKES_AND_BUSES, "no lane of type VEHICLE among 2 lane segments, expected at least one"),
        (map_json(LACKING), "lane 5: no lane_type, expected"),
        (LANE | {"drivable_areas": {"7": {"id": 7}}}, "drivable area 7: no area_boundary"),
        (LANE | {"pedestrian_crossings": {"77": ONE_EDGE}}, "pedestrian crossing 77: no edge2, expected the"),
        (LANE | {"lane_segments": {"6": lane_json(5, STRAIGHT)}}, "lane 6: id 5, expected its key"),
    ],
)
def test_json_that_is_no_map_or_not_whole_or_not_where_its_id_says_is_refused(data: Any, message: str) -> None:
    with pytest.raises(MapError, match=f"map: {message}"):
        graph_of(data, name="map")
