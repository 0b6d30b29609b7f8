"""Events in a synthetic scene, seen in the exported positions."""

from pathlib import Path

import numpy as np
import pytest

from bridge import find_scenarios, generate, prepare, read_scene
from bridge.generation.scene import TrafficScene
from hid2.params import Config, Drivers, Event, Request
from netconvert.geometry import Polyline

#: A wide road: three lanes one way.
ARTERIAL = "c58d7c2e"
#: A track there that drives 5 m/s.
SLOW = "310114"


def made(data_root: Path, *, drivers: Drivers | None = None, **asked: object) -> TrafficScene:
    """The scene of the wide road with one event before the recording vehicle, and nothing else."""
    folder = next(one for one in find_scenarios(data_root) if one.name.startswith(ARTERIAL))
    event = Event.model_validate({"kind": "cut_in", **asked})
    config = Config(request=Request(agents=0), drivers=drivers or Drivers(), event=(event,))
    return generate(prepare(read_scene(folder), config), config)


def test_cut_in_comes_over_before_the_target_at_the_time_asked_for(data_root: Path) -> None:
    """At 4 s +- 0.5 s: a lane beside the target's way 1.7 s before, on it 1.7 s after, ahead by 4 to 30 m."""
    scene = made(data_root, at_s=(4.0, 4.0))
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


def test_cut_in_has_the_criticality_asked_for(data_root: Path) -> None:
    """The smallest TTC of the target is within 1.5 to 3 s."""
    (event,) = made(data_root, at_s=(2.0, 7.0), ttc_s=(1.5, 3.0)).sidecar.events
    assert event.status == "done", event.reason
    assert event.min_ttc_s is not None
    assert 1.5 <= event.min_ttc_s <= 3.0


def test_overtake_passes_the_target_and_comes_back_before_it(data_root: Path) -> None:
    """Behind it at first, beside it in between, and ahead of it in its lane at the moment noted and after it."""
    scene = made(data_root, kind="overtake", target=SLOW)
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
def test_leader_brakes_as_hard_as_is_asked_for(data_root: Path, asked_mps2: float) -> None:
    """Within a fifth, in the exported positions, and not before the moment: its wish does not wander."""
    asked = {"kind": "lead", "target": "any", "at_s": (3.0, 6.0), "brakes_mps2": asked_mps2}
    scene = made(data_root, drivers=Drivers(wander_sd_mps=0.0), **asked)
    (event,) = scene.sidecar.events
    assert event.status == "done", event.reason
    speed = np.hypot(*np.gradient(scene.generated[0].position, 0.1, axis=0).T)
    braking = -np.gradient(speed, 0.1)
    at = round(event.at_s * 10)
    assert 0.8 * asked_mps2 - 0.05 <= braking[at:].max() <= asked_mps2 + 0.1
    assert braking[: at - 10].max() < 1.0
    assert event.brakes_mps2 == pytest.approx(braking[at:].max(), abs=0.2)


def test_what_the_tries_failed_by_is_told_for_each_event(data_root: Path) -> None:
    """No vehicle is 90 m/s faster than a target: none is driven. The second event has nothing of that reason."""
    folder = next(one for one in find_scenarios(data_root) if one.name.startswith(ARTERIAL))
    asked = (
        Event(kind="cut_in", target="av", at_s=(4.0, 4.0), speed_difference_mps=(90.0, 91.0)),
        Event(kind="cut_in", target="nobody"),
    )
    scene = generate(prepare(read_scene(folder), Config()), Config(request=Request(agents=0), event=asked))
    first, second = scene.sidecar.events
    assert (first.status, first.tries) == ("not_feasible", 0)
    assert first.reason == f"event_not_foreseen:{next(iter(first.tried))}"
    assert (second.reason, second.tried) == ("event_no_target", {})


def test_no_vehicle_of_an_event_comes_between_those_of_one_before(data_root: Path) -> None:
    """One leads by 23 m at 6 s; another would lead by 5 m at 3 s, and still be between the two at 6 s."""
    folder = next(one for one in find_scenarios(data_root) if one.name.startswith(ARTERIAL))
    asked = (
        Event(kind="lead", target="av", at_s=(6.0, 6.0), gap_m=(15.0, 30.0)),
        Event(kind="lead", target="av", at_s=(3.0, 3.0), gap_m=(4.0, 10.0)),
    )
    scene = generate(prepare(read_scene(folder), Config()), Config(request=Request(agents=0), event=asked))
    assert [one.status for one in scene.sidecar.events] == ["done", "not_feasible"]
    assert scene.judge().empty
