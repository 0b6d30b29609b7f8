"""Lanes drawn by hand, for tests that need a road and no map."""

from collections.abc import Sequence

import numpy as np

from netconvert.lane_graph import LaneSegment, turn_type


def draw_lane(
    lane_id: int,
    points: Sequence[Sequence[float]],
    *,
    successors: tuple[int, ...] = (),
    left: int | None = None,
    right: int | None = None,
    lane_type: str = "VEHICLE",
    is_intersection: bool = False,
    left_mark: str = "DASHED_WHITE",
    right_mark: str = "DASHED_WHITE",
    width_m: float = 3.5,
) -> LaneSegment:
    """A lane segment along points (m) without boundaries; left, right: ids of its neighbours."""
    centerline = np.array(points, dtype=np.float64)
    return LaneSegment(
        lane_id=lane_id,
        centerline=centerline,
        left_boundary=None,
        right_boundary=None,
        lane_type=lane_type,
        is_intersection=is_intersection,
        successors=successors,
        left_neighbor_id=left,
        right_neighbor_id=right,
        left_mark_type=left_mark,
        right_mark_type=right_mark,
        width_m=width_m,
        turn=turn_type(centerline, is_intersection=is_intersection),
    )
