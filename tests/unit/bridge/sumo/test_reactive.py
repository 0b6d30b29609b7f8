"""Recorded vehicles that react: cut in front of, they yield on their path; scenes made so are not called recorded."""

import json
from pathlib import Path

import numpy as np
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from hand_drawn import draw_two_lanes
from inserted import recorded, scene_on, start_on
from simulated import drive

from bridge.batch.validation import validate_folder
from bridge.evaluation.scene_metrics import measure_folder
from bridge.forecasting.places import generated_sidecar
from bridge.generation.generate import generate
from bridge.pictures.render import _panels
from bridge.recordings.scenario import read_scenario
from bridge.sumo.driving import FleetSimulation
from hid2.agents import Policy
from hid2.params import Config, Driving, LaneChange, Request
from netconvert.errors import ConfigError, ScenarioError

REACTIVE = Driving(replay="reactive")


def cut_in(driving: Driving) -> FleetSimulation:
    """A car at x = 38 m with 8 m/s is asked at 0.5 s to change in front of a recorded one 13.5 m behind with 12 m/s."""
    config = Config(driving=driving, lane_change=LaneChange(time_gap_rear_s=0.2, braking_mps2=4.0))
    scene = scene_on(draw_two_lanes(), recorded(20.0, 3.3, 12.0, name="follower"), config=config)
    return drive(scene, start_on(scene, (1,), 38.0, 8.0, policy=Policy.LANE_CHANGE, trigger_s=0.5))


def test_follower_that_is_cut_in_front_of_yields_on_its_path() -> None:
    """As recorded it would be run into, so nobody changes; reacting, it brakes from 12 m/s to below 9, no harder than
    SUMO's 9 m/s2, stays behind, and is where SUMO has it.
    """
    fixed, reactive = cut_in(Driving()), cut_in(REACTIVE)
    assert fixed.fleet.vehicles[0].shifts == []
    assert fixed.reactions is None
    assert fixed.fleet.scene.traffic.position[0, :, 0] == pytest.approx(20.0 + 1.2 * np.arange(110))
    (vehicle,) = reactive.fleet.vehicles
    assert len(vehicle.shifts) == 1
    traffic = reactive.fleet.scene.traffic
    x, y = traffic.position[0, :, 0], traffic.position[0, :, 1]
    speed = np.diff(x) / 0.1
    assert speed.min() < 9.0
    assert speed.max() <= 12.0 + 1e-6
    assert np.diff(speed).min() / 0.1 > -9.01
    assert np.all(y == 3.3)
    assert (np.array(vehicle.s) - x[: len(vehicle.s)] - 4.5).min() > 3.0
    assert reactive.reactions is not None
    assert set(reactive.reactions.late_s) == {"follower"}
    assert reactive.replay_errors.max_position_error_m < 1e-6


CHANGES = Request(agents=8, straight=0.3, left_turn=0.0, right_turn=0.0, lane_change=0.7, overtake=0.0, seed=6)


@pytest.fixture(scope="module")
def reactive_scene(data_scenes: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    scene = generate(read_scenario(data_scenes["arterial"]), Config(request=CHANGES, driving=REACTIVE))
    return scene.write(tmp_path_factory.mktemp("out"))


def test_late_tracks_keep_their_path_and_all_others_their_rows(
    reactive_scene: Path, data_scenes: dict[str, Path]
) -> None:
    """Every state of a late track lies on the polyline of its recorded ones, and is no farther on it than recorded."""
    sidecar = json.loads(next(reactive_scene.glob("hid2_*.json")).read_text())
    late = sidecar["replay"]["late_s"]
    assert sidecar["replay"]["mode"] == "reactive"
    assert late
    source, driven = read_scenario(data_scenes["arterial"]), read_scenario(reactive_scene)
    for track in source.tracks:
        other = driven.track(track.track_id)
        if track.track_id not in late:
            assert np.array_equal(track.position, other.position)
            assert np.array_equal(track.velocity, other.velocity)
            continue
        begin, step = track.position[:-1], np.diff(track.position, axis=0)
        for row, (place, at) in enumerate(zip(other.position, other.timesteps, strict=True)):
            offset = place - begin
            share = np.clip((offset * step).sum(axis=1) / np.maximum((step**2).sum(axis=1), 1e-12), 0.0, 1.0)
            assert np.hypot(*(offset - share[:, None] * step).T).min() < 1e-6, (track.track_id, row)
            assert at >= track.timesteps[0]
        driven_m = np.hypot(*np.diff(other.position, axis=0).T).cumsum()
        recorded_m = np.hypot(*np.diff(track.position, axis=0).T).cumsum()
        count = min(driven_m.size, recorded_m.size)
        assert np.all(driven_m[:count] <= recorded_m[:count] + 1e-6)
    table = pq.read_table(next(reactive_scene.glob("scenario_*.parquet")))
    theirs = table.filter(pc.invert(pc.starts_with(table.column("track_id"), "gen_")))
    assert len(pc.unique(theirs.column("track_id"))) == len(source.tracks)


def test_scene_in_which_recorded_vehicles_react_is_called_so_and_refused(reactive_scene: Path) -> None:
    """Also in its picture, of one panel, for what was recorded is not in it."""
    assert reactive_scene.name.startswith("reactive-")
    (finding,) = validate_folder(reactive_scene)
    assert finding.rule == "replay"
    assert "do not drive as recorded" in finding.message
    for refuses in (lambda: measure_folder(reactive_scene), lambda: generated_sidecar(reactive_scene)):
        with pytest.raises(ScenarioError, match=r"reactive-.*do not drive as recorded"):
            refuses()
    (panel,) = _panels(read_scenario(reactive_scene))
    assert "reacting agents" in panel.title


def test_same_request_makes_the_same_scene_again(reactive_scene: Path, data_scenes: dict[str, Path]) -> None:
    again = generate(read_scenario(data_scenes["arterial"]), Config(request=CHANGES, driving=REACTIVE))
    assert again.recording.scenario_id == reactive_scene.name
    assert [track.position.tolist() for track in again.recording.tracks] == [
        read_scenario(reactive_scene).track(track.track_id).position.tolist() for track in again.recording.tracks
    ]


def test_events_with_vehicles_as_recorded_are_refused(data_scenes: dict[str, Path]) -> None:
    config = Config.model_validate({"driving": {"replay": "reactive"}, "event": [{"kind": "cut_in"}]})
    with pytest.raises(ConfigError, match=r"event cut_in with driving\.replay = 'reactive'"):
        generate(read_scenario(data_scenes["arterial"]), config)
