"""Cell grids as SUMO networks, written directly: one edge per row of facing cells, one lane per cell.

The netconvert program of SUMO is not used: it trims lanes at junctions, while here every lane keeps its AV2 centreline.
"""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from lxml import etree

from netconvert.cells import Cell, CellGrid
from netconvert.errors import NetError
from netconvert.geometry import FloatArray
from netconvert.lane_graph import LaneSegment, TurnType

#: Speed limit of every lane, m/s (45 mph); the maps have none.
SPEED_LIMIT_MPS = 20.0
#: Classes that may use a lane, by lane type; None is every class.
ALLOWED_CLASSES: dict[str, str | None] = {"VEHICLE": None, "BUS": None, "BIKE": "bicycle"}
#: Points of a lane closer than this to a border of its cell are left out of the shape.
_MIN_STEP_M = 1e-3
_DIRECTION = {TurnType.STRAIGHT: "s", TurnType.LEFT: "l", TurnType.RIGHT: "r"}


def net_bytes(grid: CellGrid, *, speed_limit_mps: float = SPEED_LIMIT_MPS) -> bytes:
    """The net.xml of a grid, in city coordinates. Equal grids give equal bytes."""
    lanes = grid.graph.lanes
    net = etree.Element("net", {"version": "1.20"})
    junctions = _Junctions(grid)
    etree.SubElement(net, "location", _location(grid))
    speed = f"{speed_limit_mps:g}"
    shapes = {lane_id: _cell_shapes(lane, grid.edges_s(lane_id)) for lane_id, lane in lanes.items()}
    lengths = {lane_id: f"{lane.length_m / grid.count(lane_id):.6f}" for lane_id, lane in lanes.items()}
    links: list[dict[str, str]] = []
    for row in grid.rows():
        edge_id = grid.edge_id(row[0])
        start, end = junctions.ends(edge_id)
        edge = etree.SubElement(net, "edge", {"id": edge_id, "from": start, "to": end, "priority": "0"})
        for index, cell in enumerate(row):
            lane = lanes[cell.lane_id]
            attributes = {"id": f"{edge_id}_{index}", "index": str(index)}
            allowed = ALLOWED_CLASSES[lane.lane_type]
            if allowed is not None:
                attributes["allow"] = allowed
            attributes["speed"] = speed
            attributes["length"] = lengths[cell.lane_id]
            attributes["width"] = f"{lane.width_m:.2f}"
            attributes["shape"] = shapes[cell.lane_id][cell.index]
            element = etree.SubElement(edge, "lane", attributes)
            etree.SubElement(element, "param", {"key": "av2.lane_segment_id", "value": str(cell.lane_id)})
            for target, direction in _links(grid, cell):
                links.append(
                    {
                        "from": edge_id,
                        "to": grid.edge_id(target),
                        "fromLane": str(index),
                        "toLane": str(grid.lane_index(target)),
                        "dir": direction,
                        "state": "M",
                    }
                )
    for attributes in junctions.elements():
        etree.SubElement(net, "junction", attributes)
    for attributes in links:
        etree.SubElement(net, "connection", attributes)
    content: bytes = etree.tostring(net, xml_declaration=True, encoding="UTF-8", pretty_print=True)
    return content


def write_net(grid: CellGrid, path: Path | str) -> None:
    """Write the net.xml of a grid. NetError if the file cannot be written."""
    try:
        Path(path).write_bytes(net_bytes(grid))
    except OSError as error:
        raise NetError(f"{path}: cannot write the net: {error.strerror}") from error


def _links(grid: CellGrid, cell: Cell) -> Iterable[tuple[Cell, str]]:
    """Cells that follow a cell, and the direction of the way there."""
    following = grid.longitudinal(cell)
    if following is not None:
        return ((following, "s"),)
    return ((target, _DIRECTION[grid.graph.lanes[target.lane_id].turn]) for target in grid.inter_lane(cell))


