import math
from collections.abc import Callable

import numpy as np
import pytest

from netconvert.lane_graph import DroppedLink, LaneGraph, LaneSegment, TurnType, crossable, turn_type

Lane = Callable[..., LaneSegment]
Graph = Callable[..., LaneGraph]


@pytest.mark.parametrize(
    ("target", "reason"),
    [(99, "the other lane is outside the map"), (1, "the lane names itself"), (2, "the other lane starts elsewhere")],
)
def test_a_link_that_cannot_be_is_dropped_with_its_reason(lane: Lane, graph: Graph, target: int, reason: str) -> None:
    """A lane that starts elsewhere may well be beside."""
    links = {"left": target, "right": target} if target != 2 else {}
    made = graph(lane(1, [(0, 0), (10, 0)], successors=(target,), **links), lane(2, [(30, 0), (40, 0)]))
    assert made.successors(1) == ()
    assert made.neighbor(1, "left") is made.neighbor(1, "right") is None
    assert made.dropped[0] == DroppedLink("successor", 1, target, reason)
    assert {link.reason for link in made.dropped} == {reason}
    assert len(made.dropped) == 1 + len(links)


def test_the_neighbour_that_runs_the_opposite_way_is_no_neighbour(lane: Lane, graph: Graph) -> None:
    """
    3 <------
    2 ------>
    1 ------>
    """
    made = graph(
        lane(1, [(0, 0), (10, 0)], left=2),
        lane(2, [(0, 4), (10, 4)], left=3, right=1),
        lane(3, [(10, 8), (0, 8)], left=2),
    )
    assert made.neighbor(1, "left") == 2
    assert made.neighbor(2, "right") == 1
    assert not made.may_change(1, "right")
    assert made.neighbor(2, "left") is None
    assert {(link.source, link.reason) for link in made.dropped} == {
        (2, "the other lane runs the opposite way"),
        (3, "the other lane runs the opposite way"),
    }


def test_direction_is_that_of_the_whole_lane_not_of_its_start(lane: Lane, graph: Graph) -> None:
    """Two lanes of a bend whose first metres point back: their chords agree."""
    made = graph(lane(1, [(0, 0), (-1, 1), (10, 10)], left=2), lane(2, [(0, 4), (9, 14)], right=1))
    assert made.neighbor(1, "left") == 2


def test_two_lanes_cannot_have_the_same_lane_on_their_left(lane: Lane, graph: Graph) -> None:
    """Lane 2 names lane 3 as its right neighbour, so lane 1's claim to be beside it falls."""
    made = graph(
        lane(1, [(0, 0), (10, 0)], left=2), lane(2, [(0, 4), (10, 4)], right=3), lane(3, [(0, 0.5), (10, 0.5)], left=2)
    )
    assert made.neighbor(3, "left") == 2
    assert made.neighbor(1, "left") is None
    assert made.dropped == (DroppedLink("left_neighbor", 1, 2, "the other lane has another neighbour on that side"),)


def test_neighbours_never_form_a_ring(lane: Lane, graph: Graph) -> None:
    made = graph(
        lane(1, [(0, 0), (10, 0)], left=2, right=3),
        lane(2, [(0, 4), (10, 4)], left=3, right=1),
        lane(3, [(0, 8), (10, 8)], left=1, right=2),
    )
    leftmost = [lane_id for lane_id in made.lanes if made.neighbor(lane_id, "left") is None]
    rightmost = [lane_id for lane_id in made.lanes if made.neighbor(lane_id, "right") is None]
    assert len(leftmost) == len(rightmost) == 1
    assert {link.reason for link in made.dropped} == {"the neighbours would form a ring"}


@pytest.mark.parametrize(
    ("mark", "allowed"),
    [
        ("UNKNOWN", True),
        ("DOUBLE_DASH_WHITE", True),
        ("DASH_SOLID_YELLOW", True),  # dashed on the lane's own side
        ("SOLID_DASH_YELLOW", False),
        ("DOUBLE_SOLID_YELLOW", False),
        ("SOLID_BLUE", False),
    ],
)
def test_a_line_may_be_crossed_from_its_dashed_side_only(mark: str, allowed: bool) -> None:
    assert crossable(mark) is allowed


def _arc(degrees: float) -> np.ndarray:
    phi = np.radians(np.linspace(0.0, abs(degrees), 10))
    return 10.0 * np.column_stack([np.sin(phi), np.copysign(1, degrees) * (1.0 - np.cos(phi))])


@pytest.mark.parametrize(
    ("degrees", "turn"), [(90, TurnType.LEFT), (-90, TurnType.RIGHT), (20, TurnType.STRAIGHT), (200, TurnType.LEFT)]
)
def test_turn_type_follows_the_net_change_of_heading_in_an_intersection(degrees: float, turn: TurnType) -> None:
    assert turn_type(_arc(degrees), is_intersection=True) is turn
    assert turn_type(_arc(degrees), is_intersection=False) is TurnType.STRAIGHT


def test_an_s_bend_in_an_intersection_is_straight() -> None:
    """60 degrees left, then 60 degrees right: net change 0."""
    steps = np.array([(math.cos(a), math.sin(a)) for a in np.radians([0, 30, 60, 60, 30, 0])])
    points = np.concatenate([[[0.0, 0.0]], np.cumsum(steps, axis=0)])
    assert turn_type(points, is_intersection=True) is TurnType.STRAIGHT


def test_straightest_successor_turns_least_and_of_equals_has_the_lower_id(lane: Lane, graph: Graph) -> None:
    """Westwards, so that angles are near -pi and pi: 2 and 3 turn a little to either side, 4 farther."""
    made = graph(
        lane(1, [(0, 0), (-10, 0)], successors=(4, 3, 2)),
        lane(2, [(-10, 0), (-20, 2)]),
        lane(3, [(-10, 0), (-20, -2)]),
        lane(4, [(-10, 0), (-20, 5)]),
    )
    assert made.straightest_successor(1) == 2
    assert made.straightest_successor(2) is None


def test_straightest_successor_of_a_bent_lane_goes_on_from_its_end(lane: Lane, graph: Graph) -> None:
    """A right turn from north to east: its chord points to the north-east, its end to the east.

           3
          /
     .---'-- 2     2 turns by 0 degrees from the end, 3 by 45 to the left, which is the direction of the chord
    |
    1
    """
    made = graph(
        lane(1, [(0, 0), (0, 10), (10, 10)], successors=(2, 3), is_intersection=True),
        lane(2, [(10, 10), (20, 10)]),
        lane(3, [(10, 10), (20, 20)]),
    )
    assert made.straightest_successor(1) == 2


def test_straightest_successor_of_a_lane_for_cars_is_no_bicycle_lane(lane: Lane, graph: Graph) -> None:
    made = graph(
        lane(1, [(0, 0), (10, 0)], successors=(2, 3)),
        lane(2, [(10, 0), (20, 0)], lane_type="BIKE", successors=(4,)),
        lane(3, [(10, 0), (20, 5)], successors=(5,)),
        lane(4, [(20, 0), (30, 0)], lane_type="BIKE"),
        lane(5, [(20, 5), (30, 5)], lane_type="BIKE"),
    )
    assert [made.straightest_successor(lane_id) for lane_id in (1, 2, 3)] == [3, 4, None]
