"""A crossing of two one-way streets, 3.5 m wide; lanes 2, 5 and 7 lie in the intersection.

            6
            |
1 --------- 5 --- 3        2: from 1 to 3 through the middle, 0 < x < 20 at y = 0
      2     |              5: from 4 to 6, -10 < y < 10 at x = 10
            4              7: from 1 to 8, a right turn down to (6, -10)
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from hand_drawn import draw_driven, draw_lane
from inserted import CAR, recorded
from signal_entries import entries

from hid2.agents import Track
from hid2.conflicts.signals import InferredSignals
from hid2.measures.lane_matching import flatten_lanes
from hid2.occupancy.agent_states import agent_states
from hid2.params import Signals
from netconvert.lane_graph import LaneGraph, LaneSegment

STEPS = 110
PARAMS = Signals(before_s=2.0, after_s=3.0)


LANES = (
    draw_lane(1, [(-50, 0), (0, 0)], successors=(2, 7)),
    draw_lane(2, [(0, 0), (20, 0)], successors=(3,), is_intersection=True),
    draw_lane(3, [(20, 0), (70, 0)]),
    draw_lane(4, [(10, -50), (10, -10)], successors=(5,)),
    draw_lane(5, [(10, -10), (10, 10)], successors=(6,), is_intersection=True),
    draw_lane(6, [(10, 10), (10, 50)]),
    draw_lane(7, [(0, 0), (3, -0.8), (5.2, -3), (6, -6), (6, -10)], successors=(8,), is_intersection=True),
    draw_lane(8, [(6, -10), (6, -50)]),
)


def signals(*tracks: Track, lanes: Sequence[LaneSegment] = LANES) -> InferredSignals:
    graph = LaneGraph({one.lane_id: one for one in lanes})
    return InferredSignals(graph, agent_states(tracks, flatten_lanes(graph), num_steps=STEPS, step_s=0.1), PARAMS)


def _along(name: str, points: Sequence[Sequence[float]], *, wait_steps: int = 0, mps: float = 10.0) -> Track:
    """A car that waits at the first point and then drives along the points at a constant speed, heading along them."""
    xy = np.array(points, dtype=np.float64)
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    at = np.minimum(mps * 0.1 * np.maximum(np.arange(STEPS) - wait_steps, 0), s[-1])
    position = np.column_stack([np.interp(at, s, xy[:, 0]), np.interp(at, s, xy[:, 1])])
    piece = np.diff(xy, axis=0)[np.clip(np.searchsorted(s, at, side="right") - 1, 0, len(xy) - 2)]
    return replace(draw_driven(name, position, size=CAR), heading=np.arctan2(piece[:, 1], piece[:, 0]))


#: On lane 2 from step 47 to 53.
CROSSES = recorded(10.0, -50.0, 10.0, heading=np.pi / 2)
QUEUES = recorded(-12.0, 0.0, name="b")


def _steps(red: np.ndarray | None) -> list[int]:
    assert red is not None
    return np.flatnonzero(red).tolist()


def test_cross_traffic_makes_red_two_seconds_before_with_amber_before_that_and_three_after() -> None:
    """From (10, -50) at 1 m a step: y = step - 50. Lane 2's ground counts with 0.8 of its width, 1.4 m to each side.

    The box covers it while |y| < 1.4 + 2.25 = 3.65: steps 47 to 53. Red from 47 - 20 - 15 to 53 + 30. Where no time is
    asked for before it there is no amber either. One that is there at step 2 makes red from the beginning on.
    """
    scene = signals(CROSSES)
    assert _steps(scene.red(2)) == list(range(12, 84))
    assert "".join(scene.shown(2)) == "g" * 12 + "y" * 15 + "r" * 57 + "g" * (STEPS - 84)
    assert _steps(replace(scene, params=Signals(before_s=0.0, after_s=2.3)).red(2)) == list(range(37, 77))
    assert _steps(signals(recorded(10.0, -5.0, 10.0, heading=np.pi / 2)).red(2)) == list(range(39))
    assert _steps(scene.red(5)) == []
    assert _steps(entries(scene, 5)) == [41]  # the first centre above y = -10


@pytest.mark.parametrize(("degrees", "red"), [(35, False), (50, True), (130, True), (150, False)])
def test_only_ways_that_cross_at_a_wide_angle_are_cross_traffic(degrees: float, red: bool) -> None:
    """Through (10, 0) at step 50: a merge at 35 degrees, an oncoming vehicle at 150."""
    angle = np.radians(degrees)
    scene = signals(recorded(10 - 50 * np.cos(angle), -50 * np.sin(angle), 10.0, heading=angle))
    assert bool(scene.red(2).any()) is red


@pytest.mark.parametrize(("x", "y", "first"), [(10.0, -32.0, 25), (10.0, -45.0, 67), (26.0, 0.0, 56), (46.0, 0.0, 76)])
def test_light_has_turned_when_cross_traffic_starts(x: float, y: float, first: int) -> None:
    """All start at step 60. 28 m from lane 2's ground: red from 60 - 35 on; 42 m from it, there at 102: from 102 - 35.

    An opposite one may have waited for a gap: it turns left at (10, 0) at step 76, red from 76 - 20 on; or at step 96.
    """
    scene = signals(_along("a", [(x, y), *[(10.0, 0.0)] * (x > 10.0), (10.0, 40.0)], wait_steps=60))
    assert _steps(scene.red(2)) == list(range(first, STEPS))


def test_slow_or_parked_boxes_are_no_cross_traffic() -> None:
    """0.9 m/s across the lane is no flow; a box that stands on the crossing's ground is none, from step 49 on."""
    assert _steps(signals(_along("a", [(10.0, -50.0), (10.0, -2.0)])).red(2))[-1] == 48 + 30
    assert not signals(recorded(10.0, -5.0, 0.9, heading=np.pi / 2)).red(2).any()
    assert not signals(recorded(10.0, -2.0, heading=np.pi / 2)).red(2).any()


