"""Lane graphs as OpenDRIVE 1.7: a road for each row of lanes, junctions with a connecting road for each way.

OpenDRIVE cuts roads at right angles to their reference line, rows of lanes end at slanted stop lines. So a road is cut
where all its lanes are there, and what is left of each lane belongs to its ways through the junction:

      -----------------|--......      |: end of the road
      -----------------|-----......   .: connecting roads
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise

import numpy as np
import shapely
from lxml import etree
from lxml.builder import E

from netconvert.geo import CityOrigin
from netconvert.geometry import FloatArray, Polyline, wrap_angle
from netconvert.gui_files import xml_bytes
from netconvert.lane_graph import LaneGraph, LaneSegment, crossable
from netconvert.net_xml import SPEED_LIMIT_MPS
from netconvert.roads import Roads, Way, roads_of

#: How far lines leave centrelines where they round corners, where corners are left out, and widths theirs.
_WITHIN_M, _CORNERS_M, _WIDTH_WITHIN_M = 0.05, 0.015, 0.01
#: Lanes of one road are at most so far off their centrelines; rows with lanes farther off are roads apart.
_ROW_WITHIN_M = 0.05
#: Lanes of one section are so wide as at its start, by what that puts their middles off: what SUMO takes them for.
_SECTION_WITHIN_M = 0.02
#: Offsets of lanes are measured so far apart along a road, and of lanes drawn on so far beyond their ends.
_EVERY_M, _BEYOND_M = 0.25, 10.0
#: Ways that lead through no lane of an intersection take so much of the lanes, and no more than this share of a road.
_TAKEN_M, _TAKEN_SHARE = 1.0, 0.25
_NARROWEST_M, _SHORTEST_M, _NEAR_M = 0.3, 0.1, 0.1
_SIDES = ("predecessor", "successor")
#: Code of the user data that hold the ids of a lane's segments.
LANE_IDS = "av2.lane_segment_ids"
_LANE_TYPES = {"VEHICLE": "driving", "BUS": "bus", "BIKE": "biking"}


@dataclass(frozen=True, eq=False, slots=True)
class _Line:
    """A line of straights and arcs without kinks: place, heading, length (m, rad) and curvature of each, (N,)."""

    s: FloatArray
    x: FloatArray
    y: FloatArray
    heading: FloatArray
    length: FloatArray
    curvature: FloatArray

    @property
    def length_m(self) -> float:
        return float(self.s[-1] + self.length[-1])

    def between(self, first: float, last: float) -> "_Line":
        """The part from one s to another, beyond its ends too."""
        inside = (self.s + self.length > first + 1e-6) & (self.s < last - 1e-6)
        inside[0] |= first < 0.0
        s = np.maximum(self.s[inside], first)
        s[0] = first
        (x, y), heading = (part.T for part in self.at(s))
        return _Line(s - first, x, y, heading, np.diff(np.append(s, last)), self.curvature[inside])

    def at(self, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points (K, 2) m and headings (K,) rad."""
        k = np.clip(np.searchsorted(self.s, s, side="right") - 1, 0, len(self.s) - 1)
        along, bend = s - self.s[k], self.curvature[k]
        half = 0.5 * along * bend
        chord = along * np.sinc(half / np.pi)
        direction = self.heading[k] + half
        points = np.stack([self.x[k] + chord * np.cos(direction), self.y[k] + chord * np.sin(direction)], axis=1)
        return points, self.heading[k] + 2.0 * half


