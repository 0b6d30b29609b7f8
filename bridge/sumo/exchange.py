"""A scene in SUMO's own formats: net, routes of the inserted vehicles, FCD output of all, geo-reference.

<id>.net.xml     the net of `hid2 net`, with the city's UTM zone and origin: sumo-gui and sumolib put it on a map
<id>.rou.xml     the inserted vehicles: type and driver, departure, route along the net's edges
<id>.fcd.xml     what `sumo --fcd-output` would have written: every agent at every step, as it was exported
<id>.sumocfg     SUMO drives the inserted vehicles, where there are any, alone, by its own models
<id>_scene.*     plain sumo-gui plays the whole scene, without Python; `hid2 gui` opens it

Positions in the FCD output are SUMO's: the middle of the front bumper, and degrees clockwise from north. Every agent is
a vehicle of its own size there, pedestrians too, as in the simulation; it has a lane where it has one there.

A vehicle of SUMO's keeps to its lane and its lane's speed limit. So to be played every agent gets lanes of its own, a
centimetre wide, one for each stretch of constant velocity. They need not meet: a lane is laid so that the vehicle,
which drives further in every step than it is long, ends each step where its front bumper was recorded, with its back on
the same lane, and the lane's direction is its heading. What SUMO tells as its speed is that advance.
"""

import logging
import math
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import shapely
from lxml import etree
from lxml.builder import E

from bridge.files import beside, make_folder
from bridge.interruption import SIGNALS
from bridge.pictures.figures import FACES, check_ending, check_step, kinds_in, moving_ground
from bridge.recordings.folders import Address
from bridge.recordings.judging import recording_states
from bridge.recordings.recording import Recording
from bridge.recordings.sidecar import Sidecar
from bridge.recordings.sources import read_recording
from bridge.sumo.drivers import driver_attributes, model_parameters
from bridge.sumo.net import config_of, scene_net, sumo_program
from bridge.sumo.poses import sumo_poses
from hid2.agents import FOCAL_CATEGORY, FloatArray, Track
from hid2.drivers.driver import Driver
from hid2.kernels.gaps import ASIDE_M
from hid2.measures.arrays import is_generated_id
from hid2.measures.lane_matching import FlatLanes
from hid2.occupancy.traffic import BoolArray
from netconvert.cells import SAVED_WITHIN_M, Cell, CellGrid, build_cell_grid
from netconvert.errors import ExportError, NetError, ScenarioError, SimulationError
from netconvert.gui_files import REAL_TIME_MS, gui_files, xml_bytes
from netconvert.lane_graph import TurnType
from netconvert.net_xml import junction, junction_beside, shape

_LOG = logging.getLogger(__name__)
#: Where an agent's front bumper is on the net at each of its steps: (N,) cells, metres along them, and whether it is
#: near enough to its lane to be on it.
_Placed = tuple[list[Cell], FloatArray, BoolArray]
# No tunables: how a scene is drawn in sumo-gui; nothing that is generated depends on any of these.
#: Tolerances of front bumpers and headings on a stretch of constant velocity.
_WITHIN_M, _WITHIN_RAD = 0.05, 0.05
#: Least length of a shape, m: SUMO takes a shorter one to be as long.
_LEAST_SHAPE_M = 0.1
#: Way beyond its length that a vehicle drives in a step, m: no step ends near the end of a lane.
_CLEAR_M = 1.0
#: Least distance of the junctions that a lane of a trace joins, m: netedit takes no edge between two in one place.
_JUNCTIONS_APART_M = 0.05
#: Lanes for this class of vehicle are transparent in the view settings (`gui_files`); no map has any.
_UNSEEN = "ship"
#: Parameter of a vehicle that holds the id to show.
ID_KEY = "shown_id"
#: Characters that SUMO takes in no id of a vehicle or type.
_NOT_IN_IDS = " \"&',;<>\\|"
#: SUMO's pictures of vehicles, by object type.
GUI_SHAPES = {"vehicle": "passenger/sedan", "bus": "bus", "motorcyclist": "motorcycle", "cyclist": "bicycle"}
GUI_SHAPES |= {"riderless_bicycle": "bicycle", "pedestrian": "pedestrian"}
#: Faces as in every picture, but for the focal vehicle's, which is too dark for sumo-gui's road.
GUI_FACES: Mapping[str, str] = {**FACES, "focal": "#F0E442"}


