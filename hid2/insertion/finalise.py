"""From driven to exported: smoothing, and the final check: of each vehicle by itself, then of a round together.

Both ask the functions of `judge/states.py`, with stricter bounds (`export_bounds`) than those that `judge` has.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from hid2.agents import DEFAULT_SIZES, BoxSize, FloatArray, Track
from hid2.drivers.driver import LaneOffset
from hid2.judge.findings import MOVES_M, Allowed, Finding, Quantity, export_bounds
from hid2.judge.states import (
    headway_on_driven_path,
    headways,
    of_boxes,
    of_crossings,
    of_end,
    of_motion,
    of_recorded_followers,
    of_road,
    ttc_on_driven_path,
    ttc_on_lanes,
)
from hid2.kernels.path_intervals import SAME_WAY
from hid2.measures.arrays import MOVES_MPS
from hid2.measures.following import leaders
from hid2.motion.smoothing import Motion, Trajectory, smooth_motion, trajectory
from hid2.occupancy.agent_states import AgentStates, agent_states
from hid2.occupancy.gaps import gaps_from_poses
from hid2.occupancy.traffic import Traffic
from hid2.reasons import Reason
from hid2.scene import Scene, clearance_box
from hid2.vehicle import DrivenVehicle
from netconvert.cells import Cell

#: Widths of the filter over `smoothing.filter_s`, and shares of the driver's lateral offset, tried in turn, the usual
#: ones first. No tunables: what no limit asks for is not changed, and none drives along the very middle of its lane.
_FILTER_RATIOS, _OFFSET_SHARES = (1.0, 2.0, 3.2, 5.0), (1.0, 0.5, 0.15)
#: Least lateral clearance to what is passed, of either direction, m, if some place in the lane gives it, and how far
#: aside from the usual one places are tried, m. No tunables: one in eleven recorded vehicles leaves less.
_PASSES_M, _ASIDE_M = 0.8, (0.25, 0.5)
_PASSES_NEAR_M = 20.0  # distance on an axis; not a parameter, it saves time: farther agents have a larger clearance


@dataclass(frozen=True, eq=False, slots=True)
class ExportedVehicle:
    """A vehicle as it is exported: T_i steps from its first on.

    simulated_off_m (T_i,): exported s(t) minus SUMO's own place along the path; states: as a reader has it, with its
    clearance box.
    """

    driven: DrivenVehicle
    motion: Motion
    trajectory: Trajectory
    simulated_off_m: FloatArray
    min_ttc_s: float
    states: AgentStates

    @property
    def num_steps(self) -> int:
        """T_i."""
        return int(self.motion.s.size)

    @property
    def span(self) -> slice:
        """Its steps among those of the scene."""
        return slice(self.driven.start.step, self.driven.start.step + self.num_steps)

    @property
    def course(self) -> FloatArray:
        """(T_i,) direction of its path, rad."""
        _, tangent, _ = self.driven.path.line.motion(self.motion.s)
        return np.asarray(np.arctan2(tangent[:, 1], tangent[:, 0]))

    def track(self, track_id: str, category: int) -> Track:
        """As it is written."""
        return _track(self.driven, self.trajectory, track_id, category)


def _track(vehicle: DrivenVehicle, path: Trajectory, track_id: str, category: int) -> Track:
    start, steps = vehicle.start, vehicle.start.step + np.arange(len(path.position), dtype=np.int64)
    motion = path.position, path.heading, path.velocity
    return Track(track_id, start.request.object_type, category, steps, *motion, start.size)


def traffic_of_exported(vehicles: Sequence[ExportedVehicle], scene: Scene) -> Traffic:
    """Clearance boxes of exported vehicles, and beyond the scene's last step at constant velocity, (A, T + E)."""
    return Traffic.none(scene.future.num_steps).joined(*(
        scene.known_traffic(one.driven.vehicle_id, one.driven.start.box, [(one.driven.start.step, one.trajectory)])
        for one in vehicles
    ))  # fmt: skip


