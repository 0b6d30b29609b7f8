"""The guard: conflict cases 1 to 3, from what the simulation shows at one step."""

from typing import Any

import numpy as np
import pytest
from hand_drawn import draw_lane, draw_road
from inserted import CAR, DRIVER, nobody, recorded, scene_on

from hid2.agents import BoxSize, Track
from hid2.conflicts.guard import Braking, Guard, OwnMotion, transition_rejected
from hid2.conflicts.stop_lines import StopLines
from hid2.kernels.guard import needed_braking
from hid2.occupancy.sigma import FREE, GENERATED, ORIGINAL
from hid2.params import Config, Conflict
from hid2.scene import Scene
from netconvert.lane_graph import LaneGraph

#: Every value that a number below is worked from; the defaults may be tuned.
CONFIG = Config(conflict=Conflict(horizon_s=4.0, brake_max_mps2=3.5, margin_lateral_m=0.1))
UP = np.pi / 2


def look(*tracks: Track, s: float = 40.0, v: float = 10.0, step: int = 0) -> Braking:
    """What a vehicle on lane 1 (y = 0) has to do."""
    scene = scene_on(draw_road(), *tracks, config=CONFIG)
    return _braking(scene, 1, [(s, v, 0.0, 0.0)], step=step)


def _braking(
    scene: Scene, lane_id: int, fleet: list[tuple[float, float, float, float]], *, own: int = 0, step: int = 0,
    lanes: tuple[int, ...] = (),
) -> Braking:  # fmt: skip
    """fleet: s, v, a, executing of everybody driven, whose lanes are `lanes` (lane_id for all where it is empty)."""
    guard = Guard(scene, nobody(), StopLines(scene))
    path = scene.paths.along((lane_id,))
    paths = [scene.paths.along((lane,)) for lane in lanes or (lane_id,) * len(fleet)]
    others = [(row, paths[row], CAR) for row in range(len(fleet)) if row != own]
    state = np.array([[*one, 1.0] for one in fleet])
    going = OwnMotion(fleet[own][:3], 10.0, np.full(path.line.table_xy.shape[0], np.inf), DRIVER)
    return guard.braking(guard.obstacles(path, CAR, others), going, step, state, own=own, horizon_s=None)


def test_case_1_cell_held_by_an_original_agent_rejects_the_transition() -> None:
    assert [transition_rejected(sigma) for sigma in (ORIGINAL, FREE, GENERATED)] == [True, False, False]


@pytest.mark.parametrize(("margin_m", "is_met"), [(1.5, False), (1.7, True)])
def test_margin_widens_a_box_on_each_side_against_those_driven_with_it(margin_m: float, is_met: bool) -> None:
    """Lanes 3.5 m apart, boxes of 1.9 m: 1.6 m between them."""
    scene = scene_on(draw_road(), config=Config(conflict=Conflict(margin_lateral_m=margin_m)))
    guard = Guard(scene, nobody(), StopLines(scene))
    assert (guard.obstacles(scene.paths.along((1,)), CAR, [(1, scene.paths.along((2,)), CAR)]).rows.size > 0) is is_met


def test_nobody_brakes_on_a_free_road_or_who_stands_close_behind_a_leader_in_sight() -> None:
    """1 m behind, half the jam gap: it stays where it is by itself."""
    for found in (*(look(v=v) for v in (0.0, 5.0, 12.0)), look(recorded(45.5, 0.0), v=0.0)):
        assert (found.decel_mps2, found.conflict_s, found.run_into) == (0.0, None, False)


@pytest.mark.parametrize(
    "other",
    [
        recorded(45.0, 3.5, 10.0),
        recorded(90.0, 3.5, 10.0, heading=np.pi),
        recorded(70.0, 6.0, 8.0, heading=UP),
        recorded(70.0, -60.0, 8.0, heading=UP),
        recorded(75.0, 0.0, 8.0),
    ],
    ids=["beside", "oncoming on the next lane", "has crossed by then", "crosses later", "leads 30 m ahead at 8 m/s"],
)
def test_nobody_brakes_for_who_is_no_conflict(other: Track) -> None:
    """A crossing is taken for 1.1 s before and after (PET): these are there 3 s earlier or later. Car following copes
    with the leader.
    """
    assert look(other).decel_mps2 == 0.0


def test_timing_is_adjusted_to_a_crossing_whose_recorded_future_meets() -> None:
    """At 10 m/s the vehicle is at x = 70 in 3 s; so is somebody who crosses from y = -24 at 8 m/s.

    Braking so that x stays below 70 - 3.2 - .5 (bumper, half a width, margin) = 66.3 until it has passed.
    """
    found = look(recorded(70.0, -24.0, 8.0, heading=UP))
    assert 0.5 <= found.decel_mps2 <= 3.5
    assert found.conflict_s is None
    assert not found.run_into


