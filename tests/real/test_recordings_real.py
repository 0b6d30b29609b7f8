"""Real scenes as they are read, converted to nets and written again: with the contents that av2 finds in them."""

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from as_av2 import read_as_av2
from av2.datasets.motion_forecasting.scenario_serialization import load_argoverse_scenario_parquet
from av2.map.map_api import ArgoverseStaticMap
from breaches import breaches
from signal_entries import entries as passed
from written import write_fake

from bridge.recordings.judging import states_of
from bridge.recordings.map_rules import graph_of, read_source_map
from bridge.recordings.scenario import STEP_S, read_scenario
from bridge.sumo.net import convert
from hid2.conflicts.signals import InferredSignals
from hid2.measures.lane_matching import flatten_lanes
from hid2.params import Signals
from netconvert.fidelity import UNEXPLAINED
from netconvert.lane_graph import SIDES, LaneGraph

#: Of the recorded entries, at red: one of 69 in these six scenes.
MOST_ON_RED = 0.03


def test_real_scene_reads_as_av2_reads_it(real_scene: Path) -> None:
    scenario = read_as_av2(real_scene)
    assert scenario.num_steps == (50 if real_scene.parent.name == "test" else 110)
    assert scenario.split == real_scene.parent.name


def test_sizes_of_labelled_scenes_are_used(real_scenes: list[Path]) -> None:
    for folder in real_scenes:
        scenario = read_scenario(folder)
        labelled = (folder / "agent_sizes.csv").is_file()
        assert labelled == (folder.name[:8] in ("3b3570b4", "7fab2350"))
        assert scenario.track("AV").size == ((4.877, 2.0) if labelled else (4.5, 1.9))


def _map_path(scene: Path) -> Path:
    (path,) = scene.glob("log_map_archive_*.json")
    return path


def _check_against_av2(graph: LaneGraph, theirs: ArgoverseStaticMap) -> None:
    assert set(graph.lanes) == set(theirs.vector_lane_segments)
    for lane_id, lane in graph.lanes.items():
        other = theirs.vector_lane_segments[lane_id]
        assert np.array_equal(lane.left_boundary, other.left_lane_boundary.xyz[:, :2])
        assert np.array_equal(lane.right_boundary, other.right_lane_boundary.xyz[:, :2])
        assert lane.lane_type == other.lane_type.value
        assert lane.is_intersection is other.is_intersection is theirs.lane_is_in_intersection(lane_id)
        assert list(lane.successors) == other.successors == theirs.get_lane_segment_successor_ids(lane_id)
        assert lane.left_neighbor_id == theirs.get_lane_segment_left_neighbor_id(lane_id)
        assert lane.right_neighbor_id == theirs.get_lane_segment_right_neighbor_id(lane_id)
        assert lane.left_mark_type == other.left_mark_type.value
        assert lane.right_mark_type == other.right_mark_type.value
    areas = list(theirs.vector_drivable_areas.values())
    assert len(graph.drivable_areas) == len(areas)
    for ring, area in zip(graph.drivable_areas, areas, strict=True):
        assert np.array_equal(ring, area.xyz[:, :2])


def test_the_lane_graph_holds_what_av2_reads_and_centrelines_are_those_of_the_file(real_scene: Path) -> None:
    """av2 ignores them; the file's are finer than the ten points that it derives, as we do where there are none."""
    path = _map_path(real_scene)
    data, graph, theirs = json.loads(path.read_text()), read_source_map(path), ArgoverseStaticMap.from_json(path)
    _check_against_av2(graph, theirs)
    for segment in data["lane_segments"].values():
        points = [[point["x"], point["y"]] for point in segment.pop("centerline")]
        assert graph.lanes[segment["id"]].centerline.tolist() == points
    for lane_id, lane in graph_of(data, name="map").lanes.items():
        expected = theirs.get_lane_segment_centerline(lane_id)[:, :2]
        assert np.abs(lane.centerline - expected).max() <= 1e-6


