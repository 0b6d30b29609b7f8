"""Which points of a line are near a place."""

import numpy as np
import pytest

from hid2.kernels.raster import raster


@pytest.mark.parametrize("reach_m", [1.0, 6.0, 11.0])
def test_range_of_a_square_holds_every_point_within_reach(reach_m: float) -> None:
    """Of a figure of eight that comes back to where it was, points at most 0.65 m apart."""
    angle = np.linspace(0.0, 2 * np.pi, 900)
    loop = np.column_stack([60.0 * np.sin(angle), 30.0 * np.sin(2 * angle)])
    assert np.hypot(*np.diff(loop, axis=0).T).max() <= 0.65
    table = raster(loop, step_m=0.65, reach_m=reach_m)
    rng = np.random.default_rng(0)
    somewhere = 0
    for x, y in rng.uniform(-90.0, 90.0, (3000, 2)):
        near = np.flatnonzero(np.hypot(*(loop - [x, y]).T) <= reach_m)
        column, row = int(np.floor((x - table.x0) / table.side_m)), int(np.floor((y - table.y0) / table.side_m))
        inside = 0 <= column < table.first.shape[0] and 0 <= row < table.first.shape[1]
        if near.size:
            somewhere += 1
            assert inside
            assert table.first[column, row] <= near[0]
            assert table.last[column, row] >= near[-1]
    assert somewhere > 50


def test_range_is_empty_far_from_the_line_and_short_beside_a_straight_one() -> None:
    """Beside x = 50 of the x axis, with a reach of 5 m: no farther along than 5 m, a square and what is rounded up."""
    line = np.column_stack([np.arange(0.0, 200.0, 0.5), np.zeros(400)])
    table = raster(line, step_m=0.5, reach_m=5.0)
    column, row = int((50.0 - table.x0) / table.side_m), int((2.0 - table.y0) / table.side_m)
    first, last = int(table.first[column, row]), int(table.last[column, row])
    assert 50.0 - 14.0 < line[first, 0] < 45.5
    assert 54.5 < line[last, 0] < 50.0 + 14.0
    assert table.first.shape[1] * table.side_m < 2 * (5.0 + 2.0) + 2 * table.side_m
