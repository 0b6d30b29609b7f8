"""Routes through the lane graph, and the path that a vehicle drives along one (with its lane changes)."""

import math
from collections.abc import Callable, Container, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from hid2.agents import FloatArray, IntArray
from hid2.kernels.polyline import frenet
from hid2.motion.lane_change_path import LateralTiming, blend_paths, lateral_share
from hid2.motion.reference_line import TABLE_STEP_M, ReferenceLine, build_reference_line
from hid2.once import once
from hid2.params import Limits
from netconvert.geometry import Polyline, arc_length, resample
from netconvert.lane_graph import SIDES, TURN_RAD, LaneGraph, TurnType

#: Spacing of a reference line's points, m, no tunable: its table is as fine. Largest offset of the line from
#: centrelines, m, no tunable: half a lane less half a car. Largest distance between the middles of lanes side by side,
#: m. Length of lanes seen before l', m, no tunable: no gap ends with a follower farther back.
PATH_STEP_M, MAX_OFFSET_M, _MAX_SHIFT_M, _LOOK_BACK_M = 1.0, 0.9, 5.5, 50.0
#: Length beyond which a route stops growing, m.
ROUTE_LONGEST_M = 260.0
#: Lane types open to general motor traffic.
DRIVABLE_TYPES = frozenset({"VEHICLE"})
_GIVEN_BACK = 0.05  # largest share of its speed by which a vehicle gives back what SUMO jumped; no tunable: not seen
_BESIDE_TURN_M = 5.0  # before and behind a turning lane, to compare its headings there; no tunable: what a turn is

Route = tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Segment:
    """Stretch of a path on one lane: start, end in arc length of the path, m; lane_m at its start and end, m."""

    lane_id: int
    start: float
    end: float
    lane_start: float
    lane_end: float

    def lane_m(self, s: float) -> float:
        """Arc length on the lane at arc length s of the path."""
        share = (s - self.start) / max(self.end - self.start, 1e-9)
        return self.lane_start + min(max(share, 0.0), 1.0) * (self.lane_end - self.lane_start)

    def s_at(self, lane_m: float) -> float:
        """Arc length on the path at an arc length of the lane; also beyond the stretch."""
        pace = (self.end - self.start) / max(self.lane_end - self.lane_start, 1e-9)
        return self.start + pace * (lane_m - self.lane_start)


class LateralSpan(NamedTuple):
    """Where a lateral motion begins and ends, m on the line of a path."""

    begin: float
    end: float


