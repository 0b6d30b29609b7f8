"""Observe, decide, act, step: vehicles driven by SUMO's car following and steered by Algorithm 1 through libsumo."""

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bridge.sumo.poses import front_arc_m
from bridge.sumo.replay import Replay, ReplayErrors
from bridge.sumo.shown import may_change, shown_when
from bridge.sumo.simulation import Simulation
from hid2.agents import BoxSize, FloatArray, IntArray, Policy
from hid2.conflicts.guard import PRESENT, A, Braking, Guard, Obstacles, S, V
from hid2.conflicts.reaction import Reactions, yielding
from hid2.conflicts.stop_lines import StopLines
from hid2.insertion.sites import entry_speed
from hid2.kernels.leaders import deep_inside, shown_ahead
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.motion.route import DrivenPath
from hid2.occupancy.along_path import PathOccupancy, look_along
from hid2.occupancy.traffic import BoolArray, Traffic
from hid2.policy.decision import LaneOption, Observation, Side, decide, policy_on
from hid2.policy.observation import gap_ahead_of, gaps_on, lane_options, lay_across, leader_on, returns_to
from hid2.policy.overtake import Leader, Stage
from hid2.policy.reroute import places_on, ways_at_next_split
from hid2.policy.roads import Roads
from hid2.policy.rules import SumoAnswer
from hid2.reasons import Reason
from hid2.scene import Scene
from hid2.vehicle import DrivenVehicle, GapLook, Shift, Start
from netconvert.cells import Cell

_BINDS_MPS = 0.05  # book-keeping: a limit this close to the speed driven is what decided it
_TURN_AHEAD_S = 4.0  # book-keeping: a limit this long before a turn lane is put down to the turn
#: Refusals of a gap in which waiting for those beside to go ahead helps.
_LETS_PASS = frozenset({Reason.CELLS_OCCUPIED, Reason.FRONT_GAP})
#: Who is held to a speed would like to drive so much faster, m/s: a leader at a usual gap does not slow it then.
_HELD_MPS = 5.0
_ACROSS_MORE_S = 0.5  # it is looked at for so long beyond its change of lanes
#: No tunable, spares time: how often it is looked who is in a recorded agent's box, s, and so deep, m, that the last
#: check lets nobody pass: smoothing moves nobody so far.
_STRUCK_EVERY_S, _STRUCK_M = 0.5, 2.0


@dataclass(eq=False, slots=True)
class _Attempt:
    """A lane change that SUMO has been asked for at a step."""

    vehicle: DrivenVehicle
    look: int
    path: DrivenPath
    target: DrivenPath
    lane: str
    shift: Shift
    stage: Stage


@dataclass(frozen=True, eq=False, slots=True)
class _Lanes:
    """The lanes along a path: where each ends, m, and what Algorithm 1 comes to on it without a manoeuvre."""

    ends: list[float]
    policies: list[Policy]
    only: Policy | None
    """The one of all its lanes, None where they differ."""

    def policy_at(self, s: float) -> Policy:
        """Of the lane at an arc length, m."""
        return self.only or self.policies[min(bisect_right(self.ends, s), len(self.ends) - 1)]


@dataclass(frozen=True, eq=False, slots=True)
class _Ahead:
    """Everybody whose future is known on the ways of all vehicles, those of one after those of another.

    low .. crossing (R, T): as in `PathOccupancy`; agents (R,): recorded, then kept ones; first (N + 1,): rows by
    vehicle.
    """

    low: FloatArray
    high: FloatArray
    along: FloatArray
    same_direction: BoolArray
    crossing: BoolArray
    agents: IntArray
    first: IntArray


@dataclass(eq=False, slots=True)
class _Lazy:
    """The fleet as it is now, put together when somebody first asks."""

    make: Callable[[], Traffic]
    _made: Traffic | None = None

    @property
    def value(self) -> Traffic:
        """The same for all who ask at this step."""
        if self._made is None:
            self._made = self.make()
        return self._made


