"""Which places on routes are free as the scene begins: compiled, because many more are tried than are free."""

from collections.abc import Sequence
from itertools import accumulate
from typing import Final

import numpy as np
import numpy.typing as npt

from hid2.agents import BoxSize
from hid2.kernels.cells import is_on
from hid2.kernels.compiled import planner_kernel
from hid2.kernels.path_intervals import meets
from hid2.measures.lane_matching import FlatLanes
from hid2.motion.route import Way
from hid2.occupancy.sigma import FREE, UNDER_SHARE, CellBoxes
from hid2.occupancy.traffic import Traffic

_REASONS: Final = (None, "cells_occupied", "box_too_close")
_FREE, _OCCUPIED, _CLOSE = range(3)


def taken(
    ways: Sequence[Way],
    s0: Sequence[float],
    size: BoxSize,
    *,
    lanes: FlatLanes,
    boxes: CellBoxes,
    sigma: npt.NDArray[np.uint8],
    others: Traffic,
    gap_m: float,
    back_m: Sequence[float] = (),
) -> tuple[list[str | None], list[float]]:
    """For M places on routes why each is taken at step 0, None where it is not, and where it is then, m.

    ways, s0 (M,): the route of each place, and the arc length of the box centre on it, m. Taken: on a cell that is not
    free in sigma (C,), or within gap_m straight ahead or behind of anybody's box. back_m: by how much a place is moved
    back, again and again, while it is taken and the box does not stand out of the route's start.
    """
    rows = {way: row for row, way in enumerate(dict.fromkeys(ways))}
    begin = np.array([0, *accumulate(len(way.route) for way in rows)])
    tables = [way.table for way in rows]
    table = tables[0] if len(tables) == 1 else np.concatenate(tables)
    reason, at = _taken(
        table, begin, np.array([rows[way] for way in ways]), np.asarray(s0), np.asarray(back_m, dtype=np.float64),
        (lanes.points, lanes.s, lanes.first), (boxes.center, boxes.heading, boxes.length_m, boxes.width_m), sigma,
        (others.position, others.heading, others.present, others.length_m, others.width_m),
        size.length_m, size.width_m, gap_m,
    )  # fmt: skip
    return [_REASONS[row] for row in reason.tolist()], at.tolist()


@planner_kernel
def _pose(way, s, lanes):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """x, y m and heading rad on the middle of a route's lanes; straight on beyond either end."""
    points, lane_s, first = lanes
    row = min(np.searchsorted(way[:, 0], s, side="right"), way.shape[0] - 1)
    along = s - (way[row - 1, 0] if row > 0 else 0.0)
    begin, end = first[int(way[row, 1])], first[int(way[row, 1]) + 1]
    k = begin + min(max(np.searchsorted(lane_s[begin:end], along, side="right") - 1, 0), end - begin - 2)
    heading = np.arctan2(points[k + 1, 1] - points[k, 1], points[k + 1, 0] - points[k, 0])
    along -= lane_s[k]
    return points[k, 0] + along * np.cos(heading), points[k, 1] + along * np.sin(heading), heading


@planner_kernel
def _any_taken(sigma, boxes, x, y, heading, half_l, half_w):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Whether a box is on any cell that is not free."""
    center, c_heading, c_length, c_width = boxes
    cosine, sine = np.cos(heading), np.sin(heading)
    for c in range(sigma.size):
        if sigma[c] != FREE and is_on(center, c_heading, c_length, c_width, c, x, y, cosine, sine, half_l, half_w):
            return True
    return False


@planner_kernel
def _taken(table, begin, which, s0, back, lanes, boxes, sigma, others, length, width, gap):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    position, heading, present, lengths, widths = others
    reason, at = np.empty(s0.size, dtype=np.int64), s0.copy()
    for i in range(s0.size):
        way = table[begin[which[i]] : begin[which[i] + 1]]
        for k in range(back.size + 1):
            if k > 0:
                at[i] -= back[k - 1]
                if at[i] < length / 2:
                    break
            x, y, angle = _pose(way, at[i], lanes)
            if _any_taken(sigma, boxes, x, y, angle, length / 2, UNDER_SHARE * width / 2):
                reason[i] = _OCCUPIED
            elif meets(x, y, angle, length + 2 * gap, width, 0, position, heading, present, lengths, widths):
                reason[i] = _CLOSE
            else:
                reason[i] = _FREE
                break
    return reason, at
