from collections.abc import Callable

import pytest
from lxml import etree

from netconvert.cells import CellGrid, build_cell_grid
from netconvert.lane_graph import LaneGraph, LaneSegment
from netconvert.net_xml import net_bytes

Lane = Callable[..., LaneSegment]
Graph = Callable[..., LaneGraph]


@pytest.fixture
def fork(lane: Lane, graph: Graph) -> LaneGraph:
    """
    2 (bicycles)  -------->
    1             --------+--> 3 (straight on)
                           \\-> 4 (right turn)
    """
    return graph(
        lane(1, [(0, 0), (5, 0), (8, 0)], left=2, successors=(3, 4), left_mark="SOLID_WHITE"),
        lane(2, [(0, 3), (8, 3)], right=1, lane_type="BIKE", width_m=1.5),
        lane(3, [(8, 0), (12, 0)]),
        lane(4, [(8, 0), (10, 0), (11, -1), (11, -3)], is_intersection=True),
    )


def _net(graph: LaneGraph) -> etree._Element:
    return etree.fromstring(net_bytes(build_cell_grid(graph)))


def test_a_row_of_cells_is_an_edge_and_a_cell_is_a_lane_of_a_net_with_a_version_and_no_offset(fork: LaneGraph) -> None:
    """Without a version attribute a broken reference would crash SUMO."""
    net = _net(fork)
    assert net.get("version") == "1.20"
    assert net.find("location").get("netOffset") == "0.00,0.00"
    assert net.find("location").get("convBoundary") == "0.00,-3.00,12.00,3.00"
    lanes = {edge.get("id"): [lane.get("id") for lane in edge.iterfind("lane")] for edge in net.iterfind("edge")}
    assert lanes == {
        "1#0": ["1#0_0", "1#0_1"], "1#1": ["1#1_0", "1#1_1"], "3#0": ["3#0_0"], "4#0": ["4#0_0"],
        "4#1": ["4#1_0"],
    }  # fmt: skip


def test_lanes_have_their_segment_shapes_arc_lengths_widths_bicycles_and_solid_lines(fork: LaneGraph) -> None:
    """Lane 1 is cut at 4 m; its vertex at 5 m belongs to the second cell. Lane 4 is 2 + sqrt(2) + 2 = 5.414214 m long:
    two cells of 2.707107 m. Lane 2 is for bicycles alone.

    Lane 1 sees a solid line on its left, which emergency vehicles cross alone, lane 2 a dashed one on its right; the
    outer sides need no rule.
    """
    lanes = {lane.get("id"): lane for lane in _net(fork).iter("lane")}
    assert lanes["1#0_0"].get("shape") == "0.000,0.000 4.000,0.000"
    assert lanes["1#1_0"].get("shape") == "4.000,0.000 5.000,0.000 8.000,0.000"
    assert lanes["4#0_0"].get("length") == "2.707107"
    assert (lanes["1#0_1"].get("width"), lanes["1#0_1"].get("allow")) == ("1.50", "bicycle")
    assert lanes["1#0_0"].get("allow") is None
    assert lanes["1#0_1"].find("param").attrib == {"key": "av2.lane_segment_id", "value": "2"}
    assert (lanes["1#0_0"].get("changeLeft"), lanes["1#0_0"].get("changeRight")) == ("emergency", None)
    assert (lanes["1#0_1"].get("changeLeft"), lanes["1#0_1"].get("changeRight")) == (None, None)


def test_connections_are_the_longitudinal_and_inter_lane_links(fork: LaneGraph) -> None:
    links = {
        tuple(link.get(key) for key in ("from", "fromLane", "to", "toLane", "dir"))
        for link in _net(fork).iterfind("connection")
    }
    assert links == {
        ("1#0", "0", "1#1", "0", "s"), ("1#0", "1", "1#1", "1", "s"), ("1#1", "0", "3#0", "0", "s"),
        ("1#1", "0", "4#0", "0", "r"),
        ("4#0", "0", "4#1", "0", "s"),
    }  # fmt: skip


def test_connected_edges_meet_in_one_junction(fork: LaneGraph) -> None:
    net = _net(fork)
    ends = {edge.get("id"): (edge.get("from"), edge.get("to")) for edge in net.iterfind("edge")}
    assert ends["1#1"][1] == ends["3#0"][0] == ends["4#0"][0]
    assert len({junction for pair in ends.values() for junction in pair}) == len(list(net.iterfind("junction"))) == 6
    (meeting,) = [j for j in net.iterfind("junction") if j.get("id") == ends["1#1"][1]]
    assert meeting.get("incLanes") == "1#1_0 1#1_1"
    assert meeting.get("type") == "unregulated"
    # The middle of the ends at (8, 0), (8, 3), (8, 0), (8, 0).
    assert (meeting.get("x"), meeting.get("y")) == ("8.000", "0.750")


def test_a_net_to_be_saved_has_one_length_an_edge_and_junctions_beside_the_lanes(fork: LaneGraph) -> None:
    """Edge 1#0 is 4 m on both lanes. The freest of 16 directions about (8, 0), 0.3 m away, is the one furthest from the
    lanes that run east through it, of which lane 4 turns to the right after 2 m: straight up, or straight down.
    """
    net = etree.fromstring(net_bytes(build_cell_grid(fork, saved_within_m=0.2)))
    assert {edge.get("id"): edge.get("length") for edge in net.iterfind("edge")}["1#0"] == "4.000000"
    assert {lane.get("customShape") for lane in net.iter("lane")} == {"1"}
    junctions = {junction.get("id"): junction for junction in net.iterfind("junction")}
    (meeting,) = {edge.get("to") for edge in net.iterfind("edge") if edge.get("id") == "1#1"}
    assert junctions[meeting].get("customShape") == "1"
    points = [tuple(map(float, point.split(","))) for point in junctions[meeting].get("shape").split()]
    assert [(x, abs(y)) for x, y in points] == [(8.0, 0.3), (8.0, 0.32)]


def test_a_net_to_be_saved_has_no_vertices_within_a_centimetre_of_a_border(lane: Lane, graph: Graph) -> None:
    lanes = graph(lane(1, [(0, 0), (0.01, 0), (1, 0), (3.98, 0), (4, 0)]))
    shapes = [_only_shape(build_cell_grid(lanes, saved_within_m=within)) for within in (None, 0.2)]
    assert shapes[0] == "0.000,0.000 0.010,0.000 1.000,0.000 3.980,0.000 4.000,0.000"
    assert shapes[1] == "0.000,0.000 1.000,0.000 3.980,0.000 4.000,0.000"


def _only_shape(grid: CellGrid) -> str:
    (lane,) = etree.fromstring(net_bytes(grid)).iter("lane")
    return lane.get("shape")


def test_signal_of_a_lane_holds_the_connections_that_lead_to_it(fork: LaneGraph) -> None:
    net = etree.fromstring(net_bytes(build_cell_grid(fork), signals={4: (5.0, ((20.0, "G"), (30.0, "r")))}))
    (program,) = net.iterfind("tlLogic")
    assert (program.get("id"), program.get("offset")) == ("S4", "5")
    assert [(phase.get("duration"), phase.get("state")) for phase in program] == [("20", "G"), ("30", "r")]
    held = {one.get("to"): one.get("tl") for one in net.iterfind("connection") if one.get("tl")}
    assert held == {"4#0": "S4"}
