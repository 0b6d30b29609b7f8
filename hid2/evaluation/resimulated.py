"""Recorded vehicles that are taken out after the history and driven again: which ones, along what, and how they begin.

The present is a step of the recording. Of a vehicle's future its route is known, the lanes that it was recorded on, and
nothing else; its speed, place in the lane and gap to its leader are those of the present.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import pairwise

import numpy as np

from hid2.agents import FloatArray, Policy, Track
from hid2.drivers.driver import Driver, LaneOffset, desired_speeds, draw_driver, lane_offset
from hid2.measures.following import leaders
from hid2.measures.lane_matching import FlatLanes
from hid2.motion.reference_line import TABLE_STEP_M, build_reference_line
from hid2.motion.route import ROUTE_LONGEST_M, DrivenPath, Route
from hid2.motion.smoothing import Motion, trajectory
from hid2.occupancy.agent_states import AgentStates
from hid2.policy.roads import Roads
from hid2.scene import DRIVABLE_TYPES, Scene, clearance_box
from hid2.vehicle import Start, VehicleRequest
from netconvert.geometry import Polyline, arc_length, wrap_angle

#: No tunables of a scene: figures with others are of other vehicles. A vehicle is there so long before the present and
#: behind it, s; on a lane at this share of the steps; routes begin so far behind it, m, and link lanes over so many.
BEFORE_S, BEHIND_S, ON_LANES, _RUN_UP_M, _LINKS = 0.5, 1.0, 0.8, 30.0, 4
#: Points of a path are so far apart, m; a driver comes back from its place at the present to the usual one over so far.
_POINTS_M, _BACK_OVER_M = 1.0, 50.0
#: A vehicle's heading comes to that of its path over this, m.
_STRAIGHT_AFTER_M = 5.0
#: By so much a driver takes bends faster until it can drive as fast as it was recorded in one.
_FASTER = 1.25
#: SUMO's default speed of an edge, m/s.
_DEFAULT_MPS = 13.89


class Left(StrEnum):
    """Why a recorded vehicle stays as it was recorded."""

    FRAGMENT = "a tracker's fragment (category 0)"
    PARKED = "parked, or stands throughout"
    ABSENT = "not there from 0.5 s before the present to 1 s after it"
    OFF_LANES = "not on lanes"
    CHANGES = "changes lanes: its lanes are no route"
    UNLINKED = "its lanes do not lead into each other"
    NOT_OPEN = "on lanes that are not open to cars"


@dataclass(frozen=True, eq=False, slots=True)
class TakenOut:
    """A vehicle that is driven again, row of the recording's tracks: its route and its state at the present.

    position (2,) m; heading rad; velocity (2,) m/s, over the half second before; gap_m: to its leader, inf without one.
    """

    row: int
    track: Track
    route: Route
    position: FloatArray
    heading: float
    velocity: FloatArray
    gap_m: float

    @property
    def speed_mps(self) -> float:
        """Its speed at the present."""
        return float(np.hypot(*self.velocity))


def taken_out(states: AgentStates, tracks: Sequence[Track], now: int) -> tuple[list[TakenOut], dict[str, Left]]:
    """The vehicles of a recording that are driven again from step `now` on, and why each of the others is not."""
    arrays, matches, lanes = states.arrays, states.matches, states.lanes
    led = leaders(arrays, lanes, matches)
    before, behind = round(BEFORE_S / arrays.step_s), round(BEHIND_S / arrays.step_s)
    found, left = list[TakenOut](), dict[str, Left]()
    for row in np.flatnonzero(arrays.vehicle).tolist():
        rows = np.arange(arrays.first[row], arrays.first[row + 1])
        steps, lane = arrays.step[rows], matches.lane[rows[arrays.step[rows] >= now]]
        there = arrays.row_of[row, now - before : now + behind + 1]
        route: Route | Left
        if arrays.fragment[row]:
            route = Left.FRAGMENT
        elif not arrays.moving[row]:
            route = Left.PARKED
        elif len(there) <= before + behind or (there < 0).any():
            route = Left.ABSENT
        elif lane[0] < 0 or (lane >= 0).mean() < ON_LANES:
            route = Left.OFF_LANES
        else:
            route = _route(lanes, lane[lane >= 0].tolist())
        if isinstance(route, Left):
            left[arrays.track_ids[row]] = route
            continue
        past, here = rows[(steps >= now - before) & (steps <= now)], int(arrays.row_of[row, now])
        pace = np.polyfit(arrays.step[past] * arrays.step_s, arrays.position[past], 1)[0]
        gap_m = max(float(led.gap_m[here]), 0.0)
        found.append(TakenOut(row, tracks[row], route, arrays.position[here], float(arrays.heading[here]), pace, gap_m))
    return found, left


def _route(lanes: FlatLanes, driven: list[int]) -> Route | Left:
    """The lanes driven, with those passed between two steps, some before them and the straightest ones behind."""
    graph, chain = lanes.graph, driven[:1]
    for before, after in pairwise(driven):
        if after == before or after in chain:
            continue
        if lanes.link[chain[-1], after] == 1:
            return Left.CHANGES
        between = _between(lanes, chain[-1], after)
        if not between:
            return Left.UNLINKED
        chain += between
    route = [int(lanes.lane_ids[one]) for one in chain]
    driven_m = run_up_m = sum(graph.lanes[one].length_m for one in route)
    while run_up_m < driven_m + _RUN_UP_M:
        behind = [one for one in graph.predecessors(route[0]) if one not in route and _is_open(lanes, one)]
        if not behind:
            break
        route.insert(0, behind[0])
        run_up_m += graph.lanes[behind[0]].length_m
    onward_m = 0.0
    while onward_m < ROUTE_LONGEST_M:
        onward = graph.straightest_successor(route[-1])
        if onward is None or onward in route or not _is_open(lanes, onward):
            break
        route.append(onward)
        onward_m += graph.lanes[onward].length_m
    return tuple(route) if all(_is_open(lanes, one) for one in route) else Left.NOT_OPEN


def _is_open(lanes: FlatLanes, lane_id: int) -> bool:
    return lanes.graph.lanes[lane_id].lane_type in DRIVABLE_TYPES


def _between(lanes: FlatLanes, first: int, last: int) -> list[int]:
    """Fewest lanes that lead from one to another, without the first; none where more than _LINKS would."""
    ways: list[list[int]] = [[]]
    for _ in range(_LINKS):
        ways = [[*way, one] for way in ways for one in lanes.successors[way[-1] if way else first]]
        if found := [way for way in ways if way[-1] == last]:
            return found[0]
    return []


@dataclass(frozen=True, eq=False, slots=True)
class OwnWay:
    """The path of a vehicle along its route, from its place in the lane on; start_s m of its centre at the present.

    aside_m: of the path, what the smoothing of the line leaves; turned_rad: of the vehicle at the present.
    """

    vehicle: TakenOut
    path: DrivenPath
    start_s: float
    aside_m: float
    turned_rad: float


def own_way(scene: Scene, one: TakenOut) -> OwnWay:
    """Path of a vehicle: beside the middle of its lanes as far as at the present, and back to the usual place."""
    middle, usual_m = scene.path(one.route), scene.config.drivers.offset_mean_m
    start_s, d_m = _on(middle, one.position)
    s = np.arange(0.0, middle.line.length_m, _POINTS_M)
    beyond = np.maximum(s - start_s, 0.0) / _BACK_OVER_M
    aside = usual_m + (d_m - usual_m) * np.exp(-beyond * beyond)
    xy, tangent, _ = middle.line.motion(s)
    points = xy + aside[:, None] * np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    smoothing, length = scene.config.smoothing, arc_length(points)
    line = build_reference_line(
        points, step_m=smoothing.path_step_m, min_radius_m=scene.config.limits.min_radius_m,
        max_offset_m=smoothing.max_offset_m,
    )  # fmt: skip
    length *= line.length_m / length[-1]
    segments = tuple(
        replace(part, start=float(np.interp(part.start, s, length)), end=float(np.interp(part.end, s, length)))
        for part in middle.segments
    )
    path = DrivenPath(line=line, raw=points, segments=segments, followed=segments)
    start_s, aside_m = _on(path, one.position)
    turned = wrap_angle(one.heading - line.heading(np.array([start_s]))[0])
    return OwnWay(one, path, start_s, aside_m, float(turned))


def _on(path: DrivenPath, position: FloatArray) -> tuple[float, float]:
    """Arc length and offset, m, of a place (2,) m on the line of a path."""
    (s,), (d,) = Polyline(path.line.points).frenet(position[None])
    return float(np.interp(s, arc_length(path.line.points), path.line.points_s)), float(d)


def poses(way: OwnWay, start: Start, motion: Motion) -> tuple[FloatArray, FloatArray]:
    """Position (T, 2) m and heading (T,) rad of a vehicle as it was driven; its heading comes to that of its path."""
    driven = trajectory(way.path.line, motion, start.offset)
    turns = way.turned_rad * np.exp((motion.s[0] - motion.s) / _STRAIGHT_AFTER_M)
    return driven.position, wrap_angle(driven.heading + turns)


def begin(
    scene: Scene, roads: Roads, way: OwnWay, usual_mps: float, rng: np.random.Generator, number: int
) -> Start:  # fmt: skip
    """A vehicle at its present with a driver that could have come there: with its gap, and with its speed in a bend.

    usual_mps: speed of the scene's moving vehicles at the present.
    """
    one, config = way.vehicle, scene.config
    driver = draw_driver(config, rng, lane_speed_mps=max(usual_mps, one.speed_mps))
    driver = replace(
        driver, min_gap_m=min(driver.min_gap_m, max(one.gap_m, 0.5)),
        tau_s=float(np.clip((one.gap_m - driver.min_gap_m) / max(one.speed_mps, 1.0), 0.5, driver.tau_s)),
    )  # fmt: skip
    at = min(int(way.start_s / TABLE_STEP_M), len(way.path.line.table_xy) - 1)
    while roads.speeds(way.path, driver)[at] < one.speed_mps and driver.turn_lateral_mps2 < 20.0:
        driver = replace(driver, turn_lateral_mps2=driver.turn_lateral_mps2 * _FASTER)
    desired = desired_speeds(
        driver, config, rng, num_steps=scene.num_steps, step_s=scene.step_s, at_least_mps=one.speed_mps
    )
    return _start(way, driver, desired, _wandering(way, driver, scene, rng), number)


def _wandering(way: OwnWay, driver: Driver, scene: Scene, rng: np.random.Generator) -> LaneOffset:
    """The driver's wandering about its path, from where the vehicle is at the present on."""
    length_m = max(way.path.line.length_m - way.start_s, 1.0)
    found = lane_offset(driver, scene.config, rng, length_m=length_m, usual=np.zeros_like)
    slope = found.slope.copy()
    slope[0] = 0.0
    return LaneOffset(way.start_s + found.knots_m - found.knots_m[0], way.aside_m + found.offset_m - found.offset_m[0], slope)


