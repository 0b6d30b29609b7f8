"""Recordings whose tracks fit neither their map nor each other are refused; sound ones, however small, are not."""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from implausible import FAULTS, moved, plant, shifted

from bridge.batch.validation import validate_folder
from bridge.config import load_config
from bridge.generation.generate import prepare
from bridge.recordings.folders import Choices
from bridge.recordings.plausibility import LEAST_GAINING, LEAST_VEHICLES, figures_of, implausible
from bridge.recordings.scenario import read_scenario
from bridge.recordings.sources import READERS, find_one, find_recordings, read_recording
from hid2.measures.arrays import stack
from netconvert.errors import NoSceneError, ScenarioError

_TURNED = moved(((math.cos(2.0), -math.sin(2.0)), (math.sin(2.0), math.cos(2.0))))
_MIRRORED = moved(((-1.0, 0.0), (0.0, 1.0)))


@pytest.fixture(scope="session")
def spoiled_scenes(data_scenes: dict[str, Path], real_scenes: list[Path]) -> list[Path]:
    """The curve of data/, and a recorded scene that was derived from a sensor log."""
    return [data_scenes["curve"], *(path for path in real_scenes if path.name[:4] == "3b35")]


@pytest.mark.parametrize("name", FAULTS)
def test_every_fault_is_refused_with_its_figure(spoiled_scenes: list[Path], tmp_path: Path, name: str) -> None:
    change, said = FAULTS[name]
    for scene, other in zip(spoiled_scenes, [*spoiled_scenes[1:], spoiled_scenes[0]], strict=True):
        recording = read_scenario(plant(scene, tmp_path, change, other=other))
        with pytest.raises(ScenarioError, match=said) as caught:
            prepare(recording, load_config())
        assert str(recording.folder) in str(caught.value)
        assert str(caught.value).endswith("; --set source.plausible=false goes on all the same")
        assert "\n" not in str(caught.value)


def test_scenes_as_they_are_and_turned_and_mirrored_whole_are_taken(spoiled_scenes: list[Path], tmp_path: Path) -> None:
    for scene in spoiled_scenes:
        before = figures_of(read_scenario(scene))
        for name, change in {"turned": _TURNED, "mirrored": _MIRRORED}.items():
            recording = read_scenario(plant(scene, tmp_path / name, change))
            assert implausible(recording) == ""
            after = figures_of(recording)
            assert (after.moving, after.mapped, after.turned) == (before.moving, before.mapped, before.turned)
            assert after.ground == pytest.approx(before.ground, abs=0.02)


def test_no_real_scene_is_refused(shared_data: Path) -> None:
    """All scenes, and windows of sensor logs. Sequences are looked at by the script in tests/benchmarks."""
    found = [address for name in ("av2", "wide") for address in find_recordings([shared_data / name])]
    found += find_recordings([shared_data / "sensor"], Choices(stride=40))
    assert len(found) == 18
    assert {str(address): implausible(read_recording(address)) for address in found} == dict.fromkeys(
        map(str, found), ""
    )


@pytest.mark.parametrize("by_m", [-1.0, 1.0])
def test_a_map_shifted_by_a_metre_is_told_and_taken(spoiled_scenes: list[Path], tmp_path: Path, by_m: float) -> None:
    for scene in spoiled_scenes[:2]:
        recording = read_scenario(plant(scene, tmp_path, shifted(by_m)))
        assert implausible(recording) == ""
        assert figures_of(recording).shift_m == pytest.approx(1.0, abs=0.3)


@pytest.mark.parametrize("name", ["degrees", "swapped", "3 m", "1 km", "halved"])
def test_too_few_moving_vehicles_tell_nothing(spoiled_scenes: list[Path], tmp_path: Path, name: str) -> None:
    """Two moving vehicles are below every least number: LEAST_VEHICLES, and as many that fit fully elsewhere."""
    assert LEAST_VEHICLES > LEAST_GAINING
    recording = read_scenario(plant(spoiled_scenes[0], tmp_path, FAULTS[name][0], other=spoiled_scenes[1]))
    arrays = stack(recording.tracks, step_s=recording.step_s)
    few = {arrays.track_ids[row] for row in np.flatnonzero(arrays.moving_vehicles)}
    kept = sorted(few)[:1]
    tracks = tuple(track for track in recording.tracks if track.track_id not in few or track.track_id in kept)
    assert implausible(replace(recording, tracks=tracks)) == ""
    assert implausible(replace(recording, tracks=())) == ""


def test_a_reversing_vehicle_is_no_reason(data_scenes: dict[str, Path]) -> None:
    recording = read_scenario(data_scenes["curve"])
    backwards = [
        replace(track, heading=np.mod(track.heading + np.pi, 2 * np.pi)) if track.track_id != "AV" else track
        for track in recording.tracks
    ]
    assert implausible(replace(recording, tracks=tuple(backwards[:2]) + recording.tracks[2:])) == ""
    assert re.match(r"headings of \d+ of \d+", implausible(replace(recording, tracks=tuple(backwards))))


def test_the_switch_lets_it_through(spoiled_scenes: list[Path], tmp_path: Path) -> None:
    recording = read_scenario(plant(spoiled_scenes[0], tmp_path, FAULTS["no velocity_x"][0]))
    with pytest.raises(ScenarioError, match=r"velocity_x makes 0\.00 of the displacement"):
        prepare(recording, load_config())
    assert prepare(recording, load_config(None, ["source.plausible=false"])).scenario is recording
    assert [one.is_note for one in validate_folder(tmp_path) if "velocity_x makes" in one.message] == [True]  # recorded


@pytest.mark.parametrize(
    ("names", "what"),
    [
        (["v1.0-mini/sample.json", "v1.0-mini/scene.json"], r"a nuScenes data set \(it has 'v1.0-mini/sample.json'\)"),
        (["segment-1_with_camera_labels.tfrecord"], "Waymo data"),
        (["nuplan-v1.1/splits/mini/2021.05.12.22.00.38_veh-35.db"], "nuPlan data"),
        (["2011_09_26/calib_cam_to_cam.txt"], "a KITTI data set"),
        (["town.net.xml"], "a SUMO net"),
        (["town.xodr"], "an OpenDRIVE map"),
        (["forecasts.csv"], "a table, such as of forecasts"),
    ],
)
def test_other_data_sets_are_named(tmp_path: Path, names: list[str], what: str) -> None:
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    known = " or ".join(one.many for one in READERS)
    for find in (find_one, lambda path: find_recordings([path])):
        if len(names) == 1 and (path := tmp_path / names[0]).parent == tmp_path:
            with pytest.raises(NoSceneError, match=rf"{path.name}: this is \D+, which hid2 does not read"):
                find(path)
        with pytest.raises(NoSceneError, match=rf"this is {what}.*expected {known} \(columns") as caught:
            find(tmp_path)
        assert "\n" not in str(caught.value)
