"""The lane graph of a scene, whatever map it came from: segments, successors, same-direction neighbours."""

import math
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
import shapely

from netconvert.geometry import FloatArray, Polyline, wrap_angle

Side = Literal["left", "right"]
SIDES: tuple[Side, Side] = ("left", "right")
_OTHER: dict[Side, Side] = {"left": "right", "right": "left"}

#: Change of heading from end to end above which a segment in an intersection turns.
TURN_RAD = math.radians(30.0)
#: Largest distance of a successor's start from the end of a lane at which it can be driven to, m. Real maps: 0.
MAX_SUCCESSOR_GAP_M = 2.0
LANE_TYPES = frozenset({"VEHICLE", "BIKE", "BUS"})
#: Lane types that motor vehicles drive on; a bicycle lane is no lane to them.
MOTOR_TYPES = frozenset({"VEHICLE", "BUS"})

REASON_OUTSIDE = "the other lane is outside the map"
REASON_ITSELF = "the lane names itself"
REASON_OPPOSITE = "the other lane runs the opposite way"
REASON_CONTRADICTED = "the other lane has another neighbour on that side"
REASON_RING = "the neighbours would form a ring"
REASON_GAP = "the other lane starts elsewhere"


class TurnType(StrEnum):
    """What a vehicle does that follows the lane segment."""

    STRAIGHT = "straight"
    LEFT = "left_turn"
    RIGHT = "right_turn"


class DroppedLink(NamedTuple):
    """A link of the source map that the graph, or its grid or its net, does not have, and why."""

    kind: str
    """successor, left_neighbor or right_neighbor."""
    source: int
    target: int
    reason: str


