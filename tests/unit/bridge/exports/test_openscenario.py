"""OpenSCENARIO of generated and recorded scenes: valid by ASAM's schema, and every agent where its track has it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drawn_roads import schema
from lxml import etree

from bridge.exports.export import export_scene
from bridge.exports.openscenario import openscenario_files
from bridge.recordings.recording import Recording
from bridge.recordings.sources import read_recording
from hid2.agents import Track
from netconvert.errors import NetError


def _poses(root: etree._Element, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Times (N,) s and box middles with headings (N, 3) of an agent, as a player that knows the standard has them."""
    center = root.find(f"Entities/ScenarioObject[@name='{name}']").find(".//BoundingBox/Center")
    actions = root.find(f".//ManeuverGroup[@name='{name}']")
    vertices = actions.findall(".//Vertex")
    times = [float(vertex.get("time")) for vertex in vertices]
    places = [vertex.find("Position/WorldPosition") for vertex in vertices]
    if not places:  # of a track of one row
        places = [actions.find(".//AddEntityAction/Position/WorldPosition")]
        times = [float(actions.find(".//Event[@name='follows']//SimulationTimeCondition").get("value"))]
    poses = np.array([[float(place.get(key)) for key in ("x", "y", "h")] for place in places])
    ahead = np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], axis=1)
    poses[:, :2] += float(center.get("x")) * ahead
    assert float(center.get("y")) == 0.0
    return np.array(times), poses


def _check(scene: Recording, folder: Path) -> None:
    root = etree.parse(folder / f"{scene.scenario_id}.xosc").getroot()
    schema("OpenSCENARIO_1_2.xsd").assertValid(root)
    names = [one.get("name") for one in root.iterfind("Entities/ScenarioObject")]
    assert names[0] == "Ego"
    assert sorted(names) == sorted("Ego" if track.track_id == "AV" else track.track_id for track in scene.tracks)
    for track in scene.tracks:
        _check_track(root, track, scene)


def _check_track(root: etree._Element, track: Track, scene: Recording) -> None:
    name = "Ego" if track.track_id == "AV" else track.track_id
    times, poses = _poses(root, name)
    assert times == pytest.approx(track.timesteps * scene.step_s, abs=1e-4)
    assert np.abs(poses[:, :2] - track.position).max() <= 0.001
    assert np.abs(np.remainder(poses[:, 2] - track.heading + np.pi, 2 * np.pi) - np.pi).max() <= 1e-5
    entity = root.find(f"Entities/ScenarioObject[@name='{name}']")
    size = entity.find(".//BoundingBox/Dimensions")
    assert (float(size.get("length")), float(size.get("width"))) == pytest.approx(tuple(track.size), abs=6e-4)
    actions = root.find(f".//ManeuverGroup[@name='{name}']")
    init = root.find(f"Storyboard/Init/Actions/Private[@entityRef='{name}']")
    assert (init is None) == (track.timesteps[0] > 0) == (actions.find(".//AddEntityAction") is not None)
    assert (actions.find(".//DeleteEntityAction") is not None) == (track.timesteps[-1] < scene.num_steps - 1)


def test_a_generated_scene_is_valid_and_every_agent_is_on_its_track(made_scene: Path, tmp_path: Path) -> None:
    scene = read_recording(made_scene)
    files = export_scene(made_scene, "openscenario", tmp_path)
    assert [path.name for path in files] == [f"{scene.scenario_id}.xosc", f"{scene.scenario_id}.xodr"]
    _check(scene, tmp_path)
    roads = etree.parse(tmp_path / f"{scene.scenario_id}.xosc").find("RoadNetwork/LogicFile").get("filepath")
    assert (tmp_path / roads).read_bytes() == export_scene(made_scene, "opendrive", tmp_path)[0].read_bytes()
    assert {path.read_bytes() for path in files} == {
        path.read_bytes() for path in export_scene(made_scene, "openscenario", tmp_path / "again")
    }


def test_a_track_that_is_called_as_the_recording_vehicle_is_refused(data_scenes: dict[str, Path]) -> None:
    scene = read_recording(data_scenes["curve"])
    ego = next(replace(track, track_id="Ego") for track in scene.tracks if track.track_id != "AV")
    with pytest.raises(NetError, match="track 'Ego': expected another id, AV is called so; rename the track"):
        openscenario_files(replace(scene, tracks=(*scene.tracks, ego)))


def test_a_real_scene_has_every_agent_on_its_track(real_scenes: list[Path], tmp_path: Path) -> None:
    """Agents that come, go, and stand. Its roads are read in tests/sumo/test_opendrive_read.py."""
    export_scene(real_scenes[0], "openscenario", tmp_path)
    _check(read_recording(real_scenes[0]), tmp_path)
