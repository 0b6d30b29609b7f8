"""A scene as files that plain sumo-gui plays, without Python: net, routes, polygons, view settings, sumocfg.

SUMO cannot read positions from a file, but a vehicle keeps to its lane and its lane's speed limit. So every agent gets
lanes of its own, a centimetre wide and laid along the way of its front bumper, one for about every half second with the
mean speed of that time as limit. `hid2 gui` (bridge.sumo.gui) shows the exact positions instead.
"""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from lxml import etree
from lxml.builder import E

from bridge.config import word_for_recorded
from bridge.pictures.figures import POLICY_COLORS, SKY
from bridge.recordings.scenario import AV_ID, FOCAL_CATEGORY, Scenario
from bridge.recordings.sidecar import sidecar_in
from bridge.sumo.poses import sumo_poses
from hid2.agents import FloatArray, Policy, Track
from hid2.measures.arrays import is_generated_id
from hid2.policy.behaviours import BEHAVIOURS
from netconvert.cells import CellGrid
from netconvert.geo import CITY_ORIGINS
from netconvert.geometry import arc_length
from netconvert.gui_files import WINDOW_ASPECT, gui_files, xml_bytes
from netconvert.net_xml import junction_beside, junction_xml, net_bytes, shape

# No tunables: how a scene is drawn in sumo-gui; nothing that is generated depends on any of these.
#: A lane of a trace covers at least this much time and way (the last one whatever is left).
_MIN_SECONDS = 0.5
_MIN_METERS = 0.3
#: Points of a trace closer than this are one.
_SAME_POINT_M = 0.02
#: Lanes of a trace are no wider than this: they must not show.
_TRACE_WIDTH_M = 0.01
#: An agent that stays within this is drawn standing.
STANDS_M = 1.5
_CREEP_M = 0.1
#: Rows of the moving mean over positions.
SMOOTHED = 9
#: The last lane of a trace, on which the vehicle leaves the scene within a step.
_OUT_M, _OUT_MPS = 0.5, 80.0
#: Lanes for this class of vehicle are transparent in the view settings (`gui_files`); no map has any.
_UNSEEN = "ship"
#: Vehicles keep to the limits of their lanes, however sudden.
_ANY_ACCELERATION = "1000"
#: What moves further than this is looked at, with so much ground around it.
_MOVES_M, _MARGIN_M = 5.0, 20.0
#: Parameter of a vehicle that holds the id to show.
ID_KEY = "shown_id"
#: Distance of two lines of the legend, and its width, as a share of the height shown.
_LEGEND_ROW, _LEGEND_WIDTH = 0.045, 0.25
#: SUMO's pictures of vehicles, by object type.
GUI_SHAPES: Mapping[str, str] = {
    "vehicle": "passenger/sedan",
    "bus": "bus",
    "motorcyclist": "motorcycle",
    "cyclist": "bicycle",
    "riderless_bicycle": "bicycle",
    "pedestrian": "pedestrian",
}


class Paint(NamedTuple):
    """Colour of an agent and what it stands for."""

    color: str
    meaning: str

    @property
    def rgba(self) -> tuple[int, int, int, int]:
        """As TraCI takes it."""
        r, g, b = (int(self.color[k : k + 2], 16) for k in (1, 3, 5))
        return r, g, b, 255

    @property
    def xml(self) -> str:
        """As SUMO's files have it."""
        return ",".join(str(part) for part in self.rgba[:3])


RECORDED, REACTING = Paint("#9C9CA4", "recorded"), Paint("#9C9CA4", "reacting")
AV = Paint(SKY, "recording vehicle")
FOCAL = Paint("#F0E442", "focal")  # neither ground nor road nor background has it
POLICIES: Mapping[Policy, Paint] = {
    policy: Paint(color, BEHAVIOURS[policy].label) for policy, color in POLICY_COLORS.items()
}


def paints(scenario: Scenario) -> dict[str, Paint]:
    """Colour of every track: recorded grey, the recorded focal one yellow, generated ones by policy."""
    sidecar = sidecar_in(scenario.folder, scenario.scenario_id)
    policy_of = {agent.track_id: agent.policy for agent in sidecar.agents} if sidecar else {}
    out = {}
    for track in scenario.tracks:
        if is_generated_id(track.track_id):
            out[track.track_id] = POLICIES[policy_of.get(track.track_id, Policy.STRAIGHT)]
        elif track.category == FOCAL_CATEGORY:
            out[track.track_id] = FOCAL
        else:
            others = RECORDED if word_for_recorded(scenario.scenario_id) == "recorded" else REACTING
            out[track.track_id] = AV if track.track_id == AV_ID else others
    return out