def test_nobody_stops_on_an_open_road_for_who_appears_5_s_later() -> None:
    """A car stands at x = 90, on the way, and has a state only from step 50 on; H is 4 s: looked at when it is near."""
    later = recorded(90.0, 0.0, heading=UP, first=50)
    assert look(later).decel_mps2 == 0.0
    assert look(later, s=60.0, step=30).decel_mps2 > 0.0


def test_standing_obstacle_that_sumo_does_not_see_is_braked_for() -> None:
    """A car crosswise at x = 75 takes 71.8 to 78.2 of the centre's way, from a sample of 0.5 m and a margin of 0.5 m
    before: about 31 m from s = 40. Within H = 4 s, 10 m/s less b come 40 - 8 b m (and 1 m or so until b is reached):
    b = 1.1 comes too far, 1.5 or 2 do.

    16 m before it 3.2 m/s2 would be needed at once, and braking builds up: a conflict remains.
    """
    found = look(recorded(75.0, 0.0, heading=UP))
    assert found.decel_mps2 in (1.5, 2.0)
    assert found.conflict_s is None
    found = look(recorded(60.0, 0.0, heading=UP))
    assert found.conflict_s is not None
    assert found.decel_mps2 >= 2.5


@pytest.mark.parametrize(("most_mps2", "tried"), [(1.1, 1.1), (3.4, 3.4), (3.5, 3.5), (4.05, 4.05)])
def test_hardest_braking_is_the_one_asked_for(most_mps2: float, tried: float) -> None:
    config = Config(conflict=Conflict(brake_max_mps2=most_mps2))
    assert Guard(scene_on(draw_road(), config=config), nobody(), None).brakes[-1] == tried  # type: ignore[arg-type]


@pytest.mark.parametrize(("first", "brakes"), [(0, False), (10, True)], ids=["in sight", "appears in 1 s"])
def test_leader_in_sight_is_left_to_sumo_up_to_the_hardest_braking(first: int, brakes: bool) -> None:
    """A car stands 23 m ahead, for which IDM asks 3.2 m/s2: more than 1.4 b = 2.8, less than 3.5 m/s2.

    SUMO sees it and brakes by itself; of who is not there yet it knows nothing.
    """
    assert (look(recorded(67.5, 0.0, first=first)).decel_mps2 > 0.0) is brakes


def test_who_follows_is_ignored_but_told_of() -> None:
    """Recorded, from 20 m at 14 m/s: it reaches 40 + 10 t - 4.5 after 3.9 s. Braking would make it worse."""
    found = look(recorded(20.0, 0.0, 14.0))
    assert found.decel_mps2 == 0.0
    assert found.run_into
    assert not look(recorded(20.0, 0.0, 10.0)).run_into  # it keeps its distance


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """Answers of the kernel, as `speed_limits` has them: row, conflicts, leader with its gap, whether run into."""
    answers: list[tuple[Any, ...]] = []

    def told_of(*asked: Any) -> tuple[Any, ...]:
        answers.append(needed_braking(*asked))
        return answers[-1]

    monkeypatch.setattr("hid2.conflicts.guard.needed_braking", told_of)
    return answers


def test_generated_leader_is_named_with_its_gap_and_a_follower_left_to_its_driver(told: list[tuple[Any, ...]]) -> None:
    """At 60 m, own centre at 40: bumper gap 20 - 4.5 = 15.5 m."""
    scene = scene_on(draw_road(), config=CONFIG)
    _braking(scene, 1, [(40.0, 10.0, 0.0, 0.0), (60.0, 10.0, 0.0, 0.0)])
    assert told[0][3:5] == (1, pytest.approx(15.5, abs=1.1))
    assert _braking(scene, 1, [(40.0, 10.0, 0.0, 0.0), (28.0, 14.0, 0.0, 0.0)]).decel_mps2 == 0.0
    assert told[1][3] == -1


@pytest.fixture
def cross() -> Scene:
    """Lane 1 along the x axis, lane 2 along x = 80: both meet at s = 80 m."""
    graph = LaneGraph({1: draw_lane(1, [(0.0, 0.0), (200.0, 0.0)]), 2: draw_lane(2, [(80.0, -80.0), (80.0, 120.0)])})
    return scene_on(graph, config=CONFIG)