@dataclass(frozen=True, eq=False, slots=True)
class LaneSegment:
    """One lane segment. Links are those of the source map, unchecked: LaneGraph has the ones to follow."""

    lane_id: int
    centerline: FloatArray
    """(N, 2) m in the city frame, in driving direction."""
    left_boundary: FloatArray
    """(M, 2) m."""
    right_boundary: FloatArray
    """(M, 2) m."""
    lane_type: str
    """VEHICLE, BIKE or BUS."""
    is_intersection: bool
    successors: tuple[int, ...]
    left_neighbor_id: int | None
    right_neighbor_id: int | None
    left_mark_type: str
    right_mark_type: str
    width_m: float
    """Mean distance between the boundaries."""
    turn: TurnType
    path: Polyline = field(init=False, repr=False)
    """The centreline with its Frenet frame."""
    length_m: float = field(init=False, repr=False)
    """Length of the centreline."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", Polyline(self.centerline))
        object.__setattr__(self, "length_m", self.path.length_m)

    @property
    def sides(self) -> tuple[FloatArray, FloatArray]:
        """Left and right boundary."""
        return self.left_boundary, self.right_boundary

    def neighbor_id(self, side: Side) -> int | None:
        """The neighbour on a side as the source map names it, in whatever direction it runs."""
        return self.left_neighbor_id if side == "left" else self.right_neighbor_id

    @property
    def is_center_turn_lane(self) -> bool:
        """Whether it is the middle lane of a road that vehicles of both ways enter to turn left, not to drive on."""
        return self.left_mark_type == self.right_mark_type == "DASH_SOLID_YELLOW"

    def mark_type(self, side: Side) -> str:
        """The marking of the boundary on a side, as this lane sees it (its own side first in DASH_SOLID)."""
        return self.left_mark_type if side == "left" else self.right_mark_type


@dataclass(frozen=True, eq=False)
class LaneGraph:
    """Lane segments and the links between them that can be driven.

    Neighbour links are same-direction and mutual: neighbor(a, "left") == b exactly where neighbor(b, "right") == a. A
    link that only one of the two lanes states counts for both. Whatever the source states beyond that is in `dropped`.
    """

    lanes: Mapping[int, LaneSegment]
    """By lane id, in ascending order."""
    drivable_areas: tuple[FloatArray, ...] = ()
    """Closed rings, each (N, 2) m with the first point repeated at the end."""
    pedestrian_crossings: tuple[FloatArray, ...] = ()
    """Corners of each crossing in turn, (4, 2) m."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "lanes", dict(sorted(self.lanes.items())))

    @cached_property
    def dropped(self) -> tuple[DroppedLink, ...]:
        """Links of the source map that are not followed."""
        return tuple(self._drivable_successors[1] + self._mutual_neighbors[1])

    def successors(self, lane_id: int) -> tuple[int, ...]:
        """Lanes of the map that follow this one, in the source's order."""
        return self._drivable_successors[0][lane_id]

    def predecessors(self, lane_id: int) -> tuple[int, ...]:
        """Lanes that have this one as successor, ascending. The source's own list is not used: it is incomplete."""
        return self._predecessors[lane_id]

    def straightest_successor(self, lane_id: int) -> int | None:
        """The successor that turns least, the lower id of equals; None without one.

        Of a lane of MOTOR_TYPES only successors of these types count: motor vehicles do not go on into a bicycle lane.
        """
        any_type = self.lanes[lane_id].lane_type not in MOTOR_TYPES
        onward = [n for n in self.successors(lane_id) if any_type or self.lanes[n].lane_type in MOTOR_TYPES]
        return min(onward, key=lambda n: (self.turned_rad(lane_id, n), n), default=None)

    def turned_rad(self, lane_id: int, other: int) -> float:
        """How far a successor's chord turns from a lane's end, or a predecessor's from its start; rad, at least 0."""
        end = slice(-2, None) if other in self.successors(lane_id) else slice(2)
        (x0, y0), (x1, y1) = self.lanes[lane_id].centerline[end].tolist()
        x, y = _direction(self.lanes[other])
        return abs(math.remainder(math.atan2(y, x) - math.atan2(y1 - y0, x1 - x0), math.tau))

    def neighbor(self, lane_id: int, side: Side) -> int | None:
        """The lane beside this one that runs the same way, of whatever type."""
        return self._mutual_neighbors[0][side].get(lane_id)

    def may_change(self, lane_id: int, side: Side) -> bool:
        """Whether there is a neighbour on that side and the marking between allows a vehicle of this lane to cross."""
        return self.neighbor(lane_id, side) is not None and crossable(self.lanes[lane_id].mark_type(side))

    def rows(self, *, without: Collection[int] = (), apart: Collection[int] = ()) -> Iterator[tuple[int, ...]]:
        """Lanes side by side, from the right. without: lanes that are in no row; apart: lanes that are rows alone."""

        def beside(lane_id: int, side: Side) -> int | None:
            other = self.neighbor(lane_id, side)
            return None if other in without or lane_id in apart or other in apart else other

        for lane_id in self.lanes:
            if lane_id not in without and beside(lane_id, "right") is None:
                row = [lane_id]
                while (left := beside(row[-1], "left")) is not None:
                    row.append(left)
                yield tuple(row)

    @cached_property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Low and high corner of the ground that the lanes' centrelines take, (2,) m."""
        points = np.concatenate([lane.centerline for lane in self.lanes.values()])
        return points.min(axis=0), points.max(axis=0)

    @cached_property
    def drivable(self) -> shapely.Geometry:
        """Union of the drivable areas, prepared for containment tests."""
        areas = [shapely.make_valid(shapely.Polygon(ring)) for ring in self.drivable_areas if len(ring) >= 4]
        union = shapely.union_all(areas)
        shapely.prepare(union)
        return union

    @cached_property
    def touching(self) -> dict[int, set[int]]:
        """Lanes with a middle that touches or crosses that of a lane, with itself."""
        ids, middles = list(self.lanes), [shapely.LineString(lane.centerline) for lane in self.lanes.values()]
        touching: dict[int, set[int]] = {lane_id: set() for lane_id in ids}
        for one, other in shapely.STRtree(middles).query(middles, predicate="intersects").T.tolist():
            touching[ids[one]].add(ids[other])
        return touching

    @cached_property
    def _predecessors(self) -> dict[int, tuple[int, ...]]:
        predecessors: dict[int, tuple[int, ...]] = dict.fromkeys(self.lanes, ())
        for lane_id in self.lanes:
            for target in self.successors(lane_id):
                predecessors[target] += (lane_id,)
        return predecessors

    @cached_property
    def _drivable_successors(self) -> tuple[dict[int, tuple[int, ...]], list[DroppedLink]]:
        successors: dict[int, tuple[int, ...]] = {}
        dropped = []
        for lane_id, lane in self.lanes.items():
            why = {target: self._why_not(lane_id, target) for target in lane.successors}
            for target in [target for target, reason in why.items() if not reason]:
                apart_m = math.dist(self.lanes[target].centerline[0], lane.centerline[-1])
                why[target] = REASON_GAP if apart_m > MAX_SUCCESSOR_GAP_M else ""
            dropped += [DroppedLink("successor", lane_id, target, reason) for target, reason in why.items() if reason]
            successors[lane_id] = tuple(target for target, reason in why.items() if not reason)
        return successors, dropped

    @cached_property
    def _mutual_neighbors(self) -> tuple[dict[Side, dict[int, int]], list[DroppedLink]]:
        dropped = []
        direction = {lane_id: _direction(lane) for lane_id, lane in self.lanes.items()}
        stated: list[tuple[bool, int, Side, int]] = []
        for lane_id, lane in self.lanes.items():
            for side in SIDES:
                target = lane.neighbor_id(side)
                if target is None:
                    continue
                reason = self._why_not(lane_id, target)
                if not reason and np.dot(direction[lane_id], direction[target]) <= 0.0:
                    reason = REASON_OPPOSITE
                if reason:
                    dropped.append(DroppedLink(f"{side}_neighbor", lane_id, target, reason))
                else:
                    stated.append((self.lanes[target].neighbor_id(_OTHER[side]) != lane_id, lane_id, side, target))
        # Links that both lanes state come first, so that a one-sided claim never displaces one of them.
        neighbors: dict[Side, dict[int, int]] = {"left": {}, "right": {}}
        for _, lane_id, side, target in sorted(stated):
            mine, theirs = neighbors[side], neighbors[_OTHER[side]]
            if mine.get(lane_id) == target and theirs.get(target) == lane_id:
                continue
            if lane_id in mine or target in theirs:
                dropped.append(DroppedLink(f"{side}_neighbor", lane_id, target, REASON_CONTRADICTED))
                continue
            end = target
            while end != lane_id and end in mine:
                end = mine[end]
            if end == lane_id:
                dropped.append(DroppedLink(f"{side}_neighbor", lane_id, target, REASON_RING))
            else:
                mine[lane_id] = target
                theirs[target] = lane_id
        return neighbors, dropped

    def _why_not(self, lane_id: int, target: int) -> str:
        return REASON_ITSELF if target == lane_id else "" if target in self.lanes else REASON_OUTSIDE