def playable_files(scenario: Scenario, grid: CellGrid) -> dict[str, bytes]:
    """<id>_scene.sumocfg, .net.xml, .rou.xml, .poly.xml and .view.xml by file name.

    The net is that of `hid2 net` with the lanes of the traces added.
    """
    name = f"{scenario.scenario_id}_scene"
    options = run_options(scenario, f"{name}.rou.xml")
    options["processing"] = {"collision.action": "none", "time-to-teleport": "-1"}
    files = scene_view_files(scenario, grid, name, options)
    traces = [_trace(track, scenario.step_s) for track in scenario.tracks]
    files[f"{name}.net.xml"] = _with_traces(net_bytes(grid, origin=CITY_ORIGINS.get(scenario.city)), traces)
    files[f"{name}.rou.xml"] = _routes(scenario, traces)
    return files


def run_options(scenario: Scenario, routes: str | None) -> dict[str, dict[str, str]]:
    """Options with which SUMO runs a file of routes for as long as a scene lasts, by section and name."""
    files = {} if routes is None else {"route-files": routes}
    return {"input": files, "time": {"end": f"{scenario.num_steps * scenario.step_s:.2f}"}}


def scene_view_files(
    scenario: Scenario, grid: CellGrid, name: str, options: Mapping[str, Mapping[str, str]] | None = None
) -> dict[str, bytes]:
    """<name>.sumocfg, .poly.xml and .view.xml: those of `hid2 net`, looking at what moves, with ids and a legend.

    sumo-gui then shows the first step and waits: vehicles are boxes of their size, with their ids.
    """
    low, high = moving_ground(scenario)
    vehicles = E.vehicles(
        {"vehicleMode": "0", "vehicleQuality": "1", "showBlinker": "0", "vehicle_minSize": "0"},
        {"vehicle_exaggeration": "1", **_words("vehicleText", 46)},
        {"vehicleText_bgColor": "255,255,255", "vehicleTextParam": ID_KEY},
        E.colorScheme(name="given vehicle/type/route color"),
    )
    names = E.pois({"poi_constantSize": "1", "poi_exaggeration": "1", **_words("poiName", 50)})
    waits = {"start": "true", "breakpoints": f"{scenario.step_s}"}
    files = gui_files(
        grid, name, step_s=scenario.step_s, shown=(low, high), options={**(options or {}), "gui_only": waits},
        shapes=_legend(scenario, low, high), scheme=[vehicles, names],
    )  # fmt: skip
    del files[f"{name}.cells.csv"]
    return files


def shows_id(track: Track) -> bool:
    """Whether a vehicle shows its id: inserted ones and the focal one, as those of all would hide each other."""
    return is_generated_id(track.track_id) or track.category == FOCAL_CATEGORY


def moving_ground(scenario: Scenario) -> tuple[FloatArray, FloatArray]:
    """Low and high corner of the ground on which something moves, (2,) m."""
    moving = [track.position for track in scenario.tracks if np.ptp(track.position, axis=0).max() > _MOVES_M]
    points = np.concatenate(moving or [track.position for track in scenario.tracks])
    return points.min(axis=0) - _MARGIN_M, points.max(axis=0) + _MARGIN_M


def _words(what: str, size: int) -> dict[str, str]:
    """View settings that show names, as large at any zoom."""
    return {f"{what}_show": "1", f"{what}_size": str(size), f"{what}_constantSize": "1", f"{what}_color": "10,10,10"}


def _legend(scenario: Scenario, low: FloatArray, high: FloatArray) -> list[etree._Element]:
    """What the colours mean: bars with names, in that corner of the ground shown where the fewest vehicles pass."""
    there = set(paints(scenario).values())
    shown = [paint for paint in (RECORDED, REACTING, AV, FOCAL, *POLICIES.values()) if paint in there]
    high_m = max(float(high[1] - low[1]), float(high[0] - low[0]) / WINDOW_ASPECT)
    size = np.array([_LEGEND_WIDTH, _LEGEND_ROW * len(shown)]) * high_m
    points = np.concatenate([track.position for track in scenario.tracks])
    reach = np.array([high[0] - low[0], high_m]) / 2 - size  # of the legend's corners from the middle

    def hidden(corner: FloatArray) -> int:
        return int(((points > corner) & (points < corner + size)).all(axis=1).sum())

    middle = (low + high) / 2
    places = itertools.product((-reach[0] - size[0], reach[0]), (reach[1], -reach[1] - size[1]))
    corners = [middle + np.array(place) for place in places]
    left, bottom = min(corners, key=hidden).tolist()
    parts = []
    for row, paint in enumerate(reversed(shown)):
        name = paint.meaning if paint not in POLICIES.values() else f"inserted {paint.meaning}"
        parts += _bar(paint, name, (left, bottom + row * _LEGEND_ROW * high_m), high_m)
    return parts


