from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from hid2.agents import BoxSize, Policy, Track
from hid2.insertion import screening, spawning
from hid2.insertion.draws import Draws
from hid2.insertion.foresight import Wish
from hid2.insertion.places import Places
from hid2.insertion.screening import Candidate, Screening
from hid2.insertion.spawning import Spawner
from hid2.insertion.starts import Start
from hid2.motion.route import Way
from hid2.motion.smoothing import Trajectory
from hid2.motion.verify import first_overlap
from hid2.params import Config, Request
from hid2.scene import PlannedVehicle, build_world, predicted_traffic
from netconvert.cells import build_cell_grid
from netconvert.lane_graph import LaneGraph, LaneSegment


@pytest.fixture
def spawner(road: Callable[..., LaneGraph]) -> Callable[..., Spawner]:
    """spawner(*tracks, graph=None, seed=0, request={...}) on a straight two-lane road of 200 m."""

    def make(
        *tracks: Track,
        graph: LaneGraph | None = None,
        seed: int = 0,
        request: dict[str, Any] | None = None,
        packed: bool = False,
        **shape: Any,
    ) -> Spawner:
        config = Config(request=Request(**(request or {})))
        grid = build_cell_grid(graph or road(**shape))
        world = build_world(grid, tracks, config=config, num_steps=110, last_observed_step=49)
        world = world.packed() if packed else world
        return Spawner(Places(world, Draws(np.random.default_rng(seed)), packed), predicted_traffic([], 110))

    return make


@pytest.fixture
def bend(lane: Callable[..., LaneSegment]) -> LaneGraph:
    """A straight lane of 60 m, a left turn of radius 12 m in an intersection, a straight lane of 100 m northwards."""
    angle = np.linspace(0.0, np.pi / 2, 20)
    turn = np.array([60.0, 0.0]) + 12.0 * np.column_stack([np.sin(angle), 1 - np.cos(angle)])
    return LaneGraph({
        1: lane(1, [(0.0, 0.0), (60.0, 0.0)], successors=(2,)),
        2: lane(2, turn, successors=(3,), is_intersection=True),
        3: lane(3, [turn[-1], turn[-1] + [0.0, 100.0]]),
    })  # fmt: skip


def _fill(spawner: Spawner, count: int, policy: Policy = Policy.STRAIGHT) -> list[PlannedVehicle]:
    found = [spawner.spawn(policy, f"v{k}", attempts=80) for k in range(count)]
    return [vehicle for vehicle in found if vehicle is not None]


def _planned(vehicle: PlannedVehicle) -> Trajectory:
    line, s = vehicle.path.line, vehicle.plan_s
    end = int((s <= vehicle.path.exit_s).sum())
    return Trajectory(line.position(s)[:end], line.heading(s)[:end], np.zeros((end, 2)), s[:end])


def _meets_recorded(spawner: Spawner, vehicle: PlannedVehicle) -> bool:
    return first_overlap(_planned(vehicle), vehicle.size, spawner.world.traffic, margin_m=0.0) is not None


def test_vehicles_fill_an_empty_road_without_meeting_each_other(spawner: Callable[..., Spawner]) -> None:
    one = spawner()
    vehicles = _fill(one, 8)
    assert len(vehicles) >= 6
    for place, vehicle in enumerate(vehicles):
        others = predicted_traffic([(v.vehicle_id, v.path, v.size, v.plan_s) for v in vehicles[:place]], 110)
        assert first_overlap(_planned(vehicle), vehicle.size, others, margin_m=0.0) is None


def test_nobody_is_placed_where_a_recorded_track_appears_later(
    spawner: Callable[..., Spawner], track: Callable[..., Track]
) -> None:
    """Parked vehicles that the tracker sees only from step 40 on: their place looks free at step 0."""
    late = [
        track(range(40, 110), np.full(70, x), y, track_id=f"{x}{y}") for x in (40.0, 90.0, 140.0) for y in (0.0, 3.5)
    ]
    one = spawner(*late)
    vehicles = _fill(one, 6)
    assert vehicles
    assert not any(_meets_recorded(one, vehicle) for vehicle in vehicles)


def test_nobody_is_placed_before_who_comes_fast_from_behind(
    spawner: Callable[..., Spawner], track: Callable[..., Track]
) -> None:
    """A recorded car enters at 16 m/s on each lane and brakes for nobody."""
    fast = [track(range(110), -30.0 + 1.6 * np.arange(110), y, track_id=str(y)) for y in (0.0, 3.5)]
    one = spawner(*fast)
    assert not any(_meets_recorded(one, vehicle) for vehicle in _fill(one, 6))


