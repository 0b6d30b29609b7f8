"""A scene in SUMO's own formats: net, routes of the inserted vehicles, FCD output of all, geo-reference.

<id>.net.xml     the net of `hid2 net`, with the city's UTM zone and origin: sumo-gui and sumolib put it on a map
<id>.rou.xml     the inserted vehicles: type and driver, departure, route along the net's edges
<id>.fcd.xml     what `sumo --fcd-output` would have written: every agent at every step, as it was exported
<id>.sumocfg     SUMO drives the inserted vehicles, alone and by its own car following
<id>_scene.*     plain sumo-gui plays the whole scene, as `bridge.sumo.playback` lays it out

Positions in the FCD output are SUMO's: the middle of the front bumper, and degrees clockwise from north. Every agent is
a vehicle of its own size there, pedestrians too, as in the simulation; one off every lane has the nearest in `lane`.
"""

import logging
from collections import deque
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import shapely
from lxml import etree

from bridge.recordings.folders import Address
from bridge.recordings.recording import Recording
from bridge.recordings.sidecar import AgentRecord, Sidecar, sidecar_in
from bridge.recordings.sources import read_recording
from bridge.sumo.net import write_all
from bridge.sumo.playback import GUI_SHAPES, paints, playable_files
from bridge.sumo.poses import sumo_poses
from hid2.agents import FloatArray
from hid2.measures.arrays import stack
from hid2.measures.lane_matching import flatten_lanes, match_lanes
from netconvert.cells import Cell, CellGrid, build_cell_grid
from netconvert.fidelity import FidelityReport, measure_fidelity
from netconvert.geo import CITY_ORIGINS
from netconvert.gui_files import gui_files
from netconvert.net_xml import net_bytes

_LOG = logging.getLogger(__name__)
#: Digits of FCD output: a millimetre, a thousandth of a degree and of a metre per second.
_DIGITS = 3


class _Placed(NamedTuple):
    """Where an agent's front bumper is on the net at each of its steps: (N,) cells and metres along them."""

    cells: list[Cell]
    pos_m: FloatArray


def write_sumo(address: Address, out_dir: Path) -> tuple[FidelityReport, Path]:
    """Write a recording's or a generated scene's files into out_dir: how true the net is, and what sumo-gui plays.

    All files or, after an error, none. Errors: ScenarioError, MapError, NetError.
    """
    scenario = read_recording(address)
    grid = build_cell_grid(scenario.graph)
    files = sumo_files(scenario, sidecar_in(scenario.folder, scenario.scenario_id), grid)
    report = measure_fidelity(grid, files[f"{scenario.scenario_id}.net.xml"])
    playable = playable_files(scenario, grid)
    write_all(out_dir, files | playable)
    return report, out_dir / next(name for name in playable if name.endswith(".sumocfg"))


def sumo_files(scenario: Recording, sidecar: Sidecar | None, grid: CellGrid) -> dict[str, bytes]:
    """Contents by file name, but for <id>_scene.*. sidecar: of a generated scene; its vehicles get routes."""
    name = scenario.scenario_id
    placed = _places(scenario, grid)
    files = gui_files(grid, name, step_s=scenario.step_s)
    files[f"{name}.net.xml"] = net_bytes(grid, origin=CITY_ORIGINS.get(scenario.city))
    files[f"{name}.fcd.xml"] = fcd_bytes(scenario, grid, placed)
    if sidecar is not None:
        files[f"{name}.rou.xml"] = _routes(scenario, sidecar, grid, placed)
        files[f"{name}.sumocfg"] = _configuration(files[f"{name}.sumocfg"], scenario, f"{name}.rou.xml")
    return files


def fcd_bytes(scenario: Recording, grid: CellGrid, placed: Mapping[str, _Placed]) -> bytes:
    """FCD output: the timesteps in order, and the agents of each in the scene's order."""
    steps: list[list[str]] = [[] for _ in range(scenario.num_steps)]
    for track in scenario.tracks:
        front, angle = sumo_poses(track.position, track.heading, np.full(len(track.timesteps), track.size.length_m))
        where = placed[track.track_id]
        rows = zip(track.timesteps.tolist(), front.tolist(), angle.tolist(), track.speed.tolist(), strict=True)
        for row, (step, (x, y), degrees, speed) in enumerate(rows):
            lane, pos = grid.sumo_lane_id(where.cells[row]), where.pos_m[row]
            steps[step].append(
                f'<vehicle id="{_escaped(track.track_id)}" x="{x:.{_DIGITS}f}" y="{y:.{_DIGITS}f}" '
                f'angle="{degrees:.{_DIGITS}f}" type="type_{_escaped(track.track_id)}" speed="{speed:.{_DIGITS}f}" '
                f'pos="{pos:.{_DIGITS}f}" lane="{lane}" slope="0.00"/>'
            )
    lines = ["<?xml version='1.0' encoding='UTF-8'?>", "<fcd-export>"]
    for step, vehicles in enumerate(steps):
        lines.append(f'    <timestep time="{step * scenario.step_s:.2f}">')
        lines += [f"        {vehicle}" for vehicle in vehicles]
        lines.append("    </timestep>")
    return "\n".join([*lines, "</fcd-export>", ""]).encode()


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")


