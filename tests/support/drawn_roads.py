"""OpenDRIVE files, read by the standard's formulas: the middle of every lane, and which lanes lead to which."""

import importlib.metadata
import itertools
import math
from collections import defaultdict

import numpy as np
import shapely
from lxml import etree

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


def _value(pieces: list[etree._Element], key: str, s: float) -> float:
    piece = [one for one in pieces if float(one.get(key)) <= s + 1e-9][-1]
    a, b, c, d = (float(piece.get(name)) for name in "abcd")
    ds = s - float(piece.get(key))
    return a + ds * (b + ds * (c + ds * d))


def _place(road: etree._Element, s: float) -> tuple[float, float, float]:
    part = [one for one in road.iterfind("planView/geometry") if float(one.get("s")) <= s + 1e-9][-1]
    s0, x, y, heading = (float(part.get(name)) for name in ("s", "x", "y", "hdg"))
    along, arc = s - s0, part.find("arc")
    if arc is None:
        return x + along * math.cos(heading), y + along * math.sin(heading), heading
    bend = float(arc.get("curvature"))
    x += (math.sin(heading + bend * along) - math.sin(heading)) / bend
    y -= (math.cos(heading + bend * along) - math.cos(heading)) / bend
    return x, y, heading + bend * along


def middles(road: etree._Element) -> dict[int, np.ndarray]:
    """The middle of each lane of a road at every 0.2 m, (N, 2) m, by the lane's number from the left."""
    length, sections = float(road.get("length")), road.findall("lanes/laneSection")
    points: dict[int, list[tuple[float, float]]] = defaultdict(list)
    for s in np.linspace(0.0, length, max(int(length / 0.2), 2)).tolist():
        x, y, heading = _place(road, s)
        section = [one for one in sections if float(one.get("s")) <= s + 1e-9][-1]
        border = _value(road.findall("lanes/laneOffset"), "s", s)
        for number, lane in enumerate(section.iterfind("right/lane")):
            assert lane.get("id") == str(-1 - number)
            width = _value(lane.findall("width"), "sOffset", s - float(section.get("s")))
            assert width > 0.0
            aside = border - width / 2.0
            points[number].append((x - aside * math.sin(heading), y + aside * math.cos(heading)))
            border -= width
    return {number: np.array(line) for number, line in points.items()}


def read_roads(content: bytes) -> tuple[dict[int, list[np.ndarray]], Links, float]:
    """Lines by lane segment, links between lane segments, and the largest gap between lanes that follow, m.

    A connecting road carries the end of the lane before it and the start of the one behind it too.
    """
    root = etree.fromstring(content)
    roads = {road.get("id"): road for road in root.iter("road")}
    lines = {number: middles(road) for number, road in roads.items()}
    lane_of = {
        (number, k): segments(lane)
        for number, road in roads.items()
        for k, lane in enumerate(road.find("lanes/laneSection").iterfind("right/lane"))
    }
    found: dict[int, list[np.ndarray]] = defaultdict(list)
    links: Links = set()
    gaps = [0.0]
    for (number, k), ids in lane_of.items():
        road, chain, own = roads[number], list(ids), lines[number][k]
        if road.get("junction") != "-1":
            first, last = (road.find(f"link/{side}").get("elementId") for side in ("predecessor", "successor"))
            lane = road.find("lanes/laneSection/right/lane/link")
            before, behind = (-1 - int(lane.find(side).get("id")) for side in ("predecessor", "successor"))
            chain = [*lane_of[first, before], *ids, *lane_of[last, behind]]
            gaps += [math.dist(lines[first][before][-1], own[0]), math.dist(lines[last][behind][0], own[-1])]
        elif (after := road.find("link/successor[@elementType='road']")) is not None:
            section = road.findall("lanes/laneSection")[-1]
            behind = -1 - int(section.findall("right/lane")[k].find("link/successor").get("id"))
            (target,) = lane_of[after.get("elementId"), behind]
            links.add((ids[0], target))
            found[ids[0]].append(lines[after.get("elementId")][behind])
            found[target].append(own)
        links |= set(itertools.pairwise(chain))
        for lane_id in chain:
            found[lane_id].append(own)
    return found, links, max(gaps)


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
