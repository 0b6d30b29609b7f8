"""SCR and ORR of the paper (section Realism and Safety), and what they do not see: footprint, TTC, PET, time gap.

Per-agent and per-row results only: what is averaged over which group of agents is decided by the caller, because
recorded and generated vehicles must be told apart.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import shapely

from hid2.agents import FloatArray
from hid2.judge.states import against_lane_deg, outside_m
from hid2.measures.arrays import MOVES_MPS, BoolArray, SceneArrays
from hid2.measures.driven_lanes import LaneView
from hid2.measures.following import LaneLeaders, leaders
from hid2.measures.surrogates import CAP_S, Encroachment, earliest_contact, encroachments, time_to_collision
from hid2.params import Limits
from netconvert.geometry import box_corners
from netconvert.lane_graph import LaneGraph

#: IoU above which boxes collide ("a small IoU threshold" in the paper).
IOU_THRESHOLD = 0.02
#: Tolerance of a corner outside the drivable area, m: farther out it is off the road.
FOOTPRINT_TOLERANCE_M = Limits().drivable_tolerance_m
_TOUCHES_M2 = 1e-9  # area up to which boxes that share it only touch; no tunable


class Overlap(NamedTuple):
    """A pair of agents (numbers, first < second) with boxes that share ground at some step."""

    first: int
    second: int
    iou: float


@dataclass(frozen=True, eq=False, slots=True)
class Safety:
    """Safety of a scene: overlaps of pairs, and masks and times by row (N,).

    off_road: box centre outside the drivable area; off_footprint: the box more than 0.3 m outside; against_lane: moving
    against the lanes that hold the centre; ttc_s: two-dimensional, at most CAP_S.
    """

    overlaps: tuple[Overlap, ...]
    encroachments: tuple[Encroachment, ...]
    off_road: BoolArray
    off_footprint: BoolArray
    against_lane: BoolArray
    ttc_s: FloatArray
    leaders: LaneLeaders


def overlaps(arrays: SceneArrays) -> tuple[Overlap, ...]:
    """Every pair of agents, of any type, with boxes that overlap at some step, and their largest IoU."""
    near = arrays.position - arrays.position[:1]  # areas keep their digits near the origin
    length, width = arrays.length[arrays.agent], arrays.width[arrays.agent]
    boxes = shapely.polygons(box_corners(near, arrays.heading, length_m=length, width_m=width))
    found: dict[tuple[int, int], float] = {}
    for rows in arrays.row_of.T:
        here = rows[rows >= 0]
        own, other = here[shapely.STRtree(boxes[here]).query(boxes[here], predicate="intersects")]
        own, other = own[own < other], other[own < other]
        shared = shapely.area(shapely.intersection(boxes[own], boxes[other]))
        iou = shared / (shapely.area(boxes[own]) + shapely.area(boxes[other]) - shared)
        for k in np.flatnonzero(shared > _TOUCHES_M2).tolist():
            pair = int(arrays.agent[own[k]]), int(arrays.agent[other[k]])
            found[pair] = max(found.get(pair, 0.0), float(iou[k]))
    return tuple(Overlap(*pair, found[pair]) for pair in sorted(found))


def colliding(arrays: SceneArrays, pairs: tuple[Overlap, ...]) -> BoolArray:
    """(A, A) which agents overlap which with more than IOU_THRESHOLD at any step."""
    hit = np.zeros((arrays.num_agents, arrays.num_agents), dtype=bool)
    for pair in pairs:
        hit[pair.first, pair.second] = hit[pair.second, pair.first] = pair.iou > IOU_THRESHOLD
    return hit


def off_road(position: FloatArray, graph: LaneGraph) -> BoolArray:
    """Which points (N, 2) lie outside the union of the drivable areas."""
    return np.asarray(~shapely.intersects_xy(graph.drivable, *position.T))


def off_footprint(arrays: SceneArrays, graph: LaneGraph) -> BoolArray:
    """Rows (N,) with boxes more than FOOTPRINT_TOLERANCE_M out of the drivable area, as the judge sees it."""
    boxes = arrays.position, arrays.heading, arrays.length[arrays.agent], arrays.width[arrays.agent]
    return np.asarray(outside_m(*boxes, graph, tolerance_m=FOOTPRINT_TOLERANCE_M) > 0.0)


def ttc_after_last_step(arrays: SceneArrays, members: BoolArray, among: BoolArray) -> FloatArray:
    """(A,) s from the last step of each member (A,) to its first contact within END_HORIZON_S; inf for all else.

    Nothing is recorded beyond the last step: nothing else would tell that a track ends a moment before a collision.
    among: the agents (A,) that count as others; of these those present at that very step.
    """
    found = np.full(arrays.num_agents, np.inf)
    for agent in np.flatnonzero(members).tolist():
        step = int(arrays.step[arrays.first[agent + 1] - 1])
        agents = np.union1d(np.flatnonzero((arrays.row_of[:, step] >= 0) & among), agent)
        rows, own = arrays.row_of[agents, step], int(np.searchsorted(agents, agent))
        boxes = arrays.position[rows], arrays.heading[rows], arrays.velocity[rows]
        found[agent], _ = earliest_contact(own, *boxes, arrays.length[agents], arrays.width[agents])
    return found


def safety(view: LaneView) -> Safety:
    """Every measure of safety of a scene."""
    arrays, graph = view.arrays, view.lanes.graph
    moves = np.flatnonzero(arrays.moving_vehicles[arrays.agent] & (np.hypot(*arrays.velocity.T) > MOVES_MPS))
    angle, limit = against_lane_deg(view, moves)
    return Safety(
        overlaps=overlaps(arrays),
        encroachments=encroachments(arrays),
        off_road=off_road(arrays.position, graph),
        off_footprint=off_footprint(arrays, graph),
        against_lane=np.isin(np.arange(len(arrays.step)), moves[angle > limit]),
        ttc_s=time_to_collision(arrays, cap_s=CAP_S)[0],
        leaders=leaders(view),
    )
