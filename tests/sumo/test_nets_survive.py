"""Nets of `hid2 net` survive netconvert, with which netedit saves too: lanes, lengths, connections, permissions."""

from functools import partial
from pathlib import Path

import pytest
from hand_drawn import draw_lane
from saved_nets import check_same, on_lane_shares, read_net, save

from bridge.exports.export import export_scene
from bridge.recordings.map_rules import read_source_map
from bridge.recordings.sources import read_recording
from netconvert.cells import SAVED_WITHIN_M, build_cell_grid
from netconvert.lane_graph import LaneGraph, LaneSegment
from netconvert.net_xml import net_bytes


def _check_scene(scene: Path, folder: Path) -> None:
    """The scene's net and its map's, saved once; the map's net saved again is the same to the last bit of its lanes.

    A vehicle that is placed along each lane is on its cell, but for 1 % of the steps.
    """
    export_scene(scene, "sumo", folder / "net")
    name = read_recording(scene).scenario_id
    net, saved = folder / "net" / f"{name}.net.xml", folder / "saved.net.xml"
    check_same(net, save(net, saved))
    assert read_net(save(saved, folder / "again.net.xml")).lanes == read_net(saved).lanes
    played = folder / "net" / f"{name}_scene.net.xml"
    check_same(played, save(played, folder / "played.net.xml"))
    (map_path,) = scene.glob("log_map_archive_*.json")
    assert min(on_lane_shares(read_source_map(map_path), [net, saved], folder)) >= 0.99


def test_the_nets_of_a_real_scene_with_skewed_rows_survive(real_scenes: list[Path], tmp_path: Path) -> None:
    """Of the six maps one of the two with the most unequal facing lanes: 5.0 to 11.0 m in a row."""
    (scene,) = (folder for folder in real_scenes if folder.name.startswith("00a0ec58"))
    _check_scene(scene, tmp_path)


@pytest.mark.slow
def test_the_nets_of_all_real_scenes_survive(fourteen_scenes: list[Path], tmp_path: Path) -> None:
    for scene in fourteen_scenes:
        _check_scene(scene, tmp_path / scene.name)


_lane = partial(draw_lane, left_mark="NONE", right_mark="SOLID_WHITE")
# What netconvert would change of nets that are not made for it.
ROADS = {
    # 5 m of lane 1 face 9 m of lane 3: in 3 cells one length for all would be off by 0.67 m, in 11 it is by 0.18 m.
    "a slanted stop line": [
        _lane(1, [(0, 0), (5, 0)], left=2, successors=(4,)),
        _lane(2, [(0, 4), (7, 4)], left=3, successors=(5,)),
        _lane(3, [(0, 8), (9, 8)], successors=(6,)),
        _lane(4, [(5, 0), (20, 0)]),
        _lane(5, [(7, 4), (20, 4)]),
        _lane(6, [(9, 8), (20, 8)]),
    ],
    "a lane that is much shorter than the one beside it": [
        _lane(1, [(0, 0), (1, 0)], left=2, successors=(3,)),
        _lane(2, [(0, 4), (6, 4)]),
        _lane(3, [(1, 0), (6, 0)]),
    ],
    # netconvert: "Ignoring changeLeft prohibition to avoid dead-end"; lane 2 has been the way out of lane 1.
    "lanes that end and must not be left": [
        _lane(1, [(0, 0), (10, 0)], left=2),
        _lane(2, [(0, 4), (10, 4)], left=3, left_mark="SOLID_WHITE"),
        _lane(3, [(0, 8), (10, 8)], successors=(4,)),
        _lane(4, [(10, 8), (20, 8)]),
    ],
    "vertices close to borders of cells and to each other": [
        _lane(1, [(0, 0), (0.05, 0.01), (2, 0.1), (2.04, 0.13), (3.97, 0.2), (8.05, 0)], successors=(2,)),
        _lane(2, [(8.05, 0), (8.1, 0.02), (12, 3)]),
    ],
    "a fork and a merge": [
        _lane(1, [(0, 0), (10, 0)], successors=(2, 3)),
        _lane(2, [(10, 0), (20, 6)], successors=(4,), is_intersection=True),
        _lane(3, [(10, 0), (15, -3), (20, 6)], successors=(4,), is_intersection=True),
        _lane(4, [(20, 6), (30, 6)]),
    ],
}


@pytest.mark.parametrize("name", ROADS)
def test_a_road_that_is_hard_to_save_survives_but_not_in_a_net_that_is_not_made_for_it(
    name: str, tmp_path: Path
) -> None:
    net = _written(ROADS[name], tmp_path, saved_within_m=SAVED_WITHIN_M)
    check_same(net, save(net, tmp_path / "saved.net.xml"))
    net = _written(ROADS[name], tmp_path, saved_within_m=None)
    saved = save(net, tmp_path / "saved.net.xml")
    with pytest.raises(AssertionError):
        check_same(net, saved)


def _written(lanes: list[LaneSegment], folder: Path, *, saved_within_m: float | None) -> Path:
    grid = build_cell_grid(LaneGraph({lane.lane_id: lane for lane in lanes}), saved_within_m=saved_within_m)
    net = folder / "road.net.xml"
    net.write_bytes(net_bytes(grid))
    return net
