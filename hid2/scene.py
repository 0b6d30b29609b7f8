"""A scene as the method sees it: grid, recorded future, occupancy, speeds that belong there, and paths."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np

from hid2.agents import VEHICLE_TYPES, BoxSize, FloatArray, IntArray, Policy, Track
from hid2.conflicts.cases import DT_S, Prospect, kept_clear, prospect, road_most
from hid2.insertion.draws import Draws
from hid2.measures.lane_matching import flatten_lanes
from hid2.measures.surrogate_safety import RecordedVehicles
from hid2.motion.route import DrivenPath, Route, Way, path_along, route_beside, turn_segments, way_along
from hid2.occupancy.along_path import PathOccupancy, look_along
from hid2.occupancy.sigma import CellBoxes, OriginalOccupancy, cell_boxes, original_occupancy
from hid2.occupancy.traffic import Traffic, traffic_of
from hid2.params import Config
from hid2.policy.turns import RoadSpeeds, road_speeds
from netconvert.cells import Cell, CellGrid
from netconvert.geometry import differences

#: Cars, trucks and cars towing nothing drive on these.
DRIVABLE_TYPES = frozenset({"VEHICLE"})
_RUN_ON_M = 250.0
_MOVING_M, _MOVING_MPS = 5.0, 1.0


class _Recorded(NamedTuple):
    """Recorded agents on a path: rows of `traffic` that ever touch it; their intervals as they are, and kept clear."""

    rows: IntArray
    intervals: PathOccupancy
    kept_clear: PathOccupancy


class _Road(NamedTuple):
    """What the road says of speeds along a path: its shape, and (S,) m/s wished for at most, and possible at all."""

    speeds: RoadSpeeds
    fastest: FloatArray
    most: FloatArray


@dataclass(slots=True)
class World:
    """Everything about a scene that does not change while vehicles are inserted, and caches of what follows from it.

    earliest_exit_step: a generated vehicle may leave the map only from this step on. vehicles: the recorded cars and
    buses of `traffic`, which an overtaker may pass; others are obstacles to it. recorded: the same, as recorded.
    """

    grid: CellGrid
    config: Config
    traffic: Traffic
    vehicles: Traffic
    recorded: RecordedVehicles
    occupancy: OriginalOccupancy
    boxes: CellBoxes
    num_steps: int
    earliest_exit_step: int
    lane_speeds: dict[int, list[float]]
    scene_speeds: list[float]
    _ways: dict[Route, Way] = field(default_factory=dict)
    _paths: dict[Route, DrivenPath] = field(default_factory=dict)
    _routes_beside: dict[tuple[Route, int], Route] = field(default_factory=dict)
    _roads: dict[DrivenPath, _Road] = field(default_factory=dict)
    _known: dict[tuple[DrivenPath, BoxSize], _Recorded] = field(default_factory=dict)

    @property
    def road_tolerance_m(self) -> float:
        """By how much corners may stand out of the drivable area: a little less than what is allowed."""
        return 0.9 * self.config.limits.drivable_tolerance_m

    @property
    def curvature_most(self) -> float:
        """1 / R_min with a little to spare: whoever reads the positions sees chords, 1/m."""
        return 0.98 / self.config.limits.min_radius_m

    def packed(self) -> "World":
        """The same scene with the gaps of a packed road; itself, with all that is known, where it has them."""
        config = self.config.packed()
        return self if config == self.config else replace(self, config=config, _known={})

    def way(self, route: Route) -> Way:
        """A route with what is looked up along it; worked out once."""
        if route not in self._ways:
            self._ways[route] = way_along(self.grid.graph, route, self.recorded.lanes.index_of)
        return self._ways[route]

    def path(self, route: Route) -> DrivenPath:
        """Path on the middle of a route's lanes; built once."""
        if route not in self._paths:
            self._paths[route] = path_along(
                self.grid.graph, route, smoothing=self.config.smoothing, limits=self.config.limits,
                run_on_m=_RUN_ON_M if "topology" in self.config.without else 0.0,
            )  # fmt: skip
        return self._paths[route]

    def path_beside(self, own: Route, lane_id: int) -> DrivenPath:
        """Path of l', beside the lanes that are left of an own route; its route is looked for once."""
        key = own, lane_id
        if key not in self._routes_beside:
            lanes = self.grid.graph.lanes
            self._routes_beside[key] = route_beside(
                self.grid.graph, own, lane_id, usable=lambda n: lanes[n].lane_type in DRIVABLE_TYPES
            )
        return self.path(self._routes_beside[key])

    def recorded_on(self, path: DrivenPath, size: BoxSize) -> PathOccupancy:
        """Intervals of the recorded agents on a path, by their true future; computed once for each path and size."""
        return self._recorded_on(path, size).intervals

    def met_on(self, path: DrivenPath, size: BoxSize) -> IntArray:
        """Rows of `traffic` that a box on a path, with its margin, ever meets if it only waits for them."""
        return self._recorded_on(path, size).rows

    def _recorded_on(self, path: DrivenPath, size: BoxSize) -> _Recorded:
        key = path, size
        if key not in self._known:
            width_m = size.width_m + 2 * self.config.conflict.margin_lateral_m
            rows, found = look_along(path.line, self.traffic, size.length_m, width_m)
            steps, margin_m = kept_clear(self.config)
            self._known[key] = _Recorded(rows, found, found.kept_clear(steps, margin_m=margin_m))
        return self._known[key]

    def desired(self, path: DrivenPath, cruise_mps: float) -> FloatArray:
        """(S,) target speed along a path, m/s."""
        road = self._road(path)
        return road.fastest if cruise_mps == math.inf else self._desired(road.speeds, cruise_mps)

    def speeds(self, path: DrivenPath) -> RoadSpeeds:
        """What the road makes of anybody's speed along a path; worked out once."""
        return self._road(path).speeds

    def _road(self, path: DrivenPath) -> _Road:
        if path not in self._roads:
            segments = turn_segments(self.grid.graph, path)
            speeds = road_speeds(path.line, segments, turn=self.config.turn, limits=self.config.limits)
            self._roads[path] = _Road(speeds, self._desired(speeds, math.inf), road_most(path.line, self.config))
        return self._roads[path]

    def _desired(self, speeds: RoadSpeeds, cruise_mps: float) -> FloatArray:
        turn = self.config.turn
        return speeds.desired(
            cruise_mps,
            lateral_accel_mps2=turn.lateral_accel_mps2,
            accel_mps2=self.config.car_following.accel_mps2,
            approach_decel_mps2=turn.approach_decel_mps2,
        )

    def prospect(
        self,
        path: DrivenPath,
        size: BoxSize,
        *,
        cruise_mps: float,
        others: Sequence[Traffic],
        earliest_exit_step: int | None = None,
    ) -> Prospect:
        """Look along a path: the recorded agents and `others`."""
        return prospect(
            path,
            size,
            self.desired(path, cruise_mps),
            self._road(path).most,
            tuple(others),
            config=self.config,
            num_steps=self.num_steps,
            earliest_exit_step=self.earliest_exit_step if earliest_exit_step is None else earliest_exit_step,
            known=self._recorded_on(path, size).kept_clear,
            seen_to_s=path.grid_end_s if "topology" in self.config.without else None,
        )

    def cell_at(self, path: DrivenPath, s: float) -> Cell:
        """Cell of a path's lane at arc length s."""
        segment = path.segment_at(s)
        return self.grid.cell_at(segment.lane_id, segment.lane_s(s))

    def speed_sample(self, lane_id: int, draws: Draws) -> float:
        """Desired speed, m/s: from recorded moving traffic of the lane, else of the scene, else the prior."""
        spawn = self.config.spawn
        pool = self.lane_speeds.get(lane_id) or self.scene_speeds or [spawn.prior_speed_mps]
        speed = pool[draws.index(len(pool))] * (1.0 + spawn.speed_noise * draws.normal())
        return float(min(max(speed, spawn.min_speed_mps), spawn.max_speed_mps))


