"""The rules on the map of a scenario: what every reader of Argoverse 2 maps demands, and the source's map.

They hold for maps that are read as much as for those that are written: a source that breaks one is refused.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic_core import from_json

from bridge.files import one_line, read_regular
from bridge.recordings.limits import MAX_FILE_MB, check_map_size
from bridge.recordings.rules import Breach
from netconvert.av2_map import lane_graph_from_json
from netconvert.errors import MapError
from netconvert.lane_graph import LANE_TYPES, LaneGraph

MARK_TYPES = frozenset(
    {
        "DASH_SOLID_YELLOW",
        "DASH_SOLID_WHITE",
        "DASHED_WHITE",
        "DASHED_YELLOW",
        "DOUBLE_SOLID_YELLOW",
        "DOUBLE_SOLID_WHITE",
        "DOUBLE_DASH_YELLOW",
        "DOUBLE_DASH_WHITE",
        "SOLID_YELLOW",
        "SOLID_WHITE",
        "SOLID_DASH_WHITE",
        "SOLID_DASH_YELLOW",
        "SOLID_BLUE",
        "NONE",
        "UNKNOWN",
    }
)


def read_source_map(path: Path) -> LaneGraph:
    """The lane graph of a map file that keeps the rules; only centrelines may be missing. Errors: MapError."""
    return graph_of(_decoded(path), name=str(path))


def read_document(path: Path) -> dict[str, Any]:
    """The document of a map file that has the parts of a map. Errors: MapError."""
    document = _decoded(path)
    said = _lacks_a_part(document)
    if said:
        raise MapError(f"{path}: {said}")
    return document  # type: ignore[no-any-return]  # it has parts


def graph_of(document: Any, *, name: str) -> LaneGraph:  # noqa: ANN401  # decoded JSON
    """The lane graph of a document that keeps the rules; only centrelines may be missing. Errors: MapError.

    name: what messages call the document.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # coordinates may be anything until their size is known
        graph = lane_graph_from_json(document, name=name)
        check_map_size(graph, name)
    said = _lacks_a_part(document) or next((said for _, said in _check_map(document, centerlines=False)), "")
    if said:
        raise MapError(f"{name}: {said}")
    if not graph.drivable.area > 0.0:
        raise MapError(f"{name}: drivable areas of 0 m2 in all, expected the ground that can be driven on")
    return graph


def _decoded(path: Path) -> Any:  # noqa: ANN401  # whatever JSON holds
    try:
        return from_json(read_regular(path, most_mb=MAX_FILE_MB))
    except OSError as error:
        raise MapError(f"{path}: cannot read the map: {error.strerror}") from error
    except ValueError as error:
        raise MapError(f"{path}: not JSON: {error}") from error


def read_map(path: Path) -> tuple[dict[str, Any] | None, list[Breach]]:
    """The document of a map file, None where it is no map, and what is wrong with it."""
    try:
        document = from_json(read_regular(path, most_mb=MAX_FILE_MB))
    except (OSError, ValueError) as error:
        return None, [("map", f"not JSON ({error})")]
    said = _lacks_a_part(document)
    return (None, [("map", said)]) if said else (document, list(_check_map(document, centerlines=True)))


def _lacks_a_part(document: object) -> str:
    for part in ("drivable_areas", "lane_segments", "pedestrian_crossings"):
        if not isinstance(document, dict) or not isinstance(document.get(part), dict):
            return f"no object {part!r}, expected drivable_areas, lane_segments and pedestrian_crossings"
        for key, value in document[part].items():
            if not isinstance(value, dict):
                return f"{part} {one_line(key, most=40)!r} is no object"
    return ""


def _check_map(document: Mapping[str, Any], *, centerlines: bool) -> Iterator[Breach]:
    """What is wrong in a map that has its parts; centerlines: whether each lane must have one."""
    if not document["drivable_areas"]:
        yield "map", "no drivable area, expected at least one: where there is none, nothing tells what is off the road"
    for key, area in document["drivable_areas"].items():
        yield from _check_points(area, "area_boundary", f"drivable area {key}", least=3)
    for key, crossing in document["pedestrian_crossings"].items():
        for edge in ("edge1", "edge2"):
            yield from _check_points(crossing, edge, f"pedestrian crossing {key}", least=2)
    for key, lane in document["lane_segments"].items():
        name = f"lane segment {key}"
        for column in ("id", "is_intersection", "successors", "predecessors", "left_neighbor_id", "right_neighbor_id"):
            if column not in lane:
                yield "map", f"{name}: no {column}"
        if str(lane.get("id")) != str(key):
            yield "map", f"{name}: id {lane.get('id')!r}, expected its key"
        if lane.get("lane_type") not in LANE_TYPES:
            yield "lane-type", f"{name}: lane_type {lane.get('lane_type')!r}, expected {', '.join(sorted(LANE_TYPES))}"
        for side in ("left", "right"):
            mark = lane.get(f"{side}_lane_mark_type")
            if mark not in MARK_TYPES:
                yield "mark-type", f"{name}: {side}_lane_mark_type {mark!r}, expected one of the enum"
            yield from _check_points(lane, f"{side}_lane_boundary", name, least=2)
        if centerlines or lane.get("centerline"):
            yield from _check_points(lane, "centerline", name, least=2)


def _check_points(owner: Mapping[str, Any], field: str, name: str, *, least: int) -> Iterator[Breach]:
    points = owner.get(field)
    if not isinstance(points, list) or len(points) < least:
        have = len(points) if isinstance(points, list) else "none"
        yield "boundary", f"{name}: {field} of {have} points, expected at least {least}"
    elif not _are_finite(points):
        i, point = next((i, point) for i, point in enumerate(points) if not _are_finite([point]))
        yield "map", f"{name}: {field}[{i}] is {one_line(str(point), most=100)}, expected finite x, y and z"


def _are_finite(points: list[Any]) -> bool:
    try:
        values = [point[axis] for point in points for axis in "xyz"]
    except (KeyError, TypeError, IndexError):
        return False
    try:
        return {*map(type, values)} <= {float, int} and bool(np.isfinite(np.array(values, dtype=np.float64)).all())
    except OverflowError:  # an integer that no double holds
        return False


def compare_map(path: Path, document: Mapping[str, Any], raw: bytes, *, name: str) -> Iterator[str]:
    """The map against the bytes of the source's; only centrelines may have been added. name: of the source's map."""
    try:
        if path.read_bytes() == raw:
            return
        source = from_json(raw)
    except (OSError, ValueError) as error:
        yield f"{name}: cannot be read ({error})"
        return
    said = _lacks_a_part(source)
    if said:
        yield f"{name}: {said}"
        return
    lanes = source.get("lane_segments", {})
    lacking = {key for key, lane in lanes.items() if not lane.get("centerline")}
    if not lacking:
        yield f"not the bytes of {name}"
        return

    def without_added(lane_segments: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
        return {
            key: {name: value for name, value in lane.items() if name != "centerline" or key not in lacking}
            for key, lane in lane_segments.items()
        }

    ours = {**document, "lane_segments": without_added(document["lane_segments"])}
    if ours != {**source, "lane_segments": without_added(lanes)}:
        yield f"differs from {name} in more than added centrelines"