def sumo_files(scenario: Recording) -> dict[str, bytes]:
    """Contents of all files by file name; vehicles of a generated scene get routes."""
    name, sidecar = scenario.scenario_id, scenario.sidecar
    grid = build_cell_grid(scenario.graph, saved_within_m=SAVED_WITHIN_M)
    placed = _places(scenario, grid)
    files = gui_files(grid, name, step_s=scenario.step_s, options=run_options(scenario, f"{name}.rou.xml"))
    files |= {f"{name}.net.xml": scene_net(scenario, grid), f"{name}.fcd.xml": _fcd(scenario, grid, placed)}
    if sidecar is None or not sidecar.agents:
        del files[f"{name}.sumocfg"]  # SUMO would have nothing to drive
    else:
        files[f"{name}.rou.xml"] = _routes(scenario, sidecar, grid, placed)
    return files | playable_files(scenario, grid)


def fcd_files(scenario: Recording) -> dict[str, bytes]:
    """The FCD output and the net with the lanes that it names, by file name."""
    name, grid = scenario.scenario_id, build_cell_grid(scenario.graph, saved_within_m=SAVED_WITHIN_M)
    fcd = _fcd(scenario, grid, _places(scenario, grid))
    return {f"{name}.fcd.xml": fcd, f"{name}.net.xml": scene_net(scenario, grid)}


def _fcd(scenario: Recording, grid: CellGrid, placed: Mapping[str, _Placed]) -> bytes:
    """FCD output: the timesteps in order, and the agents of each in the scene's order."""
    root = E("fcd-export", *(E.timestep(time=f"{step * scenario.step_s:.2f}") for step in range(scenario.num_steps)))
    for track in scenario.tracks:
        name, (cells, pos, on) = track.track_id, placed[track.track_id]
        front, angle = sumo_poses(track.position, track.heading, track.size.length_m)
        rows = np.column_stack([front, angle, track.speed, pos]).tolist()
        for step, cell, there, row in zip(track.timesteps.tolist(), cells, on.tolist(), rows, strict=True):
            x, y, degrees, speed, along = (f"{value:.3f}" for value in row)  # to mm, 0.001 degrees, mm/s
            place = {"id": name, "x": x, "y": y, "angle": degrees, "type": type_id(track), "speed": speed}
            place |= {"pos": along, "lane": grid.sumo_lane_id(cell)} if there else {}
            root[step].append(E.vehicle({**place, "slope": "0.00"}))
    etree.indent(root, "    ")
    return xml_bytes(root)


def _places(scenario: Recording, grid: CellGrid) -> dict[str, _Placed]:
    """Cells under the front bumper of every agent, by the lane it is matched to, else the nearest, however far."""
    states, graph = recording_states(scenario), scenario.graph
    arrays, matches, flat = states.arrays, states.matches, states.lanes
    lines = [shapely.LineString(flat.lane_points(lane)) for lane in range(len(flat.lane_ids))]
    nearest = shapely.STRtree(lines).nearest(shapely.points(arrays.position))
    rows = np.where(matches.lane >= 0, matches.lane, nearest)
    front, _ = sumo_poses(arrays.position, arrays.heading, arrays.length[arrays.agent])
    along = np.empty(len(rows))
    for lane in np.unique(rows).tolist():
        here = rows == lane
        along[here] = graph.lanes[int(flat.lane_ids[lane])].path.frenet(front[here])[0]
    for row in np.flatnonzero(along > flat.length_m[rows]).tolist():
        driven = rows[row : arrays.first[arrays.agent[row] + 1]]
        rows[row], along[row] = _ahead(flat, int(rows[row]), float(along[row]), front[row], driven=driven.tolist())
    apart_m = shapely.distance(shapely.points(front), np.array(lines)[rows])
    on, lane_ids = (matches.lane >= 0) | (apart_m <= ASIDE_M), flat.lane_ids[rows]
    cells = [grid.cell_at(lane_id, s) for lane_id, s in zip(lane_ids.tolist(), along.tolist(), strict=True)]
    begin = np.array([grid.edges_m[cell.lane_id][cell.index] for cell in cells])
    pos = np.clip(along - begin, 0.0, [grid.length_m(cell) for cell in cells])
    bounds = zip(arrays.track_ids, pairwise(arrays.first.tolist()), strict=True)
    return {track_id: (cells[start:stop], pos[start:stop], on[start:stop]) for track_id, (start, stop) in bounds}


