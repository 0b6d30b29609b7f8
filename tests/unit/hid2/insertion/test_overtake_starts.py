"""Starts of overtakes: behind a recorded slower vehicle, or one that is added; alone, and what begins after them."""

from typing import Any

import numpy as np
from hand_drawn import draw_road
from inserted import guard_of, recorded, scene_on, sites_of

from hid2.agents import Policy, Track
from hid2.insertion.filling import Filling
from hid2.insertion.rollout import World
from hid2.insertion.sites import InsertionSites
from hid2.insertion.surroundings import Surroundings
from hid2.params import Config, Request, Spawn
from hid2.policy.overtake import Stage
from hid2.reasons import Reason
from hid2.scene import Scene
from hid2.vehicle import Start, VehicleRequest

OVERTAKE, SLOW = VehicleRequest(0, Policy.OVERTAKE, 1.0), VehicleRequest(1, Policy.STRAIGHT, 0.0)
ALONE = {"straight": 0.0, "left_turn": 0.0, "right_turn": 0.0, "lane_change": 0.0, "overtake": 1.0}


def scene_of(*tracks: Track, **request: Any) -> Scene:
    """Two lanes of 500 m that run the same way, usual speed 9 m/s."""
    config = Config(request=Request(near="anywhere", **request), spawn=Spawn(prior_speed_mps=9.0))
    return scene_on(draw_road(lanes=2, length_m=500.0), *tracks, config=config)


def _world(sites: InsertionSites) -> World:
    """With nobody else in it."""
    here = sites.here
    return World(here.scene, here.roads, guard_of(here))


def test_overtaker_without_a_slower_leader_gets_one() -> None:
    """The leader is a straight request's, ahead on the same lane, and wants 50 to 70 % of 9 m/s: 4.5 to 6.3.

    Its wish wanders, and never below 4.5 m/s.
    """
    for seed in range(4):
        leader, overtaker = sites_of(scene_of(), seed).propose(OVERTAKE, SLOW)
        assert (leader.request, overtaker.request) == (SLOW, OVERTAKE)
        assert leader.route == overtaker.route
        assert leader.start_m - overtaker.start_m > leader.box.length_m
        assert 4.5 <= leader.driver.desired_mps <= 6.3
        assert leader.desired.min() >= 4.5
        assert leader.start_mps < overtaker.start_mps


def test_rollout_of_an_overtaker_is_out_past_and_back_in_time() -> None:
    """Out at 1.0 s or later, and back before 10.9 s: two lateral motions of 2.5 s at least, 5 m ahead of the leader."""
    sites = sites_of(scene_of())
    leader, overtaker = sites.propose(OVERTAKE, SLOW)
    world = _world(sites)
    slow = world.roll(leader)
    world.choose(world.rolled_out(leader, (slow,)))
    vehicle, parts = world.roll_manoeuvre(overtaker)
    assert vehicle.stage is Stage.DONE
    assert vehicle.overtaken_id == leader.vehicle_id
    out, back = (shift.requested_step for shift in vehicle.shifts)
    assert 10 <= out <= back - 25
    assert back + 25 <= 109
    at = parts[1].s[back - out] - slow.s[back]
    assert at >= 0.5 * (leader.box.length_m + overtaker.box.length_m) + 5.0 - 0.2


def test_way_back_of_an_overtake_ends_on_the_map() -> None:
    """On 120 m of road, which vehicles at 9 m/s leave at about 11 s: it is over before the front is at the edge."""
    config, found = Config(request=Request(near="anywhere"), spawn=Spawn(prior_speed_mps=9.0)), 0
    for seed in range(6):
        sites = sites_of(scene_on(draw_road(lanes=2, length_m=120.0), config=config), seed)
        starts = sites.propose(OVERTAKE, SLOW)
        if starts:
            found += 1
            world = _world(sites)
            world.choose(world.rolled_out(starts[0], (world.roll(starts[0]),)))
            path = world.roll_manoeuvre(starts[1])[0].path
            assert path.lateral_spans[-1].end < path.exit_m - 0.5 * starts[1].size.length_m
    assert found


