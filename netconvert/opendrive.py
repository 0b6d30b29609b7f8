"""Lane graphs as OpenDRIVE 1.7: a road for each row of lanes, junctions with a connecting road for each way.

OpenDRIVE cuts roads at right angles to their reference line, rows of lanes end at slanted stop lines. So a road is cut
where all its lanes are there, and what is left of each lane belongs to its ways through the junction:

      -----------------|--......      |: end of the road
      -----------------|-----......   .: connecting roads
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
import shapely
from lxml import etree
from lxml.builder import E

from netconvert.geometry import FloatArray, Polyline, wrap_angle
from netconvert.gui_files import xml_bytes
from netconvert.lane_graph import LaneGraph, LaneSegment
from netconvert.net_xml import SPEED_LIMIT_MPS, CityOrigin, speed_limit_mps
from netconvert.roads import RoadGraph, Way, roads_of

#: Tolerances of lines where they round corners, where corners are left out, and of widths.
_WITHIN_M, _CORNERS_M, _WIDTH_WITHIN_M = 0.05, 0.015, 0.01
#: Tolerance of a row's lanes off their centrelines, or cut off at an end: beyond it they are roads apart.
_ROW_WITHIN_M = 0.05
#: Largest shift of the middles by taking a section's lanes to be as wide as at its start, which SUMO does.
_SECTION_WITHIN_M = 0.02
#: Spacing along a road at which offsets of lanes are measured, and length that lanes are drawn on by beyond their ends.
_EVERY_M, _BEYOND_M = 0.25, 10.0
#: Length that ways through no lane of an intersection take of the lanes at their ends, m, at most this share of a road.
_TAKEN_M, _TAKEN_SHARE = 1.0, 0.25
_NARROWEST_M, _SHORTEST_M, _NEAR_M = 0.3, 0.1, 0.1
_SIDES = ("predecessor", "successor")
#: Code of the user data that hold the ids of a lane's segments.
LANE_IDS = "av2.lane_segment_ids"
#: Changes of lane over a marking, by whether its left and right lane allow them; increase is towards the left.
_CHANGES = {(True, True): "both", (True, False): "decrease", (False, True): "increase", (False, False): "none"}
_LANE_TYPES = {"VEHICLE": "driving", "BUS": "bus", "BIKE": "biking"}
#: Kinds of ends of a road. Open: at the map's edge, each lane is in the road as a whole; joint: at a road with the same
#: lanes; junction: at one that has what of the lanes is beyond the first one's end; short: at a junction in which a way
#: leads through no lane, so that it takes a piece of the road.
_End = Literal["open", "joint", "junction", "short"]


@dataclass(frozen=True, eq=False, slots=True)
class _Line:
    """Straights and arcs without kinks, (N, 6): s, x, y m, heading rad, length m and curvature 1/m of each."""

    parts: FloatArray

    @property
    def length_m(self) -> float:
        return float(self.parts[-1, 0] + self.parts[-1, 4])

    def samples(self) -> FloatArray:
        """Arc lengths from end to end, about _EVERY_M apart, (K,) m."""
        return np.linspace(0.0, self.length_m, max(int(self.length_m / _EVERY_M), 1) + 1)

    def between(self, first: float, last: float) -> "_Line":
        """The part from one s to another, beyond its ends too."""
        begins = self.parts[:, 0]
        inside = (begins + self.parts[:, 4] > first + 1e-6) & (begins < last - 1e-6)
        inside[0] |= first < 0.0
        s = np.maximum(begins[inside], first)
        s[0] = first
        return _Line(np.column_stack([s - first, *self.at(s), np.diff(np.append(s, last)), self.parts[inside, 5]]))

    def at(self, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points (K, 2) m and headings (K,) rad."""
        begins = self.parts[:, 0]
        k = np.clip(np.searchsorted(begins, s, side="right") - 1, 0, len(begins) - 1)
        begin, x, y, heading, _, bend = self.parts[k].T
        along = s - begin
        half = 0.5 * along * bend
        chord, direction = along * np.sinc(half / np.pi), heading + half
        points = np.stack([x + chord * np.cos(direction), y + chord * np.sin(direction)], axis=1)
        return points, heading + 2.0 * half


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
    radius = np.maximum(cut, 1e-6) / np.maximum(np.tan(size / 2.0), 1e-9)
    unit = step / length[:, None]
    parts = np.zeros((2 * len(length) - 1, 5))  # straights, and between them arcs
    straight = np.maximum(length - before - behind, 0.0)
    parts[::2, :4] = np.column_stack([points[:-1] + before[:, None] * unit, heading, straight])
    ends = (points[1:] - behind[:, None] * unit)[:-1]
    parts[1::2] = np.column_stack([ends, heading[:-1], radius * size, np.copysign(1.0 / radius, turn)])
    parts = parts[parts[:, 3] > 1e-6]
    return _Line(np.column_stack([np.append(0.0, np.cumsum(parts[:-1, 3])), parts]))


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