def test_followed_links_are_the_file_s_links_within_the_map(real_scene: Path) -> None:
    """Every successor in the map and every neighbour whose chord points the same way; the rest is accounted for."""
    graph = read_source_map(_map_path(real_scene))
    chord = {lane_id: lane.centerline[-1] - lane.centerline[0] for lane_id, lane in graph.lanes.items()}
    dropped = {(link.kind, link.source, link.target) for link in graph.dropped}
    for lane_id, lane in graph.lanes.items():
        assert graph.successors(lane_id) == tuple(target for target in lane.successors if target in graph.lanes)
        for target in set(lane.successors) - set(graph.lanes):
            assert ("successor", lane_id, target) in dropped
        for target in graph.successors(lane_id):
            assert lane_id in graph.predecessors(target)
            assert np.hypot(*(graph.lanes[target].centerline[0] - lane.centerline[-1])) < 0.01
        for side in SIDES:
            stated = lane.neighbor_id(side)
            same_way = stated in graph.lanes and float(np.dot(chord[lane_id], chord[stated])) > 0.0
            assert graph.neighbor(lane_id, side) == (stated if same_way else None)
            assert (stated is None) or same_way or (f"{side}_neighbor", lane_id, stated) in dropped


@pytest.mark.parametrize("number", [0, 3])
def test_the_net_has_every_lane_on_its_centreline_and_every_link_or_its_reason(
    real_scenes: list[Path], tmp_path: Path, number: int
) -> None:
    report = convert(real_scenes[number], tmp_path)
    assert report.lanes == report.lanes_in_net > 0
    assert report.largest_distance_m <= 0.01
    assert sum(link.kind == "successor" for link in report.lost) == report.links["successor", "lost"]
    assert sum(link.kind != "successor" for link in report.lost) == report.links["neighbor", "lost"]
    assert UNEXPLAINED not in {link.reason for link in report.lost}
    assert {link.reason for link in report.lost} == {"the other lane is outside the map"}


@pytest.mark.parametrize(("number", "focal"), [(0, None), (1, "gen_1")])
def test_real_scene_with_vehicles_added_is_valid(
    real_scenes: list[Path], tmp_path: Path, number: int, focal: str | None, shared_data: Path
) -> None:
    real_scene = real_scenes[number]
    scenario = read_scenario(real_scene)
    folder = write_fake(scenario, tmp_path, focal=focal)
    new_id = folder.name
    assert [one for one in breaches(tmp_path, source=shared_data / "av2") if not one.is_note] == []

    table = pq.read_table(folder / f"scenario_{new_id}.parquet")
    source = pq.read_table(real_scene / f"scenario_{real_scene.name}.parquet")
    assert table.schema.names == source.schema.names
    for name in ("position_x", "position_y", "heading", "velocity_x", "velocity_y"):
        ours, theirs = (column.to_numpy().view(np.int64) for column in (table.column(name), source.column(name)))
        assert np.array_equal(ours[: len(theirs)], theirs)
    again = load_argoverse_scenario_parquet(folder / f"scenario_{new_id}.parquet")
    assert len(again.tracks) == len(scenario.tracks) + 2
    assert again.focal_track_id == (focal or scenario.focal_track_id)
    path = folder / f"log_map_archive_{new_id}.json"
    assert path.read_bytes() == scenario.map_path.read_bytes()
    assert len(ArgoverseStaticMap.from_json(path).vector_lane_segments) == len(
        json.loads(path.read_bytes())["lane_segments"]
    )


def test_recorded_vehicles_hardly_ever_enter_on_red(real_scenes: list[Path]) -> None:
    entries = on_red = red_lanes = 0
    for folder in real_scenes:
        scenario = read_scenario(folder)
        lanes = flatten_lanes(scenario.graph)
        states = states_of(scenario.tracks, lanes, set(), num_steps=scenario.num_steps, step_s=STEP_S)
        signals = InferredSignals(scenario.graph, states, Signals())
        for lane_id in scenario.graph.lanes:
            red, enters = signals.red(lane_id), passed(signals, lane_id)
            assert (red is None) == (enters is None)
            if red is not None and enters is not None:
                entries += int(enters.sum())
                on_red += int((enters & red).sum())
                red_lanes += bool(red.any())
    print(f"{on_red} of {entries} recorded entries on red; {red_lanes} entrances red at some time")
    assert entries >= 50
    assert red_lanes >= 50
    assert on_red <= MOST_ON_RED * entries
