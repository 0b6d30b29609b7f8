from collections.abc import Callable

import numpy as np
import pytest

from hid2.reference_line import TABLE_STEP_M, ReferenceLine, build_reference_line
from hid2.space_time import STAGE_STEPS, PathOccupancy, SpaceTime, SpeedPlan, path_occupancy, plan_speed, space_time
from hid2.traffic import Traffic

SIZE = {"length_m": 4.0, "width_m": 2.0}
MARGIN_M, TTC_S = 1.0, 1.7


def _occupancy(line: ReferenceLine, traffic: Traffic, *, margin_m: float = 0.0) -> PathOccupancy:
    return path_occupancy(line, traffic, **SIZE, margin_lateral_m=margin_m)


def _tables(line: ReferenceLine, *others: Traffic, exit_s: float = 1e3, earliest: int = 0) -> SpaceTime:
    occupancy = _occupancy(line, others[0])
    for traffic in others[1:]:
        occupancy = occupancy.joined(_occupancy(line, traffic))
    return space_time(
        occupancy, table_length=line.table_xy.shape[0], num_steps=110, margin_m=MARGIN_M, ttc_s=TTC_S, time_gap_s=1.0,
        exit_s=min(exit_s, line.length_m), earliest_exit_step=earliest,
    )  # fmt: skip


def _plan(
    tables: SpaceTime,
    *,
    s0: float,
    v0: float | tuple[float, ...],
    desired: float = 12.0,
    first_step: int = 0,
    **more: object,
) -> SpeedPlan | None:
    speed = np.full(tables.blocked.shape[1], desired)
    return plan_speed(
        tables, speed, s0=s0, v0=v0, a0=0.0, first_step=first_step, accel_max=1.8, accel_min=-3.2, step_s=0.1, **more
    )  # type: ignore[arg-type]


def test_box_across_the_path_forbids_half_its_width_and_half_the_own_length(
    straight_line: ReferenceLine, box: Callable[..., Traffic]
) -> None:
    """A box of 4 x 2 crosswise at x = 50; the own one is 4 m long: centres from 50 - 1 - 2 = 47 to 53 touch it.

              ||                 sampled every 0.5 m and widened by one sample: 46.5 .. 53.5 at the most
    [own]---->||
              47   53
    """
    found = _occupancy(straight_line, box(50.0, 0.0, np.pi / 2, steps=3, **SIZE))
    assert found.low.shape == (1, 3)
    assert 46.5 - 1e-9 <= found.low[0, 0] <= 47.0
    assert 53.0 <= found.high[0, 0] <= 53.5 + 1e-9
    assert not found.aligned.any()


def test_box_ahead_forbids_from_bumper_to_bumper(straight_line: ReferenceLine, box: Callable[..., Traffic]) -> None:
    """Both 4 m long: 50 - 4 = 46 to 54. It drives at 6 m/s along the path."""
    found = _occupancy(straight_line, box(50.0, 0.0, 0.0, 6.0, steps=3, **SIZE))
    assert found.low[0, 0] == pytest.approx(46.0, abs=0.51)
    assert found.high[0, 0] == pytest.approx(54.0, abs=0.51)
    assert found.along[0, 0] == pytest.approx(6.0)
    assert found.aligned.all()


def test_oncoming_box_is_not_aligned_and_moves_against_the_path(
    straight_line: ReferenceLine, box: Callable[..., Traffic]
) -> None:
    found = _occupancy(straight_line, box(50.0, 0.0, np.pi, 6.0, steps=3, **SIZE))
    assert found.along[0, 0] == pytest.approx(-6.0)
    assert not found.aligned.any()


def test_lateral_margin_counts_a_box_beside_the_path(straight_line: ReferenceLine, box: Callable[..., Traffic]) -> None:
    """At y = 2.2 half widths 1 + 1 leave 0.2 m between; a margin of 0.25 m closes it."""
    beside = box(50.0, 2.2, steps=1, **SIZE)
    assert _occupancy(straight_line, beside).low.shape[0] == 0
    assert _occupancy(straight_line, beside, margin_m=0.25).low.shape[0] == 1


def test_agents_that_never_touch_the_path_are_left_out(
    straight_line: ReferenceLine, box: Callable[..., Traffic]
) -> None:
    both = box(50.0, 10.0).joined(box(80.0, 0.0))
    assert _occupancy(straight_line, both).low.shape[0] == 1


def test_absent_steps_are_free(straight_line: ReferenceLine, box: Callable[..., Traffic]) -> None:
    found = _occupancy(straight_line, box(50.0, 0.0, steps=4, first=2, **SIZE))
    assert np.isinf(found.low[0, :2]).all()
    assert np.isfinite(found.low[0, 2:]).all()


