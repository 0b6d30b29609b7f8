"""SUMO itself reads the nets: against its schemas, with the sumo program, through libsumo. No warning anywhere."""

import importlib.util
import json
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import shapely
from hand_drawn import draw_lane
from lxml import etree

from bridge.recordings.map_rules import read_source_map
from bridge.sumo.net import convert, sumo_program
from netconvert.cells import SAVED_WITHIN_M, CellGrid, build_cell_grid
from netconvert.lane_graph import LaneGraph
from netconvert.net_xml import net_bytes

# libsumo allows one simulation a process and prints its warnings past Python: each net gets a process of its own.
DUMP = """
import json, os, sys
os.environ["LIBSUMO_AS_TRACI"] = "quiet"
import libsumo
libsumo.start(["sumo", "-n", sys.argv[1], "--step-length", "0.1", "--no-step-log", "--message-log", os.devnull])
lanes = {
    lane: {
        "segment": libsumo.lane.getParameter(lane, "av2.lane_segment_id"),
        "shape": libsumo.lane.getShape(lane),
        "length": libsumo.lane.getLength(lane),
        "links": sorted(link[0] for link in libsumo.lane.getLinks(lane)),
        "allowed": libsumo.lane.getAllowed(lane),
        "left": libsumo.lane.getChangePermissions(lane, 1),
    }
    for lane in libsumo.lane.getIDList()
}
for _ in range(3):
    libsumo.simulationStep()
libsumo.close()
json.dump(lanes, open(sys.argv[2], "w"))
"""


def _schema(name: str) -> etree.XMLSchema:
    spec = importlib.util.find_spec("sumo_data")
    assert spec is not None, "sumo-data comes with libsumo"
    assert spec.submodule_search_locations is not None
    return etree.XMLSchema(etree.parse(Path(next(iter(spec.submodule_search_locations))) / "data" / "xsd" / name))


def _messages(*arguments: str) -> str:
    """Everything that the sumo program prints about a run of one step, which must end well."""
    command = [sumo_program("sumo"), *arguments, "--end", "1", "--no-step-log", "--xml-validation", "never"]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    return (result.stdout + result.stderr).strip()


def _dump(net: Path, folder: Path) -> dict[str, dict]:
    """What libsumo says of each lane, after it has loaded the net without printing anything."""
    result = subprocess.run([sys.executable, "-c", DUMP, net, folder / "lanes.json"], capture_output=True, text=True)
    assert (result.returncode, result.stdout.strip(), result.stderr.strip()) == (0, "", "")
    return json.loads((folder / "lanes.json").read_text())


def _check_libsumo_sees_the_grid(grid: CellGrid, lanes: dict[str, dict]) -> None:
    assert set(lanes) == set(grid.cell_of_sumo_lane)
    for cell in grid.cells:
        lane = lanes[grid.sumo_lane_id(cell)]
        assert lane["segment"] == str(cell.lane_id)
        assert lane["length"] == pytest.approx(grid.length_m(cell), abs=1e-5)
        centerline = shapely.LineString(grid.graph.lanes[cell.lane_id].centerline)
        assert shapely.distance(shapely.points(np.array(lane["shape"])), centerline).max() <= 0.01
        assert lane["links"] == sorted(grid.sumo_lane_id(target) for target in grid.following(cell))
        assert (lane["allowed"] == ["bicycle"]) == (grid.graph.lanes[cell.lane_id].lane_type == "BIKE")
        if grid.lateral(cell, "left") is not None:
            assert (lane["left"] == ["emergency"]) is not grid.graph.may_change(cell.lane_id, "left")


def _check_scene(scene: Path, folder: Path) -> None:
    convert(scene, folder)
    (net,) = folder.glob("*.net.xml")
    for suffix, name in ((".net.xml", "net_file"), (".sumocfg", "sumoConfiguration"), (".poly.xml", "additional_file")):
        schema = _schema(f"{name}.xsd")
        document = etree.parse(net.with_name(net.name.replace(".net.xml", suffix)))
        assert schema.validate(document), schema.error_log.last_error
    assert _messages("-n", str(net)) == ""
    assert _messages("-c", str(net).replace(".net.xml", ".sumocfg")) == ""
    (map_path,) = scene.glob("log_map_archive_*.json")
    grid = build_cell_grid(read_source_map(map_path), saved_within_m=SAVED_WITHIN_M)
    _check_libsumo_sees_the_grid(grid, _dump(net, folder))


