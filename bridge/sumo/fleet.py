"""The vehicles driven together: where they are, the paths they are on, and which agents they will meet there."""

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import InitVar, dataclass, field, replace
from typing import NamedTuple

import numpy as np

from bridge.sumo.poses import center_on_path
from hid2.agents import BoxSize, FloatArray, IntArray
from hid2.conflicts.guard import PRESENT, Braking, Guard, Obstacles, OwnMotion, S
from hid2.conflicts.reaction import yielding
from hid2.conflicts.stop_lines import StopLines
from hid2.drivers.driver import Driver
from hid2.kernels.steering import STRAIGHT
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.motion.route import DrivenPath, Jump
from hid2.occupancy.along_path import PathOccupancy, look_along
from hid2.occupancy.traffic import BoolArray, Traffic
from hid2.policy.roads import Roads
from hid2.scene import Scene
from hid2.vehicle import DrivenVehicle, Start


@dataclass(eq=False, slots=True)
class PathContext:
    """What is worked out once of a vehicle's present path; a vehicle that takes another path gets a new one.

    road (S,): m/s at the table of the path's line, what the road allows the driver; lane_ends: where its lanes end, m;
    policies: by lane, rows of `POLICIES`, what Algorithm 1 comes to there without a manoeuvre; in_width: as
    `Fleet.in_width` has it, None until first asked for; obstacles: the guard's, likewise; reroute_tried: whether
    another way has been looked for; jump: what SUMO jumped as the vehicle came onto the path, None before.
    """

    road: FloatArray
    lane_ends: FloatArray
    policies: IntArray
    in_width: PathOccupancy | None = None
    obstacles: Obstacles | None = None
    reroute_tried: bool = False
    jump: Jump | None = None


class LimitInputs(NamedTuple):
    """What limits a vehicle's speed on its path, or of several one after another, as `speed_limits` takes it.

    Metres along its path, of its centre; low, high: where the boxes of an agent and it meet, as in `PathOccupancy`.
    """

    road: FloatArray
    lane_ends: FloatArray
    lane_policies: IntArray
    low: FloatArray
    high: FloatArray
    along: FloatArray
    same_direction: BoolArray
    stop_m: FloatArray
    closed: BoolArray
    causes: IntArray
    others: IntArray
    swept: FloatArray


