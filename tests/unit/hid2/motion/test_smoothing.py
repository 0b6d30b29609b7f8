import numpy as np
import pytest

from hid2.motion.reference_line import ReferenceLine, build_reference_line
from hid2.motion.smoothing import Motion, SpeedBounds, SpeedLimits, integrate, poses, smooth_speed

LIMITS = SpeedLimits(accel_min=-3.6, accel_max=2.1, jerk=3.3)
COUNT = 110


def _bounds(**changes: np.ndarray | float) -> SpeedBounds:
    free = {
        "low": np.full(COUNT, -np.inf),
        "high": np.full(COUNT, np.inf),
        "fastest": np.full(COUNT, 99.0),
        "ttc_room": np.full(COUNT, np.inf),
        "ttc_need": np.full(COUNT, -np.inf),
        "ttc_s": 1.7,
    }
    return SpeedBounds(**{**free, **changes})  # type: ignore[arg-type]


def _smooth(v: np.ndarray, bounds: SpeedBounds, *, s0: float = 0.0) -> Motion | None:
    s = s0 + np.concatenate([[0.0], np.cumsum(0.1 * v[1:])])
    return smooth_speed(s, v, bounds, LIMITS, a0=0.0, step_s=0.1, jerk_weight=1.0)


def test_integral_of_a_cubic_by_hand() -> None:
    """a from 0 to 3 m/s2 in 1 s (jerk 3): v = 1.5 m/s, s = 3 * 1^3 / 6 = 0.5 m. Then a constant: v = 4.5, s = 3.5."""
    motion = integrate(0.0, 0.0, np.array([0.0, 3.0, 3.0]), step_s=1.0, jerk=3.0)
    assert motion.v == pytest.approx([0.0, 1.5, 4.5])
    assert motion.s == pytest.approx([0.0, 0.5, 3.5])


def test_jerk_is_clipped_when_integrated() -> None:
    """From 0 to 3 m/s2 at 1 m/s3 takes three steps of 1 s."""
    assert integrate(0.0, 0.0, np.full(4, 3.0) * [0, 1, 1, 1], step_s=1.0, jerk=1.0).a == pytest.approx([0, 1, 2, 3])


def test_vehicle_that_would_roll_back_stands() -> None:
    motion = integrate(5.0, 0.2, np.full(30, -2.0), step_s=0.1, jerk=4.0)
    assert motion.v.min() >= 0.0
    assert np.diff(motion.s).min() >= 0.0
    assert motion.v[-1] == 0.0


def test_uniform_motion_stays_as_it_is() -> None:
    motion = _smooth(np.full(COUNT, 9.0), _bounds(), s0=40.0)
    assert motion is not None
    assert motion.s == pytest.approx(40.0 + 0.9 * np.arange(COUNT), abs=0.05)
    assert np.abs(motion.a).max() < 0.05


def test_jump_of_speed_becomes_a_motion_within_limits() -> None:
    """SUMO's driver brakes from 10 to 4 m/s within one step; a car takes jerk 3.3 and at most 3.6 m/s2."""
    v = np.where(np.arange(COUNT) < 50, 10.0, 4.0)
    motion = _smooth(v, _bounds())
    assert motion is not None
    assert motion.a.min() >= -3.6 - 0.02
    assert motion.a.max() <= 2.1 + 0.02
    assert np.abs(np.diff(motion.a)).max() <= 0.33 + 1e-9
    assert motion.v[0] == 10.0
    assert motion.v[80:] == pytest.approx(np.full(30, 4.0), abs=0.6)


def test_start_is_kept() -> None:
    motion = _smooth(np.linspace(3.0, 12.0, COUNT), _bounds(), s0=17.0)
    assert motion is not None
    assert (motion.s[0], motion.v[0], motion.a[0]) == (17.0, 3.0, 0.0)


def test_motion_stays_behind_a_leader_that_the_driven_one_would_touch() -> None:
    """Driven at 10 m/s through a wall that stands at 60 m from 4 s on."""
    high = np.where(np.arange(COUNT) < 40, np.inf, 60.0)
    motion = _smooth(np.where(np.arange(COUNT) < 70, 10.0, 0.0), _bounds(high=high))
    assert motion is not None
    assert motion.s[40:].max() <= 60.0 + 0.1
    assert motion.a.min() >= -3.6 - 0.02


def test_motion_stays_ahead_of_a_follower() -> None:
    """A follower's front at 5 + 8 t from 3 s on; driven at 6 m/s from 20 m: overtaken after 7.5 s unless it hurries."""
    step = np.arange(COUNT)
    low = np.where(step < 30, -np.inf, 5.0 + 0.8 * step)
    motion = _smooth(np.full(COUNT, 6.0), _bounds(low=low), s0=20.0)
    assert motion is not None
    assert np.all(motion.s >= low - 0.1)


def test_motion_keeps_the_critical_ttc_to_a_leader() -> None:
    """s + 1.7 v <= 80 for a wall at 80 m: at rest only at the wall, at 10 m/s no nearer than 17 m."""
    motion = _smooth(np.where(np.arange(COUNT) < 80, 10.0, 0.0), _bounds(ttc_room=np.full(COUNT, 80.0)))
    assert motion is not None
    assert np.all(motion.s + 1.7 * motion.v <= 80.0 + 0.2)


