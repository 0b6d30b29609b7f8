"""SCR and ORR of the paper (section Realism and Safety), and what they do not see: footprint, TTC, PET, time gap.

Per-agent and per-row results only: what is averaged over which group of agents is decided by the caller, because
recorded and generated vehicles must be told apart (evaluation.md).
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import shapely

from hid2.agents import FloatArray
from hid2.kernels.box_pairs import pairwise_overlap
from hid2.measures.arrays import BoolArray, SceneArrays
from hid2.measures.following import Leaders, leaders
from hid2.measures.lane_matching import FlatLanes, Matches, flatten_lanes, match_lanes
from hid2.measures.post_encroachment import Encroachment, encroachments
from hid2.measures.time_to_collision import ttc_to_anything
from hid2.params import Limits
from netconvert.geometry import box_corners
from netconvert.lane_graph import LaneGraph

#: Boxes overlapping by more than this collide ("a small IoU threshold" in the paper).
IOU_THRESHOLD = 0.02
#: A corner further outside than this is off the road.
FOOTPRINT_TOLERANCE_M = Limits().drivable_tolerance_m
#: Slower vehicles drive neither with nor against a lane.
WRONG_WAY_SPEED_MPS = 1.0
# No tunables, for rounding: both change a footprint by less than a millimetre.
#: Chords of a quarter circle, and slack against rounding, where the drivable area is widened.
_ARC = 16
_MARGIN_M = 1e-4


class Overlap(NamedTuple):
    """A pair of agents (numbers, first < second) whose boxes share ground at some step."""

    first: int
    second: int
    iou: float
    first_step: int
    steps: int


@dataclass(frozen=True, eq=False, slots=True)
class Safety:
    """Safety of a scene: overlaps of pairs, and masks and times by row (N,).

    off_road: box centre outside the drivable area; off_footprint: a corner more than 0.3 m outside;
    against_lane: moving against the lanes that hold the centre (matching.match_lanes); ttc_s: two-dimensional, at most
    CAP_S.
    """

    overlaps: tuple[Overlap, ...]
    encroachments: tuple[Encroachment, ...]
    off_road: BoolArray
    off_footprint: BoolArray
    against_lane: BoolArray
    ttc_s: FloatArray
    leaders: Leaders
    matches: Matches
    lanes: FlatLanes


def overlaps(arrays: SceneArrays) -> tuple[Overlap, ...]:
    """Every pair of agents, of any type, whose boxes overlap at some step."""
    iou, first, count = pairwise_overlap(arrays.position, arrays.heading, arrays.length, arrays.width, arrays.row_of)
    return tuple(
        Overlap(int(a), int(b), float(iou[a, b]), int(first[a, b]), int(count[a, b]))
        for a, b in np.argwhere(first >= 0)
    )


def colliding(arrays: SceneArrays, pairs: tuple[Overlap, ...], members: BoolArray) -> BoolArray:
    """(A,) members that overlap another member with more than IOU_THRESHOLD at any step."""
    hit = np.zeros(arrays.num_agents, dtype=bool)
    for pair in pairs:
        if pair.iou > IOU_THRESHOLD and members[pair.first] and members[pair.second]:
            hit[[pair.first, pair.second]] = True
    return hit


def off_road(position: FloatArray, graph: LaneGraph) -> BoolArray:
    """Which points (N, 2) lie outside the union of the drivable areas."""
    area = graph.drivable
    shapely.prepare(area)
    return np.asarray(~shapely.intersects_xy(area, position[:, 0], position[:, 1]))


@dataclass(frozen=True, eq=False, slots=True)
class PreparedMap:
    """What the measures need of a map, worked out once for all scenes on it.

    near, far: the drivable area, widened by a little less and a little more than the footprint's tolerance, prepared.
    """

    graph: LaneGraph
    lanes: FlatLanes
    near: shapely.Geometry
    far: shapely.Geometry


def prepare_map(graph: LaneGraph) -> PreparedMap:
    """Work out what the measures need of a map."""
    # a polygon inscribed in the widened area, and one around it: quarter circles of _ARC chords
    near = graph.drivable.buffer(FOOTPRINT_TOLERANCE_M - _MARGIN_M, quad_segs=_ARC)
    far = graph.drivable.buffer(FOOTPRINT_TOLERANCE_M / math.cos(math.pi / (4 * _ARC)) + _MARGIN_M, quad_segs=_ARC)
    shapely.prepare([near, far])
    return PreparedMap(graph, flatten_lanes(graph), near, far)


def off_footprint(arrays: SceneArrays, ground: PreparedMap) -> BoolArray:
    """Rows (N,) whose box has a corner more than FOOTPRINT_TOLERANCE_M outside the drivable area."""
    if not len(arrays.agent):
        return np.zeros(0, dtype=bool)
    corners = box_corners(
        arrays.position,
        arrays.heading,
        length_m=arrays.length[arrays.agent],
        width_m=arrays.width[arrays.agent],
    ).reshape(-1, 2)
    outside = off_road(corners, ground.graph)
    outside[outside] = ~shapely.intersects_xy(ground.near, corners[outside, 0], corners[outside, 1])
    # the distance itself only where it is within millimetres of the tolerance
    doubtful = np.flatnonzero(outside)
    doubtful = doubtful[shapely.intersects_xy(ground.far, corners[doubtful, 0], corners[doubtful, 1])]
    points = shapely.points(corners[doubtful])
    outside[doubtful] = ~shapely.dwithin(ground.graph.drivable, points, FOOTPRINT_TOLERANCE_M)
    return np.asarray(outside.reshape(-1, 4).any(axis=1))


def safety(arrays: SceneArrays, ground: PreparedMap) -> Safety:
    """Every measure of safety of a scene."""
    lanes = ground.lanes
    matches, against = match_lanes(arrays, lanes)
    fast = np.hypot(arrays.velocity[:, 0], arrays.velocity[:, 1]) > WRONG_WAY_SPEED_MPS
    return Safety(
        overlaps=overlaps(arrays),
        encroachments=encroachments(arrays),
        off_road=off_road(arrays.position, ground.graph),
        off_footprint=off_footprint(arrays, ground),
        against_lane=against & fast,
        ttc_s=ttc_to_anything(arrays),
        leaders=leaders(arrays, lanes, matches),
        matches=matches,
        lanes=lanes,
    )