def test_small_box_between_two_samples_is_not_jumped_over(
    straight_line: ReferenceLine, box: Callable[..., Traffic]
) -> None:
    """A pedestrian of 0.6 m right at the start, or far along, is found: the march slows before it reaches anybody."""
    for x in (0.0, 3.3, 119.77, 199.9):
        found = _occupancy(straight_line, box(x, 0.5, steps=1, length_m=0.6, width_m=0.6))
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
        found = _occupancy(line, one)
        if touching.size:
            assert found.low[0, 0] <= touching[0] + 1e-9
            assert found.high[0, 0] >= touching[-1] - 1e-9


def test_speed_towards_a_leader_keeps_the_critical_ttc(
    straight_line: ReferenceLine, box: Callable[..., Traffic]
) -> None:
    """Leader at 60 m, 5 m/s: its interval begins near 56, less the margin 55. From 38 m: 5 + 17 / 1.7 = 15 m/s."""
    tables = _tables(straight_line, box(60.0, 0.0, 0.0, 5.0, **SIZE))
    assert tables.fastest[0, int(38 / TABLE_STEP_M)] == pytest.approx(15.0, abs=0.4)
    assert tables.blocked[0, int(60 / TABLE_STEP_M)] == 1
    assert tables.blocked[0, int(50 / TABLE_STEP_M)] == 0


def test_exit_is_closed_until_the_earliest_step(straight_line: ReferenceLine, box: Callable[..., Traffic]) -> None:
    tables = _tables(straight_line, box(0.0, 50.0), exit_s=150.0, earliest=51)
    assert tables.blocked[50, int(151 / TABLE_STEP_M)] == 1
    assert tables.blocked[51, int(151 / TABLE_STEP_M)] == 0


def test_empty_road_is_driven_at_the_desired_speed(straight_line: ReferenceLine, box: Callable[..., Traffic]) -> None:
    plan = _plan(_tables(straight_line, box(0.0, 50.0)), s0=10.0, v0=12.0)
    assert plan is not None
    assert plan.v == pytest.approx(np.full(110, 12.0), abs=0.3)
    assert plan.s[-1] == pytest.approx(10.0 + 12.0 * 10.9, abs=2.0)


def test_plan_stops_behind_a_standing_box(straight_line: ReferenceLine, box: Callable[..., Traffic]) -> None:
    """Standing at 100 m: its interval begins at 96, less the margin 95. The speed falls with the gap / 1.7 s."""
    tables = _tables(straight_line, box(100.0, 0.0, **SIZE))
    plan = _plan(tables, s0=20.0, v0=12.0)
    assert plan is not None
    assert plan.s.max() <= 95.0 + TABLE_STEP_M
    assert plan.v[-1] < 3.0
    assert np.diff(plan.v).min() >= -0.32 - 1e-9
    assert np.all(plan.v[1:] <= (95.0 + TABLE_STEP_M - plan.s[1:]) / TTC_S + 0.2)


def test_plan_follows_a_slow_leader(straight_line: ReferenceLine, box: Callable[..., Traffic]) -> None:
    plan = _plan(_tables(straight_line, box(40.0, 0.0, 0.0, 5.0, **SIZE)), s0=10.0, v0=8.0)
    assert plan is not None
    gap = 40.0 + 0.5 * np.arange(110) - 4.0 - plan.s
    assert gap.min() > MARGIN_M - TABLE_STEP_M
    assert np.all(plan.v[1:] - 5.0 <= gap[1:] / TTC_S)


def test_plan_passes_before_or_behind_a_car_that_crosses(
    straight_line: ReferenceLine, box: Callable[..., Traffic]
) -> None:
    """A car crosses x = 60 at 10 m/s. It is there after 7 s, when a vehicle at 12 m/s is long past; or after 4 s, at
    its own arrival: then the plan gives way or hurries, and never shares the crossing.
    """
    late = _plan(_tables(straight_line, box(60.0, -70.0, np.pi / 2, 10.0, **SIZE)), s0=10.0, v0=12.0)
    assert late is not None
    assert late.v.min() > 11.0
    tables = _tables(straight_line, box(60.0, -40.0, np.pi / 2, 10.0, **SIZE))
    meeting = _plan(tables, s0=10.0, v0=12.0)
    assert meeting is not None
    held = tables.blocked[np.arange(110), np.minimum((meeting.s / TABLE_STEP_M + 0.5).astype(int), 400)]
    assert not held.any()
    assert np.abs(meeting.v - 12.0).max() > 0.5


