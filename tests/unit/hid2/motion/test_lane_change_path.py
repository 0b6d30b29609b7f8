import numpy as np
import pytest

from hid2.measures.manoeuvres import lateral_speed
from hid2.motion.lane_change_path import Blend, LateralTiming, blend_paths, lateral_share
from hid2.params import LaneChange
from netconvert.geometry import Polyline, arc_length, resample


def test_lateral_share_rises_evenly_between_two_ramps() -> None:
    """d / D over tau with ramps of 1/4, by hand: (2/9) (4 tau)^3 = 1/36 at 1/8, 1/6 at 1/4, 1/2 at 1/2, and mirrored.

    jerk          +256/3 |-256/3 |  0  |-256/3 |+256/3      first eighth: 256/3 / 6 tau^3
    acceleration   0 -> 32/3 -> 0   0 -> -32/3 -> 0         32/3 at 1/8
    speed          0 -> 2/3 -> 4/3  4/3 -> 0                1 / (1 - 1/4) from 1/4 to 3/4
    """
    knots = np.array([0, 1 / 8, 1 / 4, 0.5, 3 / 4, 7 / 8, 1.0])
    assert lateral_share(knots, 0.25) == pytest.approx([0, 1 / 36, 1 / 6, 0.5, 5 / 6, 35 / 36, 1])
    assert lateral_share(np.array([-1.0, 2.0]), 0.25).tolist() == [0.0, 1.0]  # it rests outside
    h = 1e-3
    d = lateral_share(np.arange(0.0, 1.0 + h / 2, h), 0.25)
    jerk = np.diff(d, 3) / h**3
    for begin, end, sign in ((0, 125, 1), (125, 250, -1), (250, 750, 0), (750, 875, -1), (875, 1000, 1)):
        inside = jerk[begin + 4 : end - 5]
        assert inside == pytest.approx(np.full(inside.size, 256 / 3 * sign), abs=1e-3)
    speed, acceleration = np.gradient(d, h), np.gradient(np.gradient(d, h), h)
    assert speed.max() == pytest.approx(4 / 3, abs=1e-3)
    assert np.abs(acceleration).max() == pytest.approx(32 / 3, abs=0.1)


def test_motion_lasts_as_wanted_between_the_moments_at_which_the_lateral_speed_passes_a_tenth() -> None:
    """5 s for 3.5 m with ramps of .27, as a lane change is measured: 5.5 s from end to end, at most .87 m/s.

    .87 = 3.5 / 5.51 / .73.
    """
    timing = LateralTiming.of(5.0, 3.5, LaneChange())
    assert timing.lasting_s == pytest.approx(5.51, abs=0.02)
    time = np.arange(0.0, 10.0, 0.1)
    speed = lateral_speed(3.5 * lateral_share((time - 2.0) / timing.lasting_s, timing.ramp), time)
    assert np.ptp(time[speed > 0.1]) == pytest.approx(5.0, abs=0.1)
    assert speed.max() == pytest.approx(0.87, abs=0.01)


def test_slow_vehicle_takes_longer_so_that_its_heading_stays_within_the_bound() -> None:
    """.87 m/s across is 10 degrees at .87 / tan(10 deg) = 4.93 m/s; at 2 m/s it takes 4.93 / 2 times as long."""
    timing = LateralTiming.of(5.0, 3.5, LaneChange(heading_deg=10.0))
    assert timing.slow_mps == pytest.approx(4.93, abs=0.02)
    whole = 0.1 / timing.lasting_s
    assert timing.gained(np.array([0.0, 2.0, 4.93, 20.0]), 0.1) == pytest.approx(
        [0.0, 2.0 / 4.93 * whole, whole, whole], rel=1e-2
    )


CURRENT = np.array([[0.0, 0.0], [200.0, 0.0]])
LEFT = np.array([[0.0, 3.5], [200.0, 3.5]])


def even_line(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    even = resample(points, step_m=1.0)
    return even, arc_length(even)


def blend_of(current: np.ndarray, target: np.ndarray, *, start_m: float, length_m: float) -> Blend | None:
    tau = np.linspace(0.0, 1.0, 11)
    return blend_paths(
        even_line(current), Polyline(target), along_m=start_m + length_m * tau, tau=tau, ramp=0.27,
        step_m=1.0, max_shift_m=5.5,
    )  # fmt: skip


def test_blend_leaves_one_lane_for_the_other() -> None:
    """Shift from 50 to 90 m: on the old lane until 50, half way (1.75 m) at 70, on the new one from 90 on.

    y = 3.5 - - - - - - - - - ______________
                         ____/
    y = 0   ____________/ - - - - - - - - -
            0           50   70   90      200
    """
    blend = blend_of(CURRENT, LEFT, start_m=50.0, length_m=40.0)
    assert blend is not None
    y = np.interp([0.0, 50.0, 70.0, 90.0, 200.0], blend.points[:, 0], blend.points[:, 1])
    assert y == pytest.approx([0.0, 0.0, 1.75, 3.5, 3.5], abs=0.02)
    assert blend.start_m == pytest.approx(50.0, abs=1.0)
    assert blend.middle_m == pytest.approx(70.0, abs=0.2)
    assert blend.end_m == pytest.approx(90.0, abs=1.5)


def test_who_slows_down_is_half_way_across_farther_on() -> None:
    """Half of the time over 30 m, the other half over 10: the middle is crossed at 80 m, not at 70."""
    blend = blend_paths(
        even_line(CURRENT), Polyline(LEFT), along_m=np.array([50.0, 80.0, 90.0]),
        tau=np.array([0.0, 0.5, 1.0]), ramp=0.27, step_m=1.0, max_shift_m=5.5,
    )  # fmt: skip
    assert blend is not None
    assert blend.middle_m == pytest.approx(80.0, abs=0.3)
    assert np.interp(80.0, *blend.points.T) == pytest.approx(1.75, abs=0.05)


def test_blend_knows_how_far_the_target_is_ahead_of_it() -> None:
    """The target begins 30 m before the current lane: its arc length is 30 m more, less a detour of 0.2 m."""
    blend = blend_of(CURRENT, LEFT - np.array([30.0, 0.0]), start_m=50.0, length_m=40.0)
    assert blend is not None
    assert blend.target_offset_m == pytest.approx(30.0, abs=0.3)
    onward = Polyline(LEFT - np.array([30.0, 0.0])).point(np.array([150.0 + blend.target_offset_m]))
    assert Polyline(blend.points).point(np.array([150.0])) == pytest.approx(onward, abs=0.02)


@pytest.mark.parametrize(
    ("target", "start", "length"),
    [
        (LEFT * [0.4, 1.0], 50.0, 40.0),  # the target ends at 80 m
        (LEFT + np.array([0.0, 3.5]), 50.0, 40.0),  # 7 m away: not the adjacent lane
        (LEFT, 180.0, 40.0),  # the own lane ends first
        (LEFT[::-1], 50.0, 40.0),  # oncoming
        (LEFT + np.array([60.0, 0.0]), 50.0, 40.0),  # begins only at 60 m
    ],
)
def test_no_blend_where_the_lanes_are_not_side_by_side(target: np.ndarray, start: float, length: float) -> None:
    assert blend_of(CURRENT, target, start_m=start, length_m=length) is None
