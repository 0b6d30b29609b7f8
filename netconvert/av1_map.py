"""Argoverse 1 maps of a whole city: an XML file of nodes and ways, and a raster of the drivable area.

A way is a lane: its centreline, links and tags; booleans are the texts True and False. There are no lane boundaries:
lanes are LANE_WIDTH_M wide, the data set's own convention (argoverse-api, `centerline_to_polygon`: 1.9 m to each side).
A part of a city is cut out as the document of an Argoverse 2 map.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import shapely
from lxml import etree

from netconvert.errors import MapError
from netconvert.geometry import FloatArray

#: Width of every lane, m: the data set's convention.
LANE_WIDTH_M = 3.8
#: Largest distance of a boundary point from the centreline in bends, as a multiple of half the width.
_MITRE = 2.0
#: Limits of what is read: elements of the XML, nodes of a lane, pixels of the raster. Real: 170,000, 12 and 6 million.
MAX_ELEMENTS, MAX_NODES, MAX_PIXELS = 5_000_000, 5_000, 100_000_000
#: Largest coordinate that is read, m.
_MOST_M = 1e7


class CityLane(NamedTuple):
    """One way. centerline: (N, 2) m, city frame, in driving direction; links: its tags as Argoverse 2 has them."""

    centerline: FloatArray
    links: dict[str, Any]


class DrivableRaster(NamedTuple):
    """Drivable area: pixels (H, W) of 1 m, and the transformation from the city to column and row, (3, 3)."""

    drivable: npt.NDArray[np.bool_]
    pixel_se2_city: FloatArray


def read_city_lanes(content: bytes, *, name: str) -> dict[int, CityLane]:
    """The lanes of a vector map by id. name: what messages call the file. Errors: MapError with way and value."""
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False)
    try:
        root = etree.fromstring(content, parser)
    except etree.XMLSyntaxError as error:
        raise MapError(f"{name}: not XML ({str(error)[:200]})") from error
    if root.getroottree().docinfo.internalDTD is not None:
        raise MapError(f"{name}: a document type, expected nodes and ways alone")
    if len(root) > MAX_ELEMENTS:
        raise MapError(f"{name}: {len(root)} elements, expected at most {MAX_ELEMENTS}")
    nodes: dict[int, tuple[float, float]] = {}
    lanes: dict[int, CityLane] = {}
    for element in root:
        if element.tag == "node":
            where = f"{name}: node {element.get('id')!r:.60}"
            x, y = (_read("metres", element.get(axis), f"{where}: {axis}") for axis in "xy")
            nodes[_read("an integer", element.get("id"), where)] = x, y
        elif element.tag == "way":
            lane_id = _read(
                "an integer", element.get("lane_id"), f"{name}: way {element.get('lane_id')!r:.60}: lane_id"
            )
            if lane_id in lanes:
                raise MapError(f"{name}: way {lane_id} appears twice, expected one way an id")
            lanes[lane_id] = _lane(element, nodes, f"{name}: way {lane_id}")
        elif isinstance(element.tag, str):  # comments have none
            raise MapError(f"{name}: element {element.tag!r:.60}, expected node or way")
    if not lanes:
        raise MapError(f"{name}: no way among {len(root)} elements, expected the lanes of a city")
    return lanes


def drivable_raster(pixels: npt.NDArray[Any], se2: npt.NDArray[Any], *, name: str, se2_name: str) -> DrivableRaster:
    """Check the two arrays of a drivable area. name, se2_name: what messages call their files. Errors: MapError."""
    if pixels.ndim != 2 or not 0 < pixels.size <= MAX_PIXELS or pixels.dtype.kind not in "biuf":
        raise MapError(
            f"{name}: pixels of shape {pixels.shape} and type {pixels.dtype}, expected numbers (H, W), at most "
            f"{MAX_PIXELS}"
        )
    if se2.shape != (3, 3) or se2.dtype.kind not in "iuf":
        raise MapError(f"{se2_name}: shape {se2.shape} and type {se2.dtype}, expected numbers (3, 3)")
    rotation = np.asarray(se2[:2, :2], dtype=np.float64)
    if not np.abs(se2).max() <= _MOST_M or not np.allclose(rotation @ rotation.T, np.eye(2), atol=1e-6):
        raise MapError(f"{se2_name}: {se2.tolist()}, expected a rotation and a translation in metres")
    with np.errstate(invalid="ignore"):
        drivable = np.asarray(pixels > 0)
    return DrivableRaster(drivable, np.asarray(se2, dtype=np.float64))


def cut_city(
    lanes: Mapping[int, CityLane], raster: DrivableRaster, *, low: FloatArray, high: FloatArray, name: str
) -> dict[str, Any]:
    """The part of a city from a low to a high corner, (2,) m, as the document of an Argoverse 2 map.

    Lanes that come into the rectangle are in it whole; links to others stay, as in maps of scenes. Errors: MapError
    where there is no lane or no drivable ground.
    """
    kept = {
        lane_id: lane
        for lane_id, lane in sorted(lanes.items())
        if (lane.centerline.min(axis=0) <= high).all() and (lane.centerline.max(axis=0) >= low).all()
    }
    where = f"x {low[0]:.0f} to {high[0]:.0f}, y {low[1]:.0f} to {high[1]:.0f}"
    if not kept:
        raise MapError(f"{name}: no lane within {where}, where the tracks are: expected the map of their city")
    ground = np.vstack([low, high, *(lane.centerline for lane in kept.values())])
    areas = _areas(raster, ground.min(axis=0) - LANE_WIDTH_M, ground.max(axis=0) + LANE_WIDTH_M)
    if not areas:
        raise MapError(f"{name}: no drivable area within {where}, where the tracks are: expected the map of their city")
    outlines = {str(number): {"area_boundary": _xyz(ring), "id": number} for number, ring in enumerate(areas, start=1)}
    segments = {str(lane_id): _segment(lane_id, lane) for lane_id, lane in kept.items()}
    return {"drivable_areas": outlines, "lane_segments": segments, "pedestrian_crossings": {}}


def _lane(way: etree._Element, nodes: Mapping[int, tuple[float, float]], where: str) -> CityLane:
    points = []
    for child in way.iterchildren("nd"):
        node = _read("an integer", child.get("ref"), f"{where}: nd ref")
        if node not in nodes:
            raise MapError(f"{where}: node {node} is not in the file, expected it before the way")
        points.append(nodes[node])
    line = np.array(points, dtype=np.float64).reshape(-1, 2)
    line = line[np.concatenate([[True], np.any(np.diff(line, axis=0) != 0, axis=1)])] if len(line) else line
    if not 2 <= len(line) <= MAX_NODES:
        raise MapError(f"{where}: {len(line)} different nodes, expected 2 to {MAX_NODES}")
    tags = [(child.get("k"), child.get("v")) for child in way.iterchildren("tag")]
    links: dict[str, Any] = {
        f"{link}s": [_read("an integer", value, f"{where}: {link}") for key, value in tags if key == link]
        for link in ("predecessor", "successor")
    }
    for key, (field, kind) in _TAGS.items():
        if key not in dict(tags):
            raise MapError(f"{where}: no tag {key}, expected one")
        links[field] = _read(kind, dict(tags)[key], f"{where}: {key}")
    return CityLane(line, links)


def _segment(lane_id: int, lane: CityLane) -> dict[str, Any]:
    """A lane segment of an Argoverse 2 map. Markings are not told: they may be crossed."""
    left, right = boundaries(lane.centerline)
    lines = {"centerline": lane.centerline, "left_lane_boundary": left, "right_lane_boundary": right}
    known = {"id": lane_id, "lane_type": "VEHICLE", "left_lane_mark_type": "UNKNOWN", "right_lane_mark_type": "UNKNOWN"}
    return dict(sorted({**known, **lane.links, **{name: _xyz(line) for name, line in lines.items()}}.items()))


def boundaries(centerline: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Left and right boundary of a lane of LANE_WIDTH_M, each (N, 2) m, along the bisectors of a centreline (N, 2)."""
    steps = np.diff(centerline, axis=0)
    along = steps / np.hypot(steps[:, 0], steps[:, 1])[:, None]
    normals = np.column_stack([-along[:, 1], along[:, 0]])
    before, after = np.vstack([normals[:1], normals]), np.vstack([normals, normals[-1:]])
    middle = before + after
    length = np.hypot(middle[:, 0], middle[:, 1])
    folds = length < 2.0 / _MITRE  # the lane turns back: the bisector runs away
    direction = np.where(folds[:, None], before, middle / np.maximum(length, 1e-9)[:, None])
    offset = 0.5 * LANE_WIDTH_M * np.where(folds, 1.0, 2.0 / np.maximum(length, 1e-9))[:, None] * direction
    return centerline + offset, centerline - offset