def test_slower_recorded_vehicle_is_overtaken_where_none_can_be_added() -> None:
    """It drives at 4 m/s from x = 150 m on lane 1, where another one far ahead tells 10 m/s as a usual speed too."""
    scene = scene_of(recorded(150.0, 0.0, 4.0), recorded(350.0, 0.0, 10.0, name="usual"))
    found = [start for seed in range(6) for start in sites_of(scene, seed).propose(OVERTAKE, None)]
    assert found
    for start in found:
        assert start.path.segments[0].lane_id == 1
        assert 150.0 - 60.0 < start.start_m < 150.0 - 4.5


def test_without_a_leader_a_request_for_one_time_or_a_way_past_there_is_no_overtake() -> None:
    """From 6.5 s on 4.4 s are left, and out and back alone take 5.0 s. Parked ones every 15 m on lane 2 block it from
    lane 1, and on lane 2 itself nothing moves.
    """
    for request, slow, reason in (
        (OVERTAKE, None, Reason.NO_SLOW_LEADER),
        (VehicleRequest(0, Policy.OVERTAKE, 6.5), SLOW, Reason.NO_OVERTAKE_FORESEEN),
    ):
        sites = sites_of(scene_of())
        assert sites.propose(request, slow) == []
        assert sites.overtakes.found_none is reason
    queue = [recorded(10.0 + 15.0 * number, 3.5, 0.0, name=f"q{number}") for number in range(32)]
    assert sites_of(scene_of(*queue)).propose(OVERTAKE, SLOW) == []


def test_what_begins_later_leaves_a_chosen_overtake_as_it_is() -> None:
    """Twelve more on 1,000 m of lane: with all of them there the overtaker still comes out, past and back."""
    for seed in range(3):
        sites = sites_of(scene_of(), seed)
        leader, overtaker = sites.propose(OVERTAKE, SLOW)
        others: list[Start] = []
        for number in range(2, 14):
            others += sites.propose(VehicleRequest(number, Policy.STRAIGHT, 0.0))
        assert len(others) > 4
        world = _world(sites)
        for start in (leader, *others):
            world.choose(world.rolled_out(start, (world.roll(start),)))
        assert world.roll_manoeuvre(overtaker)[0].stage is Stage.DONE


def test_overtakes_asked_for_alone_lead_each_other() -> None:
    """Of six requests the last ones become slow leaders, with that reason; each overtake has its leader ahead.

    A single one has none to lead it.
    """
    scene = scene_of(agents=6, **ALONE)
    filling = Filling(Surroundings(scene), (0, 0))
    starts = filling.first_starts(6)
    overtakers = [start for start in starts if start.request.policy is Policy.OVERTAKE]
    lead = [one.request.number for one in filling.unmet if one.reason is Reason.LEADS_AN_OVERTAKE]
    leaders = [start for start in starts if start.request.number in lead]
    assert 1 <= len(leaders) == len(lead) <= len(overtakers)  # one may lead two
    assert lead[0] == 5
    filling = Filling(Surroundings(scene_of(agents=1, **ALONE)), (0, 0))
    (start,) = filling.first_starts(1)
    assert start.request.policy is Policy.STRAIGHT
    assert [unmet.reason for unmet in filling.unmet] == [Reason.NO_SLOW_LEADER]


def test_motion_continued_from_a_step_is_the_same_motion() -> None:
    """What the driver keeps in mind goes on: cut at 2.0 s, the rest is driven as without the cut."""
    sites = sites_of(scene_of())
    leader, _ = sites.propose(OVERTAKE, SLOW)
    world = _world(sites)
    whole = world.roll(leader)
    rest = world.roll(leader, path=leader.path, step=20, before=whole)
    np.testing.assert_allclose(rest.s, whole.s[20:], atol=1e-9)
    np.testing.assert_allclose(rest.v, whole.v[20:], atol=1e-9)
