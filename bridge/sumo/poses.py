"""Pose of the box (city frame, radians, centre) <-> pose in SUMO (degrees clockwise from north, front bumper).

The only home of degrees and front bumpers.
"""

import numpy as np
import numpy.typing as npt

from hid2.agents import FloatArray
from hid2.motion.route import DrivenPath
from netconvert.cells import CellGrid


def sumo_poses(position: FloatArray, heading: FloatArray, length_m: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """(..., 2) m front bumpers and (...) degrees from box centres, headings and lengths."""
    direction = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    front = position + 0.5 * np.asarray(length_m)[..., None] * direction
    return front, np.asarray((90.0 - np.degrees(heading)) % 360.0)


def box_poses(front: FloatArray, angle_deg: FloatArray, length_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Inverse of `sumo_poses`: box centres (..., 2) m and headings (...) rad in (-pi, pi]."""
    heading = np.radians(90.0 - np.asarray(angle_deg))
    heading = np.arctan2(np.sin(heading), np.cos(heading))
    direction = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return front - 0.5 * np.asarray(length_m)[..., None] * direction, heading


def front_arc_m(center_m: float, length_m: float) -> float:
    """Arc length of the front bumper of a box with its centre at center_m, m."""
    return center_m + 0.5 * length_m


def center_on_path(
    grid: CellGrid, path: DrivenPath, lane: str, front_m: float, *, length_m: float, after: float
) -> float | None:
    """Arc length of a box's centre on a path where SUMO has its front bumper front_m along a lane; None off the path.

    after: where it was before (`DrivenPath.s_on`). SUMO's lanes are cells, each as long as its piece of the centreline.
    """
    cell = grid.cell_of_sumo_lane.get(lane)
    if cell is None:
        return None
    front = path.s_on(cell.lane_id, float(grid.edges_m[cell.lane_id][cell.index]) + front_m, after=after)
    return None if front is None else front - 0.5 * length_m
