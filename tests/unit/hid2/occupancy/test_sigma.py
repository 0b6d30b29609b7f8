import numpy as np
import pytest
from hand_drawn import draw_box, draw_road

from hid2.occupancy.sigma import FREE, ORIGINAL, CellBoxes, cell_boxes, dwell_steps, is_agent_on, original_occupancy
from netconvert.cells import Cell, CellGrid, build_cell_grid


@pytest.fixture(scope="module")
def grid() -> CellGrid:
    """Two lanes of 40 m, ten cells of 4 m each: lane 1 at y = 0, lane 2 at y = 3.5, both 3.5 m wide, along +x."""
    return build_cell_grid(draw_road(lanes=2, length_m=40.0))


@pytest.fixture(scope="module")
def boxes(grid: CellGrid) -> CellBoxes:
    return cell_boxes(grid)


def test_cells_are_boxes_on_the_centreline(grid: CellGrid, boxes: CellBoxes) -> None:
    """Cell (2, 3) covers x = 12 .. 16 of lane 2: centre (14, 3.5), 4 m long, 3.5 m wide, heading 0."""
    row = grid.index_of[Cell(2, 3)]
    assert boxes.center[row] == pytest.approx([14.0, 3.5])
    assert (boxes.heading[row], boxes.length_m[row], boxes.width_m[row]) == pytest.approx((0.0, 4.0, 3.5))


@pytest.mark.parametrize(
    ("pose", "cell"),
    [
        ((13.0, 1.7, 0.0), Cell(1, 3)),  # level 1: the cell that holds the centre
        ((13.0, 1.8, 0.0), Cell(2, 3)),
        ((13.0, 1.7, np.pi / 4), Cell(1, 3)),  # 45 degrees agree, and (14, 0) is no nearer
        ((13.0, -2.2, 0.0), Cell(1, 3)),  # level 2: lane 1 reaches to y = -1.75, the centre is 0.45 m outside
        ((13.5, 1.1, np.pi / 2), Cell(1, 3)),  # level 3: crosswise; the nearest cell centre, (14, 0), is 1.2 m away
        ((14.0, -3.5, np.pi), Cell(1, 3)),
        ((14.0, -6.0, 0.0), None),  # level 4: 6 m from the nearest cell; a box to everybody, but without a cell
    ],
)
def test_cell_of_a_vehicle_is_told_by_four_levels(
    pose: tuple[float, float, float], cell: Cell | None, grid: CellGrid, boxes: CellBoxes
) -> None:
    found = original_occupancy(boxes, draw_box(*pose, steps=1)).cell[0, 0]
    assert (grid.cells[found] if found >= 0 else None) == cell


@pytest.mark.parametrize(
    ("place", "length_m", "held"),
    [
        ((14.0, 0.0), 4.5, {Cell(1, 2), Cell(1, 3), Cell(1, 4)}),  # x = 11.75 .. 16.25, y = -0.95 .. 0.95
        ((14.0, 1.75), 3.0, {Cell(1, 3), Cell(2, 3)}),  # between two lanes
        ((18.0, 0.0), 11.0, {Cell(1, 3), Cell(1, 4), Cell(1, 5)}),  # a bus: 12.5 .. 23.5
    ],
)
def test_vehicle_occupies_every_cell_its_box_covers(
    place: tuple[float, float], length_m: float, held: set[Cell], grid: CellGrid, boxes: CellBoxes
) -> None:
    """
    8       12       16       20
    |   2  [|===3====|]  4    |
    """
    sigma = original_occupancy(boxes, draw_box(*place, steps=1, length_m=length_m)).sigma[0]
    assert {grid.cells[row] for row in np.flatnonzero(sigma == ORIGINAL)} == held
    assert set(np.unique(sigma)) == {FREE, ORIGINAL}


def test_occupancy_follows_the_vehicle_and_releases_the_cells_behind(grid: CellGrid, boxes: CellBoxes) -> None:
    """10 m/s from x = 6: after 1 s at 16. Cell 1 (4 .. 8) is free again, cell 4 (16 .. 20) is held.

    One that is absent occupies nothing.
    """
    sigma = original_occupancy(boxes, draw_box(6.0, 0.0, 0.0, 10.0, steps=11)).sigma
    one, four = grid.index_of[Cell(1, 1)], grid.index_of[Cell(1, 4)]
    assert sigma[0, [one, four]].tolist() == [ORIGINAL, FREE]
    assert sigma[10, [one, four]].tolist() == [FREE, ORIGINAL]
    found = original_occupancy(boxes, draw_box(14.0, 0.0, steps=4, first=2))
    assert not found.sigma[:2].any()
    assert (found.cell[0] >= 0).tolist() == [False, False, True, True]


def test_dwell_time_is_rounded_up_to_whole_steps() -> None:
    """4 m at 9 m/s are 0.444 s: 5 steps of 0.1 s. At 10 m/s 0.4 s: 4 steps exactly."""
    assert dwell_steps(cell_m=4.0, speed_mps=9.0, step_s=0.1) == 5
    assert dwell_steps(cell_m=4.0, speed_mps=10.0, step_s=0.1) == 4
    assert dwell_steps(cell_m=4.0, speed_mps=0.0, step_s=0.1) is None  # it stands


def test_somebody_on_some_of_the_cells(grid: CellGrid, boxes: CellBoxes) -> None:
    """10 m/s from x = 6 in lane 1: on cell 1 at first, after 1 s on cell 4; never on lane 2."""
    someone = draw_box(6.0, 0.0, 0.0, 10.0, steps=11)
    first, second = grid.index_of[Cell(1, 0)], grid.index_of[Cell(2, 0)]

    def is_on(cell: int, step: int, *, until: int | None = None) -> bool:
        return is_agent_on(boxes, np.arange(cell, (cell if until is None else until) + 1), someone, step)

    assert (is_on(first + 1, 0), is_on(first + 4, 0), is_on(first + 1, 0, until=first + 4)) == (True, False, True)
    assert (is_on(first + 1, 10), is_on(first + 4, 10)) == (False, True)
    assert not is_on(second + 1, 0)
    assert not is_agent_on(boxes, np.arange(first, first + 3), draw_box(6.0, 0.0, steps=4, first=2), 0)
