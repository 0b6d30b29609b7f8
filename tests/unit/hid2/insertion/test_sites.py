"""Start sites: where a request may be met, and whether a vehicle can begin there."""

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hand_drawn import draw_chain, draw_crossing, draw_lane, draw_road, graph_of
from inserted import CAR, DRIVER, guard_of, recorded, scene_on, sites_of, start_on
from scipy.stats import chisquare

from hid2.agents import Policy, Track
from hid2.conflicts.stop_lines import ClosedLines, StopLines
from hid2.insertion.rollout import World
from hid2.insertion.sites import InsertionSites
from hid2.insertion.situations import Situation
from hid2.insertion.starts import Site, speed_behind
from hid2.insertion.surroundings import Surroundings
from hid2.motion.route import LateralSpan
from hid2.occupancy.sigma import FREE
from hid2.params import Config, LaneChange, Request, Spawn
from hid2.reasons import Reason
from hid2.scene import Scene
from hid2.vehicle import Start, VehicleRequest

ROAD_M = 300.0


def _request(number: int = 0, policy: Policy = Policy.STRAIGHT, trigger_s: float = 0.0) -> VehicleRequest:
    return VehicleRequest(number, policy, trigger_s, size=CAR)


def scene_of(*tracks: Track, sites: str = "promising", lanes: int = 2, length_m: float = ROAD_M, **spawn: Any) -> Scene:
    """Two lanes of 300 m."""
    config = Config(request=Request(sites=sites), spawn=Spawn(prior_speed_mps=9.0, **spawn))
    return scene_on(draw_road(lanes=lanes, length_m=length_m), *tracks, config=config)


def _left_turn_scene(at_m: float, on_m: float = 185.0) -> Scene:
    """One lane that turns to the left at so many metres and goes on for on_m, and no recorded vehicle."""
    bend = [(at_m + 15.0 * np.sin(a), 15.0 - 15.0 * np.cos(a)) for a in np.linspace(0.0, np.pi / 2, 12)]
    lanes = [
        draw_lane(1, [(0.0, 0.0), (at_m, 0.0)], successors=(2,)),
        draw_lane(2, bend, successors=(3,), is_intersection=True),
    ]
    return scene_on(graph_of(*lanes, *[draw_lane(3, [bend[-1], (at_m + 15.0, 15.0 + on_m)])] * (on_m > 0.0)))


def _many(scene: Scene, count: int, **request: Any) -> list[Start]:
    """One start of each of many seeds, nobody else proposed before it."""
    return [start for seed in range(count) for start in sites_of(scene, seed).propose(_request(**request))]


def test_site_is_never_on_an_occupied_cell_nor_near_a_box() -> None:
    """Parked ones at 60 and 130 m of lane 1, one at 9 m/s on lane 2 at 100 m: CLEAR_GAP_M of 2 m to all."""
    others = [recorded(60.0, 0.0, name="a"), recorded(130.0, 0.0, name="b"), recorded(100.0, 3.5, 9.0, name="c")]
    scene = scene_of(*others)
    starts = _many(scene, 60)
    assert len(starts) > 30
    for start in starts:
        cell = scene.cell_at(start.path, start.start_m)
        assert scene.occupancy.sigma[0, scene.grid.index_of[cell]] == FREE
        x, y = start.path.line.position(np.array([start.start_m]))[0]
        for one in others:
            if abs(one.position[0, 1] - y) < 1.5:
                assert abs(one.position[0, 0] - x) - 0.5 * (start.size.length_m + 4.5) >= 2.0 - 0.01


