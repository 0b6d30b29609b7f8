"""Argoverse 2 vector maps (log_map_archive_*.json) as lane graphs."""

import reprlib
from typing import Annotated, Any, NotRequired

import numpy as np
from pydantic import Field, FiniteFloat, PlainValidator, TypeAdapter, ValidationError
from typing_extensions import TypedDict

from netconvert.errors import MapError
from netconvert.geometry import FloatArray, arc_length
from netconvert.lane_graph import LANE_TYPES, LaneGraph, LaneSegment, turn_type

#: Number of points of a derived centreline, as in av2.geometry.interpolate.NUM_CENTERLINE_INTERP_PTS.
CENTERLINE_POINTS = 10
#: Least length of a lane with a direction, m: the format's coordinates are in centimetres.
MIN_LENGTH_M = 0.001
#: Largest distance of a centreline outside of the boundaries of its lane, m. Recorded ones lie between them.
_OUTSIDE_M = 0.5
_LINES = ("DASHED", "SOLID", "DASH_SOLID", "SOLID_DASH", "DOUBLE_DASH", "DOUBLE_SOLID")
MARK_TYPES = frozenset(
    {f"{line}_{color}" for line in _LINES for color in ("WHITE", "YELLOW")} | {"SOLID_BLUE", "NONE", "UNKNOWN"}
)
#: Parts of a map, and the name of an element of each.
_PARTS = {"lane_segments": "lane", "drivable_areas": "drivable area", "pedestrian_crossings": "pedestrian crossing"}
#: A rule of the format that is broken, by its name, and what is said of it.
Breach = tuple[str, str]


def _one_of(allowed: frozenset[str]) -> PlainValidator:
    def check(value: object) -> object:
        if not isinstance(value, str) or value not in allowed:
            raise ValueError(f"one of {', '.join(sorted(allowed))}")
        return value

    return PlainValidator(check)


class _Point(TypedDict):
    x: FiniteFloat
    y: FiniteFloat
    z: FiniteFloat


_Line = Annotated[list[_Point], Field(min_length=2)]
_Mark = Annotated[str, _one_of(MARK_TYPES)]


class _Lane(TypedDict):
    id: int
    left_lane_boundary: _Line
    right_lane_boundary: _Line
    centerline: NotRequired[_Line | None]
    lane_type: Annotated[str, _one_of(LANE_TYPES)]
    is_intersection: bool
    predecessors: list[int]
    successors: list[int]
    left_neighbor_id: int | None
    right_neighbor_id: int | None
    left_lane_mark_type: _Mark
    right_lane_mark_type: _Mark


class _Area(TypedDict):
    area_boundary: Annotated[list[_Point], Field(min_length=3)]


class _Crossing(TypedDict):
    edge1: _Line
    edge2: _Line


class _Map(TypedDict):
    lane_segments: dict[str, _Lane]
    drivable_areas: dict[str, _Area]
    pedestrian_crossings: dict[str, _Crossing]


_MAP = TypeAdapter(_Map)
#: Rules by field; the others keep `map`, and lines without points `boundary`.
_RULES = {"lane_type": "lane-type", "left_lane_mark_type": "mark-type", "right_lane_mark_type": "mark-type"}


def read_map(data: Any) -> tuple[LaneGraph | None, list[Breach]]:  # noqa: ANN401
    """The lane graph of a decoded map, and all that is wrong with the map, of which there is no graph then.

    Demanded is what readers of the format demand, also where a lane graph needs less; only centrelines may be missing.
    """
    if said := lacks_a_part(data):
        return None, [("map", said)]
    try:
        values = _MAP.validate_python(data, strict=True)
    except ValidationError as error:
        return None, _breaches(error)
    found: list[Breach] = []
    lanes: dict[int, LaneSegment] = {}
    for key, segment in values["lane_segments"].items():
        if str(segment["id"]) != key:
            found.append(("map", f"lane {key}: id {segment['id']}, expected its key"))
        try:
            lanes[segment["id"]] = _lane_segment(segment)
        except MapError as error:
            found.append(("map", str(error)))
    if not found and not any(lane.lane_type == "VEHICLE" for lane in lanes.values()):
        said = f"no lane of type VEHICLE among {len(lanes)} lane segments, expected at least one"
        found.append(("map", said))
    if not values["drivable_areas"]:
        said = "no drivable area, expected at least one: where there is none, nothing tells what is off the road"
        found.append(("map", said))
    if found:
        return None, found
    rings = [_array(area["area_boundary"]) for area in values["drivable_areas"].values()]
    crossings = (_corners(one["edge1"], one["edge2"]) for one in values["pedestrian_crossings"].values())
    return LaneGraph(lanes, tuple(np.vstack([ring, ring[:1]])[:, :2] for ring in rings), tuple(crossings)), []


