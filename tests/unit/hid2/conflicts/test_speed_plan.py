from collections.abc import Callable

import numpy as np
import pytest
from views import MARGIN_M, SIZE, TTC_S, tables_of

from hid2.conflicts.space_time import SpaceTime
from hid2.conflicts.speed_plan import STAGE_STEPS, SpeedPlan, accelerations, farthest, plan_speed
from hid2.motion.reference_line import TABLE_STEP_M, ReferenceLine
from hid2.occupancy.traffic import Traffic


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
        tables, speed, s0=s0, v0=v0, a0=0.0, first_step=first_step, accels=accelerations(1.8, -3.2), step_s=0.1, **more
    )  # type: ignore[arg-type]


def test_empty_road_is_driven_at_the_desired_speed(straight_line: ReferenceLine, box: Callable[..., Traffic]) -> None:
    plan = _plan(tables_of(straight_line, box(0.0, 50.0)), s0=10.0, v0=12.0)
    assert plan is not None
    assert plan.v == pytest.approx(np.full(110, 12.0), abs=0.3)
    assert plan.s[-1] == pytest.approx(10.0 + 12.0 * 10.9, abs=2.0)


def test_plan_stops_behind_a_standing_box(straight_line: ReferenceLine, box: Callable[..., Traffic]) -> None:
    """Standing at 100 m: its interval begins at 96, less the margin 95. The speed falls with the gap / 1.7 s."""
    tables = tables_of(straight_line, box(100.0, 0.0, **SIZE))
    plan = _plan(tables, s0=20.0, v0=12.0)
    assert plan is not None
    assert plan.s.max() <= 95.0 + TABLE_STEP_M
    assert plan.v[-1] < 3.0
    assert np.diff(plan.v).min() >= -0.32 - 1e-9
    assert np.all(plan.v[1:] <= (95.0 + TABLE_STEP_M - plan.s[1:]) / TTC_S + 0.2)


def test_plan_follows_a_slow_leader(straight_line: ReferenceLine, box: Callable[..., Traffic]) -> None:
    plan = _plan(tables_of(straight_line, box(40.0, 0.0, 0.0, 5.0, **SIZE)), s0=10.0, v0=8.0)
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
    late = _plan(tables_of(straight_line, box(60.0, -70.0, np.pi / 2, 10.0, **SIZE)), s0=10.0, v0=12.0)
    assert late is not None
    assert late.v.min() > 11.0
    tables = tables_of(straight_line, box(60.0, -40.0, np.pi / 2, 10.0, **SIZE))
    meeting = _plan(tables, s0=10.0, v0=12.0)
    assert meeting is not None
    held = tables.blocked[np.arange(110), np.minimum((meeting.s / TABLE_STEP_M + 0.5).astype(int), 400)]
    assert not held.any()
    assert np.abs(meeting.v - 12.0).max() > 0.5


def test_plan_flees_from_a_recorded_follower_that_will_not_brake(
    straight_line: ReferenceLine, box: Callable[..., Traffic]
) -> None:
    """Follower 40 m behind at 11 m/s, own start at 7 m/s: at constant speed it would be met after 9 s."""
    tables = tables_of(straight_line, box(0.0, 0.0, 0.0, 11.0, **SIZE))
    plan = _plan(tables, s0=40.0, v0=7.0, desired=13.0)
    assert plan is not None
    assert np.all(plan.s > 11.0 * 0.1 * np.arange(110) + 4.0)
    assert plan.v[-1] > 10.5


def test_no_plan_where_every_motion_meets_somebody(straight_line: ReferenceLine, box: Callable[..., Traffic]) -> None:
    """15 m/s, a wall 12 m ahead: braking at 3.2 m/s2 takes 35 m."""
    assert _plan(tables_of(straight_line, box(40.0, 0.0, **SIZE)), s0=24.0, v0=15.0) is None


def test_no_plan_between_a_wall_and_a_follower(straight_line: ReferenceLine, box: Callable[..., Traffic]) -> None:
    tables = tables_of(straight_line, box(60.0, 0.0, **SIZE), box(0.0, 0.0, 0.0, 10.0, **SIZE))
    assert _plan(tables, s0=30.0, v0=8.0) is None


def test_plan_from_a_later_step_covers_the_steps_that_are_left(
    straight_line: ReferenceLine, box: Callable[..., Traffic]
) -> None:
    plan = _plan(tables_of(straight_line, box(0.0, 50.0)), s0=50.0, v0=10.0, first_step=63)
    assert plan is not None
    assert plan.s.shape == plan.v.shape == (47,)
    assert (plan.s[0], plan.v[0]) == (50.0, 10.0)


def test_plan_stays_near_a_driven_motion(straight_line: ReferenceLine, box: Callable[..., Traffic]) -> None:
    """With the s(t) of 8 m/s as reference it is nearer to that than without, whose desired speed is 12 m/s."""
    tables = tables_of(straight_line, box(0.0, 50.0))
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
    plan = _plan(tables_of(straight_line, box(100.0, 0.0, **SIZE)), s0=20.0, v0=12.0)
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
    plan = _plan(tables_of(straight_line, box(50.0, 0.0, **SIZE)), s0=25.0, v0=8.0)
    assert plan is not None
    drop = -np.diff(plan.v)[:STAGE_STEPS]
    assert np.all(np.diff(drop) > 0)
    assert drop[0] < 0.017


