"""Inserted vehicles: a planned vehicle becomes one that SUMO drives."""

from bridge.sumo.poses import front_arc_m
from bridge.sumo.simulation import Simulation
from hid2.motion.route import DrivenPath
from hid2.scene import PlannedVehicle, World
from netconvert.cells import Cell


def edges_along(world: World, path: DrivenPath, cell: Cell) -> tuple[str, ...] | None:
    """SUMO edges from a cell on along the lanes of a path; None where the path does not use the cell's lane."""
    lanes = [segment.lane_id for segment in path.segments]
    if cell.lane_id not in lanes:
        return None
    grid = world.grid
    edges: list[str] = []
    first = cell.index
    last = len(lanes) - 1 - lanes[::-1].index(cell.lane_id)  # an overtake comes back to the lane it left
    for lane_id in lanes[last:]:
        for index in range(first, grid.count(lane_id)):
            edge = grid.edge_id(Cell(lane_id, index))
            if not edges or edges[-1] != edge:
                edges.append(edge)
        first = 0
    return tuple(edges)


def insert(simulation: Simulation, world: World, spec: PlannedVehicle) -> str | None:
    """Insert at the planned cell, position and speed. Returns SUMO's objection, None where it accepts."""
    front = front_arc_m(spec.s0, spec.size.length_m)
    segment = spec.path.segment_at(front)
    lane_s = segment.lane_s(front)
    cell = world.grid.cell_at(segment.lane_id, lane_s)
    edges = edges_along(world, spec.path, cell)
    if edges is None:
        return "no_route"
    driving = world.config.car_following
    grid_lane = world.grid.sumo_lane_id(cell)
    start = float(world.grid.edges_s(cell.lane_id)[cell.index])
    front_m = max(0.0, lane_s - start)
    objection = simulation.insert(
        spec.vehicle_id, edges=edges, lane_id=grid_lane, front_m=front_m,
        speed_mps=spec.v0, length_m=spec.size.length_m, width_m=spec.size.width_m, accel_mps2=driving.accel_mps2,
        decel_mps2=driving.decel_mps2, tau_s=driving.tau_s, min_gap_m=driving.min_gap_m,
        max_speed_mps=max(world.config.spawn.max_speed_mps, spec.cruise_mps),
    )  # fmt: skip
    if objection is None and "collision" in world.config.without:
        simulation.disregard_others(spec.vehicle_id)
    return objection
