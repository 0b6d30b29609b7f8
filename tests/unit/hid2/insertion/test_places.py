"""What the map alone says about where a vehicle of a policy may start."""

from collections.abc import Callable

import numpy as np
import pytest

from hid2.agents import BoxSize, Policy
from hid2.insertion.draws import Draws
from hid2.insertion.foresight import Wish
from hid2.insertion.places import Places
from hid2.params import Config
from hid2.scene import build_world
from netconvert.cells import build_cell_grid
from netconvert.lane_graph import LaneGraph, LaneSegment


@pytest.fixture
def places() -> Callable[..., Places]:
    """places(graph, packed=False) on an empty scene."""

    def make(graph: LaneGraph, *, packed: bool = False) -> Places:
        world = build_world(build_cell_grid(graph), (), config=Config(), num_steps=110, last_observed_step=49)
        return Places(world, Draws(np.random.default_rng(0)), packed)

    return make


@pytest.fixture
def corner(lane: Callable[..., LaneSegment]) -> Callable[..., LaneGraph]:
    """corner(radius): 60 m of lane 1, a left turn (2) of that radius in an intersection, 100 m of lane 3."""

    def make(radius: float) -> LaneGraph:
        angle = np.linspace(0.0, np.pi / 2, 30)
        turn = np.array([60.0, 0.0]) + radius * np.column_stack([np.sin(angle), 1 - np.cos(angle)])
        return LaneGraph({
            1: lane(1, [(0.0, 0.0), (60.0, 0.0)], successors=(2,)),
            2: lane(2, turn, successors=(3,), is_intersection=True),
            3: lane(3, [turn[-1], turn[-1] + [0.0, 100.0]]),
        })  # fmt: skip

    return make


def _wish(policy: Policy) -> Wish:
    return Wish(policy, "v1", "vehicle", BoxSize(4.2, 1.87), 2.0)


def test_lane_change_is_offered_where_a_lane_lies_beside_and_goes_on(
    places: Callable[..., Places], road: Callable[..., LaneGraph]
) -> None:
    """25 m of the lane beside must be left: 24 m offer none."""
    assert places(road()).offers(Policy.LANE_CHANGE)
    assert not places(road(lanes=1)).offers(Policy.LANE_CHANGE)
    assert not places(road(mark="SOLID_WHITE")).offers(Policy.LANE_CHANGE)
    assert places(road(length_m=26.0)).offers(Policy.LANE_CHANGE)
    assert not places(road(length_m=24.0)).offers(Policy.LANE_CHANGE)


def test_lane_change_needs_a_lane_beside_that_lasts(
    places: Callable[..., Places], lane: Callable[..., LaneSegment]
) -> None:
    """Beside 60 m of lane 1, which goes on for 100 m, lies lane 2 with 60 m to its end: 25 m of it must be left.

    A change may begin 8 m later than foreseen: the last place is at 27 m. At 10 m/s, triggered at 2 s, who starts at
    20 m may be as slow as .3 of that: 14 m further up, where 26 m are left, or 2 m less, since that is a rough figure.
    """
    found = places(LaneGraph({
        1: lane(1, [(0.0, 0.0), (60.0, 0.0)], successors=(3,), left=2),
        2: lane(2, [(0.0, 3.5), (60.0, 3.5)], right=1),
        3: lane(3, [(60.0, 0.0), (160.0, 0.0)]),
    }))  # fmt: skip
    way = found.world.way((1, 3))
    assert [found.lies_beside(way, s) for s in (0.0, 26.9, 27.1, 55.0)] == [True, True, False, False]

    def against(policy: Policy, s0: float) -> str | None:
        return found.unsuited(_wish(policy), way, s0, 10.0, 0)

    assert [against(Policy.LANE_CHANGE, s0) for s0 in (20.0, 22.9)] == [None, None]
    assert against(Policy.LANE_CHANGE, 23.1) == "no_lane_beside_at_trigger"
    assert against(Policy.OVERTAKE, 23.1) != "no_lane_beside_at_trigger"


def test_overtake_needs_two_lanes_side_by_side_for_long_enough(
    places: Callable[..., Places], road: Callable[..., LaneGraph], lane: Callable[..., LaneSegment]
) -> None:
    """65 m, which may be made of several lane segments one after the other."""
    assert places(road(length_m=66.0)).offers(Policy.OVERTAKE)
    assert not places(road(length_m=64.0)).offers(Policy.OVERTAKE)
    assert not places(road(lanes=1)).offers(Policy.OVERTAKE)
    pieces = LaneGraph({
        1: lane(1, [(0.0, 0.0), (30.0, 0.0)], successors=(3,), left=2),
        2: lane(2, [(0.0, 3.5), (30.0, 3.5)], successors=(4,), right=1),
        3: lane(3, [(30.0, 0.0), (70.0, 0.0)], left=4),
        4: lane(4, [(30.0, 3.5), (70.0, 3.5)], right=3),
    })  # fmt: skip
    assert places(pieces).offers(Policy.OVERTAKE)


