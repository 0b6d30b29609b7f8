"""Cell grids as SUMO networks, written directly: one edge per row of facing cells, one lane per cell.

The netconvert program of SUMO is not used: it trims lanes at junctions, while here every lane keeps its AV2 centreline.
It keeps them, as netedit does, when it saves the net of a grid that is made for it (`CellGrid.saved_within_m`): lanes
have shapes of their own there, edges lengths, and each junction is a short line beside its lanes, because lanes are
trimmed where they touch their junction:

      ------------>x----->
      ------------>x----->     x: where lanes end and begin
                   |           |: the junction
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import shapely

from netconvert.cells import Cell, CellGrid
from netconvert.geometry import FloatArray, cut_at
from netconvert.lane_graph import SIDES, LaneGraph, TurnType, joined

#: Speed limit of every lane, m/s (45 mph), unless drivers desire more; the maps have none.
SPEED_LIMIT_MPS = 20.0
#: Speed limit of every lane in nets for traffic of SUMO's own, which drives as fast as it may, m/s (50 km/h).
WHOLE_LIMIT_MPS = 13.89
#: Classes that may use a lane, by lane type; None is every class: recorded and inserted vehicles are on bus lanes too.
ALLOWED_CLASSES: dict[str, str | None] = {"VEHICLE": None, "BUS": None, "BIKE": "bicycle"}
#: Vehicle class that may cross a marking that forbids it. SUMO needs at least one class; it draws such a line solid.
_MAY_ALWAYS_CROSS = "emergency"
#: The net format that SUMO 1.28 writes. Without it a broken reference crashes SUMO instead of raising.
NET_VERSION = "1.20"
#: Distance to a border of its cell within which a vertex of a lane is left out of the cell's shape, m.
_MIN_STEP_M = 1e-3
#: _MIN_STEP_M of a net that may be saved by netconvert, which loses the ends of lanes that have points within 0.01 m.
_MIN_SAVED_STEP_M = 0.015
#: Length up to which cells have shapes finer than a millimetre, m.
_FINER_M = 0.05
#: Distance of a junction from the end of a lane where netconvert may save the net, m; directions, the freest is taken.
_BESIDE_M, _DIRECTIONS = 0.3, 16
#: Length by which netconvert extends lanes, m.
_SEEN_M = 100.0
_DIRECTION = {TurnType.STRAIGHT: "s", TurnType.LEFT: "l", TurnType.RIGHT: "r"}


class CityOrigin(NamedTuple):
    """Origin of a city frame: UTM zone on the northern half, easting and northing, m."""

    zone: int
    easting_m: float
    northing_m: float

    @property
    def projection(self) -> str:
        """As SUMO and PROJ write it."""
        return f"+proj=utm +zone={self.zone} +ellps=WGS84 +datum=WGS84 +units=m +no_defs"


#: Origins by the names of cities in scenes: those of av2 (`av2.geometry.utm`), projected once; a test compares them.
CITY_ORIGINS = {
    "austin": CityOrigin(14, 621150.0275, 3349889.9996),
    "dearborn": CityOrigin(17, 320669.9346, 4685369.9988),
    "miami": CityOrigin(17, 580560.0088, 2850959.9999),
    "palo-alto": CityOrigin(10, 576480.0006, 4141379.9353),
    "pittsburgh": CityOrigin(17, 583710.0070, 4477259.9998),
    "washington-dc": CityOrigin(18, 323459.9997, 4306469.9870),
}


def speed_limit_mps(fastest_mps: float) -> float:
    """Speed limit of lanes, m/s, on which the fastest desired speed is fastest_mps: no driver is held below its own."""
    return max(SPEED_LIMIT_MPS, fastest_mps)


def net_bytes(
    grid: CellGrid, *, origin: CityOrigin | None = None, fastest_mps: float = SPEED_LIMIT_MPS,
    signals: Mapping[int, tuple[float, Sequence[tuple[float, str]]]] | None = None,
) -> bytes:  # fmt: skip
    """The net.xml of a grid, in city coordinates. Equal grids give equal bytes.

    origin: of the city frame; with it the net has a geo-reference, so that it lies on a map. fastest_mps: see
    `speed_limit_mps`. signals: by lane that begins at a stop line, from when its signal shows which phases, s and
    SUMO's letter, again and again.
    """
    signals, rows = signals or {}, tuple(grid.rows())
    edge_ids = [grid.edge_id(row[0]) for row in rows]
    place = {cell: (edge, index) for edge, row in enumerate(rows) for index, cell in enumerate(row)}
    # longitudinal and inter-lane links: from edge, from lane, to edge, to lane, direction
    links = [
        (edge, index, *place[target], "s" if target.index else _DIRECTION[grid.graph.lanes[target.lane_id].turn])
        for edge, row in enumerate(rows)
        for index, cell in enumerate(row)
        for target in grid.following(cell)
    ]
    # The end of an edge, 2 k + 1, and the starts of all edges that it leads to, 2 k, are one junction.
    of = joined(2 * len(rows), ((2 * to_edge, 2 * from_edge + 1) for from_edge, _, to_edge, _, _ in links))
    known: dict[int, str] = {}
    names = [known.setdefault(junction, f"J{len(known)}") for junction in of]

    editable = grid.saved_within_m is not None
    text = ["<?xml version='1.0' encoding='UTF-8'?>", f'<net version="{NET_VERSION}">', location(grid.graph, origin)]
    limit_mps, custom, templates = speed_limit_mps(fastest_mps), ' customShape="1"' if editable else "", {}
    for lane_id, lane in grid.graph.lanes.items():  # what all cells of a lane have in common
        allowed, length_m = ALLOWED_CLASSES[lane.lane_type], lane.length_m / grid.count(lane_id)
        classes = "" if allowed is None else f' allow="{allowed}"'
        own = f'{classes} speed="{limit_mps:g}" length="{length_m:.6f}" width="{lane.width_m:.2f}"{custom}'
        templates[lane_id] = own
    step_m = _MIN_SAVED_STEP_M if editable else _MIN_STEP_M
    lines = {
        lane_id: cut_at(lane.path.points, lane.path.s, grid.edges_m[lane_id], grid.borders[lane_id], farther_m=step_m)
        for lane_id, lane in grid.graph.lanes.items()
    }
    for edge, (edge_id, row) in enumerate(zip(edge_ids, rows, strict=True)):
        ends = f'from="{names[2 * edge]}" to="{names[2 * edge + 1]}"'
        # of the lanes, on which SUMO drives; netconvert has one for all of them
        lengths = [grid.length_m(cell) for cell in row]
        length = f' length="{(min(lengths) + max(lengths)) / 2.0:.6f}"' if editable else ""
        text.append(f'  <edge id="{edge_id}" {ends} priority="0"{length}>')
        for index, (lane_id, cell_index) in enumerate(row):
            beside = zip(SIDES[::-1], (index > 0, index + 1 < len(row)), strict=True)
            closed = (side for side, there in beside if there and not grid.graph.may_change(lane_id, side))
            crossing = "".join(f' change{side.capitalize()}="{_MAY_ALWAYS_CROSS}"' for side in closed)
            line = shape(lines[lane_id][cell_index], digits=3 if grid.edges_m[lane_id][1] > _FINER_M else 6)
            text.append(
                f'    <lane id="{edge_id}_{index}" index="{index}"{templates[lane_id]} shape="{line}"{crossing}>'
                f'\n      <param key="av2.lane_segment_id" value="{lane_id}"/>\n    </lane>'
            )
        text.append("  </edge>")
    text += _junctions(rows, lines, edge_ids, names, editable=editable)
    for lane_id, (since_s, phases) in signals.items():
        shown = "".join(f'<phase duration="{seconds:g}" state="{state}"/>' for seconds, state in phases)
        text.append(f'  <tlLogic id="S{lane_id}" type="static" programID="0" offset="{since_s:g}">{shown}</tlLogic>')
    for from_edge, from_lane, to_edge, to_lane, direction in links:
        ends = f'from="{edge_ids[from_edge]}" to="{edge_ids[to_edge]}" fromLane="{from_lane}" toLane="{to_lane}"'
        lane_id, cell_index = rows[to_edge][to_lane]
        held = f'tl="S{lane_id}" linkIndex="0" state="o"' if cell_index == 0 and lane_id in signals else 'state="M"'
        text.append(f'  <connection {ends} dir="{direction}" {held}/>')
    return "\n".join([*text, "</net>", ""]).encode()


def _junctions(
    rows: Sequence[tuple[Cell, ...]], lines: Mapping[int, Sequence[FloatArray]], edge_ids: Sequence[str],
    names: Sequence[str], *, editable: bool,
) -> list[str]:  # fmt: skip
    """Each junction, in the middle of the ends of its lanes. names: at start (2 k) and end (2 k + 1) of each edge k."""
    lanes: dict[str, list[tuple[FloatArray, int]]] = {name: [] for name in names}
    incoming: dict[str, list[str]] = {name: [] for name in names}
    for edge, row in enumerate(rows):
        start, end = names[2 * edge : 2 * edge + 2]
        for index, (lane_id, cell_index) in enumerate(row):
            lanes[start].append((lines[lane_id][cell_index], 0))
            lanes[end].append((lines[lane_id][cell_index], -1))
            incoming[end].append(f"{edge_ids[edge]}_{index}")
    text = []
    for name, touching in lanes.items():
        ends = [line[at].tolist() for line, at in touching]
        place = np.array([sum(x for x, _ in ends), sum(y for _, y in ends)]) / len(ends)
        beside = junction_beside(np.array(ends[0]), [line for line, _ in touching]) if editable else None
        known = junction(name, place, incoming=incoming[name], line=beside)
        shown = " ".join([f'{key}="{value}"' for key, value in known.items()])
        text.append(f"  <junction {shown}/>")
    return text


def junction_beside(end: FloatArray, lanes: Sequence[FloatArray]) -> FloatArray:
    """Shape of a junction that none of its lanes touches: a short line (2, 2) m beside the end of one of them.

    lanes: (N, 2) m, all that end or begin in the junction. netconvert looks for it on their straight extensions too.
    """
    seen = []
    for lane in lanes:
        first, last = lane[0] - lane[1], lane[-1] - lane[-2]
        before = lane[0] + first * (_SEEN_M / max(np.hypot(*first), 1e-9))
        after = lane[-1] + last * (_SEEN_M / max(np.hypot(*last), 1e-9))
        seen.append(shapely.LineString(np.vstack([before, lane, after])))
    angle = np.arange(_DIRECTIONS) * (2.0 * np.pi / _DIRECTIONS)
    way = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    clear = shapely.distance(shapely.points(end + _BESIDE_M * way)[:, None], seen).min(axis=1)
    return np.asarray(end + np.array([[_BESIDE_M], [_BESIDE_M + 0.02]]) * way[np.argmax(clear)])


def junction(name: str, place: FloatArray, *, incoming: Sequence[str], line: FloatArray | None) -> dict[str, str]:
    """Attributes of a junction at a place, m; incoming: ids of the lanes that end there; line: its shape, (N, 2) m."""
    known = {"id": name, "type": "unregulated", "x": f"{place[0]:.3f}", "y": f"{place[1]:.3f}"}
    known |= {"incLanes": " ".join(incoming), "intLanes": ""}
    return known if line is None else {**known, "shape": shape(line, digits=3), "customShape": "1"}


def location(graph: LaneGraph, origin: CityOrigin | None) -> str:
    """Where a net of the graph lies: element `location` of SUMO's files."""
    (left, bottom), (right, top) = graph.bounds
    boundary = f"{left:.2f},{bottom:.2f},{right:.2f},{top:.2f}"
    if origin is None:
        offset, original, projection = "0.00,0.00", boundary, "!"
    else:  # SUMO: net = projected + offset; the original boundary is in the projection, before the offset
        east, north, projection = origin.easting_m, origin.northing_m, origin.projection
        offset = f"{-east:.4f},{-north:.4f}"
        original = f"{left + east:.2f},{bottom + north:.2f},{right + east:.2f},{top + north:.2f}"
    places = f'netOffset="{offset}" convBoundary="{boundary}" origBoundary="{original}"'
    return f'  <location {places} projParameter="{projection}"/>'


def shape(points: FloatArray, *, digits: int = 2) -> str:
    """Points (N, 2) m as SUMO writes them."""
    return " ".join([f"%.{digits}f,%.{digits}f" % (x, y) for x, y in points.tolist()])  # twice as fast as an f-string