def _areas(raster: DrivableRaster, low: FloatArray, high: FloatArray) -> list[FloatArray]:
    """Outlines (N, 2) m of the drivable pixels within a rectangle, without holes: areas are cut apart at theirs."""
    rotation, translation = raster.pixel_se2_city[:2, :2], raster.pixel_se2_city[:2, 2]
    corners = np.array([[low[0], low[1]], [low[0], high[1]], [high[0], low[1]], [high[0], high[1]]])
    pixels = corners @ rotation.T + translation
    height, width = raster.drivable.shape
    (first_x, first_y), (last_x, last_y) = np.floor(pixels.min(axis=0)), np.ceil(pixels.max(axis=0))
    left, bottom = max(0, int(first_x)), max(0, int(first_y))
    within = raster.drivable[bottom : min(height, int(last_y) + 1), left : min(width, int(last_x) + 1)]
    row, edge = np.nonzero(np.diff(within.astype(np.int8), axis=1, prepend=0, append=0))  # where runs begin and end
    row, begin, end = row[::2] + bottom, edge[::2] + left, edge[1::2] + left
    rings = []
    for part in shapely.get_parts(shapely.union_all(shapely.box(begin, row, end, row + 1))):
        rings += [np.asarray(piece.exterior.coords)[:-1] for piece in _without_holes(part)]
    return [(ring - translation) @ rotation for ring in rings]