def test_who_turns_off_from_the_same_approach_does_not_cross() -> None:
    """Right out of lane 1, at 90 degrees over lane 2's ground for a while; from elsewhere it is a crossing."""
    turn = [(0.0, 0.0), (6.0, 0.0), (6.0, -40.0)]
    assert not signals(_along("a", [(-50.0, 0.0), *turn])).red(2).any()
    assert signals(_along("a", [(6.0, 30.0), (6.0, -40.0)])).red(2).any()
    lane_9 = draw_lane(9, [(-50, -3.5), (0, -3.5)], left=1)  # of the same approach
    beside = (draw_lane(1, [(-50, 0), (0, 0)], successors=(2, 7), right=9), lane_9)
    left = _along("a", [(-50.0, -3.5), (10.0, -3.5), (10.0, 40.0)])
    assert not signals(left, lanes=(*LANES[1:], *beside)).red(2).any()


@pytest.mark.parametrize(
    ("red", "x", "y"), [(1, -5.0, 0.5), (0, -5.0, 0.65), (1, -19.5, 0.0), (0, -20.5, 0.0), (1, 2.5, 0.0), (0, 3.5, 0.0)]
)
def test_a_queue_stands_in_the_middle_third_near_the_entrance(red: int, x: float, y: float) -> None:
    """A third of 3.5 m: 0.58 m to each side. Beyond it, who never moves is parked. 20 m before, 3 m behind."""
    assert _steps(signals(recorded(x, y)).red(2)) == list(range(red * STEPS))


def test_a_driver_that_comes_to_stand_saw_red_two_seconds_before() -> None:
    """From x = -35 at 5 m/s to -5 at step 60: it stands, by central differences, from step 61 on."""
    comes = recorded(-35.0, 0.0, 5.0)
    stands = np.minimum(comes.position, [-5.0, 0.0])
    scene = signals(replace(comes, position=stands, velocity=np.gradient(stands, 0.1, axis=0)))
    assert _steps(scene.red(2)) == list(range(41, STEPS))


