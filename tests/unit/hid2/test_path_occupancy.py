from collections.abc import Callable

import numpy as np
import pytest
from views import SIZE, occupancy_of

from hid2.path_occupancy import path_occupancy
from hid2.reference_line import ReferenceLine, build_reference_line
from hid2.traffic import Traffic


def test_box_across_the_path_forbids_half_its_width_and_half_the_own_length(
    straight_line: ReferenceLine, box: Callable[..., Traffic]
) -> None:
    """A box of 4 x 2 crosswise at x = 50; the own one is 4 m long: centres from 50 - 1 - 2 = 47 to 53 touch it.

              ||                 sampled every 0.5 m and widened by one sample: 46.5 .. 53.5 at the most
    [own]---->||
              47   53
    """
    found = occupancy_of(straight_line, box(50.0, 0.0, np.pi / 2, steps=3, **SIZE))
    assert found.low.shape == (1, 3)
    assert 46.5 - 1e-9 <= found.low[0, 0] <= 47.0
    assert 53.0 <= found.high[0, 0] <= 53.5 + 1e-9
    assert not found.aligned.any()


def test_box_ahead_forbids_from_bumper_to_bumper(straight_line: ReferenceLine, box: Callable[..., Traffic]) -> None:
    """Both 4 m long: 50 - 4 = 46 to 54. It drives at 6 m/s along the path."""
    found = occupancy_of(straight_line, box(50.0, 0.0, 0.0, 6.0, steps=3, **SIZE))
    assert found.low[0, 0] == pytest.approx(46.0, abs=0.51)
    assert found.high[0, 0] == pytest.approx(54.0, abs=0.51)
    assert found.along[0, 0] == pytest.approx(6.0)
    assert found.aligned.all()


def test_oncoming_box_is_not_aligned_and_moves_against_the_path(
    straight_line: ReferenceLine, box: Callable[..., Traffic]
) -> None:
    found = occupancy_of(straight_line, box(50.0, 0.0, np.pi, 6.0, steps=3, **SIZE))
    assert found.along[0, 0] == pytest.approx(-6.0)
    assert not found.aligned.any()


def test_lateral_margin_counts_a_box_beside_the_path(straight_line: ReferenceLine, box: Callable[..., Traffic]) -> None:
    """At y = 2.2 half widths 1 + 1 leave 0.2 m between; a margin of 0.25 m closes it."""
    beside = box(50.0, 2.2, steps=1, **SIZE)
    assert occupancy_of(straight_line, beside).low.shape[0] == 0
    assert occupancy_of(straight_line, beside, margin_m=0.25).low.shape[0] == 1


def test_agents_that_never_touch_the_path_are_left_out(
    straight_line: ReferenceLine, box: Callable[..., Traffic]
) -> None:
    both = box(50.0, 10.0).joined(box(80.0, 0.0))
    assert occupancy_of(straight_line, both).low.shape[0] == 1


def test_absent_steps_are_free(straight_line: ReferenceLine, box: Callable[..., Traffic]) -> None:
    found = occupancy_of(straight_line, box(50.0, 0.0, steps=4, first=2, **SIZE))
    assert np.isinf(found.low[0, :2]).all()
    assert np.isfinite(found.low[0, 2:]).all()


def test_small_box_between_two_samples_is_not_jumped_over(
    straight_line: ReferenceLine, box: Callable[..., Traffic]
) -> None:
    """A pedestrian of 0.6 m right at the start, or far along, is found: the march slows before it reaches anybody."""
    for x in (0.0, 3.3, 119.77, 199.9):
        found = occupancy_of(straight_line, box(x, 0.5, steps=1, length_m=0.6, width_m=0.6))
        assert found.low.shape[0] == 1, x
        assert found.low[0, 0] <= max(x - 2.3, 0.0)
        assert found.high[0, 0] >= min(x + 2.3, 200.0) - 0.5


def test_intervals_hold_every_arc_length_that_really_touches(box: Callable[..., Traffic]) -> None:
    """On a bend, against boxes at every angle: what touches when tested box by box lies inside the interval."""
    from netconvert.geometry import box_corners, boxes_overlap

    angle = np.linspace(0.0, np.pi / 2, 40)
    bend = 30.0 * np.column_stack([np.sin(angle), 1 - np.cos(angle)])
    line = build_reference_line(bend, step_m=1.0, min_radius_m=5.0, max_offset_m=0.6)
    s = np.arange(0.0, line.length_m, 0.05)
    own = box_corners(line.position(s), line.heading(s), **SIZE)
    for heading in np.linspace(0, np.pi, 7):
        one = box(20.0, 9.0, heading, steps=1)
        other = box_corners(one.position[0, 0], heading, length_m=4.5, width_m=1.9)
        touching = s[boxes_overlap(own, other)]
        found = occupancy_of(line, one)
        if touching.size:
            assert found.low[0, 0] <= touching[0] + 1e-9
            assert found.high[0, 0] >= touching[-1] - 1e-9


def test_place_of_who_crosses_is_kept_clear_before_and_after(
    straight_line: ReferenceLine, box: Callable[..., Traffic]
) -> None:
    """A car crosses at x = 50 from the right at 10 m/s, on the line's middle at 2.0 s.

    Its box (4.5 m) and the own one (1.9 m wide) touch while |y| <= 2.25 + 0.95 = 3.2 m: from 1.68 to 2.32 s, steps
    17 to 23. With 10 steps of PET that place is taken from 0.7 to 3.3 s, 0.2 m narrower on both sides where a margin is
    added later; at the steps of the crossing itself nothing changes.
    """
    crossing = box(50.0, -20.0, np.pi / 2, 10.0)
    found = path_occupancy(straight_line, crossing, length_m=4.5, width_m=1.9, margin_lateral_m=0.0)
    clear = found.kept_clear(10, margin_m=0.2)
    there, kept = np.flatnonzero(np.isfinite(found.low[0])), np.flatnonzero(np.isfinite(clear.low[0]))
    assert (there[0], there[-1]) == (17, 23)
    assert (kept[0], kept[-1]) == (7, 33)
    assert clear.low[0, 20] == found.low[0, 20]
    assert clear.low[0, 10] == pytest.approx(found.low[0, 17] + 0.2)
    assert clear.high[0, 30] == pytest.approx(found.high[0, 23] - 0.2)
    assert not clear.aligned.any()


def test_leader_holds_no_more_than_where_it_is(straight_line: ReferenceLine, box: Callable[..., Traffic]) -> None:
    found = path_occupancy(straight_line, box(50.0, 0.0, 0.0, 10.0), length_m=4.5, width_m=1.9, margin_lateral_m=0.0)
    clear = found.kept_clear(10, margin_m=0.2)
    assert np.array_equal(clear.low, found.low)
    assert np.array_equal(clear.high, found.high)