@dataclass(eq=False, slots=True)
class Driving:
    """One simulation of vehicles, each from its own first step on, among recorded ones and those kept in rounds before.

    checked: all recorded agents are replayed at all steps, and their poses in SUMO compared; else those who have to be
    shown to a vehicle, when they have to. Where recorded vehicles react, `scene` becomes another one with each that
    yields, and `reactions` says how late they are.
    """

    scene: Scene
    simulation: Simulation
    starts: Sequence[Start]
    fixed: Traffic
    roads: Roads
    stop_lines: StopLines
    checked: bool = True
    vehicles: list[DrivenVehicle] = field(init=False)
    replay_errors: ReplayErrors = field(init=False)
    reactions: Reactions | None = field(init=False, default=None)
    _guard: Guard = field(init=False)
    _state: FloatArray = field(init=False)
    _obstacles: list[Obstacles | None] = field(init=False)
    _known: list[tuple[PathOccupancy, IntArray] | None] = field(init=False)
    _ahead: _Ahead | None = field(init=False, default=None)
    _place: FloatArray = field(init=False)
    _centre: FloatArray = field(init=False)
    _own_lengths: FloatArray = field(init=False)
    _road: list[FloatArray] = field(init=False)
    _lanes: list[_Lanes] = field(init=False)
    _edge: dict[Cell, tuple[str, int]] = field(init=False, default_factory=dict)
    _lengths: FloatArray = field(init=False)
    _limit: list[tuple[float, str] | None] = field(init=False)
    _reroutes_tried: list[DrivenPath | None] = field(init=False)
    _recorded: Replay = field(init=False)
    _kept: Replay = field(init=False)

    def __post_init__(self) -> None:
        """Nobody has moved yet."""
        self.vehicles = [DrivenVehicle(start=start, path=start.path) for start in self.starts]
        self._guard = Guard(self.scene, self.fixed, self.stop_lines)
        self._state = np.zeros((len(self.starts), 5))
        self._obstacles = [None] * len(self.starts)
        self._lengths = np.concatenate([self.scene.traffic.length_m, self.fixed.length_m])
        self._known = [None] * len(self.starts)
        self._place = np.array([np.nan if start.step > 0 else start.start_s for start in self.starts], dtype=np.float64)
        self._centre = np.full((len(self.starts), 2), np.inf)
        self._own_lengths = np.array([start.box.length_m for start in self.starts])
        self._road = [self.roads.speeds(start.path, start.driver) for start in self.starts]
        self._lanes = [self._lanes_of(start.path) for start in self.starts]
        self._limit = [None] * len(self.starts)
        self._reroutes_tried = [None] * len(self.starts)

    def _lanes_of(self, path: DrivenPath) -> _Lanes:
        lanes = self.scene.grid.graph.lanes
        policies = [policy_on(lanes[segment.lane_id].turn) for segment in path.segments]
        only = policies[0] if len(set(policies)) == 1 else None
        return _Lanes([segment.end for segment in path.segments], policies, only)

    def run(self) -> list[DrivenVehicle]:
        """All steps of the scene; a vehicle's first state is its start."""
        scene, simulation, step_s = self.scene, self.simulation, self.scene.step_s
        simulation.rewind()
        everybody = self.checked or scene.config.driving.replay != "fixed"  # who reacts is anywhere
        there, there_kept = (scene.traffic, self.fixed) if everybody else self._shown()
        recorded = self._recorded = Replay(simulation, there, "r", step_s=step_s, checked=self.checked)
        kept = self._kept = Replay(simulation, there_kept, "k", step_s=step_s, checked=False)
        for back in (2, 1):
            recorded.warm_up(back)
            if self.fixed.ids:
                kept.warm_up(back)
            simulation.step()
        reactions, look = self._reactions(recorded), scene.steps_in(_STRUCK_EVERY_S)
        fails = reactions is None and "collision" not in scene.config.without  # who is run into
        for step in range(scene.num_steps):
            attempts: list[_Attempt] = []
            if step > 0:
                if fails and step % look == 0:
                    self._take_out_struck(step - 1)
                fleet = _Lazy(self._fleet)
                if reactions is not None and reactions.advance(step, self._generated(step - 1, fleet)):
                    self._look_anew(reactions.scene)
                    recorded.take(self.scene.traffic)
                for row, vehicle in enumerate(self.vehicles):
                    if vehicle.running and step > vehicle.start.step:
                        attempts += self._steer(row, vehicle, step - 1, fleet)
            for row, start in enumerate(self.starts):
                if start.step == step:  # SUMO has to have shown who is ahead of it by now
                    self._place[row] = start.start_s
            seen, seen_kept = self._seen(step)
            recorded.place(step, seen)
            if self.fixed.ids:
                kept.place(step, seen_kept)
            simulation.step()
            self._enter(step)
            recorded.check(step)
            self._read(step)
            for attempt in attempts:
                self._conclude(attempt, step)
        self.replay_errors, self.reactions = recorded.errors, reactions
        return self.vehicles

    def _shown(self) -> tuple[Traffic, Traffic]:
        """Recorded agents and those kept, present only while SUMO may have to be shown them."""
        scene, count = self.scene, len(self.scene.traffic.ids)
        everybody = [self._known_of(row) for row in range(len(self.starts))]
        shown = []
        for traffic, first in ((scene.traffic.first(scene.num_steps), 0), (self.fixed.first(scene.num_steps), count)):
            if first == count and any(may_change(start) for start in self.starts):  # few, and any may come to lead
                shown.append(traffic)
                continue
            last, known = first + len(traffic.ids), []
            for found, rows in everybody:
                here = (rows >= first) & (rows < last)
                known.append((rows[here] - first, found.rows(here)))
            present = shown_when(traffic, self.starts, known, step_s=scene.step_s, driving=scene.config.driving)
            shown.append(replace(traffic, present=present))
        return shown[0], shown[1]

    def _reactions(self, recorded: Replay) -> Reactions | None:
        """The recorded vehicles as those who react, each by SUMO's car following of its replayed vehicle."""
        if self.scene.config.driving.replay == "fixed":
            return None

        def follow_mps(row: int, speed_mps: float, gap_m: float, leader_mps: float) -> float:
            name = recorded.name(row)
            return self.simulation.follow_speed(name, speed_mps, gap_m=gap_m, leader_mps=leader_mps)

        return Reactions(self.scene, follow_mps)

    def _generated(self, step: int, fleet: _Lazy) -> Traffic:
        """All generated vehicles at a step (one step): those kept in rounds before, and those driven now."""
        return self.fixed.at(step).joined(fleet.value) if self.fixed.ids else fleet.value

    def _look_anew(self, scene: Scene) -> None:
        """Recorded vehicles will be elsewhere than was known: nothing that was worked out of it holds any more."""
        self.scene = self._guard.scene = scene
        self._known, self._ahead = [None] * len(self.vehicles), None
        self._obstacles = [None] * len(self.vehicles)

    def _enter(self, step: int) -> None:
        """Insert whoever begins; after the step, so that the state of its first step is the start."""
        for row, start in enumerate(self.starts):
            if start.step != step:
                continue
            vehicle = self.vehicles[row]
            speed: float | None = start.start_mps
            if step > 0 and "collision" not in self.scene.config.without:
                speed = entry_speed(start, self._fleet(), self.scene.config, step_s=self.scene.step_s)
            if speed is None:
                vehicle.objection = Reason.NO_ROOM_AT_EDGE
            else:
                vehicle.start = replace(start, start_mps=speed)
                vehicle.objection = insert(self.simulation, self.scene, vehicle.start)
            if vehicle.objection is not None:
                self._place[row] = np.nan

    def _read(self, step: int) -> None:
        """Take down what SUMO did, and which limit decided it."""
        inside, step_s = self.simulation.driven(), self.scene.step_s
        for row, vehicle in enumerate(self.vehicles):
            if not vehicle.running or step < vehicle.start.step:
                continue
            if vehicle.vehicle_id not in inside:
                if not vehicle.s:
                    vehicle.objection = Reason.SUMO_REFUSES_INSERTION
                else:
                    vehicle.left_at = step
                self._forget(row)
                continue
            if not vehicle.s:
                speed, s = vehicle.start.start_mps, vehicle.start.start_s
            else:
                speed = self.simulation.speed(vehicle.vehicle_id)
                s = vehicle.s[-1] + speed * step_s  # SUMO moves by the new speed (Euler)
                limit = self._limit[row]
                if limit is not None and speed > limit[0] - _BINDS_MPS:
                    vehicle.limited[limit[1]] += 1
            before = vehicle.v[-1] if vehicle.v else speed
            vehicle.s.append(s)
            vehicle.v.append(speed)
            table = vehicle.path.line.table_xy
            self._place[row], self._centre[row] = s, table[min(int(s / TABLE_STEP_M), len(table) - 1)]
            self._state[row] = s, speed, (speed - before) / step_s, self._is_executing(row, vehicle.path, s), 1.0

    def _forget(self, row: int) -> None:
        """It is nowhere any more."""
        self._state[row, PRESENT], self._centre[row], self._place[row] = 0.0, np.inf, np.nan

    def _take_out_struck(self, step: int) -> None:
        """Take out who is in a recorded agent's box, mostly as that does not brake: it will not be exported.

        Others need not mind it any more.
        """
        if self._ahead is None:
            self._ahead = self._look_ahead()
        here, scene, traffic = self._ahead, self.scene, self.scene.traffic
        struck = deep_inside(
            here.low, here.high, here.agents, here.first, len(traffic.ids), step, self._place[: len(self.vehicles)],
            _STRUCK_M,
        )  # fmt: skip
        for row, agent in zip(*(column.tolist() for column in struck), strict=True):
            vehicle = self.vehicles[row]
            xy, tangent, _ = vehicle.path.line.motion(np.array([vehicle.s[-1]]))
            (tx, ty), (dx, dy) = tangent[0], traffic.position[agent, step] - xy[0]
            room = 0.5 * (vehicle.start.box.width_m + traffic.width_m[agent]) - scene.config.drivers.offset_max_m
            if vehicle.running and abs(tx * dy - ty * dx) < room:  # wherever in its lane it is
                vehicle.objection = Reason.MEETS_RECORDED
                self.simulation.remove(vehicle.vehicle_id)
                self._forget(row)

    def _is_executing(self, row: int, path: DrivenPath, s: float) -> bool:
        """Whether a vehicle is changing lanes or in a turn: case 2, executing goes before pending."""
        if path.shifts and path.shifts[-1][0] < s < path.shifts[-1][1]:
            return True
        return self._lanes[row].policy_at(s) is not Policy.STRAIGHT

    def _seen(self, step: int) -> tuple[dict[int, tuple[str, int]], dict[int, tuple[str, int]]]:
        """Whom SUMO's car following is shown, recorded and kept: row -> edge and lane index of its place on the way.

        Those whose boxes reach into the driving width on the present way of some vehicle and who move along it or
        stand. Who crosses is the guard's business: to SUMO it would appear out of nowhere.
        """
        recorded: dict[int, tuple[str, int]] = {}
        kept: dict[int, tuple[str, int]] = {}
        if "collision" in self.scene.config.without:
            return recorded, kept
        if self._ahead is None:
            self._ahead = self._look_ahead()
        driving, here, count = self.scene.config.driving, self._ahead, len(self.scene.traffic.ids)
        found = shown_ahead(
            here.low, here.high, here.along, here.same_direction, here.crossing, here.agents, here.first, self._lengths,
            self.scene.traffic.position, self.fixed.position, step, self._place[: len(self.vehicles)],
            self._centre, self._own_lengths, (driving.standing_mps, driving.leads_from_m, driving.shown_m),
        )  # fmt: skip
        for agent, row, middle in zip(*(column.tolist() for column in found), strict=True):
            where = self._edge_of(self.scene.cell_at(self.vehicles[row].path, middle))
            (recorded if agent < count else kept)[agent if agent < count else agent - count] = where
        return recorded, kept

    def _edge_of(self, cell: Cell) -> tuple[str, int]:
        """SUMO edge and lane index of a cell."""
        if cell not in self._edge:
            self._edge[cell] = self.scene.grid.edge_id(cell), self.scene.grid.lane_index(cell)
        return self._edge[cell]

    def _look_ahead(self) -> _Ahead:
        """Everybody known on the present ways of all."""
        known = [self._known_of(row) for row in range(len(self.vehicles))]
        nobody = PathOccupancy.nobody(self.scene.future.num_steps)
        every = nobody.joined(*(found for found, _ in known))
        first = np.concatenate([[0], np.cumsum([rows.size for _, rows in known])]).astype(np.int64)
        agents = np.concatenate([np.zeros(0, dtype=np.int64), *(rows for _, rows in known)])
        return _Ahead(every.low, every.high, every.along, every.same_direction, every.crossing, agents, first)

    def _known_of(self, row: int) -> tuple[PathOccupancy, IntArray]:
        """Intervals of everybody whose future is known on a vehicle's path, and rows (recorded, then kept)."""
        known = self._known[row]
        if known is None:
            vehicle = self.vehicles[row]
            path, box = vehicle.path, vehicle.start.box
            rows, found = self.scene.in_driving_width(path, box)
            if self.fixed.ids:
                kept_rows, more = look_along(path.line, self.fixed, box.length_m, box.width_m)
                found = found.joined(more)
                rows = np.concatenate([rows, kept_rows + len(self.scene.traffic.ids)])
            known = self._known[row] = found, rows
        return known

    def _fleet(self) -> Traffic:
        """The vehicles that are driven, where the simulation has them now (one step)."""
        rows = [row for row, vehicle in enumerate(self.vehicles) if vehicle.running and vehicle.s]
        position, heading, velocity = np.zeros((len(rows), 1, 2)), np.zeros((len(rows), 1)), np.zeros((len(rows), 1, 2))
        for place, row in enumerate(rows):
            vehicle = self.vehicles[row]
            xy, tangent, _ = vehicle.path.line.motion(np.array([vehicle.s[-1]]))
            position[place], heading[place, 0] = xy, np.arctan2(tangent[0, 1], tangent[0, 0])
            velocity[place] = tangent * vehicle.v[-1]
        return Traffic(
            ids=tuple(self.vehicles[row].vehicle_id for row in rows), position=position, heading=heading,
            velocity=velocity, present=np.ones((len(rows), 1), dtype=np.bool_),
            length_m=np.array([self.vehicles[row].start.box.length_m for row in rows]),
            width_m=np.array([self.vehicles[row].start.box.width_m for row in rows]),
        )  # fmt: skip

    def _steer(self, row: int, vehicle: DrivenVehicle, now: int, fleet: "_Lazy") -> list[_Attempt]:
        """Decide at step `now`, limit the speed where SUMO is blind, and pass both on for the coming step."""
        s, v, driving, step_s = vehicle.s[-1], vehicle.v[-1], self.scene.config.driving, self.scene.step_s
        if vehicle.path.shifts and vehicle.stage in (Stage.ENTER, Stage.RETURN) and s >= vehicle.path.shifts[-1][1]:
            passing = vehicle.stage is Stage.ENTER and vehicle.policy is Policy.OVERTAKE
            vehicle.stage = Stage.PASS if passing else Stage.DONE
        attempts = self._decide(row, vehicle, now, fleet)
        desired = float(vehicle.start.desired[now])
        limits = [(self._road_speed(row, s, v), "turn" if self._turns(row, s, v) else "curve")]
        if "collision" not in self.scene.config.without:
            limits += self._guarded(row, vehicle, now, desired)
        if vehicle.stage is Stage.WAITING and vehicle.reason in _LETS_PASS:
            limits.append((max(driving.let_pass_share * desired, v - driving.let_pass_mps2 * step_s), "gap"))
        limit = min(limits)
        self._limit[row] = limit if limit[0] < desired - 1e-3 else None
        held = self._limit[row]
        limit_mps = None if held is None else max(0.0, held[0])
        if vehicle.start.is_held:
            limit_mps, desired = desired if limit_mps is None else min(limit_mps, desired), desired + _HELD_MPS
        self.simulation.drive(vehicle.vehicle_id, desired_mps=desired, limit_mps=limit_mps)
        return attempts

    def _road_speed(self, row: int, s: float, v: float) -> float:
        road = self._road[row]
        return float(road[min(int((s + v * self.scene.step_s) / TABLE_STEP_M), road.size - 1)])

    def _turns(self, row: int, s: float, v: float) -> bool:
        """Whether it is in a turn lane or slows down for one."""
        lanes = self._lanes[row]
        return (
            lanes.policy_at(s) is not Policy.STRAIGHT or lanes.policy_at(s + _TURN_AHEAD_S * v) is not Policy.STRAIGHT
        )

    def _obstacles_of(self, row: int) -> Obstacles:
        known = self._obstacles[row]
        if known is None:
            vehicle = self.vehicles[row]
            known = self._guard.obstacles(vehicle.path, vehicle.start.box, self._others(row))
            self._obstacles[row] = known
        return known

    def _who_does_not_yield(self, obstacles: Obstacles, row: int, path: DrivenPath, now: int) -> Obstacles:
        """Where recorded vehicles react: without those behind a vehicle who can yield to it."""
        if self.scene.config.driving.replay == "fixed":
            return obstacles
        vehicle = self.vehicles[row]
        rows = self.scene.rows_on(path, vehicle.start.box)
        xy, tangent, _ = vehicle.path.line.motion(np.array([vehicle.s[-1]]))
        yields = yielding(
            self.scene, rows, now, xy=xy[0], forward=tangent[0], half_m=0.5 * vehicle.start.box.length_m,
            speed_mps=vehicle.v[-1],
        )  # fmt: skip
        known = obstacles.known
        low = known.low.copy()
        low[: rows.size][yields] = np.inf
        return replace(obstacles, known=replace(known, low=low))

    def _others(self, row: int) -> list[tuple[int, DrivenPath, BoxSize]]:
        """Rows of the other vehicles that SUMO has or will have, with their paths and boxes."""
        return [
            (other, one.path, one.start.box) for other, one in enumerate(self.vehicles) if other != row and one.running
        ]

    def _guarded(self, row: int, vehicle: DrivenVehicle, now: int, desired: float) -> list[tuple[float, str]]:
        """Limits of the guard for the coming step: predicted conflicts (case 3, timing)."""
        state = (float(self._state[row, S]), float(self._state[row, V]), float(self._state[row, A]))
        driving, step_s = self.scene.config.driving, self.scene.step_s
        found = self._predicted(row, vehicle.path, now, state, desired)
        if found.conflict_s is not None or found.decel_mps2 > vehicle.start.driver.decel_mps2:
            found = self._rerouted(row, vehicle, now, desired) or found
            state = (float(self._state[row, S]), state[1], state[2])
        if found.leader >= 0 and self._slows_for(state, found, vehicle.start):
            vehicle.waited_for.add(self.vehicles[found.leader].vehicle_id)
        act = driving.keep_yielding_mps2 if vehicle.yielding else self.scene.config.conflict.act_mps2
        soon = found.free_conflict_s is not None and found.free_conflict_s <= driving.soon_s
        urgent = vehicle.yielding or soon or found.decel_mps2 >= driving.urgent_ratio * act
        vehicle.yielding = found.decel_mps2 >= act and urgent
        start, limits = vehicle.start, []
        if vehicle.yielding:
            limits.append((-found.decel_mps2, "conflict"))
        stop = self._obstacles_of(row).lines.braking(start.driver, s=state[0], speed_mps=state[1], step=now)
        if stop is not None:
            limits.append(stop)
        eased = min(state[2], 0.0) - driving.brake_jerk_mps3 * step_s
        gentle = -max(driving.last_brake_mps2, driving.last_brake_per_s * state[1])  # nobody stops with a jerk
        return [(state[1] + max(accel, eased, gentle) * step_s, cause) for accel, cause in limits]

    def _predicted(
        self, row: int, path: DrivenPath, now: int, state: tuple[float, float, float], desired: float
    ) -> Braking:
        """What the guard predicts for a vehicle on a path, its own or another one."""
        vehicle = self.vehicles[row]
        own, driver = path is vehicle.path, vehicle.start.driver
        obstacles = (
            self._obstacles_of(row) if own else self._guard.obstacles(path, vehicle.start.box, self._others(row))
        )
        return self._guard.braking(
            self._who_does_not_yield(obstacles, row, path, now), own=row, step=now, fleet=self._state, state=state,
            desired_mps=desired, road=self._road[row] if own else self.roads.speeds(path, driver), driver=driver,
        )  # fmt: skip

    def _rerouted(self, row: int, vehicle: DrivenVehicle, now: int, desired: float) -> Braking | None:
        """Take another way at the next split if nobody is met there (conflict case 3); None where there is none.

        Only who is to go straight: another way is no longer the turn or the change of lanes that was asked for.
        """
        stays = vehicle.start.is_held or vehicle.policy is not Policy.STRAIGHT
        if stays or self._reroutes_tried[row] is vehicle.path:
            return None
        self._reroutes_tried[row] = vehicle.path
        (s, v), driver = self._state[row, [S, V]].tolist(), vehicle.start.driver
        cell = self.scene.grid.cell_of_sumo_lane.get(self.simulation.lane(vehicle.vehicle_id)[0])
        if cell is None:
            return None
        for path in ways_at_next_split(self.scene, vehicle.path, s=s, from_m=s + vehicle.start.box.length_m):
            at = places_on(path, vehicle.path, np.array(vehicle.s))
            road = self.roads.speeds(path, driver)
            if v > road[min(int(at[-1] / TABLE_STEP_M), road.size - 1)] + _BINDS_MPS:
                continue
            found = self._predicted(row, path, now, (float(at[-1]), v, float(self._state[row, A])), desired)
            edges = edges_along(self.scene, path, cell)
            if found.conflict_s is None and found.decel_mps2 < self.scene.config.conflict.act_mps2 and edges:
                self.simulation.set_route(vehicle.vehicle_id, edges)
                self._take_path(row, vehicle, path)
                vehicle.s[:] = at.tolist()
                vehicle.rerouted_at, self._state[row, S], self._place[row] = now, at[-1], at[-1]
                self._recorded.take(self.scene.traffic)  # others may have to be shown on this way
                self._kept.take(self.fixed)
                return found
        return None

    def _take_path(self, row: int, vehicle: DrivenVehicle, path: DrivenPath) -> None:
        vehicle.path = path
        self._known[row], self._ahead = None, None
        self._road[row], self._lanes[row] = self.roads.speeds(path, vehicle.start.driver), self._lanes_of(path)
        self._obstacles = [None] * len(self.vehicles)  # everybody sees the new intention

    def _slows_for(self, state: tuple[float, float, float], found: Braking, start: Start) -> bool:
        driving, driver = self.scene.config.driving, start.driver
        usual_m = driver.tau_s * state[1] + driver.min_gap_m
        return found.leader_gap_m < driving.behind_ratio * usual_m and state[2] < -driving.slows_mps2

    def _decide(self, row: int, vehicle: DrivenVehicle, now: int, fleet: "_Lazy") -> list[_Attempt]:
        """Algorithm 1 for one vehicle at one step: what it observes, the decision, and what is asked of SUMO."""
        config, request = self.scene.config, vehicle.start.request
        time_s, change = now * self.scene.step_s, config.lane_change
        asks = vehicle.policy in (Policy.LANE_CHANGE, Policy.OVERTAKE)
        due = asks and time_s >= request.trigger_s and vehicle.stage in (Stage.WAITING, Stage.PASS)
        if due and vehicle.stage is Stage.WAITING and time_s > request.trigger_s + change.give_up_s:
            vehicle.stage, due = Stage.ABORTED, False
        if not due:  # nothing to be asked: it keeps to its lane, as `decide` says
            vehicle.policies[self._lanes[row].policy_at(vehicle.s[-1])] += 1
            return []
        others = _without(fleet.value, vehicle.vehicle_id)
        options, leader = self._look_around(vehicle, now, others)
        if change.rule == "LC2013":
            options = {side: (self._with_sumo_answer(vehicle, found), path) for side, (found, path) in options.items()}
        passed_m = self._passed_gap_m(vehicle, now, others)
        seen = self._observation(vehicle, now, tuple(option for option, _ in options.values()), leader, passed_m)
        if change.rule not in ("paper", "LC2013"):
            ahead, behind = gaps_on(
                self.scene, vehicle.path, vehicle.start.box, at=vehicle.s[-1], step=now, fixed=self.fixed, fleet=others
            )  # fmt: skip
            seen = replace(seen, own_front=ahead, own_rear=behind)
        decision = decide(seen, lane_change=change, overtake=config.overtake)
        vehicle.policies[decision.policy] += 1
        side = decision.side
        for (option, _), answer in zip(options.values(), decision.answers, strict=False):  # those not looked at: none
            vehicle.gaps.append(_look(vehicle, now, option, answer))
        if side is None:
            vehicle.reason = decision.reason
            return []
        option, target = options[side]
        attempt = self._attempt(row, vehicle, now, option, target, leader)
        if isinstance(attempt, Reason):
            vehicle.reason = attempt
            vehicle.gaps[-1] = replace(vehicle.gaps[-1], guard=attempt)
            return []
        return [attempt]

    def _look_around(
        self, vehicle: DrivenVehicle, now: int, others: Traffic
    ) -> tuple[dict[Side, tuple[LaneOption, DrivenPath]], Leader | None]:
        """Adjacent lanes, and for an overtake the leader within d_obs."""
        start, sides = vehicle.start, vehicle.start.sides
        if vehicle.stage is Stage.PASS:
            sides = ("right",) if vehicle.shifts[-1].side == "left" else ("left",)
        found = lane_options(
            self.scene, vehicle.path, start.box, s=vehicle.s[-1], step=now, sides=sides, fixed=self.fixed, fleet=others,
            speed_mps=vehicle.v[-1], desired_mps=start.driver.desired_mps,
        )  # fmt: skip
        leader = None
        if vehicle.policy is Policy.OVERTAKE:
            leader = leader_on(
                vehicle.path, start.box, s=vehicle.s[-1], d_obs_m=self.scene.config.overtake.d_obs_m,
                here=self._vehicles(now, others),
            )  # fmt: skip
        return {option.side: (option, target) for option, target in found}, leader

    def _vehicles(self, now: int, others: Traffic) -> Traffic:
        """Vehicles that can be overtaken, as they are now (one step)."""
        recorded = self.scene.traffic.at(now).rows(self.scene.vehicle_rows.tolist())
        return recorded.joined(self.fixed.at(now), others) if self.fixed.ids else recorded.joined(others)

    def _passed_gap_m(self, vehicle: DrivenVehicle, now: int, others: Traffic) -> float:
        """How far the overtaken vehicle is behind, m; -1 where there is none."""
        if vehicle.stage is not Stage.PASS or vehicle.leader_id is None:
            return -1.0
        return gap_ahead_of(
            vehicle.path, vehicle.start.box, s=vehicle.s[-1], lane=vehicle.start.path, passed_id=vehicle.leader_id,
            here=self._vehicles(now, others),
        )  # fmt: skip

    def _observation(
        self, vehicle: DrivenVehicle, now: int, options: tuple[LaneOption, ...], leader: Leader | None, passed_m: float
    ) -> Observation:
        cell = self.scene.cell_at(vehicle.path, vehicle.s[-1])
        return Observation(
            time_s=now * self.scene.step_s,
            cell=cell,
            next_cell=self.scene.grid.longitudinal(cell),
            lane_turn=self.scene.grid.graph.lanes[cell.lane_id].turn,
            speed_mps=vehicle.v[-1],
            desired_mps=vehicle.start.driver.desired_mps,
            request=vehicle.policy,
            trigger_s=vehicle.start.request.trigger_s,
            stage=vehicle.stage,
            leader=leader,
            options=options,
            passed_gap_m=passed_m,
            length_m=vehicle.start.box.length_m,
            driver=vehicle.start.driver,
        )

    def _with_sumo_answer(self, vehicle: DrivenVehicle, option: LaneOption) -> LaneOption:
        """An adjacent lane with what SUMO's own model makes of it."""
        return replace(option, sumo=SumoAnswer(*self.simulation.lane_change_answer(vehicle.vehicle_id, option.side)))

    def _attempt(
        self, row: int, vehicle: DrivenVehicle, now: int, option: LaneOption, target: DrivenPath, leader: Leader | None
    ) -> _Attempt | Reason:
        """Lay the path across, look along it (conflict case 3), and ask SUMO; or the reason not to."""
        scene, start, s, v = self.scene, vehicle.start, vehicle.s[-1], vehicle.v[-1]
        overtakes = vehicle.policy is Policy.OVERTAKE
        wanted = start.driver.lane_change_s * (scene.config.overtake.shift_ratio if overtakes else 1.0)
        path = lay_across(
            scene, vehicle.path, target, s=s, step=now, pace_mps=0.5 * (v + max(v, start.driver.desired_mps)),
            remaining_m=option.remaining_m, lasting_s=wanted,
        )  # fmt: skip
        if isinstance(path, Reason):
            return path
        if vehicle.stage is Stage.PASS and not returns_to(start.path, path):
            return Reason.LANES_PART
        if s + v * (scene.num_steps - 2 - now) * scene.step_s < path.shifts[-1][1]:
            return Reason.SCENE_ENDS
        if "collision" not in scene.config.without and self._meets_on(row, vehicle, now, path):
            return Reason.CONFLICT_PREDICTED
        cell = scene.grid.cell_of_sumo_lane.get(self.simulation.lane(vehicle.vehicle_id)[0])
        if cell is None:
            return Reason.OFF_ITS_LANE
        link = scene.grid.lateral(cell, option.side)
        if link is None:
            return Reason.NO_ADJACENT_LANE
        edges = edges_along(scene, target, link.target)
        if edges is None:
            return Reason.TARGET_NOT_BESIDE_FRONT
        self.simulation.change_lane(vehicle.vehicle_id, scene.grid.lane_index(link.target), edges=edges)
        shift = Shift(
            side=option.side, source_lane=vehicle.path.segment_at(s).lane_id, target_lane=option.target.lane_id,
            requested_step=now, gap_front_m=option.front.distance_m, gap_rear_m=option.rear.distance_m,
        )  # fmt: skip
        stage = Stage.RETURN if vehicle.stage is Stage.PASS else Stage.ENTER
        if leader is not None and stage is Stage.ENTER:
            vehicle.leader_id = leader.track_id
        look = len(vehicle.gaps) - 1
        return _Attempt(vehicle, look, path, target, scene.grid.sumo_lane_id(link.target), shift, stage)

    def _meets_on(self, row: int, vehicle: DrivenVehicle, now: int, path: DrivenPath) -> bool:
        """Whether a path across has a predicted conflict that ordinary braking does not solve."""
        obstacles, start = self._guard.obstacles(path, vehicle.start.box, self._others(row)), vehicle.start
        across_s, wished = self.scene.config.driving.across_s, now
        if start.is_held:  # planned among everybody known: it will go as fast as it wishes
            across_s = min(across_s, start.driver.lane_change_s + _ACROSS_MORE_S)
            wished = min(now + self.scene.steps_in(across_s), start.desired.size - 1)
        found = self._guard.braking(
            self._who_does_not_yield(obstacles, row, path, now), own=row, step=now, fleet=self._state,
            state=(vehicle.s[-1], vehicle.v[-1], 0.0), desired_mps=float(start.desired[wished]),
            road=self.roads.speeds(path, start.driver), driver=start.driver, horizon_s=across_s,
        )  # fmt: skip
        return found.conflict_s is not None or found.run_into or found.decel_mps2 > vehicle.start.driver.decel_mps2

    def _conclude(self, attempt: _Attempt, step: int) -> None:
        """Take the new path if SUMO did change lanes; else its refusal is the answer, and the route is restored."""
        vehicle = attempt.vehicle
        if not vehicle.running:
            return
        lane, _ = self.simulation.lane(vehicle.vehicle_id)
        cell = self.scene.grid.cell_of_sumo_lane.get(lane)
        beside = {segment.lane_id for segment in attempt.target.segments}
        own = {segment.lane_id for segment in vehicle.path.segments if segment.end > vehicle.s[-1]}
        changed = lane == attempt.lane or (cell is not None and cell.lane_id in beside - own)
        look = vehicle.gaps[attempt.look]
        vehicle.gaps[attempt.look] = replace(look, sumo=changed)
        if not changed:
            vehicle.reason = Reason.SUMO_REFUSES
            edges = edges_along(self.scene, vehicle.path, cell) if cell is not None else None
            if edges:
                self.simulation.set_route(vehicle.vehicle_id, edges)
            return
        row = self.vehicles.index(vehicle)
        vehicle.shifts.append(attempt.shift)
        vehicle.stage = attempt.stage
        vehicle.reason = None
        self._take_path(row, vehicle, attempt.path)


