"""Another way at the next split: the paper's answer to a predicted conflict (case 3) that timing does not solve."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from hid2.motion.route import DrivenPath, is_drivable, routes_from, straightest_first
from hid2.scene import Scene

_SAME_M, _EVERY_M = 0.02, 2.0  # book-keeping: how far two paths with the same first lanes may differ, and where we look


def ways_at_next_split(scene: Scene, path: DrivenPath, *, s: float, from_m: float) -> Iterator[DrivenPath]:
    """Paths that leave the present one at the next split, those that go straight on first.

    s: arc length driven so far, m, up to which they lie on the present path; from_m: no turn off before it. A path
    with a change of lanes has none: it is not the middle of its lanes. Nor where nothing links lanes (ablation).
    """
    if path.shifts or "topology" in scene.config.without:
        return
    graph, route = scene.grid.graph, tuple(segment.lane_id for segment in path.segments)
    straight_first = partial(straightest_first, graph)
    for row, segment in enumerate(path.segments[:-1]):
        others = tuple(n for n in graph.successors(segment.lane_id) if n not in route and is_drivable(graph, n))
        if segment.end < from_m or not others:
            continue
        for lane_id in straight_first(others):
            for rest in routes_from(graph, lane_id, choose=straight_first, most=1):
                other = scene.paths.along((*route[: row + 1], *rest))
                if not set(rest) & set(route[: row + 1]) and _is_the_same_until(path, other, s):
                    yield other
        return


def _is_the_same_until(path: DrivenPath, other: DrivenPath, s: float) -> bool:
    own = np.arange(0.0, s + _EVERY_M, _EVERY_M)
    apart = path.line.position(own) - other.line.position(other.all_to_line(path.all_to_raw(own)))
    return bool(np.hypot(apart[:, 0], apart[:, 1]).max() < _SAME_M)
