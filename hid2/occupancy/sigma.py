"""Occupancy sigma of the cells (paper, Lane Gridification and Occupancy): 0 free, 1 original, 2 generated."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from numba import njit

from hid2.agents import FloatArray
from hid2.kernels.boxes import overlap
from hid2.occupancy.traffic import Traffic
from netconvert.cells import CellGrid

#: Of a box's width: cells that it only grazes are not taken.
UNDER_SHARE: Final = 0.8
FREE: Final = 0
ORIGINAL: Final = 1
GENERATED: Final = 2

#: A lane agrees with a vehicle whose heading is within this angle of its own, rad.
AGREES_RAD: Final = np.pi / 3


@dataclass(frozen=True, eq=False, slots=True)
class CellBoxes:
    """Cells as oriented boxes, in the order of the grid: center (C, 2) m, heading (C,) rad, length and width (C,) m."""

    center: FloatArray
    heading: FloatArray
    length_m: FloatArray
    width_m: FloatArray


def cell_boxes(grid: CellGrid) -> CellBoxes:
    """Boxes of all cells: chord of the stretch of centreline, and the lane's width."""
    lanes = grid.graph.lanes
    borders = [grid.borders(lane_id) for lane_id in lanes]
    start, end = np.concatenate([b[:-1] for b in borders]), np.concatenate([b[1:] for b in borders])
    chord = end - start
    return CellBoxes(
        center=(end + start) / 2,
        heading=np.arctan2(chord[:, 1], chord[:, 0]),
        length_m=np.hypot(chord[:, 0], chord[:, 1]),
        width_m=np.repeat([lane.width_m for lane in lanes.values()], [len(b) - 1 for b in borders]),
    )


@dataclass(frozen=True, eq=False, slots=True)
class OriginalOccupancy:
    """What the recorded agents occupy, for all steps beforehand.

    sigma (T, C) uint8, FREE or ORIGINAL; cell (A, T) index of the cell of each agent's centre, mapped (A, T) tells
    whether it has one.
    """

    sigma: npt.NDArray[np.uint8]
    cell: npt.NDArray[np.int64]
    mapped: npt.NDArray[np.bool_]


def original_occupancy(boxes: CellBoxes, traffic: Traffic) -> OriginalOccupancy:
    """Hierarchical distance-based mapping of every recorded agent at every step, and the cells under its box.

    Centre: the cell that holds it and agrees in heading; else the nearest that agrees, within half a lane width plus
    0.5 m to the side; else the nearest cell centre within one cell; else off the grid (still an obstacle as a box).
    """
    sigma, cell = _occupancy(
        boxes.center, boxes.heading, boxes.length_m, boxes.width_m,
        traffic.position, traffic.heading, traffic.present, traffic.length_m, traffic.width_m, AGREES_RAD,
    )  # fmt: skip
    return OriginalOccupancy(sigma=sigma, cell=cell, mapped=cell >= 0)


@njit(cache=True)
def _occupancy(center, c_heading, c_length, c_width, position, heading, present, lengths, widths, agrees):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    agents, steps = present.shape
    cells = center.shape[0]
    sigma = np.zeros((steps, cells), dtype=np.uint8)
    found = np.full((agents, steps), -1, dtype=np.int64)
    cosine, sine = np.cos(c_heading), np.sin(c_heading)
    cos_agrees = np.cos(agrees)
    widest = np.hypot(c_length.max(), c_width.max()) / 2 if cells else 0.0
    by_x = np.argsort(center[:, 0])  # so that only cells near in x need to be looked at
    xs = center[by_x, 0]
    for a in range(agents):
        half_l, half_w = lengths[a] / 2, widths[a] / 2
        reach = np.hypot(half_l, half_w) + widest
        for t in range(steps):
            if not present[a, t]:
                continue
            x, y, angle = position[a, t, 0], position[a, t, 1], heading[a, t]
            still = (
                t > 0
                and present[a, t - 1]
                and x == position[a, t - 1, 0]
                and y == position[a, t - 1, 1]
                and angle == heading[a, t - 1]
            )
            co, si = np.cos(angle), np.sin(angle)
            best_level, best_distance, best = 4, np.inf, -1
            for k in range(np.searchsorted(xs, x - reach), cells):
                c = by_x[k]
                dx, dy = x - center[c, 0], y - center[c, 1]
                if dx < -reach:
                    break
                if abs(dy) > reach:
                    continue
                if overlap(
                    x, y, co, si, half_l, half_w,
                    center[c, 0], center[c, 1], cosine[c], sine[c], c_length[c] / 2, c_width[c] / 2,
                ):  # fmt: skip
                    sigma[t, c] = 1
                if still:
                    continue
                along = abs(dx * cosine[c] + dy * sine[c])
                across = abs(-dx * sine[c] + dy * cosine[c])
                same_way = co * cosine[c] + si * sine[c] > cos_agrees
                distance = np.hypot(dx, dy)
                level = 4
                if same_way and along <= c_length[c] / 2 + 1e-9 and across <= c_width[c] / 2:
                    level, distance = 1, across
                elif same_way and along <= c_length[c] / 2 + 0.5 and across <= c_width[c] / 2 + 0.5:
                    level, distance = 2, across
                elif distance <= c_length[c]:
                    level = 3
                nearer = distance < best_distance or (distance == best_distance and c < best)
                if level < best_level or (level == best_level and level < 4 and nearer):
                    best_level, best_distance, best = level, distance, c
            found[a, t] = found[a, t - 1] if still else best
    return sigma, found