def test_speed_belongs_to_the_traffic_of_the_lane(spawner: Callable[..., Spawner], track: Callable[..., Track]) -> None:
    """Recorded traffic at 6 m/s: nobody cruises at the prior of 9, but for 10 % of noise around 6."""
    vehicles = _fill(spawner(track(range(110), 150.0 + 0.6 * np.arange(110), 0.0)), 6)
    assert vehicles
    assert all(4.0 <= vehicle.cruise_mps <= 8.0 for vehicle in vehicles)


def test_left_turn_is_planned_onto_a_route_that_turns_and_is_reached(
    spawner: Callable[..., Spawner], bend: LaneGraph
) -> None:
    vehicle = spawner(graph=bend).spawn(Policy.LEFT_TURN, "v1", attempts=80)
    assert vehicle is not None
    turn = next(segment for segment in vehicle.path.segments if segment.lane_id == 2)
    assert vehicle.s0 < turn.start
    assert vehicle.plan_s[-1] > turn.end


def test_map_without_a_turn_offers_none(spawner: Callable[..., Spawner]) -> None:
    one = spawner()
    assert one.spawn(Policy.RIGHT_TURN, "v1", attempts=20) is None
    assert one.why_none(Policy.RIGHT_TURN) == "map_offers_no_right_turn"


def test_planned_lane_change_is_foreseen_on_both_lanes(spawner: Callable[..., Spawner]) -> None:
    vehicles = _fill(spawner(length_m=300.0), 3, Policy.LANE_CHANGE)
    assert vehicles
    for vehicle in vehicles:
        assert len(vehicle.intended_path.shifts) == 1
        assert vehicle.intended_s[-1] > vehicle.intended_path.shifts[0][1]
        assert len(vehicle.sides) == 2


def test_overtake_brings_its_slower_leader_along(spawner: Callable[..., Spawner]) -> None:
    """No traffic on 400 m of road: the leader is spawned as well, ahead on the same lane and slower."""
    found = spawner(length_m=400.0).spawn_overtake("v1", "v2", attempts=80)
    assert len(found) == 2
    overtaker, leader = found
    assert leader.s0 > overtaker.s0
    assert leader.cruise_mps < overtaker.cruise_mps
    assert (overtaker.policy, leader.policy) == (Policy.OVERTAKE, Policy.STRAIGHT)


def test_overtaker_starts_behind_its_leader_passes_and_comes_back(spawner: Callable[..., Spawner]) -> None:
    """The whole of it is foreseen: out and back on the intended path, the leader's box behind at the end."""
    one = spawner(length_m=400.0)
    overtaker, leader = one.spawn_overtake("v1", "v2", attempts=80)
    assert one.led_by == {"v1": "v2"}
    assert len(overtaker.intended_path.shifts) == 2
    assert overtaker.intended_s[-1] > overtaker.intended_path.shifts[1][1]
    assert overtaker.sides in {("left", "right"), ("right", "left")}
    ahead = overtaker.intended_path.line.position(overtaker.intended_s[-1:])[0]
    behind = leader.path.line.position(leader.plan_s[-1:])[0]
    assert ahead[0] - behind[0] > 0.5 * (overtaker.size.length_m + leader.size.length_m)
    assert ahead[1] == pytest.approx(behind[1], abs=0.3)


def test_leader_whose_overtaker_finds_no_way_leaves_no_trace(spawner: Callable[..., Spawner]) -> None:
    """From 6 s on the scene is too short for out and back: no vehicle stays planned and no cell stays taken."""
    one = spawner(length_m=400.0, request={"trigger_min_s": 6.0, "trigger_max_s": 6.0})
    before = one._sigma.copy()
    assert one.spawn_overtake("v1", "v2", attempts=60) == ()
    assert one.reasons["overtake_scene_too_short"] > 0
    assert np.array_equal(one._sigma, before)
    assert not one.planned


def test_overtake_without_a_leader_fails_where_none_may_be_spawned(spawner: Callable[..., Spawner]) -> None:
    """No id for a leader: none is wanted."""
    one = spawner(length_m=400.0)
    assert one.spawn_overtake("v1", None, attempts=40) == ()
    assert one.reasons
    assert not one.planned


def test_trigger_is_drawn_from_the_range_asked_for(spawner: Callable[..., Spawner]) -> None:
    one = spawner(request={"trigger_min_s": 1.0, "trigger_max_s": 2.0})
    assert all(1.0 <= vehicle.trigger_s <= 2.0 for vehicle in _fill(one, 6))
    fixed = spawner(request={"trigger_min_s": 1.5, "trigger_max_s": 1.5})
    assert {vehicle.trigger_s for vehicle in _fill(fixed, 4)} == {1.5}


