"""Start sites: where a request may be met, in which order they are looked at."""

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hand_drawn import draw_chain, draw_lane, draw_road, graph_of
from inserted import (
    DRIVER,
    ROAD_M,
    guard_of,
    left_turn_scene,
    recorded,
    request_of,
    road_scene,
    scene_on,
    sites_of,
    start_on,
)
from scipy.stats import chisquare

from hid2.agents import Policy, Track
from hid2.insertion.rollout import World
from hid2.insertion.sites import InsertionSites
from hid2.insertion.situations import Situation
from hid2.insertion.starts import Site
from hid2.insertion.surroundings import Surroundings
from hid2.occupancy.sigma import FREE
from hid2.params import Config, LaneChange, Request, Spawn
from hid2.reasons import Reason
from hid2.scene import Scene
from hid2.vehicle import Start, VehicleRequest


def _many(scene: Scene, count: int, **request: Any) -> list[Start]:
    """One start of each of many seeds, nobody else proposed before it."""
    return [start for seed in range(count) for start in sites_of(scene, seed).propose(request_of(**request))]


def test_site_is_never_on_an_occupied_cell_nor_near_a_box() -> None:
    """Parked ones at 60 and 130 m of lane 1, one at 9 m/s on lane 2 at 100 m: CLEAR_GAP_M of 2 m to all."""
    others = [recorded(60.0, 0.0, name="a"), recorded(130.0, 0.0, name="b"), recorded(100.0, 3.5, 9.0, name="c")]
    scene = road_scene(*others)
    starts = _many(scene, 60)
    assert len(starts) > 30
    for start in starts:
        cell = scene.cell_at(start.path, start.start_m)
        assert scene.occupancy.sigma[0, scene.grid.index_of[cell]] == FREE
        x, y = start.path.line.position(np.array([start.start_m]))[0]
        for one in others:
            if abs(one.position[0, 1] - y) < 1.5:
                assert abs(one.position[0, 0] - x) - 0.5 * (start.size.length_m + 4.5) >= 2.0 - 0.01


def test_start_that_a_recorded_vehicle_would_run_into_is_rejected() -> None:
    """On one lane somebody comes from x = 0 at 18 m/s, whom nobody can make brake: no slower one begins ahead of it.

    In 10.9 s it drives 196 m; a vehicle with 9 m/s would have to begin at 196 - 98 = 98 m or farther.
    """
    scene = road_scene(recorded(2.3, 0.0, 18.0), lanes=1, max_speed_mps=10.0)
    sites = sites_of(scene)
    starts = [start for number in range(10) for start in sites.propose(request_of(number))]
    assert all(start.start_m > 75.0 for start in starts)
    assert sites.starts.refusals[Reason.TTC_RECORDED_FOLLOWER] > 0


def test_start_at_any_site_is_known_to_those_after_it() -> None:
    """No rollout of it was kept. From 9 to 10 m/s it comes from 60 m to 60 + 9.9 * 10.9 = 168 m."""
    scene = road_scene(sites="any")
    starts = sites_of(scene).starts
    starts.take([start_on(scene, (1,), 60.0, 9.0)])
    known = starts.world.guard.inserted_known.position[0, scene.num_steps - 1]
    assert known == pytest.approx((168.0, 0.0), abs=2.0)


def test_what_a_place_promises() -> None:
    """A turn of 23.5 m at 60 or 200 m, at 9 m/s for 10.9 s: strictly (60 - s) / 6.75 + 23.5 / 5 + 2 s of them."""

    def promised(policy: Policy, at_m: float, *from_m: float, strict: bool = True) -> list[bool]:
        sites, request = sites_of(left_turn_scene(at_m)), request_of(0, policy)
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
    assert sites_of(road_scene()).propose(request_of(0, policy, 1.0)) == []
    assert looked == [policy] * times


