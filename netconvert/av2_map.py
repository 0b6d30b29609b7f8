"""Argoverse 2 vector maps (log_map_archive_*.json) as lane graphs."""

import reprlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from netconvert.errors import MapError
from netconvert.geometry import FloatArray, arc_length
from netconvert.lane_graph import LANE_TYPES, LaneGraph, LaneSegment, turn_type

#: Points of a derived centreline, as in av2.geometry.interpolate.NUM_CENTERLINE_INTERP_PTS.
CENTERLINE_POINTS = 10
#: A lane shorter than this has no direction: the format's coordinates are in centimetres.
MIN_LENGTH_M = 0.001
_LINES = ("DASHED", "SOLID", "DASH_SOLID", "SOLID_DASH", "DOUBLE_DASH", "DOUBLE_SOLID")
MARK_TYPES = frozenset(
    {f"{line}_{color}" for line in _LINES for color in ("WHITE", "YELLOW")} | {"SOLID_BLUE", "NONE", "UNKNOWN"}
)
#: The parts of a map, and how what is in them is called.
_PARTS = {
    "lane_segments": "lane",
    "drivable_areas": "drivable area",
    "pedestrian_crossings": "pedestrian crossing",
}
#: A rule of the format that is broken, by its name, and what is said of it.
Breach = tuple[str, str]
#: Reads one value of a map. Errors: _RefusedError.
_Read = Callable[[Any], Any]


class _RefusedError(Exception):
    """A value that breaks a rule: the rule, and what is said of the value."""


def lane_graph_from_json(data: Any, *, name: str) -> LaneGraph:  # noqa: ANN401
    """Build the lane graph of a decoded map; name stands for the file in messages. Errors: MapError."""
    graph, breaches = read_map(data)
    if graph is None:
        raise MapError(f"{name}: {breaches[0][1]}")
    return graph


def read_map(data: Any) -> tuple[LaneGraph | None, list[Breach]]:  # noqa: ANN401
    """The lane graph of a decoded map, and all that is wrong with the map, of which there is no graph then.

    Demanded is what readers of the format demand, also where a lane graph needs less; only centrelines may be missing.
    """
    said = lacks_a_part(data)
    if said:
        return None, [("map", said)]
    found: list[Breach] = []
    lanes: dict[int, LaneSegment] = {}
    for key, segment in data["lane_segments"].items():
        lane = _lane_segment(segment, f"lane {key}", found)
        if lane is not None and str(lane.lane_id) != key:
            found.append(("map", f"lane {key}: id {lane.lane_id}, expected its key"))
        elif lane is not None:
            lanes[lane.lane_id] = lane
    if not found and not any(lane.lane_type == "VEHICLE" for lane in lanes.values()):
        said = f"no lane of type VEHICLE among {len(lanes)} lane segments, expected at least one"
        found.append(("map", said))
    if not data["drivable_areas"]:
        said = "no drivable area, expected at least one: where there is none, nothing tells what is off the road"
        found.append(("map", said))
    areas = [_values(one, _AREA, f"drivable area {key}", found) for key, one in data["drivable_areas"].items()]
    crossings = [
        _values(one, _CROSSING, f"pedestrian crossing {key}", found)
        for key, one in data["pedestrian_crossings"].items()
    ]
    if found:
        return None, found
    rings = (np.vstack([ring, ring[:1]])[:, :2] for (ring,) in map(dict.values, areas))
    return LaneGraph(lanes, tuple(rings), tuple(_corners(*edges.values()) for edges in crossings)), []


def lacks_a_part(data: object) -> str:
    """What of its parts a decoded map lacks; "" where each is an object of objects."""
    for part, name in _PARTS.items():
        if not isinstance(data, dict) or not isinstance(data.get(part), dict):
            return f"no object {part!r}, expected {', '.join(_PARTS)} of an Argoverse 2 vector map"
        for key, one in data[part].items():
            if not isinstance(one, dict):
                return f"{name} {key}: {type(one).__name__}, expected an object"
    return ""


def _corners(first: FloatArray, second: FloatArray) -> FloatArray:
    """Corners of a pedestrian crossing, along its first edge and back along the second; (4, 2) m."""
    first, second = first[[0, -1], :2], second[[0, -1], :2]
    is_along = np.dot(first[1] - first[0], second[1] - second[0]) > 0
    return np.concatenate([first, second[::-1] if is_along else second])


def _lane_segment(segment: Mapping[str, Any], where: str, found: list[Breach]) -> LaneSegment | None:
    """One lane; None where something is wrong, which is appended to `found`."""
    before = len(found)
    values = _values({"centerline": None, **segment}, _LANE, where, found)
    if len(found) > before:
        return None
    left, right, centerline = (values.pop(line) for line in ("left_lane_boundary", "right_lane_boundary", "centerline"))
    rungs = _rungs(left), _rungs(right)
    if centerline is None:
        centerline = (rungs[0] + rungs[1]) / 2.0
    centerline = centerline[:, :2]
    centerline = centerline[np.append(True, np.any(centerline[1:] != centerline[:-1], axis=1))]
    length_m = float(arc_length(centerline)[-1])
    if length_m < MIN_LENGTH_M:
        said = f"centerline is {length_m:.6f} m long, expected at least {MIN_LENGTH_M} m"
        found.append(("map", f"{where}: {said}"))
        return None
    try:
        return LaneSegment(
            lane_id=values["id"],
            centerline=centerline,
            left_boundary=np.ascontiguousarray(left[:, :2]),
            right_boundary=np.ascontiguousarray(right[:, :2]),
            lane_type=values["lane_type"],
            is_intersection=values["is_intersection"],
            successors=values["successors"],
            left_neighbor_id=values["left_neighbor_id"],
            right_neighbor_id=values["right_neighbor_id"],
            left_mark_type=values["left_lane_mark_type"],
            right_mark_type=values["right_lane_mark_type"],
            width_m=float(np.hypot(*(rungs[0] - rungs[1]).T[:2]).mean()),
            turn=turn_type(centerline, is_intersection=values["is_intersection"]),
        )
    except MapError as error:  # coordinates without end
        found.append(("map", str(error)))
        return None