def _location(grid: CellGrid) -> dict[str, str]:
    points = np.concatenate([lane.centerline for lane in grid.graph.lanes.values()])
    (left, bottom), (right, top) = points.min(axis=0), points.max(axis=0)
    boundary = f"{left:.2f},{bottom:.2f},{right:.2f},{top:.2f}"
    return {"netOffset": "0.00,0.00", "convBoundary": boundary, "origBoundary": boundary, "projParameter": "!"}


def _cell_shapes(lane: LaneSegment, edges_s: FloatArray) -> list[str]:
    """The centreline of each cell as SUMO writes shapes."""
    digits = 3 if edges_s[1] > 0.05 else 6
    vertices = _coordinates(lane.path.points, digits)
    borders = _coordinates(lane.path.point(edges_s), digits)
    start = np.searchsorted(lane.path.s, edges_s[:-1] + _MIN_STEP_M, side="right").tolist()
    stop = np.searchsorted(lane.path.s, edges_s[1:] - _MIN_STEP_M, side="left").tolist()
    return [" ".join([borders[k], *vertices[start[k] : stop[k]], borders[k + 1]]) for k in range(len(edges_s) - 1)]


def _coordinates(points: FloatArray, digits: int) -> list[str]:
    return [f"{x:.{digits}f},{y:.{digits}f}" for x, y in points.tolist()]


class _Junctions:
    """Junctions where edges meet: the end of an edge and the starts of all edges that it leads to are one."""

    def __init__(self, grid: CellGrid) -> None:
        self._parent: dict[tuple[str, str], tuple[str, str]] = {}
        self._points: dict[tuple[str, str], list[FloatArray]] = {}
        self._incoming: dict[tuple[str, str], list[str]] = {}
        for row in grid.rows():
            edge_id = grid.edge_id(row[0])
            for side in ("start", "end"):
                self._parent.setdefault((edge_id, side), (edge_id, side))
            for cell in row:
                for target, _ in _links(grid, cell):
                    self._join((edge_id, "end"), (grid.edge_id(target), "start"))
        self._names: dict[tuple[str, str], str] = {}
        for row in grid.rows():
            edge_id = grid.edge_id(row[0])
            for side in ("start", "end"):
                root = self._root((edge_id, side))
                self._names.setdefault(root, f"J{len(self._names)}")
            for index, cell in enumerate(row):
                ends = grid.graph.lanes[cell.lane_id].path.point(
                    grid.edges_s(cell.lane_id)[cell.index : cell.index + 2]
                )
                self._points.setdefault(self._root((edge_id, "start")), []).append(ends[0])
                self._points.setdefault(self._root((edge_id, "end")), []).append(ends[1])
                self._incoming.setdefault(self._root((edge_id, "end")), []).append(f"{edge_id}_{index}")

    def ends(self, edge_id: str) -> tuple[str, str]:
        """Junctions at the start and the end of an edge."""
        return self._names[self._root((edge_id, "start"))], self._names[self._root((edge_id, "end"))]

    def elements(self) -> Iterable[dict[str, str]]:
        """Attributes of each junction."""
        for root, name in self._names.items():
            x, y = np.mean(self._points[root], axis=0).tolist()
            yield {
                "id": name,
                "type": "unregulated",
                "x": f"{x:.3f}",
                "y": f"{y:.3f}",
                "incLanes": " ".join(self._incoming.get(root, [])),
                "intLanes": "",
            }

    def _root(self, node: tuple[str, str]) -> tuple[str, str]:
        while self._parent[node] != node:
            self._parent[node] = self._parent[self._parent[node]]
            node = self._parent[node]
        return node

    def _join(self, a: tuple[str, str], b: tuple[str, str]) -> None:
        self._parent.setdefault(a, a)
        self._parent.setdefault(b, b)
        self._parent[self._root(b)] = self._root(a)
