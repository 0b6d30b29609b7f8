"""Recorded vehicles that are taken out after the history and driven again: which ones, where, and how they begin.

Of a vehicle's future its route is known, the lanes that it was recorded on, and nothing else; its speed, its place in
the lane and the gap to its leader are those of the present, a step of the recording.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from hid2.agents import FloatArray, Policy, Track
from hid2.drivers.driver import Driver, LaneOffset, desired_speeds, draw_driver, lane_offset, usual_driver
from hid2.measures.driven_lanes import LaneView, path_driven, runs_of
from hid2.measures.following import leaders
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.motion.route import DRIVABLE_TYPES, DrivenPath, Route, line_along
from hid2.motion.smoothing import smooth_motion, trajectory
from hid2.occupancy.agent_states import AgentStates
from hid2.policy.roads import Roads
from hid2.scene import Scene, clearance_box
from hid2.vehicle import DrivenVehicle, Start, VehicleRequest
from netconvert.geometry import Polyline, arc_length, wrap_angle

# Figures with other numbers than these, no tunables, are of other vehicles or of other starts.
#: Time before and after the present for which a vehicle that is driven again must be there, s. No tunables.
_BEFORE_S, _AFTER_S = 0.5, 1.0
#: Distances over which a vehicle comes from its place in the lane at the present to the usual one and to its driver's
#: own wandering, and from its heading to its path's, m; spacing of the points of a path, m. No tunables.
_BACK_OVER_M, _WANDERS_OVER_M, _STRAIGHT_OVER_M, _POINTS_M = 50.0, 20.0, 5.0, 1.0
#: Least time gap, s, and jam gap, m, that the present gap is taken for; factor of the lateral acceleration in turns for
#: each try until the present speed fits a bend, and bound up to which it is tried, m/s2. No tunables.
_LEAST_TAU_S, _LEAST_GAP_M, _FASTER, _MOST_MPS2 = 0.5, 0.5, 1.25, 20.0
#: SUMO's default passenger car (vType of 1.28, Krauss) on its default edge; SD of the speed factor. No tunables.
_DEFAULT = replace(usual_driver(13.89), tau_s=1.0, accel_mps2=2.6, decel_mps2=4.5, min_gap_m=2.5)
_DEFAULT_SD = 0.1


class Left(StrEnum):
    """Why a recorded vehicle stays as it was recorded."""

    FRAGMENT = "a tracker's fragment (category 0)"
    PARKED = "parked, or stands throughout"
    ABSENT = "not there from .5 s before the present to 1 s after it"
    OFF_LANES = "on no lane at the present"
    NO_ROUTE = "its lanes are no route: it changes or leaves them, or they are not open to cars"


@dataclass(frozen=True, eq=False, slots=True)
class TakenOut:
    """A vehicle that is driven again, a row of the tracks, with its state at the present.

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
        """At the present."""
        return float(np.hypot(*self.velocity))


def taken_out(states: AgentStates, tracks: Sequence[Track], now: int) -> tuple[list[TakenOut], dict[str, Left]]:
    """The vehicles of a recording that are driven again from step `now` on, and why each of the others is not."""
    arrays, step_s = states.arrays, states.arrays.step_s
    gap_m = leaders(states).gap_m
    before, after = now - round(_BEFORE_S / step_s), now + round(_AFTER_S / step_s)
    found, left = list[TakenOut](), dict[str, Left]()
    for row in np.flatnonzero(arrays.vehicle).tolist():
        there, route = arrays.row_of[row], None
        if arrays.fragment[row] or not arrays.moving[row]:
            why = Left.FRAGMENT if arrays.fragment[row] else Left.PARKED
        elif there.size <= after or (there[before : after + 1] < 0).any():
            why = Left.ABSENT
        elif states.matches.lane[there[now]] < 0:
            why = Left.OFF_LANES
        else:
            why, route = Left.NO_ROUTE, _route(states, row, int(there[now]))
        if route is None:
            left[arrays.track_ids[row]] = why
            continue
        past, here = there[before : now + 1], int(there[now])
        velocity = np.polyfit(step_s * np.arange(past.size), arrays.position[past], 1)[0]
        pose = arrays.position[here], float(arrays.heading[here])
        found.append(TakenOut(row, tracks[row], route, *pose, velocity, max(float(gap_m[here]), 0.0)))
    return found, left


def _route(view: LaneView, row: int, first: int) -> Route | None:
    """The lanes of a vehicle from its row `first` on and the straightest ones beyond; None where they are no route."""
    runs = runs_of(view, row)
    k = next(number for number, run in enumerate(runs) if run.last >= first)
    _, path = path_driven(view, runs, k)
    ids = tuple(int(view.lanes.lane_ids[lane]) for lane in path)
    lanes, types = {run.lane for run in runs[k:]}, {view.lanes.graph.lanes[one].lane_type for one in ids}
    return ids if lanes <= {*path} and types <= DRIVABLE_TYPES else None


