"""A recording whose steps are not 0.1 s is driven and checked at its own, and refused where a format has 0.1 s."""

from dataclasses import replace

import numpy as np
import pytest
from lxml import etree
from separating_axes import boxes_overlap

from bridge.batch.batch import SceneFolders, plan
from bridge.batch.isolation import Failure
from bridge.batch.scene_work import generate_runs
from bridge.generation.generate import generate
from bridge.generation.scene import TrafficScene
from bridge.recordings.recording import Recording
from bridge.recordings.scenario import read_scenario
from bridge.sumo.exchange import sumo_files
from hid2.agents import Track
from hid2.params import Config, Limits
from netconvert.errors import ExportError
from netconvert.geometry import box_corners

LIMITS = Limits()
AGENTS = 8


def resampled(scenario: Recording, step_s: float) -> Recording:
    """The same scene at other steps: states between the recorded ones are interpolated."""
    tracks = [_resampled(track, scenario.step_s, step_s) for track in scenario.tracks]
    lasts_s = (scenario.num_steps - 1) * scenario.step_s
    observed_s = (scenario.observed_steps - 1) * scenario.step_s
    return replace(
        scenario, step_s=step_s, tracks=tuple(track for track in tracks if len(track.timesteps) > 1),
        num_steps=int(lasts_s / step_s + 1e-9) + 1, observed_steps=int(observed_s / step_s + 1e-9) + 1,
    )  # fmt: skip


def _resampled(track: Track, old_s: float, step_s: float) -> Track:
    times = track.timesteps * old_s
    steps = np.arange(np.ceil(times[0] / step_s - 1e-9), np.floor(times[-1] / step_s + 1e-9) + 1).astype(np.int64)

    def at(values):
        return np.interp(steps * step_s, times, values)

    return replace(
        track, timesteps=steps, position=np.column_stack([at(track.position[:, 0]), at(track.position[:, 1])]),
        heading=at(np.unwrap(track.heading)),
        velocity=np.column_stack([at(track.velocity[:, 0]), at(track.velocity[:, 1])]),
    )  # fmt: skip


@pytest.fixture(scope="module")
def recording(data_scenes) -> Recording:
    return read_scenario(data_scenes["arterial"])


@pytest.fixture(scope="module", params=[0.2, 0.05])
def made(request, recording) -> TrafficScene:
    config = Config.model_validate({"request": {"agents": AGENTS, "seed": 3}})
    return generate(resampled(recording, request.param), config)


def test_vehicles_are_placed_and_drive_as_far_as_their_speeds_say_within_the_limits_of_motion(made):
    """A step is a step of SUMO too: way driven = mean of two speeds times the step, as smoothed within half a metre.

    A step's way differs a little: SUMO's lanes are not as long as the map's, and what it jumps at a lane change
    is given back at 5 % of the speed at most. Speeds, accelerations and turn rates are by differences over the step.
    """
    step_s = made.source.step_s
    assert len(made.generated) == AGENTS
    for vehicle, track in zip(made.vehicles, made.generated, strict=True):
        s, v = np.array(vehicle.driven.s), np.array(vehicle.driven.v)
        np.testing.assert_allclose(np.diff(s), 0.5 * (v[1:] + v[:-1]) * step_s, rtol=0.07, atol=0.001)
        way = np.hypot(*np.diff(track.position, axis=0).T).sum()
        assert way == pytest.approx(track.speed.sum() * step_s, abs=0.1 + track.speed.max() * step_s)
        assert way == pytest.approx(s[track.timesteps[-1]] - s[0], abs=1.0)
        velocity = np.gradient(track.position, step_s, axis=0)
        speed = np.hypot(*velocity.T)
        assert speed.max() < 25.0
        np.testing.assert_allclose(velocity[1:-1], track.velocity[1:-1], atol=0.25)
        accel = np.gradient(speed, step_s)
        assert LIMITS.accel_min_mps2 <= accel.min()
        assert accel.max() <= LIMITS.accel_max_mps2
        assert np.abs(np.gradient(np.unwrap(track.heading), step_s)).max() <= LIMITS.yaw_rate_radps


def test_judge_finds_nothing_wrong(made):
    """No boxes that touch, at any step or between two, nothing off the ground, nothing met too soon."""
    assert made.judge().empty


def test_no_two_boxes_touch(made):
    """Generated with everybody, at every step."""
    everybody = [*made.source.tracks, *made.generated]
    for track in made.generated:
        for row, step in enumerate(track.timesteps.tolist()):
            for other in everybody:
                at = np.flatnonzero(other.timesteps == step)
                if other is track or not at.size:
                    continue
                if np.hypot(*(other.position[at[0]] - track.position[row])) > 20.0:
                    continue
                assert not boxes_overlap(_corners(track, row), _corners(other, int(at[0])))


def _corners(track, row):
    box = {"length_m": track.size.length_m, "width_m": track.size.width_m}
    return box_corners(track.position[[row]], track.heading[[row]], **box)[0]


def test_times_in_the_sidecar_are_seconds_of_the_recording(made):
    """Triggers are drawn in seconds, and a manoeuvre is asked for at its trigger or later, within the scene."""
    last_s = (made.source.num_steps - 1) * made.source.step_s
    asked = [one for agent in made.sidecar.agents for one in agent.maneuvers if one.requested_s is not None]
    assert asked
    for one in asked:
        assert one.requested_s <= last_s
        assert one.kind in ("left_turn", "right_turn") or one.requested_s >= one.trigger_s - 1e-9
    assert made.sidecar.recording.step_s == made.source.step_s


def test_files_for_sumo_have_the_step(made):
    """FCD output, and the playback: by the recording's own step."""
    step_s, scenario = made.source.step_s, made.source
    whole = replace(scenario, tracks=(*scenario.tracks, *made.generated))
    name = whole.scenario_id
    files = sumo_files(whole)
    times = [float(one.get("time")) for one in etree.fromstring(files[f"{name}.fcd.xml"]).iter("timestep")]
    np.testing.assert_allclose(times, step_s * np.arange(scenario.num_steps), atol=0.0051)
    time = etree.fromstring(files[f"{name}_scene.sumocfg"]).find("time")
    assert float(time.find("step-length").get("value")) == step_s
    end_s = (scenario.num_steps + 1) * step_s  # the last step stays
    assert float(time.find("end").get("value")) == pytest.approx(end_s, abs=0.006)


def test_argoverse_2_scene_is_refused_in_one_line(made, tmp_path):
    """Its readers take every step for 0.1 s: nothing is written, and the line says what to do."""
    with pytest.raises(ExportError) as refused:
        made.write(tmp_path / "out")
    said = str(refused.value)
    assert "\n" not in said
    assert f"steps of {made.source.step_s:g} s" in said
    assert "every 0.1 s" in said
    assert not (tmp_path / "out").exists()


def test_a_batch_refuses_it_before_anything_is_driven(recording, tmp_path, monkeypatch):
    """The line of `write`, from reading on: no time is spent on a scene that cannot be written."""
    monkeypatch.setattr("bridge.batch.scene_work.read_recording", lambda _: resampled(recording, 0.2))
    monkeypatch.setattr("bridge.batch.scene_work.prepare", lambda *_: pytest.fail("made before it was refused"))
    runs = plan([recording.folder], Config())[0].runs
    (failure,) = generate_runs(SceneFolders(recording.folder, tmp_path), runs)
    assert isinstance(failure, Failure)
    assert "steps of 0.2 s" in failure.message
