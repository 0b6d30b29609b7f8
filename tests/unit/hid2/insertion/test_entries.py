"""Who enters at the map's edge: at which lanes and steps, where, how fast, and with room to whom."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from hand_drawn import draw_box, draw_lane, draw_road, graph_of
from inserted import recorded, scene_on, sites_of, start_on

from hid2.agents import Policy, Track
from hid2.insertion.entry_sites import entry_speed
from hid2.insertion.filling import Filling
from hid2.insertion.flow import arrivals, edge_lanes
from hid2.insertion.surroundings import Surroundings
from hid2.params import Config, Flow, Request, Spawn
from hid2.scene import Scene
from hid2.vehicle import Start, VehicleRequest
from netconvert.lane_graph import LaneGraph

STRAIGHT = VehicleRequest(0, Policy.STRAIGHT, 0.0)


def _scene(graph: LaneGraph, *tracks: Track, **request: object) -> Scene:
    asked = {"entering": 1.0, "near": "anywhere"} | request
    return scene_on(graph, *tracks, config=Config(request=Request(**asked), spawn=Spawn(prior_speed_mps=9.0)))


def _entering(scene: Scene, *, count: int = 20, seed: int = 0) -> list[Start]:
    return list(islice(sites_of(scene, seed).entering.starts_of(STRAIGHT, [], frozenset()), count))


def _pocket() -> LaneGraph:
    """Lane 1 from x = 0 to 100, then 2; 3 begins beside 2 (a turn pocket); 4 begins alone in the middle of it all."""
    return graph_of(
        draw_lane(1, [(0.0, 0.0), (100.0, 0.0)], successors=(2,)),
        draw_lane(2, [(100.0, 0.0), (300.0, 0.0)], left=3), draw_lane(3, [(100.0, 3.5), (300.0, 3.5)], right=2),
        draw_lane(4, [(150.0, -20.0), (300.0, -20.0)]), draw_lane(5, [(300.0, -50.0), (0.0, -50.0)]),
        ground=[(-20.0, -60.0), (320.0, -60.0), (320.0, 60.0), (-20.0, 60.0)],
    )  # fmt: skip


def test_turn_pockets_and_driveways_are_no_edge() -> None:
    """The hull reaches from y = -50 to 3.5: lane 4 begins 20 m inside it, lane 3 beside one that goes on before."""
    scene = scene_on(_pocket(), config=Config(flow=Flow(veh_per_h_lane=2000.0)))
    routes = Surroundings(scene).routes
    assert edge_lanes(scene, routes) == sorted({one.lane_id for one in arrivals(scene, routes, (0,))}) == [1, 5]


def test_entries_are_at_observed_steps_after_the_first_with_three_seconds_left() -> None:
    """Of a scene with 50 steps, all of them observed, in steps 1 to 20."""
    entries = Surroundings(_scene(draw_road(length_m=300.0))).entries
    table = entries.table
    assert sorted({one.step for one in table}) == list(range(5, 50, 5))
    assert {one.offer.route[0] for one in table} == {1, 2}
    assert (entries.outlook.weight > 0.0).all()
    short = replace(_scene(draw_road(length_m=300.0)), num_steps=50)
    assert sorted({one.step for one in Surroundings(short).entries.table}) == [5, 10, 15, 20]


def test_entries_from_which_nobody_is_met_have_no_weight() -> None:
    """One at 9 m/s on lane 1, 25 m ahead at step 5 and 47 m at step 30, where .7 * 30 m are near."""
    met, alone = (
        Surroundings(_scene(draw_road(length_m=300.0), *tracks, near="traffic")).entries
        for tracks in ((recorded(20.0, 0.0, 9.0),), ())
    )
    step = np.array([one.step for one in met.table])
    first = (step == 5) & np.array([one.offer.route[0] == 1 for one in met.table])
    assert met.outlook.weight[first].min() > 0.0
    assert met.outlook.weight[step >= 30].max() == 0.0
    assert (met.outlook.leader[first] >= 0).all()
    assert alone.outlook.weight.max() == 0.0


def test_who_enters_is_just_inside_the_map_at_the_speed_of_its_traffic() -> None:
    """Rear bumpers 0.5 m from the edge and what is driven in a step, 0.9 m; speeds about 9 m/s."""
    starts = _entering(_scene(draw_road(length_m=300.0)))
    assert len(starts) > 10
    assert {start.step for start in starts} <= set(range(5, 50))
    assert len({start.step for start in starts}) > 5
    rear = np.array([start.start_m - 0.5 * start.box.length_m for start in starts])
    assert rear.min() >= 0.5 - 1e-6
    assert rear.max() <= 0.5 + 0.9 + 1e-6
    assert min(start.start_mps for start in starts) > 5.0
    assert max(start.start_mps for start in starts) < 14.0
    assert all(start.desired.shape == (110,) and start.desired[start.step] >= start.start_mps for start in starts)


def test_room_is_kept_to_who_is_at_the_edge_at_that_very_step() -> None:
    """One stands at x = 10 on lane 1 from the first step on; another one on lane 2 has left the edge at 9 m/s.

    Where vehicles stand at x = 5 on both lanes one begins elsewhere.
    """
    scene = _scene(draw_road(length_m=300.0), recorded(10.0, 0.0, 0.0), recorded(3.0, 3.5, 9.0, name="q"))
    starts = _entering(scene)
    assert {start.route[0] for start in starts} == {2}
    gaps = [3.0 + 0.9 * start.step - start.start_m - 4.5 for start in starts]
    assert min(gaps) > 2.0
    scene = _scene(draw_road(length_m=300.0), recorded(5.0, 0.0), recorded(5.0, 3.5, name="q"))
    assert [start.step for start in sites_of(scene).propose(STRAIGHT)] == [0]


def test_nobody_enters_before_who_comes_from_outside_the_map() -> None:
    """At 14 m/s from x = -60 on: the edge is passed at step 43; until then it closes in, from 1.5 s before too fast."""
    scene = _scene(draw_road(lanes=1, length_m=300.0), recorded(-60.0, 0.0, 14.0))
    for start in _entering(scene):
        gap_m = start.start_m - 0.5 * 4.5 - (-60.0 + 1.4 * start.step + 0.5 * 4.5)
        assert gap_m < 0.0 or gap_m > max(2.0, 1.5 * (14.0 - start.start_mps))


@pytest.mark.parametrize(
    ("request_", "policy"),
    [({"entering": 0.0}, Policy.STRAIGHT), ({"generated_category": 2}, Policy.STRAIGHT), ({}, Policy.LANE_CHANGE)],
)
def test_who_is_scored_or_changes_lanes_is_there_from_the_first_step(
    request_: dict[str, object], policy: Policy
) -> None:
    scene = _scene(draw_road(length_m=300.0), **request_)
    starts = sites_of(scene).propose(VehicleRequest(0, policy, 1.0))
    assert [start.step for start in starts] == [0]


def test_two_that_enter_on_one_lane_keep_their_distance() -> None:
    """At 9 m/s, at most 11.4: of two on one lane the later one leaves 2 m, the first one drives 6.5 m in 6 steps."""
    sites = sites_of(_scene(draw_road(lanes=1, length_m=300.0)))
    starts = [start for k in range(6) for start in sites.propose(VehicleRequest(k, Policy.STRAIGHT, 0.0))]
    steps = sorted(start.step for start in starts if start.step > 0)
    assert len(steps) >= 2
    assert np.diff(steps).min() >= 6


@pytest.mark.parametrize(
    ("x", "speed", "y", "found"),
    [
        (60.0, 10.0, 0.0, 10.0),
        (8.0, 10.0, 0.0, None),  # bumper to bumper 0.5 m
        (8.0, 10.0, 3.5, 10.0),
        (-10.0, 10.0, 0.0, None),  # 8.5 m behind: less than 1 s
        (-15.0, 10.0, 0.0, 10.0),
        (16.0, 5.0, 0.0, pytest.approx(6.5, abs=2.5)),  # 8.5 m behind a slower one
    ],
)
def test_room_at_the_edge_among_those_that_are_driven(x: float, speed: float, y: float, found: float | None) -> None:
    """Enters with its centre at x = 3 at 10 m/s."""
    scene = _scene(draw_road(length_m=300.0))
    start = start_on(scene, (1,), 3.0, 10.0, step=20)
    fleet = draw_box(x - 0.1 * speed, y, 0.0, speed, steps=1)  # where it was a step before
    assert entry_speed(start, fleet, scene.config, step_s=0.1) == found


def test_share_of_those_that_go_straight_enters() -> None:
    """A share of .5 of four on each of 20 seeds: 40 of 80, give or take three standard deviations (4.5)."""
    others = {"left_turn": 0.0, "right_turn": 0.0, "lane_change": 0.0, "overtake": 0.0}
    scene = _scene(draw_road(lanes=3, length_m=500.0), agents=4, straight=1.0, entering=0.5, **others)
    here = Surroundings(scene)
    late = [start.step > 0 for seed in range(20) for start in Filling(here, [seed, 0, 1]).first_starts(4)]
    assert len(late) == 80
    assert 27 <= sum(late) <= 53
