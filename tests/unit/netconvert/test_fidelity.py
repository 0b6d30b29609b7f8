from collections.abc import Callable

import pytest

from netconvert.cells import build_cell_grid
from netconvert.fidelity import UNEXPLAINED, measure_fidelity
from netconvert.lane_graph import LaneGraph, LaneSegment
from netconvert.net_xml import net_bytes

Lane = Callable[..., LaneSegment]
Graph = Callable[..., LaneGraph]


@pytest.fixture
def road(lane: Lane, graph: Graph) -> LaneGraph:
    """
    3 <--------            oncoming
    2 ---------> 4
    1 --------->           successor 9 and right neighbour 8 outside the map
    """
    return graph(
        lane(1, [(0, 0), (6, 0.5), (12, 0)], left=2, right=8, successors=(9,)),
        lane(2, [(0, 4), (12, 4)], left=3, right=1, successors=(4,)),
        lane(3, [(12, 8), (0, 8)], left=2),
        lane(4, [(12, 4), (20, 4)]),
    )


def test_the_report_counts_what_is_in_the_net(road: LaneGraph) -> None:
    grid = build_cell_grid(road)
    report = measure_fidelity(grid, net_bytes(grid))
    assert (report.lanes, report.lanes_in_net) == (4, 4)
    # Lanes 1 (12.04 m) and 2 in 4 cells each, lane 3 in 3, lane 4 in 2; the first two share edges.
    assert (report.cells, report.edges) == (13, 9)
    links = {("successor", "kept"): 1, ("successor", "lost"): 1, ("neighbor", "kept"): 2, ("neighbor", "lost"): 1}
    assert report.links == links | {("neighbor", "oncoming"): 2}
    assert report.largest_distance_m <= 0.001
    assert {(link.kind, link.source, link.target, link.reason) for link in report.lost} == {
        ("successor", 1, 9, "the other lane is outside the map"),
        ("right_neighbor", 1, 8, "the other lane is outside the map"),
    }
    rows = dict(report.rows())
    assert (rows["lanes in / with cells"], rows["successor links kept"]) == ("4 / 4", "1 of 2")
    assert rows["lost: successor"] == "1 x the other lane is outside the map"


def test_the_report_is_measured_on_the_net_not_on_the_grid(road: LaneGraph) -> None:
    """Move one vertex by 0.3 m and cut the connection to lane 4: both are found."""
    grid = build_cell_grid(road)
    net = net_bytes(grid).replace(b"6.000,0.500", b"6.000,0.800")
    net = net.replace(b'to="4#0" fromLane="1"', b'to="5#0" fromLane="1"')
    report = measure_fidelity(grid, net)
    assert report.largest_distance_m == pytest.approx(0.3, abs=0.01)
    assert ("successor", 2, 4, UNEXPLAINED) in report.lost