@pytest.mark.parametrize(
    ("request_", "object_type", "shortest", "longest"),
    [({}, "vehicle", 3.8, 5.6), ({"bus_share": 1.0}, "bus", 10.5, 12.3), ({"truck_share": 1.0}, "vehicle", 7.0, 10.5)],
)
def test_sizes_are_drawn_from_real_labels(
    request_: dict[str, Any], object_type: str, shortest: float, longest: float, spawner: Callable[..., Spawner]
) -> None:
    """The exported box has the label's size; the one that is kept clear is no smaller than what readers assume."""
    vehicles = _fill(spawner(request=request_), 5)
    assert vehicles
    for vehicle in vehicles:
        assert vehicle.object_type == object_type
        assert shortest <= vehicle.own_size.length_m <= longest
        assert vehicle.size.length_m >= vehicle.own_size.length_m
        assert vehicle.size.width_m >= vehicle.own_size.width_m


def test_same_generator_plans_the_same(spawner: Callable[..., Spawner]) -> None:
    first, second, other = (_fill(spawner(seed=seed), 5) for seed in (3, 3, 4))
    assert [v.s0 for v in first] == [v.s0 for v in second]
    assert [v.s0 for v in first] != [v.s0 for v in other]


def test_full_road_turns_vehicles_down_with_reasons(
    spawner: Callable[..., Spawner], track: Callable[..., Track]
) -> None:
    """Bumper to bumper on both lanes."""
    jam = [track(range(110), np.full(110, 5.0 * k), y, track_id=f"{k}{y}") for k in range(41) for y in (0.0, 3.5)]
    one = spawner(*jam)
    assert _fill(one, 3) == []
    assert sum(one.reasons.values()) > 0


def test_nobody_starts_with_hard_braking_where_a_slower_start_is_possible(
    spawner: Callable[..., Spawner], track: Callable[..., Track]
) -> None:
    """Behind a car that brakes from 12 m/s to a stop within 18 m: whoever is near was slower already.

    Braking harder than 2.5 m/s2 is never needed then, though at the speed of the traffic there it would be.
    """
    time = np.minimum(0.1 * np.arange(110), 3.0)
    stops = track(range(110), 60.0 + 12.0 * time - 2.0 * time**2, 0.0)
    found = [spawner(stops, lanes=1, seed=seed).spawn(Policy.STRAIGHT, "v0", attempts=80) for seed in range(40)]
    vehicles = [vehicle for vehicle in found if vehicle is not None]
    assert len(vehicles) >= 20
    for vehicle in vehicles:
        assert np.diff(vehicle.plan_v[:21]).min() > -0.25 - 1e-9


def test_new_vehicle_does_not_make_the_one_behind_brake_at_once(spawner: Callable[..., Spawner]) -> None:
    """Without patience, a generated follower keeps the safe speed of its car following, eased off by 1 m/s at most."""
    one = spawner(lanes=1, seed=3)
    vehicles = sorted((v for v in _fill(one, 8) if one.patience == 0), key=lambda v: v.s0)
    assert len(vehicles) >= 3
    for follower, leader in pairwise(vehicles):
        gap = leader.s0 - follower.s0 - (leader.size.length_m + follower.size.length_m) / 2 - 1.5
        safe = -2.5 + np.sqrt(2.5**2 + leader.v0**2 + 2 * 2.5 * max(gap, 0.0))
        assert follower.v0 <= safe + 1.0 + 0.5


def test_cells_that_are_not_tried_are_too_near_wherever_one_starts(
    spawner: Callable[..., Spawner], track: Callable[..., Track]
) -> None:
    """A car stands at x = 100. Centres nearer than 4.5 m of boxes and 3 m of gap to it, less 0.3 m, are turned down.

    Of cells of 4 m, those that lie wholly within 92.8 .. 107.2 m are not tried: 96-100 and 100-104.
    """
    one = spawner(track(range(110), np.full(110, 100.0), 0.0), lanes=2)
    grid = one.world.grid
    tried = [cell for _ in range(6) for way, s0 in _tried(one) if (cell := (way.route[-1], int(s0 / 4.0)))[0] == 1]
    assert {24, 25}.isdisjoint(index for _, index in tried)
    assert {22, 27} <= {index for _, index in tried}
    assert grid.count(1) == 50


def _tried(spawner: Spawner) -> list[tuple[Way, float]]:
    return [place for place in spawner.places.candidates(Policy.STRAIGHT, spawner._is_free, 0) if place is not None]


