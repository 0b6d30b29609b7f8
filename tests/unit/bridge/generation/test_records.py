"""What the sidecar says of manoeuvres, of the replay, of what is near and enters; claims are seen in tests/real."""

import numpy as np
import pytest

from bridge.batch.manifest import DONE, ManifestRow
from bridge.batch.scene_work import summarise
from bridge.cli.generation import print_batch
from bridge.generation.generate import generate, prepare
from bridge.generation.scene import TrafficScene
from bridge.recordings.scenario import read_scenario
from hid2.agents import Policy, Track
from hid2.params import Config, Driving, Request

OVERTAKES = {"straight": 0.7, "left_turn": 0.0, "right_turn": 0.0, "lane_change": 0.0, "overtake": 0.3}


@pytest.fixture(scope="module")
def arterial(data_scenes):
    return prepare(read_scenario(data_scenes["arterial"]), Config())


@pytest.fixture(scope="module")
def full(arterial) -> TrafficScene:
    """The road has no room for all of 25."""
    return generate(arterial, Config(request=Request(agents=25, seed=0, **OVERTAKES)))


def test_manoeuvre_that_no_vehicle_does_has_a_record_with_its_reason_and_is_told_of_none(full):
    """What goes straight in its place has done nothing of what the reason says."""
    assert [record.kind for _, record in full.sidecar.asked].count("overtake") == 8
    assert full.sidecar.unmet
    assert all(record.status == "not_feasible" and record.reason for record in full.sidecar.unmet)
    assert all(not agent.maneuvers for agent in full.sidecar.agents if agent.policy is Policy.STRAIGHT)


def test_replay_of_every_recorded_agent_is_measured_where_that_is_asked_for(arterial):
    """The vehicles drive alike: agents that are near no path of theirs are nothing to them."""
    request = Request(agents=4, seed=3)
    scenes = [
        generate(arterial, Config(request=request, driving=Driving(check_replay=check))) for check in (False, True)
    ]
    without, measured = (scene.sidecar.replay for scene in scenes)
    assert (without.checked, without.states) == (False, 0)
    assert measured.checked
    assert measured.states == sum(track.timesteps.size for track in scenes[1].source.tracks)
    assert measured.max_position_error_m <= 0.001
    assert measured.max_heading_error_rad <= 0.001
    for one, other in zip(*(scene.generated for scene in scenes), strict=True):
        np.testing.assert_array_equal(one.position, other.position)


@pytest.mark.parametrize(("near", "within_m", "steps"), [("focal", 25.0, [49]), ("traffic", 4.0, range(110))])
def test_vehicles_near_to_what_was_named_are_counted_by_positions(arterial, near: str, within_m: float, steps):
    """A focal track counts at the last observed step alone, moving traffic at any."""
    scene = generate(arterial, Config(request=Request(agents=6, near=near, within_m=within_m)))
    moving = [
        track for track in scene.source.tracks
        if (track.category == 3 if near == "focal" else np.hypot(*np.ptp(track.position, axis=0)) > 5.0)
        and track.object_type in ("vehicle", "bus") and track.category > 0
    ]  # fmt: skip

    def is_near(own: Track, other: Track) -> bool:
        at = {int(step): place for step, place in zip(other.timesteps, other.position, strict=True)}
        pairs = zip(own.timesteps.tolist(), own.position, strict=True)
        return any(step in steps and step in at and np.hypot(*(at[step] - place)) <= within_m for step, place in pairs)

    wanted = sum(any(is_near(own, other) for other in moving) for own in scene.generated)
    assert scene.sidecar.placed.near == wanted
    assert 0 < wanted < len(scene.generated)


def test_what_enters_and_what_the_focal_track_does_is_in_sidecar_manifest_and_table(arterial, capsys):
    """One of three is to overtake; of the two that go straight, and were all to enter, one does."""
    request = Request(agents=3, entering=1.0, focal="generated")
    made = generate(arterial, Config(request=request))
    row = summarise(made.sidecar, ManifestRow("arterial", "val", 0, 0, DONE, requested="3"))
    told = made.sidecar.selection
    failed = made.sidecar.model_copy(update={"selection": told.model_copy(update={"dropped": told.kept})})
    assert (row.driven, summarise(failed, row).driven) == (3, 6)
    assert row.entered == sum(own.timesteps[0] > 0 for own in made.generated) == 1
    print_batch([row._replace(rejected="pet (1)"), row._replace(focal="straight")], request)
    told = capsys.readouterr().out
    assert "3 of 3, 1 entered" in told
    assert "candidates rejected: pet (1)" in told
    assert "\nentered: 2 of 4 that go straight\nfocal tracks that do a manoeuvre: 1 of 2\n" in told
    assert row.focal == "overtake"
