from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import shapely

from hid2.agents import BoxSize
from hid2.motion.smoothing import Trajectory
from hid2.motion.verify import first_overlap, limit_exceeded, motion_profile, off_road_steps
from hid2.occupancy.traffic import Traffic
from hid2.params import Limits
from hid2.reasons import Reason

CAR = BoxSize(4.5, 1.9)


def _straight(x: float, y: float, speed: float, *, heading: float = 0.0, steps: int = 20) -> Trajectory:
    ahead = np.array([np.cos(heading), np.sin(heading)])
    s = 0.1 * speed * np.arange(steps)
    return Trajectory(
        position=np.array([x, y]) + s[:, None] * ahead,
        heading=np.full(steps, heading),
        velocity=np.tile(speed * ahead, (steps, 1)),
        s=s,
    )


def _circle(radius: float, speed: float, *, steps: int = 60) -> Trajectory:
    angle = speed / radius * 0.1 * np.arange(steps)
    heading = (angle + np.pi) % (2 * np.pi) - np.pi
    return Trajectory(
        position=radius * np.column_stack([np.sin(angle), 1 - np.cos(angle)]),
        heading=heading,
        velocity=speed * np.column_stack([np.cos(angle), np.sin(angle)]),
        s=angle * radius,
    )


def test_profile_on_a_circle() -> None:
    """R = 20 m at 10 m/s: 0.5 rad/s, 10^2 / 20 = 5 m/s2 to the left, no acceleration along, jerk v w^2 = 2.5 m/s3.

    The heading passes pi after 6.28 s without a leap of the yaw rate.
    """
    circle = _circle(20.0, 10.0, steps=90)
    profile = motion_profile(circle.velocity, circle.heading, step_s=0.1)
    inner = slice(2, -2)
    assert profile.speed_mps == pytest.approx(np.full(90, 10.0))
    assert profile.yaw_rate_radps[inner] == pytest.approx(np.full(86, 0.5))
    assert profile.lateral_accel_mps2[inner] == pytest.approx(np.full(86, 5.0), abs=0.01)
    assert profile.accel_mps2[inner] == pytest.approx(np.zeros(86), abs=1e-9)
    assert profile.jerk_mps3[inner] == pytest.approx(np.full(86, 2.5), abs=0.02)
    assert np.abs(profile.yaw_accel_radps2[inner]).max() < 1e-9


def test_profile_of_speeding_up_along_the_heading() -> None:
    """v = 2 t: 2 m/s2 along, nothing across, whatever the heading."""
    time = 0.1 * np.arange(30)
    for heading in (0.0, 2.5, -3.0):
        ahead = np.array([np.cos(heading), np.sin(heading)])
        profile = motion_profile(2 * time[:, None] * ahead, np.full(30, heading), step_s=0.1)
        assert profile.accel_mps2 == pytest.approx(np.full(30, 2.0))
        assert profile.lateral_accel_mps2 == pytest.approx(np.zeros(30), abs=1e-9)
        assert profile.longitudinal_jerk_mps3 == pytest.approx(np.zeros(30), abs=1e-9)


def test_quiet_motion_exceeds_nothing() -> None:
    assert limit_exceeded(_straight(0.0, 0.0, 15.0), Limits(), step_s=0.1) is None
    assert limit_exceeded(_circle(40.0, 10.0), Limits(), step_s=0.1) is None


def test_limits_are_named() -> None:
    """R = 15 m at 9 m/s: 5.4 m/s2 across, above 4.89. R = 5 m at 4.9 m/s: 4.8 m/s2, but 0.98 rad/s, above 0.95."""
    assert limit_exceeded(_circle(15.0, 9.0), Limits(), step_s=0.1) is Reason.LIMIT_LATERAL_ACCEL
    assert limit_exceeded(_circle(5.0, 4.9), Limits(), step_s=0.1) is Reason.LIMIT_YAW_RATE


@pytest.mark.parametrize(("accel", "reason"), [(2.5, Reason.LIMIT_ACCEL), (-4.2, Reason.LIMIT_DECEL)])
def test_acceleration_beyond_a_limit_is_named(accel: float, reason: Reason) -> None:
    time = 0.1 * np.arange(20)
    speed = 10.0 + accel * time
    flat = np.zeros(20)
    trajectory = Trajectory(
        position=np.column_stack([10 * time + accel * time**2 / 2, flat]),
        heading=flat,
        velocity=np.column_stack([speed, flat]),
        s=flat,
    )
    assert limit_exceeded(trajectory, Limits(), step_s=0.1) is reason


