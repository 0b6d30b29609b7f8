"""Starts: whether a vehicle can begin at a site, how fast, and what a rollout says of it."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hand_drawn import draw_crossing, draw_lane, draw_road, graph_of
from inserted import CAR, DRIVER, ROAD_M, left_turn_scene, recorded, request_of, road_scene, scene_on, sites_of

from hid2.agents import Policy
from hid2.conflicts.stop_lines import ClosedLines, StopLines
from hid2.insertion.rollout import World
from hid2.insertion.starts import Site, speed_behind
from hid2.insertion.surroundings import Surroundings
from hid2.motion.route import LateralSpan
from hid2.params import Config, Spawn
from hid2.reasons import Reason
from hid2.vehicle import Start


def test_three_in_ten_begin_while_they_gain_speed() -> None:
    """On a free road, at least .3 of the desired speed; others differ from it by 2 SD of 1.2 m/s at most."""
    sites = sites_of(road_scene(lanes=1))
    site = Site(sites.here.routes.offers(1)[0], 50.0)
    starts = [one for _ in range(300) if isinstance(one := sites.starts.make(request_of(), site), Start)]
    below = np.array([start.driver.desired_mps - start.start_mps for start in starts])
    assert (below > 2.4).mean() == pytest.approx(0.3 * (6.0 - 2.0) / (6.0 - 1.0), abs=0.06)
    assert below.min() >= -2.4 - 1e-9
    assert min(start.start_mps / start.driver.desired_mps for start in starts) >= 0.3 - 1e-9


def test_start_that_harms_a_recorded_follower_later_is_refused_with_the_harm(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(World, "harm_to_followers", lambda *_: Reason.FOLLOWER_BRAKING)
    sites = sites_of(road_scene(lanes=1))
    site = Site(sites.here.routes.offers(1)[0], 100.0)
    assert sites.starts.make(request_of(), site, driver=DRIVER) is Reason.FOLLOWER_BRAKING


@pytest.mark.parametrize(("gap", "leader_mps"), [(6.0, 0.0), (15.0, 8.0), (30.0, 4.0), (60.0, 12.0)])
def test_start_speed_behind_a_leader_needs_no_braking(gap: float, leader_mps: float) -> None:
    """IDM at that speed and gap: a (1 - (s* / gap)^2) is -0.3 m/s2, a lifted foot; also behind a faster one."""
    v = speed_behind(gap, leader_mps, DRIVER.following)
    star = DRIVER.min_gap_m + v * DRIVER.tau_s + v * (v - leader_mps) / (2 * np.sqrt(1.6 * 2.0))
    assert DRIVER.accel_mps2 * (1.0 - (star / gap) ** 2) == pytest.approx(-0.3, abs=1e-6)
    assert speed_behind(1.5, 0.0, DRIVER.following) == 0.0  # less than the 2 m kept to a standing one


@pytest.mark.parametrize(
    ("gap_m", "other_mps", "begins"), [(2.5, 14.0, False), (8.0, 14.0, True), (-4.0, 4.0, False), (-12.0, 4.0, True)]
)
def test_none_begins_where_its_leader_or_follower_has_just_been(gap_m: float, other_mps: float, begins: bool) -> None:
    """Behind one at 14 m/s, 2.5 m of gap are as much as .2 s ago there was none; 8 m allow 10.7 m/s at the start.

    Ahead of one at 4 m/s a vehicle at some 10 m/s was inside it .7 s ago if there are 4 m between them, not 12.
    """
    x = 100.0 + gap_m + np.sign(gap_m) * CAR.length_m
    sites = sites_of(road_scene(recorded(x, 0.0, other_mps), lanes=1))
    driver = replace(DRIVER, desired_mps=11.0)
    start = sites.starts.make(request_of(), Site(sites.here.routes.offers(1)[0], 100.0), driver=driver)
    if begins:
        assert isinstance(start, Start), start
        assert 1.5 * abs(other_mps - start.start_mps) <= abs(gap_m) + 0.3
    else:
        assert start is Reason.NO_SITE


@pytest.mark.parametrize(("at_m", "begins"), [(90.0, False), (160.0, True)])
def test_slow_start_looks_for_sharp_curves_as_far_as_it_comes(at_m: float, begins: bool) -> None:
    """At 3 m/s from s = 10, at 10 m/s after 4.4 s: 95 m in a scene, 36 at the speed of the start. R = 3 m, 5 needed."""
    bend = [(at_m + 3.0 * np.sin(a), 3.0 - 3.0 * np.cos(a)) for a in np.linspace(0.0, np.pi / 2, 9)]
    sites = sites_of(scene_on(graph_of(draw_lane(1, [(0.0, 0.0), *bend, (at_m + 3.0, 200.0)]))))
    site = Site(sites.here.routes.offers(1)[0], 10.0)
    made = sites.starts.make(request_of(), site, driver=DRIVER, speed_mps=3.0)
    assert isinstance(made, Start) if begins else made is Reason.LIMIT_CURVATURE


def test_vehicle_that_begins_at_a_red_line_stands_there() -> None:
    """Cross traffic has the intersection at 60 m: with its front within what drivers keep of that, it stands.

    20 m before it begins to drive; a meter past what drivers keep it came on red.
    """
    scene = scene_on(draw_crossing(), recorded(70.0, -8.0, 9.0, heading=np.pi / 2))
    (offer,) = (one for one in Surroundings(scene).routes.offers(1) if one.route == (1, 2, 3))
    begun = {
        front: sites_of(scene).starts.make(request_of(), Site(offer, front - CAR.length_m / 2), driver=DRIVER)
        for front in (40.0, 57.5, 60.8, 62.6)
    }
    at_line = [begun[57.5], begun[60.8]]
    assert [start.start_mps for start in at_line if isinstance(start, Start)] == [0.0, 0.0]
    gaps = [start.driver.line_gap_m for start in at_line if isinstance(start, Start)]
    assert gaps == pytest.approx([2.5, -0.8], abs=0.1)
    before = begun[40.0]
    assert isinstance(before, Start)
    assert before.start_mps > 3.0
    assert before.driver == DRIVER
    assert begun[62.6] is Reason.ENTERS_ON_RED


def test_without_collision_checks_no_start_asks_where_others_have_been() -> None:
    """2.5 m behind one at 14 m/s, where a start is none otherwise."""
    config = Config(without=frozenset({"collision"}), spawn=Spawn(prior_speed_mps=9.0))
    sites = sites_of(scene_on(draw_road(lanes=1, length_m=ROAD_M), recorded(107.0, 0.0, 14.0), config=config))
    start = sites.starts.make(request_of(), Site(sites.here.routes.offers(1)[0], 100.0), driver=DRIVER)
    assert isinstance(start, Start), start


@pytest.mark.parametrize(
    ("on_m", "is_offered", "is_made"), [(0.0, False, False), (3.0, True, False), (40.0, True, True)]
)
def test_turn_is_done_where_the_map_goes_on_behind_it(on_m: float, is_offered: bool, is_made: bool) -> None:
    """None is seen where the map ends with it, or so near that the front is there while the middle is in the turn."""
    sites = sites_of(left_turn_scene(60.0, on_m))
    routes = sites.here.routes
    assert routes.map_offers(Policy.LEFT_TURN) is is_offered
    assert sites._promises(request_of(0, Policy.LEFT_TURN), routes.offers(1)[0], 35.0, 9.0, strict=True) is is_offered
    made = sites.starts.make(request_of(0, Policy.LEFT_TURN), Site(routes.offers(1)[0], 20.0), driver=DRIVER)
    assert isinstance(made, Start) if is_made else made is Reason.SCENE_ENDED


@pytest.mark.parametrize(("s", "reason"), [(59.5, Reason.TURN_NOT_SEEN), (58.0, None)])
def test_turn_is_seen_from_its_beginning(s: float, reason: Reason | None) -> None:
    sites = sites_of(left_turn_scene(60.0))
    made = sites.starts.make(request_of(0, Policy.LEFT_TURN), Site(sites.here.routes.offers(1)[0], s), driver=DRIVER)
    assert made is reason if reason else isinstance(made, Start)


@pytest.mark.parametrize(("red", "reason"), [(True, Reason.WAITS_AT_LINE), (False, Reason.SCENE_ENDED)])
def test_turn_behind_a_red_line_says_that_the_vehicle_waits(
    monkeypatch: pytest.MonkeyPatch, red: bool, reason: Reason
) -> None:
    """30 m before a turn to the left that is red throughout; 150 m before one that is not, farther than it drives."""
    at_m = 60.0 if red else 180.0
    scene = left_turn_scene(at_m)
    closed = np.full((1, scene.num_steps), red)
    line = ClosedLines(np.array([at_m - CAR.length_m / 2]), np.array([at_m + 24.0]), closed, np.array([0]))
    monkeypatch.setattr(StopLines, "on", lambda *_: line)
    (offer,) = Surroundings(scene).routes.offers(1)
    made = sites_of(scene).starts.make(request_of(0, Policy.LEFT_TURN), Site(offer, 30.0), driver=DRIVER)
    assert made is reason


@pytest.mark.parametrize(
    ("slow_m", "end_m", "reason"), [(40, 170, Reason.TOO_SLOW), (85, 170, None), (140, 230, Reason.SCENE_ENDED)]
)
def test_none_is_to_stop_astride_of_two_lanes(
    monkeypatch: pytest.MonkeyPatch, slow_m: float, end_m: float, reason: Reason | None
) -> None:
    """Across from 120 to 170 m: at 1.5 m/s for 20 m, too slow to shift, 40 m after the start at 100 m, or past it."""
    scene = road_scene()
    starts, act = sites_of(scene).starts, World.roll_manoeuvre

    def slowed(world: World, start: Start) -> Any:
        vehicle, parts = act(world, start)
        s, v = parts[-1].s, np.where(np.abs(parts[-1].s - 100.0 - slow_m) < 10.0, 1.5, 9.0)
        path = replace(parts[-1].path, lateral_spans=(LateralSpan(120.0, end_m),))
        return replace(vehicle, path=path), (*parts[:-1], replace(parts[-1], path=path, s=s, v=v))

    monkeypatch.setattr(World, "roll_manoeuvre", slowed)
    monkeypatch.setattr(World, "rejection_reason", lambda *_args, **_more: None)
    request = request_of(0, Policy.LANE_CHANGE, 1.0)
    made = starts.make(
        request, Site(Surroundings(scene).routes.offers(1)[0], 100.0), driver=replace(DRIVER, desired_mps=10.0)
    )
    assert made is reason if reason else isinstance(made, Start), made


def test_who_begins_close_behind_a_standing_one_stands() -> None:
    """Some 3 m from bumper to bumper behind one that stands at 100 m; at 2 m/s it would have to brake at once.

    The leader drives off after 3 s, at 1 m/s2: a vehicle that stands throughout is no start.
    """
    moved_m = 0.5 * np.maximum(0.1 * np.arange(110) - 3.0, 0.0) ** 2
    leader = replace(recorded(100.0, 0.0), position=np.stack([100.0 + moved_m, np.zeros(110)], axis=1))
    scene = road_scene(leader, lanes=1)
    for seed in range(10):
        sites = sites_of(scene, seed)
        start = sites.starts.make(request_of(), Site(sites.here.routes.offers(1)[0], 92.5))
        assert isinstance(start, Start), start
        assert start.start_mps == 0.0


@pytest.mark.parametrize(("aside_m", "stands"), [(0.0, True), (1.0, False)])
def test_none_queues_behind_a_parked_vehicle(aside_m: float, stands: bool) -> None:
    """Two cars that never move: in the middle of the lane they are a queue, 1 m aside they are parked.

    Some 3 m behind there is no speed to begin with; behind a queue a vehicle begins standing, for what a look tells.
    """
    scene = road_scene(recorded(100.0, aside_m), recorded(107.0, aside_m, name="b"), lanes=1)
    sites = sites_of(scene)
    start = sites.starts.make(request_of(), Site(sites.here.routes.offers(1)[0], 92.5))
    assert start is (Reason.STANDS_THROUGHOUT if stands else Reason.NO_SITE)


@pytest.mark.parametrize(
    ("behind_m", "headway_s", "begins"), [(12.0, 0.8, False), (16.0, 0.8, True), (16.0, 1.3, False), (23.0, 1.3, True)]
)
def test_none_begins_nearer_ahead_of_a_recorded_follower_than_drivers_follow(
    behind_m: float, headway_s: float, begins: bool
) -> None:
    """At 16 m/s behind centres 12, 16 and 23 m ahead, between bumpers .47, .72 and 1.16 s: .2 s less are asked for."""
    scene = road_scene(recorded(60.0 - behind_m, 0.0, 16.0), lanes=1)
    sites = sites_of(scene)
    site = Site(sites.here.routes.offers(1)[0], 60.0, headway_s=headway_s)
    start = sites.starts.make(request_of(), site, driver=replace(DRIVER, desired_mps=17.0))
    assert (start is not Reason.FOLLOWER_HEADWAY) is begins


def test_rear_bumper_is_at_least_so_far_from_the_beginning_of_the_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """A car begins no nearer to the edge than half its kept length and _FROM_EDGE_M."""
    scene = road_scene(length_m=60.0)
    monkeypatch.setattr("hid2.insertion.starts._FROM_EDGE_M", 6.0)
    sites = sites_of(scene)
    offer = sites.here.routes.offers(1)[0]
    for s, begins in ((0.5, False), (8.0, False), (9.5, True)):
        found = sites.starts.make(request_of(), Site(offer, s))
        assert isinstance(found, Start) == begins, s
