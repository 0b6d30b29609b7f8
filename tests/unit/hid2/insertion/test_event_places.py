"""Places of events: on which routes, and where on them a vehicle has to be at which step."""

from dataclasses import replace

import numpy as np
import pytest
from hand_drawn import draw_lane, draw_road, graph_of
from inserted import recorded, scene_on

from hid2.agents import Track
from hid2.insertion.event_places import Place, Places
from hid2.insertion.event_targets import target_of
from hid2.insertion.routes import Routes
from hid2.params import Event
from netconvert.lane_graph import LaneGraph

#: Half of both lengths: the target and the vehicle are 4.5 m long.
LENGTHS_M = 4.5


def _places(graph: LaneGraph, track: Track, **asked: object) -> list[Place]:
    scene = scene_on(graph, track)
    target = target_of(scene, 0)
    assert target is not None
    event = Event.model_validate({"target": "r", "at_s": (4.0, 4.0), **asked})
    return list(Places(Routes(scene), event, target, LENGTHS_M).all())


@pytest.mark.parametrize(("kind", "beyond"), [("lead", (6.0 + 4.5, 12.0 + 4.5)), ("follow", (-12.0 - 4.5, -6.0 - 4.5))])
def test_leader_and_follower_are_a_gap_away_on_the_lane_of_the_target(kind: str, beyond: tuple[float, float]) -> None:
    """A target at 8 m/s from 100.5 m is at 132.5 m at 4 s; gaps of 6 to 12 m, bumper to bumper."""
    (place,) = _places(draw_road(lanes=2, length_m=400.0), recorded(100.5, 0.0, 8.0), kind=kind, gap_m=(6.0, 12.0))
    assert (place.offer.route, place.side) == ((1,), None)
    assert place.along[40] == pytest.approx(132.5, abs=0.1)
    assert np.flatnonzero(np.isfinite(place.along)).tolist() == list(range(36, 45))
    assert place.beyond == beyond


def test_cut_in_begins_on_the_lane_beside_and_overtake_behind_the_target_early_enough_to_be_back() -> None:
    """The target is on lane 1, so from lane 2 to the right. To be back at 8 s an overtake begins at 0 to 4 s and .4 s
    more, within 30 m behind.
    """
    (place,) = _places(draw_road(lanes=2, length_m=400.0), recorded(100.5, 0.0, 8.0), kind="cut_in")
    assert (place.offer.route, place.side) == ((2,), "right")
    assert place.along[40] == pytest.approx(132.5, abs=0.1)
    (place,) = _places(draw_road(lanes=2, length_m=600.0), recorded(60.5, 0.0, 4.0), kind="overtake", at_s=(8.0, 8.0))
    assert (place.offer.route, place.side) == ((1,), "left")
    assert np.flatnonzero(np.isfinite(place.along)).tolist() == list(range(45))
    assert place.beyond == (-30.0, -3.0)


def test_ways_meet_where_the_common_lane_begins_and_the_target_comes_there_by_its_own_way() -> None:
    """It comes from the north at 10 m/s, turns left at x = 80 m and is 20 m later where lane 2 from the west ends, too.

    At 2 s it has 10 m to its turn: 30 m to go, 10 m of them along its heading.
    """
    graph = graph_of(
        draw_lane(1, [(80.0, 100.0), (80.0, 0.0), (100.0, 0.0)], successors=(3,)),
        draw_lane(2, [(0.0, -9.0), (100.0, 0.0)], successors=(3,)), draw_lane(3, [(100.0, 0.0), (300.0, 0.0)]),
    )  # fmt: skip
    way = np.arange(110) - 30.0
    xy = np.column_stack([80.0 + np.maximum(way, 0.0), np.maximum(-way, 0.0)])
    turns = replace(recorded(60.0, 0.0, 10.0), position=xy, heading=np.where(way < 0.0, -np.pi / 2, 0.0))
    (place,) = _places(graph, turns, kind="merge", at_s=(2.0, 2.0), gap_m=(15.0, 35.0))
    assert place.offer.route == (2, 3)
    begin = next(one.start for one in place.path.segments if one.lane_id == 3)
    assert np.unique(place.along[np.isfinite(place.along)]).tolist() == [begin]
    assert np.isfinite(place.along[20])
    assert _places(graph, turns, kind="merge", at_s=(2.0, 2.0), gap_m=(0.0, 15.0)) == []


def test_a_path_is_crossed_apart_from_the_target_by_the_critical_pet() -> None:
    """Lane 9 along +y crosses at x = 150, 60 m along it; the target at 10 m/s from 50.5 m is there at 10 s.

    A vehicle may cross before it by at least 1 s, and at most 5 s with 2 s for the boxes.
    """
    graph = graph_of(draw_lane(1, [(0.0, 0.0), (300.0, 0.0)]), draw_lane(9, [(150.0, -60.0), (150.0, 60.0)]))
    (place,) = _places(graph, recorded(50.5, 0.0, 10.0), kind="cross", at_s=(2.0, 10.9))
    steps = np.flatnonzero(np.isfinite(place.along))
    assert place.offer.route == (9,)
    assert (steps[0], steps[-1]) == (30, 90)
    assert place.along[50] == pytest.approx(60.0, abs=0.1)


def test_routes_come_along_the_lanes_of_the_target_first_then_from_elsewhere_and_on_elsewhere() -> None:
    """Lanes 1 and 2 lead to 3, which leads to 4 and 5; the target comes by 2 and goes on by 5."""
    graph = graph_of(
        draw_lane(1, [(0.0, 0.0), (100.0, 0.0)], successors=(3,)),
        draw_lane(2, [(0.0, 40.0), (100.0, 0.0)], successors=(3,)),
        draw_lane(3, [(100.0, 0.0), (200.0, 0.0)], successors=(4, 5)), draw_lane(4, [(200.0, 0.0), (300.0, 0.0)]),
        draw_lane(5, [(200.0, 0.0), (300.0, 20.0)]),
    )  # fmt: skip
    scene = scene_on(graph, recorded(110.0, 0.0, 8.0))
    target = target_of(scene, 0)
    assert target is not None
    places = Places(Routes(scene), Event(kind="lead", target="r"), target, LENGTHS_M)
    assert places._over(3, (5,), (2,)) == [(2, 3, 5), (2, 3, 4), (1, 3, 5)]