def test_first_start_that_is_possible_is_taken(straight_line: ReferenceLine, box: Callable[..., Traffic]) -> None:
    """A car stands 16 m ahead (12 m between the boxes): 12 m/s cannot be braked for, 4 m/s and 2 m/s can."""
    tables = tables_of(straight_line, box(41.0, 0.0, **SIZE))
    assert _plan(tables, s0=25.0, v0=12.0) is None
    chosen, slow = _plan(tables, s0=25.0, v0=(12.0, 4.0, 2.0)), _plan(tables, s0=25.0, v0=4.0)
    assert chosen is not None
    assert slow is not None
    assert chosen.v[0] == 4.0
    assert chosen.s == pytest.approx(slow.s)


@pytest.mark.parametrize(("ahead_m", "leader_mps", "v0"), [(60.0, 4.0, 10.0), (50.0, 5.0, 10.0), (45.0, 6.0, 9.0)])
def test_plan_is_one_that_car_following_can_drive(
    straight_line: ReferenceLine, box: Callable[..., Traffic], ahead_m: float, leader_mps: float, v0: float
) -> None:
    """Nowhere much faster than Krauss's safe speed, though TTC and time gap would allow 3 m/s more in the end."""
    tables = tables_of(straight_line, box(ahead_m, 0.0, 0.0, leader_mps, **SIZE))
    plan = _plan(tables, s0=10.0, v0=v0)
    assert plan is not None
    at = np.minimum((plan.s / TABLE_STEP_M + 0.5).astype(int), tables.cells - 1)
    assert np.max(plan.v - tables.followed[np.arange(110), at]) < 1.0


def _farthest(tables: SpaceTime, s0: float, v0: float, before: int = 110) -> float:
    return float(farthest(tables.view(), s0, v0, v0, -3.2, 1.8, 0, before, 0.1))


def _is_squeezed_out(tables: SpaceTime, s0: float, v0: float) -> bool:
    return _farthest(tables, s0, v0) == -np.inf


def test_nobody_is_squeezed_out_who_may_get_through(straight_line: ReferenceLine, box: Callable[..., Traffic]) -> None:
    """Of 300 roads with two cars that move, stand or cross: wherever a drawn motion meets nobody, there is room.

    And the roads are such that the test can fail: of one in six it is said that there is none.
    """
    rng = np.random.default_rng(3)
    squeezed, passed = 0, 0
    for _ in range(300):
        headings, speeds = rng.choice([0.0, 0.0, np.pi / 2], 2), rng.uniform(0.0, 14.0, 2)
        x, y = rng.uniform(0.0, 120.0, 2), rng.uniform(-60.0, 0.0, 2)
        first, second = (
            box(x[k], y[k] if headings[k] else 0.0, headings[k], speeds[k], **SIZE, name=f"{k}") for k in range(2)
        )
        tables = tables_of(straight_line, first.joined(second))
        s0, v0 = float(rng.uniform(10.0, 90.0)), float(rng.uniform(0.0, 14.0))
        accel = np.clip(np.repeat(rng.uniform(-4.0, 2.5, (200, 11)), 10, axis=1), -3.2, 1.8)
        v = np.maximum(v0 + 0.1 * np.cumsum(accel, axis=1), 0.0)[:, :109]
        s = s0 + np.concatenate([np.zeros((200, 1)), np.cumsum(0.1 * v, axis=1)], axis=1)
        cells = np.minimum((s / TABLE_STEP_M + 0.5).astype(int), tables.cells - 1)
        free = ~tables.blocked[np.arange(1, 110), cells[:, 1:]].any(axis=1)
        through, told = bool(free.any()), _is_squeezed_out(tables, s0, v0)
        assert not (through and told)
        if through:
            for before in (31, 50, 110):
                assert s[free, before - 1].max() <= _farthest(tables, s0, v0, before)
        squeezed, passed = squeezed + told, passed + through
    assert squeezed > 50
    assert passed > 200


def test_no_room_between_two_that_meet(straight_line: ReferenceLine, box: Callable[..., Traffic]) -> None:
    """Standing at 100 m, and coming up from 60 m at 10 m/s: whoever is between is met, within 3 s."""
    both = box(100.0, 0.0, **SIZE).joined(box(60.0, 0.0, 0.0, 10.0, **SIZE, name="b"))
    tables = tables_of(straight_line, both)
    assert _is_squeezed_out(tables, 80.0, 5.0)
    assert _plan(tables, s0=80.0, v0=5.0) is None
    assert not _is_squeezed_out(tables, 40.0, 5.0)
    assert not _is_squeezed_out(tables_of(straight_line, box(100.0, 0.0, **SIZE)), 80.0, 5.0)
    assert _is_squeezed_out(tables_of(straight_line, box(100.0, 0.0, **SIZE)), 80.0, 14.0)  # it cannot stop in time


def test_nobody_gets_beyond_who_stands_in_the_way(straight_line: ReferenceLine, box: Callable[..., Traffic]) -> None:
    """From 60 m at 8 m/s: to 95 m behind who stands at 100 m; on an empty road 40 m + 1.8 / 2 * 25 m in 5 s."""
    standing, nobody = (tables_of(straight_line, one) for one in (box(100.0, 0.0, **SIZE), box(0.0, 80.0)))
    assert 95.0 <= _farthest(standing, 60.0, 8.0) <= 95.0 + 0.3 * 30.0
    assert 60.0 + 40.0 + 22.5 <= _farthest(nobody, 60.0, 8.0, 50) <= 60.0 + 40.0 + 22.5 + 0.3 * 20.0