def test_plan_flees_from_a_recorded_follower_that_will_not_brake(
    straight_line: ReferenceLine, box: Callable[..., Traffic]
) -> None:
    """Follower 40 m behind at 11 m/s, own start at 7 m/s: at constant speed it would be met after 9 s."""
    tables = _tables(straight_line, box(0.0, 0.0, 0.0, 11.0, **SIZE))
    plan = _plan(tables, s0=40.0, v0=7.0, desired=13.0)
    assert plan is not None
    assert np.all(plan.s > 11.0 * 0.1 * np.arange(110) + 4.0)
    assert plan.v[-1] > 10.5


def test_no_plan_where_every_motion_meets_somebody(straight_line: ReferenceLine, box: Callable[..., Traffic]) -> None:
    """15 m/s, a wall 12 m ahead: braking at 3.2 m/s2 takes 35 m."""
    assert _plan(_tables(straight_line, box(40.0, 0.0, **SIZE)), s0=24.0, v0=15.0) is None


def test_no_plan_between_a_wall_and_a_follower(straight_line: ReferenceLine, box: Callable[..., Traffic]) -> None:
    tables = _tables(straight_line, box(60.0, 0.0, **SIZE), box(0.0, 0.0, 0.0, 10.0, **SIZE))
    assert _plan(tables, s0=30.0, v0=8.0) is None


def test_plan_from_a_later_step_covers_the_steps_that_are_left(
    straight_line: ReferenceLine, box: Callable[..., Traffic]
) -> None:
    plan = _plan(_tables(straight_line, box(0.0, 50.0)), s0=50.0, v0=10.0, first_step=63)
    assert plan is not None
    assert plan.s.shape == plan.v.shape == (47,)
    assert (plan.s[0], plan.v[0]) == (50.0, 10.0)


def test_plan_stays_near_a_driven_motion(straight_line: ReferenceLine, box: Callable[..., Traffic]) -> None:
    """With the s(t) of 8 m/s as reference it is nearer to that than without, whose desired speed is 12 m/s."""
    tables = _tables(straight_line, box(0.0, 50.0))
    reference = 10.0 + 0.8 * np.arange(110)
    near, free = _plan(tables, s0=10.0, v0=8.0, reference=reference), _plan(tables, s0=10.0, v0=8.0)
    assert near is not None
    assert free is not None
    assert np.abs(near.s - reference).max() < np.abs(free.s - reference).max()


def test_positions_are_the_integral_of_the_speeds(straight_line: ReferenceLine, box: Callable[..., Traffic]) -> None:
    """Constant acceleration within stages: trapezoids are exact, but where the vehicle comes to rest within a step.

    In the first stage, half a second, the acceleration builds up: a trapezoid is off by jerk * dt^3 / 12 there, with at
    most 3.3 m/s3 by 0.0003 m.
    """
    plan = _plan(_tables(straight_line, box(100.0, 0.0, **SIZE)), s0=20.0, v0=12.0)
    assert plan is not None
    moving = plan.v[1:] > 0
    trapezoids = 0.05 * (plan.v[1:] + plan.v[:-1])
    assert np.diff(plan.s)[moving][STAGE_STEPS:] == pytest.approx(trapezoids[moving][STAGE_STEPS:], abs=1e-9)
    assert np.diff(plan.s)[:STAGE_STEPS] == pytest.approx(trapezoids[:STAGE_STEPS], abs=3e-4)


def test_braking_builds_up_within_the_first_half_second(
    straight_line: ReferenceLine, box: Callable[..., Traffic]
) -> None:
    """A car stands 20 m ahead of one that drives at 8 m/s: it brakes at once, but no harder than jerk allows.

    From rest of the brakes to -1.6 m/s2 within 0.5 s, evenly: after 0.1 s the speed is down by 3.2 / 2 * 0.01 m/s.
    """
    plan = _plan(_tables(straight_line, box(50.0, 0.0, **SIZE)), s0=25.0, v0=8.0)
    assert plan is not None
    drop = -np.diff(plan.v)[:STAGE_STEPS]
    assert np.all(np.diff(drop) > 0)
    assert drop[0] < 0.017


def test_first_start_that_is_possible_is_taken(straight_line: ReferenceLine, box: Callable[..., Traffic]) -> None:
    """A car stands 16 m ahead (12 m between the boxes): 12 m/s cannot be braked for, 4 m/s and 2 m/s can."""
    tables = _tables(straight_line, box(41.0, 0.0, **SIZE))
    assert _plan(tables, s0=25.0, v0=12.0) is None
    chosen, slow = _plan(tables, s0=25.0, v0=(12.0, 4.0, 2.0)), _plan(tables, s0=25.0, v0=4.0)
    assert chosen is not None
    assert slow is not None
    assert chosen.v[0] == 4.0
    assert chosen.s == pytest.approx(slow.s)


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