def test_vehicle_does_not_begin_with_braking() -> None:
    """Behind one that slows down from 9 m/s by 1.2 m/s2 a driver begins slower: it loses .5 m/s2 in 1.3 s at most."""
    speed = np.maximum(9.0 - 0.12 * np.arange(110), 0.0)
    x = 150.0 + 0.1 * np.concatenate([[0.0], np.cumsum(speed[:-1])])
    leader = recorded(150.0, 0.0)
    leader = replace(
        leader, position=np.column_stack([x, np.zeros(110)]), velocity=np.column_stack([speed, np.zeros(110)])
    )
    scene = road_scene(leader, lanes=1)
    behind = [start for seed in range(90) for start in sites_of(scene, seed).propose(request_of()) if start.leader == 0]
    here = Surroundings(scene)
    world = World(scene, here.roads, guard_of(here))
    loses = np.array([v[0] - v[13] for v in (world.roll(start).v for start in behind)]) / 1.3
    assert (np.abs(loses - 0.5) < 0.02).sum() > 5
    assert loses.max() < 0.52


def test_any_site_is_drawn_uniformly_over_all_that_are_admissible() -> None:
    """sites = "any" on an empty lane of 300 m: admissible is where nobody leaves before 5 s, and all of that alike.

    Six stretches of 30 m from 20 to 200 m, 240 seeds: chi-square against the same count in each.
    """
    scene = road_scene(sites="any", lanes=1)
    s = np.array([start.start_m for start in _many(scene, 240)])
    counts, _ = np.histogram(s, bins=np.linspace(20.0, 200.0, 7))
    assert counts.sum() > 120
    assert chisquare(counts).pvalue > 0.01


def test_any_site_asks_for_no_promise() -> None:
    """A lane change on a road of one lane: promising sites have none; any site is taken, and the map says no later."""
    assert _many(road_scene(lanes=1), 5, policy=Policy.LANE_CHANGE) == []
    assert len(_many(road_scene(lanes=1, sites="any"), 5, policy=Policy.LANE_CHANGE)) == 5


def test_promising_sites_are_nearer_to_moving_traffic() -> None:
    """Cells within 30 m of somebody who moves weigh four times as much; parked ones draw nobody."""

    def near(*tracks: Track) -> float:
        return float(np.mean([abs(start.start_m - 150.0) < 30.0 for start in _many(road_scene(*tracks), 60)]))

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
    usual = road_scene(length_m=500.0)

    def found(rule: str, sites: str = "promising") -> int:
        config = usual.config.model_copy(
            update={
                "lane_change": LaneChange(rule=rule), "request": Request(sites=sites, near="anywhere"),
            }
        )  # fmt: skip
        slow = None if slow_leader is None else request_of(slow_leader)
        scene = replace(usual, config=config)
        return sum(bool(sites_of(scene, seed).propose(request_of(0, policy, 1.0), slow)) for seed in range(2))

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
    usual = road_scene(recorded(130.0, 0.0, 5.0))
    request = request_of(0, Policy.LANE_CHANGE, 2.0)

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
    sites = sites_of(road_scene())
    starts = [start for number in range(12) for start in sites.propose(request_of(number))]
    assert len(starts) >= 6
    for row, one in enumerate(starts):
        for other in starts[:row]:
            if one.route == other.route:
                gap = abs(one.start_m - other.start_m) - 0.5 * (one.size.length_m + other.size.length_m)
                assert gap > 2.5 - 0.01


def test_a_second_vehicle_that_is_to_follow_takes_the_other_leader() -> None:
    """One leader on each of two lanes, of one speed, and all are to follow one."""
    scene = road_scene(recorded(150.0, 0.0, 9.0, name="a"), recorded(150.0, 3.5, 9.0, name="b"))
    for seed in range(8):
        sites = sites_of(scene, seed, Situation.FOLLOWS)
        found = [start for number in (0, 1) for start in sites.propose(request_of(number))]
        assert all(Situation.FOLLOWS in start.situations for start in found)
        assert len({start.leader for start in found}) == 2


def test_route_that_ends_too_early_is_no_site() -> None:
    """On 60 m of road nobody stays for 5 s at 9 m/s but from its first metres; at 20 m/s nobody does."""
    assert _many(road_scene(recorded(200.0, 30.0, 20.0), length_m=60.0, min_speed_mps=18.0), 10) == []


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
    scene = left_turn_scene(60.0) if policy == "left_turn" else road_scene(recorded(200.0, 30.0, 20.0), sites=sites)
    here = sites_of(scene)
    assert [here.propose(request_of(number, Policy(policy))) for number in range(30)] == [[]] * 30
    assert (max(tried.values()) > 1) is again