def finalise(scene: Scene, vehicle: DrivenVehicle, kept: Sequence[ExportedVehicle]) -> ExportedVehicle | Reason:
    """Smooth a driven vehicle and judge it beside everything recorded and those kept; or why it is not exported."""
    if vehicle.not_inserted is not None:
        return vehicle.not_inserted
    start, config = vehicle.start, scene.config
    s, v, own = np.array(vehicle.s), np.array(vehicle.v), np.array(vehicle.s) - np.array(vehicle.jumped_m)
    missing = scene.num_steps - start.step - s.size
    if "topology" in config.without and missing > 0:  # off the grid it goes on as it was
        s = np.concatenate([s, s[-1] + v[-1] * scene.step_s * np.arange(1, missing + 1)])
        v, own = np.concatenate([v, np.full(missing, v[-1])]), s
    end = vehicle.path.exit_m - start.size.length_m / 2
    steps = int((s <= end).sum())
    if steps < scene.steps_to_stay(start.step):
        return Reason.LEAVES_TOO_EARLY
    if s[steps - 1] - s[0] < MOVES_M and "collision" not in config.without:
        return Reason.STANDS_THROUGHOUT
    others = together(scene, kept)
    if "smoothing" in config.without:
        path = _grid_path(scene, vehicle, s[:steps], v[:steps])
        if path is None:
            return Reason.NO_SITE
        motion = Motion(s=s[:steps], v=v[:steps], a=np.gradient(v[:steps], scene.step_s), step_s=scene.step_s)
        cell_by_cell = as_exported(scene, vehicle, motion, path, np.zeros(steps))
        return _boxes(scene, others.joined(cell_by_cell.states)) or cell_by_cell
    offset = start.offset
    for begin, finish in vehicle.path.lateral_spans:
        offset = offset.held(begin, finish)
    verdict: ExportedVehicle | Reason = Reason.LIMIT_JERK  # replaced by that of the first try
    tried = [(_FILTER_RATIOS[0], False), *((ratio, True) for ratio in _FILTER_RATIOS)]
    for ratio, eased in tried:  # ends are eased where they must be
        motion = smooth_motion(
            s[:steps], filter_s=ratio * config.smoothing.filter_s, step_s=scene.step_s,
            end_jerk_mps3=config.limits.longitudinal_jerk_mps3 if eased else None,
        )  # fmt: skip
        verdict = _placed(scene, vehicle, motion, offset, motion.s - own[:steps], others)
        if not isinstance(verdict, Reason) or verdict not in _STEEP:
            break
    return verdict


#: Verdicts that another lateral offset may change.
_LATERAL = frozenset({
    Reason.OFF_ROAD, Reason.MEETS_RECORDED, Reason.MEETS_GENERATED, Reason.LIMIT_JERK, Reason.LIMIT_YAW_ACCEL,
    Reason.LIMIT_YAW_RATE, Reason.LIMIT_CURVATURE, Reason.TTC_LANE_LEADER, Reason.TTC_AT_END, Reason.PET,
    Reason.SOLID_LINE,
})  # fmt: skip
#: Verdicts that a wider filter may change.
_STEEP = frozenset({
    Reason.LIMIT_ACCEL, Reason.LIMIT_DECEL, Reason.LIMIT_LONGITUDINAL_JERK, Reason.LIMIT_JERK, Reason.LIMIT_YAW_ACCEL,
})  # fmt: skip


def _placed(
    scene: Scene, vehicle: DrivenVehicle, motion: Motion, offset: LaneOffset, off_m: FloatArray, others: AgentStates
) -> ExportedVehicle | Reason:
    """At the first place in the lane that the judge accepts, farther aside from what it passes; or why at none."""
    verdict: ExportedVehicle | Reason = Reason.LIMIT_JERK  # replaced by that of the first try
    for share in _OFFSET_SHARES:
        own = offset.scaled(share)
        verdict = _checked_alone(scene, _at(scene, vehicle, motion, own, off_m), others)
        if not isinstance(verdict, Reason) or verdict not in _LATERAL:
            break
    if isinstance(verdict, Reason):
        return verdict
    room_m, side = _passes(verdict.states, others)
    tried = (_at(scene, vehicle, motion, own.shifted(-side * by_m), off_m) for by_m in _ASIDE_M if room_m < _PASSES_M)
    rooms = [(min(_passes(one.states, others)[0], _PASSES_M), one) for one in tried]
    for there_m, one in sorted(rooms, key=lambda found: -found[0]):  # the least shift of those with the most room
        if there_m > room_m and not isinstance(judged := _checked_alone(scene, one, others), Reason):
            return judged
    return verdict