def test_positions_are_checked_as_well_as_the_stated_velocity() -> None:
    """A leap of half a metre in the positions, which the velocity does not show."""
    quiet = _straight(0.0, 0.0, 10.0)
    position = quiet.position.copy()
    position[10:] += [0.5, 0.0]
    assert limit_exceeded(replace(quiet, position=position), Limits(), step_s=0.1) is not None


def test_corner_outside_the_road_beyond_the_tolerance_is_off_road() -> None:
    """The road ends at y = -2. Half a width is 0.95 m: at y = -1.3 a corner is 0.25 m outside, at y = -1.4 0.35 m."""
    road = shapely.box(-50.0, -2.0, 250.0, 10.0)
    shapely.prepare(road)
    for y, expected in ((0.0, False), (-1.3, False), (-1.4, True)):
        driven = _straight(0.0, y, 10.0)
        off = off_road_steps(driven.position, driven.heading, CAR, road, tolerance_m=0.3)
        assert bool(off.any()) is expected


def test_off_road_tells_the_steps() -> None:
    """The road ends at x = 20: with 2.25 m to the bumper and 0.3 m of tolerance, from x > 18.05 on, step 19."""
    road = shapely.box(-50.0, -5.0, 20.0, 5.0)
    shapely.prepare(road)
    driven = _straight(0.0, 0.0, 10.0)
    off = off_road_steps(driven.position, driven.heading, CAR, road, tolerance_m=0.3)
    assert np.flatnonzero(off).tolist() == [19]


def test_overlap_is_found_at_its_first_step(box: Callable[..., Traffic]) -> None:
    """From 0 at 10 m/s to a car standing at 12: bumpers meet at 12 - 4.5 = 7.5 m, half way from step 7 to step 8."""
    met = first_overlap(_straight(0.0, 0.0, 10.0), CAR, box(12.0, 0.0, steps=20), margin_m=0.01)
    assert met == (0, 7)


def test_overlap_between_two_steps_is_found(box: Callable[..., Traffic]) -> None:
    """A narrow box leaps over the standing car within one step: from y = -2 to +2, and at y = 0 half way.

    step 0   x         y = -2       half the car is 0.95 m wide, half the box 0.3 m: clear at both steps
    half    [x]        y =  0
    step 1   x         y = +2
    """
    standing = _straight(0.0, 0.0, 0.0, steps=2)
    leap = box(0.0, -2.0, np.pi / 2, 40.0, steps=2, length_m=0.6, width_m=0.6)
    assert first_overlap(standing, CAR, leap, margin_m=0.0) == (0, 0)


def test_agent_that_leaves_in_between_is_not_interpolated(box: Callable[..., Traffic]) -> None:
    leap = box(0.0, -2.0, np.pi / 2, 40.0, steps=2, length_m=0.6, width_m=0.6)
    gone = replace(leap, present=np.array([[True, False]]))
    assert first_overlap(_straight(0.0, 0.0, 0.0, steps=2), CAR, gone, margin_m=0.0) is None


def test_half_step_turns_the_short_way_round(box: Callable[..., Traffic]) -> None:
    """Heading from 179 to -179 degrees is 180 half way, not 0 or 90: a bus beside, 3 m off, is not swept."""
    beside = box(0.0, 3.0, np.radians(179.0), steps=2, length_m=11.0, width_m=2.0)
    turned = replace(beside, heading=np.radians([[179.0, -179.0]]))
    assert first_overlap(_straight(0.0, 0.0, 0.0, steps=2), CAR, turned, margin_m=0.0) is None


def test_margin_widens_the_own_box(box: Callable[..., Traffic]) -> None:
    """1.95 m apart sideways, 1.9 m wide both: 0.05 m between; a margin of 0.06 m closes it."""
    beside = box(0.0, 1.95, steps=5)
    assert first_overlap(_straight(0.0, 0.0, 0.0, steps=5), CAR, beside, margin_m=0.04) is None
    assert first_overlap(_straight(0.0, 0.0, 0.0, steps=5), CAR, beside, margin_m=0.06) == (0, 0)


def test_only_the_steps_of_the_trajectory_count(box: Callable[..., Traffic]) -> None:
    """A trajectory of five steps that ends at the map's edge does not meet who comes there later."""
    later = box(0.0, 0.0, steps=20, first=5)
    assert first_overlap(_straight(0.0, 0.0, 0.0, steps=5), CAR, later, margin_m=0.0) is None
