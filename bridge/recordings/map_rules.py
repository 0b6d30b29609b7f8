"""The rules on the map of a scenario: what every reader of Argoverse 2 maps demands, and the source's map."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bridge.recordings.rules import Breach
from netconvert.lane_graph import LANE_TYPES

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


def read_map(path: Path) -> tuple[dict[str, Any] | None, list[Breach]]:
    """The document of a map file, None where it is no map, and what is wrong with it."""
    try:
        document = json.loads(path.read_bytes())
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        return None, [("map", f"not JSON ({error})")]
    if not isinstance(document, dict) or not all(
        isinstance(document.get(part), dict) for part in ("drivable_areas", "lane_segments", "pedestrian_crossings")
    ):
        return None, [("map", "expected drivable_areas, lane_segments and pedestrian_crossings")]
    return document, list(_check_map(document))


def _check_map(document: Mapping[str, Any]) -> Iterator[Breach]:
    if not document["drivable_areas"]:
        yield "map", "no drivable area"
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
        yield from _check_points(lane, "centerline", name, least=2)


def _check_points(owner: Mapping[str, Any], field: str, name: str, *, least: int) -> Iterator[Breach]:
    points = owner.get(field)
    if not isinstance(points, list) or len(points) < least:
        have = len(points) if isinstance(points, list) else "none"
        yield "boundary", f"{name}: {field} of {have} points, expected at least {least}"
        return
    for i, point in enumerate(points):
        values = [point.get(axis) for axis in "xyz"] if isinstance(point, dict) else [None]
        if not all(isinstance(value, float | int) and np.isfinite(value) for value in values):
            yield "map", f"{name}: {field}[{i}] is {point}, expected finite x, y and z"
            return


def compare_map(path: Path, document: Mapping[str, Any], source_path: Path) -> Iterator[str]:
    """The map against the source's, byte for byte; only centrelines may have been added."""
    try:
        raw = source_path.read_bytes()
        if path.read_bytes() == raw:
            return
        source = json.loads(raw)
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        yield f"{source_path}: cannot be read ({error})"
        return
    lanes = source.get("lane_segments", {})
    lacking = {key for key, lane in lanes.items() if not lane.get("centerline")}
    if not lacking:
        yield f"not the bytes of {source_path.name}"
        return

    def without_added(lane_segments: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
        return {
            key: {name: value for name, value in lane.items() if name != "centerline" or key not in lacking}
            for key, lane in lane_segments.items()
        }

    ours = {**document, "lane_segments": without_added(document["lane_segments"])}
    if ours != {**source, "lane_segments": without_added(lanes)}:
        yield f"differs from {source_path.name} in more than added centrelines"