def _breaches(error: ValidationError) -> list[Breach]:
    """What is wrong with the fields of a map, of each field what comes first."""
    found: dict[tuple[int | str, ...], Breach] = {}
    for one in error.errors(include_url=False):
        (part, key, field), kind, value = one["loc"][:3], one["type"], one["input"]
        place = str(field) + "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in one["loc"][3:])
        said = (
            f": {reprlib.repr(value)}, expected " + one["msg"].split("Input should be ")[-1].split("Value error, ")[-1]
        )
        if kind == "missing":
            place, said = f"no {place}", f", expected the fields of an Argoverse 2 {_PARTS[str(part)]}"
        elif kind == "too_short":
            said = f": {len(value)} points, expected at least {one['ctx']['min_length']} points"
        lacks_points = kind in {"too_short", "list_type"} and not str(field).endswith("cessors")
        rule = "boundary" if lacks_points else _RULES.get(str(field), "map")
        found.setdefault((part, key, field), (rule, f"{_PARTS[str(part)]} {key}: {place}{said}"))
    return list(found.values())


def lacks_a_part(data: object) -> str:
    """What of its parts a decoded map lacks; "" where each is an object of objects."""
    for part, name in _PARTS.items():
        if not isinstance(data, dict) or not isinstance(data.get(part), dict):
            return f"no object {part!r}, expected {', '.join(_PARTS)} of an Argoverse 2 vector map"
        for key, one in data[part].items():
            if not isinstance(one, dict):
                return f"{name} {key}: {type(one).__name__}, expected an object"
    return ""


def _array(points: list[_Point]) -> FloatArray:
    """(N, 3) m."""
    return np.array([(point["x"], point["y"], point["z"]) for point in points], dtype=np.float64)


def _corners(edge1: list[_Point], edge2: list[_Point]) -> FloatArray:
    """Corners of a pedestrian crossing, along its first edge and back along the second; (4, 2) m."""
    first, second = (_array(edge)[[0, -1], :2] for edge in (edge1, edge2))
    is_along = np.dot(first[1] - first[0], second[1] - second[0]) > 0
    return np.concatenate([first, second[::-1] if is_along else second])


def _lane_segment(segment: _Lane) -> LaneSegment:
    """One lane. Errors: MapError for one of no length, of coordinates without end, or not between its boundaries."""
    left, right = _array(segment["left_lane_boundary"]), _array(segment["right_lane_boundary"])
    rungs, line = (_rungs(left), _rungs(right)), segment.get("centerline")
    middle, across = (rungs[0] + rungs[1]) / 2.0, rungs[0] - rungs[1]
    whole = middle if line is None else _array(line)
    centerline = whole[np.append(True, np.any(whole[1:, :2] != whole[:-1, :2], axis=1)), :2]
    length_m = float(arc_length(centerline)[-1])
    if not MIN_LENGTH_M <= length_m < np.inf:
        said = f"centerline is {length_m:.6f} m long, expected at least {MIN_LENGTH_M} m"
        raise MapError(f"lane {segment['id']}: {said}")
    outside_m = np.hypot(*(_rungs(whole) - middle).T[:2]) - 0.5 * np.hypot(*across.T[:2])
    if outside_m.max() > _OUTSIDE_M:
        said = f"centerline is {outside_m.max():.1f} m outside of its boundaries, expected it between them, or none"
        raise MapError(f"lane {segment['id']}: {said}")
    along = middle[1:] - middle[:-1]
    if (along[:, 0] * across[1:, 1] - along[:, 1] * across[1:, 0]).sum() < 0.0:
        raise MapError(f"lane {segment['id']}: left boundary is on the right of its lane, expected it on the left")
    return LaneSegment(
        lane_id=segment["id"],
        centerline=centerline,
        left_boundary=np.ascontiguousarray(left[:, :2]),
        right_boundary=np.ascontiguousarray(right[:, :2]),
        lane_type=segment["lane_type"],
        is_intersection=segment["is_intersection"],
        successors=tuple(segment["successors"]),
        left_neighbor_id=segment["left_neighbor_id"],
        right_neighbor_id=segment["right_neighbor_id"],
        left_mark_type=segment["left_lane_mark_type"],
        right_mark_type=segment["right_lane_mark_type"],
        width_m=float(np.hypot(*across.T[:2]).mean()),
        turn=turn_type(centerline, is_intersection=segment["is_intersection"]),
    )


def _rungs(boundary: FloatArray) -> FloatArray:
    """CENTERLINE_POINTS points at equal distances (in space) along a boundary (M, 3) m; (10, 3) m."""
    s = np.append(0.0, np.cumsum(np.sqrt(np.square(boundary[1:] - boundary[:-1]).sum(axis=1))))
    at = np.linspace(0.0, s[-1], CENTERLINE_POINTS)
    return np.column_stack([np.interp(at, s, axis) for axis in boundary.T])