def _bar(paint: Paint, name: str, corner: tuple[float, float], high_m: float) -> list[etree._Element]:
    """A bar of the legend, lower left at `corner`, and its name, for which SUMO needs a point without colour."""
    (left, lower), width, height = corner, _LEGEND_WIDTH * high_m, 0.8 * _LEGEND_ROW * high_m
    ring = [(left, lower), (left + width, lower), (left + width, lower + height), (left, lower + height)]
    # SUMO takes no spaces in ids, but those that do not break
    bar = {"id": f"legend_{name}".replace(" ", "\u00a0"), "type": "legend", "color": paint.xml, "fill": "1"}
    point = {"id": name.replace(" ", "\u00a0"), "type": "legend", "color": "0,0,0,0", "layer": "500"}
    point |= {"x": f"{left + width / 2:.2f}", "y": f"{lower + height / 2:.2f}"}
    return [E.poly(bar, {"layer": "450", "shape": shape(np.array(ring))}), E.poi(point)]


@dataclass(frozen=True, eq=False, slots=True)
class _Trace:
    """The lanes of one track: shapes, each (N, 2) m, and speed limits, m/s.

    The first begins a vehicle's length behind the front bumper; the last takes the vehicle out at once.
    """

    track: Track
    shapes: tuple[FloatArray, ...]
    limits: tuple[float, ...]

    def edge(self, number: int) -> str:
        """Id of one of its edges."""
        return f"trace_{self.track.track_id}_{number}"


def _trace(track: Track, step_s: float) -> _Trace:
    points, when = _way(track, step_s)
    knots = [0]
    for row in range(1, len(points)):
        way = float(arc_length(points[knots[-1] : row + 1])[-1])
        if way >= _MIN_METERS and when[row] - when[knots[-1]] >= _MIN_SECONDS - 1e-9:
            knots.append(row)
    if knots[-1] != len(points) - 1:
        knots = [*(knots[:-1] or [0]), len(points) - 1]
    shapes = [points[begin : end + 1] for begin, end in pairwise(knots)]
    limits = [float(arc_length(points[b : e + 1])[-1]) / float(when[e] - when[b]) for b, e in pairwise(knots)]
    first, last = _direction(track.heading[0]), _direction(track.heading[-1])
    shapes[0] = np.vstack([points[0] - track.size.length_m * first, shapes[0]])
    shapes.append(np.stack([points[-1], points[-1] + _OUT_M * last]))
    return _Trace(track, tuple(shapes), (*limits, _OUT_MPS))


def _way(track: Track, step_s: float) -> tuple[FloatArray, FloatArray]:
    """Places of the front bumper (N, 2) m, N >= 2, that follow each other forwards, and when it is there (N,) s.

    An agent that stays within STANDS_M creeps a hand's breadth, and positions are smoothed: jitter would turn it round.
    """
    times = np.asarray(track.timesteps * step_s, dtype=np.float64)
    middle = len(times) // 2
    if np.hypot(*np.ptp(track.position, axis=0)) <= STANDS_M:
        heading = float(track.heading[middle])
        front = np.median(track.position, axis=0) + 0.5 * track.size.length_m * _direction(heading)
        return np.stack([front, front + _CREEP_M * _direction(heading)]), np.array([times[0], times[-1] + step_s])
    front, _ = sumo_poses(track.position, track.heading, np.full(len(times), track.size.length_m))
    front = _smooth(front)
    backwards = (track.position[-1] - track.position[0]) @ _direction(track.heading[middle]) < 0
    kept = [0]
    for row in range(1, len(front)):
        step = front[row] - front[kept[-1]]
        ahead = np.hypot(*step) if backwards else step @ _direction(track.heading[row])
        if ahead > _SAME_POINT_M:
            kept.append(row)
    if len(kept) < 2:
        kept = [0, len(front) - 1]
    when = times[kept]
    when[-1] = times[-1]
    return front[kept], when


