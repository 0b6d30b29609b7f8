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
from bridge.recordings.recording import Recording
from bridge.recordings.rules import Breach
from netconvert import av2_map
from netconvert.errors import MapError
from netconvert.lane_graph import LaneGraph

#: Lists of points that have heights in maps of Argoverse 2: how their owners are called, and the fields.
_POINTS = {
    "drivable_areas": ("drivable area", ("area_boundary",)),
    "pedestrian_crossings": ("pedestrian crossing", ("edge1", "edge2")),
    "lane_segments": ("lane segment", ("left_lane_boundary", "right_lane_boundary", "centerline")),
}


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
        graph = av2_map.lane_graph_from_json(document, name=name)
        check_map_size(graph, name)
    said = _lacks_a_part(document) or next((said for _, said in _stricter(document)), "")
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
    if said:
        return None, [("map", said)]
    with np.errstate(over="ignore", invalid="ignore"):
        breaches = av2_map.read_map(document)[1] + list(_stricter(document))
    lanes = document["lane_segments"].items()
    lacking = [f"lane segment {key}: no centerline" for key, lane in lanes if not lane.get("centerline")]
    return document, breaches + [("boundary", f"{said}, expected at least 2 points") for said in lacking]


def _lacks_a_part(document: object) -> str:
    for part in _POINTS:
        if not isinstance(document, dict) or not isinstance(document.get(part), dict):
            return f"no object {part!r}, expected drivable_areas, lane_segments and pedestrian_crossings"
        for key, value in document[part].items():
            if not isinstance(value, dict):
                return f"{part} {one_line(key, most=40)!r} is no object"
    return ""


def _stricter(document: Mapping[str, Any]) -> Iterator[Breach]:
    """What readers of the format demand of a map that has its parts, beyond what a lane graph needs."""
    if not document["drivable_areas"]:
        yield "map", "no drivable area, expected at least one: where there is none, nothing tells what is off the road"
    for part, (name, fields) in _POINTS.items():
        for key, one in document[part].items():
            for field in fields:
                points = one.get(field)
                if isinstance(points, list) and not _are_finite(points):
                    i, point = next((i, point) for i, point in enumerate(points) if not _are_finite([point]))
                    shown = one_line(str(point), most=100)
                    yield "map", f"{name} {key}: {field}[{i}] is {shown}, expected finite x, y and z"
    for key, lane in document["lane_segments"].items():
        if "predecessors" not in lane:
            yield "map", f"lane segment {key}: no predecessors"
        if str(lane.get("id")) != str(key):
            yield "map", f"lane segment {key}: id {lane.get('id')!r}, expected its key"


def _are_finite(points: list[Any]) -> bool:
    try:
        values = [point[axis] for point in points for axis in "xyz"]
    except (KeyError, TypeError, IndexError):
        return False
    try:
        return {*map(type, values)} <= {float, int} and bool(np.isfinite(np.array(values, dtype=np.float64)).all())
    except OverflowError:  # an integer that no double holds
        return False


def compare_map(path: Path, document: Mapping[str, Any], source: Recording) -> Iterator[str]:
    """The map against the bytes of the source's; only centrelines may have been added."""
    name = source.map_path.name
    try:
        raw = source.map_path.read_bytes() if source.map_json is None else source.map_json
        if path.read_bytes() == raw:
            return
    except OSError as error:
        yield f"{name}: cannot be read ({error})"
        return
    wanted = from_json(raw)
    lacking = {key for key, lane in wanted["lane_segments"].items() if not lane.get("centerline")}
    if not lacking:
        yield f"not the bytes of {name}"
        return
    ours = {**document, "lane_segments": {key: {**lane} for key, lane in document["lane_segments"].items()}}
    for lanes in (ours["lane_segments"], wanted["lane_segments"]):
        for key in lacking & lanes.keys():
            lanes[key].pop("centerline", None)
    if ours != wanted:
        yield f"differs from {name} in more than added centrelines"
