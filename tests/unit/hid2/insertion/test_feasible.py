"""What a scene cannot meet, known before anything is driven."""

from dataclasses import replace

import pytest
from hand_drawn import draw_road
from inserted import recorded, scene_on

from hid2.insertion.feasible import impossible
from hid2.params import Config, Event
from netconvert.lane_graph import LaneGraph


def _refused(graph: LaneGraph, event: Event, category: int = 1) -> dict[str, str]:
    fragment = replace(recorded(20.0, 0.0, 8.0, name="b"), category=category)
    scene = scene_on(graph, recorded(50.0, 0.0, 8.0, name="a"), fragment)
    return impossible(replace(scene, config=Config(event=(event,))), ())


@pytest.mark.parametrize(("kind", "last_s"), [("cut_in", -0.5), ("overtake", -0.2), ("lead", 0.5)])
def test_moment_is_refused_from_which_on_it_cannot_come_about(kind: str, last_s: float) -> None:
    """A quarter of 3.7 s is left when it crosses (of an overtake .68 of that), half a second is spare: .43 s, .13 s."""
    graph = draw_road(lanes=2, length_m=400.0)
    at_s = last_s + scene_on(graph, recorded(50.0, 0.0, 8.0)).last_s
    events = [Event.model_validate({"kind": kind, "target": "a", "at_s": s}) for s in (at_s, at_s + 0.1)]
    assert [bool(_refused(graph, event)) for event in events] == [False, True]


def test_target_is_not_there_or_cannot_be_one_and_those_that_can_are_listed() -> None:
    asked, graph = [("ghost", 1), ("b", 0), ("a", 0)], draw_road(lanes=2, length_m=400.0)
    there, fragment, target = ([*_refused(graph, Event(kind="lead", target=n), k).values()] for n, k in asked)
    said = "vehicles that move on a lane, but for tracker fragments"
    assert there == [f"not there, expected av, focal, any or one of its 2 {said} (a, b)"]
    assert fragment[0].startswith("not moving, on no lane, no vehicle, a tracker fragment, or")
    assert (fragment[0].endswith(f"one of its 1 {said} (a)"), target) == (True, [])
