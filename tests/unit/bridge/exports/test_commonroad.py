"""CommonRoad files: lanelets with the graph's links, agents where their tracks have them, one planning problem."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lxml import etree
from written import edit_json

from bridge.exports.commonroad import commonroad_files
from bridge.exports.export import export_scene
from bridge.recordings.sources import read_recording
from hid2.agents import AV_ID
from netconvert.errors import NetError

#: Types of dynamic obstacles in CommonRoad's schema.
KINDS = {"unknown", "car", "truck", "bus", "motorcycle", "bicycle", "pedestrian", "priorityVehicle", "train", "taxi"}


def _states(obstacle: etree._Element) -> dict[int, list[float]]:
    found = {}
    for state in [obstacle.find("initialState"), *obstacle.iterfind("trajectory/state")]:
        values = [state.find(path).text for path in ("position/point/x", "position/point/y", "orientation/exact")]
        found[int(state.find("time/exact").text)] = [*map(float, values), float(state.find("velocity/exact").text)]
    return found


@pytest.fixture(params=["generated", "real"])
def scene(request: pytest.FixtureRequest) -> Path:
    if request.param == "generated":
        return request.getfixturevalue("made_scene")
    return next((request.getfixturevalue("shared_data") / "wide").glob("*/01844147-*"))  # with a box turned round


def test_lanelets_and_agents_are_those_of_the_scene(scene: Path, tmp_path: Path) -> None:
    (file,) = export_scene(scene, "commonroad", tmp_path)
    assert file.read_bytes() == export_scene(scene, "commonroad", tmp_path / "again")[0].read_bytes()
    recording, root = read_recording(scene), etree.parse(file).getroot()
    graph = recording.graph
    lanelets = {int(lanelet.get("id")): lanelet for lanelet in root.iterfind("lanelet")}
    assert lanelets.keys() == graph.lanes.keys()
    for lane_id, lanelet in lanelets.items():
        for key, wanted in (
            ("predecessor", graph.predecessors(lane_id)),
            ("successor", graph.successors(lane_id)),
            ("adjacentLeft", [graph.neighbor(lane_id, "left")]),
            ("adjacentRight", [graph.neighbor(lane_id, "right")]),
        ):
            found = [int(one.get("ref")) for one in lanelet.iterfind(key)]
            assert found == [one for one in wanted if one is not None]
        left, right = (lanelet.findall(f"{side}Bound/point") for side in ("left", "right"))
        assert len(left) == len(right) >= 2
    tracks = [track for track in recording.tracks if track.track_id != AV_ID]
    obstacles = root.findall("dynamicObstacle")
    assert len(obstacles) == len(tracks)
    ids = [int(one.get("id")) for one in [*obstacles, *root.iterfind("planningProblem"), *lanelets.values()]]
    assert len(set(ids)) == len(ids)
    waiting: list[tuple[float, float]] = []
    for track, obstacle in zip(tracks, obstacles, strict=True):
        assert obstacle.find("type").text in KINDS
        assert obstacle.find("initialState/time/exact").text == "0"
        assert obstacle.getprevious().text.strip() == f"track {track.track_id}"
        states = _states(obstacle)
        there = list(range(track.timesteps[0], track.timesteps[-1] + 1))
        assert list(states) == [*([0] if there[0] > 0 else []), *there]
        if there[0] > 0:  # it waits where no lane is
            x, y, *_ = states.pop(0)
            waiting.append((x, y))
            assert all(np.hypot(*(lane.centerline - (x, y)).T).min() > 99.0 for lane in graph.lanes.values())
        values = np.array([states[step] for step in track.timesteps.tolist()])
        assert np.abs(values[:, :2] - track.position).max() <= 0.001
        assert np.abs(np.remainder(values[:, 2] - track.heading + np.pi, 2 * np.pi) - np.pi).max() <= 1e-5
        assert values[:, 3] == pytest.approx(track.speed, abs=1e-5)
    assert len(set(waiting)) == len(waiting) == sum(track.timesteps[0] > 0 for track in tracks)
    (problem,) = root.iterfind("planningProblem")
    place = [float(problem.find(f"initialState/position/point/{axis}").text) for axis in "xy"]
    goal = [float(problem.find(f"goalState/position/rectangle/center/{axis}").text) for axis in "xy"]
    ego = recording.track(AV_ID)
    assert np.abs(np.array([place, goal]) - ego.position[[0, -1]]).max() <= 0.001


def test_track_ids_of_hyphens_and_bounds_that_are_points_are_written(copy_scene: Callable[..., Path]) -> None:
    """XML takes no "--" in a comment; the inner bound of a tight turn may be one point, which the outer one has too."""
    folder, ends = copy_scene(), {}
    (path,) = folder.glob("log_map_archive_*.json")

    def spoil(data: dict[str, Any]) -> None:
        lane = next(iter(data["lane_segments"].values()))
        lane["right_lane_boundary"] = lane["right_lane_boundary"][:1] * 2
        ends[str(lane["id"])] = len(lane["left_lane_boundary"])

    edit_json(path, spoil)
    scene = read_recording(folder)
    tracks = (replace(scene.tracks[0], track_id="a---b-"), *scene.tracks[1:])
    root = etree.fromstring(commonroad_files(replace(scene, tracks=tracks))[f"{scene.scenario_id}.cr.xml"])
    assert "a- - -b-" in "".join(comment.text for comment in root.iter(etree.Comment))
    ((lane_id, count),) = ends.items()
    right = root.findall(f"lanelet[@id='{lane_id}']/rightBound/point")
    assert len(right) >= count
    assert len({tuple(value.text for value in point) for point in right}) == 1


def test_a_lane_with_an_id_that_commonroad_has_not_is_refused(data_scenes: dict[str, Path]) -> None:
    """Its schema has positive ids, and commonroad-io reads no file with another one."""
    scene = read_recording(data_scenes["curve"])
    lane = replace(next(iter(scene.graph.lanes.values())), lane_id=-5)
    graph = replace(scene.graph, lanes={**scene.graph.lanes, -5: lane})
    with pytest.raises(NetError, match=f"{scene.scenario_id}: lane -5: .* expected 1 or more"):
        commonroad_files(replace(scene, graph=graph))
