"""Smoothing takes SUMO's steps out, not the driver."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from hid2.drivers.driver import MIDDLE, LaneOffset
from hid2.motion.reference_line import ReferenceLine, build_reference_line
from hid2.motion.smoothing import Motion, _gaussian_filter, smooth_motion, trajectory

DT = 0.1


def _driven(v: np.ndarray, s0: float = 40.0) -> np.ndarray:
    """Arc lengths as SUMO makes them: each step by its new speed."""
    return s0 + np.concatenate([[0.0], np.cumsum(DT * v[1:])])


def _smooth(v: np.ndarray, filter_s: float = 0.3, s0: float = 40.0) -> Motion:
    return smooth_motion(_driven(v, s0), filter_s=filter_s, step_s=DT)


def test_exported_way_stays_by_the_simulated_one() -> None:
    """A queue: from 10 m/s to a stand behind somebody and off again; s(t) stays within half a metre."""
    t = DT * np.arange(110)
    v = np.clip(np.where(t < 6.0, 10.0 - 2.5 * np.clip(t - 1.0, 0.0, None), 1.6 * (t - 6.0)), 0.0, 10.0)
    assert np.abs(_smooth(v).s - _driven(v)).max() < 0.5


def test_s_of_t_is_a_cubic_from_position_speed_and_acceleration() -> None:
    """Between steps s is the cubic with v and a at both ends: its increment is dt (v0 + v1) / 2 - dt^2 (a1 - a0) / 12.

    v = 8 + 0.6 t^2 (a = 1.2 t) is kept by a narrow filter inside; over 1 s from t = 2: 8 + 0.2 (3^3 - 2^3) = 11.8 m.
    Differences over two steps make of v what is 0.2 delta^2 = 0.002 m/s faster.
    """
    t = np.arange(51) * DT
    s = 5.0 + 8.0 * t + 0.2 * t**3
    motion = smooth_motion(s, filter_s=0.02, step_s=DT)
    assert motion.s[30] - motion.s[20] == pytest.approx(11.802, abs=1e-3)
    assert motion.a[20] == pytest.approx(2.4, abs=1e-2)
    step = 0.5 * DT * (motion.v[1:] + motion.v[:-1]) - DT**2 / 12.0 * np.diff(motion.a)
    assert np.diff(motion.s) == pytest.approx(step)


@pytest.mark.parametrize("seed", range(2))
def test_nobody_rolls_backwards_or_below_zero(seed: int) -> None:
    """Stop and go with jumps down to 0, at both ends too."""
    rng = np.random.default_rng(seed)
    v = np.repeat(rng.choice([0.0, 0.0, 4.0, 9.0], 22), 5).astype(float)
    for filter_s in (0.3, 0.5, 0.8):
        motion = _smooth(v, filter_s)
        assert motion.v.min() >= 0.0
        assert np.diff(motion.s).min() >= 0.0
        assert motion.v.max() <= 18.0


def test_who_stands_stands() -> None:
    """At rest from 3 s on: once the filter's reach (3 SD, 0.9 s) is over, s does not move."""
    v = np.where(np.arange(110) < 30, 3.0 - 0.1 * np.arange(110), 0.0).clip(0.0)
    motion = _smooth(v)
    assert np.ptp(motion.s[42:]) < 1e-9
    assert motion.v[42:].max() == 0.0


def test_first_and_last_second_keep_their_slope() -> None:
    """A driver who speeds up at 1.5 m/s2 from the first step on, and brakes at 1 m/s2 at the last, still does.

    A filter that mirrors its ends would flatten both to 0. SUMO drives each step at the speed that it has at its end:
    by its positions a vehicle has that speed half a step before.
    """
    t = DT * np.arange(110)
    v = np.where(t < 4.0, 5.0 + 1.5 * t, np.where(t < 7.0, 11.0, 11.0 - 1.0 * (t - 7.0)))
    motion = _smooth(v)
    assert motion.a[:10] == pytest.approx(np.full(10, 1.5), abs=0.02)
    assert motion.a[-10:] == pytest.approx(np.full(10, -1.0), abs=0.02)
    assert motion.v[[0, -1]] == pytest.approx(v[[0, -1]] + 0.5 * DT * np.array([1.5, -1.0]), abs=0.02)


