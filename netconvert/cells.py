"""Lane gridification: every lane cut into cells of at most 4 m, and the links between cells.

Same-direction neighbours form a row of lanes and are cut into equally many cells, so that cell j faces cell j. Facing
cells are one SUMO edge, each of them one lane of it:

      lane 12   | 0 | 1 | 2 | 3 |      edge 11#2 = cells (11, 2) and (12, 2)
      lane 11   | 0 | 1 | 2 | 3 |      SUMO lanes 11#2_0 (right) and 11#2_1 (left)
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import shapely

from netconvert.geometry import FloatArray, arc_length, cut_at
from netconvert.lane_graph import SIDES, DroppedLink, LaneGraph, LaneSegment, Side

#: Tolerance of the length of a cell in a net that an editor of SUMO's has saved, m.
SAVED_WITHIN_M = 0.2
#: Least length of a cell to which cells are shortened to be equally long, m.
SHORTEST_EQUAL_M = 0.25

REASON_LENGTHS = "the lanes differ too much in length for one edge"
REASON_DEAD_END = "a lane of one cell ends and must not be left"


class Cell(NamedTuple):
    """Cell number `index` of a lane segment, counted from its start."""

    lane_id: int
    index: int  # type: ignore[assignment]  # hides tuple.index, which a cell has no use for


@dataclass(frozen=True, eq=False)
class CellGrid:
    """The cells of a lane graph. Made by build_cell_grid."""

    graph: LaneGraph
    cells: tuple[Cell, ...]
    """By lane id, then index."""
    centers: FloatArray
    """(C, 2) m, the middle of each cell's centreline, in the order of cells."""
    lost_links: tuple[DroppedLink, ...]
    """Links of the source map that the grid does not have."""
    saved_within_m: float | None
    """How far lengths of cells may be off once an editor of SUMO's has saved the net; None: it is not to be edited."""
    edges_m: Mapping[int, FloatArray] = field(repr=False)
    """Arc lengths at which the cells of each lane begin and end; (N + 1,) m."""
    borders: Mapping[int, FloatArray] = field(repr=False)
    """Points of the centreline at which the cells of each lane begin and end; (N + 1, 2) m."""
    _rows: dict[int, tuple[tuple[int, ...], ...]] = field(repr=False)
    """For each lane and cell index, the lanes with cells that face each other, from the right."""

    def count(self, lane_id: int) -> int:
        """Number of cells of a lane: N_l of the paper, at least."""
        return len(self._rows[lane_id])

    def cell_at(self, lane_id: int, s: float) -> Cell:
        """The cell that holds arc length s of a lane; the first or last one where s lies before or past the lane."""
        count, length_m = len(self._rows[lane_id]), float(self.edges_m[lane_id][-1])
        return Cell(lane_id, min(max(int(s / length_m * count), 0), count - 1))

    def length_m(self, cell: Cell) -> float:
        """Length of the cell's centreline."""
        return float(self.edges_m[cell.lane_id][-1]) / len(self._rows[cell.lane_id])

    def longitudinal(self, cell: Cell) -> Cell | None:
        """The next cell of the same lane, None at its end."""
        return Cell(cell.lane_id, cell.index + 1) if cell.index + 1 < len(self._rows[cell.lane_id]) else None

    def lateral(self, cell: Cell, side: Side) -> Cell | None:
        """The facing cell of the same-direction neighbour, None where there is none or where the row is split."""
        row = self._rows[cell.lane_id][cell.index]
        at = row.index(cell.lane_id) + (1 if side == "left" else -1)
        return Cell(row[at], cell.index) if 0 <= at < len(row) else None

    def following(self, cell: Cell) -> tuple[Cell, ...]:
        """The next cell of the lane; at its end the first ones of its successors (merges, splits)."""
        ahead = self.longitudinal(cell)
        return (ahead,) if ahead else tuple(Cell(target, 0) for target in self.graph.successors(cell.lane_id))

    def edge_id(self, cell: Cell) -> str:
        """SUMO edge that holds the cell."""
        return f"{self._rows[cell.lane_id][cell.index][0]}#{cell.index}"

    def lane_index(self, cell: Cell) -> int:
        """Index of the cell's SUMO lane in its edge, 0 at the right."""
        return self._rows[cell.lane_id][cell.index].index(cell.lane_id)

    def sumo_lane_id(self, cell: Cell) -> str:
        """SUMO lane that is the cell."""
        return f"{self.edge_id(cell)}_{self.lane_index(cell)}"

    def rows(self) -> Iterator[tuple[Cell, ...]]:
        """Every row of facing cells once, from the right, ordered by its rightmost lane and index."""
        for lane_id, rows in self._rows.items():
            for index, row in enumerate(rows):
                if row[0] == lane_id:
                    yield tuple(Cell(member, index) for member in row)

    @cached_property
    def index_of(self) -> Mapping[Cell, int]:
        """Position of each cell in cells and centers."""
        return {cell: index for index, cell in enumerate(self.cells)}

    @cached_property
    def cell_of_sumo_lane(self) -> Mapping[str, Cell]:
        """The cell of each SUMO lane."""
        return {self.sumo_lane_id(cell): cell for cell in self.cells}

    @cached_property
    def polygons(self) -> npt.NDArray[np.object_]:
        """Ground of each cell, (C,) polygons in the order of cells, between equal fractions of the boundaries."""
        rings = [
            np.concatenate([right, left[::-1]])
            for lane_id, lane in self.graph.lanes.items()
            for left, right in zip(*(_cut(side, self.count(lane_id)) for side in lane.sides), strict=True)
        ]
        owner = np.repeat(np.arange(len(rings)), [len(ring) for ring in rings])
        polygons: npt.NDArray[np.object_] = shapely.polygons(shapely.linearrings(np.concatenate(rings), indices=owner))
        invalid = ~shapely.is_valid(polygons)
        if invalid.any():
            polygons[invalid] = shapely.buffer(shapely.make_valid(polygons[invalid]), 0.0)
        return polygons


