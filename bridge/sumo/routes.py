"""The path of a vehicle as SUMO's route, and another one from the next split on."""

from itertools import groupby

import numpy as np

from bridge.sumo.fleet import Fleet
from bridge.sumo.simulation import Simulation
from hid2.agents import Policy
from hid2.conflicts.guard import ACTS_MPS2, A, S
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.motion.route import DrivenPath
from hid2.policy.roads import ways_at_next_split
from hid2.scene import Scene
from netconvert.cells import Cell

_FASTER_MPS = 0.05  # over the speed of the road on another way, with which it is still taken; no tunable: rounding


def edges_along(scene: Scene, path: DrivenPath, cell: Cell) -> tuple[str, ...] | None:
    """SUMO edges from a cell on along the lanes of a path; None where the path does not use the cell's lane."""
    lanes = [segment.lane_id for segment in path.segments]
    if cell.lane_id not in lanes:
        return None
    grid, last = scene.grid, len(lanes) - 1 - lanes[::-1].index(cell.lane_id)  # an overtake comes back to its lane
    cells = [Cell(cell.lane_id, index) for index in range(cell.index, grid.count(cell.lane_id))]
    cells += [Cell(lane_id, index) for lane_id in lanes[last + 1 :] for index in range(grid.count(lane_id))]
    return tuple(edge for edge, _ in groupby(map(grid.edge_id, cells)))


def take_another_way(fleet: Fleet, simulation: Simulation, row: int, now: int) -> bool:
    """Send a vehicle another way at the next split if no agent is met there (conflict case 3); whether it goes there.

    Only one that is to go straight: another way is no longer the turn or the change of lanes that was asked for.
    """
    vehicle, way, scene = fleet.vehicles[row], fleet.ways[row], fleet.scene
    if vehicle.policy is not Policy.STRAIGHT or way.reroute_tried:
        return False
    way.reroute_tried = True
    s, v, a = fleet.state[row, S : A + 1].tolist()
    cell = scene.grid.cell_of_sumo_lane.get(simulation.lane(vehicle.vehicle_id)[0])
    if cell is None:
        return False
    for path in ways_at_next_split(scene, vehicle.path, s=s, from_m=s + vehicle.start.box.length_m):
        at = path.all_to_line(vehicle.path.all_to_raw(np.array(vehicle.s)))
        road = fleet.roads.speeds(path, vehicle.start.driver)
        if v > road[min(int(at[-1] / TABLE_STEP_M), road.size - 1)] + _FASTER_MPS:
            continue
        found = fleet.braking(
            row, path, now, state=(float(at[-1]), v, a), desired_mps=float(vehicle.start.desired[now])
        )
        edges = edges_along(scene, path, cell)
        if found.conflict_s is None and found.decel_mps2 < ACTS_MPS2 and edges:
            simulation.set_route(vehicle.vehicle_id, edges)
            fleet.take_path(row, path, at)
            vehicle.rerouted_at = now
            return True
    return False