def test_eased_ends_leave_the_middle_as_it_is() -> None:
    """A driver who speeds up at 2 m/s2 throughout: eased, it begins at less, and drives as before from then to the end.

    It had gained less speed by then: so it was faster at the first step.
    """
    v = 5.0 + 0.2 * np.arange(110)
    plain = smooth_motion(_driven(v), filter_s=0.3, step_s=DT)
    eased = smooth_motion(_driven(v), filter_s=0.3, step_s=DT, end_jerk_mps3=3.0)
    assert eased.v[40:70] == pytest.approx(plain.v[40:70], abs=1e-9)
    assert eased.v[0] > plain.v[0] + 0.1
    assert eased.v[-1] < plain.v[-1] - 0.1
    assert abs(eased.a[0]) < 0.5 * abs(plain.a[0])


@pytest.fixture(scope="module")
def circle() -> ReferenceLine:
    """A left bend of 25 m around (0, 25)."""
    angle = np.linspace(0.0, np.pi, 60)
    return build_reference_line(
        25.0 * np.column_stack([np.sin(angle), 1 - np.cos(angle)]), step_m=1.0, min_radius_m=5.0, max_offset_m=0.6
    )


MOTION = Motion(s=5.0 + 1.0 * np.arange(50), v=np.full(50, 10.0), a=np.zeros(50), step_s=0.1)


def test_poses_lie_on_the_line_and_move_along_it_and_the_place_in_the_lane_is_added_along_the_normal(
    circle: ReferenceLine,
) -> None:
    """At 10 m/s: velocity is the derivative of position; a box of 5 m has its rear axle 1.5 m behind its middle.

    That rolls along the heading, which trails the course of the middle by 1.5 / 25 = .06 rad. P = r + d n, half a metre
    left of a left bend of 25 m: a circle of 24.5 m, driven at 10 * 24.5 / 25 = 9.8 m/s.
    """
    found = trajectory(circle, MOTION, MIDDLE, 5.0)
    assert np.abs(np.hypot(*(found.position - [0.0, 25.0]).T) - 25.0).max() < 0.03
    derived = np.gradient(found.position, DT, axis=0)[1:-1]
    assert np.abs(derived - found.velocity[1:-1]).max() < 0.05
    course = np.arctan2(derived[:, 1], derived[:, 0])
    assert np.sin(course - found.heading[1:-1]) == pytest.approx(np.full(48, 0.06), abs=5e-3)
    axle = found.position - 1.5 * np.column_stack([np.cos(found.heading), np.sin(found.heading)])
    rolls = np.gradient(axle, DT, axis=0)[1:-1]
    assert np.abs(np.sin(np.arctan2(rolls[:, 1], rolls[:, 0]) - found.heading[1:-1])).max() < 5e-3
    left = trajectory(circle, MOTION, LaneOffset(np.array([0.0, 100.0]), np.full(2, 0.5), np.zeros(2)), 5.0)
    assert np.abs(np.hypot(*(left.position - [0.0, 25.0]).T) - 24.5).max() < 0.03
    assert np.hypot(*left.velocity.T)[5:-5] == pytest.approx(np.full(40, 9.8), abs=0.06)
    assert left.heading == pytest.approx(found.heading, abs=2e-3)


def test_heading_follows_who_drifts_aside(straight_line: ReferenceLine) -> None:
    """0.4 m over 20 m, flat at both ends: half way the course is atan(0.03) to the left, and so is the heading."""
    drift = LaneOffset(np.array([20.0, 40.0]), np.array([0.0, 0.4]), np.zeros(2))
    found = trajectory(
        straight_line, Motion(s=np.array([30.0]), v=np.array([10.0]), a=np.zeros(1), step_s=0.1), drift, 5.0
    )
    assert found.position[0] == pytest.approx([30.0, 0.2], abs=1e-6)
    assert found.heading[0] == pytest.approx(np.arctan(0.03), abs=1e-6)
    assert found.velocity[0] == pytest.approx([10.0, 0.3], abs=1e-6)


@pytest.mark.parametrize(("count", "deviation"), [(50, 0.4), (110, 4.0), (12, 5.0), (30, 0.1)])
def test_gaussian_filter_is_that_of_scipy(count: int, deviation: float) -> None:
    """Also where the signal is shorter than the filter reaches, and where that is less than a step."""
    values = np.random.default_rng(0).normal(10.0, 3.0, count)
    expected = gaussian_filter1d(values, deviation, truncate=3.0)
    np.testing.assert_allclose(_gaussian_filter(values, deviation), expected, rtol=0.0, atol=1e-12)