@pytest.mark.parametrize("number", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 6))])
def test_sumo_loads_the_net_of_a_real_scene_without_a_word(
    real_scenes: list[Path], tmp_path: Path, number: int
) -> None:
    _check_scene(real_scenes[number], tmp_path)


_lane = partial(draw_lane, left_mark="NONE", right_mark="SOLID_WHITE")


# Maps that are legal but odd; each has been a problem for some reader of maps.
ODD_MAPS = {
    "negative ids and far coordinates": [
        _lane(-5, [(-123456.78, 987654.32), (-123446.78, 987654.32)], successors=(-4,)),
        _lane(-4, [(-123446.78, 987654.32), (-123440.0, 987650.0)]),
    ],
    "cycle of three": [
        _lane(1, [(0, 0), (10, 0)], successors=(2,)),
        _lane(2, [(10, 0), (5, 8)], successors=(3,)),
        _lane(3, [(5, 8), (0, 0)], successors=(1,)),
    ],
    "cycle of two single cells": [
        _lane(1, [(0, 0), (2, 1), (3, 0)], successors=(2,)),
        _lane(2, [(3, 0), (1, -1), (0, 0)], successors=(1,)),
    ],
    # Lane 1 leads to 2 and 3, and 2 leads to 3: the single cell of lane 2 starts and ends in one junction.
    "a short cut round a short lane": [
        _lane(1, [(0, 0), (10, 0)], successors=(2, 3)),
        _lane(2, [(10, 0), (11, 0)], successors=(3,)),
        _lane(3, [(11, 0), (20, 0)]),
    ],
    "lane of a millimetre": [
        _lane(1, [(0, 0), (10, 0)], successors=(2,)),
        _lane(2, [(10, 0), (10.001, 0)], successors=(3,)),
        _lane(3, [(10.001, 0), (20, 0)]),
    ],
    "a millimetre beside a long lane": [_lane(1, [(0, 0), (30, 0)], left=2), _lane(2, [(15, 3), (15.001, 3)])],
    "points a tenth of a millimetre apart": [_lane(1, [(0, 0), (3, 0), (3.0001, 0), (3.0001, 0.0001), (6, 3)])],
    "two lanes in the same place": [_lane(1, [(0, 0), (10, 0)]), _lane(2, [(0, 0), (10, 0)])],
    "neighbours at both ends of the skew": [
        _lane(1, [(0, 0), (20, 0)], left=2),
        _lane(2, [(6, 4), (20, 4)], left=3, lane_type="BIKE"),
        _lane(3, [(12, 8), (32, 8)]),
    ],
    "a hairpin": [_lane(1, [(0, 0), (9, 0), (9, 0.2), (0, 0.2)])],
    "no way between the lanes": [_lane(1, [(0, 0), (10, 0)]), _lane(2, [(50, 0), (60, 0)])],
}


def _all_in_one() -> LaneGraph:
    """All odd maps a kilometre apart, with ids of their own: the first one as it is, with its negative ids."""
    lanes = {}
    for number, odd in enumerate(ODD_MAPS.values()):
        for lane in odd:
            lane_id, beside = lane.lane_id + 10 * number, lane.left_neighbor_id
            lanes[lane_id] = replace(
                lane, lane_id=lane_id, centerline=lane.centerline + np.array([0.0, 1000.0 * number]),
                successors=tuple(target + 10 * number for target in lane.successors),
                left_neighbor_id=None if beside is None else beside + 10 * number,
            )  # fmt: skip
    return LaneGraph(lanes)


def test_sumo_loads_odd_maps_without_a_word(tmp_path: Path) -> None:
    grid = build_cell_grid(_all_in_one(), max_skew_m=4.0)
    net = tmp_path / "odd.net.xml"
    net.write_bytes(net_bytes(grid))
    schema = _schema("net_file.xsd")
    assert schema.validate(etree.parse(net)), schema.error_log.last_error
    assert _messages("-n", str(net)) == ""
    _check_libsumo_sees_the_grid(grid, _dump(net, tmp_path))
