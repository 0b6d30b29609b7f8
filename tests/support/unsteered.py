"""Bare SUMO beside which the tool's price is told: recorded agents replayed, vehicles driven by it unsteered."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import bridge.sumo.simulation  # noqa: F401  # it silences a remark of libsumo's import on stdout
from bridge.sumo.poses import front_arc_m
from bridge.sumo.steering import edges_along
from hid2.agents import FloatArray
from hid2.occupancy.traffic import Traffic
from hid2.scene import Scene
from hid2.vehicle import Start

import libsumo  # after it  # isort: skip


@dataclass(frozen=True, eq=False, slots=True)
class UnsteeredStart:
    """One unsteered vehicle: SUMO edges, lane index and position of the front bumper on the first, speed."""

    edges: tuple[str, ...]
    lane_index: int
    front_m: float
    speed_mps: float


def unsteered_start(scene: Scene, begun: Start) -> UnsteeredStart:
    """Where a vehicle of hid2 begins, as SUMO takes it."""
    front = front_arc_m(begun.start_m, begun.size.length_m)
    segment = begun.path.segment_at(front)
    lane_m = segment.lane_m(front)
    cell = scene.grid.cell_at(segment.lane_id, lane_m)
    edges = edges_along(scene, begun.path, cell)
    assert edges is not None
    begin = float(scene.grid.edges_m[cell.lane_id][cell.index])
    return UnsteeredStart(edges, scene.grid.lane_index(cell), max(0.0, lane_m - begin), begun.start_mps)


def simulate_unsteered(
    net: Path, traffic: Traffic, front: FloatArray, angle: FloatArray, starts: Sequence[UnsteeredStart]
) -> None:
    """Nothing but what SUMO itself needs, from loading the net to closing. front (A, T, 2) m, angle (A, T) degrees."""
    libsumo.start([
        "sumo", "--net-file", str(net), "--step-length", "0.1", "--seed", "0", "--collision.action", "none",
        "--time-to-teleport", "-1", "--no-step-log", "true", "--no-warnings", "true", "--duration-log.disable", "true",
    ])  # fmt: skip
    vehicle = libsumo.vehicle
    libsumo.vehicletype.copy("DEFAULT_VEHTYPE", "recorded")
    libsumo.vehicletype.setVehicleClass("recorded", "ignoring")
    libsumo.route.add("replay", [libsumo.edge.getIDList()[0]])
    inside: set[int] = set()
    for step in range(traffic.num_steps):
        here = set(np.flatnonzero(traffic.present[:, step]).tolist())
        for row in inside - here:
            vehicle.remove(f"r{row}")
        for row in here - inside:
            vehicle.add(f"r{row}", "replay", typeID="recorded", depart="now")
        for row in here:
            x, y = front[row, step].tolist()
            vehicle.moveToXY(f"r{row}", "", -1, x, y, float(angle[row, step]), keepRoute=6, matchThreshold=3.0)
        inside = here
        if step == 0:
            for row, start in enumerate(starts):
                libsumo.route.add(f"way{row}", list(start.edges))
                vehicle.add(
                    f"v{row}", f"way{row}", depart="now", departLane=str(start.lane_index),
                    departPos=f"{start.front_m:.3f}", departSpeed=f"{start.speed_mps:.3f}",
                )  # fmt: skip
        libsumo.simulationStep()
    libsumo.close()