@dataclass(eq=False, slots=True)
class Fleet:
    """Vehicles that are driven together among recorded ones and those kept in rounds before.

    scene: where recorded vehicles react, a new one whenever one yields (`look_anew`); near_m:
    vehicles farther than this from another one on either axis do not look at it. By vehicle: state (N, 5): s m, v m/s,
    a m/s2, whether it executes a manoeuvre, whether it is there; along_m (N,) of the centre on the path, from its first
    step on, NaN for a vehicle nowhere; centre (N, 2) m, inf for a vehicle that is nowhere yet; length_m (N,) of the
    box; desired_mps (N, T); drivers (N, 4): as `Driver.following`; yielding (N,): whether a vehicle brakes for a
    conflict by now.
    """

    scene: Scene
    starts: InitVar[Sequence[Start]]
    kept: Traffic
    roads: Roads
    stop_lines: StopLines
    near_m: float = math.inf
    vehicles: list[DrivenVehicle] = field(init=False, default_factory=list)
    contexts: list[PathContext] = field(init=False, default_factory=list)
    state: FloatArray = field(init=False)
    along_m: FloatArray = field(init=False)
    centre: FloatArray = field(init=False)
    length_m: FloatArray = field(init=False)
    desired_mps: FloatArray = field(init=False)
    drivers: FloatArray = field(init=False)
    yielding: BoolArray = field(init=False)
    guard: Guard = field(init=False)
    _all_in_width: tuple[PathOccupancy, IntArray] | None = field(init=False, default=None)
    _limit_inputs: tuple[IntArray, LimitInputs] | None = field(init=False, default=None)

    def __post_init__(self, starts: Sequence[Start]) -> None:
        """No vehicle has moved yet."""
        self.guard = Guard(self.scene, self.kept, self.stop_lines)
        self.state, self.centre = np.zeros((0, 5)), np.zeros((0, 2))
        self.along_m, self.length_m = np.zeros(0), np.zeros(0)
        self.desired_mps, self.drivers = np.zeros((0, self.scene.num_steps)), np.zeros((0, 4))
        self.yielding = np.zeros(0, dtype=np.bool_)
        self.add(starts)

    def add(self, starts: Sequence[Start]) -> None:
        """Vehicles that have not moved yet."""
        if not starts:
            return
        count = len(starts)
        self.vehicles += [DrivenVehicle(start=start, path=start.path) for start in starts]
        self.contexts += [self._context(start.path, start.driver) for start in starts]
        self.state = np.concatenate([self.state, np.zeros((count, 5))])
        self.centre = np.concatenate([self.centre, np.full((count, 2), np.inf)])
        self.along_m = np.concatenate([self.along_m, np.full(count, np.nan)])
        self.length_m = np.concatenate([self.length_m, [start.box.length_m for start in starts]])
        self.desired_mps = np.concatenate([self.desired_mps, [one.desired[: self.scene.num_steps] for one in starts]])
        self.drivers = np.concatenate([self.drivers, [start.driver.following for start in starts]])
        self.yielding = np.concatenate([self.yielding, np.zeros(count, dtype=np.bool_)])
        self.forget_obstacles()  # all vehicles see the new ones

    def begin(self, row: int) -> None:
        """A vehicle is at its start now."""
        start = self.vehicles[row].start
        self.move(row, start.start_m, start.start_mps)
        self._limit_inputs = None

    def move(self, row: int, s: float, speed_mps: float, *, jumped_m: float = 0.0) -> None:
        """Add a state: s of its centre on its path, m, which is jumped_m ahead of SUMO's own place."""
        vehicle, context = self.vehicles[row], self.contexts[row]
        before = vehicle.v[-1] if vehicle.v else speed_mps
        vehicle.s.append(s)
        vehicle.v.append(speed_mps)
        vehicle.jumped_m.append(jumped_m)
        spans = vehicle.path.lateral_spans
        # executing goes before pending (conflict case 2): in a change of lanes or in a turn
        turns = context.policies[bisect_right(context.lane_ends, s, hi=context.lane_ends.size - 1)] != STRAIGHT
        executing = (spans and spans[-1].begin < s < spans[-1].end) or turns
        self.along_m[row], self.centre[row] = s, _xy(vehicle)
        self.state[row] = s, speed_mps, (speed_mps - before) / self.scene.step_s, executing, 1.0

    def update_from_sumo(self, row: int, lane: str, front_m: float, speed_mps: float) -> None:
        """Add the state that SUMO has now: the front bumper front_m along a lane, at a speed.

        SUMO puts a vehicle that changes lanes into the cell beside, as far along: the arc length jumps. On its new path
        it goes on from where it was; its lead over SUMO's place fades out (`Jump`). Where SUMO has it on no lane of
        the path, as at a split that it takes otherwise, it goes on as it was.
        """
        vehicle, context = self.vehicles[row], self.contexts[row]
        # by the mean speed, as SUMO's ballistic step; its Euler step, where no agent is replayed, is millimetres off
        steady = vehicle.s[-1] + 0.5 * (vehicle.v[-1] + speed_mps) * self.scene.step_s
        own = center_on_path(
            self.scene.grid, vehicle.path, lane, front_m, length_m=vehicle.start.size.length_m, after=vehicle.s[-1]
        )
        if own is None:
            own = steady - vehicle.jumped_m[-1]
        if context.jump is None:
            context.jump = Jump.onto(vehicle.path, own, steady - own)
        jumped = float(context.jump.left_m(own))
        self.move(row, own + jumped, speed_mps, jumped_m=jumped)

    def leave(self, row: int) -> None:
        """A vehicle is nowhere any more."""
        self.state[row, PRESENT], self.centre[row], self.along_m[row] = 0.0, np.inf, np.nan
        self._limit_inputs = None

    def traffic(self) -> Traffic:
        """The vehicles that are driven, where the simulation has them now (one step)."""
        rows = [row for row, vehicle in enumerate(self.vehicles) if vehicle.running and vehicle.s]
        position, heading, velocity = np.zeros((len(rows), 1, 2)), np.zeros((len(rows), 1)), np.zeros((len(rows), 1, 2))
        for k, row in enumerate(rows):
            vehicle = self.vehicles[row]
            xy, tangent, _ = vehicle.path.line.motion(np.array([vehicle.s[-1]]))
            position[k], heading[k, 0] = xy, np.arctan2(tangent[0, 1], tangent[0, 0])
            velocity[k] = tangent * vehicle.v[-1]
        return Traffic(
            ids=tuple(self.vehicles[row].vehicle_id for row in rows), position=position, heading=heading,
            velocity=velocity, present=np.ones((len(rows), 1), dtype=np.bool_), length_m=self.length_m[rows],
            width_m=np.array([self.vehicles[row].start.box.width_m for row in rows]),
        )  # fmt: skip

    def _context(self, path: DrivenPath, driver: Driver) -> PathContext:
        return PathContext(self.roads.speeds(path, driver), *self.roads.lanes(path))

    def take_path(self, row: int, path: DrivenPath, s: FloatArray | None = None) -> None:
        """A vehicle takes another path now. s (K,) m: where it has been on it since its start; None: as before."""
        vehicle = self.vehicles[row]
        vehicle.path, self.contexts[row] = path, self._context(path, vehicle.start.driver)
        if s is not None:
            vehicle.s[:] = s.tolist()
            self.state[row, S] = self.along_m[row] = s[-1]
        self.forget_obstacles()  # all vehicles see the new intention

    def look_anew(self, scene: Scene) -> None:
        """Recorded vehicles will be elsewhere than was known: nothing that was worked out of it holds any more."""
        self.scene = self.guard.scene = scene
        for context in self.contexts:
            context.in_width = None
        self.forget_obstacles()

    def forget_obstacles(self) -> None:
        """What is on the paths is worked out anew at the next use."""
        self._all_in_width = self._limit_inputs = None
        for context in self.contexts:
            context.obstacles = None

    @property
    def recorded_and_kept(self) -> Traffic:
        """All agents with a known future, recorded, then kept, up to the scene's end."""
        return self.scene.traffic.joined(self.kept.span(slice(self.scene.num_steps)))

    def in_width(self, row: int) -> PathOccupancy:
        """Intervals of known agents that reach into the width that a vehicle drives on its path, no margins."""
        context = self.contexts[row]
        if context.in_width is None:
            path, box = self.vehicles[row].path, self.vehicles[row].start.box
            kept = look_along(path.line, self.kept, box.length_m, box.width_m)
            context.in_width = self.scene.with_inserted(self.scene.in_driving_width(path, box), kept)
        return context.in_width

    @property
    def all_in_width(self) -> tuple[PathOccupancy, IntArray]:
        """The same of all vehicles, one after another, and where those of each begin, (N + 1,)."""
        if self._all_in_width is None:
            each = [self.in_width(row) for row in range(len(self.vehicles))]
            every = PathOccupancy.none(self.scene.future.num_steps).joined(*each)
            self._all_in_width = every, np.cumsum([0, *(found.agents.size for found in each)])
        return self._all_in_width

    @property
    def here(self) -> IntArray:
        """Rows of the vehicles that have a place on the road now."""
        return np.flatnonzero(self.state[:, PRESENT])

    def limit_inputs(self, now: int) -> tuple[IntArray, LimitInputs]:
        """Where the inputs of each vehicle that is `here` begin, (M + 1, 6), and all inputs, one vehicle after another.

        The six: the road's table, its lanes, known agents, stop lines, other vehicles, and what those sweep.
        """
        if self._limit_inputs is None or self.scene.config.driving.replay != "fixed":
            each = [self._limit_inputs_of(row, now) for row in self.here.tolist()]
            parts = ((one.road, one.lane_ends, one.low, one.stop_m, one.others, one.swept) for one in each)
            first = np.cumsum([[0] * 6, *([len(part) for part in own] for own in parts)], axis=0, dtype=np.int64)
            self._limit_inputs = first, LimitInputs(*(np.concatenate(column) for column in zip(*each, strict=True)))
        return self._limit_inputs

    def _limit_inputs_of(self, row: int, now: int) -> LimitInputs:
        context, path = self.contexts[row], self.vehicles[row].path
        seen = self._without_those_that_yield(self.obstacles(row, path), row, path, now)
        known, lines = seen.known, seen.lines
        return LimitInputs(
            context.road, context.lane_ends, context.policies, known.low, known.high, known.along, known.same_direction,
            lines.stops_m(self.vehicles[row].start.driver), lines.closed, lines.cause, seen.rows, seen.swept.ravel(),
        )  # fmt: skip

    def braking(
        self, row: int, path: DrivenPath, now: int, state: tuple[float, float, float], horizon_s: float | None = None
    ) -> Braking:
        """What the guard predicts for a vehicle from a state (s m, v m/s, a m/s2) at step `now`, on any path.

        horizon_s: another one than `conflict.horizon_s`.
        """
        vehicle = self.vehicles[row]
        obstacles = self._without_those_that_yield(self.obstacles(row, path), row, path, now)
        road = self.contexts[row].road if path is vehicle.path else self.roads.speeds(path, vehicle.start.driver)
        going = OwnMotion(state, float(vehicle.start.desired[now]), road, vehicle.start.driver)
        return self.guard.braking(obstacles, going, now, self.state, own=row, horizon_s=horizon_s)

    def obstacles(self, row: int, path: DrivenPath) -> Obstacles:
        """All agents on a path for a vehicle; what is on its own one is worked out once."""
        context, own = self.contexts[row], path is self.vehicles[row].path
        if own and context.obstacles is not None:
            return context.obstacles
        found = self.guard.obstacles(path, self.vehicles[row].start.box, self._others(row))
        if own:
            context.obstacles = found
        return found

    def _others(self, row: int) -> list[tuple[int, DrivenPath, BoxSize]]:
        """Rows of the other vehicles that SUMO has or will have, with their paths and boxes."""
        found = [(other, one) for other, one in enumerate(self.vehicles) if other != row and one.running]
        if self.near_m < math.inf:
            own = _xy(self.vehicles[row])
            found = [(other, one) for other, one in found if np.abs(_xy(one) - own).max() < self.near_m]
        return [(other, one.path, one.start.box) for other, one in found]

    def _without_those_that_yield(self, obstacles: Obstacles, row: int, path: DrivenPath, now: int) -> Obstacles:
        """Where recorded vehicles react: without recorded followers that can yield to the vehicle."""
        if self.scene.config.driving.replay == "fixed":
            return obstacles
        vehicle, known = self.vehicles[row], obstacles.known
        recorded = np.flatnonzero(known.agents < self.scene.num_recorded)
        xy, tangent, _ = vehicle.path.line.motion(np.array([vehicle.s[-1]]))
        yields = yielding(
            self.scene, known.agents[recorded], now, xy=xy[0], forward=tangent[0],
            half_m=0.5 * vehicle.start.box.length_m, speed_mps=vehicle.v[-1],
        )  # fmt: skip
        low = known.low.copy()
        low[recorded[yields]] = np.inf
        return replace(obstacles, known=known._replace(low=low))


def _xy(vehicle: DrivenVehicle) -> FloatArray:
    """Where a vehicle is, or starts, (2,) m."""
    s = vehicle.s[-1] if vehicle.s else vehicle.start.start_m
    table = vehicle.path.line.table_xy
    return np.asarray(table[min(max(int(s / TABLE_STEP_M), 0), len(table) - 1)])
