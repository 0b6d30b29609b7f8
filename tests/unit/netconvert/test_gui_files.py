import csv
import io
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from lxml import etree

from netconvert.cells import CellGrid, build_cell_grid
from netconvert.gui_files import cells_csv, gui_files
from netconvert.lane_graph import LaneGraph, LaneSegment


@pytest.fixture
def grid(lane: Callable[..., LaneSegment]) -> CellGrid:
    ring = np.array([[0.0, -5.0], [20.0, -5.0], [20.0, 5.0], [0.0, -5.0]])
    return build_cell_grid(LaneGraph({5: lane(5, [(0, 0), (10, 0)], lane_type="BUS")}, (ring,)))


def test_the_cell_table_has_a_row_for_every_cell(grid: CellGrid) -> None:
    """10 m in three cells of 3.333 m."""
    rows = list(csv.DictReader(io.StringIO(cells_csv(grid).decode())))
    assert rows[1] == {
        "lane_segment_id": "5", "cell_index": "1", "sumo_lane_id": "5#1_0", "length_m": "3.333",
        "center_x_m": "5.000", "center_y_m": "0.000",
        "lane_type": "BUS",
    }  # fmt: skip
    assert len(rows) == 3


def test_the_drivable_area_lies_under_the_lanes_and_every_cell_is_outlined_above_its_lane(grid: CellGrid) -> None:
    """sumo-gui draws lanes on layer 100."""
    polygons = etree.fromstring(gui_files(grid, "scene", step_s=0.1)["scene.poly.xml"])
    (area,) = polygons.iterfind("poly[@type='drivable_area']")
    assert area.get("shape") == "0.00,-5.00 20.00,-5.00 20.00,5.00 0.00,-5.00"
    assert float(area.get("layer")) < 0
    cells = polygons.findall("poly[@type='cell']")
    assert [cell.get("id") for cell in cells] == ["cell_5_0", "cell_5_1", "cell_5_2"]
    assert all(float(cell.get("layer")) > 100 and cell.get("fill") == "0" for cell in cells)


def test_a_cell_in_which_the_boundaries_of_its_lane_cross_is_outlined_in_its_parts(
    lane: Callable[..., LaneSegment],
) -> None:
    """They cross at 16.8 m of 20, in the fourth of five cells: it is two triangles."""
    left, right = (np.array([[0.0, side * 2.0], [16.0, side * 2.0], [20.0, -side * 8.0]]) for side in (1, -1))
    crossed = replace(lane(5, [(0, 0), (20, 0)]), left_boundary=left, right_boundary=right)
    grid = build_cell_grid(LaneGraph({5: crossed}))
    assert {polygon.geom_type for polygon in grid.polygons} == {"Polygon", "MultiPolygon"}
    cells = etree.fromstring(gui_files(grid, "scene", step_s=0.1)["scene.poly.xml"]).findall("poly[@type='cell']")
    assert [cell.get("id") for cell in cells][3:] == ["cell_5_3", "cell_5_3_1", "cell_5_4"]


def test_the_view_can_be_closer_and_a_net_that_covers_more_ground_is_seen_as_close(grid: CellGrid) -> None:
    """The area is 20 m by 10 m, which 20 m of width show; half of it is seen twice as large.

    Zoom 100 shows all of the net: of 40 m, with a line beyond the area, twice as much as of 20 m.
    """
    shown = [{"shown": (np.array([0.0, -y]), np.array([x, y]))} for x, y in ((20.0, 5.0), (10.0, 2.0))]
    covered = [{"covered": lines} for lines in ((), [np.array([[30.0, 0.0], [40.0, 0.0]])])]
    for options in (shown, covered):
        views = [etree.fromstring(gui_files(grid, "s", step_s=0.1, **one)["s.view.xml"]) for one in options]
        zooms = [float(view.find("viewport").get("zoom")) for view in views]
        assert zooms[1] == pytest.approx(2 * zooms[0], rel=0.01)