def own_path(scene: Scene, one: TakenOut) -> DrivenPath:
    """Path of a vehicle along its lanes: as far aside as at the present, and back to the usual place."""
    middle, usual_m = scene.paths.along(one.route), scene.config.drivers.offset_mean_m
    start_m, d_m = _on(middle, one.position)
    s = np.arange(0.0, middle.line.length_m, _POINTS_M)
    aside = usual_m + (d_m - usual_m) * np.exp(-((np.maximum(s - start_m, 0.0) / _BACK_OVER_M) ** 2))
    xy, tangent, _ = middle.line.motion(s)
    points = xy + aside[:, None] * np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    line, length_m = line_along(points, scene.config.limits), arc_length(points)
    ends = np.array([(part.start, part.end) for part in middle.segments])
    ends = np.interp(ends, s, length_m * line.length_m / length_m[-1])
    segments = tuple(replace(part, start=a, end=b) for part, (a, b) in zip(middle.segments, ends.tolist(), strict=True))
    return DrivenPath(line=line, raw=points, segments=segments, followed=segments)


def _on(path: DrivenPath, position: FloatArray) -> tuple[float, float]:
    """Arc length and offset, m, of a place (2,) m on the line of a path."""
    (s,), (d,) = Polyline(path.line.points).frenet(position[None])
    return float(np.interp(s, arc_length(path.line.points), path.line.points_m)), float(d)


def begin(
    scene: Scene, roads: Roads, one: TakenOut, path: DrivenPath, rng: np.random.Generator, *, number: int,
    usual_mps: float | None,
) -> Start:  # fmt: skip
    """A vehicle at the present with a driver that could have come there: with its gap, and its speed in a bend.

    usual_mps: of the scene's moving vehicles at the present; None: SUMO's default driver.
    """
    size, (start_m, d_m) = one.track.size, _on(path, one.position)
    if usual_mps is None:
        factor = float(np.clip(1.0 + _DEFAULT_SD * rng.standard_normal(), 0.5, 1.5))
        driver = replace(_DEFAULT, desired_mps=factor * _DEFAULT.desired_mps)
        desired = np.full(scene.num_steps, driver.desired_mps)
    else:
        driver = _as_come(draw_driver(scene.config, rng, lane_speed_mps=max(usual_mps, one.speed_mps)), one)
        at = min(int(start_m / TABLE_STEP_M), len(path.line.table_xy) - 1)
        while roads.speeds(path, driver)[at] < one.speed_mps and driver.turn_lateral_mps2 < _MOST_MPS2:
            driver = replace(driver, turn_lateral_mps2=_FASTER * driver.turn_lateral_mps2)
        desired = desired_speeds(
            driver, scene.config, rng, num_steps=scene.num_steps, step_s=scene.step_s, at_least_mps=one.speed_mps
        )
    pace_mps = 0.5 * (one.speed_mps + driver.desired_mps)
    offset = lane_offset(driver, scene.config, rng, length_m=path.line.length_m, pace_mps=pace_mps, usual=np.zeros_like)
    knots = start_m + offset.knots_m - offset.knots_m[0]  # the first one where the vehicle is
    place = offset.offset_m + (d_m - offset.offset_m[0]) * np.exp(-(knots - start_m) / _WANDERS_OVER_M)
    return Start(
        vehicle_id=f"v{number}", request=VehicleRequest(number, Policy.STRAIGHT, 0.0, one.track.object_type, size),
        box=clearance_box(size, size), route=one.route, path=path, start_m=start_m,
        start_mps=one.speed_mps, driver=driver, desired=desired, sides=("left", "right"),
        offset=LaneOffset(knots, place, np.gradient(place, knots)),
    )  # fmt: skip


def _as_come(driver: Driver, one: TakenOut) -> Driver:
    """A driver that keeps no more from its leader than it does at the present."""
    gap_m = min(driver.min_gap_m, max(one.gap_m, _LEAST_GAP_M))
    tau_s = (one.gap_m - gap_m) / max(one.speed_mps, 1.0)
    return replace(driver, min_gap_m=gap_m, tau_s=min(driver.tau_s, max(tau_s, _LEAST_TAU_S)))


def poses(scene: Scene, vehicle: DrivenVehicle, one: TakenOut) -> tuple[FloatArray, FloatArray]:
    """Position (T, 2) m and heading (T,) rad of a vehicle as it was driven; behind the end of its lanes straight on."""
    s, ahead = np.array(vehicle.s), np.arange(1, scene.num_steps - len(vehicle.s) + 1)
    s = np.concatenate([s, s[-1] + vehicle.v[-1] * scene.step_s * ahead])
    motion = smooth_motion(s, filter_s=scene.config.smoothing.filter_s, step_s=scene.step_s)
    motion = replace(motion, s=motion.s + s[0] - motion.s[0])
    driven = trajectory(vehicle.path.line, motion, vehicle.start.offset, vehicle.start.size.length_m)
    turned = wrap_angle(one.heading - driven.heading[0])
    return driven.position, wrap_angle(driven.heading + turned * np.exp((s[0] - motion.s) / _STRAIGHT_OVER_M))