def build_cell_grid(
    graph: LaneGraph, *, cell_m: float = 4.0, max_skew_m: float = 6.0, saved_within_m: float | None = None
) -> CellGrid:
    """Cut every lane into cells of at most cell_m: N_l = ceil(L_l / cell_m), the maximum over a row of neighbours.

    Facing cells with middles more than max_skew_m apart along the road are not linked: the row is split there.

    saved_within_m: for a net that netconvert or netedit may save. They give all lanes of an edge one length, so that
    rows get as many cells as keep every length within saved_within_m; lanes too different for that are split apart.
    They open a lane that ends and must not be left, so that its last cell is in no row.
    """
    rows: dict[int, tuple[tuple[int, ...], ...]] = {}
    edges_m: dict[int, FloatArray] = {}
    borders: dict[int, FloatArray] = {}
    centers: dict[int, FloatArray] = {}
    lost = list(graph.dropped)
    for members in graph.rows():
        lanes = [graph.lanes[lane_id] for lane_id in members]
        count, apart_m = _cell_count(lanes, cell_m, saved_within_m)
        for lane in lanes:
            halves_m = np.arange(2 * count + 1, dtype=np.float64) * (lane.length_m / (2 * count))
            halves_m[-1] = lane.length_m
            halves = lane.path.point(halves_m)
            edges_m[lane.lane_id], borders[lane.lane_id] = halves_m[::2], halves[::2]
            centers[lane.lane_id] = halves[1::2]
        split = np.zeros((len(lanes), count), dtype=np.bool_)
        reasons = [""] * len(lanes)
        for at in range(1, len(lanes)):
            right, left = lanes[at - 1], lanes[at]
            # distance along the road between facing cells' middles
            heading = right.path.heading((np.arange(count) + 0.5) * (right.length_m / count))
            offset = centers[left.lane_id] - centers[right.lane_id]
            skew = np.abs(offset[:, 0] * np.cos(heading) + offset[:, 1] * np.sin(heading))
            split[at] = skew > max_skew_m
            reasons[at] = f"facing cells are skewed by {skew.min():.1f} m or more, {max_skew_m} m is allowed"
            if apart_m is not None and abs(right.length_m - left.length_m) > count * apart_m:
                split[at], reasons[at] = True, REASON_LENGTHS
        if saved_within_m is not None:
            reasons = [reasons[at] if split[at].all() else REASON_DEAD_END for at in range(len(lanes))]
            _part_dead_ends(graph, members, split[:, -1])
        for at in np.flatnonzero(split[1:].all(axis=1)).tolist():
            right_id, left_id = members[at : at + 2]
            lost.append(DroppedLink("left_neighbor", right_id, left_id, reasons[at + 1]))
            lost.append(DroppedLink("right_neighbor", left_id, right_id, reasons[at + 1]))
        by_index = [_split(members, split[:, index]) for index in range(count)]
        for lane_id in members:
            rows[lane_id] = tuple(next(part for part in parts if lane_id in part) for parts in by_index)
    return CellGrid(
        graph=graph,
        saved_within_m=saved_within_m,
        cells=tuple(Cell(lane_id, index) for lane_id in graph.lanes for index in range(len(rows[lane_id]))),
        centers=np.concatenate([centers[lane_id] for lane_id in graph.lanes]),
        lost_links=tuple(lost),
        edges_m=edges_m,
        borders=borders,
        _rows={lane_id: rows[lane_id] for lane_id in graph.lanes},
    )


