import numpy as np
import pytest

from hid2.motion.lane_change_path import Blend, blend_paths, even_line, lateral_share
from netconvert.geometry import Polyline


def test_lateral_share_has_jerk_plus_minus_nothing_minus_plus_of_54() -> None:
    """d / D over tau, by hand: 9 / 216 = 1/24 at 1/6, 1/4 at 1/3, 1/2 at 1/2, and mirrored.

    jerk          +54 |-54 |  0  |-54 |+54        first sixth: 54 / 6 tau^3 = 9 tau^3
    acceleration   0 -> 9 -> 0   0 -> -9 -> 0     9 at 1/6: 9 D / T^2
    speed          0 -> .75 -> 1.5  1.5 -> 0      1.5 from 1/3 to 2/3: 1.5 D / T
    """
    knots = np.array([0, 1 / 6, 1 / 3, 0.5, 2 / 3, 5 / 6, 1.0])
    assert lateral_share(knots) == pytest.approx([0, 1 / 24, 0.25, 0.5, 0.75, 23 / 24, 1])
    h = 1e-3
    tau = np.arange(0.0, 1.0 + h / 2, h)
    d = lateral_share(tau)
    jerk = np.diff(d, 3) / h**3
    for sixth, sign in enumerate((1, -1, 0, 0, -1, 1)):
        inside = jerk[round(1000 / 6 * sixth) + 4 : round(1000 / 6 * (sixth + 1)) - 5]
        assert inside == pytest.approx(np.full(inside.size, 54.0 * sign), abs=1e-3)
    speed, acceleration = np.gradient(d, h), np.gradient(np.gradient(d, h), h)
    assert speed.max() == pytest.approx(1.5, abs=1e-3)
    assert np.abs(acceleration).max() == pytest.approx(9.0, abs=0.06)


def test_lateral_share_rests_outside_its_window() -> None:
    assert lateral_share(np.array([-1.0, 0.0, 1.0, 2.0])).tolist() == [0.0, 0.0, 1.0, 1.0]


CURRENT = np.array([[0.0, 0.0], [200.0, 0.0]])
LEFT = np.array([[0.0, 3.5], [200.0, 3.5]])


def blend_of(current: np.ndarray, target: np.ndarray, *, start_m: float, length_m: float) -> Blend | None:
    line = even_line(current, step_m=1.0)
    return blend_paths(line, Polyline(target), start_m=start_m, length_m=length_m, step_m=1.0, max_shift_m=5.5)


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
    assert blend.end_m == pytest.approx(90.0, abs=1.5)


def test_blend_to_the_right_shifts_the_other_way() -> None:
    blend = blend_of(LEFT, CURRENT, start_m=50.0, length_m=40.0)
    assert blend is not None
    assert np.all(np.diff(blend.points[:, 1]) <= 1e-9)


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
