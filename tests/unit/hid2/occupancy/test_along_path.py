import numpy as np
import pytest
from hand_drawn import draw_box
from separating_axes import boxes_overlap
from views import SIZE, occupancy_of

from hid2.agents import BoxSize
from hid2.motion.reference_line import TABLE_STEP_M, ReferenceLine, build_reference_line
from hid2.occupancy.along_path import PathOccupancy, path_occupancy
from hid2.occupancy.traffic import Traffic
from netconvert.geometry import box_corners


def test_box_ahead_forbids_from_bumper_to_bumper(straight_line: ReferenceLine) -> None:
    """Both 4 m long: 50 - 4 = 46 to 54. It drives at 6 m/s along the path. An oncoming one is not aligned with it."""
    found = occupancy_of(straight_line, draw_box(50.0, 0.0, 0.0, 6.0, steps=3, **SIZE._asdict()))
    assert found.low[0, 0] == pytest.approx(46.0, abs=0.51)
    assert found.high[0, 0] == pytest.approx(54.0, abs=0.51)
    assert found.along[0, 0] == pytest.approx(6.0)
    assert found.same_direction.all()
    found = occupancy_of(straight_line, draw_box(50.0, 0.0, np.pi, 6.0, steps=3, **SIZE._asdict()))
    assert found.along[0, 0] == pytest.approx(-6.0)
    assert not found.same_direction.any()


def test_lateral_margin_counts_a_box_beside_the_path(straight_line: ReferenceLine) -> None:
    """At y = 2.2 half widths 1 + 1 leave 0.2 m between; a margin of 0.25 m closes it."""
    beside = draw_box(50.0, 2.2, steps=1, **SIZE._asdict())
    assert occupancy_of(straight_line, beside).low.shape[0] == 0
    assert occupancy_of(straight_line, beside, margin_m=0.25).low.shape[0] == 1


def test_place_of_who_crosses_is_kept_clear_before_and_after(straight_line: ReferenceLine) -> None:
    """A car crosses at x = 50 from the right at 10 m/s, on the line's middle at 2.0 s.

    Its box (4.5 m) and the own one (1.9 m wide) touch while |y| <= 2.25 + 0.95 = 3.2 m: from 1.68 to 2.32 s, steps
    17 to 23. With 10 steps of PET that place is taken from 0.7 to 3.3 s, 0.5 m narrower on both sides; at the steps of
    the crossing itself nothing changes. A leader holds no more than where it is.
    """
    crossing = draw_box(50.0, -20.0, np.pi / 2, 10.0)
    found = path_occupancy(straight_line, crossing, BoxSize(4.5, 1.9))
    clear = found.kept_clear(10)
    there, kept = np.flatnonzero(np.isfinite(found.low[0])), np.flatnonzero(np.isfinite(clear.low[0]))
    assert (there[0], there[-1]) == (17, 23)
    assert (kept[0], kept[-1]) == (7, 33)
    assert clear.low[0, 20] == found.low[0, 20]
    assert clear.low[0, 10] == pytest.approx(found.low[0, 17] + 0.5)
    assert clear.high[0, 30] == pytest.approx(found.high[0, 23] - 0.5)
    assert not clear.same_direction.any()
    found = path_occupancy(straight_line, draw_box(50.0, 0.0, 0.0, 10.0), BoxSize(4.5, 1.9))
    assert np.array_equal(found.kept_clear(10).low, found.low)
    assert np.array_equal(found.kept_clear(10).high, found.high)


def test_way_of_one_that_turns_across_is_kept_clear_from_its_first_touch_on() -> None:
    """It touches at steps 5 to 8, at first heading against the path: from 2 steps before 5 to 2 after 8."""
    low, high = np.full((1, 12), np.inf), np.full((1, 12), -np.inf)
    low[0, 5:9], high[0, 5:9] = [50.0, 48.0, 46.0, 44.0], [58.0, 56.0, 54.0, 52.0]
    never = np.zeros((1, 12), dtype=np.bool_)
    crossing = never.copy()
    crossing[0, 7:9] = True
    found = PathOccupancy(np.array([0]), low, high, np.zeros((1, 12)), never, crossing)
    clear = found.kept_clear(2)
    assert np.flatnonzero(np.isfinite(clear.low[0])).tolist() == list(range(3, 11))
    assert (clear.low[0, 3], clear.high[0, 3]) == (50.5, 57.5)
    assert (clear.low[0, 10], clear.high[0, 10]) == (44.5, 51.5)