def _look(vehicle: DrivenVehicle, step: int, option: LaneOption, rule: Reason | None) -> GapLook:
    """What is recorded of one look at a gap."""
    return GapLook(
        step=step, side=option.side, target=option.target, front=option.front, rear=option.rear,
        own_mps=vehicle.v[-1], remaining_m=option.remaining_m, cells_free=option.cells_free, rule=rule,
    )  # fmt: skip


def _without(fleet: Traffic, vehicle_id: str) -> Traffic:
    return fleet.rows([row for row, one in enumerate(fleet.ids) if one != vehicle_id])


def edges_along(scene: Scene, path: DrivenPath, cell: Cell) -> tuple[str, ...] | None:
    """SUMO edges from a cell on along the lanes of a path; None where the path does not use the cell's lane."""
    lanes = [segment.lane_id for segment in path.segments]
    if cell.lane_id not in lanes:
        return None
    grid = scene.grid
    edges: list[str] = []
    first = cell.index
    last = len(lanes) - 1 - lanes[::-1].index(cell.lane_id)  # an overtake comes back to the lane it left
    for lane_id in lanes[last:]:
        for index in range(first, grid.count(lane_id)):
            edge = grid.edge_id(Cell(lane_id, index))
            if not edges or edges[-1] != edge:
                edges.append(edge)
        first = 0
    return tuple(edges)


