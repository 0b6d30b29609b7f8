from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hand_drawn import draw_box, draw_lane, draw_road, draw_track
from inserted import CAR, nobody, scene_on

from hid2.agents import Track
from hid2.drivers.driver import usual_driver
from hid2.motion.route import DrivenPath, Route
from hid2.occupancy.traffic import Traffic
from hid2.params import Config
from hid2.policy.lane_change import OPEN as NO_GAP
from hid2.policy.lane_change import Gap, LaneOption
from hid2.policy.observation import (
    Foreseen,
    Inserted,
    admissible_neighbor,
    gap_to_passed,
    gaps_on,
    lane_options,
    lay_across,
    leader_on,
    target_path,
)
from hid2.reasons import Reason
from hid2.scene import Scene
from netconvert.cells import Cell
from netconvert.lane_graph import LaneGraph

NOBODY = nobody()
#: Lanes 1 and, to its left, 2 go on as lanes 3 and 6 at 100 m.
JOINED = LaneGraph({
    1: draw_lane(1, [(0.0, 0.0), (100.0, 0.0)], left=2, successors=(3,)),
    2: draw_lane(2, [(0.0, 3.5), (100.0, 3.5)], right=1, successors=(6,)),
    3: draw_lane(3, [(100.0, 0.0), (200.0, 0.0)], left=6),
    6: draw_lane(6, [(100.0, 3.5), (200.0, 3.5)], right=3),
})  # fmt: skip


def scene_of(*tracks: Track, graph: LaneGraph | None = None, config: Config | None = None, **shape: Any) -> Scene:
    """A scene on a straight road of 200 m."""
    return scene_on(graph or draw_road(**shape), *tracks, config=config)


def _option(
    scene: Scene, s: float, *, step: int = 0, known: Traffic = NOBODY, driven: Traffic = NOBODY, speed_mps: float = 10.0
) -> LaneOption:
    """What lane 2 offers to a car on lane 1 that wants 10 m/s."""
    path, inserted = scene.paths.along((1,)), Inserted(step, known, driven)
    ((option, _),) = lane_options(
        scene, path, CAR, s=s, sides=("left",), inserted=inserted, speed_mps=speed_mps, desired_mps=10.0
    )
    return option


def _gaps(scene: Scene, *, step: int = 0, known: Traffic = NOBODY, driven: Traffic = NOBODY) -> tuple[Gap, Gap]:
    """Gaps of a car at 80 m of lane 2."""
    return gaps_on(scene, scene.paths.along((2,)), CAR, at=80.0, inserted=Inserted(step, known, driven))


def _drive(x: float, y: float, speed: float, name: str = "t") -> Track:
    return draw_track(range(110), x + 0.1 * speed * np.arange(110), y, track_id=name)


def test_neighbour_across_a_dashed_line_is_admissible() -> None:
    scene = scene_of(lanes=3)
    assert [admissible_neighbor(scene, 2, side) for side in ("left", "right")] == [3, 1]
    assert admissible_neighbor(scene, 3, "left") is None


def test_neighbour_across_a_solid_line_a_bicycle_lane_and_all_without_topology_are_not() -> None:
    bikes = LaneGraph({
        1: draw_lane(1, [(0.0, 0.0), (200.0, 0.0)], left=2),
        2: draw_lane(2, [(0.0, 3.5), (200.0, 3.5)], right=1, lane_type="BIKE"),
    })  # fmt: skip
    unlinked = Config(without=frozenset({"topology"}))
    for scene in (scene_of(mark="SOLID_WHITE"), scene_of(graph=bikes), scene_of(config=unlinked)):
        assert admissible_neighbor(scene, 1, "left") is None


