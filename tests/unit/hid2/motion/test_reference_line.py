import math

import numpy as np
import pytest

from hid2.motion.reference_line import TABLE_STEP_M, ReferenceLine, build_reference_line
from netconvert.geometry import Polyline, resample


def _line(points: np.ndarray, **changes: float) -> ReferenceLine:
    return build_reference_line(points, **{"step_m": 1.0, "min_radius_m": 5.0, "max_offset_m": 0.6, **changes})


def _arc(radius: float, degrees: float, step_deg: float = 3.0) -> np.ndarray:
    angle = np.radians(np.arange(0.0, degrees + 1e-9, step_deg))
    return radius * np.column_stack([np.sin(angle), 1.0 - np.cos(angle)])


def _inside(line: ReferenceLine) -> slice:
    """Rows of the tables on the line itself, without those beyond its end."""
    return slice(0, int(line.length_m / TABLE_STEP_M) + 1)


def test_straight_line_stays_as_it_is_and_goes_straight_on_past_its_ends(straight_line: ReferenceLine) -> None:
    s = np.array([0.0, 12.3, 200.0])
    assert straight_line.length_m == pytest.approx(200.0)
    assert straight_line.position(s) == pytest.approx(np.column_stack([s, np.zeros(3)]), abs=1e-6)
    assert np.abs(straight_line.table_curvature).max() < 1e-9
    rows = _inside(straight_line)
    at = np.arange(straight_line.table_xy.shape[0])[rows] * TABLE_STEP_M
    assert straight_line.table_xy[rows] == pytest.approx(straight_line.position(at), abs=1e-6)
    assert straight_line.table_heading[rows] == pytest.approx(np.zeros(at.size), abs=1e-6)
    past = np.array([-3.0, 205.0])
    assert straight_line.position(past) == pytest.approx(np.array([[-3.0, 0.0], [205.0, 0.0]]), abs=1e-6)
    assert straight_line.motion(past)[2].tolist() == [1.0, 1.0]


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["left", "right"])
def test_circle_keeps_its_curvature_length_and_ends(side: float) -> None:
    """A quarter circle of 20 m: curvature 1 / 20 = 0.05, positive to the left, length 20 pi / 2 = 31.42 m.

    Its points stand 3 degrees apart, where the chord is 0.7 cm off the arc.
    """
    line = _line(_arc(20.0, 90.0) * [1.0, side])
    inner = line.table_curvature[_inside(line)][8:-8]
    assert inner == pytest.approx(np.full(inner.size, 0.05 * side), rel=0.05)
    assert line.table_heading[-1] == pytest.approx(side * math.pi / 2, abs=0.05)
    ends = np.array([[0.0, 0.0], [20.0, side * 20.0]])
    assert line.position(np.array([0.0, line.length_m])) == pytest.approx(ends, abs=1e-3)
    assert line.length_m == pytest.approx(20 * math.pi / 2, abs=0.02)
    radius = np.hypot(*(line.table_xy[_inside(line)] - [0.0, side * 20.0]).T)
    assert np.abs(radius - 20.0).max() < 0.02


def test_corner_is_rounded_but_not_cut() -> None:
    """A kink of 45 degrees cannot have R >= 5 m within 0.6 m: the line strays at most 0.6 m, and no kink is left.

    __________
              \\      an arc of radius R leaves the kink by R (1 / cos(22.5 deg) - 1) = 0.082 R: 0.6 m allows 7.3 m
               \\
    """
    kink = np.array([[0.0, 0.0], [30.0, 0.0], [30.0 + 30.0 * math.sqrt(0.5), -30.0 * math.sqrt(0.5)]])
    line = _line(kink)
    assert np.abs(Polyline(kink).frenet(line.table_xy)[1]).max() <= 0.6
    assert np.abs(line.table_curvature).max() <= 1.0 / 5.0


def test_wider_allowance_gives_a_gentler_corner_within_it() -> None:
    """An arc through a corner of 90 degrees leaves it by 0.41 R: R = 5 m needs 2.1 m, more than is allowed."""
    corner = np.array([[0.0, 0.0], [30.0, 0.0], [30.0, 30.0]])
    tight, wide = _line(corner), _line(corner, max_offset_m=2.0)
    assert np.abs(wide.table_curvature).max() < np.abs(tight.table_curvature).max()
    assert np.hypot(*(wide.points - resample(corner, step_m=1.0)).T).max() <= 2.0


def test_bend_of_eight_metres_needs_no_more_smoothing() -> None:
    """Radius 8 m is above R_min = 5 m, so the line stays on the arc by centimetres."""
    line = _line(_arc(8.0, 90.0))
    assert np.abs(line.table_curvature).max() <= 1.0 / 5.0
    assert np.abs(np.hypot(*(line.table_xy[_inside(line)] - [0.0, 8.0]).T) - 8.0).max() < 0.15


def test_parameter_is_arc_length() -> None:
    """|dr/ds| is 1 to a few parts in a thousand, also on a winding line."""
    x = np.arange(0.0, 120.0, 2.0)
    line = _line(np.column_stack([x, 4.0 * np.sin(x / 12.0)]))
    assert np.abs(line.motion(np.linspace(0.0, line.length_m, 400))[2] - 1.0).max() < 5e-3


@pytest.mark.parametrize("length", [0.25, 1.0, 4.0])
def test_shortest_lanes_have_a_line_too(length: float) -> None:
    line = _line(np.array([[0.0, 0.0], [length, 0.0]]))
    assert line.length_m == pytest.approx(length)
    assert line.position(np.array([length / 2]))[0] == pytest.approx([length / 2, 0.0], abs=1e-6)


def test_short_line_is_cut_evenly_wherever_its_points_lie() -> None:
    """4 m with a point at 0.1 m: pieces of at most 4 / 6.01 = 0.67 m are seven, of 4 / 7 m, from eight points."""
    line = _line(np.array([[0.0, 0.0], [0.1, 0.0], [4.0, 0.0]]))
    assert np.diff(line.points[:, 0]) == pytest.approx(np.full(7, 4.0 / 7.0))


@pytest.mark.parametrize(
    ("at", "reach_m", "beyond"), [((0.0, 30.0), 32.0, False), ((0.0, 34.0), 32.0, True), ((260.0, 0.0), 15.0, True)]
)
def test_line_is_beyond_another_one_where_they_are_too_far_apart_on_an_axis(
    straight_line: ReferenceLine, at: tuple[float, float], reach_m: float, beyond: bool
) -> None:
    """Both 200 m along x, with tables that go on to 240 m: 30 or 34 m apart across, or 20 m along."""
    other = _line(np.array([[0.0, 0.0], [200.0, 0.0]]) + at)
    assert straight_line.is_beyond(other, reach_m) == other.is_beyond(straight_line, reach_m) == beyond
