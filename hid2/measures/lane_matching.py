"""Which lane a vehicle drives on, from positions and the map alone: nearest lanes, then the likeliest sequence.

For every row the lanes near it that agree with the direction of motion are candidates; a Viterbi pass per vehicle
picks the sequence that is near the centrelines and follows the map's links (Newson and Krumm 2009, on lanes).
"""

from dataclasses import dataclass

import numpy as np

from hid2.agents import FloatArray, IntArray
from hid2.kernels.lane_matching import lane_candidates, likeliest_lanes, motion_directions
from hid2.measures.arrays import BoolArray, SceneArrays
from netconvert.geometry import wrap_angle
from netconvert.lane_graph import MOTOR_TYPES, SIDES, LaneGraph, TurnType

#: Largest distance beyond its own edge at which a lane is a candidate, m.
BEYOND_EDGE_M = 1.0
#: Time before and after a step between which the displacement is the direction of motion, s.
HALF_WINDOW_S = 0.5
#: What a lane is to another: the same or a successor; a neighbour, or one's successor; anything else is neither.
GOES_ON, CHANGES_LANES, _NEITHER = range(3)
#: Length of lanes in a row that may be passed between two steps, m. No tunable, as in `kernels/lane_matching.py`.
_SHORT_M = 6.0


@dataclass(frozen=True, eq=False, slots=True)
class FlatLanes:
    """The lanes of a map, `graph`, for compiled code: lane k has points first[k]:first[k + 1].

    lane_ids (L,); points (P, 2) m; s (P,) m along each lane; half_width (L,) m; box (L, 4) bounds, m;
    link (L, L): what each lane is to each, GOES_ON, CHANGES_LANES or neither;
    left, right (L,): same-direction neighbour of a driven type, -1 where none; turn (L,): +1 left, -1 right, else 0;
    straight (L,): `LaneGraph.straightest_successor`, -1 where there is none; length_m (L,). If all lanes lay one behind
    the other, 1 m apart, they would begin at offset (L,) m, and the points be at along (P,) m.
    """

    graph: LaneGraph
    lane_ids: IntArray
    points: FloatArray
    s: FloatArray
    first: IntArray
    half_width: FloatArray
    box: FloatArray
    link: IntArray
    left: IntArray
    right: IntArray
    turn: IntArray
    straight: IntArray
    successors: tuple[tuple[int, ...], ...]
    index_of: dict[int, int]
    length_m: FloatArray
    offset: FloatArray
    along: FloatArray

    def heading(self, lane: IntArray, s: FloatArray) -> FloatArray:
        """(M,) rad, direction of lanes at arc lengths on them; that of lane 0 where there is none (-1)."""
        lane = np.maximum(lane, 0)
        at = np.searchsorted(self.along, np.clip(s, 0.0, self.length_m[lane]) + self.offset[lane], side="right") - 1
        at = np.clip(at, self.first[lane], self.first[lane + 1] - 2)
        step = self.points[at + 1] - self.points[at]
        return np.asarray(np.arctan2(step[:, 1], step[:, 0]))

    def lane_points(self, lane: int) -> FloatArray:
        """(M, 2) centreline of lane number `lane`."""
        return self.points[self.first[lane] : self.first[lane + 1]]


@dataclass(frozen=True, eq=False, slots=True)
class Matches:
    """Lane of every row (N,), -1 off every lane; s and d (N,) m on it; direction (N,) rad of the motion."""

    lane: IntArray
    s: FloatArray
    d: FloatArray
    direction: FloatArray


def flatten_lanes(graph: LaneGraph) -> FlatLanes:
    """The lanes of `graph` that vehicles drive on, as flat arrays."""
    lanes = [lane for lane in graph.lanes.values() if lane.lane_type in MOTOR_TYPES]
    index_of = {lane.lane_id: k for k, lane in enumerate(lanes)}
    counts = np.array([len(lane.centerline) for lane in lanes], dtype=np.int64)
    first = np.concatenate([np.zeros(1, np.int64), np.cumsum(counts)])
    points = np.concatenate([np.zeros((0, 2)), *(lane.centerline[:, :2] for lane in lanes)])
    step = np.hypot(*np.diff(points, axis=0, prepend=points[:1]).T)
    step[first[:-1]] = 0.0
    total = np.cumsum(step)
    s = total - np.repeat(total[first[:-1]], counts)
    length_m = s[first[1:] - 1]
    offset = np.concatenate([[0.0], np.cumsum(length_m + 1.0)])[:-1]
    half_width = np.array([lane.width_m / 2 for lane in lanes], dtype=np.float64)
    margin = half_width + BEYOND_EDGE_M
    low, high = (ends.reduceat(points, first[:-1], axis=0) for ends in (np.minimum, np.maximum))
    box = np.column_stack([low - margin[:, None], high + margin[:, None]])
    successors = tuple(tuple(index_of[n] for n in graph.successors(lane.lane_id) if n in index_of) for lane in lanes)
    number: dict[int | None, int] = dict([(None, -1), *index_of.items()])
    left, right = (
        np.array([number.get(graph.neighbor(lane.lane_id, side), -1) for lane in lanes], dtype=np.int64)
        for side in SIDES
    )
    sign = {TurnType.STRAIGHT: 0, TurnType.LEFT: 1, TurnType.RIGHT: -1}
    straightest = (graph.straightest_successor(lane.lane_id) for lane in lanes)
    return FlatLanes(
        graph=graph,
        lane_ids=np.array([lane.lane_id for lane in lanes], dtype=np.int64),
        points=np.ascontiguousarray(points, dtype=np.float64),
        s=s,
        first=first,
        half_width=half_width,
        box=box,
        link=_links(successors, left, right, length_m),
        left=left,
        right=right,
        turn=np.array([sign[lane.turn] for lane in lanes], dtype=np.int64),
        straight=np.array([number[n] for n in straightest], dtype=np.int64),
        successors=successors,
        index_of=index_of,
        length_m=length_m,
        offset=offset,
        along=s + np.repeat(offset, counts),
    )


