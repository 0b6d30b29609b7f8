"""The rules on the map of a scenario: what every reader of Argoverse 2 maps demands.

They hold for maps that are read as much as for those that are written: a source that breaks one is refused.
"""

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from pydantic_core import from_json

from bridge.files import read_received
from bridge.recordings.limits import check_map_size
from netconvert import av2_map
from netconvert.av2_map import Breach
from netconvert.errors import MapError
from netconvert.lane_graph import LaneGraph


def read_source_map(path: Path) -> LaneGraph:
    """The lane graph of a map file that keeps the rules; only centrelines may be missing. Errors: MapError."""
    try:
        return _known(read_received(path, MapError, wanted="an Argoverse 2 map"))
    except (ValueError, MapError):
        return graph_of(_decoded(path), name=str(path))  # says what is wrong with which file


@lru_cache(maxsize=2)
def _known(content: bytes) -> LaneGraph:
    """The lane graph of a map file: scenes made from one share its map, and reading it takes longest."""
    return graph_of(from_json(content), name="")


def read_document(path: Path) -> dict[str, Any]:
    """The document of a map file that has the parts of a map. Errors: MapError."""
    document = _decoded(path)
    said = av2_map.lacks_a_part(document)
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
    if not graph.drivable.area > 0.0:
        raise MapError(f"{name}: drivable areas of 0 m2 in all, expected the ground that can be driven on")
    return graph


def read_map(path: Path) -> tuple[dict[str, Any] | None, list[Breach]]:
    """The document of a map file, None where it is no map, and what is wrong with it."""
    try:
        document = read_document(path)
    except MapError as error:
        return None, [("map", str(error))]
    with np.errstate(over="ignore", invalid="ignore"):
        breaches = av2_map.read_map(document)[1]
    lanes = document["lane_segments"].items()
    lacking = [f"lane segment {key}: no centerline" for key, lane in lanes if not lane.get("centerline")]
    return document, breaches + [("boundary", f"{said}, expected at least 2 points") for said in lacking]


def _decoded(path: Path) -> Any:  # noqa: ANN401  # whatever JSON holds
    try:
        return from_json(read_received(path, MapError, wanted="an Argoverse 2 map"))
    except ValueError as error:
        raise MapError(f"{path}: not JSON ({error}), expected an Argoverse 2 map") from error