def cells_under(
    boxes: CellBoxes, x: float, y: float, heading: float, *, length_m: float, width_m: float
) -> npt.NDArray[np.int64]:
    """Indices of the cells that a box covers."""
    return _under(boxes.center, boxes.heading, boxes.length_m, boxes.width_m, x, y, heading, length_m / 2, width_m / 2)  # type: ignore[no-any-return]


def is_anybody_on(boxes: CellBoxes, cells: Sequence[int], traffic: Traffic, step: int, *, width_share: float) -> bool:
    """Whether anybody is on any of some cells at a step; boxes count with a share of their width."""
    return bool(
        _anybody_on(
            boxes.center, boxes.heading, boxes.length_m, boxes.width_m, np.asarray(cells), step, width_share,
            traffic.position, traffic.heading, traffic.present, traffic.length_m, traffic.width_m,
        )
    )  # fmt: skip


@njit(cache=True)
def _anybody_on(  # type: ignore[no-untyped-def]  # noqa: ANN202
    center, c_heading, c_length, c_width, cells, step, share, position, heading, present, length, width,  # noqa: ANN001
):  # fmt: skip
    for a in range(present.shape[0]):
        if not present[a, step]:
            continue
        x, y, half_l, half_w = position[a, step, 0], position[a, step, 1], length[a] / 2, share * width[a] / 2
        co, si = np.cos(heading[a, step]), np.sin(heading[a, step])
        for c in cells:
            if is_on(center, c_heading, c_length, c_width, c, x, y, co, si, half_l, half_w):
                return True
    return False


@njit(cache=True)
def is_on(center, c_heading, c_length, c_width, c, x, y, co, si, half_l, half_w):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Whether a box covers any of cell c."""
    reach = half_l + half_w + c_length[c] + c_width[c]
    if abs(x - center[c, 0]) > reach or abs(y - center[c, 1]) > reach:
        return False
    return overlap(
        x, y, co, si, half_l, half_w,
        center[c, 0], center[c, 1], np.cos(c_heading[c]), np.sin(c_heading[c]), c_length[c] / 2, c_width[c] / 2,
    )  # fmt: skip


@njit(cache=True)
def _under(center, c_heading, c_length, c_width, x, y, heading, half_l, half_w):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    out = np.empty(64, dtype=np.int64)
    count = 0
    co, si = np.cos(heading), np.sin(heading)
    for c in range(center.shape[0]):
        if count < 64 and is_on(center, c_heading, c_length, c_width, c, x, y, co, si, half_l, half_w):
            out[count] = c
            count += 1
    return out[:count]


def dwell_steps(*, cell_m: float, speed_mps: float, step_s: float) -> int | None:
    """n_i = ceil(delta s / v_i / delta): steps that a vehicle takes to move on by one cell; None where it stands.

    Paper, Trajectory Generation. The motion itself is SUMO's, at every step.
    """
    if speed_mps <= 0.0:
        return None
    return math.ceil(cell_m / speed_mps / step_s - 1e-9)