def _around(line: ReferenceLine, rng: np.random.Generator, *, steps: int = 12) -> Traffic:
    """Sixty agents of all sizes near a line: standing, jittering, driving, some for a while only."""
    count = 60
    at = rng.uniform(-5.0, line.length_m + 5.0, count)
    position = line.position(at) + rng.uniform(-9.0, 9.0, (count, 2))
    heading = rng.uniform(-np.pi, np.pi, count)
    velocity = rng.choice([0.0, 0.0, 0.3, 8.0], count)[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
    time = 0.1 * np.arange(steps)
    jitter = rng.choice([0.0, 0.03], count)[:, None, None] * rng.standard_normal((count, steps, 2))
    kinds = np.array([(0.6, 0.6), (4.5, 1.9), (5.6, 2.1), (12.3, 2.95), (18.0, 3.0)])[rng.integers(5, size=count)]
    return Traffic(
        ids=tuple(f"{row}" for row in range(count)),
        position=position[:, None] + time[:, None] * velocity[:, None] + jitter,
        heading=heading[:, None] + np.where(jitter[..., 0] > 0.0, 0.01, 0.0),
        velocity=np.repeat(velocity[:, None], steps, axis=1),
        present=(np.arange(steps) >= rng.integers(0, 4, count)[:, None]) & (rng.random((count, steps)) > 0.05),
        length_m=kinds[:, 0],
        width_m=kinds[:, 1],
    )


@pytest.mark.parametrize(("seed", "own"), [(0, BoxSize(4.5, 1.9)), (1, BoxSize(12.5, 3.0))])
def test_intervals_are_those_of_every_box_against_every_point(seed: int, own: BoxSize) -> None:
    """On a line that crosses itself: from one point before the first that touches to one behind the last, as tested box
    by box at every point of the line's table, whoever is looked at and whatever was skipped.
    """
    angle = np.linspace(0.0, 2.2 * np.pi, 150)
    loop = np.column_stack([40.0 * np.sin(angle), 25.0 * np.sin(2 * angle)])
    line = build_reference_line(loop, step_m=1.0, min_radius_m=5.0, max_offset_m=0.6)
    traffic = _around(line, np.random.default_rng(seed))
    found = path_occupancy(line, traffic, own)
    low, high = np.full(traffic.present.shape, np.inf), np.full(traffic.present.shape, -np.inf)
    boxes = box_corners(line.table_xy, line.table_heading, **own._asdict())
    for row, step in zip(*np.nonzero(traffic.present), strict=True):
        other = box_corners(
            traffic.position[row, step], traffic.heading[row, step], length_m=traffic.length_m[row],
            width_m=traffic.width_m[row],
        )  # fmt: skip
        touching = np.flatnonzero(boxes_overlap(boxes, other))
        if touching.size:
            low[row, step], high[row, step] = (touching[0] - 1) * TABLE_STEP_M, (touching[-1] + 1) * TABLE_STEP_M
    touched = np.isfinite(low).any(axis=1)
    assert touched.sum() > 10
    assert np.array_equal(found.low, low[touched])
    assert np.array_equal(found.high, high[touched])


def test_what_is_known_of_some_holds_for_all_that_join_them(straight_line: ReferenceLine) -> None:
    """Looked along one by one or all at once, in the order in which they joined, kept clear alike."""

    def along(traffic: Traffic, clear_steps: int):
        return path_occupancy(straight_line, traffic, BoxSize(4.5, 1.9), margin_m=0.2, clear_steps=clear_steps)

    def parts() -> list[Traffic]:
        poses = (50.0, -20.0, np.pi / 2, 10.0), (90.0, 40.0), (120.0, 0.0, 0.0, 5.0), (20.0, 0.0)
        return [draw_box(*pose) for pose in poses]

    for clear_steps in (0, 10):
        first, *others = parts()
        grown = first
        for other in others:
            along(grown, clear_steps)
            grown = grown.joined(other)
        fresh = parts()[0].joined(*parts()[1:])
        for name in ("low", "high", "along", "same_direction", "crossing"):
            assert np.array_equal(getattr(along(grown, clear_steps), name), getattr(along(fresh, clear_steps), name))
        assert along(grown, clear_steps).low.shape[0] == 3
    assert not np.array_equal(along(fresh, 0).low, along(fresh, 10).low)


def test_small_box_between_two_samples_is_not_jumped_over(straight_line: ReferenceLine) -> None:
    """A pedestrian of 0.6 m right at the start, or far along, is found: the march slows before it reaches anybody."""
    for x in (0.0, 3.3, 119.77, 199.9):
        found = occupancy_of(straight_line, draw_box(x, 0.5, steps=1, length_m=0.6, width_m=0.6))
        assert found.low.shape[0] == 1, x
        assert found.low[0, 0] <= max(x - 2.3, 0.0)
        assert found.high[0, 0] >= min(x + 2.3, 200.0) - 0.5
