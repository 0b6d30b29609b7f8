"""A scene in SUMO's own formats: net, routes of the inserted vehicles, FCD output of all, geo-reference.

<id>.net.xml     the net of `hid2 net`, with the city's UTM zone and origin: sumo-gui and sumolib put it on a map
<id>.rou.xml     the inserted vehicles: type and driver, departure, route along the net's edges
<id>.fcd.xml     what `sumo --fcd-output` would have written: every agent at every step, as it was exported
<id>.sumocfg     SUMO drives the inserted vehicles, where there are any, alone, by its own models
<id>_scene.*     plain sumo-gui plays the whole scene, as `bridge.sumo.playback` lays it out

Positions in the FCD output are SUMO's: the middle of the front bumper, and degrees clockwise from north. Every agent is
a vehicle of its own size there, pedestrians too, as in the simulation; it has a lane where it has one there.
"""

import logging
import math
from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
import shapely
from lxml import etree
from lxml.builder import E

from bridge.config import config_from_dict
from bridge.pictures.figures import kinds_in
from bridge.recordings.recording import Recording
from bridge.recordings.sidecar import Sidecar
from bridge.sumo.drivers import driver_attributes, model_parameters
from bridge.sumo.playback import departure, playable_files, run_options, type_id, vehicle_type
from bridge.sumo.poses import sumo_poses
from hid2.agents import FloatArray
from hid2.drivers.driver import Driver
from hid2.measures.lane_matching import flatten_lanes
from hid2.occupancy.agent_states import agent_states
from hid2.occupancy.shown import ASIDE_M
from hid2.occupancy.traffic import BoolArray
from hid2.params import Config
from netconvert.cells import SAVED_WITHIN_M, Cell, CellGrid, build_cell_grid
from netconvert.errors import ScenarioError
from netconvert.gui_files import gui_files, xml_bytes
from netconvert.lane_graph import TurnType
from netconvert.net_xml import CITY_ORIGINS, net_bytes

_LOG = logging.getLogger(__name__)
#: Where an agent's front bumper is on the net at each of its steps: (N,) cells, metres along them, and whether it is
#: near enough to its lane to be on it.
_Placed = tuple[list[Cell], FloatArray, BoolArray]


def sumo_files(scenario: Recording) -> dict[str, bytes]:
    """Contents of all files by file name; vehicles of a generated scene get routes."""
    name, sidecar = scenario.scenario_id, scenario.sidecar
    config = Config() if sidecar is None else config_from_dict(sidecar.config, source=f"{name}: the sidecar's config")
    grid = build_cell_grid(scenario.graph, saved_within_m=SAVED_WITHIN_M)
    placed = _places(scenario, grid)
    files = gui_files(grid, name, step_s=scenario.step_s, options=run_options(scenario, f"{name}.rou.xml"))
    fastest_mps = config.spawn.max_speed_mps
    files[f"{name}.net.xml"] = net_bytes(grid, origin=CITY_ORIGINS.get(scenario.city), fastest_mps=fastest_mps)
    files[f"{name}.fcd.xml"] = _fcd(scenario, grid, placed)
    if sidecar is None or not sidecar.agents:
        del files[f"{name}.sumocfg"]  # SUMO would have nothing to drive
    else:
        files[f"{name}.rou.xml"] = _routes(scenario, sidecar, config, grid, placed)
    return files | playable_files(scenario, grid)


def fcd_files(scenario: Recording) -> dict[str, bytes]:
    """The FCD output and the net with the lanes that it names, by file name."""
    grid = build_cell_grid(scenario.graph, saved_within_m=SAVED_WITHIN_M)
    return {
        f"{scenario.scenario_id}.fcd.xml": _fcd(scenario, grid, _places(scenario, grid)),
        f"{scenario.scenario_id}.net.xml": net_bytes(grid, origin=CITY_ORIGINS.get(scenario.city)),
    }


def _fcd(scenario: Recording, grid: CellGrid, placed: Mapping[str, _Placed]) -> bytes:
    """FCD output: the timesteps in order, and the agents of each in the scene's order."""
    root = E("fcd-export", *(E.timestep(time=f"{step * scenario.step_s:.2f}") for step in range(scenario.num_steps)))
    for track in scenario.tracks:
        name, (cells, pos, on) = track.track_id, placed[track.track_id]
        front, angle = sumo_poses(track.position, track.heading, np.full(len(track.timesteps), track.size.length_m))
        rows = np.column_stack([front, angle, track.speed, pos]).tolist()
        for step, cell, there, row in zip(track.timesteps.tolist(), cells, on.tolist(), rows, strict=True):
            x, y, degrees, speed, along = (f"{value:.3f}" for value in row)  # to mm, 0.001 degrees, mm/s
            place = {"id": name, "x": x, "y": y, "angle": degrees, "type": type_id(track), "speed": speed}
            place |= {"pos": along, "lane": grid.sumo_lane_id(cell)} if there else {}
            root[step].append(E.vehicle({**place, "slope": "0.00"}))
    etree.indent(root, "    ")
    return xml_bytes(root)