def test_three_in_ten_begin_while_they_gain_speed() -> None:
    """On a free road, at least .3 of the desired speed; others differ from it by 2 SD of 1.2 m/s at most."""
    sites = sites_of(scene_of(lanes=1))
    site = Site(sites.here.routes.offers(1)[0], 50.0)
    starts = [one for _ in range(300) if isinstance(one := sites.starts.make(_request(), site), Start)]
    below = np.array([start.driver.desired_mps - start.start_mps for start in starts])
    assert (below > 2.4).mean() == pytest.approx(0.3 * (6.0 - 2.0) / (6.0 - 1.0), abs=0.06)
    assert below.min() >= -2.4 - 1e-9
    assert min(start.start_mps / start.driver.desired_mps for start in starts) >= 0.3 - 1e-9


def test_start_that_a_recorded_vehicle_would_run_into_is_rejected() -> None:
    """On one lane somebody comes from x = 0 at 18 m/s, whom nobody can make brake: no slower one begins ahead of it.

    In 10.9 s it drives 196 m; a vehicle with 9 m/s would have to begin at 196 - 98 = 98 m or farther.
    """
    scene = scene_of(recorded(2.3, 0.0, 18.0), lanes=1, max_speed_mps=10.0)
    sites = sites_of(scene)
    starts = [start for number in range(10) for start in sites.propose(_request(number))]
    assert all(start.start_m > 75.0 for start in starts)
    assert sites.starts.refusals[Reason.TTC_RECORDED_FOLLOWER] > 0