def _links(successors: tuple[tuple[int, ...], ...], left: IntArray, right: IntArray, length: FloatArray) -> IntArray:
    count = len(successors)
    link = np.full((count, count), 2, dtype=np.int64)
    reached = [_reached(k, successors, length) for k in range(count)]
    for k in range(count):
        beside = [n for n in (left[k], right[k]) if n >= 0]
        link[k, [n for one in beside for n in (one, *reached[one])]] = CHANGES_LANES
        link[k, [n for ahead in reached[k] for n in (left[ahead], right[ahead]) if n >= 0]] = CHANGES_LANES
        link[k, [k, *reached[k]]] = GOES_ON
    return link


def _reached(lane: int, successors: tuple[tuple[int, ...], ...], length: FloatArray) -> list[int]:
    """Successors, and those behind lanes so short that a step may pass them."""
    found: list[int] = []
    stack = [(n, 0.0) for n in successors[lane]]
    while stack:
        current, passed = stack.pop()
        if current in found or current == lane:
            continue
        found.append(current)
        passed += float(length[current])
        if passed < _SHORT_M:
            stack.extend((n, passed) for n in successors[current])
    return found


def lanes_near(
    lanes: FlatLanes, position: FloatArray, direction: FloatArray, wanted: BoolArray, *, beyond_m: float = BEYOND_EDGE_M
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray, IntArray]:
    """Lane, s, d, cost (N, K) of the lanes near places (N, 2) m that agree with directions (N,) rad; numbers (N,).

    beyond_m: a lane is near at most so far beyond its edge.
    """
    box = lanes.box + (beyond_m - BEYOND_EDGE_M) * np.array([-1.0, -1.0, 1.0, 1.0])
    return lane_candidates(
        position, direction, lanes.points, lanes.s, lanes.first, lanes.half_width, box, wanted, beyond_m
    )


def directions_of_motion(position: FloatArray, heading: FloatArray, first: IntArray, *, step_s: float) -> FloatArray:
    """(N,) rad, of the displacement from HALF_WINDOW_S before a row to as long after it, where that is long enough."""
    half = max(1, round(HALF_WINDOW_S / step_s))
    return motion_directions(np.ascontiguousarray(position), np.ascontiguousarray(heading), first, half)


def lane_along(lanes: FlatLanes, position: FloatArray, direction: float) -> tuple[int, float, float]:
    """Of the lanes that hold a place (2,) m the one that runs most nearly in a direction, rad; its s and d, m.

    Lane -1 where none holds it. Where lanes part, it tells which one an agent follows; its offset does not.
    """
    lane, s, d, _, (count,) = lanes_near(lanes, position[None], np.array([direction]), np.ones(1, dtype=np.bool_))
    held = np.flatnonzero(np.abs(d[0, :count]) <= lanes.half_width[lane[0, :count]])
    if not held.size:
        return -1, 0.0, 0.0
    best = int(held[np.argmin(np.abs(wrap_angle(lanes.heading(lane[0, held], s[0, held]) - direction)))])
    return int(lane[0, best]), float(s[0, best]), float(d[0, best])


def match_lanes(arrays: SceneArrays, lanes: FlatLanes) -> Matches:
    """Lanes of every vehicle's rows; those of other agents have lane -1."""
    direction = directions_of_motion(arrays.position, arrays.heading, arrays.first, step_s=arrays.step_s)
    lane, s, d, cost, count = lanes_near(lanes, arrays.position, direction, arrays.vehicle[arrays.agent])
    chosen = likeliest_lanes(np.flatnonzero(arrays.vehicle), arrays.first, lane, s, cost, count, lanes.link)
    rows, on = np.arange(len(chosen)), chosen >= 0
    slot = np.where(on, chosen, 0)
    s_on, d_on = (np.where(on, one[rows, slot], 0.0) for one in (s, d))
    return Matches(np.where(on, lane[rows, slot], -1), s_on, d_on, direction)