def _ahead(flat: FlatLanes, lane: int, s: float, front: FloatArray, *, driven: Sequence[int]) -> tuple[int, float]:
    """Lane that holds a front bumper (2,) m beyond the end of one, and s m on it. driven: lanes to prefer at splits."""
    point, passed = shapely.Point(front), {lane}
    while s > flat.length_m[lane] and (ways := set(flat.successors[lane]) - passed):
        far_m = {way: point.distance(shapely.LineString(flat.lane_points(way))) for way in ways}
        lane = min(ways, key=lambda way: (way not in driven, far_m[way], way))
        passed.add(lane)
        s = float(flat.graph.lanes[int(flat.lane_ids[lane])].path.frenet(front)[0][0])
    return lane, s


def _routes(scenario: Recording, sidecar: Sidecar, grid: CellGrid, placed: Mapping[str, _Placed]) -> bytes:
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
            more = model_parameters(config_of(scenario)) | driver_attributes(drives, driver.model)
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


def rgb(kind: str) -> str:
    """A colour as SUMO's files have it."""
    return ",".join(str(int(GUI_FACES[kind][k : k + 2], 16)) for k in (1, 3, 5))


def playable_files(scenario: Recording, grid: CellGrid) -> dict[str, bytes]:
    """<id>_scene.sumocfg, .net.xml, .rou.xml, .poly.xml and .view.xml by file name.

    The net is that of `hid2 net` with the lanes of the traces added, the view looks at what moves.
    sumo-gui shows the first step and waits, and the last one: vehicles are boxes of their size, with their ids.
    Errors: NetError for the id of a track that SUMO refuses.
    """
    if wrong := [track.track_id for track in scenario.tracks if {*track.track_id} & {*_NOT_IN_IDS}]:
        said = f"{scenario.folder}: track {wrong[0]!r}: SUMO takes no such id"
        raise NetError(f"{said}, expected one without any of the characters {_NOT_IN_IDS!r}; rename the track")
    name = f"{scenario.scenario_id}_scene"
    options = run_options(scenario, f"{name}.rou.xml")
    options["time"]["end"] = f"{(scenario.num_steps + 1) * scenario.step_s:.2f}"  # at which sumo-gui asks to close all
    options["processing"] = {"collision.action": "none", "time-to-teleport": "-1"}
    last_s = (scenario.num_steps - 1) * scenario.step_s
    options["gui_only"] = {"start": "true", "breakpoints": f"0.00,{last_s:.2f}"}
    vehicles = E.vehicles(
        {"vehicleMode": "0", "vehicleQuality": "1", "showBlinker": "0", "vehicle_minSize": "0", "scaleLength": "0"},
        {"vehicle_exaggeration": "1", "vehicleText_show": "1", "vehicleText_size": "46", "vehicleTextParam": ID_KEY},
        {"vehicleText_constantSize": "1", "vehicleText_color": "10,10,10", "vehicleText_bgColor": "255,255,255"},
        E.colorScheme(name="given vehicle/type/route color"),
    )
    shown, step_s = moving_ground(scenario), scenario.step_s
    traces = [_trace(track, step_s) for track in scenario.tracks]
    covered = [line for trace in traces for line in trace.shapes]
    files = gui_files(grid, name, step_s=step_s, shown=shown, covered=covered, options=options, vehicles=vehicles)
    del files[f"{name}.cells.csv"]
    files[f"{name}.net.xml"] = _with_traces(scene_net(scenario, grid), traces)
    files[f"{name}.rou.xml"] = _trace_routes(scenario, traces)
    return files


def run_options(scenario: Recording, routes: str) -> dict[str, dict[str, str]]:
    """Options with which SUMO runs a file of routes for as long as a scene lasts, by section and name."""
    return {"input": {"route-files": routes}, "time": {"end": f"{scenario.num_steps * scenario.step_s:.2f}"}}


@dataclass(frozen=True, eq=False, slots=True)
class _Trace:
    """The lanes of one track: shapes, each (2, 2) m, driven at limit m/s for so many steps of advance_m each."""

    track: Track
    shapes: tuple[FloatArray, ...]
    steps: tuple[int, ...]
    advance_m: float
    limit: str

    def edge(self, number: int) -> str:
        """Id of one of its edges."""
        return f"trace_{self.track.track_id}_{number}"