def build_world(
    grid: CellGrid, tracks: Sequence[Track], *, config: Config, num_steps: int, last_observed_step: int
) -> World:
    """World of a recorded scene. last_observed_step: every generated vehicle is there at least until then."""
    traffic = traffic_of(tracks, num_steps, step_s=DT_S)
    boxes = cell_boxes(grid)
    occupancy = original_occupancy(boxes, traffic)
    through = config.request.focal == "generated" or config.request.generated_category >= 2
    lane_speeds, scene_speeds = _speeds(grid, tracks, traffic, occupancy)
    rows = [row for row, track in enumerate(tracks) if track.object_type in VEHICLE_TYPES]
    return World(
        grid=grid,
        config=config,
        traffic=traffic,
        vehicles=traffic.rows(rows),
        recorded=RecordedVehicles([tracks[row] for row in rows], flatten_lanes(grid.graph), num_steps),
        occupancy=occupancy,
        boxes=boxes,
        num_steps=num_steps,
        earliest_exit_step=num_steps if through else min(last_observed_step + 2, num_steps),
        lane_speeds=lane_speeds,
        scene_speeds=scene_speeds,
    )


def _speeds(
    grid: CellGrid, tracks: Sequence[Track], traffic: Traffic, occupancy: OriginalOccupancy
) -> tuple[dict[int, list[float]], list[float]]:
    """Cruising speed (90th percentile while moving) of each moving vehicle: over the scene, and by lane driven on."""
    lane_of = np.array([cell.lane_id for cell in grid.cells])
    by_lane: dict[int, list[float]] = {}
    scene: list[float] = []
    for row, track in enumerate(tracks):
        if track.object_type not in VEHICLE_TYPES or track.category < 1 or track.path_m < _MOVING_M:
            continue
        speed = np.hypot(*traffic.velocity[row].T)
        moving = traffic.present[row] & (speed > _MOVING_MPS)
        if moving.sum() < 10:
            continue
        cruise = float(np.percentile(speed[moving], 90))
        scene.append(cruise)
        for lane_id in np.unique(lane_of[occupancy.cell[row, moving & occupancy.mapped[row]]]):
            by_lane.setdefault(int(lane_id), []).append(cruise)
    return by_lane, scene


