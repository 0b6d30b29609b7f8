"""OpenDRIVE files as SUMO's netconvert reads them: the middle of every lane, and which lanes lead to which."""

import importlib.metadata
import itertools
import subprocess
from collections import defaultdict
from pathlib import Path

import numpy as np
import shapely
from lxml import etree

from bridge.sumo.net import sumo_program
from netconvert.lane_graph import LaneGraph

Links = set[tuple[int, int]]


def schema(name: str) -> etree.XMLSchema:
    """A schema of ASAM's that scenariogeneration brings."""
    (path,) = (file for file in importlib.metadata.files("scenariogeneration") if file.name == name)
    return etree.XMLSchema(etree.parse(path.locate()))


def segments(lane: etree._Element) -> list[int]:
    """Ids of the lane segments that a lane is made of."""
    data = lane.find("userData[@code='av2.lane_segment_ids']")
    return [] if data is None else [int(part) for part in data.get("value").split()]


def _line(element: etree._Element) -> shapely.LineString:
    return shapely.LineString([[float(part) for part in xy.split(",")[:2]] for xy in element.get("shape").split()])


def read_by_netconvert(file: Path, graph: LaneGraph, folder: Path) -> tuple[set[tuple[int, int]], dict[int, float]]:
    """Links that netconvert loses, and how far each lane is from its centreline, m.

    As netconvert writes plain files, before it cuts lanes where its junctions begin; it keeps one width for each edge.
    """
    command = [sumo_program("netconvert"), "--opendrive", str(file), "--plain-output-prefix", str(folder / "read")]
    command += ["--plain-output.lanes", "--precision", "4", "--output.original-names", "--opendrive.import-all-lanes"]
    command += ["--opendrive.internal-shapes", "--offset.disable-normalization", "--opendrive.min-width", "0"]
    command += ["--opendrive.curve-resolution", "0.25", "--geometry.min-dist", "0"]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    nodes, edges, links = (etree.parse(folder / f"read.{kind}.xml").getroot() for kind in ("nod", "edg", "con"))
    place = {node.get("id"): [float(node.get("x")), float(node.get("y"))] for node in nodes.iter("node")}
    of = {
        f"{road.get('id')}_{lane.get('id')}": segments(lane)
        for road in etree.parse(file).getroot().iter("road")
        for lane in road.iter("lane")
    }
    lines, lane_of = defaultdict(list), {}
    for edge in edges.iter("edge"):
        ends = [place[edge.get("from")], place[edge.get("to")]]
        border, aside = _line(edge) if edge.get("shape") else shapely.LineString(ends), 0.0
        for lane in reversed(edge.findall("lane")):
            (lane_id,) = of[lane.find("param[@key='origId']").get("value")]
            width = float(lane.get("width"))
            lines[lane_id].append(border.offset_curve(-(aside + width / 2), join_style="mitre"))
            aside += width
            lane_of[edge.get("id"), lane.get("index")] = lane_id
    found, joins = set(), []
    for link in links.iter("connection"):
        if link.get("to") is None:
            continue
        ends = [lane_of[link.get("from"), link.get("fromLane")], lane_of[link.get("to"), link.get("toLane")]]
        road = link.find("param[@key='origId']")
        chain = [ends[0], *(of[road.get("value")] if road is not None else []), ends[1]]
        found |= set(itertools.pairwise(chain))
        if road is None and ends[0] != ends[1]:
            joins.append(ends)
        for lane_id in chain if road is not None else ():
            lines[lane_id].append(_line(link))
    whole = {lane_id: list(parts) for lane_id, parts in lines.items()}
    for one, other in joins:
        lines[one] += whole[other]
        lines[other] += whole[one]
    lost = links_of(graph) - found
    read = LaneGraph({lane_id: graph.lanes[lane_id] for lane_id in lines if lines[lane_id]})
    return lost, off_m(read, lines)


def links_of(graph: LaneGraph) -> Links:
    """Links between the lanes of a graph."""
    return {(lane_id, target) for lane_id in graph.lanes for target in graph.successors(lane_id)}


def off_m(graph: LaneGraph, lines: dict[int, list[np.ndarray | shapely.Geometry]]) -> dict[int, float]:
    """How far each lane's centreline is from its lines at most, m, at every 0.5 m."""
    off = {}
    for lane_id, lane in graph.lanes.items():
        points = shapely.points(lane.path.point(np.linspace(0.0, lane.length_m, max(int(lane.length_m / 0.5), 2))))
        drawn = [line if isinstance(line, shapely.Geometry) else shapely.LineString(line) for line in lines[lane_id]]
        off[lane_id] = float(shapely.distance(points, shapely.union_all(drawn)).max())
    return off


def check_roads(file: Path, graph: LaneGraph, folder: Path) -> None:
    """The file keeps the standard's schema, with all links, and all lanes within 0.1 m of their centrelines."""
    schema("opendrive_17_core.xsd").assertValid(etree.parse(file))
    lost, off = read_by_netconvert(file, graph, folder)
    assert not lost
    assert off.keys() == graph.lanes.keys()
    assert max(off.values()) <= 0.1
