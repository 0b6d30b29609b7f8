"""Occupancy sigma of the cells (paper, Lane Gridification and Occupancy): 0 free, 1 original, 2 generated."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from hid2.agents import BoxSize, FloatArray
from hid2.kernels import cells as kernels
from hid2.occupancy.traffic import Traffic
from netconvert.cells import CellGrid

FREE: Final = 0
ORIGINAL: Final = 1
GENERATED: Final = 2

#: Largest angle between a lane and a vehicle's heading at which they agree, rad.
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
    borders = [grid.borders[lane_id] for lane_id in grid.graph.lanes]
    start, end = np.concatenate([b[:-1] for b in borders]), np.concatenate([b[1:] for b in borders])
    chord = end - start
    return CellBoxes(
        center=(end + start) / 2,
        heading=np.arctan2(chord[:, 1], chord[:, 0]),
        length_m=np.hypot(chord[:, 0], chord[:, 1]),
        width_m=np.repeat([lane.width_m for lane in grid.graph.lanes.values()], [len(b) - 1 for b in borders]),
    )


@dataclass(frozen=True, eq=False, slots=True)
class OriginalOccupancy:
    """What recorded agents occupy: sigma (T, C), FREE or ORIGINAL; cell (A, T) of each centre, -1 for none."""

    sigma: npt.NDArray[np.uint8]
    cell: npt.NDArray[np.int64]


def original_occupancy(boxes: CellBoxes, traffic: Traffic) -> OriginalOccupancy:
    """Hierarchical distance-based mapping of every recorded agent at every step, and the cells under its box.

    Centre: the cell that holds it and agrees in heading; else the nearest that agrees, within half a lane width plus
    0.5 m to the side; else the nearest cell centre within one cell; else off the grid (still an obstacle as a box).
    """
    by_x = np.argsort(boxes.center[:, 0])  # so that only cells near in x need to be looked at
    widest = float(np.hypot(boxes.length_m.max(), boxes.width_m.max())) / 2 if by_x.size else 0.0
    return OriginalOccupancy(
        *kernels.original_cells(
            boxes.center, boxes.heading, boxes.length_m, boxes.width_m, by_x, widest, *traffic.boxes, AGREES_RAD
        )
    )


def is_agent_on(boxes: CellBoxes, cells: npt.NDArray[np.int64], traffic: Traffic, step: int) -> bool:
    """Whether the box of an agent covers any of some cells at a step."""
    half_l, half_w = 0.5 * boxes.length_m[cells], 0.5 * boxes.width_m[cells]
    place, heading = boxes.center[cells], boxes.heading[cells]
    return not kernels.clear_places(place, heading, half_l, half_w, step, *traffic.boxes).all()


def clear_places(
    boxes: CellBoxes, cells: npt.NDArray[np.int64], share: FloatArray, here: Traffic, *, box: BoxSize, gap_m: float
) -> npt.NDArray[np.bool_]:
    """Whether a box a share (N,) along cells (N,) is clear, by a gap ahead and behind, of all agents (one step)."""
    heading = boxes.heading[cells]
    forward = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    place = boxes.center[cells] + ((share - 0.5) * boxes.length_m[cells])[:, None] * forward
    half_l, half_w = (np.full(heading.size, 0.5 * size) for size in (box.length_m + 2.0 * gap_m, box.width_m))
    return np.asarray(kernels.clear_places(place, heading, half_l, half_w, 0, *here.boxes))


def dwell_steps(*, cell_m: float, speed_mps: float, step_s: float) -> int | None:
    """n_i = ceil(delta s / v_i / delta): steps that a vehicle takes to move on by one cell; None where it stands.

    Paper, Trajectory Generation. The motion itself is SUMO's, at every step.
    """
    if speed_mps <= 0.0:
        return None
    return math.ceil(cell_m / speed_mps / step_s - 1e-9)
