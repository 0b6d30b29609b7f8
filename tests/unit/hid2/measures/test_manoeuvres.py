"""The detector of manoeuvres on hand-drawn roads: it sees positions and the map, nothing else.

Lanes 1 and 2 run along +x, 3.5 m wide, lane 1 at y = 0, lane 2 to its left at y = 3.5; the marking is at y = 1.75.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from hand_drawn import draw_driven, draw_lane, draw_road
from scipy.signal import savgol_filter
from views import lane_view

from hid2.agents import Policy
from hid2.evaluation.metrics import policies
from hid2.measures.arrays import stack
from hid2.measures.manoeuvres import ManeuverKind, detect, lateral_speed
from netconvert.lane_graph import LaneGraph

TIME = 0.1 * np.arange(110)


def along(x, y, *, name="a"):
    x, y = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
    return draw_driven(name, np.column_stack([x, y]))


def shift(start, duration, *, width=3.5, time=TIME):
    """Lateral offset of a change that starts at `start`: a quintic from 0 to width."""
    r = np.clip((time - start) / duration, 0, 1)
    return width * (10 * r**3 - 15 * r**4 + 6 * r**5)


def seen(graph, *tracks):
    return detect(lane_view(stack(tracks, step_s=0.1), graph))


def kinds(graph, *tracks, of="a"):
    return [maneuver.kind.value for maneuver in seen(graph, *tracks) if maneuver.track_id == of]


def test_lane_change_is_found_with_its_crossing_in_the_middle():
    """10 m/s, change of 4 s from 3.0 s: crosses the marking half-way, at 5.0 s. |d'| passes 0.1 m/s a little inside.

    d' = 3.5 / 4 * 30 r^2 (1 - r)^2 = 0.1 at r = 0.0657: 3.26 s and 6.74 s; the fitted slope blurs by half a window.
    To the right as well; with 0.9 s left beyond a crossing at 10.0 s it is seen without its end.
    """
    (found,) = seen(draw_road(length_m=200), along(20 + 10 * TIME, shift(3.0, 4.0)))
    assert found.kind is ManeuverKind.LANE_CHANGE
    assert found.crossing_s == pytest.approx(5.0, abs=0.01)
    assert found.start_s == pytest.approx(3.26, abs=0.35)
    assert found.end_s == pytest.approx(6.74, abs=0.35)
    assert (found.source_lane, found.target_lane, found.side, found.complete) == (1, 2, 1, True)
    (found,) = seen(draw_road(length_m=200), along(20 + 10 * TIME, 3.5 - shift(3.0, 3.0)))
    assert (found.kind, found.side, found.source_lane, found.target_lane) == (ManeuverKind.LANE_CHANGE, -1, 2, 1)
    (found,) = seen(draw_road(length_m=200), along(20 + 10 * TIME, shift(8.0, 4.0)))
    assert (found.kind, found.complete) == (ManeuverKind.LANE_CHANGE, False)


def test_crossing_is_at_the_border_where_it_is_crossed():
    """Lanes of 4 m in the mean, centrelines 4 m apart; the border is at y = 1.5 from x = 50 m on, before it at 2.6.

    d = 4 (10 r^3 - 15 r^4 + 6 r^5) = 1.5 at r = 0.4325: 3.0 + 0.4325 * 6 = 5.60 s; it would be at 2 m at 6.0 s.
    """
    first = draw_lane(1, [(0, 0), (200, 0)], left=2, width_m=4.0)
    second = draw_lane(2, [(0, 4), (200, 4)], right=1, width_m=4.0)
    border = np.array([[0.0, 2.6], [50.0, 1.5], [200.0, 1.5]])
    first = replace(first, left_boundary=border, right_boundary=first.sides[1])
    second = replace(second, left_boundary=second.sides[0], right_boundary=border)
    (found,) = seen(LaneGraph({1: first, 2: second}), along(20 + 10 * TIME, shift(3.0, 6.0, width=4.0)))
    assert found.crossing_s == pytest.approx(5.60, abs=0.02)


def test_lane_change_over_the_joint_of_two_segments():
    """Lanes 1 -> 3 and 2 -> 4 meet at x = 60, which is where the vehicle crosses."""
    graph = LaneGraph(
        {
            1: draw_lane(1, [(0, 0), (60, 0)], successors=(3,), left=2),
            2: draw_lane(2, [(0, 3.5), (60, 3.5)], successors=(4,), right=1),
            3: draw_lane(3, [(60, 0), (200, 0)], left=4),
            4: draw_lane(4, [(60, 3.5), (200, 3.5)], right=3),
        }
    )
    (found,) = seen(graph, along(10 + 10 * TIME, shift(3.0, 4.0)))
    assert found.kind is ManeuverKind.LANE_CHANGE
    assert found.crossing_s == pytest.approx(5.0, abs=0.02)


@pytest.mark.parametrize(
    "y",
    [
        1.6 * np.exp(-(((TIME - 5) / 1.5) ** 2)),
        2.1 * np.exp(-(((TIME - 5) / 0.4) ** 2)),  # beyond the marking for 2 * 0.4 * sqrt(ln(2.1 / 1.75)) = 0.34 s
        1.0 + shift(3.0, 3.0, width=1.4),  # 1.4 m of 3.5 m
    ],
    ids=["to the marking and back", "beyond it for less than half a second", "over it by less than half a lane"],
)
def test_what_is_no_lane_change(y):
    assert kinds(draw_road(length_m=200), along(20 + 10 * TIME, y)) == []


def test_noise_of_a_tracker_makes_no_lane_changes_and_hides_none_and_who_stands_does_nothing():
    assert kinds(draw_road(), along(np.full(110, 50.0), 0.0)) == []
    rng = np.random.default_rng(1)
    noisy = along(20 + 10 * TIME + rng.normal(0, 0.1, 110), 0.6 + rng.normal(0, 0.15, 110))
    assert kinds(draw_road(length_m=200), noisy) == []
    rng = np.random.default_rng(1)
    noisy = along(20 + 10 * TIME + rng.normal(0, 0.05, 110), shift(3.0, 4.0) + rng.normal(0, 0.05, 110))
    (found,) = seen(draw_road(length_m=200), noisy)
    assert found.crossing_s == pytest.approx(5.0, abs=0.2)


def test_following_a_merge_or_a_fork_is_no_lane_change():
    """Lane 1 ends in lane 3 together with lane 2: who comes along 1 merges, but changes no lane."""
    graph = LaneGraph(
        {
            1: draw_lane(1, [(0, -4), (50, -1), (60, 0)], successors=(3,)),
            2: draw_lane(2, [(0, 0), (60, 0)], successors=(3,)),
            3: draw_lane(3, [(60, 0), (200, 0)]),
        }
    )
    x = 10 * TIME
    assert kinds(graph, along(x, np.interp(x, [0, 50, 60, 200], [-4, -1, 0, 0]))) == []


def crossroads():
    """Lane 1 comes from the left, 2 turns left over a quarter circle of 10 m, 3 goes on up; 4, 5 likewise right."""
    quarter = np.linspace(0, math.pi / 2, 12)
    left = [(50 + 10 * math.sin(a), 10 - 10 * math.cos(a)) for a in quarter]
    right = [(x, -y) for x, y in left]
    return LaneGraph(
        {
            1: draw_lane(1, [(0, 0), (50, 0)], successors=(2, 4)),
            2: draw_lane(2, left, successors=(3,), is_intersection=True),
            3: draw_lane(3, [(60, 10), (60, 80)]),
            4: draw_lane(4, right, successors=(5,), is_intersection=True),
            5: draw_lane(5, [(60, -10), (60, -80)]),
        }
    )


def turning(sign, speed=7.0, start=0.0):
    way = start + speed * TIME
    angle = np.clip((way - 50) / 10, 0, math.pi / 2)
    beyond = np.maximum(way - 50 - 5 * math.pi, 0)
    return along(np.minimum(way, 50) + 10 * np.sin(angle), sign * (10 - 10 * np.cos(angle) + beyond))


@pytest.mark.parametrize(("sign", "kind"), [(1, ManeuverKind.LEFT_TURN), (-1, ManeuverKind.RIGHT_TURN)])
def test_turns_are_found_by_lane_and_heading(sign, kind):
    """50 m at 7 m/s: in the turn from 7.1 to 9.4 s."""
    (found,) = seen(crossroads(), turning(sign))
    assert (found.kind, found.side, found.complete) == (kind, sign, True)
    assert found.start_s == pytest.approx(7.1, abs=0.3)
    assert found.end_s == pytest.approx(9.4, abs=0.3)


def test_a_turn_that_the_scene_cuts_off_early_is_none_and_later_is_incomplete():
    """76 m are driven. From -27 m the turn is never reached; from -18 m 8.3 m of it are driven, 48 degrees."""
    assert kinds(crossroads(), turning(1, start=-27.0)) == []
    (found,) = seen(crossroads(), turning(1, start=-18.0))
    assert (found.kind, found.complete) == (ManeuverKind.LEFT_TURN, False)


OUT_AND_BACK = shift(1.5, 2.5) - shift(6.5, 2.5)


def test_overtake_is_out_past_and_back():
    """a at 14 m/s, b 15 m ahead at 8 m/s in lane 1: level after 2.5 s, 25 m clear when a is back."""
    a, b = along(20 + 14 * TIME, OUT_AND_BACK), along(35 + 8 * TIME, 0.0, name="b")
    found = seen(draw_road(length_m=250), a, b)
    overtake = next(m for m in found if m.kind is ManeuverKind.OVERTAKE)
    assert overtake.other_track_id == "b"
    assert overtake.crossing_s == pytest.approx(2.5, abs=0.11)
    changes = [m for m in found if m.kind is ManeuverKind.LANE_CHANGE]
    assert [m.part_of for m in changes] == [ManeuverKind.OVERTAKE] * 2
    assert policies(stack([a, b], step_s=0.1), found) == {"a": Policy.OVERTAKE, "b": Policy.STRAIGHT}


@pytest.mark.parametrize(
    ("a", "b", "found"),
    [
        (along(20 + 14 * TIME, shift(1.5, 2.5)), 35 + 8 * TIME, ["lane_change", "pass"]),
        (along(20 + 9 * TIME, OUT_AND_BACK), 65 + 0 * TIME, ["lane_change", "lane_change", "obstacle_avoidance"]),
        (along(20 + 10 * TIME, OUT_AND_BACK), 45 + 10 * TIME, ["lane_change", "lane_change"]),
        # from lane 2 past b it moves in ahead of it: it never was behind b in b's lane
        (along(20 + 14 * TIME, 3.5 - shift(5.0, 3.0)), 35 + 8 * TIME, ["lane_change"]),
    ],
    ids=["without the return", "round a parked vehicle", "behind the other", "in front of a slower one"],
)
def test_what_is_no_overtake(a, b, found):
    assert sorted(kinds(draw_road(length_m=250), a, along(b, 0.0, name="b"))) == found


@pytest.mark.parametrize("steps", [11, 12, 110])
def test_lateral_speed_is_savitzkys_and_golays(steps):
    """A window of 1.1 s is 11 points at 0.1 s; at the ends the parabola of the outermost window is used."""
    values = np.random.default_rng(0).normal(size=steps).cumsum()
    expected = savgol_filter(values, 11, 2, deriv=1, delta=0.1)
    assert lateral_speed(values, 0.1 * np.arange(steps)) == pytest.approx(expected, abs=1e-9)