def test_option_is_the_facing_cell_with_what_is_left_of_its_lane() -> None:
    """At 41 m of lane 1: cell 10 of lane 2, 159 m before its end, nobody there."""
    scene = scene_of()
    ((option, target),) = lane_options(
        scene, scene.paths.along((1,)), CAR, s=41.0, sides=("left", "right"), inserted=Inserted(0, NOBODY, NOBODY),
        speed_mps=10.0, desired_mps=10.0,
    )  # fmt: skip
    assert (option.side, option.target, option.cells_free) == ("left", Cell(2, 10), True)
    assert option.front == option.rear == NO_GAP
    assert option.remaining_m == option.corridor_m == pytest.approx(159.0, abs=0.1)
    assert [segment.lane_id for segment in target.segments] == [2]


def test_cell_that_is_taken_when_the_vehicle_gets_there_rejects_the_transition() -> None:
    """Conflict case 1, at the predicted time: at 10 m/s the next cell is reached after ceil(4 / 10 / 0.1) = 4 steps.

    Somebody appears on cell 11 of lane 2 (44 to 48 m) at step 4, far enough from cells 9 to 11 at step 0.
    """
    scene = scene_of(draw_track(range(4, 60), np.full(56, 46.0), 3.5))

    free = [
        _option(scene, 41.0, speed_mps=speed_mps, step=step).cells_free
        for speed_mps, step in ((10.0, 0), (20.0, 0), (0.0, 0), (0.0, 4))
    ]
    assert free == [False, True, True, False]  # at 20 m/s the cell is still free two steps on


def test_gaps_are_bumper_to_bumper_with_the_neighbours_speeds() -> None:
    """Own centre at 80 on the target lane; centres at 60 (9 m/s) and 110 (12 m/s), all 4.5 m long.

    [60]          (80)               [110]
        |<-15.5->|    |<---25.5---->|           20 - 4.5 and 30 - 4.5, to half a metre
    """
    scene = scene_of(_drive(60.0, 3.5, 9.0, "rear"), _drive(110.0, 3.5, 12.0, "front"))
    front, rear = _gaps(scene)
    assert front.distance_m == pytest.approx(25.5, abs=0.6)
    assert rear.distance_m == pytest.approx(15.5, abs=0.6)
    assert (front.speed_mps, rear.speed_mps) == pytest.approx((12.0, 9.0))
    front, rear = _gaps(scene, step=50)  # the one from 60 m is at 105 m
    assert (front.distance_m, rear) == (pytest.approx(20.5, abs=0.6), NO_GAP)


def test_kept_and_driven_vehicles_count_like_recorded_ones() -> None:
    """One kept in a round before drives at 5 m/s from 90 m on and is at 110 after 4 s; the fleet is as it is now."""
    known, driven = draw_box(90.0, 3.5, 0.0, 5.0), draw_box(50.0, 3.5, 0.0, 7.0, steps=1)
    front, rear = _gaps(scene_of(), step=40, known=known, driven=driven)
    assert front.distance_m == pytest.approx(25.5, abs=0.6)
    assert rear.distance_m == pytest.approx(25.5, abs=0.6)
    assert (front.speed_mps, rear.speed_mps) == pytest.approx((5.0, 7.0))


@pytest.mark.parametrize(("speed", "corridor"), [(5.0, 24.5), (10.0, 120.0), (12.0, 120.0)])
def test_free_corridor_ends_at_who_is_slower_than_desired(speed: float, corridor: float) -> None:
    """At 80 m of 200, somebody at 109 m ahead on the lane beside: bumper gap 24.5 m; who drives 10 m/s leaves it."""
    option = _option(scene_of(), 80.0, known=draw_box(109.0, 3.5, 0.0, speed))
    assert option.corridor_m == pytest.approx(corridor, abs=0.6)


def test_free_corridor_ends_at_a_slow_vehicle_ahead_of_a_faster_one() -> None:
    """Of boxes at 95 m (12 m/s) and 109 m (5 m/s) the nearer one leaves the corridor; the other ends it at 24.5 m."""
    scene = scene_of(_drive(95.0, 3.5, 12.0, "fast"))
    option = _option(scene, 80.0, known=draw_box(109.0, 3.5, 0.0, 5.0))
    assert option.front.speed_mps == pytest.approx(12.0)
    assert option.corridor_m == pytest.approx(24.5, abs=0.6)