def _rounded(points: FloatArray) -> _Line:
    """A polyline (N, 2) m with arcs as corners, as long as they stay within _WITHIN_M of it."""
    points = Polyline(shapely.get_coordinates(shapely.LineString(points).simplify(_CORNERS_M))).points
    step = np.diff(points, axis=0)
    length, heading = np.hypot(*step.T), np.arctan2(step[:, 1], step[:, 0])
    turn = wrap_angle(np.diff(heading))
    size = np.abs(turn)
    within = _WITHIN_M / np.maximum(np.tan(size / 4.0), 1e-9)
    cut = np.where(size > 1e-9, np.minimum(np.minimum(length[:-1], length[1:]) / 2.0, within), 0.0)
    before, behind = np.append(0.0, cut), np.append(cut, 0.0)
    straight = np.maximum(length - before - behind, 0.0)
    radius = np.maximum(cut, 1e-6) / np.maximum(np.tan(size / 2.0), 1e-9)
    unit = step / length[:, None]
    start, end = points[:-1] + before[:, None] * unit, points[1:] - behind[:, None] * unit
    parts = []
    for k in range(len(length)):
        parts.append((*start[k], heading[k], straight[k], 0.0))
        if k < len(turn) and size[k] > 1e-9:
            parts.append((*end[k], heading[k], radius[k] * size[k], math.copysign(1.0 / radius[k], turn[k])))
    made = np.array([part for part in parts if part[3] > 1e-6])
    s = np.append(0.0, np.cumsum(made[:-1, 3]))
    return _Line(s, *made.T)


@dataclass(frozen=True, eq=False, slots=True)
class _Road:
    """A road along a line: lanes from the left, and their n + 1 borders, (n + 1, K) m to its left at s (K,) m."""

    lanes: tuple[int, ...]
    line: _Line
    s: FloatArray
    borders: FloatArray

    def middle(self, lane: int, k: int) -> FloatArray:
        """The middle of a lane at s[k], (2,) m."""
        point, heading = self.line.at(self.s[[k]])
        aside = self.borders[lane : lane + 2, k].mean()
        return np.asarray(point[0] + aside * np.array([-np.sin(heading[0]), np.cos(heading[0])]))


class _End(Enum):
    """What is at an end of a road."""

    OPEN = "the map's edge: each of its lanes is in the road as a whole"
    JOINT = "a road with the same lanes"
    JUNCTION = "a junction: what of its lanes is beyond the first one's end is the junction's"
    SHORT = "a junction in which a way leads through no other lane, so that it takes a piece of the road"


def _road(lanes: Sequence[LaneSegment], start: _End, end: _End) -> _Road | None:
    """The road of lanes, from the left; None where they cannot be one."""
    line = _rounded(lanes[0].centerline)
    whole = np.linspace(0.0, line.length_m, max(int(line.length_m / _EVERY_M), 1) + 1)
    path = Polyline(line.at(whole)[0])
    starts, ends = (path.frenet([lane.centerline[k] for lane in lanes])[0] for k in (0, -1))
    first = {_End.OPEN: min(starts.min(), 0.0), _End.JOINT: 0.0}.get(start, max(starts.max(), 0.0))
    last = {_End.OPEN: max(ends.max(), whole[-1]), _End.JOINT: whole[-1]}.get(end, min(ends.min(), whole[-1]))
    taken = min(_TAKEN_M, _TAKEN_SHARE * (last - first))
    first, last = first + taken * (start is _End.SHORT), last - taken * (end is _End.SHORT)
    if len(lanes) > 1 and last - first < _SHORTEST_M:
        return None
    line = line.between(first, last)
    s = np.linspace(0.0, line.length_m, max(int(line.length_m / _EVERY_M), 1) + 1)
    middles = [np.zeros(len(s)), *(_beside(path, first + s, lane) for lane in lanes[1:])]
    # Borders b_0 ... b_n with middles between them have one degree of freedom: b_k = (-1)^k b_0 + known_k.
    known = [np.zeros(len(s))]
    for middle in middles:
        known.append(2.0 * middle - known[-1])
    sign = (-1.0) ** np.arange(len(known))
    wider = [lane.width_m for lane in lanes] + np.diff(known, axis=0).mean(axis=1)
    # beyond the tightest bend's radius the left border would fold
    half = min(float((sign[:-1] * wider).mean()) / 2.0, 1.0 / max(np.abs(line.curvature).max(), 1e-9))
    borders = max(half, _NARROWEST_M / 2.0) * sign[:, None] + np.array(known)
    for k in range(1, len(borders)):
        borders[k] = np.minimum(borders[k], borders[k - 1] - _NARROWEST_M)
    if np.abs((borders[1:] + borders[:-1]) / 2.0 - middles).max() > _ROW_WITHIN_M:
        return None
    return _Road(tuple(lane.lane_id for lane in lanes), line, s, borders)


