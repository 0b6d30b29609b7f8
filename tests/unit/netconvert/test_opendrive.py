"""OpenDRIVE of lane graphs, read back by SUMO's netconvert: lanes on their centrelines, links, marks, place."""

from functools import partial
from pathlib import Path

import pytest
from drawn_roads import check_roads, segments
from hand_drawn import draw_lane
from lxml import etree

from netconvert.errors import NetError
from netconvert.lane_graph import LaneGraph, LaneSegment
from netconvert.net_xml import CITY_ORIGINS
from netconvert.opendrive import opendrive_bytes

_lane = partial(draw_lane, left_mark="NONE", right_mark="SOLID_WHITE")


def graph_of(*lanes: LaneSegment) -> LaneGraph:
    return LaneGraph({lane.lane_id: lane for lane in lanes})


#   3 ----------------> 6      the left lane ends 4 m before the right one; 5 turns left in the intersection
#   1 ------------------> 5, 4
SLANTED = (
    _lane(1, [(0, 0), (24, 0)], left=3, successors=(4, 5)),
    _lane(3, [(0, 4), (20, 4)], successors=(6,)),
    _lane(4, [(24, 0), (40, 0)], is_intersection=True, successors=(7,)),
    _lane(5, [(24, 0), (30, 2), (34, 8)], is_intersection=True, successors=(8,)),
    _lane(6, [(20, 4), (40, 4)], is_intersection=True, successors=(9,)),
    _lane(7, [(40, 0), (60, 0)], left=9),
    _lane(8, [(34, 8), (36, 30)]),
    _lane(9, [(40, 4), (60, 4)]),
)
ROADS = {
    "a slanted stop line": SLANTED,
    "a row that goes on as it is": (
        _lane(1, [(0, 0), (20, 0)], left=2, successors=(3,)),
        _lane(2, [(0, 4), (20, 4)], successors=(4,)),
        _lane(3, [(20, 0), (40, 0), (60, 3)], left=4),
        _lane(4, [(20, 4), (40, 4), (60, 7)]),
    ),
    "a fork without an intersection": (
        _lane(1, [(0, 0), (30, 0)], successors=(2, 3)),
        _lane(2, [(30, 0), (60, 6)]),
        _lane(3, [(30, 0), (60, -6)]),
    ),
    "lanes that come nearer to each other": (
        _lane(1, [(0, 0), (50, 0)], left=2),
        _lane(2, [(0, 6), (20, 5.5), (50, 3)]),
    ),
    "a lane that begins before the row, with nothing that leads to it": (
        _lane(1, [(10, 0), (40, 0)], left=2),
        _lane(2, [(16, 4), (40, 4)]),
        _lane(3, [(0, 0), (10, 4), (16, 4)], is_intersection=True, successors=(2,)),
        _lane(4, [(-20, 0), (0, 0)], successors=(3,)),
    ),
    "a sharp turn": (_lane(1, [(0, 0), (20, 0), (21, 0.4), (21.6, 1.4), (21.6, 20)]),),
    "the shortest lane": (_lane(1, [(0, 0), (0.05, 0)]),),
}


@pytest.mark.parametrize("name", ROADS)
def test_every_lane_is_on_its_centreline_and_leads_where_it_did(name: str, tmp_path: Path) -> None:
    graph = graph_of(*ROADS[name])
    (tmp_path / "roads.xodr").write_bytes(opendrive_bytes(graph, "test"))
    check_roads(tmp_path / "roads.xodr", graph, tmp_path)


def test_lanes_of_a_row_are_one_road_cut_where_the_shorter_lane_ends() -> None:
    """Lanes 1 and 3 are a road of 20 m; what is left of lane 1, 4 m, belongs to its ways: 20 m straight on in all."""
    root = etree.fromstring(opendrive_bytes(graph_of(*SLANTED), "test"))
    road = next(road for road in root.iter("road") if road.get("name") == "3 1")
    assert float(road.get("length")) == pytest.approx(20.0)
    assert [segments(lane) for lane in road.iterfind("lanes/laneSection/right/lane")] == [[3], [1]]
    straight = next(road for road in root.iter("road") if road.get("name") == "4")
    assert float(straight.get("length")) == pytest.approx(20.0)
    assert road.find("link/successor").get("elementType") == "junction"


@pytest.mark.parametrize(
    ("mark", "kind", "color", "change"),
    [
        ("SOLID_WHITE", "solid", "white", "none"),
        ("DASHED_YELLOW", "broken", "yellow", "decrease"),
        ("DASH_SOLID_WHITE", "broken solid", "white", "decrease"),
        ("DOUBLE_SOLID_YELLOW", "solid solid", "yellow", "none"),
        ("NONE", "none", "standard", "decrease"),
    ],
)
def test_a_marking_is_told_from_left_to_right(mark: str, kind: str, color: str, change: str) -> None:
    """Between two lanes, of which the right one must not change: the left lane's marking on its right side."""
    graph = graph_of(
        draw_lane(1, [(0, 0), (20, 0)], left=2, left_mark="SOLID_WHITE", right_mark="NONE"),
        draw_lane(2, [(0, 4), (20, 4)], left_mark="NONE", right_mark=mark),
    )
    root = etree.fromstring(opendrive_bytes(graph, "test"))
    found = root.find("road/lanes/laneSection/right/lane/roadMark")
    assert (found.get("type"), found.get("color"), found.get("laneChange")) == (kind, color, change)


def test_the_map_lies_on_the_globe() -> None:
    graph, origin = graph_of(_lane(1, [(0, 0), (20, 0)])), CITY_ORIGINS["miami"]
    header = etree.fromstring(opendrive_bytes(graph, "test", origin=origin)).find("header")
    assert header.find("geoReference").text == origin.projection
    assert float(header.find("offset").get("x")) == pytest.approx(origin.easting_m, abs=1e-3)
    assert etree.fromstring(opendrive_bytes(graph, "test")).find("header/geoReference") is None


def test_endless_ways_are_refused_in_one_line() -> None:
    """Ten forks one after the other in an intersection: 1,024 ways from lane 0."""
    lanes = [_lane(0, [(-10, 0), (0, 0)], successors=(1, 2))]
    for k in range(10):
        for side, lane_id in enumerate((2 * k + 1, 2 * k + 2)):
            line = [(10 * k, 0), (10 * k + 5, 3 - 6 * side), (10 * k + 10, 0)]
            onward = (2 * k + 3, 2 * k + 4) if k < 9 else (99,)
            lanes.append(_lane(lane_id, line, is_intersection=True, successors=onward))
    lanes.append(_lane(99, [(100, 0), (110, 0)]))
    with pytest.raises(NetError, match="lane 0: more than 200 ways"):
        opendrive_bytes(graph_of(*lanes), "test")