def insert(simulation: Simulation, scene: Scene, start: Start) -> Reason | None:
    """Insert a vehicle at its cell, position and speed, with its driver. Returns SUMO's objection, None if accepted."""
    front = front_arc_m(start.start_s, start.size.length_m)
    segment = start.path.segment_at(front)
    lane_s = segment.lane_s(front)
    cell = scene.grid.cell_at(segment.lane_id, lane_s)
    edges = edges_along(scene, start.path, cell)
    if edges is None:
        return Reason.NO_ROUTE
    begin = float(scene.grid.edges_s(cell.lane_id)[cell.index])
    driver = start.driver
    objection = simulation.insert(
        start.vehicle_id, edges=edges, lane_id=scene.grid.sumo_lane_id(cell), front_m=max(0.0, lane_s - begin),
        speed_mps=start.start_mps, length_m=start.size.length_m, width_m=start.size.width_m,
        accel_mps2=driver.accel_mps2, decel_mps2=driver.decel_mps2, tau_s=driver.tau_s, min_gap_m=driver.min_gap_m,
        max_speed_mps=float(max(start.desired[0], start.start_mps)),
    )  # fmt: skip
    if objection is None and "collision" in scene.config.without:
        simulation.disregard_others(start.vehicle_id)
    return None if objection is None else Reason.SUMO_REFUSES_INSERTION