def _beside(path: Polyline, s: FloatArray, lane: LaneSegment) -> FloatArray:
    """How far to the left of a path at s (K,) m a lane, drawn on beyond its ends, is: (K,) m."""
    line = lane.path.point(np.arange(-_BEYOND_M, lane.length_m + _BEYOND_M, _EVERY_M))
    along, aside = path.frenet(line)
    return np.interp(s, np.maximum.accumulate(along), aside)


def _connecting(graph: LaneGraph, way: Way, source: tuple[_Road, int], target: tuple[_Road, int]) -> _Road:
    """The road of a way, from the end of a lane of one road to the start of a lane of another."""
    (before, left), (behind, right) = source, target
    first, last = graph.lanes[way.source].path, graph.lanes[way.target].path
    (begin,), _ = first.frenet(before.middle(left, -1))
    (end,), _ = last.frenet(behind.middle(right, 0))
    pieces = [first.point([begin]), first.points[first.s > begin]]
    pieces += [graph.lanes[lane_id].centerline for lane_id in way.through]
    pieces += [last.points[last.s < end], last.point([end])]
    points = np.concatenate(pieces)
    far = [0]
    for k in range(1, len(points) - 1):
        if min(math.dist(points[k], points[far[-1]]), math.dist(points[k], points[-1])) > _NEAR_M:
            far.append(k)
    line = _rounded(points[[*far, len(points) - 1]])
    ends = [-np.diff(road.borders[lane : lane + 2, k])[0] for road, lane, k in ((before, left, -1), (behind, right, 0))]
    half = np.array(ends) / 2.0
    return _Road(way.through, line, np.array([0.0, line.length_m]), np.array([half, -half]))


