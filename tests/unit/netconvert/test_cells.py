import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hand_drawn import draw_lane
from hypothesis import given, settings
from hypothesis import strategies as st

from netconvert.cells import Cell, CellGrid, build_cell_grid
from netconvert.lane_graph import LaneGraph, LaneSegment

Lane = Callable[..., LaneSegment]
Graph = Callable[..., LaneGraph]


@pytest.fixture
def two_lanes(lane: Lane, graph: Graph) -> CellGrid:
    """
    lane 2 (10 m)    | 0 | 1 | 2 | 3 |   --> lane 3 (5 m)   | 0 | 1 |
    lane 1 (12.5 m)  | 0 | 1 | 2 | 3 |

    ceil(10 / 4) = 3 and ceil(12.5 / 4) = 4: both lanes get 4 cells.
    """
    return build_cell_grid(
        graph(
            lane(1, [(0, 0), (12.5, 0)], left=2, left_mark="SOLID_WHITE"),
            lane(2, [(0, 4), (10, 4)], right=1, right_mark="DASHED_WHITE", successors=(3,)),
            lane(3, [(10, 4), (15, 4)]),
        )
    )


def test_cells_come_by_lane_and_index_and_neighbours_share_the_larger_number(two_lanes: CellGrid) -> None:
    """With the middles of their centrelines; an arc length lies in the cell between whose borders it is."""
    assert [two_lanes.count(lane_id) for lane_id in (1, 2, 3)] == [4, 4, 2]
    assert two_lanes.edges_m[1].tolist() == [0.0, 3.125, 6.25, 9.375, 12.5]
    assert two_lanes.edges_m[2].tolist() == [0.0, 2.5, 5.0, 7.5, 10.0]
    assert two_lanes.borders[2].tolist() == [[0.0, 4.0], [2.5, 4.0], [5.0, 4.0], [7.5, 4.0], [10.0, 4.0]]
    assert two_lanes.cells[3:6] == (Cell(1, 3), Cell(2, 0), Cell(2, 1))
    assert all(two_lanes.index_of[cell] == index for index, cell in enumerate(two_lanes.cells))
    assert two_lanes.centers.shape == (10, 2)
    assert two_lanes.centers[two_lanes.index_of[Cell(2, 1)]].tolist() == [3.75, 4.0]
    assert two_lanes.length_m(Cell(1, 0)) == 3.125
    assert [two_lanes.cell_at(2, s).index for s in (-1.0, 0.0, 2.4, 2.5, 9.9, 10.0, 30.0)] == [0, 0, 0, 1, 3, 3, 3]


def test_longitudinal_links_end_with_the_lane_inter_lane_links_leave_from_its_last_cell_and_lateral_ones_face(
    two_lanes: CellGrid,
) -> None:
    assert [two_lanes.longitudinal(Cell(2, index)) for index in (2, 3)] == [Cell(2, 3), None]
    assert two_lanes.following(Cell(2, 3)) == (Cell(3, 0),)
    assert two_lanes.following(Cell(2, 2)) == (Cell(2, 3),)
    assert two_lanes.following(Cell(1, 3)) == ()
    assert two_lanes.lateral(Cell(1, 2), "left") == Cell(2, 2)
    assert two_lanes.lateral(Cell(2, 2), "right") == Cell(1, 2)
    assert two_lanes.lateral(Cell(2, 2), "left") is None
    assert two_lanes.lateral(Cell(3, 0), "right") is None


def test_facing_cells_are_lanes_of_one_edge_counted_from_the_right(two_lanes: CellGrid) -> None:
    assert two_lanes.sumo_lane_id(Cell(1, 2)) == "1#2_0"
    assert two_lanes.sumo_lane_id(Cell(2, 2)) == "1#2_1"
    assert two_lanes.edge_id(Cell(2, 2)) == "1#2"
    assert two_lanes.lane_index(Cell(2, 2)) == 1
    assert two_lanes.cell_of_sumo_lane["1#2_1"] == Cell(2, 2)
    assert (Cell(1, 2), Cell(2, 2)) in two_lanes.rows()
    assert [len(row) for row in two_lanes.rows()] == [2, 2, 2, 2, 1, 1]


def test_a_row_is_split_where_its_cells_are_skewed(lane: Lane, graph: Graph) -> None:
    """Lane 2 runs 6 m ahead of lane 1 at its start and 0 m at its end.

    lane 2 (14 m)        |  0  |  1  |  2  |  3  |  4  |
    lane 1 (20 m)  |   0   |   1   |   2   |   3   |   4   |

    Middles of cells at 2, 6, 10, 14, 18 m and at 7.4, 10.2, 13, 15.8, 18.6 m: skews 5.4, 4.2, 3.0, 1.8, 0.6 m.
    """
    lanes = graph(lane(1, [(0, 0), (20, 0)], left=2), lane(2, [(6, 4), (20, 4)], right=1))
    grid = build_cell_grid(lanes, max_skew_m=4.0)
    assert grid.count(1) == grid.count(2) == 5
    assert [grid.lateral(Cell(1, index), "left") is not None for index in range(5)] == [False, False, True, True, True]
    assert [grid.sumo_lane_id(Cell(2, index)) for index in (1, 2)] == ["2#1_0", "1#2_1"]
    assert grid.lost_links == ()
    assert len(set(grid.cell_of_sumo_lane)) == len(grid.cells)