def test_speed_cap_gives_way_only_where_it_must() -> None:
    """Driven at 10 m/s where 6 are allowed from step 40 on: comfort, so a compromise, but no more than 8 m/s."""
    motion = _smooth(np.full(COUNT, 10.0), _bounds(fastest=np.where(np.arange(COUNT) < 40, 10.0, 6.0)))
    assert motion is not None
    assert motion.v[60:].max() < 8.0
    assert motion.a.min() >= -3.6 - 0.02


def test_motion_without_bounds_is_the_least_squares_one() -> None:
    """Few steps, no bound in reach: the same as solving the normal equations over the accelerations.

    s = S a + s_free, v = V a + v_free by the cubics; (s - s*)^2 + (v - v*)^2 / 2 + 0.3 a^2 + 0.3 j^2, a(0) = 0.
    """
    count, dt = 12, 0.1
    v_driven = 8.0 + 0.02 * np.arange(count) ** 2 / count
    s_driven = np.concatenate([[0.0], np.cumsum(dt * v_driven[1:])])
    s_of, v_of = np.zeros((count, count)), np.zeros((count, count))
    for k in range(count - 1):
        v_of[k + 1] = v_of[k]
        v_of[k + 1, [k, k + 1]] += dt / 2
        s_of[k + 1] = s_of[k] + dt * v_of[k]
        s_of[k + 1, k] += dt**2 / 3
        s_of[k + 1, k + 1] += dt**2 / 6
    jerk = np.diff(np.eye(count), axis=0) / dt
    rows = np.concatenate([s_of, np.sqrt(0.5) * v_of, np.sqrt(0.3) * np.eye(count), np.sqrt(0.3) * jerk])
    wanted = np.concatenate([
        s_driven - 8.0 * dt * np.arange(count), np.sqrt(0.5) * (v_driven - 8.0), np.zeros(count), np.zeros(count - 1),
    ])  # fmt: skip
    accel = np.linalg.lstsq(rows[:, 1:], wanted, rcond=None)[0]
    far = np.full(count, np.inf)
    bounds = SpeedBounds(low=-far, high=far, fastest=far, ttc_room=far, ttc_need=-far, ttc_s=1.7)
    motion = smooth_speed(s_driven, v_driven, bounds, LIMITS, a0=0.0, step_s=dt, jerk_weight=1.0)
    assert motion is not None
    assert motion.a[1:] == pytest.approx(accel, abs=1e-4)


def test_hard_bounds_are_kept_to_the_last_digit() -> None:
    """A leader ahead, one behind that closes in, jumping speeds: nothing is exceeded by more than 1e-6."""
    v = np.where((np.arange(COUNT) // 20) % 2 == 0, 9.0, 6.0)
    s = np.concatenate([[0.0], np.cumsum(0.1 * v[1:])])
    bounds = _bounds(high=s + 1.0, low=s - 1.5, ttc_room=s + 1.7 * 8.0 + 2.0)
    motion = _smooth(v, bounds)
    assert motion is not None
    assert np.all(motion.s[1:] <= bounds.high[1:] + 1e-6)
    assert np.all(motion.s[1:] >= bounds.low[1:] - 1e-6)
    assert np.all((motion.s + 1.7 * motion.v)[1:] <= bounds.ttc_room[1:] + 1e-6)
    assert np.abs(np.diff(motion.a)).max() <= 0.1 * LIMITS.jerk + 1e-6


def test_no_motion_where_the_bounds_contradict_each_other() -> None:
    assert _smooth(np.full(COUNT, 10.0), _bounds(low=np.full(COUNT, 50.0), high=np.full(COUNT, 40.0))) is None


def test_no_motion_where_nothing_brakes_in_time() -> None:
    """10 m/s and a wall 5 m ahead: 10^2 / 2 / 3.6 = 13.9 m are needed."""
    assert _smooth(np.full(COUNT, 10.0), _bounds(high=np.where(np.arange(COUNT) < 5, np.inf, 5.0))) is None


def test_poses_lie_on_the_line_and_move_along_it() -> None:
    """On a circle of 25 m at 10 m/s: heading is the tangent, velocity the derivative of position."""
    angle = np.linspace(0.0, np.pi, 60)
    line: ReferenceLine = build_reference_line(
        25.0 * np.column_stack([np.sin(angle), 1 - np.cos(angle)]), step_m=1.0, min_radius_m=5.0, max_offset_m=0.6
    )
    s = 5.0 + 1.0 * np.arange(50)
    trajectory = poses(line, Motion(s=s, v=np.full(50, 10.0), a=np.zeros(50)))
    assert np.abs(np.hypot(*(trajectory.position - [0.0, 25.0]).T) - 25.0).max() < 0.03
    derived = np.gradient(trajectory.position, 0.1, axis=0)[1:-1]
    assert np.abs(derived - trajectory.velocity[1:-1]).max() < 0.05
    course = np.arctan2(derived[:, 1], derived[:, 0])
    assert np.abs(np.sin(course - trajectory.heading[1:-1])).max() < 5e-3