def _rungs(boundary: FloatArray) -> FloatArray:
    """CENTERLINE_POINTS points at equal distances (in space) along a boundary (M, 3) m; (10, 3) m."""
    s = np.append(0.0, np.cumsum(np.sqrt(np.square(boundary[1:] - boundary[:-1]).sum(axis=1))))
    at = np.linspace(0.0, s[-1], CENTERLINE_POINTS)
    return np.column_stack([np.interp(at, s, axis) for axis in boundary.T])


def _values(owner: Mapping[str, Any], fields: Mapping[str, _Read], where: str, found: list[Breach]) -> dict[str, Any]:
    """The fields of an object as they are read; what is wrong with them is appended to `found`."""
    missing = [field for field in fields if field not in owner]
    if missing:
        found.append(("map", f"{where}: {_LACKS.get(missing[-1], _LACKS_FIELDS).format(', '.join(missing))}"))
        return {}
    values = {}
    for field, read in fields.items():
        try:
            values[field] = read(owner[field])
        except _RefusedError as error:
            rule, said = error.args
            found.append((rule, f"{where}: {field}{said}"))
    return values


def _points(at_least: int = 2) -> _Read:
    """Reads the coordinates of a list of {x, y, z}; (N, 3) m."""

    def read(value: Any) -> FloatArray:  # noqa: ANN401
        if not isinstance(value, list) or len(value) < at_least:
            have = f"{len(value)} points" if isinstance(value, list) else reprlib.repr(value)
            raise _RefusedError("boundary", f": {have}, expected at least {at_least} points")
        points = _coordinates(value)
        if points is None:
            i, point = next((i, point) for i, point in enumerate(value) if _coordinates([point]) is None)
            raise _RefusedError("map", f"[{i}] is {reprlib.repr(point)}, expected finite x, y and z")
        return points

    return read


def _coordinates(points: list[Any]) -> FloatArray | None:
    """(N, 3) m; None where a point is not made of finite numbers."""
    try:
        values = [point[axis] for point in points for axis in "xyz"]
        numbers = np.array(values, dtype=np.float64).reshape(-1, 3)
    except (KeyError, IndexError, TypeError, ValueError, OverflowError):  # the last: an integer that no double holds
        return None
    return numbers if {*map(type, values)} <= {float, int} and bool(np.isfinite(numbers).all()) else None


def _integer(value: Any) -> int:  # noqa: ANN401
    if not isinstance(value, int) or isinstance(value, bool):
        raise _RefusedError("map", f": {reprlib.repr(value)}, expected an integer")
    return value


def _boolean(value: Any) -> bool:  # noqa: ANN401
    if not isinstance(value, bool):
        raise _RefusedError("map", f" {reprlib.repr(value)}, expected true or false")
    return value


def _lane_ids(value: Any) -> tuple[int, ...]:  # noqa: ANN401
    if not isinstance(value, Sequence) or isinstance(value, str):
        raise _RefusedError("map", f": {reprlib.repr(value)}, expected a list of lane ids")
    return tuple(map(_integer, value))


def _optional(read: _Read) -> _Read:
    return lambda value: None if value is None else read(value)


def _one_of(allowed: frozenset[str], rule: str) -> _Read:
    def read(value: Any) -> str:  # noqa: ANN401
        if not isinstance(value, str) or value not in allowed:
            raise _RefusedError(rule, f": {reprlib.repr(value)}, expected one of {', '.join(sorted(allowed))}")
        return value

    return read


#: What reads each field, by name.
_LANE: Mapping[str, _Read] = {
    "left_lane_boundary": _points(),
    "right_lane_boundary": _points(),
    "centerline": _optional(_points()),
    "id": _integer,
    "lane_type": _one_of(LANE_TYPES, "lane-type"),
    "is_intersection": _boolean,
    "predecessors": _lane_ids,
    "successors": _lane_ids,
    "left_neighbor_id": _optional(_integer),
    "right_neighbor_id": _optional(_integer),
    "left_lane_mark_type": _one_of(MARK_TYPES, "mark-type"),
    "right_lane_mark_type": _one_of(MARK_TYPES, "mark-type"),
}
_AREA: Mapping[str, _Read] = {"area_boundary": _points(at_least=3)}
_CROSSING: Mapping[str, _Read] = {"edge1": _points(), "edge2": _points()}
#: What is said where a field is missing.
_LACKS_FIELDS = "no {}, expected the fields of an Argoverse 2 lane segment"
_LACKS_EDGE = "no edge1 or no edge2, expected two lists of points"
_LACKS = {"area_boundary": "no area_boundary, expected a list of points", "edge1": _LACKS_EDGE, "edge2": _LACKS_EDGE}