def _without_holes(area: shapely.Polygon) -> list[shapely.Polygon]:
    """The pieces of a polygon that is cut along a vertical line through each of its holes."""
    todo, done = [area], []
    while todo:
        piece = todo.pop()
        if not piece.interiors:
            done.append(piece)
            continue
        x = math.floor(shapely.Polygon(piece.interiors[0]).centroid.x) + 0.5
        left, low, right, high = piece.bounds
        for side in (shapely.box(left, low, x, high), shapely.box(x, low, right, high)):
            cut = shapely.get_parts(piece.intersection(side))
            todo += [part for part in cut if part.geom_type == "Polygon" and part.area > 0]
    return sorted(done, key=lambda piece: piece.bounds)


def _xyz(points: FloatArray) -> list[dict[str, float]]:
    return [{"x": round(x, 6), "y": round(y, 6), "z": 0.0} for x, y in points.tolist()]


def _metres(text: str) -> float:
    if not abs(value := float(text)) <= _MOST_M:
        raise ValueError
    return value


#: How a text is read, by what is expected of it.
_READ: Mapping[str, Callable[[str], Any]] = {
    "an integer": int,
    "an integer or None": lambda text: None if text == "None" else int(text),
    "metres": _metres,
    "True or False": {"True": True, "False": False}.__getitem__,
}
#: Tags that a way has once, their fields in Argoverse 2, and what they are.
_TAGS = {
    "is_intersection": ("is_intersection", "True or False"),
    "l_neighbor_id": ("left_neighbor_id", "an integer or None"),
    "r_neighbor_id": ("right_neighbor_id", "an integer or None"),
}


def _read(wanted: str, text: str | None, where: str) -> Any:  # noqa: ANN401  # of that kind
    try:
        return _READ[wanted](text or "")
    except (ValueError, KeyError):
        raise MapError(f"{where}: {text!r:.60}, expected {wanted}") from None