def opendrive_bytes(graph: LaneGraph, name: str, *, origin: CityOrigin | None = None) -> bytes:
    """The .xodr file of a graph, in city coordinates. Equal graphs give equal bytes.

    name: of the map; origin: of the city frame; with it the file has a geo-reference. Errors: NetError.
    """
    roads, drawn = _drawn(graph)
    links: list[dict[str, etree._Element]] = [{} for _ in drawn]
    connecting: list[etree._Element] = []
    junctions = []
    for junction, ways in roads.ways_of.items():
        joint = roads.joint(junction)
        if joint is not None:
            before, behind = joint
            links[before]["successor"] = _link("successor", behind, "start")
            links[behind]["predecessor"] = _link("predecessor", before, "end")
            continue
        for end, at in enumerate(roads.junctions):
            if at == junction:
                links[end // 2][_SIDES[end % 2]] = E(_SIDES[end % 2], elementType="junction", elementId=str(junction))
        found: list[etree._Element] = []
        for way in ways:
            places = [_place(roads, lane_id) for lane_id in (way.source, way.target)]
            (before, left), (behind, right) = places
            road = _connecting(graph, way, (drawn[before], left), (drawn[behind], right))
            number = len(drawn) + len(connecting)
            ends = [_link("predecessor", before, "end"), _link("successor", behind, "start")]
            lanes = {"predecessor": [left], "successor": [right]}
            connecting.append(_road_xml(graph, road, number, ends, lanes, junction=str(junction)))
            known = {"id": str(len(found)), "incomingRoad": str(before), "connectingRoad": str(number)}
            lane_link = E.laneLink({"from": str(-1 - left), "to": "-1"})
            found.append(E.connection({**known, "contactPoint": "start"}, lane_link))
        junctions.append(E.junction(*found, id=str(junction), name=f"J{junction}"))
    whole = []
    for number, road in enumerate(drawn):
        own = links[number]
        same = list(range(len(road.lanes)))
        lanes = {side: same for side, link in own.items() if link.get("elementType") == "road"}
        whole.append(_road_xml(graph, road, number, [own[side] for side in _SIDES if side in own], lanes))
    return xml_bytes(E.OpenDRIVE(_header(graph, name, origin), *whole, *connecting, *junctions))


def _drawn(graph: LaneGraph) -> tuple[Roads, list[_Road]]:
    """Roads, and each with its line; lanes of rows that cannot be one road are roads of their own."""
    apart: set[int] = set()
    while True:
        roads = roads_of(graph, apart=apart)
        left = {way.source for way in roads.ways}, {way.target for way in roads.ways}
        ends = [_End.OPEN] * len(roads.junctions)
        for end, junction in enumerate(roads.junctions):
            if junction in roads.ways_of:
                ends[end] = _End.JUNCTION if roads.joint(junction) is None else _End.JOINT
        merging: dict[tuple[int, int], set[int]] = {}
        for way in roads.ways:
            merging.setdefault((roads.place[way.source][0], way.target), set()).add(way.source)
            for end in (2 * roads.place[way.source][0] + 1, 2 * roads.place[way.target][0]):
                if not way.through and ends[end] is _End.JUNCTION:
                    ends[end] = _End.SHORT
        drawn, before = [], len(apart)
        for sources in merging.values():  # netconvert takes one link from a road to a lane
            apart.update(sorted(sources, key=lambda lane_id: roads.place[lane_id][1])[:-1])
        for number, row in enumerate(roads.rows):
            lanes = [graph.lanes[lane_id] for lane_id in reversed(row)]
            road = _road(lanes, *ends[2 * number : 2 * number + 2])
            if road is None:
                apart.update(row)
                continue
            drawn.append(road)
            for k, lane in enumerate(lanes if len(row) > 1 else ()):
                start, end = lane.path.frenet([road.middle(k, 0), road.middle(k, -1)])[0].tolist()
                lost = start if lane.lane_id not in left[1] else 0.0, lane.length_m - end
                if max(lost[0], lost[1] if lane.lane_id not in left[0] else 0.0) > _ROW_WITHIN_M:
                    apart.add(lane.lane_id)  # nothing leads to what is cut off
        if len(apart) == before:
            return roads, drawn


def _place(roads: Roads, lane_id: int) -> tuple[int, int]:
    """Road of a lane, and its index from the left."""
    road, index = roads.place[lane_id]
    return road, len(roads.rows[road]) - 1 - index


def _header(graph: LaneGraph, name: str, origin: CityOrigin | None) -> etree._Element:
    points = np.concatenate([lane.centerline for lane in graph.lanes.values()])
    (west, south), (east, north) = points.min(axis=0), points.max(axis=0)
    ground = {"north": north, "south": south, "east": east, "west": west}
    known = {"revMajor": "1", "revMinor": "7", "name": name, "version": "1.00", "vendor": "hid2-sumo"}
    header = E.header({**known, **{side: f"{value:.3f}" for side, value in ground.items()}})
    if origin is not None:
        header.append(E.geoReference(etree.CDATA(origin.projection)))
        offset = {"x": f"{origin.easting_m:.4f}", "y": f"{origin.northing_m:.4f}", "z": "0", "hdg": "0"}
        header.append(E.offset(offset))
    return header


def _link(side: str, road: int, contact: str) -> etree._Element:
    return E(side, elementType="road", elementId=str(road), contactPoint=contact)


def _road_xml(
    graph: LaneGraph, road: _Road, number: int, ends: Sequence[etree._Element], lanes: Mapping[str, Sequence[int]],
    junction: str = "-1",
) -> etree._Element:  # fmt: skip
    """A road. ends: what it is linked with; lanes: those before and behind each of its lanes, from the left."""
    through = junction != "-1"
    offsets = E.lanes(*_pieces("laneOffset", road.s, road.borders[0], "s"))
    line, plan = road.line, []
    for s, x, y, heading, length, curvature in zip(
        line.s, line.x, line.y, line.heading, line.length, line.curvature, strict=True
    ):
        shape = E.arc(curvature=f"{curvature:.9f}") if curvature else E.line()
        place = {"s": f"{s:.6f}", "x": f"{x:.6f}", "y": f"{y:.6f}", "hdg": f"{heading:.9f}", "length": f"{length:.6f}"}
        plan.append(E.geometry(place, shape))
    knots = _sections(road) if not through else [0, len(road.s) - 1]
    for first, last in pairwise(knots):
        within = [side for side, far in zip(_SIDES, (first, len(road.s) - 1 - last), strict=True) if far]
        linked = {**lanes, **dict.fromkeys(within, range(len(road.lanes)))}
        offsets.append(_section(graph, road, slice(first, last + 1), linked, through=through))
    known = {"name": " ".join(map(str, road.lanes)), "length": f"{line.length_m:.6f}", "id": str(number)}
    return E.road(
        {**known, "junction": junction, "rule": "RHT"},
        E.link(*ends),
        E.type(E.speed(max=f"{SPEED_LIMIT_MPS:g}", unit="m/s"), s="0", type="town"),
        E.planView(*plan),
        offsets,
    )


def _sections(road: _Road) -> list[int]:
    """Indices into the road's s at which its lane sections begin, and its end."""
    widths = road.borders[:-1] - road.borders[1:]
    begins = [0]
    for k in range(1, len(road.s)):
        wider = widths[:, k] - widths[:, begins[-1]]
        if np.abs(np.cumsum(wider) - wider / 2.0).max() > _SECTION_WITHIN_M:
            begins.append(max(k - 1, begins[-1] + 1))
    return [*begins, len(road.s) - 1] if begins[-1] < len(road.s) - 1 else begins


def _section(
    graph: LaneGraph, road: _Road, part: slice, lanes: Mapping[str, Sequence[int]], *, through: bool
) -> etree._Element:
    """A lane section. part: of the road's s; lanes: those before and behind each of its lanes; through: a junction."""
    s = road.s[part] - road.s[part][0]
    drawn = []
    for k, width in enumerate((road.borders[:-1] - road.borders[1:])[:, part]):
        segments = road.lanes if through else road.lanes[k : k + 1]
        link = E.link(*(E(side, id=str(-1 - lanes[side][k])) for side in _SIDES if side in lanes))
        lane = E.lane(link, *_pieces("width", s, width, "sOffset"), id=str(-1 - k), level="false")
        lane.set("type", _LANE_TYPES[graph.lanes[segments[0]].lane_type] if segments else "driving")
        if not through:
            lane.append(_mark(graph, graph.lanes[segments[0]]))
        if segments:
            lane.append(E.userData(code=LANE_IDS, value=" ".join(map(str, segments))))
        drawn.append(lane)
    center = E.lane(id="0", type="none", level="false")
    if not through:
        mark, color = _mark_of(graph.lanes[road.lanes[0]].left_mark_type, outwards_is_left=True)
        center.append(E.roadMark(sOffset="0", type=mark, color=color, width="0.12", laneChange="none"))
    return E.laneSection(E.center(center), E.right(*drawn), s=f"{road.s[part][0]:.6f}")


def _pieces(name: str, s: FloatArray, values: FloatArray, at: str) -> Iterator[etree._Element]:
    """Values (K,) m at s (K,) m as pieces that are linear."""
    kept = np.asarray(shapely.LineString(np.column_stack([s, values])).simplify(_WIDTH_WITHIN_M).coords)
    for (first, value), (last, then) in pairwise(kept.tolist()):
        slope = (then - value) / (last - first)
        yield E(name, {at: f"{first:.6f}", "a": f"{value:.6f}", "b": f"{slope:.9f}", "c": "0", "d": "0"})


def _mark(graph: LaneGraph, lane: LaneSegment) -> etree._Element:
    """The marking on the right of a lane; increase is towards the left."""
    right = graph.neighbor(lane.lane_id, "right")
    leaves = right is not None and crossable(lane.right_mark_type)
    enters = right is not None and crossable(graph.lanes[right].left_mark_type)
    change = {(True, True): "both", (True, False): "decrease", (False, True): "increase"}.get((leaves, enters), "none")
    mark, color = _mark_of(lane.right_mark_type, outwards_is_left=False)
    return E.roadMark(sOffset="0", type=mark, color=color, width="0.12", laneChange=change)


def _mark_of(mark_type: str, *, outwards_is_left: bool) -> tuple[str, str]:
    """Type and colour of a marking, of which Argoverse names the lines from the lane outwards."""
    words = mark_type.split("_")
    lines = ["solid" if word == "SOLID" else "broken" for word in words if word in {"SOLID", "DASH", "DASHED"}]
    lines *= 2 if words[0] == "DOUBLE" else 1
    color = words[-1].lower() if lines else "standard"
    return " ".join(reversed(lines) if outwards_is_left else lines) or "none", color
