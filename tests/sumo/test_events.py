"""Events in a synthetic scene, seen in the exported positions."""

from pathlib import Path

import numpy as np
import pytest

from bridge import find_scenarios, generate, prepare, read_scene
from bridge.generation.generate import PreparedScene
from bridge.generation.scene import TrafficScene
from hid2.params import Config, Drivers, Event, EventSearch, Request
from netconvert.geometry import Polyline

#: A wide road: three lanes one way.
ARTERIAL = "c58d7c2e"
#: A track there that drives 5 m/s.
SLOW = "310114"


@pytest.fixture(scope="module")
def prepared(data_root: Path) -> PreparedScene:
    """The scene of the wide road."""
    folder = next(one for one in find_scenarios(data_root) if one.name.startswith(ARTERIAL))
    return prepare(read_scene(folder), Config())


def made(
    prepared: PreparedScene, *events: dict[str, object], drivers: Drivers | None = None, candidates: int = 1500
) -> TrafficScene:
    """The scene with events alone, before the recording vehicle if nothing else is said, and nothing else."""
    asked = tuple(Event.model_validate({"kind": "cut_in", "target": "av", **event}) for event in events)
    search = EventSearch(candidates=candidates)
    config = Config(request=Request(agents=0), drivers=drivers or Drivers(), event=asked, event_search=search)
    return generate(prepared, config)


def test_cut_in_comes_over_before_the_target_at_the_time_asked_for(prepared: PreparedScene) -> None:
    """At 4 s +- 0.5 s: a lane beside the target's way 1.7 s before, on it 1.7 s after, ahead by 4 to 30 m."""
    scene = made(prepared, {"at_s": (4.0, 4.0)})
    (event,) = scene.sidecar.events
    assert event.status == "done", event.reason
    assert event.at_s == pytest.approx(4.0, abs=0.5)
    own = scene.generated[0]
    target = next(track for track in scene.source.tracks if track.track_id == event.target_track_id)
    way = Polyline(target.position)
    at = round(event.at_s * 10)
    rows = [at - 17, at, at + 17]
    (own_m, own_d), (target_m, _) = way.frenet(own.position[rows]), way.frenet(target.position[rows])
    assert abs(own_d[0]) > 2.2
    assert abs(own_d[2]) < 1.3
    gap = own_m - target_m - 0.5 * (own.size.length_m + target.size.length_m)
    assert np.all((gap > 3.5) & (gap < 30.5))


def test_cut_in_has_the_criticality_asked_for(prepared: PreparedScene) -> None:
    """The smallest TTC of the target is within 2 to 4 s."""
    (event,) = made(prepared, {"at_s": (2.0, 7.0), "ttc_s": (2.0, 4.0)}).sidecar.events
    assert event.status == "done", event.reason
    assert event.min_ttc_s is not None
    assert 2.0 <= event.min_ttc_s <= 4.0


def test_overtake_passes_the_target_and_comes_back_before_it(prepared: PreparedScene) -> None:
    """Behind it at first, beside it in between, and ahead of it in its lane at the moment noted and after it."""
    scene = made(prepared, {"kind": "overtake", "target": SLOW})
    (event,) = scene.sidecar.events
    assert event.status == "done", event.reason
    assert event.ahead
    assert 3.5 <= event.at_s <= 10.5  # the usual time of an overtake, within half a second
    own = scene.generated[0]
    target = next(track for track in scene.source.tracks if track.track_id == event.target_track_id)
    way = Polyline(np.concatenate([target.position, own.position[-1:]]))
    (own_m, own_d), (target_m, _) = way.frenet(own.position), way.frenet(target.position)
    at, lengths_m = round(event.at_s * 10), 0.5 * (own.size.length_m + target.size.length_m)
    assert own_m[0] < target_m[0] - lengths_m
    assert np.max(np.abs(own_d[:at])) > 2.2
    assert own_m[at] - target_m[at] - lengths_m == pytest.approx(event.gap_m, abs=1.0)
    assert np.all(own_m[at:] - target_m[at:] > lengths_m)


@pytest.mark.parametrize("asked_mps2", [2.0, 4.0])
def test_leader_brakes_as_hard_as_is_asked_for(prepared: PreparedScene, asked_mps2: float) -> None:
    """Within a fifth, in the exported positions, and not before the moment: its wish does not wander."""
    asked = {"kind": "lead", "target": "any", "at_s": (3.0, 6.0), "brakes_mps2": asked_mps2}
    scene = made(prepared, asked, drivers=Drivers(desired_mean=1.0, wander_sd_mps=0.0))
    (event,) = scene.sidecar.events
    assert event.status == "done", event.reason
    speed = np.hypot(*np.gradient(scene.generated[0].position, 0.1, axis=0).T)
    braking = -np.gradient(speed, 0.1)
    at = round(event.at_s * 10)
    assert 0.8 * asked_mps2 - 0.05 <= braking[at:].max() <= asked_mps2 + 0.1
    assert braking[: at - 10].max() < 1.0
    assert event.brakes_mps2 == pytest.approx(braking[at:].max(), abs=0.2)


def test_what_the_tries_failed_by_is_told_for_each_event(prepared: PreparedScene) -> None:
    """No vehicle is 90 m/s faster than a target: none is driven. The second event has nothing of that reason."""
    too_fast = {"at_s": (4.0, 4.0), "speed_difference_mps": (90.0, 91.0)}
    first, second = made(prepared, too_fast, {"target": "nobody"}, candidates=200).sidecar.events
    assert (first.status, first.tries) == ("not_feasible", 0)
    assert first.reason == f"event_not_foreseen:{next(iter(first.tried))}"
    assert (second.reason, second.tried) == ("event_no_target", {})


def test_no_vehicle_of_an_event_comes_between_those_of_one_before(prepared: PreparedScene) -> None:
    """One leads by 23 m at 6 s; another would lead by 5 m at 3 s, and still be between the two at 6 s.

    Alone it is the first candidate.
    """
    far = {"kind": "lead", "at_s": (6.0, 6.0), "gap_m": (15.0, 30.0)}
    near = {"kind": "lead", "at_s": (3.0, 3.0), "gap_m": (4.0, 10.0)}
    scene = made(prepared, far, near, candidates=200)
    assert [one.status for one in scene.sidecar.events] == ["done", "not_feasible"]
    assert scene.judge().empty
    (alone,) = made(prepared, near, candidates=200).sidecar.events
    assert alone.status == "done"
