"""Events in synthetic scenes, as the second checker sees them in the exported positions."""

from pathlib import Path

import numpy as np
import pytest
from judged import check_generated

from bridge import prepare, read_scene
from bridge.generation.generate import PreparedScene, generate
from bridge.generation.scene import TrafficScene
from bridge.recordings.judging import findings_of, recording_states
from hid2.insertion.event_objective import Objective
from hid2.insertion.events import SceneEvents
from hid2.judge.findings import allowed_to
from hid2.params import Config, Drivers, Event, EventSearch, Request
from hid2.reasons import Reason
from hid2.vehicle import DrivenVehicle

#: A track that drives 5 m/s.
SLOW = "310114"


@pytest.fixture(scope="module")
def arterial(data_scenes: dict[str, Path]) -> PreparedScene:
    """The scene of the wide road: three lanes one way."""
    return prepare(read_scene(data_scenes["arterial"]), Config())


def made(prepared: PreparedScene, *events: dict[str, object], candidates: int = 1500, seed: int = 2) -> TrafficScene:
    """The scene with events alone, before the recording vehicle if nothing else is said; no driver's wish wanders."""
    asked = tuple(Event.model_validate({"kind": "cut_in", "target": "av", **event}) for event in events)
    search, drivers = EventSearch(candidates=candidates), Drivers(desired_mean=1.0, wander_sd_mps=0.0)
    request = Request(agents=0, seed=seed)
    return generate(prepared, Config(request=request, drivers=drivers, event=asked, event_search=search))


@pytest.mark.parametrize("kind", ["cross", "merge", "follow"])
def test_event_is_seen_where_roads_meet(data_scenes: dict[str, Path], kind: str) -> None:
    scene = made(prepare(read_scene(data_scenes["intersection"]), Config()), {"kind": kind, "target": "any"})
    assert [one.status for one in scene.sidecar.events] == ["done"]
    assert check_generated(scene) == []


@pytest.mark.parametrize(
    "asked",
    [
        {"at_s": (2.0, 7.0), "ttc_s": (2.0, 4.0)},
        {"kind": "overtake", "target": SLOW, "at_s": (4.0, 10.0)},
        {"kind": "lead", "target": "any", "at_s": (3.0, 6.0), "brakes_mps2": 4.0},
    ],
    ids=["cut-in", "overtake", "leader that brakes"],
)
def test_event_is_as_asked_in_the_exported_positions(arterial: PreparedScene, asked: dict[str, object]) -> None:
    """At the time asked for, +- 0.5 s, with the gap noted, bumper to bumper; as critical, and braking as hard.

    Within a fifth, and not before the moment.
    """
    scene = made(arterial, asked)
    (event,) = scene.sidecar.events
    assert event.status == "done", event.reason
    assert check_generated(scene) == []
    low, high = asked["at_s"]
    assert low - 0.5 <= event.at_s <= high + 0.5
    (own,), at, target = scene.generated, round(event.at_s * 10), scene.source.track(event.target_track_id)
    apart = float(np.hypot(*(own.position[at] - target.position[target.timesteps == at][0])))
    assert apart - 0.5 * (own.size.length_m + target.size.length_m) == pytest.approx(event.gap_m, abs=1.0)
    if "ttc_s" in asked:
        assert 2.0 <= event.min_ttc_s <= 4.0
    if "brakes_mps2" in asked:
        braking = -np.gradient(np.hypot(*np.gradient(own.position, 0.1, axis=0).T), 0.1)
        assert 3.15 <= braking[at:].max() <= 4.1
        assert braking[: at - 6].max() < 2.0 < braking[: at + 7].max()
        assert event.brakes_mps2 == pytest.approx(braking[at:].max(), abs=0.2)


def test_a_criticality_is_asked_of_the_target_alone(arterial: PreparedScene, monkeypatch: pytest.MonkeyPatch) -> None:
    """A TTC below the critical 1.5 s: with another target it is a finding, and where none is allowed none is made."""
    asked = {"kind": "lead", "target": "any", "ttc_s": (0.3, 1.4)}
    scene = made(arterial, asked, seed=10)
    assert scene.judge().empty
    events = [one.model_copy(update={"target_track_id": "other"}) for one in scene.sidecar.events]
    sidecar = scene.sidecar.model_copy(update={"events": events})
    assert "ttc_recorded_follower" in {one.quantity for one in findings_of(recording_states(scene.recording), sidecar)}
    monkeypatch.setattr("hid2.insertion.events.allowed_to", lambda target_id, _: allowed_to(target_id, {}))
    assert made(arterial, asked, seed=10).sidecar.events[0].status == "not_feasible"


def test_what_the_tries_failed_by_is_told_for_each_event(arterial: PreparedScene) -> None:
    """No vehicle is 90 m/s faster than a target: none is driven. The second event has nothing of that reason."""
    too_fast = {"at_s": (4.0, 4.0), "speed_difference_mps": (90.0, 91.0)}
    first, second = made(arterial, too_fast, {"target": "nobody"}, candidates=200).sidecar.events
    assert (first.status, first.tries) == ("not_feasible", 0)
    assert first.reason == f"event_not_foreseen:{next(iter(first.tried))}"
    assert (second.reason, second.tried) == ("event_no_target", {})


def test_tries_that_were_driven_and_failed_are_counted_by_their_reason(
    arterial: PreparedScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    judge = SceneEvents._judged

    def fails(self: SceneEvents, objective: Objective, driven: DrivenVehicle) -> object:
        """Only what SUMO has driven, which has a name of its own."""
        return Reason.PET if driven.vehicle_id.startswith("e0_") else judge(self, objective, driven)

    monkeypatch.setattr(SceneEvents, "_judged", fails)
    (event,) = made(arterial, {}, candidates=300).sidecar.events
    assert event.tries > 1
    assert event.tried == {"pet": event.tries}
    assert (event.status, event.reason) == ("not_feasible", "event_not_as_asked:pet")


def test_no_vehicle_of_an_event_comes_between_those_of_one_before(arterial: PreparedScene) -> None:
    """One leads by 23 m at 6 s; another would lead by 5 m at 3 s, and still be between the two at 6 s.

    Alone it is the first candidate.
    """
    far = {"kind": "lead", "at_s": (6.0, 6.0), "gap_m": (15.0, 30.0)}
    near = {"kind": "lead", "at_s": (3.0, 3.0), "gap_m": (4.0, 10.0)}
    scene = made(arterial, far, near, candidates=200)
    assert [one.status for one in scene.sidecar.events] == ["done", "not_feasible"]
    assert scene.judge().empty
    (alone,) = made(arterial, near, candidates=200).sidecar.events
    assert alone.status == "done"