def test_lane_change_is_triggered_where_a_lane_lies_beside(
    spawner: Callable[..., Spawner], lane: Callable[..., LaneSegment]
) -> None:
    """Beside lane 1 of 90 m lies lane 2; behind both, lanes of 90 m that are no neighbours.

    The trigger is drawn from 1 to 4 s, nearly always such that the lane is still beside then: at 0.9 of the desired
    speed, 8 m before the end of lane 1.
    """
    graph = LaneGraph({
        1: lane(1, [(0.0, 0.0), (90.0, 0.0)], successors=(3,), left=2),
        2: lane(2, [(0.0, 3.5), (90.0, 3.5)], successors=(4,), right=1),
        3: lane(3, [(90.0, 0.0), (180.0, 0.0)]),
        4: lane(4, [(90.0, 3.5), (180.0, 3.5)]),
    })  # fmt: skip
    beside = 0
    found = [
        spawner(graph=graph, seed=seed, request={"trigger_min_s": 1.0, "trigger_max_s": 4.0}).spawn(
            Policy.LANE_CHANGE, "v0", attempts=40
        )
        for seed in range(30)
    ]
    vehicles = [vehicle for vehicle in found if vehicle is not None]
    assert len(vehicles) >= 25
    for vehicle in vehicles:
        assert 1.0 <= vehicle.trigger_s <= 4.0
        beside += vehicle.s0 + 0.9 * vehicle.cruise_mps * vehicle.trigger_s + 8.0 < 90.0
    assert beside >= 0.8 * len(vehicles)


def test_nobody_slows_down_at_the_edge_of_the_map(spawner: Callable[..., Spawner]) -> None:
    """Nobody may leave before step 51. On a road of 60 m those who start late would have to wait at its end."""
    left = 0
    for seed in range(25):
        one = spawner(lanes=1, length_m=60.0, seed=seed)
        one.patience = 1
        for vehicle in _fill(one, 2):
            edge = vehicle.path.exit_s - vehicle.size.length_m / 2
            near = (vehicle.plan_s > edge - 6.0) & (vehicle.plan_s <= edge)
            if vehicle.plan_s[-1] > edge:
                left += 1
                assert vehicle.plan_v[near].min(initial=np.inf) >= 2.0
    assert left >= 10


def test_places_that_one_vehicle_did_not_need_are_offered_to_the_next(
    spawner: Callable[..., Spawner], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 32 candidates looked at in one go the first possible one is taken; the others are not lost."""
    monkeypatch.setattr(spawning, "_SCREENED_LATER", 32)
    one = spawner(lanes=1)
    one.patience = 1
    assert len(_fill(one, 12)) >= 8


def test_full_road_has_room_for_more_with_closer_gaps(spawner: Callable[..., Spawner]) -> None:
    one = spawner(lanes=1, seed=2)
    before = _fill(one, 40)
    one.look_again()
    one.look_again()
    before += _fill(one, 10)
    one.close_up(one.world.packed())
    one.look_again()
    after = _fill(one, 10)
    assert len(before) >= 6
    assert after
    boxes = predicted_traffic([(v.vehicle_id, v.path, v.size, v.plan_s) for v in before], 110)
    assert all(first_overlap(_planned(v), v.size, boxes, margin_m=0.0) is None for v in after)


def test_packed_vehicles_begin_close_behind_one_another(
    spawner: Callable[..., Spawner], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A place that is taken is tried a little further back: over ten seeds more of them fit on the road."""

    def placed() -> int:
        count = 0
        for seed in range(10):
            one = spawner(lanes=1, seed=seed, packed=True)
            one.patience = 2
            count += len(_fill(one, 40))
        return count

    with_moves = placed()
    monkeypatch.setattr(screening, "_BACK_M", ())
    assert with_moves > placed()


def test_what_was_seen_before_the_last_vehicles_turns_down_nobody_who_might_start(
    spawner: Callable[..., Spawner], track: Callable[..., Track]
) -> None:
    """Looks from before vehicles were added, and looks taken now, say the same of every place of a road in use."""
    slow = track(range(110), 90.0 + 0.4 * np.arange(110), 0.0)
    one = spawner(slow, lanes=1, seed=5)
    wish = Wish(Policy.STRAIGHT, "v9", "vehicle", BoxSize(4.5, 1.9), 0.0, 8.0, steady=True)
    answers = []
    for _ in range(4):
        places = [Candidate(wish, one.world.way((1,)), s0, 8.0, 8.0) for s0 in np.arange(6.0, 180.0, 3.0)]
        kept, anew = (
            screen.starts(places, one._ahead, one._sigma, 0) for screen in (one._screening, Screening(one.places))
        )
        assert [isinstance(start, str) for start in kept] == [isinstance(start, str) for start in anew]
        answers.append(sum(isinstance(start, Start) for start in anew))
        _fill(one, 1)
    assert answers[0] > answers[-1] > 0
