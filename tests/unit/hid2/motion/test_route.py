from dataclasses import replace

import numpy as np
import pytest
from hand_drawn import draw_lane, draw_road
from inserted import scene_on

from hid2.insertion.routes import Routes
from hid2.motion import route as routing
from hid2.motion.lane_change_path import LateralTiming
from hid2.params import Limits
from netconvert.lane_graph import LaneGraph, TurnType


@pytest.fixture(scope="module")
def forked() -> LaneGraph:
    """A lane that splits, straight on and to the left; the left branch turns by 90 degrees.

                     4 |
                       |
                    3 _/
    ---- 1 ----><----- 2 -----><-- 5 (a bus lane) --
    0          50             100               150
    """
    angle = np.linspace(0.0, np.pi / 2, 20)
    bend = np.array([50.0, 0.0]) + 15.0 * np.column_stack([np.sin(angle), 1 - np.cos(angle)])
    return LaneGraph({
        1: draw_lane(1, [(0.0, 0.0), (50.0, 0.0)], successors=(2, 3)),
        2: draw_lane(2, [(50.0, 0.0), (100.0, 0.0)], successors=(5,), is_intersection=True),
        3: draw_lane(3, bend, successors=(4,), is_intersection=True),
        4: draw_lane(4, [bend[-1], bend[-1] + [0.0, 60.0]]),
        5: draw_lane(5, [(100.0, 0.0), (150.0, 0.0)], lane_type="BUS"),
    })  # fmt: skip


def _path(graph: LaneGraph, *route: int) -> routing.DrivenPath:
    return routing.LanePaths(graph, Limits()).along(route)


def test_segments_meet_and_cover_the_path(forked: LaneGraph) -> None:
    """Lane 1 is 50 m; lane 3 is an arc of 15 pi / 2 = 23.6 m; lane 4 is 60 m."""
    path = _path(forked, 1, 3, 4)
    ends = [segment.end for segment in path.segments]
    assert ends == pytest.approx([50.0, 73.6, 133.6], abs=0.2)
    assert [segment.start for segment in path.segments] == pytest.approx([0.0, *ends[:-1]])
    assert path.exit_m == pytest.approx(ends[-1])


def test_place_on_the_path_is_a_place_on_a_lane_and_back(forked: LaneGraph) -> None:
    """70 m on 1 and 2 are 20 m on lane 2; along the arc the scales of the line and its polyline differ."""
    path = _path(forked, 1, 2)
    segment = path.segment_at(70.0)
    assert (segment.lane_id, segment.lane_m(70.0)) == (2, pytest.approx(20.0, abs=0.01))
    assert (path.segment_at(0.0).lane_id, path.segment_at(1e3).lane_id) == (1, 2)
    path = _path(forked, 1, 3, 4)
    for s in (0.0, 20.0, 60.0, 90.0, 130.0):
        segment = path.segment_at(s)
        assert path.s_on(segment.lane_id, segment.lane_m(s), after=s - 1.0) == pytest.approx(s)
        assert path.to_line(path.to_raw(s)) == pytest.approx(s, abs=1e-6)
    assert path.s_on(2, 10.0, after=0.0) is None


def test_lane_position_outside_a_segment_is_its_nearer_end() -> None:
    segment = routing.Segment(lane_id=1, start=10.0, end=30.0, lane_start=5.0, lane_end=25.0)
    assert [segment.lane_m(s) for s in (0.0, 10.0, 20.0, 30.0, 99.0)] == [5.0, 5.0, 15.0, 25.0, 25.0]


