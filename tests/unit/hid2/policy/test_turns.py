import numpy as np
import pytest

from hid2.motion.reference_line import TABLE_STEP_M, ReferenceLine, build_reference_line
from hid2.params import Limits, Turn
from hid2.policy.roads import f_left, hard_cap, road_speeds, turn_shape
from netconvert.lane_graph import TurnType

#: Every value that a number below is worked from; the defaults may be tuned.
TURN = Turn(left_trough=0.65, right_trough=0.75, trough_at=0.4)


def _circle(radius: float, degrees: float = 180.0) -> ReferenceLine:
    angle = np.radians(np.arange(0.0, degrees + 1e-9, 2.0))
    points = radius * np.column_stack([np.sin(angle), 1.0 - np.cos(angle)])
    return build_reference_line(points, step_m=1.0, min_radius_m=5.0, max_offset_m=0.6)


def _inside(line: ReferenceLine) -> slice:
    """Rows of the tables on the line itself, without those beyond its end."""
    return slice(0, int(line.length_m / TABLE_STEP_M) + 1)


def test_shape_is_one_at_both_ends_lowest_at_its_trough_and_smooth() -> None:
    """Trough 0.65 at alpha = 0.4. Half way down, at 0.2: 1 - 0.35 * (1 - cos(pi / 2)) / 2 = 0.825; at 0.7 as well.

    The slope at the ends and at the trough is zero: no jump of acceleration on entering.
    """
    assert turn_shape(np.array([0.0, 0.2, 0.4, 0.7, 1.0]), 0.65, 0.4) == pytest.approx([1.0, 0.825, 0.65, 0.825, 1.0])
    slope = np.gradient(turn_shape(np.linspace(0, 1, 10001), 0.65, 0.4), 1e-4)
    assert np.abs(slope[[1, 4000, -2]]).max() < 2e-2
    assert np.abs(np.diff(slope)).max() < 2e-3


def test_cap_on_a_circle_is_the_root_of_lateral_acceleration_times_radius() -> None:
    """R = 10 m, a_y = 2.5 m/s2: v = sqrt(25) = 5 m/s, below the yaw-rate cap of 0.8 * 0.95 * 10 = 7.6 m/s.

    With a_y = 4.89 it allows 7.0 m/s; a yaw-rate limit of 0.5 rad/s allows 0.8 * 0.5 * 10 = 4 m/s.
    """
    line = _circle(10.0)
    cap = road_speeds(line, [], turn=TURN, limits=Limits()).cap(2.5)[_inside(line)]
    assert np.median(cap) == pytest.approx(5.0, rel=0.02)
    limits = Limits(yaw_rate_radps=0.5)
    cap = road_speeds(line, [], turn=TURN, limits=limits).cap(4.89)[_inside(line)]
    assert np.median(cap) == pytest.approx(4.0, rel=0.02)
    assert np.all(cap <= hard_cap(line, limits)[_inside(line)])


def test_bend_asks_the_same_of_a_driver_that_desires_less_in_the_mean() -> None:
    """Desired speeds wander above their mean: R = 20 m at 2.5 m/s2 is taken at 7.07 m/s by it too."""
    line = _circle(20.0)
    road = road_speeds(line, [], turn=TURN, limits=Limits())
    slow, fast = (road.desired(mps, lateral_accel_mps2=2.5, accel_mps2=1.8)[_inside(line)] for mps in (5.0, 12.0))
    assert slow.tolist() == fast.tolist()
    assert np.median(slow) == pytest.approx(7.07, rel=0.02)


def _desired(
    line: ReferenceLine,
    segments: list[tuple[float, float, TurnType]],
    *,
    desired_mps: float = 10.0,
    lateral_accel_mps2: float = 2.5,
):
    """Speed of a driver that never desires more than in the mean."""
    road = road_speeds(line, segments, turn=TURN, limits=Limits())
    return np.minimum(road.desired(desired_mps, lateral_accel_mps2=lateral_accel_mps2, accel_mps2=1.8), desired_mps)


def test_straight_lane_is_driven_at_the_cruising_speed(straight_line: ReferenceLine) -> None:
    """v(t + dt) ~ v(t)."""
    speed = _desired(straight_line, [(0.0, 200.0, TurnType.STRAIGHT)], desired_mps=12.0)
    assert speed == pytest.approx(np.full(speed.size, 12.0))