def _places(scenario: Recording, grid: CellGrid) -> dict[str, _Placed]:
    """Cells of every agent, by the lane that it is matched to, else by the nearest lane."""
    tracks, graph = scenario.tracks, scenario.graph
    arrays = stack(tracks, num_steps=scenario.num_steps, step_s=scenario.step_s)
    flat = flatten_lanes(graph)
    matches, _ = match_lanes(arrays, flat)
    lines = [shapely.LineString(flat.lane_points(lane)) for lane in range(len(flat.lane_ids))]
    nearest = shapely.STRtree(lines).nearest(shapely.points(arrays.position))
    lane_ids = flat.lane_ids[np.where(matches.lane >= 0, matches.lane, nearest)]
    front, _ = sumo_poses(arrays.position, arrays.heading, arrays.length[arrays.agent])
    along = np.empty(len(lane_ids))
    for lane_id in np.unique(lane_ids).tolist():
        rows = lane_ids == lane_id
        along[rows] = graph.lanes[lane_id].path.frenet(front[rows])[0]
    cells = [grid.cell_at(lane_id, s) for lane_id, s in zip(lane_ids.tolist(), along.tolist(), strict=True)]
    begin = np.array([grid.edges_s(cell.lane_id)[cell.index] for cell in cells])
    pos = np.clip(along - begin, 0.0, [grid.length_m(cell) for cell in cells])
    bounds = list(pairwise(arrays.first.tolist()))
    return {
        track_id: _Placed(cells[start:stop], pos[start:stop])
        for track_id, (start, stop) in zip(arrays.track_ids, bounds, strict=True)
    }


def _routes(scenario: Recording, sidecar: Sidecar, grid: CellGrid, placed: Mapping[str, _Placed]) -> bytes:
    """Types of the inserted vehicles, and the vehicles in the order of departure."""
    root = etree.Element("routes")
    colors = paints(scenario)
    agents = {agent.track_id: agent for agent in sidecar.agents}
    tracks = [track for track in scenario.tracks if track.track_id in agents]
    tracks.sort(key=lambda track: (int(track.timesteps[0]), track.track_id))
    for track in tracks:
        kind = {"id": f"type_{track.track_id}", "length": f"{track.size.length_m:.2f}"}
        kind |= {"width": f"{track.size.width_m:.2f}", "color": colors[track.track_id].xml}
        kind |= {"guiShape": GUI_SHAPES[track.object_type]} | _driver(agents[track.track_id])
        etree.SubElement(root, "vType", kind)
    links = _edge_links(grid)
    for track in tracks:
        name, where = track.track_id, placed[track.track_id]
        vehicle = {"id": name, "type": f"type_{name}", "depart": f"{track.timesteps[0] * scenario.step_s:.2f}"}
        vehicle |= {"departLane": str(grid.lane_index(where.cells[0])), "departPos": f"{where.pos_m[0]:.2f}"}
        vehicle |= {"departSpeed": f"{track.speed[0]:.2f}", "insertionChecks": "none"}
        element = etree.SubElement(root, "vehicle", vehicle)
        etree.SubElement(element, "route", {"edges": " ".join(_edges(where.cells, grid, links, name))})
    return _content(root)


def _driver(agent: AgentRecord) -> dict[str, str]:
    """Car following as the vehicle was driven with."""
    if agent.driver is None:
        return {}
    known = {"carFollowModel": agent.driver.model}
    return known | {key: f"{value:g}" for key, value in sorted(agent.driver.parameters.items())}


def _edge_links(grid: CellGrid) -> dict[str, tuple[str, ...]]:
    """Edges that follow an edge on any of its lanes."""
    links: dict[str, dict[str, None]] = {}
    for row in grid.rows():
        following = links.setdefault(grid.edge_id(row[0]), {})
        for cell in row:
            ahead = grid.longitudinal(cell)
            for target in (ahead,) if ahead is not None else grid.inter_lane(cell):
                following[grid.edge_id(target)] = None
    return {edge: tuple(targets) for edge, targets in links.items()}


def _edges(cells: Sequence[Cell], grid: CellGrid, links: Mapping[str, tuple[str, ...]], name: str) -> list[str]:
    """The edges that a vehicle drove, without gaps: between two that do not follow each other the shortest way."""
    edges: list[str] = []
    for cell in cells:
        edge = grid.edge_id(cell)
        if not edges or edge == edges[-1]:
            edges = edges or [edge]
        elif edge not in edges:
            way = _way(edges[-1], edge, links)
            if way is None:
                _LOG.warning("%s: the net has no way from edge %s to %s, its route ends there", name, edges[-1], edge)
                break
            edges += way
    return edges


def _way(start: str, goal: str, links: Mapping[str, tuple[str, ...]]) -> list[str] | None:
    """Edges after start to goal, the fewest; None where there is no way."""
    before = {start: start}
    queue = deque([start])
    while queue:
        edge = queue.popleft()
        if edge == goal:
            way = []
            while edge != start:
                way.append(edge)
                edge = before[edge]
            return way[::-1]
        for target in links.get(edge, ()):
            if target not in before:
                before[target] = edge
                queue.append(target)
    return None


def _configuration(base: bytes, scenario: Recording, routes: str) -> bytes:
    root = etree.fromstring(base)
    given, time = root.find("input"), root.find("time")
    assert given is not None
    assert time is not None
    etree.SubElement(given, "route-files", {"value": routes})
    etree.SubElement(time, "end", {"value": f"{scenario.num_steps * scenario.step_s:.2f}"})
    return _content(root)


def _content(root: etree._Element) -> bytes:
    content: bytes = etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)
    return content
