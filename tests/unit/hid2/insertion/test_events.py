"""Events and the vehicles that are inserted after them."""

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
from hand_drawn import draw_road
from inserted import recorded, scene_on

from hid2.agents import Track
from hid2.insertion.event_objective import Seen
from hid2.insertion.events import EventOutcome, SceneEvents, comes_between
from hid2.insertion.finalise import states_of_inserted
from hid2.judge.events import EventMeasures
from hid2.params import Event
from hid2.reasons import Reason
from hid2.scene import Scene


@pytest.mark.parametrize(("kind", "own", "x", "y", "between"), [
    ("lead", 120.0, 110.0, 0.0, True), ("lead", 120.0, 110.0, 3.5, False), ("lead", 120.0, 130.0, 0.0, False),
    ("follow", 80.0, 90.0, 0.0, True), ("merge", 120.0, 110.0, 0.0, False),
])  # fmt: skip
def test_vehicle_that_comes_between_a_leader_and_its_follower_breaks_the_event(
    kind: str, own: float, x: float, y: float, between: bool
) -> None:
    """The target is at 100 m, all at 8 m/s: one that is beside, or ahead of both, is in the way of none."""
    scene = scene_on(draw_road(lanes=2, length_m=400.0), recorded(100.0, 0.0, 8.0))
    measures = EventMeasures(15.5, 0.0, None, None, None, None, 0.0, 0.0)
    seen = Seen(30, -1 if kind == "follow" else 1, measures)
    event = Event.model_validate({"kind": kind, "target": "r", "at_s": (3.0, 3.0)})
    found = EventOutcome(event, target_id="r", vehicle=_vehicle(scene, recorded(own, 0.0, 8.0, name="e")), seen=seen)
    assert comes_between(scene, found, _vehicle(scene, recorded(x, y, 8.0, name="v"))) is between


def test_what_most_candidates_fail_by_is_told_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """Most are drawn where they come too late or too early, and that is what is told."""

    def likely(_: SceneEvents, *given: Any) -> Iterator[Any]:
        given[-1].update({Reason.LEAVES_TOO_EARLY: 276, Reason.EVENT_NOT_THERE: 1500})
        yield from ()

    monkeypatch.setattr(SceneEvents, "likely", likely)
    scene = scene_on(draw_road(lanes=2, length_m=400.0), recorded(100.0, 0.0, 8.0))
    here, event = SimpleNamespace(scene=scene), Event.model_validate({"kind": "lead", "target": "r"})
    found = SceneEvents(here, (0,)).search(event, 0, drive=None)
    assert found.reason is Reason.EVENT_NOT_FORESEEN
    assert list(found.tried) == [Reason.EVENT_NOT_THERE, Reason.LEAVES_TOO_EARLY]


def _vehicle(scene: Scene, track: Track) -> Any:
    driven = SimpleNamespace(vehicle_id=track.track_id)
    return SimpleNamespace(track=lambda *_: track, states=states_of_inserted(scene, track), driven=driven)
