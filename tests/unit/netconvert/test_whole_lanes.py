"""Plain files of whole lanes: edges of rows, connections of ways, signals; and the roads that they are made of."""

import re
from functools import partial

import numpy as np
import pytest
from hand_drawn import draw_lane
from lxml import etree

from netconvert.cells import build_cell_grid
from netconvert.lane_graph import LaneGraph, LaneSegment
from netconvert.net_xml import net_bytes
from netconvert.roads import Way, roads_of
from netconvert.whole_lanes import plain_files

_lane = partial(draw_lane, left_mark="NONE", right_mark="NONE")
#   2 ====>       5 -->      lane 4 of the intersection leads from lane 1 to lane 5, lanes 3 and 6 from lane 2 to 7
#   1 ====> 4, 3, 6 ..> 7
CROSSING = (
    _lane(1, [(0, 0), (20, 0)], left=2, successors=(4,)),
    _lane(2, [(0, 4), (20, 4)], successors=(3,)),
    _lane(3, [(20, 4), (25, 2)], is_intersection=True, successors=(6,)),
    _lane(4, [(20, 0), (40, 4)], is_intersection=True, successors=(5,)),
    _lane(5, [(40, 4), (60, 4)]),
    _lane(6, [(25, 2), (40, 0)], is_intersection=True, successors=(7,)),
    _lane(7, [(40, 0), (60, 0)]),
)


def graph_of(*lanes: LaneSegment) -> LaneGraph:
    return LaneGraph({lane.lane_id: lane for lane in lanes})


def test_rows_are_roads_and_lanes_of_an_intersection_are_ways_of_one_junction() -> None:
    """Lane 4 crosses 3 and 6, so both ways are in one junction: at the end of road 0, at the start of the others."""
    roads = roads_of(graph_of(*CROSSING))
    assert roads.rows == ((1, 2), (5,), (7,))
    assert set(roads.ways) == {Way(1, 5, (4,)), Way(2, 7, (3, 6))}
    (junction,) = roads.ways_of
    assert [name == junction for name in roads.junctions] == [False, True, True, False, True, False]
    assert roads.joint(junction) is None
    roads = roads_of(graph_of(_lane(1, [(0, 0), (20, 0)], successors=(2,)), _lane(2, [(20, 0), (40, 0)])))
    (junction,) = roads.ways_of
    assert roads.joint(junction) == (0, 1)  # a row that goes on as it is


def test_a_road_within_an_intersection_is_a_part_of_it() -> None:
    """Lane 3 leads from the intersection back into it."""
    graph = graph_of(
        _lane(1, [(0, 0), (10, 0)], successors=(2,)),
        _lane(2, [(10, 0), (20, 0)], is_intersection=True, successors=(3,)),
        _lane(3, [(20, 0), (22, 0)], successors=(4,)),
        _lane(4, [(22, 0), (30, 0), (15, -1), (15, 5), (40, 5)], is_intersection=True, successors=(5,)),
        _lane(5, [(40, 5), (60, 5)]),
    )
    assert roads_of(graph).ways == (Way(1, 5, (2, 3, 4)),)


def test_files_have_the_lanes_and_their_ways_and_no_signals_where_nothing_is_ever_red() -> None:
    files = {name: etree.fromstring(content) for name, content in plain_files(graph_of(*CROSSING), step_s=0.1).items()}
    edge = files["edge-files"].find("edge[@id='1']")
    assert [lane.find("param").get("value") for lane in edge.iterfind("lane")] == ["1", "2"]
    links = {
        tuple(map(link.get, ("from", "fromLane", "to", "toLane"))): link
        for link in files["connection-files"].iterfind("connection")
    }
    assert links.keys() == {("1", "0", "5", "0"), ("1", "1", "7", "0"), ("5",) + (None,) * 3, ("7",) + (None,) * 3}
    assert links["1", "1", "7", "0"].get("shape") == "20.000,4.000 25.000,2.000 25.000,2.000 40.000,0.000"
    assert "tllogic-files" not in files
    for shown in (None, np.array([*"ggggg"])):
        assert "tllogic-files" not in plain_files(graph_of(*CROSSING), shown=lambda _, it=shown: it, step_s=0.1)
    assert {node.get("type") for node in files["node-files"].iterfind("node")} == {"priority"}


def test_bus_lanes_are_for_buses_of_sumo_and_open_in_nets_of_cells() -> None:
    graph = graph_of(_lane(1, [(0, 0), (20, 0)]), _lane(2, [(0, 9), (20, 9)], lane_type="BUS"))
    for content, wanted in (
        (plain_files(graph, step_s=0.1)["edge-files"], [None, "bus"]),
        (net_bytes(build_cell_grid(graph, cell_m=20.0)), [None, None]),
    ):
        assert [lane.get("allow") for lane in etree.fromstring(content).iter("lane")] == wanted


def test_signals_are_a_program_as_long_as_the_recording() -> None:
    """Lane 4 is red for 2 of 5 steps of 0.5 s, lane 3 has a signal that is never red: two phases of 1.0 and 1.5 s."""
    files = plain_files(graph_of(*CROSSING), shown={4: np.array([*"rrggg"]), 3: np.array([*"ggggg"])}.get, step_s=0.5)
    program = etree.fromstring(files["tllogic-files"]).find("tlLogic")
    links = {link.get("fromLane"): int(link.get("linkIndex")) for link in program.itersiblings("connection")}
    phases = [(float(phase.get("duration")), phase.get("state")) for phase in program.iterfind("phase")]
    assert [duration for duration, _ in phases] == [1.0, 1.5]
    assert [state[links["0"]] for _, state in phases] == ["r", "g"]
    assert [state[links["1"]] for _, state in phases] == ["g", "g"]
    nodes = etree.fromstring(files["node-files"])
    assert [node.get("id") for node in nodes.iterfind("node[@type='traffic_light']")] == [program.get("id")]


def test_an_entrance_that_never_opens_is_named(caplog: pytest.LogCaptureFixture) -> None:
    """Lane 4 is red throughout, lane 3 at first."""
    plain_files(graph_of(*CROSSING), shown={4: np.array([*"rrrr"]), 3: np.array([*"rggy"])}.get, step_s=0.5)
    (said,) = caplog.messages
    assert re.fullmatch(r"junction J\d+: lanes 4 of the intersection were red throughout; .*stay so", said)
