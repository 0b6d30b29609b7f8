"""Argoverse 2 vector maps (log_map_archive_*.json) as lane graphs."""

import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from netconvert.errors import MapError
from netconvert.geometry import FloatArray, arc_length
from netconvert.lane_graph import LANE_TYPES, LaneGraph, LaneSegment, turn_type

#: Points of a derived centreline, as in av2.geometry.interpolate.NUM_CENTERLINE_INTERP_PTS.
CENTERLINE_POINTS = 10
#: A lane shorter than this has no direction: the format's coordinates are in centimetres.
MIN_LENGTH_M = 0.001

MARK_TYPES = frozenset(
    {
        *(f"{line}_{color}" for line in ("DASH_SOLID", "SOLID_DASH") for color in ("WHITE", "YELLOW")),
        *(f"{line}_{color}" for line in ("DASHED", "SOLID") for color in ("WHITE", "YELLOW")),
        *(f"DOUBLE_{line}_{color}" for line in ("DASH", "SOLID") for color in ("WHITE", "YELLOW")),
        "SOLID_BLUE",
        "NONE",
        "UNKNOWN",
    }
)
_FIELDS = (
    "id",
    "lane_type",
    "is_intersection",
    "left_lane_boundary",
    "right_lane_boundary",
    "left_lane_mark_type",
    "right_lane_mark_type",
    "left_neighbor_id",
    "right_neighbor_id",
    "successors",
)


def lane_graph_from_json(data: Any, *, name: str) -> LaneGraph:  # noqa: ANN401
    """Build the lane graph of a decoded map; name stands for the file in messages."""
    segments = _objects(data, "lane_segments", name=name)
    areas = _objects(data, "drivable_areas", name=name)
    shapes = [_Shape.of(segment, where=f"{name}: lane {key}") for key, segment in segments.items()]
    rungs = _rungs([boundary for shape in shapes for boundary in (shape.left, shape.right)])
    lanes: dict[int, LaneSegment] = {}
    for number, (key, segment) in enumerate(segments.items()):
        where = f"{name}: lane {key}"
        lane = _lane_segment(segment, shapes[number], rungs[2 * number], rungs[2 * number + 1], where=where)
        if lane.lane_id in lanes:
            raise MapError(f"{where}: id {lane.lane_id} appears twice, expected one segment an id")
        lanes[lane.lane_id] = lane
    if not any(lane.lane_type == "VEHICLE" for lane in lanes.values()):
        raise MapError(f"{name}: no lane of type VEHICLE among {len(lanes)} lane segments, expected at least one")
    rings = []
    for key, area in areas.items():
        where = f"{name}: drivable area {key}"
        if not isinstance(area, dict) or "area_boundary" not in area:
            raise MapError(f"{where}: no area_boundary, expected a list of points")
        ring = _points(area["area_boundary"], where=f"{where}: area_boundary", axes="xy", at_least=3)
        rings.append(np.vstack([ring, ring[:1]]))
    crossings = _objects(data, "pedestrian_crossings", name=name) if "pedestrian_crossings" in data else {}
    return LaneGraph(
        lanes,
        tuple(rings),
        tuple(_crossing(found, where=f"{name}: pedestrian crossing {key}") for key, found in crossings.items()),
    )


def _objects(data: Any, key: str, *, name: str) -> Mapping[str, Any]:  # noqa: ANN401
    if not isinstance(data, dict) or not isinstance(data.get(key), dict):
        raise MapError(f"{name}: no object {key!r}, expected an Argoverse 2 vector map")
    objects: dict[str, Any] = data[key]
    return objects


def _crossing(found: Any, *, where: str) -> FloatArray:  # noqa: ANN401
    """Corners of a pedestrian crossing, along its first edge and back along the second; (4, 2) m."""
    if not isinstance(found, dict) or "edge1" not in found or "edge2" not in found:
        raise MapError(f"{where}: no edge1 or no edge2, expected two lists of points")
    first, second = (
        _points(found[edge], where=f"{where}: {edge}", axes="xy", at_least=2)[[0, -1]] for edge in ("edge1", "edge2")
    )
    if np.dot(first[1] - first[0], second[1] - second[0]) > 0:
        second = second[::-1]
    return np.concatenate([first, second])


@dataclass(frozen=True, eq=False, slots=True)
class _Shape:
    """What a segment's lists of points hold."""

    left: FloatArray
    """(M, 3) m."""
    right: FloatArray
    """(M, 3) m."""
    centerline: FloatArray | None
    """(N, 2) m, None where the source has none."""

    @staticmethod
    def of(segment: Any, *, where: str) -> "_Shape":  # noqa: ANN401
        if not isinstance(segment, dict):
            raise MapError(f"{where}: {type(segment).__name__}, expected an object")
        missing = [field for field in _FIELDS if field not in segment]
        if missing:
            raise MapError(f"{where}: no {', '.join(missing)}, expected the fields of an Argoverse 2 lane segment")
        centerline = segment.get("centerline")
        return _Shape(
            left=_points(segment["left_lane_boundary"], where=f"{where}: left_lane_boundary", axes="xyz", at_least=2),
            right=_points(
                segment["right_lane_boundary"], where=f"{where}: right_lane_boundary", axes="xyz", at_least=2
            ),
            centerline=None
            if centerline is None
            else _points(centerline, where=f"{where}: centerline", axes="xy", at_least=2),
        )