@pytest.mark.parametrize("who", ["recorded", "kept", "driven"])
def test_vehicles_hold_the_cells_beside_and_next_to_it_where_they_are_now(who: str) -> None:
    """Of one recorded (sigma = 1), and of one driven or kept in a round before (2), cells 9 to 11, 36 .. 48 m.

    A car at 32 m ends at 34.25, at 37.5 and 46.5 m it is on 9 and 11 alone of these, at 52 m it begins at 49.75.
    """

    def is_free(x: float) -> bool:
        scene = scene_of(*([draw_track(range(110), np.full(110, x), 3.5)] if who == "recorded" else []))
        known = draw_box(x, 3.5) if who == "kept" else NOBODY
        driven = draw_box(x, 3.5, steps=1) if who == "driven" else NOBODY
        return _option(scene, 42.0, step=70, known=known, driven=driven).cells_free

    assert [is_free(x) for x in (32.0, 37.5, 46.5, 52.0)] == [True, False, False, True]


def test_target_path_reaches_back_to_who_comes_from_behind() -> None:
    """Lane 4 leads into lane 2: a follower there is a follower of who changes to the start of lane 2."""
    graph = LaneGraph({
        1: draw_lane(1, [(0.0, 0.0), (100.0, 0.0)], left=2),
        2: draw_lane(2, [(0.0, 3.5), (100.0, 3.5)], right=1),
        4: draw_lane(4, [(-60.0, 3.5), (0.0, 3.5)], successors=(2,)),
    })  # fmt: skip
    scene = scene_of(graph=graph)
    assert [segment.lane_id for segment in target_path(scene, scene.paths.along((1,)), 2, s=5.0).segments] == [4, 2]


def test_target_path_goes_on_beside_the_own_route() -> None:
    """Lane 2 splits into 5, which leaves, and 6, which runs on beside lane 3 of the own route."""
    split = replace(JOINED.lanes[2], successors=(5, 6)), draw_lane(5, [(100.0, 3.5), (200.0, 40.0)])
    scene = scene_of(graph=LaneGraph({**JOINED.lanes, 2: split[0], 5: split[1]}))
    assert [segment.lane_id for segment in target_path(scene, scene.paths.along((1, 3)), 2, s=5.0).segments] == [2, 6]


@pytest.mark.parametrize(("s", "x", "first", "free"), [
    (98.0, 102.3, 0, False), (98.0, 102.3, 4, False), (98.0, 107.0, 0, True), (102.0, 97.7, 0, False),
])  # fmt: skip
def test_cells_are_looked_at_over_the_ends_of_their_lanes(s: float, x: float, first: int, *, free: bool) -> None:
    """From step `first` on a box of 4.5 m stands on lane 2 or 6, at x."""
    scene = scene_of(draw_track(range(first, 60), np.full(60 - first, x), 3.5), graph=JOINED)
    ((option, _),) = lane_options(
        scene, scene.paths.along((1, 3)), CAR, s=s, sides=("left",), inserted=Inserted(0, NOBODY, NOBODY),
        speed_mps=10.0, desired_mps=10.0,
    )  # fmt: skip
    assert option.cells_free is free


def test_leader_is_the_next_one_on_the_path_within_d_obs(straight_path: DrivenPath) -> None:
    """At 50 and 70 m on the own lane, at 45 m on the next lane; own centre at 30: the one at 50, gap 20 - 4.5 m.

    None leads from behind, far beyond d_obs, or across.
    """
    vehicles = (
        draw_box(70.0, 0.0, name="far")
        .joined(draw_box(50.0, 0.0, 0.0, 6.0, name="near"))
        .joined(draw_box(45.0, 3.5, name="x"))
    )
    leader = leader_on(straight_path, CAR, s=30.0, d_obs_m=40.0, here=vehicles.at(0))
    assert leader is not None
    assert leader.track_id == "near"
    assert leader.distance_m == pytest.approx(15.5, abs=0.6)
    assert leader.speed_mps == pytest.approx(6.0)
    for other in (draw_box(10.0, 0.0), draw_box(90.0, 0.0), draw_box(50.0, 0.0, np.pi / 2)):
        assert leader_on(straight_path, CAR, s=30.0, d_obs_m=40.0, here=other.at(0)) is None