def _trace(track: Track, step_s: float) -> _Trace:
    """Lanes as long as possible; where a track has a gap, its agent drives evenly through."""
    steps = np.arange(track.timesteps[0], track.timesteps[-1] + 1)
    front, _ = sumo_poses(track.position, track.heading, track.size.length_m)
    front = np.stack([np.interp(steps, track.timesteps, front[:, axis]) for axis in (0, 1)], axis=1)
    heading = np.interp(steps, track.timesteps, np.unwrap(track.heading))
    advance_m = track.size.length_m + _CLEAR_M
    begins = 1.0 - 0.5 * _CLEAR_M / advance_m  # steps on a lane before its first front bumper
    shapes, counts, row = [], [], 0
    while row < len(steps):
        count, (place, velocity) = 1, (front[row], _LEAST_SHAPE_M * _direction(heading[row]))
        while row + count < len(steps):
            longer = _steady(front[row : row + count + 1], heading[row : row + count + 1])
            if longer is None:
                break
            count, (place, velocity) = count + 1, longer
        shapes.append(np.stack([place - begins * velocity, place + (count - begins) * velocity]))
        counts.append(count)
        row += count
    return _Trace(track, tuple(shapes), tuple(counts), advance_m, f"{advance_m / step_s:.4f}")


def _steady(front: FloatArray, heading: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """First place and advance a step, (2,) m, of front bumpers (N, 2) m that keep to a constant velocity, else None.

    It has the heading of the middle, forwards, also of what stands, which creeps as far as a shape has to be long.
    """
    rows, along = np.arange(len(front)), _direction(heading[len(heading) // 2])
    moved_m = float((front[-1] - front[0]) @ along)
    velocity = max(moved_m / (len(front) - 1), _LEAST_SHAPE_M / len(front)) * along
    place = front.mean(axis=0) - rows.mean() * velocity
    apart = front - place - rows[:, None] * velocity
    near = np.hypot(*apart.T).max() <= _WITHIN_M and np.abs(heading - heading[len(heading) // 2]).max() <= _WITHIN_RAD
    return (place, velocity) if near else None


def _direction(heading: float) -> FloatArray:
    return np.array([np.cos(heading), np.sin(heading)])


def _with_traces(net: bytes, traces: list[_Trace]) -> bytes:
    """Add the lanes of the traces to a net."""
    root = etree.fromstring(net)
    added: dict[str, list[etree._Element]] = {"edge": [], "junction": [], "connection": []}
    for trace in traces:
        for k, (points, steps) in enumerate(zip(trace.shapes, trace.steps, strict=True)):
            length = f"{steps * trace.advance_m:.4f}"
            edge = {"id": trace.edge(k), "from": f"{trace.edge(k)}_j", "to": f"{trace.edge(k + 1)}_j"}
            edge |= {"priority": "0", "length": length}
            lane = {"id": f"{trace.edge(k)}_0", "index": "0", "speed": trace.limit, "width": "0.01"}
            lane |= {"allow": _UNSEEN, "length": length, "shape": shape(points, digits=4), "customShape": "1"}
            added["edge"].append(E.edge(edge, E.lane(lane)))
            if k:
                link = {"from": trace.edge(k - 1), "to": trace.edge(k), "fromLane": "0", "toLane": "0", "dir": "s"}
                added["connection"].append(E.connection({**link, "state": "M"}))
        place = np.full(2, np.inf)
        for k in range(len(trace.shapes) + 1):
            incoming = [f"{trace.edge(k - 1)}_0"] if k else []
            end = trace.shapes[k - 1][1] if k else trace.shapes[0][0]
            line = junction_beside(end, trace.shapes[max(k - 1, 0) : k + 1])
            near = np.hypot(*(end - place)) < _JUNCTIONS_APART_M
            place = end + 2.0 * _JUNCTIONS_APART_M * np.array([near, 0.0])
            added["junction"].append(E.junction(junction(f"{trace.edge(k)}_j", place, incoming=incoming, line=line)))
    for tag, elements in added.items():
        before = root.findall(tag)
        behind = root.index(before[-1]) + 1 if before else len(root)
        root[behind:behind] = elements
    return xml_bytes(root)


def _trace_routes(scenario: Recording, traces: list[_Trace]) -> bytes:
    faces = kinds_in(scenario)
    kinds, vehicles = [], []
    for trace in sorted(traces, key=lambda trace: departure(trace.track)):
        name, limit = trace.track.track_id, trace.limit
        kind = vehicle_type(trace.track) | {"vClass": _UNSEEN, "maxSpeed": limit, "speedFactor": "1", "speedDev": "0"}
        kinds.append(E.vType(kind | {"minGap": "0", "sigma": "0", "tau": f"{scenario.step_s}"}))
        vehicle = {"id": name, "type": type_id(trace.track), "color": rgb(faces[name]), "insertionChecks": "none"}
        vehicle |= {"depart": f"{trace.track.timesteps[0] * scenario.step_s:.2f}", "departSpeed": limit}
        vehicle |= {"departPos": f"{trace.advance_m - 0.5 * _CLEAR_M:.4f}", "arrivalPos": "max"}
        shown = is_generated_id(name) or trace.track.category == FOCAL_CATEGORY  # all ids would hide each other
        params = [E.param(key=ID_KEY, value=name)] if shown else []
        edges = " ".join(trace.edge(k) for k in range(len(trace.shapes)))
        vehicles.append(E.vehicle(vehicle, *params, E.route(edges=edges)))
    return xml_bytes(E.routes(*kinds, *vehicles))


def departure(track: Track) -> tuple[int, str]:
    """What vehicles are sorted by in a file of routes."""
    return int(track.timesteps[0]), track.track_id


def vehicle_type(track: Track, kind: str | None = None) -> dict[str, str]:
    """Attributes of the type that each agent has of its own: id, size and looks. kind: with its colour."""
    looks = {} if kind is None else {"color": rgb(kind)}
    looks |= {"guiShape": GUI_SHAPES[track.object_type]} if track.object_type in GUI_SHAPES else {}
    size = {"length": f"{track.size.length_m:.2f}", "width": f"{track.size.width_m:.2f}"}
    return {"id": type_id(track), **size, **looks}


def type_id(track: Track) -> str:
    """Its type of its own by name: what it is, so that tools can tell cars from others, and its id."""
    return f"{track.object_type}_{track.track_id}"


def play_scene(
    folder: Address,
    *,
    speed: float = 1.0,
    screenshot: Path | None = None,
    step: int | None = None,
    on_shown: Callable[[], None] | None = None,
) -> Path | None:
    """Play a recorded or generated scene folder in sumo-gui; returns when its window is closed.

    It waits at the first step until the user presses play, and shows the last one until the user reloads. speed: 1 is
    real time. on_shown is called when sumo-gui has been started. screenshot: a .png file, written at timestep `step`
    (default: the last observed one); the window then closes at once and the file is returned.
    Errors: ScenarioError, MapError, NetError; ConfigError for a step that there is none of; SimulationError without
    sumo-gui or a display, or where it fails; ExportError where the picture cannot be written.
    """
    if screenshot is not None:
        check_ending(screenshot, [".png"])
    binary = sumo_program("sumo-gui")
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise SimulationError("no display for sumo-gui: set DISPLAY, or run it under xvfb-run")
    scenario = read_recording(folder)
    at_s = check_step(scenario, step) * scenario.step_s
    files = playable_files(scenario, build_cell_grid(scenario.graph, saved_within_m=SAVED_WITHIN_M))
    name = f"{scenario.scenario_id}_scene"
    # else what the user's last window had
    options = {"window-size": "1280,900", "delay": f"{REAL_TIME_MS / speed:.0f}"}
    if screenshot is not None:
        make_folder(screenshot.parent)
        view = etree.fromstring(files[f"{name}.view.xml"])
        view.append(E.snapshot(file=screenshot.name, time=f"{at_s:.2f}"))
        files[f"{name}.view.xml"] = xml_bytes(view)
        # where a list is expected an empty one is refused, so a time that never comes
        end_s = at_s + 2 * scenario.step_s
        options |= {"delay": "0", "breakpoints": "1e6", "end": f"{end_s:.2f}", "quit-on-end": "true"}
    with tempfile.TemporaryDirectory(prefix="hid2-gui-") as place:
        for file, content in files.items():
            (Path(place) / file).write_bytes(content)
        command = [binary, "-c", str(Path(place) / f"{name}.sumocfg"), "--no-warnings", "true"]
        command += [word for key, value in options.items() for word in (f"--{key}", value)]
        with subprocess.Popen(command, stdout=sys.stderr) as window:
            if on_shown is not None:
                on_shown()
            code = window.wait()
        if code not in {0, *(-number for number in SIGNALS)}:  # it may be closed so
            raise SimulationError(f"{binary} ended with exit code {code}; what it says stands above")
        if screenshot is not None:
            if not (drawn := Path(place) / screenshot.name).is_file():
                raise ExportError(f"{screenshot}: sumo-gui drew no picture; see what it says, or try another display")
            with beside(screenshot) as hidden:
                shutil.copyfile(drawn, hidden)
    return screenshot