def _lane_segment(
    segment: Mapping[str, Any], shape: _Shape, left_rungs: FloatArray, right_rungs: FloatArray, *, where: str
) -> LaneSegment:
    centerline = shape.centerline
    if centerline is None:
        centerline = (left_rungs[:, :2] + right_rungs[:, :2]) / 2.0
    centerline = _without_repeats(centerline)
    length_m = float(arc_length(centerline)[-1])
    if length_m < MIN_LENGTH_M:
        raise MapError(f"{where}: centerline is {length_m:.6f} m long, expected at least {MIN_LENGTH_M} m")
    is_intersection = segment["is_intersection"]
    if not isinstance(is_intersection, bool):
        raise MapError(f"{where}: is_intersection {reprlib.repr(is_intersection)}, expected true or false")
    gaps = left_rungs - right_rungs
    return LaneSegment(
        lane_id=_lane_id(segment["id"], where=f"{where}: id"),
        centerline=centerline,
        left_boundary=np.ascontiguousarray(shape.left[:, :2]),
        right_boundary=np.ascontiguousarray(shape.right[:, :2]),
        lane_type=_one_of(segment["lane_type"], LANE_TYPES, where=f"{where}: lane_type"),
        is_intersection=is_intersection,
        successors=_lane_ids(segment["successors"], where=f"{where}: successors"),
        left_neighbor_id=_neighbor_id(segment["left_neighbor_id"], where=f"{where}: left_neighbor_id"),
        right_neighbor_id=_neighbor_id(segment["right_neighbor_id"], where=f"{where}: right_neighbor_id"),
        left_mark_type=_one_of(segment["left_lane_mark_type"], MARK_TYPES, where=f"{where}: left_lane_mark_type"),
        right_mark_type=_one_of(segment["right_lane_mark_type"], MARK_TYPES, where=f"{where}: right_lane_mark_type"),
        width_m=float(np.hypot(gaps[:, 0], gaps[:, 1]).mean()),
        turn=turn_type(centerline, is_intersection=is_intersection),
    )


def _points(value: Any, *, where: str, axes: str, at_least: int) -> FloatArray:  # noqa: ANN401
    """Coordinates of a list of {x, y, z}; (N, len(axes)) m."""
    if not isinstance(value, list) or len(value) < at_least:
        found = f"{len(value)} points" if isinstance(value, list) else reprlib.repr(value)
        raise MapError(f"{where}: {found}, expected at least {at_least} points")
    try:
        if axes == "xy":
            points = np.array([(point["x"], point["y"]) for point in value], dtype=np.float64)
        else:
            points = np.array([(point["x"], point["y"], point["z"]) for point in value], dtype=np.float64)
    except KeyError as error:
        raise MapError(f"{where}: a point has no {error}, expected x, y and z") from error
    except (TypeError, ValueError) as error:
        raise MapError(f"{where}: a point is not made of numbers ({error}), expected x, y and z") from error
    if not np.isfinite(points).all():
        raise MapError(f"{where}: point {points[~np.isfinite(points).all(axis=1)][0]}, expected finite coordinates")
    return points


def _rungs(boundaries: Sequence[FloatArray]) -> FloatArray:
    """CENTERLINE_POINTS points at equal distances (in space) along each boundary.

    boundaries: B arrays (M, 3) m, all interpolated in one go on one long axis of arc length. Returns (B, 10, 3) m.
    """
    if not boundaries:
        return np.zeros((0, CENTERLINE_POINTS, 3))
    points = np.concatenate(boundaries)
    first = np.cumsum([0, *(len(boundary) for boundary in boundaries[:-1])])
    steps = np.zeros(len(points))
    steps[1:] = np.sqrt(np.square(points[1:] - points[:-1]).sum(axis=1))
    # The step from one boundary to the next stays on the axis: no point is asked for there.
    s = np.cumsum(steps)
    start, end = s[first], s[np.append(first[1:], len(points)) - 1]
    at = start[:, None] + (end - start)[:, None] * np.linspace(0.0, 1.0, CENTERLINE_POINTS)
    at[:, -1] = end
    rungs = np.stack([np.interp(at, s, points[:, axis]) for axis in range(3)], axis=-1)
    # Boundaries that meet lie at one place of the axis: each keeps its own ends.
    rungs[:, 0], rungs[:, -1] = points[first], points[np.append(first[1:], len(points)) - 1]
    return rungs


def _without_repeats(points: FloatArray) -> FloatArray:
    """The points without those that repeat the one before; the first always stays."""
    keep = np.ones(len(points), dtype=np.bool_)
    keep[1:] = np.any(points[1:] != points[:-1], axis=1)
    return points if keep.all() else points[keep]


def _lane_id(value: Any, *, where: str) -> int:  # noqa: ANN401
    if not isinstance(value, int) or isinstance(value, bool):
        raise MapError(f"{where}: {reprlib.repr(value)}, expected an integer")
    return value


def _neighbor_id(value: Any, *, where: str) -> int | None:  # noqa: ANN401
    return None if value is None else _lane_id(value, where=where)


def _lane_ids(value: Any, *, where: str) -> tuple[int, ...]:  # noqa: ANN401
    if not isinstance(value, Sequence) or isinstance(value, str):
        raise MapError(f"{where}: {reprlib.repr(value)}, expected a list of lane ids")
    return tuple(_lane_id(item, where=where) for item in value)


def _one_of(value: Any, allowed: frozenset[str], *, where: str) -> str:  # noqa: ANN401
    if not isinstance(value, str) or value not in allowed:
        raise MapError(f"{where}: {reprlib.repr(value)}, expected one of {', '.join(sorted(allowed))}")
    return value
