"""Lane graphs as SUMO's plain files, of which netconvert makes a net for demand, routing and simulations of their own.

One SUMO lane for each lane of a road; ways through an intersection are connections, and netconvert works out which of
them yields. Junctions lie beside their lanes, as in `net_xml`, so that lanes keep their ends.
"""

import logging
from collections import defaultdict
from collections.abc import Callable, Sequence
from itertools import groupby

import numpy as np
import numpy.typing as npt
from lxml import etree
from lxml.builder import E

from netconvert.geometry import FloatArray
from netconvert.gui_files import xml_bytes
from netconvert.lane_graph import LaneGraph
from netconvert.net_xml import ALLOWED_CLASSES, WHOLE_LIMIT_MPS, CityOrigin, junction_beside, location, shape
from netconvert.roads import RoadGraph, Way, roads_of

_LOG = logging.getLogger(__name__)
#: Classes of SUMO's own traffic that may use a lane, by lane type.
_WHOLE_CLASSES = {**ALLOWED_CLASSES, "BUS": "bus"}
#: SUMO's letter at the entrance of a lane of an intersection, by step; None where there is no signal.
Shown = Callable[[int], npt.NDArray[np.str_] | None]


def plain_files(
    graph: LaneGraph, *, origin: CityOrigin | None = None, shown: Shown | None = None, step_s: float
) -> dict[str, bytes]:
    """Nodes, edges, connections, and with `shown` signals, by netconvert's option for each file.

    Equal graphs give equal bytes. Errors: NetError for endless ways through an intersection.
    """
    roads = roads_of(graph)
    links = {(way.source, way.target): way for way in reversed(roads.ways)}  # SUMO has one from lane to lane
    ways = tuple(way for way in roads.ways if links[way.source, way.target] is way)
    signals = {} if shown is None else _signals(roads, ways, shown, step_s)
    files = {
        "node-files": _nodes(graph, roads, origin, signals),
        "edge-files": xml_bytes(E.edges(*(_edge(graph, roads, number) for number in range(len(roads.rows))))),
        "connection-files": xml_bytes(E.connections(*_connections(graph, roads, ways))),
    }
    if signals:
        files["tllogic-files"] = xml_bytes(E.tlLogics(*(part for parts in signals.values() for part in parts)))
    return files


def _nodes(
    graph: LaneGraph, roads: RoadGraph, origin: CityOrigin | None, signals: dict[int, list[etree._Element]]
) -> bytes:
    touching: dict[int, list[tuple[FloatArray, int]]] = defaultdict(list)
    for end, junction in enumerate(roads.junctions):
        touching[junction] += [(graph.lanes[lane_id].centerline, -(end % 2)) for lane_id in roads.rows[end // 2]]
    nodes = []
    for junction, lines in touching.items():
        points = [line[end] for line, end in lines]
        x, y = np.mean(points, axis=0)
        beside = shape(junction_beside(points[0], [line for line, _ in lines]), digits=3)
        kind = {"type": "traffic_light", "tl": f"J{junction}"} if junction in signals else {"type": "priority"}
        nodes.append(E.node(kind, id=f"J{junction}", x=f"{x:.3f}", y=f"{y:.3f}", shape=beside))
    return xml_bytes(E.nodes(etree.fromstring(location(graph, origin)), *nodes))


def _edge(graph: LaneGraph, roads: RoadGraph, number: int) -> etree._Element:
    members = [graph.lanes[lane_id] for lane_id in roads.rows[number]]
    lanes = []
    for index, lane in enumerate(members):
        allowed = _WHOLE_CLASSES[lane.lane_type]
        known = {"index": str(index), "speed": f"{WHOLE_LIMIT_MPS:g}", "width": f"{lane.width_m:.2f}"}
        known |= {} if allowed is None else {"allow": allowed}
        segment = E.param(key="av2.lane_segment_id", value=str(lane.lane_id))
        lanes.append(E.lane({**known, "shape": shape(lane.centerline, digits=3)}, segment))
    ends = {"from": f"J{roads.junctions[2 * number]}", "to": f"J{roads.junctions[2 * number + 1]}"}
    length_m = sum(lane.length_m for lane in members) / len(members)
    middle = shape(members[len(members) // 2].centerline, digits=3)
    known = {"numLanes": str(len(members)), "priority": "1", "length": f"{length_m:.3f}", "shape": middle}
    return E.edge({"id": str(members[0].lane_id), **ends, **known}, *lanes)


def _link(roads: RoadGraph, way: Way) -> dict[str, str]:
    (before, source), (behind, target) = roads.place[way.source], roads.place[way.target]
    edges = {"from": str(roads.rows[before][0]), "to": str(roads.rows[behind][0])}
    return {**edges, "fromLane": str(source), "toLane": str(target)}


def _connections(graph: LaneGraph, roads: RoadGraph, ways: Sequence[Way]) -> list[etree._Element]:
    """The ways; an edge without any is told to have none, else netconvert guesses."""
    found = []
    for way in ways:
        lines = [graph.lanes[lane_id].centerline for lane_id in way.through]
        line = {"shape": shape(np.concatenate(lines), digits=3)} if lines else {}
        found.append(E.connection(_link(roads, way) | line))
    leaving = {roads.place[way.source][0] for way in ways}
    return found + [E.connection({"from": str(row[0])}) for k, row in enumerate(roads.rows) if k not in leaving]


def _signals(roads: RoadGraph, ways: Sequence[Way], shown: Shown, step_s: float) -> dict[int, list[etree._Element]]:
    """By junction with an entrance that was red: its program, as long as what is shown, and the links it controls."""
    found = {}
    for junction, every in roads.ways_of.items():
        through = [way for way in every if way in ways]
        each = [shown(way.through[0]) if way.through else None for way in through]
        always = "g" * len(next((letters for letters in each if letters is not None), ()))
        states = ["".join(now) for now in zip(*(always if one is None else one for one in each), strict=True)]
        if not any(state.strip("Gg") for state in states):
            continue
        if red := {way.through[0] for k, way in enumerate(through) if not any(state[k] in "gG" for state in states)}:
            said = "junction J%d: lanes %s of the intersection were red throughout; as the program repeats they stay so"
            _LOG.warning(said, junction, ", ".join(map(str, sorted(red))))
        phases = [E.phase(duration=f"{len(list(same)) * step_s:g}", state=state) for state, same in groupby(states)]
        name, controlled = f"J{junction}", (_link(roads, way) | {"linkIndex": str(k)} for k, way in enumerate(through))
        program = E.tlLogic(*phases, id=name, type="static", programID="recorded", offset="0")
        found[junction] = [program, *(E.connection(link, tl=name) for link in controlled)]
    return found
