"""Nets before and after SUMO's netconvert has saved them, as netedit does: what has become of their lanes."""

import json
import math
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from lxml import etree

from bridge.sumo.net import sumo_program
from netconvert.cells import SAVED_WITHIN_M, build_cell_grid
from netconvert.lane_graph import LaneGraph

#: Puts a vehicle to every point of each lane, a lane's points in successive steps; says on which lane SUMO has it.
PLACE = """
import json, os, sys
os.environ["LIBSUMO_AS_TRACI"] = "quiet"
import libsumo
ways = json.load(open(sys.argv[2]))
libsumo.start(["sumo", "-n", sys.argv[1], "--step-length", "0.1", "--no-step-log", "--message-log", os.devnull,
               "--collision.action", "none", "--time-to-teleport", "-1"])
libsumo.vehicletype.setVehicleClass("DEFAULT_VEHTYPE", "ignoring")
libsumo.route.add("any", [next(edge for edge in libsumo.edge.getIDList() if not edge.startswith(":"))])
found = {name: [] for name in ways}
for step in range(max(map(len, ways.values()))):
    here = {name: points[step] for name, points in ways.items() if step < len(points)}
    for name in ways.keys() - here.keys():
        if step == len(ways[name]):
            libsumo.vehicle.remove(name)
    for name, (edge, lane, x, y, angle) in here.items():
        if step == 0:
            libsumo.vehicle.add(name, "any")
        libsumo.vehicle.moveToXY(name, edge, lane, x, y, angle, 6, 3.0)
    libsumo.simulationStep()
    for name in here:
        found[name].append(libsumo.vehicle.getLaneID(name))
libsumo.close()
json.dump(found, open(sys.argv[3], "w"))
"""


@dataclass(frozen=True, slots=True)
class Lane:
    """A lane of a net as its XML has it."""

    ends: tuple[tuple[float, float], tuple[float, float]]
    length_m: float
    limit_mps: float
    rules: tuple[str | None, ...]
    """Classes that may use it, that may not, and that may change to its left and right; width; lane segment."""


@dataclass(frozen=True, eq=False, slots=True)
class Net:
    """Lanes by id, and connections."""

    lanes: dict[str, Lane]
    links: frozenset[tuple[str | None, ...]]


def read_net(path: Path) -> Net:
    """A net's lanes and connections."""
    root = etree.parse(path).getroot()
    lanes = {}
    for lane in root.iterfind("edge/lane"):
        points = [tuple(map(float, point.split(","))) for point in lane.get("shape").split()]
        rules = [lane.get(name) for name in ("allow", "disallow", "changeLeft", "changeRight")]
        rules += [f"{float(lane.get('width')):.2f}", *(param.get("value") for param in lane.iterfind("param"))]
        numbers = float(lane.get("length")), float(lane.get("speed"))
        lanes[lane.get("id")] = Lane((points[0], points[-1]), *numbers, tuple(rules))
    links = [tuple(map(link.get, ("from", "fromLane", "to", "toLane"))) for link in root.iterfind("connection")]
    return Net(lanes, frozenset(links))


def save(net: Path, saved: Path) -> Path:
    """Let netconvert read a net and write it again."""
    command = [sumo_program("netconvert"), "-s", str(net), "-o", str(saved), "--xml-validation", "never"]
    result = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "PROJ_DEBUG": "0"})
    assert result.returncode == 0, result.stderr
    return saved


def check_same(net: Path, saved: Path) -> None:
    """All lanes are where they were, as long as they were, with the same connections and rules; no cell is too long."""
    before, after = read_net(net), read_net(saved)
    assert after.links == before.links
    assert after.lanes.keys() == before.lanes.keys()
    for lane_id, lane in before.lanes.items():
        now = after.lanes[lane_id]
        assert now.rules == lane.rules, lane_id
        assert max(map(math.dist, lane.ends, now.ends)) <= 0.02, lane_id
        assert abs(now.length_m - lane.length_m) <= 0.2, lane_id
        assert abs(now.limit_mps - lane.limit_mps) <= 0.006, lane_id
        assert now.length_m <= 4.05 or lane_id.startswith("trace_"), lane_id


def on_lane_shares(graph: LaneGraph, nets: Sequence[Path], folder: Path) -> list[float]:
    """Share of the steps of a vehicle along each lane segment, a metre each, in which each net has it on its cell."""
    grid = build_cell_grid(graph, saved_within_m=SAVED_WITHIN_M)
    ways, wanted = {}, {}
    for lane_id, lane in graph.lanes.items():
        s = np.arange(0.5, max(lane.length_m, 1.0), 1.0)
        poses = np.column_stack([lane.path.point(s), (90.0 - np.degrees(lane.path.heading(s))) % 360.0]).tolist()
        cells = [grid.cell_at(lane_id, at) for at in s.tolist()]
        names = [(grid.edge_id(cell), grid.lane_index(cell)) for cell in cells]
        ways[str(lane_id)] = [[*name, *pose] for name, pose in zip(names, poses, strict=True)]
        wanted[str(lane_id)] = [f"{edge}_{index}" for edge, index in names]
    (folder / "ways.json").write_text(json.dumps(ways))
    shares = []
    for path in nets:
        command = [sys.executable, "-c", PLACE, str(path), str(folder / "ways.json"), str(folder / "lanes.json")]
        result = subprocess.run(command, capture_output=True, text=True)
        assert result.returncode == 0, result.stderr
        found = json.loads((folder / "lanes.json").read_text())
        on = [a == b for lane_id in ways for a, b in zip(found[lane_id], wanted[lane_id], strict=True)]
        shares.append(sum(on) / len(on))
    return shares