def test_start_that_harms_a_recorded_follower_later_is_refused_with_the_harm(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(World, "harm_to_followers", lambda *_: Reason.FOLLOWER_BRAKING)
    sites = sites_of(scene_of(lanes=1))
    site = Site(sites.here.routes.offers(1)[0], 100.0)
    assert sites.starts.make(_request(), site, driver=DRIVER) is Reason.FOLLOWER_BRAKING


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
    sites = sites_of(scene_of(recorded(x, 0.0, other_mps), lanes=1))
    driver = replace(DRIVER, desired_mps=11.0)
    start = sites.starts.make(_request(), Site(sites.here.routes.offers(1)[0], 100.0), driver=driver)
    if begins:
        assert isinstance(start, Start), start
        assert 1.5 * abs(other_mps - start.start_mps) <= abs(gap_m) + 0.3
    else:
        assert start is Reason.NO_SITE


@pytest.mark.parametrize(("sites", "y"), [("promising", 3.5), ("any", 0.0)])
def test_lane_changer_that_is_driven_again_is_known_on_its_way_across(sites: str, y: float) -> None:
    """Alone at 9 m/s it has changed to lane 2 by the end; `any` looks no farther ahead than it follows its lane."""
    scene = scene_of(sites=sites)
    starts = sites_of(scene).starts
    starts.take([start_on(scene, (1,), 60.0, 9.0, policy=Policy.LANE_CHANGE, sides=("left",))])
    known = starts.world.guard.inserted_known.position[0, scene.num_steps - 1]
    assert known[1] == pytest.approx(y, abs=0.3)


@pytest.mark.parametrize(("at_m", "begins"), [(90.0, False), (160.0, True)])
def test_slow_start_looks_for_sharp_curves_as_far_as_it_comes(at_m: float, begins: bool) -> None:
    """At 3 m/s from s = 10, at 10 m/s after 4.4 s: 95 m in a scene, 36 at the speed of the start. R = 3 m, 5 needed."""
    bend = [(at_m + 3.0 * np.sin(a), 3.0 - 3.0 * np.cos(a)) for a in np.linspace(0.0, np.pi / 2, 9)]
    sites = sites_of(scene_on(graph_of(draw_lane(1, [(0.0, 0.0), *bend, (at_m + 3.0, 200.0)]))))
    site = Site(sites.here.routes.offers(1)[0], 10.0)
    made = sites.starts.make(_request(), site, driver=DRIVER, speed_mps=3.0)
    assert isinstance(made, Start) if begins else made is Reason.LIMIT_CURVATURE


def test_vehicle_that_begins_at_a_red_line_stands_there() -> None:
    """Cross traffic has the intersection at 60 m: with its front within what drivers keep of that, it stands.

    20 m before it begins to drive; a meter past what drivers keep it came on red.
    """
    scene = scene_on(draw_crossing(), recorded(70.0, -8.0, 9.0, heading=np.pi / 2))
    (offer,) = (one for one in Surroundings(scene).routes.offers(1) if one.route == (1, 2, 3))
    begun = {
        front: sites_of(scene).starts.make(_request(), Site(offer, front - CAR.length_m / 2), driver=DRIVER)
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
    start = sites.starts.make(_request(), Site(sites.here.routes.offers(1)[0], 100.0), driver=DRIVER)
    assert isinstance(start, Start), start


@pytest.mark.parametrize(
    ("on_m", "is_offered", "is_made"), [(0.0, False, False), (3.0, True, False), (40.0, True, True)]
)
def test_turn_is_done_where_the_map_goes_on_behind_it(on_m: float, is_offered: bool, is_made: bool) -> None:
    """None is seen where the map ends with it, or so near that the front is there while the middle is in the turn."""
    sites = sites_of(_left_turn_scene(60.0, on_m))
    routes = sites.here.routes
    assert routes.map_offers(Policy.LEFT_TURN) is is_offered
    assert sites._promises(_request(0, Policy.LEFT_TURN), routes.offers(1)[0], 35.0, 9.0, strict=True) is is_offered
    made = sites.starts.make(_request(0, Policy.LEFT_TURN), Site(routes.offers(1)[0], 20.0), driver=DRIVER)
    assert isinstance(made, Start) if is_made else made is Reason.SCENE_ENDED


@pytest.mark.parametrize(("s", "reason"), [(59.5, Reason.TURN_NOT_SEEN), (58.0, None)])
def test_turn_is_seen_from_its_beginning(s: float, reason: Reason | None) -> None:
    sites = sites_of(_left_turn_scene(60.0))
    made = sites.starts.make(_request(0, Policy.LEFT_TURN), Site(sites.here.routes.offers(1)[0], s), driver=DRIVER)
    assert made is reason if reason else isinstance(made, Start)


def test_what_a_place_promises() -> None:
    """A turn of 23.5 m at 60 or 200 m, at 9 m/s for 10.9 s: strictly (60 - s) / 6.75 + 23.5 / 5 + 2 s of them."""

    def promised(policy: Policy, at_m: float, *from_m: float, strict: bool = True) -> list[bool]:
        sites, request = sites_of(_left_turn_scene(at_m)), _request(0, policy)
        (offer,) = sites.here.routes.offers(1)
        meets = [offer.meets_junction(at_m + at, at_m + at + 5) for at in (-6, -4, 22, 24)]
        assert meets == [False, True, True, False]
        return [sites._promises(request, offer, s, 9.0, strict=strict) for s in from_m]

    assert promised(Policy.LEFT_TURN, 60, 20, 35, 56) == [False, True, False]
    assert promised(Policy.LEFT_TURN, 60, 20, 56, 61, strict=False) == [True, True, False]
    assert promised(Policy.LEFT_TURN, 200, 20, strict=False) == promised(Policy.RIGHT_TURN, 60, 35) == [False]
    assert promised(Policy.STRAIGHT, 60, 20, 61) + promised(Policy.STRAIGHT, 200, 20) == [False, False, True]


@pytest.mark.parametrize(("policy", "times"), [(Policy.LANE_CHANGE, 4), (Policy.STRAIGHT, 2)])
def test_cells_for_a_manoeuvre_are_gone_through_again(
    monkeypatch: pytest.MonkeyPatch, policy: Policy, times: int
) -> None:
    """Strict sites and others: by what goes straight once, for a lane change twice."""
    looked: list[Policy] = []

    def places(_: InsertionSites, request: VehicleRequest, wants: object) -> Any:
        looked.append(request.policy)
        return iter(())

    monkeypatch.setattr(InsertionSites, "_places", places)
    assert sites_of(scene_of()).propose(_request(0, policy, 1.0)) == []
    assert looked == [policy] * times


@pytest.mark.parametrize(("red", "reason"), [(True, Reason.WAITS_AT_LINE), (False, Reason.SCENE_ENDED)])
def test_turn_behind_a_red_line_says_that_the_vehicle_waits(
    monkeypatch: pytest.MonkeyPatch, red: bool, reason: Reason
) -> None:
    """30 m before a turn to the left that is red throughout; 150 m before one that is not, farther than it drives."""
    at_m = 60.0 if red else 180.0
    scene = _left_turn_scene(at_m)
    closed = np.full((1, scene.num_steps), red)
    line = ClosedLines(np.array([at_m - CAR.length_m / 2]), np.array([at_m + 24.0]), closed, np.array([0]))
    monkeypatch.setattr(StopLines, "on", lambda *_: line)
    (offer,) = Surroundings(scene).routes.offers(1)
    made = sites_of(scene).starts.make(_request(0, Policy.LEFT_TURN), Site(offer, 30.0), driver=DRIVER)
    assert made is reason


@pytest.mark.parametrize(
    ("slow_m", "end_m", "reason"), [(40, 170, Reason.TOO_SLOW), (85, 170, None), (140, 230, Reason.SCENE_ENDED)]
)
def test_none_is_to_stop_astride_of_two_lanes(
    monkeypatch: pytest.MonkeyPatch, slow_m: float, end_m: float, reason: Reason | None
) -> None:
    """Across from 120 to 170 m: at 1.5 m/s for 20 m, too slow to shift, 40 m after the start at 100 m, or past it."""
    scene = scene_of()
    starts, act = sites_of(scene).starts, World.roll_manoeuvre

    def slowed(world: World, start: Start) -> Any:
        vehicle, parts = act(world, start)
        s, v = parts[-1].s, np.where(np.abs(parts[-1].s - 100.0 - slow_m) < 10.0, 1.5, 9.0)
        path = replace(parts[-1].path, lateral_spans=(LateralSpan(120.0, end_m),))
        return replace(vehicle, path=path), (*parts[:-1], replace(parts[-1], path=path, s=s, v=v))

    monkeypatch.setattr(World, "roll_manoeuvre", slowed)
    monkeypatch.setattr(World, "rejection_reason", lambda *_args, **_more: None)
    request = _request(0, Policy.LANE_CHANGE, 1.0)
    made = starts.make(
        request, Site(Surroundings(scene).routes.offers(1)[0], 100.0), driver=replace(DRIVER, desired_mps=10.0)
    )
    assert made is reason if reason else isinstance(made, Start), made


def test_vehicle_does_not_begin_with_braking() -> None:
    """Behind one that slows down from 9 m/s by 1.2 m/s2 a driver begins slower: it loses .5 m/s2 in 1.3 s at most."""
    speed = np.maximum(9.0 - 0.12 * np.arange(110), 0.0)
    x = 150.0 + 0.1 * np.concatenate([[0.0], np.cumsum(speed[:-1])])
    leader = recorded(150.0, 0.0)
    leader = replace(
        leader, position=np.column_stack([x, np.zeros(110)]), velocity=np.column_stack([speed, np.zeros(110)])
    )
    scene = scene_of(leader, lanes=1)
    behind = [start for seed in range(90) for start in sites_of(scene, seed).propose(_request()) if start.leader == 0]
    here = Surroundings(scene)
    world = World(scene, here.roads, guard_of(here))
    loses = np.array([v[0] - v[13] for v in (world.roll(start).v for start in behind)]) / 1.3
    assert (np.abs(loses - 0.5) < 0.02).sum() > 5
    assert loses.max() < 0.52


def test_any_site_is_drawn_uniformly_over_all_that_are_admissible() -> None:
    """sites = "any" on an empty lane of 300 m: admissible is where nobody leaves before 5 s, and all of that alike.

    Six stretches of 30 m from 20 to 200 m, 240 seeds: chi-square against the same count in each.
    """
    scene = scene_of(sites="any", lanes=1)
    s = np.array([start.start_m for start in _many(scene, 240)])
    counts, _ = np.histogram(s, bins=np.linspace(20.0, 200.0, 7))
    assert counts.sum() > 120
    assert chisquare(counts).pvalue > 0.01


def test_any_site_asks_for_no_promise() -> None:
    """A lane change on a road of one lane: promising sites have none; any site is taken, and the map says no later."""
    assert _many(scene_of(lanes=1), 5, policy=Policy.LANE_CHANGE) == []
    assert len(_many(scene_of(lanes=1, sites="any"), 5, policy=Policy.LANE_CHANGE)) == 5


def test_promising_sites_are_nearer_to_moving_traffic() -> None:
    """Cells within 30 m of somebody who moves weigh four times as much; parked ones draw nobody."""

    def near(*tracks: Track) -> float:
        return float(np.mean([abs(start.start_m - 150.0) < 30.0 for start in _many(scene_of(*tracks), 60)]))

    assert near(recorded(150.0, 3.5, 9.0), recorded(150.0, -20.0, 9.0)) > max(0.2, near(recorded(150.0, -8.0, 0.0)))


def test_lane_changes_start_where_a_lane_is_beside_at_the_trigger() -> None:
    """Lane 2 lies beside lane 1 up to x = 120 m only. At a trigger of 4 s and 9 m/s, 0.9 * 36 = 32 m on, it must

    last for 1.3 * 2.5 s and half a second more: from about 120 - 34 = 86 m at the latest, so starts before 55 m.
    """
    graph = graph_of(
        draw_lane(1, [(0.0, 0.0), (120.0, 0.0)], left=2, successors=(3,)),
        draw_lane(2, [(0.0, 3.5), (120.0, 3.5)], right=1), draw_lane(3, [(120.0, 0.0), (300.0, 0.0)]),
    )  # fmt: skip
    scene = scene_on(graph, config=Config(spawn=Spawn(prior_speed_mps=9.0)))
    own = [s for s in _many(scene, 30, policy=Policy.LANE_CHANGE, trigger_s=4.0) if s.path.segment_at(5.0).lane_id == 1]
    assert own
    assert max(start.start_m for start in own) < 56.0


@pytest.fixture
def refusing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A rule of a user's that takes no gap, ever."""
    (tmp_path / "refusing_rule.py").write_text("def never(view):\n    return False\n")
    monkeypatch.syspath_prepend(tmp_path)
    return "refusing_rule:never"


@pytest.mark.parametrize(("policy", "slow_leader"), [(Policy.LANE_CHANGE, None), (Policy.OVERTAKE, 1)])
def test_no_site_is_proposed_for_a_manoeuvre_that_the_configured_rule_never_begins(
    refusing: str, policy: Policy, slow_leader: int | None
) -> None:
    """By the paper's, MOBIL's and SUMO's rules sites are found on two empty lanes; `any` asks no rule."""
    usual = scene_of(length_m=500.0)

    def found(rule: str, sites: str = "promising") -> int:
        config = usual.config.model_copy(
            update={
                "lane_change": LaneChange(rule=rule), "request": Request(sites=sites, near="anywhere"),
            }
        )  # fmt: skip
        slow = None if slow_leader is None else _request(slow_leader)
        scene = replace(usual, config=config)
        return sum(bool(sites_of(scene, seed).propose(_request(0, policy, 1.0), slow)) for seed in range(2))

    assert min(found(rule) for rule in ("paper", "MOBIL", "LC2013")) > 0
    assert found(refusing) == 0
    assert found(refusing, "any") > 0


@pytest.mark.parametrize(("side", "lane_id"), [("left", 1), ("right", 2)])
def test_rule_that_takes_one_side_alone_finds_its_sites(
    side: str, lane_id: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two lanes, 1 to the right of 2: who is to change to the left begins on 1, to the right on 2."""
    (tmp_path / f"only_{side}.py").write_text(f"def accept(view):\n    return view.side == {side!r}\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    config = Config(lane_change=LaneChange(rule=f"only_{side}:accept"))
    scene = scene_on(draw_road(length_m=ROAD_M), config=config)
    starts = _many(scene, 4, policy=Policy.LANE_CHANGE, trigger_s=1.0)
    assert {scene.cell_at(start.path, start.start_m).lane_id for start in starts} == {lane_id}


def test_gap_beside_is_foreseen_by_the_configured_rule(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A rule that leaves slow leaders alone: behind one at 5 m/s no gap is foreseen, by the paper's rule one is.

    A driver who wishes 10 m/s is behind it when the trigger comes.
    """
    (tmp_path / "patient_rule.py").write_text("def follows(view):\n    return view.own_front.distance_m > 80.0\n")
    monkeypatch.syspath_prepend(tmp_path)
    usual = scene_of(recorded(130.0, 0.0, 5.0))
    request = _request(0, Policy.LANE_CHANGE, 2.0)

    def begins(rule: str) -> bool:
        scene = replace(usual, config=usual.config.model_copy(update={"lane_change": LaneChange(rule=rule)}))
        sites = sites_of(scene)
        offer = sites.here.routes.offers(1)[0]
        found = sites.starts.make(request, Site(offer, 90.0), driver=DRIVER, speed_mps=8.0)
        return isinstance(found, Start)

    assert begins("paper")
    assert not begins("patient_rule:follows")


def test_starts_of_a_round_keep_clear_of_each_other() -> None:
    """Twelve on 2 x 300 m: 2.5 m at least from bumper to bumper on one lane."""
    sites = sites_of(scene_of())
    starts = [start for number in range(12) for start in sites.propose(_request(number))]
    assert len(starts) >= 6
    for row, one in enumerate(starts):
        for other in starts[:row]:
            if one.route == other.route:
                gap = abs(one.start_m - other.start_m) - 0.5 * (one.size.length_m + other.size.length_m)
                assert gap > 2.5 - 0.01


def test_a_second_vehicle_that_is_to_follow_takes_the_other_leader() -> None:
    """One leader on each of two lanes, of one speed, and all are to follow one."""
    scene = scene_of(recorded(150.0, 0.0, 9.0, name="a"), recorded(150.0, 3.5, 9.0, name="b"))
    for seed in range(8):
        sites = sites_of(scene, seed, Situation.FOLLOWS)
        found = [start for number in (0, 1) for start in sites.propose(_request(number))]
        assert all(Situation.FOLLOWS in start.situations for start in found)
        assert len({start.leader for start in found}) == 2


def test_route_that_ends_too_early_is_no_site() -> None:
    """On 60 m of road nobody stays for 5 s at 9 m/s but from its first metres; at 20 m/s nobody does."""
    assert _many(scene_of(recorded(200.0, 30.0, 20.0), length_m=60.0, min_speed_mps=18.0), 10) == []


def test_who_begins_close_behind_a_standing_one_stands() -> None:
    """Some 3 m from bumper to bumper behind one that stands at 100 m; at 2 m/s it would have to brake at once.

    The leader drives off after 3 s, at 1 m/s2: a vehicle that stands throughout is no start.
    """
    moved_m = 0.5 * np.maximum(0.1 * np.arange(110) - 3.0, 0.0) ** 2
    leader = replace(recorded(100.0, 0.0), position=np.stack([100.0 + moved_m, np.zeros(110)], axis=1))
    scene = scene_of(leader, lanes=1)
    for seed in range(10):
        sites = sites_of(scene, seed)
        start = sites.starts.make(_request(), Site(sites.here.routes.offers(1)[0], 92.5))
        assert isinstance(start, Start), start
        assert start.start_mps == 0.0


@pytest.mark.parametrize(("aside_m", "stands"), [(0.0, True), (1.0, False)])
def test_none_queues_behind_a_parked_vehicle(aside_m: float, stands: bool) -> None:
    """Two cars that never move: in the middle of the lane they are a queue, 1 m aside they are parked.

    Some 3 m behind there is no speed to begin with; behind a queue a vehicle begins standing, for what a look tells.
    """
    scene = scene_of(recorded(100.0, aside_m), recorded(107.0, aside_m, name="b"), lanes=1)
    sites = sites_of(scene)
    start = sites.starts.make(_request(), Site(sites.here.routes.offers(1)[0], 92.5))
    assert start is (Reason.STANDS_THROUGHOUT if stands else Reason.NO_SITE)


@pytest.mark.parametrize(
    ("behind_m", "headway_s", "begins"), [(12.0, 0.8, False), (16.0, 0.8, True), (16.0, 1.3, False), (23.0, 1.3, True)]
)
def test_none_begins_nearer_ahead_of_a_recorded_follower_than_drivers_follow(
    behind_m: float, headway_s: float, begins: bool
) -> None:
    """At 16 m/s behind centres 12, 16 and 23 m ahead, between bumpers .47, .72 and 1.16 s: .2 s less are asked for."""
    scene = scene_of(recorded(60.0 - behind_m, 0.0, 16.0), lanes=1)
    sites = sites_of(scene)
    site = Site(sites.here.routes.offers(1)[0], 60.0, headway_s=headway_s)
    start = sites.starts.make(_request(), site, driver=replace(DRIVER, desired_mps=17.0))
    assert (start is not Reason.FOLLOWER_HEADWAY) is begins


def test_nobody_begins_in_an_intersection_where_there_is_anything_else() -> None:
    config = Config(request=Request(near="anywhere"), spawn=Spawn(prior_speed_mps=9.0))
    scene = scene_on(draw_chain(60.0, 90.0, 200.0, crossing=2), config=config)
    begun = Counter(one.path.segment_at(one.start_m).lane_id for one in _many(scene, 30))
    assert begun.total() == 30
    assert begun[2] == 0


@pytest.mark.parametrize(
    ("sites", "policy", "again"),
    [
        ("promising", "straight", False), ("promising", "lane_change", True), ("promising", "left_turn", True),
        ("any", "straight", True),
    ],
)  # fmt: skip
def test_only_cells_for_a_manoeuvre_and_those_drawn_from_all_are_tried_again(
    monkeypatch: pytest.MonkeyPatch, sites: str, policy: str, again: bool
) -> None:
    """Two lanes of 150 cells, or one before a turn, on which no vehicle can begin, for each of 30."""
    tried: Counter[tuple[int, int]] = Counter()

    def turn_down(_starts: object, _request: object, site: Site, **_: object) -> Reason:
        assert site.s is not None
        tried[site.offer.route[0], int((site.s - site.offer.start_m) / 4.0)] += 1
        return Reason.MEETS_RECORDED  # NO_SITE: another vehicle of the round may be in the way, not the place's fault

    monkeypatch.setattr("hid2.insertion.starts.Starts.make", turn_down)
    scene = _left_turn_scene(60.0) if policy == "left_turn" else scene_of(recorded(200.0, 30.0, 20.0), sites=sites)
    here = sites_of(scene)
    assert [here.propose(_request(number, Policy(policy))) for number in range(30)] == [[]] * 30
    assert (max(tried.values()) > 1) is again


def test_rear_bumper_is_at_least_so_far_from_the_beginning_of_the_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """A car begins no nearer to the edge than half its kept length and _FROM_EDGE_M."""
    scene = scene_of(length_m=60.0)
    monkeypatch.setattr("hid2.insertion.starts._FROM_EDGE_M", 6.0)
    sites = sites_of(scene)
    offer = sites.here.routes.offers(1)[0]
    for s, begins in ((0.5, False), (8.0, False), (9.5, True)):
        found = sites.starts.make(_request(), Site(offer, s))
        assert isinstance(found, Start) == begins, s