@dataclass(frozen=True, eq=False, slots=True)
class PlannedVehicle:
    """A vehicle ready to be inserted: where, how fast, on which route, to do what.

    s0, v0: state of the box centre on the path at step 0; plan_s (T,) m, plan_v (T,) m/s: its motion on that path.
    intended_path, intended_s (T,) m: the same with its manoeuvre, as the others foresee it; sides: where it looks for a
    lane, in this order; claims: room beside that the others keep free for it.
    size: the larger of its own box and the one that readers without the sidecar assume; own_size is exported.
    """

    vehicle_id: str
    policy: Policy
    object_type: str
    size: BoxSize
    own_size: BoxSize
    route: Route
    path: DrivenPath
    s0: float
    v0: float
    cruise_mps: float
    trigger_s: float
    plan_s: FloatArray
    plan_v: FloatArray
    sides: tuple[Literal["left", "right"], ...]
    intended_path: DrivenPath
    intended_s: FloatArray
    claims: Traffic | None = None


def predicted_traffic(
    entries: Sequence[tuple[str, DrivenPath, BoxSize, FloatArray]], num_steps: int, *, first_step: int = 0
) -> Traffic:
    """Boxes of generated vehicles along their plans: (id, path, size, s (T - first_step,) m)."""
    count = len(entries)
    position = np.zeros((count, num_steps, 2))
    heading = np.zeros((count, num_steps))
    velocity = np.zeros((count, num_steps, 2))
    present = np.zeros((count, num_steps), dtype=np.bool_)
    for row, (_, path, size, s) in enumerate(entries):
        span = slice(first_step, first_step + s.size)
        position[row, span], tangent, _ = path.line.motion(s)
        heading[row, span] = np.arctan2(tangent[:, 1], tangent[:, 0])
        velocity[row, span] = tangent * differences(s[:, None], DT_S)
        present[row, span] = s <= path.exit_s - size.length_m / 2
    return Traffic(
        ids=tuple(entry[0] for entry in entries),
        position=position,
        heading=heading,
        velocity=velocity,
        present=present,
        length_m=np.array([entry[2].length_m for entry in entries]),
        width_m=np.array([entry[2].width_m for entry in entries]),
    )