@pytest.mark.parametrize(
    ("vehicles", "enters", "red"),
    [
        # at y = 1 until step 80, then on: it stands, by central differences, to step 79, and passes x = 0 at step 85
        ([_along("a", [(-5.0, 1.0), (40.0, 1.0)], wait_steps=80)], 86, range(76)),
        # from (-108.5, 0) at 1 m a step: at x = 0.5 at step 109, the last one
        ([_along("a", [(-108.5, 0.0), (40.0, 0.0)])], 109, ()),
        # the first enters at step 36, the second stands on at x = -12: red but for 36 - 10 to 36 + 20
        ([_along("a", [(-5.0, 0.0), (40.0, 0.0)], wait_steps=30), QUEUES], 36, (*range(26), *range(57, STEPS))),
        # cross traffic on the lane from 47 to 53, red from 12 to 83: an entry at 61 clears 51 to 81, not below 53 + 10
        ([CROSSES, _along("b", [(-50.0, 0.0), (70.0, 0.0)], wait_steps=10)], 61, (*range(12, 64), 82, 83)),
        # one waits for 25 steps, red to 20, and enters at 31: it is red again from 32 on for cross traffic to come
        ([CROSSES, _along("b", [(-5.0, 0.0), (40.0, 0.0)], wait_steps=25)], 31, (*range(21), *range(32, 84))),
    ],
    ids=["queue at the side", "inside at last", "queue behind", "soon after cross traffic", "cross traffic to come"],
)  # fmt: skip
def test_an_entry_makes_green_from_a_second_before_it_on(
    vehicles: list[Track], enters: int, red: Iterable[int]
) -> None:
    scene = signals(*vehicles)
    assert _steps(entries(scene, 2)) == [enters]
    assert _steps(scene.red(2)) == list(red)


@pytest.mark.parametrize(("y", "red"), [(4.0, 26), (30.0, 0)])
def test_straight_on_is_red_while_the_opposite_queue_stands(y: float, red: int) -> None:
    """It waits 5 m before the opposite entrance for 30 steps and enters at step 36: both are green from 26 on.

    The right turn of lane 7 has a phase of its own. A street 30 m aside is not the opposite one.
    """
    west = [
        draw_lane(11, [(70, y), (20, y)], successors=(12,)),
        draw_lane(12, [(20, y), (0, y)], successors=(13,), is_intersection=True),
        draw_lane(13, [(0, y), (-50, y)]),
    ]
    scene = signals(_along("a", [(25.0, y), (-50.0, y)], wait_steps=30), lanes=(*LANES, *west))
    assert "".join(scene.shown(12)) == "y" * 15 + "r" * 11 + "g" * (STEPS - 26)
    assert _steps(scene.red(2)) == list(range(red))
    assert _steps(scene.red(7)) == []


def test_a_right_turn_says_nothing_of_the_way_straight_on() -> None:
    """What turns right enters lane 7 alone; the queue in the shared lane stays red for lane 2."""
    turning = _along("a", [(-5.0, 0.0), (0.0, 0.0), (3.0, -0.8), (5.2, -3.0), (6.0, -6.0), (6.0, -40.0)], wait_steps=30)
    scene = signals(turning, QUEUES)
    assert _steps(entries(scene, 7)) == [35]
    assert _steps(entries(scene, 2)) == []
    assert _steps(scene.red(2)) == list(range(STEPS))
    assert _steps(scene.red(7)) == [*range(25), *range(56, STEPS)]


def test_only_lanes_that_are_entered_from_outside_have_an_entrance() -> None:
    """Lane 2 is cut in two: 9 begins inside. Its cross traffic counts at the entrance, which is that of lane 2."""
    lanes = [
        draw_lane(1, [(-50, 0), (0, 0)], successors=(2,)),
        draw_lane(2, [(0, 0), (8, 0)], successors=(9,), is_intersection=True),
        draw_lane(9, [(8, 0), (30, 0)], is_intersection=True),
        draw_lane(11, [(0, 40), (8, 40)], is_intersection=True),
    ]
    scene = signals(recorded(20.0, -50.0, 10.0, heading=np.pi / 2), lanes=lanes)
    assert _steps(scene.red(2)) == list(range(12, 84))
    assert [scene.red(lane) for lane in (1, 9, 11)] == [None, None, None]
    assert entries(scene, 11) is None