def _at(scene: Scene, vehicle: DrivenVehicle, motion: Motion, offset: LaneOffset, off_m: FloatArray) -> ExportedVehicle:
    """A vehicle at a place in the lane, not judged."""
    path = trajectory(vehicle.path.line, motion, offset, vehicle.start.size.length_m)
    return as_exported(scene, vehicle, motion, path, off_m)


def together(scene: Scene, vehicles: Iterable[ExportedVehicle]) -> AgentStates:
    """Recorded agents and exported vehicles, in this order."""
    return scene.states.joined(*(one.states for one in vehicles))


def as_written(scene: Scene, vehicles: Iterable[ExportedVehicle]) -> AgentStates:
    """The same with the boxes that they have: a reader has no others to measure what is claimed of them."""
    each = (_inserted(scene, one.track(one.driven.vehicle_id, 1)) for one in vehicles)
    return scene.states_as_written.joined(*each)


def _reason(scene: Scene, findings: Iterable[Finding]) -> Reason | None:
    """Reason of the first finding; boxes that meet are told apart by their agents."""
    for one in findings:
        if one.quantity is Quantity.OVERLAP:
            return Reason.MEETS_RECORDED if one.other in scene.states.traffic.ids else Reason.MEETS_GENERATED
        return one.reason
    return None


def _checked_alone(scene: Scene, vehicle: ExportedVehicle, others: AgentStates) -> ExportedVehicle | Reason:
    """A vehicle that the judge has nothing against, with its least TTC; or the reason of its first finding.

    First what the choice of filter and place in the lane decides: motion, road, boxes. Then what it does to others on
    the path that it drives, and what follows its last step.
    """
    bounds, without, own = export_bounds(scene.config), scene.config.without, others.arrays.num_agents
    found = of_motion(vehicle.states, 0, bounds)
    if not {"collision", "topology"} & without:
        found = chain(found, of_road(vehicle.states, 0, vehicle.driven.start.size, bounds))
    verdict = _reason(scene, found)
    if verdict is not None or "collision" in without:
        return verdict or vehicle
    states = others.joined(vehicle.states)
    verdict = _boxes(scene, states)
    if verdict is not None:
        return verdict
    led = states.leaders_among(own, others.traffic, aside_m=bounds.spare_aside_m)
    found = chain(ttc_on_driven_path(states, own, led, bounds), of_end(states, own, np.arange(own), bounds))
    if "topology" not in without:
        found = chain(found, of_crossings(states, bounds, first_row=own))
    return _reason(scene, found) or replace(vehicle, min_ttc_s=float(led.ttc_s.min(initial=np.inf)))


def as_exported(
    scene: Scene, vehicle: DrivenVehicle, motion: Motion, path: Trajectory, off_m: FloatArray
) -> ExportedVehicle:
    """A vehicle with its states, as a reader has them; not judged."""
    states = states_of_inserted(scene, _track(vehicle, path, vehicle.vehicle_id, 1))
    return ExportedVehicle(vehicle, motion, path, off_m, float("inf"), states)


def states_of_inserted(scene: Scene, track: Track) -> AgentStates:
    """The states of an inserted track as the final check sees them, with its clearance box."""
    return _inserted(scene, replace(track, size=clearance_box(track.size, DEFAULT_SIZES[track.object_type])))


def _inserted(scene: Scene, track: Track) -> AgentStates:
    return agent_states(
        [track], scene.states.lanes, num_steps=scene.num_steps, step_s=scene.step_s, is_inserted=lambda _: True
    )


def _boxes(scene: Scene, states: AgentStates) -> Reason | None:
    """Whether the box of the last vehicle meets another one."""
    if "collision" in scene.config.without:
        return None
    own = states.arrays.num_agents - 1
    return _reason(scene, of_boxes(states, own, np.arange(own), spare_m=export_bounds(scene.config).spare_box_m))