def _cell_count(lanes: Sequence[LaneSegment], cell_m: float, saved_within_m: float | None) -> tuple[int, float | None]:
    """Number of cells of a row; by how much neighbours may differ, m, where more cells do not make lanes equal."""
    lengths = [lane.length_m for lane in lanes]
    count = max(1, *(math.ceil(length / cell_m - 1e-9) for length in lengths))
    if saved_within_m is None or len(lanes) == 1:
        return count, None
    range_m = 2.0 * saved_within_m - 0.01  # lengths are saved to the centimetre
    equal = math.ceil((max(lengths) - min(lengths)) / range_m - 1e-9)
    if equal > count and min(lengths) < equal * SHORTEST_EQUAL_M:
        return count, range_m / (len(lanes) - 1)
    return max(count, equal), None


def _part_dead_ends(graph: LaneGraph, members: tuple[int, ...], split: npt.NDArray[np.bool_]) -> None:
    """Split off, in the last cells of a row, each lane that ends and must not be left while others go on."""
    for lane_id in members * len(members):  # the lane that is split off may have been the way out of another one
        part = next(part for part in _split(members, split) if lane_id in part)
        outer = zip(SIDES, (part[-1], part[0]), strict=True)
        may_leave = any(lane_id != last and graph.may_change(lane_id, side) for side, last in outer)
        if not may_leave and not graph.successors(lane_id) and any(graph.successors(other) for other in part):
            at = members.index(lane_id)
            split[at : at + 2] = True


def _split(members: tuple[int, ...], split: npt.NDArray[np.bool_]) -> list[tuple[int, ...]]:
    """Parts of a row, cut to the right of each member where split is true."""
    borders = [0, *np.flatnonzero(split).tolist(), len(members)]
    return [members[start:end] for start, end in pairwise(borders) if end > start]


def _cut(points: FloatArray, count: int) -> list[FloatArray]:
    """Pieces of equal length of a polyline, each (M, 2) m."""
    s = arc_length(points)
    at = np.linspace(0.0, s[-1], count + 1)
    return cut_at(points, s, at, np.column_stack([np.interp(at, s, points[:, 0]), np.interp(at, s, points[:, 1])]))