def test_a_neighbour_link_is_lost_where_every_row_is_skewed_and_the_others_are_kept(lane: Lane, graph: Graph) -> None:
    grid = build_cell_grid(
        graph(
            lane(1, [(0, 0), (20, 0)], left=2),
            lane(2, [(0, 4), (20, 4)], left=3, right=1),
            lane(3, [(12, 8), (32, 8)], right=2),
        )
    )
    assert {link[:3] for link in grid.lost_links} == {("left_neighbor", 2, 3), ("right_neighbor", 3, 2)}
    assert grid.lost_links[0].reason == "facing cells are skewed by 12.0 m or more, 6.0 m is allowed"
    assert grid.lateral(Cell(1, 0), "left") == Cell(2, 0)
    assert grid.lateral(Cell(2, 0), "left") is None
    assert grid.sumo_lane_id(Cell(3, 0)) == "3#0_0"


@pytest.mark.parametrize(("within_m", "count"), [(None, 4), (0.4, 4), (0.2, 7), (0.1, 14)])
def test_facing_cells_get_lengths_that_one_length_can_stand_for(
    lane: Lane, graph: Graph, within_m: float | None, count: int
) -> None:
    """12.5 and 10 m differ by 2.5 m: ceil(2.5 / 0.79) = 4, ceil(2.5 / 0.39) = 7, ceil(2.5 / 0.19) = 14."""
    lanes = graph(lane(1, [(0, 0), (12.5, 0)], left=2), lane(2, [(0, 4), (10, 4)], right=1))
    grid = build_cell_grid(lanes, saved_within_m=within_m)
    assert grid.count(1) == grid.count(2) == count
    assert grid.lateral(Cell(1, 0), "left") == Cell(2, 0)


def test_lanes_are_split_apart_where_cells_would_be_tiny(lane: Lane, graph: Graph) -> None:
    """1 m beside 6 m: 13 cells of 0.08 m would do. Lane 3 is as long as lane 2 and stays beside it."""
    lanes = graph(
        lane(1, [(0, 0), (1, 0)], left=2),
        lane(2, [(0, 4), (6, 4)], left=3, right=1),
        lane(3, [(0, 8), (6, 8)], right=2),
    )
    grid = build_cell_grid(lanes, saved_within_m=0.2)
    assert grid.count(1) == 2
    assert grid.lateral(Cell(1, 0), "left") is None
    assert grid.lateral(Cell(2, 0), "left") == Cell(3, 0)
    assert {link.reason for link in grid.lost_links} == {"the lanes differ too much in length for one edge"}


def test_a_lane_that_ends_and_must_not_be_left_ends_alone(lane: Lane, graph: Graph) -> None:
    """
    lane 3  -------->  lane 4      goes on
    lane 2  --------|              must not be left to the left; to the right it may, where lane 1 ends alone
    lane 1  --------|              must not be left at all
    """
    lanes = graph(
        lane(1, [(0, 0), (8, 0)], left=2, left_mark="SOLID_WHITE"),
        lane(2, [(0, 4), (8, 4)], left=3, right=1, left_mark="SOLID_WHITE"),
        lane(3, [(0, 8), (8, 8)], right=2, successors=(4,)),
        lane(4, [(8, 8), (12, 8)]),
    )
    for within_m, last in ((None, [[1, 2, 3]]), (0.2, [[1], [2], [3]])):
        grid = build_cell_grid(lanes, saved_within_m=within_m)
        assert [[cell.lane_id for cell in row] for row in grid.rows()] == [[1, 2, 3], *last, [4]]


def test_boundaries_are_cut_at_equal_fractions() -> None:
    """A lane whose left boundary starts 2 m farther ahead: the middle cut goes from (8, -2) to (9, 2)."""
    lane = replace(
        draw_lane(1, [(1.0, 0.0), (16.0, 0.0)], width_m=4.0),
        left_boundary=np.array([[2.0, 2.0], [16.0, 2.0]]),
        right_boundary=np.array([[0.0, -2.0], [16.0, -2.0]]),
    )
    grid = build_cell_grid(LaneGraph({1: lane}))
    assert grid.count(1) == 4
    corners = {tuple(point) for point in shapely.get_coordinates(grid.polygons[2]).tolist()}
    assert corners == {(8.0, -2.0), (12.0, -2.0), (12.5, 2.0), (9.0, 2.0)}


@settings(deadline=None)
@given(length_m=st.floats(0.01, 300.0), cell_m=st.floats(1.0, 20.0), s=st.floats(0.0, 1.0))
def test_every_arc_length_is_in_exactly_one_cell_no_longer_than_asked(length_m: float, cell_m: float, s: float) -> None:
    points = np.array([[0.0, 0.0], [length_m / 2, 0.0], [length_m / 2, length_m / 2]])
    lane = draw_lane(1, points)
    grid = build_cell_grid(LaneGraph({1: lane}), cell_m=cell_m)
    assert grid.count(1) == max(1, math.ceil(lane.length_m / cell_m - 1e-9))
    assert np.diff(grid.edges_m[1]).max() <= cell_m + 1e-6
    assert grid.edges_m[1][-1] == lane.length_m
    index = grid.cell_at(1, s * lane.length_m).index
    assert grid.edges_m[1][index] - 1e-9 <= s * lane.length_m <= grid.edges_m[1][index + 1] + 1e-9