@pytest.mark.parametrize(
    ("own", "other", "brakes"),
    [
        ((40.0, 10.0, 0.0, 0.0), (30.0, 12.5, 0.0, 1.0), True),
        ((40.0, 10.0, 0.0, 1.0), (50.0, 7.5, 0.0, 0.0), False),
        ((40.0, 10.0, 0.0, 0.0), (50.0, 7.5, 0.0, 0.0), True),
        ((40.0, 10.0, 0.0, 0.0), (30.0, 12.5, 0.0, 0.0), False),
        ((40.0, 10.0, 0.0, 1.0), (30.0, 12.5, 0.0, 1.0), False),
    ],
    ids=["executing before pending", "pending after executing", "closer first", "farther last", "both executing"],
)
def test_case_2_of_two_who_are_there_in_4_s(cross: Scene, own: Any, other: Any, brakes: bool) -> None:
    """From 40 m at 10, from 30 m at 12.5 or from 50 m at 7.5 m/s: all are at the crossing (80 m) after 4 s.

    Distances to it are metres, not cells or ids.
    """
    found = _braking(cross, 1, [own, other], lanes=(1, 2))
    assert (found.decel_mps2 > 0.0) is brakes


def test_case_2_equally_far_on_the_crossing_already_and_where_braking_does_not_avoid_it(cross: Scene) -> None:
    """Equally far the lower id goes first. One rolls at 1 m/s with its box across lane 1, and the own one is executing:
    no right to run into it. 10 m before the crossing at 9 m/s, and the other one 8 m: they meet, the slower the better.
    """
    alike = [(42.0, 10.0, 0.0, 0.0), (42.0, 10.0, 0.0, 0.0)]
    assert _braking(cross, 1, alike, lanes=(1, 2), own=0).decel_mps2 == 0.0
    assert _braking(cross, 2, alike, lanes=(1, 2), own=1).decel_mps2 > 0.0
    assert _braking(cross, 1, [(60.0, 10.0, 0.0, 1.0), (80.0, 1.0, 0.0, 0.0)], lanes=(1, 2)).decel_mps2 > 0.0
    found = _braking(cross, 1, [(70.0, 9.0, 0.0, 0.0), (72.0, 9.0, 0.0, 1.0)], lanes=(1, 2))
    assert found.conflict_s is not None
    assert found.decel_mps2 == 3.5


def _cross_at(degrees: float) -> Scene:
    """Lane 1 along the x axis, lane 2 at an angle to it: both meet at s = 80 m."""
    x, y = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    across = draw_lane(2, [(80.0 - 80.0 * x, -80.0 * y), (80.0 + 120.0 * x, 120.0 * y)])
    return scene_on(LaneGraph({1: draw_lane(1, [(0.0, 0.0), (200.0, 0.0)]), 2: across}), config=CONFIG)


@pytest.mark.parametrize("degrees", [20.0, 30.0, 45.0, 60.0, 90.0, 120.0, 150.0])
def test_case_2_one_of_two_yields_however_the_paths_cross(degrees: float) -> None:
    """Both at 10 m/s, about 30 m before the crossing, up to half a meter apart: they would meet there."""
    cross = _cross_at(degrees)
    for other_m in np.arange(50.0, 51.01, 0.125).tolist():
        fleet = [(50.5, 10.0, 0.0, 0.0), (other_m, 10.0, 0.0, 0.0)]
        brakes = [_braking(cross, 1 + own, fleet, lanes=(1, 2), own=own).decel_mps2 > 0.0 for own in range(2)]
        assert sum(brakes) == 1, other_m


def test_case_2_the_faster_one_that_comes_first_by_time_goes_first_though_it_is_farther() -> None:
    """35 m before the crossing at 12 m/s, 2.9 s, and 26 m at 8 m/s, 3.3 s: it would be the nearer one on the way."""
    cross = _cross_at(90.0)
    fleet = [(45.0, 12.0, 0.0, 0.0), (54.0, 8.0, 0.0, 0.0)]
    brakes = [_braking(cross, 1 + own, fleet, lanes=(1, 2), own=own).decel_mps2 for own in range(2)]
    assert brakes[0] == 0.0
    assert brakes[1] > 0.0


def test_who_yields_brakes_where_the_other_one_would_be_beside_it_and_a_little_behind() -> None:
    """At 30 degrees: after 2.5 s the own one is at the crossing, and the other, which executes, 4 m before it."""
    found = _braking(_cross_at(30.0), 1, [(55.0, 10.0, 0.0, 0.0), (56.0, 8.0, 0.0, 1.0)], lanes=(1, 2))
    assert found.decel_mps2 > 0.0


def test_larger_box_needs_more_room() -> None:
    """Beside a pedestrian at y = -1.5 m a car of 1.9 m passes; a bus of 2.9 m (with 0.1 m beside it) does not."""
    scene = scene_on(draw_road(), recorded(70.0, -1.5, kind="pedestrian", size=BoxSize(0.6, 0.6)), config=CONFIG)
    guard = Guard(scene, nobody(), StopLines(scene))
    path = scene.paths.along((1,))
    widths = [guard.obstacles(path, BoxSize(10.0, width), []).known.low.shape[0] for width in (1.9, 2.9)]
    assert widths == [0, 1]