def _smooth(points: FloatArray) -> FloatArray:
    """Moving mean over SMOOTHED rows, fewer towards the ends, where points stay."""
    total = np.vstack([np.zeros(2), np.cumsum(points, axis=0)])
    rows = np.arange(len(points))
    half = np.minimum(np.minimum(rows, rows[::-1]), SMOOTHED // 2)
    return np.asarray((total[rows + half + 1] - total[rows - half]) / (2 * half + 1)[:, None])


def _direction(heading: float) -> FloatArray:
    return np.array([np.cos(heading), np.sin(heading)])


def _with_traces(net: bytes, traces: list[_Trace]) -> bytes:
    """Add the lanes of the traces to a net."""
    root = etree.fromstring(net)
    added: dict[str, list[etree._Element]] = {"edge": [], "junction": [], "connection": []}
    for trace in traces:
        count = len(trace.shapes)
        for k, (points, limit) in enumerate(zip(trace.shapes, trace.limits, strict=True)):
            length = f"{arc_length(points)[-1]:.4f}"
            edge = {"id": trace.edge(k), "from": f"{trace.edge(k)}_j", "to": f"{trace.edge(k + 1)}_j"}
            edge |= {"priority": "0", "length": length}
            lane = {"id": f"{trace.edge(k)}_0", "index": "0", "speed": f"{limit:.4f}", "width": f"{_TRACE_WIDTH_M}"}
            lane |= {"allow": _UNSEEN, "length": length, "shape": shape(points, digits=3), "customShape": "1"}
            added["edge"].append(E.edge(edge, E.lane(lane)))
            if k:
                link = {"from": trace.edge(k - 1), "to": trace.edge(k), "fromLane": "0", "toLane": "0", "dir": "s"}
                added["connection"].append(E.connection({**link, "state": "M"}))
        for k in range(count + 1):
            incoming = [f"{trace.edge(k - 1)}_0"] if k else []
            end = trace.shapes[k][0] if k < count else points[-1]
            line = junction_beside(end, trace.shapes[max(k - 1, 0) : k + 1])
            junction = junction_xml(f"{trace.edge(k)}_j", end.tolist(), incoming=incoming, line=line)
            added["junction"].append(etree.fromstring(junction))
    for tag, elements in added.items():
        before = root.findall(tag)
        place = root.index(before[-1]) + 1 if before else len(root)
        root[place:place] = elements
    return xml_bytes(root)


def _routes(scenario: Scenario, traces: list[_Trace]) -> bytes:
    colors = paints(scenario)
    kinds, vehicles = [], []
    for trace in sorted(traces, key=lambda trace: departure(trace.track)):
        name = trace.track.track_id
        kind = vehicle_type(trace.track) | {"vClass": _UNSEEN, "minGap": "0", "sigma": "0"}
        kind |= {"accel": _ANY_ACCELERATION, "decel": _ANY_ACCELERATION, "emergencyDecel": _ANY_ACCELERATION}
        kind |= {"maxSpeed": "80", "speedFactor": "1", "speedDev": "0", "tau": f"{scenario.step_s}"}
        kinds.append(E.vType(kind))
        vehicle = {"id": name, "type": f"type_{name}", "color": colors[name].xml, "insertionChecks": "none"}
        vehicle |= {"depart": f"{trace.track.timesteps[0] * scenario.step_s:.2f}"}
        vehicle |= {"departPos": f"{trace.track.size.length_m:.2f}"}
        vehicle |= {"departSpeed": f"{trace.limits[0]:.4f}", "arrivalPos": "max"}
        params = [E.param(key=ID_KEY, value=name)] if shows_id(trace.track) else []
        edges = " ".join(trace.edge(k) for k in range(len(trace.shapes)))
        vehicles.append(E.vehicle(vehicle, *params, E.route(edges=edges)))
    return xml_bytes(E.routes(*kinds, *vehicles))


def departure(track: Track) -> tuple[int, str]:
    """What vehicles are sorted by in a file of routes."""
    return int(track.timesteps[0]), track.track_id


def vehicle_type(track: Track, color: Paint | None = None) -> dict[str, str]:
    """Attributes of the type that each agent has of its own: id, size and looks."""
    looks = {} if color is None else {"color": color.xml}
    looks |= {"guiShape": GUI_SHAPES[track.object_type]} if track.object_type in GUI_SHAPES else {}
    size = {"length": f"{track.size.length_m:.2f}", "width": f"{track.size.width_m:.2f}"}
    return {"id": f"type_{track.track_id}", **size, **looks}