def _road(lanes: Sequence[LaneSegment], start: _End, end: _End) -> _Road | None:
    """The road of lanes, from the left; None where they cannot be one."""
    line = _rounded(lanes[0].centerline)
    whole = line.samples()
    path = Polyline(line.at(whole)[0])
    starts, ends = (path.frenet([lane.centerline[k] for lane in lanes])[0] for k in (0, -1))
    first = {"open": min(starts.min(), 0.0), "joint": 0.0}.get(start, max(starts.max(), 0.0))
    last = {"open": max(ends.max(), whole[-1]), "joint": whole[-1]}.get(end, min(ends.min(), whole[-1]))
    taken = min(_TAKEN_M, _TAKEN_SHARE * (last - first))
    first, last = first + taken * (start == "short"), last - taken * (end == "short")
    if len(lanes) > 1 and last - first < _SHORTEST_M:
        return None
    line = line.between(first, last)
    s = line.samples()
    middles = [np.zeros(len(s)), *(_beside(path, first + s, lane) for lane in lanes[1:])]
    # Borders b_0 ... b_n with middles between them have one degree of freedom: b_k = (-1)^k b_0 + known_k.
    known = [np.zeros(len(s))]
    for middle in middles:
        known.append(2.0 * middle - known[-1])
    sign = (-1.0) ** np.arange(len(known))
    wider = [lane.width_m for lane in lanes] + np.diff(known, axis=0).mean(axis=1)
    # beyond the tightest bend's radius the left border would fold
    half = min(float((sign[:-1] * wider).mean()) / 2.0, 1.0 / max(np.abs(line.parts[:, 5]).max(), 1e-9))
    borders = max(half, _NARROWEST_M / 2.0) * sign[:, None] + np.array(known)
    for k in range(1, len(borders)):
        borders[k] = np.minimum(borders[k], borders[k - 1] - _NARROWEST_M)
    if np.abs((borders[1:] + borders[:-1]) / 2.0 - middles).max() > _ROW_WITHIN_M:
        return None
    return _Road(tuple(lane.lane_id for lane in lanes), line, s, borders)


def _beside(path: Polyline, s: FloatArray, lane: LaneSegment) -> FloatArray:
    """How far to the left of a path at s (K,) m a lane, drawn on beyond its ends, is: (K,) m."""
    along, aside = path.frenet(lane.path.point(np.arange(-_BEYOND_M, lane.length_m + _BEYOND_M, _EVERY_M)))
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
    line = _rounded(shapely.get_coordinates(shapely.remove_repeated_points(shapely.LineString(points), _NEAR_M)))
    ends = [-np.diff(road.borders[lane : lane + 2, k])[0] for road, lane, k in ((before, left, -1), (behind, right, 0))]
    half = np.array(ends) / 2.0
    return _Road(way.through, line, np.array([0.0, line.length_m]), np.array([half, -half]))