def test_routes_follow_the_order_chosen_at_a_split_and_are_cut_when_long_enough_and_counted(
    forked: LaneGraph, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Lane 2 leads only onto the bus lane: a route that stopped there would stop in the middle of the road."""

    def routes(graph: LaneGraph, order: int = 1, most: int = 9) -> list[tuple[int, ...]]:
        return list(routing.routes_from(graph, 1, choose=lambda _, onward: onward[::order], most=most))

    open_to_all = LaneGraph({**forked.lanes, 5: replace(forked.lanes[5], lane_type="VEHICLE")})  # lane 5 for all
    assert routes(open_to_all) == [(1, 2, 5), (1, 3, 4)]
    assert routes(open_to_all, order=-1) == [(1, 3, 4), (1, 2, 5)]
    assert routes(open_to_all, most=1) == [(1, 2, 5)]
    assert routes(forked) == [(1, 3, 4)]
    monkeypatch.setattr("hid2.motion.route.ROUTE_LONGEST_M", 60.0)
    assert routes(open_to_all) == [(1, 2), (1, 3)]
    # a vehicle that may drive farther in the time of the scene needs more
    straight_on = routing.routes_from(open_to_all, 1, choose=lambda _, onward: onward, most=1, needed_m=500.0)
    assert list(straight_on) == [(1, 2, 5)]


def test_straightest_lane_at_a_split_is_the_one_that_turns_least_either_way() -> None:
    """Both lanes go straight on by their own shape: 2 bears off by 11 degrees, 3 by 3; so do those that they meet."""
    made = LaneGraph({
        1: draw_lane(1, [(0.0, 0.0), (20.0, 0.0)], successors=(2, 3)),
        2: draw_lane(2, [(20.0, 0.0), (40.0, 4.0)], successors=(4,)),
        3: draw_lane(3, [(20.0, 0.0), (40.0, 1.0)], successors=(4,)),
        4: draw_lane(4, [(40.0, 2.0), (60.0, 2.0)]),
    })  # fmt: skip
    assert routing.straightest_first(made, 1, (2, 3)) == (3, 2)
    assert routing.straightest_first(made, 1, (2, 3))[0] == made.straightest_successor(1)
    assert routing.straightest_first(made, 1, (2, 3), preferred={2}) == (2, 3)
    assert routing.straightest_first(made, 4, (2, 3)) == (3, 2)
    assert routing.LanePaths(made, Limits()).route_beside((1,), 4) == (1, 3, 4)


def test_lane_before_that_goes_straight_on_comes_before_one_that_turns_onto_it() -> None:
    """Lane 1 turns left by 90 degrees and ends along x, as lane 3 begins; lane 2 comes by 1.4 degrees aside."""
    angle = np.linspace(0.0, np.pi / 2, 60)
    bend = np.array([40.0, 20.0]) - 20.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    made = LaneGraph({
        1: draw_lane(1, bend, successors=(3,)),
        2: draw_lane(2, [(0.0, -1.0), (40.0, 0.0)], successors=(3,)),
        3: draw_lane(3, [(40.0, 0.0), (80.0, 0.0)]),
    })  # fmt: skip
    assert routing.straightest_first(made, 3, (1, 2)) == (2, 1)
    assert routing.LanePaths(made, Limits()).route_beside((1,), 3) == (2, 3)


@pytest.mark.parametrize(("look_back_m", "route"), [(0.0, (5,)), (30.0, (4, 5)), (50.0, (3, 4, 5)), (500.0, (3, 4, 5))])
def test_lane_beside_is_known_so_far_back_as_is_asked_for(
    monkeypatch: pytest.MonkeyPatch, look_back_m: float, route: tuple[int, ...]
) -> None:
    """Lanes 3, 4, 5 of 40 m each, one after the other, and lane 6 beside lane 5: whoever comes from behind on them."""
    monkeypatch.setattr("hid2.motion.route._LOOK_BACK_M", look_back_m)
    graph = LaneGraph({
        n: draw_lane(n, [(40.0 * place, 3.5), (40.0 * (place + 1), 3.5)], successors=onward)
        for place, (n, onward) in enumerate(((3, (4,)), (4, (5,)), (5, ())))
    } | {6: draw_lane(6, [(80.0, 0.0), (120.0, 0.0)])})  # fmt: skip
    assert routing.LanePaths(graph, Limits()).route_beside((6,), 5) == route


def test_circle_of_lanes_is_driven_once() -> None:
    angle = np.linspace(0.0, np.pi, 30)
    half = 20.0 * np.column_stack([np.sin(angle), 1 - np.cos(angle)])
    ring = LaneGraph({1: draw_lane(1, half, successors=(2,)), 2: draw_lane(2, [0.0, 40.0] - half, successors=(1,))})
    routes = list(routing.routes_from(ring, 1, choose=lambda _, onward: onward, most=5))
    assert routes == [(1, 2)]


def test_no_route_comes_back_over_itself() -> None:
    """Lane 3 leads down across lane 1: of an agent there the path would have one interval from 40 to 130 m."""
    bow = [(60.0, 0.0), (75.0, 15.0), (60.0, 30.0), (40.0, 30.0)]
    looped = LaneGraph({
        1: draw_lane(1, [(0.0, 0.0), (60.0, 0.0)], successors=(2,)), 2: draw_lane(2, bow, successors=(3,)),
        3: draw_lane(3, [(40.0, 30.0), (40.0, -30.0)], successors=(4,)),
        4: draw_lane(4, [(40.0, -30.0), (40.0, -60.0)]),
    })  # fmt: skip
    routes = {n: next(routing.routes_from(looped, n, choose=lambda _, onward: onward, most=1)) for n in looped.lanes}
    assert routes == {1: (1, 2), 2: (2, 3, 4), 3: (3, 4), 4: (4,)}
    assert routing.LanePaths(looped, Limits()).route_beside((), 3) == (2, 3, 4)
    before = {offer.route for n in looped.lanes for offer in Routes(scene_on(looped)).offers(n)}
    assert before == {(1, 2), (2, 3, 4), (3, 4)}


def _shifted(
    own: routing.DrivenPath, target: routing.DrivenPath, *, start_m: float, length_m: float
) -> routing.DrivenPath:
    timing = LateralTiming(lasting_s=4.0, ramp=0.27, slow_mps=5.0)
    begun = routing.LateralMotion(own, target, timing, np.array([start_m]), np.zeros(1))
    motion = begun.foreseen(np.array([length_m / 4.0]), 0.1)
    path = routing.shifted_path(motion, limits=Limits())
    assert path is not None
    return path


def test_shifted_path_changes_its_lane_half_way() -> None:
    """From lane 1 to lane 2 between 60 and 100 m: lane 1 up to 80, lane 2 from there; it ends with lane 2."""
    graph = draw_road()
    own, target = _path(graph, 1), _path(graph, 2)
    path = _shifted(own, target, start_m=60.0, length_m=40.0)
    assert [segment.lane_id for segment in path.segments] == [1, 2]
    assert path.segments[0].end == path.segments[1].start == pytest.approx(80.0, abs=1.0)
    assert path.segments[1].lane_start == pytest.approx(80.0, abs=1.0)
    assert path.segments[1].lane_end == pytest.approx(200.0)
    assert path.lateral_spans == (pytest.approx((60.0, 100.0), abs=1.5),)
    assert path.line.position(np.array([0.0, 80.0, 150.0]))[:, 1] == pytest.approx([0.0, 1.75, 3.5], abs=0.05)
    assert path.exit_m == pytest.approx(200.2, abs=0.2)


def test_steps_to_come_are_foreseen_up_to_the_end_of_the_motion() -> None:
    """4 s: .5 s are over, at 8 m/s; then .2 s at 4 m/s, slower than 5 m/s and so worth .16 s, and at 10 m/s the rest.

    Left: 3.34 s, 34 steps; all in all 4 + 4 * .2 + 34 = 38.8 m.
    """
    graph = draw_road()
    timing = LateralTiming(lasting_s=4.0, ramp=0.27, slow_mps=5.0)
    begun = routing.LateralMotion(
        _path(graph, 1), _path(graph, 2), timing, np.array([60.0, 64.0]), np.array([0.0, 0.125])
    )
    motion = begun.foreseen(np.array([4.0, 4.0, 10.0]), 0.1)
    assert motion.tau[:4] == pytest.approx([0.0, 0.125, 0.145, 0.165])
    assert motion.tau.size == motion.along_m.size == 2 + 2 + 34
    assert motion.tau[-2] < 1.0 <= motion.tau[-1]
    assert motion.along_m[-1] == pytest.approx(60.0 + 4.0 + 0.8 + 34.0)
    assert (motion.share_off(60.0, 0.0), motion.share_off(60.0, 1.0)) == (0.0, 1.0)
    assert (motion.share_off(99.0, 0.0), motion.share_off(99.0, 1.0)) == (1.0, 0.0)


def test_second_shift_leaves_the_first_as_it_is_and_each_lane_is_followed_from_its_beginning_on() -> None:
    """Out at 40 and back at 110 m, as an overtake does; places on lane 1 are those before 40 m or behind 110 m."""
    graph = draw_road()
    right = _path(graph, 1)
    path = _shifted(_shifted(right, _path(graph, 2), start_m=40.0, length_m=30.0), right, start_m=110.0, length_m=30.0)
    assert [segment.lane_id for segment in path.segments] == [1, 2, 1]
    assert len(path.lateral_spans) == 2
    assert path.line.position(np.array([20.0, 90.0, 170.0]))[:, 1] == pytest.approx([0.0, 3.5, 0.0], abs=0.05)
    assert [segment.lane_id for segment in path.followed] == [1, 2, 1]
    assert [segment.end for segment in path.followed[:2]] == pytest.approx([40.0, 110.4], abs=1.0)
    assert path.s_on(1, 30.0, after=25.0) == pytest.approx(30.0, abs=0.01)
    assert path.s_on(2, 60.0, after=42.0) == pytest.approx(60.2, abs=0.2)
    assert path.s_on(1, 130.0, after=112.0) == pytest.approx(130.4, abs=0.3)


def test_first_turn_is_one_that_the_path_makes(forked: LaneGraph) -> None:
    path = _path(forked, 1, 3, 4)
    turn = routing.first_turn(forked, path, TurnType.LEFT, after=10.0)
    assert turn is not None
    assert turn.lane_id == 3
    assert routing.first_turn(forked, path, TurnType.LEFT, after=60.0) is None
    assert routing.first_turn(forked, path, TurnType.RIGHT, after=10.0) is None
    assert (
        routing.first_turn(forked, _path(forked, 3, 4), TurnType.LEFT, after=0.0) is None
    )  # it is on it from the beginning


def test_turn_is_told_by_how_far_the_path_turns_wherever_it_heads() -> None:
    """Down the map, -90 degrees, then to the left along it, 0: it turns by 0 - (-90) = 90 degrees."""
    angle = np.linspace(np.pi, 1.5 * np.pi, 20)
    bend = np.array([15.0, 0.0]) + 15.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    graph = LaneGraph({
        1: draw_lane(1, [(0.0, 50.0), (0.0, 0.0)], successors=(2,)),
        2: draw_lane(2, bend, successors=(3,), is_intersection=True),
        3: draw_lane(3, [bend[-1], bend[-1] + [60.0, 0.0]]),
    })  # fmt: skip
    turn = routing.first_turn(graph, _path(graph, 1, 2, 3), TurnType.LEFT, after=10.0)
    assert turn is not None
    assert turn.lane_id == 2


def test_lane_that_undoes_the_kink_before_it_is_no_turn() -> None:
    """Lane 2 is drawn with a bend of 40 degrees to the left, where lane 1 leads to a kink of 40 degrees to the right:

    -------- 1 -----\\__ 2 ---- 3 --------
    Over the whole, the heading stays as it was.
    """
    dip = np.array([[60.0, 0.0], [62.3, -1.93], [66.0, -1.93]])
    graph = LaneGraph({
        1: draw_lane(1, [(0.0, 0.0), (60.0, 0.0)], successors=(2,)),
        2: draw_lane(2, dip, successors=(3,), is_intersection=True),
        3: draw_lane(3, [dip[-1], dip[-1] + [60.0, 0.0]]),
    })  # fmt: skip
    assert graph.lanes[2].turn is TurnType.LEFT
    assert routing.first_turn(graph, _path(graph, 1, 2, 3), TurnType.LEFT, after=10.0) is None


def test_no_vehicle_drives_along_a_center_turn_lane() -> None:
    """Its line is dashed on its own side, left and right: one of the two alone is the edge of an ordinary lane."""
    dashed = {"left_mark": "DASH_SOLID_YELLOW"}
    graph = LaneGraph({
        1: draw_lane(1, [(0.0, 0.0), (50.0, 0.0)], right_mark="DASH_SOLID_YELLOW", **dashed),
        2: draw_lane(2, [(0.0, -3.5), (50.0, -3.5)], **dashed),
    })  # fmt: skip
    assert [routing.is_drivable(graph, lane_id) for lane_id in (1, 2)] == [False, True]
