"""The rules on the map of a scenario: what every reader of Argoverse 2 maps demands.

They hold for maps that are read as much as for those that are written: a source that breaks one is refused.
"""

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from pydantic_core import from_json

from bridge.files import read_received
from bridge.recordings.limits import too_large
from netconvert import av2_map
from netconvert.av2_map import Breach
from netconvert.errors import MapError
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
        said = "" if graph is None else too_large(graph)
    if graph is not None and not said and not graph.drivable.area > 0.0:
        said = "drivable areas of 0 m2 in all, expected the ground that can be driven on"
    return (None, [("map", said)]) if said else (graph, breaches)


def lacking_centerlines(document: dict[str, Any]) -> list[Breach]:
    """Lanes without the centreline that recorded maps may lack, and written ones may not."""
    lacking = [key for key, lane in document["lane_segments"].items() if not lane.get("centerline")]
    return [("boundary", f"lane segment {key}: no centerline, expected at least 2 points") for key in lacking]