@dataclass(frozen=True, eq=False)
class DrivenPath:
    """Where a vehicle goes: the smoothed line, the polyline below it, and the lanes along it.

    raw (N, 2) m; segments: by the lane that the centre is on, which changes half way across; followed: by the lane on
    which the simulation has the vehicle, which is in the new one at once; lateral_spans: of each lateral motion;
    lateral: the last of them; exit_m: the end of the last lane.
    """

    line: ReferenceLine
    raw: FloatArray
    segments: tuple[Segment, ...]
    followed: tuple[Segment, ...]
    lateral_spans: tuple[LateralSpan, ...] = ()
    lateral: "LateralMotion | None" = None

    @cached_property
    def raw_m(self) -> FloatArray:
        """Arc length on raw of each of the line's points, m."""
        return np.linspace(0.0, float(arc_length(self.raw)[-1]), self.line.points_m.size)

    @cached_property
    def raw_line(self) -> Polyline:
        """Raw with its Frenet frame."""
        return Polyline(self.raw)

    @cached_property
    def even(self) -> tuple[FloatArray, FloatArray]:
        """Raw at equal distances, PATH_STEP_M, and its arc lengths."""
        points = resample(self.raw, step_m=PATH_STEP_M)
        return points, arc_length(points)

    @property
    def exit_m(self) -> float:
        """Arc length where the last lane ends, m."""
        return self.line.length_m

    def segment_at(self, s: float) -> Segment:
        """Lane stretch at arc length s; the last one beyond the end."""
        for segment in self.segments:
            if s < segment.end:
                return segment
        return self.segments[-1]

    def all_lane_m(self, s: FloatArray) -> tuple[IntArray, FloatArray]:
        """Segments at arc lengths (M,) m, the last one beyond the end, and arc lengths on their lanes, m."""
        every = [(one.start, one.end, one.lane_start, one.lane_end) for one in self.segments]
        start, end, lane_start, lane_end = np.array(every).T
        of = np.minimum(np.searchsorted(end, s, side="right"), end.size - 1)
        share = (s - start[of]) / np.maximum(end - start, 1e-9)[of]
        return of, lane_start[of] + np.clip(share, 0.0, 1.0) * (lane_end - lane_start)[of]

    def s_on(self, lane_id: int, lane_m: float, *, after: float) -> float | None:
        """Arc length at lane_m of the lane on which the simulation has a vehicle, after a place; None off the path."""
        for segment in self.followed:
            if segment.lane_id == lane_id and segment.end > after:
                return segment.s_at(lane_m)
        return None

    def to_line(self, raw_m: float) -> float:
        """Arc length on the line of an arc length on the raw polyline."""
        return float(np.interp(raw_m, self.raw_m, self.line.points_m))

    def all_to_line(self, raw_m: FloatArray) -> FloatArray:
        """The same for many, (M,) m."""
        return np.interp(raw_m, self.raw_m, self.line.points_m)

    def frenet(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of points (M, 2) m: arc lengths on the line and offsets from the raw polyline, left positive, (M,) m each."""
        raw_m, offset = frenet(xy, self.raw_line.points, self.raw_line.s)
        return self.all_to_line(raw_m), offset

    def to_raw(self, s: float) -> float:
        """Arc length on the raw polyline of an arc length on the line."""
        return float(self.all_to_raw(np.array(s)))

    def all_to_raw(self, s: FloatArray) -> FloatArray:
        """The same for many, (M,) m."""
        return np.interp(s, self.line.points_m, self.raw_m)


class Jump(NamedTuple):
    """What SUMO jumps, m, where it puts a vehicle onto a facing cell; it gives that back between two places, m."""

    jump_m: float
    since: float
    until: float

    @classmethod
    def onto(cls, path: DrivenPath, own: float, jump_m: float) -> "Jump":
        """On a path on which SUMO has the vehicle at an arc length, m: by the end of a change of lanes."""
        end = path.lateral_spans[-1].end if path.lateral_spans else own + 1.0
        return cls(jump_m, own, max(own + abs(jump_m) / _GIVEN_BACK, end))

    def left_m(self, own: FloatArray | float) -> FloatArray:
        """How far the vehicle is ahead of SUMO's, m, where that is at arc lengths (K,) m."""
        return np.asarray(self.jump_m * np.maximum(self.until - own, 0.0) / (self.until - self.since))


@dataclass(frozen=True, eq=False, slots=True)
class LateralMotion:
    """From one path to one beside: along_m, tau (K,): arc length on the one left, the driver's clock, at steps."""

    source: DrivenPath
    target: DrivenPath
    timing: LateralTiming
    along_m: FloatArray
    tau: FloatArray

    def foreseen(self, speed_mps: FloatArray, step_s: float) -> "LateralMotion":
        """With the steps to come at speeds (M,) m/s, of which the last one goes on, up to the end of the motion."""
        last = float(speed_mps[-1])
        left = math.ceil((1.0 - float(self.tau[-1])) / float(self.timing.gained(speed_mps[-1:], step_s)[0]))
        speeds = np.concatenate([speed_mps, np.full(max(left, 0), last)])
        tau = self.tau[-1] + np.cumsum(self.timing.gained(speeds, step_s))
        count = int(np.searchsorted(tau, 1.0)) + 1
        along = self.along_m[-1] + step_s * np.cumsum(speeds)
        return replace(
            self, along_m=np.concatenate([self.along_m, along[:count]]), tau=np.concatenate([self.tau, tau[:count]])
        )

    def share_off(self, s: float, tau: float) -> float:
        """Share of the way across by which the motion is off at an arc length, m, from a driver with another clock."""
        own, laid = lateral_share(np.array([tau, np.interp(s, self.along_m, self.tau)]), self.timing.ramp)
        return abs(float(own - laid))


def route_points(graph: LaneGraph, route: Route) -> FloatArray:
    """(N, 2) m centrelines of a route's lanes, one after the other, joints once."""
    pieces = [graph.lanes[route[0]].centerline]
    pieces += [graph.lanes[lane_id].centerline[1:] for lane_id in route[1:]]
    return np.concatenate(pieces)


def line_along(raw: FloatArray, limits: Limits) -> ReferenceLine:
    """Line of a path with the polyline (N, 2) m below it."""
    return build_reference_line(raw, step_m=PATH_STEP_M, min_radius_m=limits.min_radius_m, max_offset_m=MAX_OFFSET_M)


def shifted_path(motion: LateralMotion, *, limits: Limits) -> DrivenPath | None:
    """Path of a lateral motion, on the target's lanes from half way across on; None as of `blend_paths`."""
    path, target = motion.source, motion.target
    blend = blend_paths(
        path.even, target.raw_line, along_m=path.all_to_raw(motion.along_m), tau=motion.tau,
        ramp=motion.timing.ramp, step_m=PATH_STEP_M, max_shift_m=_MAX_SHIFT_M,
    )  # fmt: skip
    if blend is None:
        return None
    bare = DrivenPath(line=line_along(blend.points, limits), raw=blend.points, segments=(), followed=())
    start, end = bare.to_line(blend.start_m), bare.to_line(blend.end_m)

    def beside(s: float) -> float:  # the target may begin before the path: straight on there
        raw = target.to_raw(s) - blend.target_offset_m
        return bare.to_line(raw) + min(raw, 0.0)

    onto = [Segment(o.lane_id, beside(o.start), beside(o.end), o.lane_start, o.lane_end) for o in target.segments]
    segments = _joined(path.segments, onto, at=bare.to_line(blend.middle_m))
    followed = _joined(path.followed, onto, at=start)
    return replace(
        bare,
        segments=segments,
        followed=followed,
        lateral_spans=(*path.lateral_spans, LateralSpan(start, end)),
        lateral=motion,
    )


def _joined(own: Iterable[Segment], beside: Iterable[Segment], *, at: float) -> tuple[Segment, ...]:
    """Stretches of a path up to an arc length, m, and those of another one from there on."""
    before = [Segment(o.lane_id, o.start, min(o.end, at), o.lane_start, o.lane_m(at)) for o in own if o.start < at]
    behind = [Segment(o.lane_id, max(o.start, at), o.end, o.lane_m(at), o.lane_end) for o in beside if o.end > at]
    return (*before, *behind)


def first_turn(graph: LaneGraph, path: DrivenPath, kind: TurnType, *, after: float) -> Segment | None:
    """First stretch of a path on a lane of a turn type that begins behind arc length `after`, m; None if none does.

    Only where the path itself turns so: a lane may do no more than undo the kink before it, which does not show.
    """
    heading, sign = path.line.table_heading, 1.0 if kind is TurnType.LEFT else -1.0
    for segment in path.segments:
        if graph.lanes[segment.lane_id].turn is kind and segment.start > after:
            before = max(int((segment.start - _BESIDE_TURN_M) / TABLE_STEP_M), 0)
            behind = min(int((segment.end + _BESIDE_TURN_M) / TABLE_STEP_M), heading.size - 1)
            if sign * float(heading[behind] - heading[before]) >= TURN_RAD:
                return segment
    return None


def is_drivable(graph: LaneGraph, lane_id: int) -> bool:
    """Whether a lane is open to general motor traffic, along it."""
    lane = graph.lanes[lane_id]
    return lane.lane_type in DRIVABLE_TYPES and not lane.is_center_turn_lane


def comes_back(graph: LaneGraph, route: Route, lane_id: int) -> bool:
    """Whether a lane is on a route, or touches it before its last lane: no path comes back over itself."""
    return lane_id in route or not graph.touching[lane_id].isdisjoint(route[:-1])


def is_simple(graph: LaneGraph, route: Route) -> bool:
    """Whether a route nowhere comes back over itself."""
    return not any(comes_back(graph, route[:at], route[at]) for at in range(1, len(route)))


def straightest_first(graph: LaneGraph, lane_id: int, onward: Iterable[int], preferred: Container[int] = ()) -> Route:
    """Lanes that follow a lane, or come before it: those preferred, then those that turn least."""
    return tuple(sorted(onward, key=lambda n: (n not in preferred, graph.turned_rad(lane_id, n), n)))


def routes_from(
    graph: LaneGraph, lane_id: int, *, choose: Callable[[int, Route], Route], most: int, needed_m: float = 0.0
) -> Iterator[Route]:
    """Routes of drivable lanes to where the map ends, at most `most`, depth first.

    choose: orders the lanes onward from the lane before a split. A route stops growing beyond ROUTE_LONGEST_M and
    needed_m, and where it would come back over itself.
    """
    found, longest_m = 0, max(ROUTE_LONGEST_M, needed_m)
    stack: list[tuple[Route, float]] = [((lane_id,), 0.0)]
    while stack and found < most:
        route, length = stack.pop()
        while True:
            length += graph.lanes[route[-1]].length_m
            after = graph.successors(route[-1])
            onward = tuple([n for n in after if is_drivable(graph, n) and not comes_back(graph, route, n)])
            if len(onward) != 1 or length > longest_m:
                break
            route = (*route, *onward)
        if not onward and any(not is_drivable(graph, n) for n in after):
            continue
        if not onward or length > longest_m:
            found += 1
            yield route
            continue
        stack.extend(((*route, n), length) for n in reversed(choose(route[-1], onward)))


def with_run_up(graph: LaneGraph, route: Route, back_m: float) -> Route:
    """A route with lanes that lead to it, the straightest way, on which followers are seen: so far back, m, or less."""
    while back_m > 0.0:
        back = route[::-1]
        onto = (p for p in graph.predecessors(route[0]) if is_drivable(graph, p) and not comes_back(graph, back, p))
        before = straightest_first(graph, route[0], onto)
        if not before:
            break
        back_m -= graph.lanes[before[0]].length_m
        route = (before[0], *route)
    return route


@dataclass(frozen=True, eq=False)
class LanePaths:
    """Paths on the middle of the lanes of routes, and run_on_m farther straight on, off the grid (without topology).

    needed_m: how far a vehicle may drive in the time of the scene.
    """

    graph: LaneGraph
    limits: Limits
    run_on_m: float = 0.0
    needed_m: float = 0.0

    @once
    def along(self, route: Route) -> DrivenPath:
        """Path along a route."""
        raw = route_points(self.graph, route)
        if self.run_on_m > 0:
            last = raw[-1] - raw[-2]
            raw = np.concatenate([raw, raw[-1:] + self.run_on_m * last / np.hypot(last[0], last[1])])
        bare = DrivenPath(line=line_along(raw, self.limits), raw=raw, segments=(), followed=())
        lengths = [self.graph.lanes[lane_id].length_m for lane_id in route]
        ends = bare.all_to_line(np.concatenate([[0.0], np.cumsum(lengths)])).tolist()
        segments = tuple(map(Segment, route, ends[:-1], ends[1:], [0.0] * len(route), lengths))
        return replace(bare, segments=segments, followed=segments)

    def beside(self, own: Route, lane_id: int) -> DrivenPath:
        """Path of l', beside the lanes that are left of an own route."""
        return self.along(self.route_beside(own, lane_id))

    @once
    def route_beside(self, own: Route, lane_id: int) -> Route:
        """Route of that path: lanes before l', for agents from behind, then on beside the own ones if it can."""
        graph = self.graph
        beside = {n for lane in own for side in SIDES if (n := graph.neighbor(lane, side)) is not None}
        choose = partial(straightest_first, graph, preferred=beside)
        routes = routes_from(graph, lane_id, choose=choose, most=1, needed_m=self.needed_m)
        return with_run_up(graph, next(routes, (lane_id,)), _LOOK_BACK_M)