def test_gap_to_a_passed_vehicle_is_one_behind_on_the_same_lane_or_beyond_the_map(straight_path: DrivenPath) -> None:
    """From s = 50 m on at 10 m/s. One stands at 51, ahead; two steps later it is 3.5 m short of clear, ten later
    9 - 4.5 = 4.5 m behind. One that turned off is never passed, one that has left the map for good.
    """

    def gap_to(passed: Traffic, step: int) -> float:
        return gap_to_passed(straight_path, CAR, s=50.0 + step, lane=straight_path, passed_id="p", here=passed.at(step))

    stands = draw_box(51.0, 0.0, name="p")
    assert [gap_to(stands, step) for step in (0, 2, 10)] == pytest.approx([-np.inf, -3.5, 4.5], abs=0.01)
    assert gap_to(draw_box(50.0, 3.5, name="p"), 10) == -np.inf
    until = np.arange(stands.num_steps)[None, :] <= 3
    assert gap_to(replace(stands, present=stands.present & until), 20) == np.inf


def _across(
    scene: Scene, own: Route = (1,), other: Route = (2,), *, s: float = 40.0, remaining_m: float = 160.0
) -> DrivenPath | Reason:
    """From 40 m on at 10 m/s within 4 s to the left."""
    begin, driver = Foreseen(scene.paths.along(own), s, 10, np.array([10.0])), usual_driver(10.0)
    target, driver = scene.paths.along(other), replace(driver, lane_change_s=4.0)
    return lay_across(scene, begin, target, side="left", remaining_m=remaining_m, driver=driver)


def test_path_across_ends_in_the_middle_of_the_other_lane() -> None:
    path = _across(scene_of())
    assert isinstance(path, DrivenPath)
    ((start, end),) = path.lateral_spans
    assert start == pytest.approx(40.0, abs=1.01)  # it begins at a point of the path, 1 m apart
    assert (end - start) / 10.0 == pytest.approx(4.0, abs=0.15)
    assert path.line.position(np.array([end + 1.0]))[0, 1] == pytest.approx(3.5, abs=0.05)


@pytest.mark.parametrize(("joint", "is_laid"), [(55.0, False), (65.0, True)])
def test_no_path_across_a_line_that_is_solid_where_it_is_crossed(joint: float, is_laid: bool) -> None:
    """From 40 m on at 10 m/s in 4 s: half way across at 60 m."""
    graph = LaneGraph({
        1: draw_lane(1, [(0.0, 0.0), (joint, 0.0)], left=2, successors=(3,)),
        2: draw_lane(2, [(0.0, 3.5), (joint, 3.5)], right=1, successors=(4,)),
        3: draw_lane(3, [(joint, 0.0), (200.0, 0.0)], left=4, left_mark="SOLID_WHITE"),
        4: draw_lane(4, [(joint, 3.5), (200.0, 3.5)], right=3, right_mark="SOLID_WHITE"),
    })  # fmt: skip
    path = _across(scene_of(graph=graph), (1, 3), (2, 4))
    assert isinstance(path, DrivenPath) is is_laid
    assert is_laid or path is Reason.SOLID_LINE


def test_no_path_across_to_a_lane_that_ends() -> None:
    short = {1: draw_lane(1, [(0.0, 0.0), (200.0, 0.0)], left=2), 2: draw_lane(2, [(0.0, 3.5), (60.0, 3.5)], right=1)}
    assert isinstance(_across(scene_of(graph=LaneGraph(short)), s=50.0, remaining_m=10.0), Reason)