def crossable(mark_type: str) -> bool:
    """Whether a marking may be crossed from the lane that states it: unmarked, dashed, or dashed on the lane's side.

    A mark type names its lines from the stating lane outwards (a centre turn lane has DASH_SOLID_YELLOW on both sides).
    """
    return mark_type in {"NONE", "UNKNOWN"} or mark_type.startswith(("DASHED_", "DASH_SOLID_", "DOUBLE_DASH_"))


def joined(count: int, pairs: Iterable[tuple[int, int]]) -> list[int]:
    """Of each of `count` things, the one that stands for all that it is joined with, by pairs (union-find)."""
    parent = list(range(count))

    def root(node: int) -> int:
        while parent[node] != node:
            parent[node] = node = parent[parent[node]]
        return node

    for one, other in pairs:
        parent[root(one)] = root(other)
    return [root(node) for node in range(count)]


def turn_type(centerline: FloatArray, *, is_intersection: bool) -> TurnType:
    """Left or right turn where the heading changes by more than TURN_RAD over a lane of an intersection.

    centerline: (N, 2) m without repeated points.
    """
    if not is_intersection:
        return TurnType.STRAIGHT
    steps = np.diff(centerline, axis=0)
    change = float(np.sum(wrap_angle(np.diff(np.arctan2(steps[:, 1], steps[:, 0])))))
    if abs(change) <= TURN_RAD:
        return TurnType.STRAIGHT
    return TurnType.LEFT if change > 0.0 else TurnType.RIGHT


def _direction(lane: LaneSegment) -> tuple[float, float]:
    """Chord of the lane, m; for a lane that ends where it starts, its first segment."""
    start_x, start_y = lane.centerline[0].tolist()
    end_x, end_y = lane.centerline[-1].tolist()
    if math.hypot(end_x - start_x, end_y - start_y) < 1e-6:
        end_x, end_y = lane.path.point(1e-3).tolist()
    return end_x - start_x, end_y - start_y