def _places(scenario: Recording, grid: CellGrid) -> dict[str, _Placed]:
    """Cells of every agent, by the lane that it is matched to, else by the nearest lane, however far."""
    tracks, graph = scenario.tracks, scenario.graph
    flat = flatten_lanes(graph)
    states = agent_states(tracks, flat, num_steps=scenario.num_steps, step_s=scenario.step_s)
    arrays, matches = states.arrays, states.matches
    lines = [shapely.LineString(flat.lane_points(lane)) for lane in range(len(flat.lane_ids))]
    nearest = shapely.STRtree(lines).nearest(shapely.points(arrays.position))
    rows = np.where(matches.lane >= 0, matches.lane, nearest)
    front, _ = sumo_poses(arrays.position, arrays.heading, arrays.length[arrays.agent])
    apart_m = shapely.distance(shapely.points(front), np.array(lines)[rows])
    on, lane_ids = (matches.lane >= 0) | (apart_m <= ASIDE_M), flat.lane_ids[rows]
    along = np.empty(len(lane_ids))
    for lane_id in np.unique(lane_ids).tolist():
        here = lane_ids == lane_id
        along[here] = graph.lanes[lane_id].path.frenet(front[here])[0]
    cells = [grid.cell_at(lane_id, s) for lane_id, s in zip(lane_ids.tolist(), along.tolist(), strict=True)]
    begin = np.array([grid.edges_s(cell.lane_id)[cell.index] for cell in cells])
    pos = np.clip(along - begin, 0.0, [grid.length_m(cell) for cell in cells])
    bounds = zip(arrays.track_ids, pairwise(arrays.first.tolist()), strict=True)
    return {track_id: (cells[start:stop], pos[start:stop], on[start:stop]) for track_id, (start, stop) in bounds}


def _routes(
    scenario: Recording, sidecar: Sidecar, config: Config, grid: CellGrid, placed: Mapping[str, _Placed]
) -> bytes:
    """Types of the inserted vehicles, and the vehicles in the order of departure."""
    faces, drivers = kinds_in(scenario), {agent.track_id: agent.driver for agent in sidecar.agents}
    links = {
        grid.edge_id(row[0]): [grid.edge_id(target) for cell in row for target in grid.following(cell)]
        for row in grid.rows()
    }
    kinds, vehicles = [], []
    for track in sorted((track for track in scenario.tracks if track.track_id in drivers), key=departure):
        name, (cells, pos, _) = track.track_id, placed[track.track_id]
        kind, driver, speed_mps = vehicle_type(track, faces[name]), drivers[name], float(track.speed[0])
        if driver is not None:  # car following as the vehicle was driven with
            try:
                drives = Driver(**driver.parameters)
            except TypeError as error:
                known = ", ".join(driver.parameters) or "nothing"
                raise ScenarioError(f"{name}: the driver in the sidecar has {known}, expected all of one") from error
            more = model_parameters(config) | driver_attributes(drives, driver.model)
            kind |= {"carFollowModel": driver.model, **{key: f"{value:g}" for key, value in more.items()}}
            speed_mps = min(speed_mps, more["maxSpeed"])  # SUMO inserts no vehicle that is faster
        kinds.append(E.vType(kind))
        vehicle = {"id": name, "type": type_id(track), "depart": f"{track.timesteps[0] * scenario.step_s:.2f}"}
        vehicle |= {"departLane": str(grid.lane_index(cells[0])), "departPos": _rounded_down(pos[0])}
        vehicle |= {"departSpeed": _rounded_down(speed_mps), "insertionChecks": "none"}
        edges = _edges(cells, grid, links, name) + _onward(cells[-1], grid)
        vehicles.append(E.vehicle(vehicle, E.route(edges=" ".join(edges))))
    return xml_bytes(E.routes(*kinds, *vehicles))


def _rounded_down(value: float) -> str:
    """To two digits, and so within a lane and a greatest speed."""
    return f"{math.floor(value * 100.0) / 100.0:.2f}"


def _edges(cells: Sequence[Cell], grid: CellGrid, links: Mapping[str, Sequence[str]], name: str) -> list[str]:
    """The edges that a vehicle drove, without gaps: between two that do not follow each other the shortest way."""
    edges: list[str] = []
    for edge in map(grid.edge_id, cells):
        if edge not in edges:
            way = _way(edges[-1], edge, links) if edges else [edge]
            if way is None:
                _LOG.warning("%s: the net has no way from edge %s to %s, its route ends there", name, edges[-1], edge)
                break
            edges += way
    return edges


def _onward(cell: Cell, grid: CellGrid) -> list[str]:
    """The edges from a cell to the map's edge, straight on where there are: SUMO may be faster than it was."""
    edges: list[str] = []
    while targets := grid.following(cell):
        cell = min(targets, key=lambda one: grid.graph.lanes[one.lane_id].turn is not TurnType.STRAIGHT)
        if (edge := grid.edge_id(cell)) in edges:
            break
        edges.append(edge)
    return edges


def _way(start: str, goal: str, links: Mapping[str, Sequence[str]]) -> list[str] | None:
    """Edges after start to goal, the fewest; None where there is no way."""
    ways: dict[str, list[str]] = {start: []}
    queue = [start]
    for edge in queue:  # which grows
        for target in links[edge]:
            if target not in ways:
                ways[target] = [*ways[edge], target]
                queue.append(target)
    return ways.get(goal)
