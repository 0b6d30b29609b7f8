"""The synthetic data set: made byte for byte by its script, in the format, and like traffic."""

import importlib
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pyarrow.parquet as pq
import pytest
import second_scene
from second_checker import CHECKS, overlaps

from bridge.config import load_config
from bridge.recordings.recording import Recording
from bridge.recordings.scenario import read_scenario

Script = Callable[[str], ModuleType]


@pytest.fixture(scope="module")
def script(data_root: Path) -> Iterator[Script]:
    """script(name): a module of those that make the data set; they lie in its folder, outside any package."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.syspath_prepend(str(data_root.parent))
        yield importlib.import_module


@pytest.fixture(scope="module")
def scenario(data_scene: Path) -> Recording:
    return read_scenario(data_scene)


def test_script_makes_the_data_set_byte_for_byte(script: Script, data_root: Path, tmp_path: Path) -> None:
    """A parquet file also names the pyarrow that wrote it: with another one the tables are compared instead."""
    script("make_data").make(tmp_path)
    made = sorted(path.relative_to(tmp_path) for path in tmp_path.rglob("*") if path.is_file())
    assert made == sorted(path.relative_to(data_root) for path in data_root.rglob("*") if path.is_file())
    assert len(made) == 6
    for path in made:
        ours, theirs = data_root / path, tmp_path / path
        if path.suffix == ".parquet" and _writer(ours) != _writer(theirs):
            assert pq.read_table(ours).equals(pq.read_table(theirs))
        else:
            assert ours.read_bytes() == theirs.read_bytes(), path


def test_scene_has_the_cast_that_was_asked_for(scenario: Recording) -> None:
    kinds = Counter(track.object_type for track in scenario.tracks)
    assert kinds["bus"] == 1
    assert kinds["cyclist"] == 1
    assert kinds["pedestrian"] >= 3
    vehicles = [track for track in scenario.tracks if track.object_type == "vehicle"]
    moving = [track for track in vehicles if track.path_m > 5]
    assert len(moving) >= 10
    assert sum(track.path_m == 0 for track in vehicles) >= 6
    assert sum(track.timesteps[0] > 49 for track in moving) == 1
    assert [track.track_id for track in scenario.tracks].count("AV") == 1
    assert scenario.num_steps == 110
    assert all(len(track.timesteps) == 110 for track in scenario.tracks if track.category >= 2)
    assert all(track.track_id == "AV" or track.track_id.isdigit() for track in scenario.tracks)


def test_the_second_checker_finds_nothing_wrong_with_a_vehicle_and_no_boxes_that_overlap(data_scene: Path) -> None:
    """Each vehicle as if it had been inserted; only those on their way in or out of the map leave its ground."""
    scene = second_scene.read_scene(data_scene)
    for track in scene.tracks:
        alone = replace(scene, inserted_ids=[track.track_id])
        checks = CHECKS if track.object_type in ("vehicle", "bus") else (overlaps,)
        found = {one.quantity for check in checks for one in check(alone, track)}
        assert found <= ({"off_road"} if len(track.steps) < 110 else set()), track.track_id


def test_motion_is_smooth_and_possible(scenario: Recording) -> None:
    """Velocity is the derivative of position; accelerations, yaw rates and jerks of a calm driver."""
    for track in scenario.tracks:
        derivative = np.gradient(track.position, 0.1, axis=0)
        assert np.hypot(*(derivative - track.velocity)[1:-1].T).max() < 0.01, track.track_id
        speed = track.speed
        acceleration = np.diff(track.velocity, axis=0) / 0.1
        jerk = np.diff(acceleration, axis=0) / 0.1
        turning = np.diff(np.unwrap(track.heading)) / 0.1
        assert np.abs(np.diff(speed) / 0.1).max() < 2.5
        assert np.hypot(*acceleration.T).max() < 3.0
        assert np.hypot(*jerk.T).max() < 4.0
        assert np.abs(turning).max() < 0.7
        fast = speed > 0.5
        course = np.arctan2(track.velocity[fast, 1], track.velocity[fast, 0])
        assert np.abs(np.sin((track.heading[fast] - course) / 2)).max(initial=0.0) < 0.001


def test_example_configurations_are_valid(data_root: Path) -> None:
    examples = sorted((data_root.parent / "configs").glob("*.toml"))
    assert examples
    for path in examples:
        load_config(path)


def _writer(path: Path) -> str:
    return str(pq.ParquetFile(path).metadata.created_by)