def opendrive_bytes(
    graph: LaneGraph, name: str, *, origin: CityOrigin | None = None, fastest_mps: float = SPEED_LIMIT_MPS
) -> bytes:
    """The .xodr file of a graph, in city coordinates. Equal graphs give equal bytes.

    name: of the map; origin: of the city frame; with it the file has a geo-reference. fastest_mps: see
    `speed_limit_mps`. Errors: NetError.
    """
    roads, drawn = _drawn(graph)
    ends: list[list[etree._Element]] = [[] for _ in drawn]
    for end, junction in enumerate(roads.junctions):
        joint = roads.joint(junction)
        if joint is not None:
            ends[end // 2].append(_link(_SIDES[end % 2], joint[end % 2]))
        elif junction in roads.ways_of:
            ends[end // 2].append(E(_SIDES[end % 2], elementType="junction", elementId=str(junction)))
    connecting: list[etree._Element] = []
    junctions = []
    for junction, ways in roads.ways_of.items():
        if roads.joint(junction) is not None:
            continue
        found = E.junction(id=str(junction), name=f"J{junction}")
        for way in ways:
            before, behind = roads.place[way.source][0], roads.place[way.target][0]
            left, right = drawn[before].lanes.index(way.source), drawn[behind].lanes.index(way.target)
            road = _connecting(graph, way, (drawn[before], left), (drawn[behind], right))
            number = len(drawn) + len(connecting)
            links = [_link("predecessor", before), _link("successor", behind)]
            leads = {"predecessor": [left], "successor": [right]}
            connecting.append(_road_xml(graph, road, number, links, leads, fastest_mps, junction=str(junction)))
            known = {"id": str(len(found)), "incomingRoad": str(before), "connectingRoad": str(number)}
            lane_link = E.laneLink({"from": str(-1 - left), "to": "-1"})
            found.append(E.connection({**known, "contactPoint": "start"}, lane_link))
        junctions.append(found)
    whole = []
    for number, road in enumerate(drawn):
        joined = [str(link.tag) for link in ends[number] if link.get("elementType") == "road"]
        lanes = dict.fromkeys(joined, range(len(road.lanes)))
        whole.append(_road_xml(graph, road, number, ends[number], lanes, fastest_mps))
    (west, south), (east, north) = graph.bounds
    ground = {"north": north, "south": south, "east": east, "west": west}
    known = {"revMajor": "1", "revMinor": "7", "name": name, "version": "1.00", "vendor": "hid2-sumo"}
    header = E.header({**known, **{side: f"{value:.3f}" for side, value in ground.items()}})
    if origin is not None:
        header.append(E.geoReference(etree.CDATA(origin.projection)))
        header.append(E.offset(x=f"{origin.easting_m:.4f}", y=f"{origin.northing_m:.4f}", z="0", hdg="0"))
    return xml_bytes(E.OpenDRIVE(header, *whole, *connecting, *junctions))


def _drawn(graph: LaneGraph) -> tuple[RoadGraph, list[_Road]]:
    """Roads, and each with its line; lanes of rows that cannot be one road are roads of their own."""
    apart: set[int] = set()
    while True:
        roads = roads_of(graph, apart=apart)
        left, entered = {way.source for way in roads.ways}, {way.target for way in roads.ways}
        ends: list[_End] = ["open"] * len(roads.junctions)
        for end, junction in enumerate(roads.junctions):
            if junction in roads.ways_of:
                ends[end] = "junction" if roads.joint(junction) is None else "joint"
        merging: dict[tuple[int, int], set[int]] = {}
        for way in roads.ways:
            merging.setdefault((roads.place[way.source][0], way.target), set()).add(way.source)
            for end in (2 * roads.place[way.source][0] + 1, 2 * roads.place[way.target][0]):
                if not way.through and ends[end] == "junction":
                    ends[end] = "short"
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
                before_m = start if lane.lane_id not in entered else 0.0
                behind_m = lane.length_m - end if lane.lane_id not in left else 0.0
                if max(before_m, behind_m) > _ROW_WITHIN_M:
                    apart.add(lane.lane_id)  # nothing leads to what is cut off
        if len(apart) == before:
            return roads, drawn


def _link(side: str, road: int) -> etree._Element:
    contact = "end" if side == "predecessor" else "start"
    return E(side, elementType="road", elementId=str(road), contactPoint=contact)


def _road_xml(
    graph: LaneGraph, road: _Road, number: int, ends: Sequence[etree._Element], lanes: Mapping[str, Sequence[int]],
    fastest_mps: float, *, junction: str = "-1",
) -> etree._Element:  # fmt: skip
    """A road. ends: what it is linked with; lanes: those before and behind each of its lanes, from the left."""
    through = junction != "-1"
    offsets = E.lanes(*_pieces("laneOffset", road.s, road.borders[0], "s"))
    plan = []
    for s, x, y, heading, length, curvature in road.line.parts.tolist():
        shape = E.arc(curvature=f"{curvature:.9f}") if curvature else E.line()
        place = {"s": f"{s:.6f}", "x": f"{x:.6f}", "y": f"{y:.6f}", "hdg": f"{heading:.9f}", "length": f"{length:.6f}"}
        plan.append(E.geometry(place, shape))
    knots = _sections(road) if not through else [0, len(road.s) - 1]
    for first, last in pairwise(knots):
        within = [side for side, far in zip(_SIDES, (first, len(road.s) - 1 - last), strict=True) if far]
        linked = {**lanes, **dict.fromkeys(within, range(len(road.lanes)))}
        offsets.append(_section(graph, road, slice(first, last + 1), linked, through=through))
    known = {"name": " ".join(map(str, road.lanes)), "length": f"{road.line.length_m:.6f}", "id": str(number)}
    known |= {"junction": junction, "rule": "RHT"}
    town = E.type(E.speed(max=f"{speed_limit_mps(fastest_mps):g}", unit="m/s"), s="0", type="town")
    return E.road(known, E.link(*ends), town, E.planView(*plan), offsets)


def _sections(road: _Road) -> list[int]:
    """Indices into the road's s at which its lane sections begin, and its end."""
    widths, begins = road.borders[:-1] - road.borders[1:], [0]
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
            own = graph.lanes[segments[0]]
            right = graph.neighbor(own.lane_id, "right")
            allowed = graph.may_change(own.lane_id, "right"), right is not None and graph.may_change(right, "left")
            lane.append(_mark(own.right_mark_type, _CHANGES[allowed], outwards_is_left=False))
        if segments:
            lane.append(E.userData(code=LANE_IDS, value=" ".join(map(str, segments))))
        drawn.append(lane)
    center = E.lane(id="0", type="none", level="false")
    if not through:
        center.append(_mark(graph.lanes[road.lanes[0]].left_mark_type, "none", outwards_is_left=True))
    return E.laneSection(E.center(center), E.right(*drawn), s=f"{road.s[part][0]:.6f}")


def _pieces(name: str, s: FloatArray, values: FloatArray, at: str) -> Iterator[etree._Element]:
    """Values (K,) m at s (K,) m as pieces that are linear."""
    kept = np.asarray(shapely.LineString(np.column_stack([s, values])).simplify(_WIDTH_WITHIN_M).coords)
    for (first, value), (last, then) in pairwise(kept.tolist()):
        slope = (then - value) / (last - first)
        yield E(name, {at: f"{first:.6f}", "a": f"{value:.6f}", "b": f"{slope:.9f}", "c": "0", "d": "0"})


def _mark(mark_type: str, changes: str, *, outwards_is_left: bool) -> etree._Element:
    """A marking, of which Argoverse names the lines from the lane outwards."""
    words = mark_type.split("_")
    lines = ["solid" if word == "SOLID" else "broken" for word in words if word in {"SOLID", "DASH", "DASHED"}]
    lines *= 2 if words[0] == "DOUBLE" else 1
    kind = " ".join(reversed(lines) if outwards_is_left else lines) or "none"
    color = words[-1].lower() if lines else "standard"
    return E.roadMark(sOffset="0", type=kind, color=color, width="0.12", laneChange=changes)
