"""The rules on the map of a scenario: what every reader of Argoverse 2 maps demands.

They hold for maps that are read as much as for those that are written: a source that breaks one is refused.
"""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from pydantic_core import from_json

from bridge.files import read_received
from bridge.recordings import limits
from hid2.agents import Track
from netconvert import av2_map
from netconvert.av2_map import Breach
from netconvert.errors import MapError, ScenarioError
from netconvert.geometry import FloatArray
from netconvert.lane_graph import LaneGraph


def read_source_map(path: Path) -> LaneGraph:
    """The lane graph of a map file that keeps the rules; only centrelines may be missing. Errors: MapError."""
    graph, breaches = _known(read_received(path, MapError, wanted="an Argoverse 2 map"))
    if graph is None:
        raise MapError(f"{path}: {breaches[0][1]}")
    return graph


@lru_cache(maxsize=2)
def _known(content: bytes) -> tuple[LaneGraph | None, list[Breach]]:
    """As `checked`, of a map file: scenes made from one share its map, and reading it takes longest."""
    try:
        return checked(from_json(content))
    except ValueError as error:
        return None, [("map", f"not JSON ({error}), expected an Argoverse 2 map")]


def read_document(path: Path) -> dict[str, Any]:
    """The document of a map file that has the parts of a map. Errors: MapError."""
    try:
        document = from_json(read_received(path, MapError, wanted="an Argoverse 2 map"))
    except ValueError as error:
        raise MapError(f"{path}: not JSON ({error}), expected an Argoverse 2 map") from error
    said = av2_map.lacks_a_part(document)
    if said:
        raise MapError(f"{path}: {said}")
    return document  # type: ignore[no-any-return]  # it has parts


def graph_of(document: Any, *, name: str) -> LaneGraph:  # noqa: ANN401  # decoded JSON
    """The lane graph of a document that keeps the rules; only centrelines may be missing. Errors: MapError.

    name: what messages call the document.
    """
    graph, breaches = checked(document)
    if graph is None:
        raise MapError(f"{name}: {breaches[0][1]}")
    return graph


def checked(document: Any) -> tuple[LaneGraph | None, list[Breach]]:  # noqa: ANN401  # decoded JSON
    """The lane graph of a document, or what is wrong with it."""
    with np.errstate(over="ignore", invalid="ignore"):  # coordinates may be anything until their size is known
        graph, breaches = av2_map.read_map(document)
        said = "" if graph is None else _too_large(graph)
    if graph is not None and not said and not graph.drivable.area > 0.0:
        said = "drivable areas of 0 m2 in all, expected the ground that can be driven on"
    return (None, [("map", said)]) if said else (graph, breaches)


def _too_large(graph: LaneGraph) -> str:
    """What of a map is too large for a scene, with lane, value and limit; "" where nothing is."""
    lanes, rings = list(graph.lanes.values()), graph.drivable_areas
    lines, lane_ids = list(rings), {lane.lane_id for lane in lanes}
    sizes: list[tuple[str, float, float]] = [("lane segments", len(lanes), limits.MAX_LANES)]
    sizes.append(("drivable areas", len(rings), limits.MAX_AREAS))
    sizes += [("points of a drivable area", len(ring), limits.MAX_POINTS) for ring in rings]
    for lane in lanes:
        own, where = (lane.centerline, *lane.sides), f"lane {lane.lane_id}"
        sizes += [(f"{where}: points of a line", len(line), limits.MAX_POINTS) for line in own]
        sizes.append((f"{where}: length, m", lane.length_m, limits.MAX_LANE_M))
        lines += own
        lane_ids |= {*lane.successors, lane.left_neighbor_id or 0, lane.right_neighbor_id or 0}
    sizes.append(("length of all lanes, m", sum(lane.length_m for lane in lanes), limits.MAX_LANES_M))
    most = max(lane_ids, key=abs)
    if abs(most) > limits.MAX_LANE_ID:
        return f"lane id {str(most)[:40]}, expected an integer of 64 bit"
    beyond = (f"{what}: {size:.0f}, expected at most {limit:.0f}" for what, size, limit in sizes if not size <= limit)
    return next(beyond, "") or _extent_breach(lines)


def check_ground(tracks: Sequence[Track], graph: LaneGraph, name: str) -> None:
    """Refuse tracks that do not lie on the ground of the map. Errors: ScenarioError with track and value."""
    ends = np.array(graph.bounds)
    for track in tracks:
        if said := _extent_breach([ends, track.position]):
            raise ScenarioError(f"{name}: track {track.track_id!r} and the map: {said}")


def _extent_breach(lines: Sequence[FloatArray]) -> str:
    points = np.concatenate(lines)
    low, high = points.min(axis=0), points.max(axis=0)
    with np.errstate(over="ignore"):  # of coordinates near the largest double: infinity is too far as well
        (x, y), far = high - low, float(np.abs([low, high]).max())
    if not max(x, y) <= limits.MAX_EXTENT_M:
        return f"spread over {x:.6g} x {y:.6g} m, expected at most {limits.MAX_EXTENT_M:.0f} m each way"
    if far > limits.MAX_COORDINATE_M:
        return f"a coordinate of {far:.6g} m, expected at most {limits.MAX_COORDINATE_M:.0e} m"
    return ""