def test_turn_tighter_than_a_car_can_follow_is_not_offered(
    places: Callable[..., Places], corner: Callable[..., LaneGraph]
) -> None:
    """R_min is 5 m; the line may cut a corner by up to 0.9 m, so that 12 m pass and 2 m do not."""
    assert places(corner(12.0)).offers(Policy.LEFT_TURN)
    assert not places(corner(12.0)).offers(Policy.RIGHT_TURN)
    assert not places(corner(2.0)).offers(Policy.LEFT_TURN)


def test_candidates_lie_on_free_cells_only_and_lead_into_the_turn(
    places: Callable[..., Places], corner: Callable[..., LaneGraph]
) -> None:
    some = places(corner(12.0))
    free = {0, 1, 2, 3}
    found = list(some.candidates(Policy.LEFT_TURN, free.__contains__, 0))
    taken = [place for place in found if place is None]
    given = [place for place in found if place is not None]
    on_lane_1_and_3 = some.world.grid.count(1) + some.world.grid.count(3)
    assert len(taken) == on_lane_1_and_3 - len(free)
    assert len(given) == len(free)
    for way, s0 in given:
        assert way.route == (1, 2, 3)
        assert 0.0 <= s0 <= 16.0


def test_packed_candidates_come_from_the_exit_backwards(
    places: Callable[..., Places], road: Callable[..., LaneGraph]
) -> None:
    some = places(road(lanes=1), packed=True)
    starts = [place[1] for place in some.candidates(Policy.STRAIGHT, lambda _: True, 2) if place is not None]
    cells = [int(s0 / 4.0) for s0 in starts]
    assert cells == sorted(cells, reverse=True)


@pytest.mark.parametrize(
    ("policy", "s0", "reason"),
    [
        (Policy.STRAIGHT, 1.0, "no_room_on_lane"),
        (Policy.STRAIGHT, 199.0, "no_room_on_lane"),
        (Policy.STRAIGHT, 190.0, "leaves_too_early"),
        (Policy.STRAIGHT, 100.0, None),
        (Policy.LANE_CHANGE, 100.0, "no_lane_beside_at_trigger"),
    ],
)
def test_map_speaks_against_places_without_room(
    places: Callable[..., Places], road: Callable[..., LaneGraph], policy: Policy, s0: float, reason: str | None
) -> None:
    """One lane of 200 m, 10 m/s: at 190 m the vehicle is off the map before the last observed step."""
    some = places(road(lanes=1))
    assert some.unsuited(_wish(policy), some.world.way((1,)), s0, 10.0, 0) == reason


def test_routes_begin_where_the_lanes_come_from(
    places: Callable[..., Places], corner: Callable[..., LaneGraph]
) -> None:
    """Places on lanes 1, 2 and 3 are all on the route 1 - 2 - 3, and s0 counts from the start of lane 1."""
    found = places(corner(12.0))
    length = {lane_id: lane.length_m for lane_id, lane in found.world.grid.graph.lanes.items()}
    start = {1: 0.0, 2: length[1], 3: length[1] + length[2]}
    taken = [place for place in found.candidates(Policy.STRAIGHT, lambda _: True, 1) if place is not None]
    assert {way.route for way, _ in taken} == {(1, 2, 3)}
    on = [way.on_lane(s0)[0] for way, s0 in taken]
    assert set(on) == {1, 2, 3}
    for lane_id, (_, s0) in zip(on, taken, strict=True):
        assert start[lane_id] <= s0 <= start[lane_id] + length[lane_id]


def test_route_goes_back_no_farther_than_it_must(
    places: Callable[..., Places], lane: Callable[..., LaneSegment]
) -> None:
    """Ten lanes of 40 m in a row: from the last one 150 m back are four lanes."""
    row = LaneGraph({
        i: lane(i, [(40.0 * i, 0.0), (40.0 * i + 40.0, 0.0)], successors=(i + 1,) if i < 9 else ()) for i in range(10)
    })  # fmt: skip
    routes = {
        place[0].route for place in places(row).candidates(Policy.STRAIGHT, lambda _: True, 1) if place is not None
    }
    assert (5, 6, 7, 8, 9) in routes
    assert max(len(route) for route in routes) <= 4 + 7  # onward, a route ends behind 260 m