def test_slowing_begins_before_the_entrance_and_speeding_up_ends_after_the_exit(straight_line: ReferenceLine) -> None:
    """Left turn from 100 to 120 m at a desired speed of 10 m/s: 6.5 m/s at its trough, 108 m.

    Slowing at 1.5 m/s2 from 10 to 6.5 m/s takes (100 - 42.25) / 3 = 19.25 m: it begins at 88.75 m, 11 m before the
    entrance. Speeding up at 1.8 m/s2 takes 57.75 / 3.6 = 16.04 m: it ends at 124.04 m, 4 m behind the exit. At the
    entrance sqrt(42.25 + 3 * 8) = 8.14 m/s, at the exit sqrt(42.25 + 3.6 * 12) = 9.24 m/s; both a little less, since
    the shape is flat at its trough.
    """
    speed = _desired(
        straight_line,
        [(0.0, 100.0, TurnType.STRAIGHT), (100.0, 120.0, TurnType.LEFT), (120.0, 200.0, TurnType.STRAIGHT)],
    )

    def at(s: float) -> float:
        return float(speed[int(s / TABLE_STEP_M)])

    assert at(108.0) == pytest.approx(6.5)
    assert at(88.0) == pytest.approx(10.0)
    assert 9.0 < at(92.0) < 10.0
    assert at(100.0) == pytest.approx(8.0, abs=0.14)
    assert at(120.0) == pytest.approx(9.0, abs=0.24)
    assert at(126.0) == pytest.approx(10.0)


def test_right_turn_is_driven_faster_than_a_left_one(straight_line: ReferenceLine) -> None:
    left, right = (_desired(straight_line, [(100.0, 120.0, kind)]) for kind in (TurnType.LEFT, TurnType.RIGHT))
    assert left.min() == pytest.approx(6.5)
    assert right.min() == pytest.approx(7.5)


def _corner(radius: float, *, before_m: float = 60.0) -> tuple[ReferenceLine, list[tuple[float, float, TurnType]]]:
    """Straight, 90 degrees to the left, straight; the turning lane begins 4 m before the arc and ends 4 m behind it."""
    angle = np.radians(np.arange(0.0, 91.0, 3.0))
    arc = np.column_stack([before_m + radius * np.sin(angle), radius - radius * np.cos(angle)])
    points = np.concatenate([[[0.0, 0.0]], arc, [[before_m + radius, radius + 60.0]]])
    line = build_reference_line(points, step_m=1.0, min_radius_m=5.0, max_offset_m=0.6)
    start, end = before_m - 4.0, before_m + radius * np.pi / 2 + 4.0
    return line, [(0.0, start, TurnType.STRAIGHT), (start, end, TurnType.LEFT), (end, line.length_m, TurnType.STRAIGHT)]


def test_shape_and_lateral_acceleration_meet_at_one_point_of_a_corner() -> None:
    """R = 10 m: v^2 kappa is 2 m/s2 at most, at one point; v / v_0 is f(alpha) on the whole lane."""
    line, segments = _corner(10.0)
    road = road_speeds(line, segments, turn=TURN, limits=Limits(jerk_mps3=30.0, yaw_accel_radps2=5.0))
    (start, end, _) = segments[1]
    rows = np.arange(int(np.ceil(start / TABLE_STEP_M)), int(end / TABLE_STEP_M) + 1)
    v = road.cap(2.0)[rows]
    f = f_left((rows * TABLE_STEP_M - start) / (end - start), TURN)
    assert v / f == pytest.approx(np.full(v.size, v[0] / f[0]))
    lateral = v**2 * np.abs(line.table_curvature[rows])
    assert lateral.max() == pytest.approx(2.0)
    assert np.sum(lateral > 0.999 * 2.0) == 1


def test_slow_driver_enters_a_wide_turn_at_the_cruising_speed() -> None:
    """R = 40 m at 2.5 m/s2 allows 10 m/s and more: at a desired speed of 6 m/s f alone decides, 0.65 * 6 = 3.9 m/s."""
    line, segments = _corner(40.0)
    speed = _desired(line, segments, desired_mps=6.0)
    assert speed.min() == pytest.approx(3.9, rel=0.01)
    assert speed[0] == pytest.approx(6.0)


def test_hard_limits_have_the_last_word_in_a_turn() -> None:
    line, segments = _corner(6.0)
    limits = Limits(yaw_rate_radps=0.3)
    road = road_speeds(line, segments, turn=TURN, limits=limits)
    speed = road.desired(10.0, lateral_accel_mps2=4.0, accel_mps2=1.8)
    assert np.all(speed <= hard_cap(line, limits) + 1e-9)