def begin_by_default(scene: Scene, way: OwnWay, rng: np.random.Generator, number: int) -> Start:
    """The same with SUMO's default passenger car (vType attributes of 1.28: Krauss) on a road of 50 km/h."""
    factor = float(np.clip(1.0 + 0.1 * rng.standard_normal(), 0.2, 2.0))
    driver = Driver(
        desired_mps=_DEFAULT_MPS * factor, tau_s=1.0, accel_mps2=2.6, decel_mps2=4.5, min_gap_m=2.5,
        turn_lateral_mps2=2.0, offset_m=0.0, lane_change_s=scene.config.drivers.lane_change_mean_s,
    )  # fmt: skip
    offset = LaneOffset(np.array([0.0, 1.0]), np.full(2, way.aside_m), np.zeros(2))
    return _start(way, driver, np.full(scene.num_steps, driver.desired_mps), offset, number)


def _start(way: OwnWay, driver: Driver, desired: FloatArray, offset: LaneOffset, number: int) -> Start:
    one, size = way.vehicle, way.vehicle.track.size
    return Start(
        vehicle_id=f"v{number}", request=VehicleRequest(number, Policy.STRAIGHT, 0.0),
        object_type=one.track.object_type, size=size, box=clearance_box(size, size), route=one.route, path=way.path,
        start_s=way.start_s, start_mps=one.speed_mps, driver=driver, desired=desired, offset=offset,
        sides=("left", "right"),
    )  # fmt: skip