def _passes(vehicle: AgentStates, others: AgentStates) -> tuple[float, float]:
    """Least room to the side of what a vehicle passes, m, inf where it passes nothing near by; its side, 1 for left.

    That is traffic of either direction, and whatever stands, at any angle.
    """
    own, traffic = vehicle.traffic, others.traffic
    forward = np.stack([np.cos(own.heading[0]), np.sin(own.heading[0])], axis=-1)
    apart_m = np.maximum(*(np.abs(traffic.position[..., axis] - own.position[0, :, axis]) for axis in (0, 1)))
    traffic = traffic.rows(np.flatnonzero((apart_m < _PASSES_NEAR_M).any(axis=1)).tolist())
    seen = gaps_from_poses(own.position[0], forward, BoxSize(own.length_m[0], own.width_m[0]), traffic)
    sine, cosine = np.abs(np.sin(traffic.heading - own.heading)), np.abs(np.cos(traffic.heading - own.heading))
    passes = own.present & traffic.present & (seen.gap_m < 0.0) & ((cosine > SAME_WAY) | (traffic.speed <= MOVES_MPS))
    if not passes.any():
        return math.inf, 0.0
    askew_m = 0.5 * (traffic.length_m[:, None] * sine - traffic.width_m[:, None] * (1.0 - cosine))
    room_m = np.where(passes, seen.aside_m - askew_m, np.inf)
    row, step = np.unravel_index(room_m.argmin(), room_m.shape)
    (ahead, left), (x, y) = forward[step], traffic.position[row, step] - own.position[0, step]
    return float(room_m[row, step]), math.copysign(1.0, ahead * y - left * x)


def conflicting(
    scene: Scene, exported: Sequence[ExportedVehicle], *, first_row: int = 0, allowed: Allowed | None = None
) -> list[tuple[int, Reason]]:
    """Rows of exported vehicles that are in conflict with others when all are looked at together, with the reason.

    Of two exported vehicles the later row: one that was kept before another one was driven did not react to that one.
    first_row: the first that is asked about; those before it have been looked at together; allowed: as `allowed_to`.
    """
    config, bounds = scene.config, export_bounds(scene.config)
    if len(exported) <= first_row or {"collision", "topology"} & config.without:
        return []
    states, first = together(scene, exported), scene.states.arrays.num_agents
    led, beyond_m = leaders(states), np.zeros(states.arrays.num_agents)
    beyond_m[first:] = [one.driven.start.beyond_m for one in exported]
    findings = [*ttc_on_lanes(states, led, bounds), *headways(states, led, beyond_m)]
    rows = first + np.arange(len(exported))
    findings += of_recorded_followers(states, rows[first_row:], bounds)
    for row in rows.tolist():
        # one that was kept has been looked at behind recorded agents
        others, recorded = (rows[rows != row], first) if row >= first + first_row else (rows[first_row:], 0)
        led_by = states.leaders_on_path(row, np.append(np.arange(recorded), others), aside_m=bounds.spare_aside_m)
        findings += ttc_on_driven_path(states, row, led_by, bounds)
        findings += headway_on_driven_path(states, row, led_by, beyond_m)
        findings += of_end(states, row, others, bounds)
    findings += of_crossings(states, bounds, first_row=first + first_row)
    row_of = {name: row for row, name in enumerate(states.arrays.track_ids[first:])}
    found: dict[int, Reason] = {}
    for one in findings:
        if one.value < (allowed or {}).get((one.other, one.quantity), math.inf):
            found.setdefault(max(row_of[one.track_id], row_of.get(one.other or "", -1)), one.reason)
    return sorted((row, reason) for row, reason in found.items() if row >= first_row)


def _grid_path(scene: Scene, vehicle: DrivenVehicle, s: FloatArray, v: FloatArray) -> Trajectory | None:
    """Without smoothing the paper exports the grid path: piecewise linear from cell centre to cell centre.

    None where there are no two cells.
    """
    knots: list[float] = []
    cells: list[int] = []
    for segment in vehicle.path.segments:
        if segment.end < s[0] - 10.0 or segment.start > s[-1] + 10.0:
            continue
        borders = scene.grid.edges_m[segment.lane_id]
        middles = 0.5 * (borders[1:] + borders[:-1])
        inside = np.flatnonzero((middles >= segment.lane_start) & (middles <= segment.lane_end))
        knots += [segment.s_at(middle) for middle in middles[inside].tolist()]
        cells += (scene.grid.index_of[Cell(segment.lane_id, 0)] + inside).tolist()
    if len(knots) < 2:
        return None
    at, centre = np.array(knots), scene.grid.centers[cells]
    place = np.clip(np.searchsorted(at, s, side="right") - 1, 0, at.size - 2)
    chord = centre[place + 1] - centre[place]
    share = ((s - at[place]) / (at[place + 1] - at[place]))[:, None]
    forward = chord / np.hypot(chord[:, 0], chord[:, 1])[:, None]
    return Trajectory(
        position=centre[place] + share * chord,
        heading=np.arctan2(forward[:, 1], forward[:, 0]),
        velocity=forward * v[:, None],
    )
