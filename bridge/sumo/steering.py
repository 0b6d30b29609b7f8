"""Decision -> libsumo calls: inserted vehicles, step by step (paper, Algorithm 1; conflict cases 1 to 3)."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from bridge.sumo.insertion import edges_along, insert
from bridge.sumo.replay import Replay
from bridge.sumo.simulation import Simulation
from hid2.agents import FloatArray, Policy
from hid2.conflicts.cases import DT_S
from hid2.motion.repair import DrivenVehicle
from hid2.motion.route import DrivenPath
from hid2.occupancy.traffic import Traffic
from hid2.policy.decision import LaneOption, Observation, Side, decide
from hid2.policy.maneuver import gap_ahead_of, lane_options, lay_across, leader_on, returns_to
from hid2.policy.overtake import Leader, Stage
from hid2.scene import PlannedVehicle, World, predicted_traffic

_RETRY_STEPS = 3
_LAG_M = 2.5
_DROPS_BACK = frozenset({"cells_occupied", "front_gap"})
_DROP_BACK_SHARE = 0.75
_PATIENCE_S = 0.8
_REPLAN_STEPS = 10
_REPLANS_MOST = 2  # what is off then is retimed when the vehicle is settled


@dataclass(slots=True)
class Shift:
    """One lateral motion as it was begun. index: which of the path's shifts it is."""

    index: int
    side: Side
    source_lane: int
    target_lane: int
    requested_step: int
    gap_front_m: float
    gap_rear_m: float


@dataclass(slots=True)
class Driver:
    """State of one inserted vehicle while SUMO drives it."""

    spec: PlannedVehicle
    path: DrivenPath
    plan_s: FloatArray
    plan_v: FloatArray
    sides: tuple[Side, ...]
    s: list[float] = field(default_factory=list)
    v: list[float] = field(default_factory=list)
    stage: Stage = Stage.WAITING
    reason: str | None = None
    shifts: list[Shift] = field(default_factory=list)
    leader_id: str | None = None
    objection: str | None = None
    left_at: int | None = None
    retry_at: int = 0
    replan_at: int = 0
    replans: int = 0

    @property
    def running(self) -> bool:
        """In SUMO, not yet beyond the map's edge."""
        return self.objection is None and self.left_at is None


@dataclass(slots=True)
class _Attempt:
    """A lane change that SUMO was asked for and has not carried out yet."""

    driver: Driver
    path: DrivenPath
    target: DrivenPath
    plan_s: FloatArray
    plan_v: FloatArray
    target_sumo_lane: str
    shift: Shift
    stage: Stage


@dataclass(slots=True)
class Steering:
    """Drives planned vehicles through one simulation. `fixed`: generated vehicles of earlier rounds, replayed."""

    world: World
    simulation: Simulation
    fixed: Traffic
    drivers: list[Driver] = field(default_factory=list)
    _fleet: Traffic = field(init=False)

    def run(self, planned: Sequence[PlannedVehicle], replays: Sequence[Replay]) -> list[Driver]:
        """All steps of the scene: replay, insert, decide, apply, step, record."""
        for spec in planned:
            self.drivers.append(Driver(spec, spec.path, spec.plan_s.copy(), spec.plan_v.copy(), spec.sides))
        self._fleet = predicted_traffic(
            [(d.spec.vehicle_id, d.spec.intended_path, d.spec.size, d.spec.intended_s) for d in self.drivers],
            self.world.num_steps,
        )
        for step in range(self.world.num_steps):
            for replay in replays:
                replay.place(step)
            attempts: list[_Attempt] = []
            if step > 0:
                for driver in self.drivers:
                    if driver.running:
                        attempts += self._steer(driver, step - 1)
            self.simulation.step()
            if step == 0:  # behind the first step, so that the state of step 0 is the planned one
                for driver in self.drivers:
                    driver.objection = insert(self.simulation, self.world, driver.spec)
            for replay in replays:
                replay.check(step)
            self._read(step)
            for attempt in attempts:
                self._conclude(attempt, step)
        return self.drivers

    def _read(self, step: int) -> None:
        inside = self.simulation.driven()
        for driver in self.drivers:
            if not driver.running:
                continue
            if driver.spec.vehicle_id not in inside:
                if step == 0:
                    driver.objection = "sumo_refuses_insertion"
                else:
                    driver.left_at = step
                continue
            if step == 0:
                driver.s.append(driver.spec.s0)
                driver.v.append(driver.spec.v0)
            else:
                speed = self.simulation.speed(driver.spec.vehicle_id)
                driver.s.append(driver.s[-1] + speed * DT_S)
                driver.v.append(speed)

    def _steer(self, driver: Driver, now: int) -> list[_Attempt]:
        """Decide at step `now` and pass the decision on to SUMO for the coming step."""
        spec, s = driver.spec, driver.s[-1]
        if driver.path.shifts and driver.stage is Stage.ENTER and s >= driver.path.shifts[-1][1]:
            driver.stage = Stage.PASS if spec.policy is Policy.OVERTAKE else Stage.DONE
        if driver.stage is Stage.RETURN and s >= driver.path.shifts[-1][1]:
            driver.stage = Stage.DONE
        attempts = self._decide(driver, now)
        if "collision" in self.world.config.without:
            cell = min(int(s / 0.5), self.world.desired(driver.path, spec.cruise_mps).size - 1)
            self.simulation.set_speed(spec.vehicle_id, float(self.world.desired(driver.path, spec.cruise_mps)[cell]))
            return attempts
        behind = float(driver.plan_s[now]) - s
        if behind > _LAG_M and now >= driver.replan_at and driver.replans < _REPLANS_MOST:
            self._replan(driver, now)
            behind = float(driver.plan_s[now]) - s
        then = min(now + 1, driver.plan_v.size - 1)
        speed = max(0.0, float(driver.plan_v[then]) + 0.4 * behind)
        if driver.stage is Stage.WAITING and driver.reason in _DROPS_BACK and now * DT_S > spec.trigger_s + _PATIENCE_S:
            speed *= _DROP_BACK_SHARE  # who is beside goes ahead, and the gap behind it opens
        self.simulation.set_speed(spec.vehicle_id, speed)
        return attempts

    def _decide(self, driver: Driver, now: int) -> list[_Attempt]:
        """Algorithm 1 for one vehicle at one step: what it sees, the decision, and what comes of it."""
        spec, config = driver.spec, self.world.config
        give_up_s = spec.trigger_s + config.lane_change.give_up_s
        asks = spec.policy in (Policy.LANE_CHANGE, Policy.OVERTAKE) and driver.stage in (Stage.WAITING, Stage.PASS)
        if asks and driver.stage is Stage.WAITING and now * DT_S > give_up_s:
            driver.stage, asks = Stage.ABORTED, False
        if not asks or now * DT_S < spec.trigger_s or now < driver.retry_at:
            return []  # on to the next cell of the lane, or of the turn that its route takes: that is SUMO's own way
        options, leader = self._look_around(driver, now)
        seen = self._observation(driver, now, tuple(option for option, _ in options.values()), leader)
        decision = decide(seen, lane_change=config.lane_change, overtake=config.overtake)
        if decision.side is None:
            driver.reason = decision.reason
            return []
        option, target = options[decision.side]
        attempt = self._attempt(driver, now, option, target, leader)
        if isinstance(attempt, str):
            driver.reason = attempt
            driver.retry_at = now + _RETRY_STEPS
            return []
        return [attempt]

    def _look_around(self, driver: Driver, now: int) -> tuple[dict[Side, tuple[LaneOption, DrivenPath]], Leader | None]:
        """Adjacent lanes, and for an overtake the leader within d_obs."""
        spec = driver.spec
        sides = driver.sides
        if driver.stage is Stage.PASS:
            sides = ("right",) if driver.shifts[-1].side == "left" else ("left",)
        found = lane_options(
            self.world,
            driver.path,
            spec.size,
            s=driver.s[now],
            step=now,
            sides=sides,
            others=(self.fixed, self._others(driver)),
            speed_mps=driver.v[now],
            desired_mps=spec.cruise_mps,
        )
        options = {option.side: (option, target) for option, target in found}
        leader = None
        if spec.policy is Policy.OVERTAKE:
            leader = leader_on(
                driver.path, spec.size, s=driver.s[now], step=now, d_obs_m=self.world.config.overtake.d_obs_m,
                vehicles=self._vehicles(driver),
            )  # fmt: skip
        return options, leader

    def _observation(
        self, driver: Driver, now: int, options: tuple[LaneOption, ...], leader: Leader | None
    ) -> Observation:
        s = driver.s[now]
        cell = self.world.cell_at(driver.path, s)
        passed = -1.0
        if driver.stage is Stage.PASS and driver.leader_id is not None:
            passed = gap_ahead_of(
                driver.path,
                driver.spec.size,
                s=np.asarray(driver.s),
                step=now,
                lane=driver.spec.path,
                passed_id=driver.leader_id,
                vehicles=self._vehicles(driver),
            )
        return Observation(
            time_s=now * DT_S,
            cell=cell,
            next_cell=self.world.grid.longitudinal(cell),
            lane_turn=self.world.grid.graph.lanes[cell.lane_id].turn,
            speed_mps=driver.v[now],
            desired_mps=driver.spec.cruise_mps,
            request=driver.spec.policy,
            trigger_s=driver.spec.trigger_s,
            stage=driver.stage,
            leader=leader,
            options=options,
            passed_gap_m=passed,
        )

    def _attempt(
        self, driver: Driver, now: int, option: LaneOption, target: DrivenPath, leader: Leader | None
    ) -> _Attempt | str:
        """Lay the path across, look along it (conflict case 3), and ask SUMO; or the reason not to."""
        config, spec, s, v = self.world.config, driver.spec, driver.s[now], driver.v[now]
        pace = max(v, 0.5 * (v + float(driver.plan_v[min(now + 20, driver.plan_v.size - 1)])))
        path = lay_across(
            self.world, driver.path, target, s=s, step=now, pace_mps=pace, remaining_m=option.remaining_m,
            policy=spec.policy,
        )  # fmt: skip
        if isinstance(path, str):
            return path
        if driver.stage is Stage.PASS and not returns_to(spec.path, path):
            return "lanes_part"
        look = self.world.prospect(
            path, spec.size, cruise_mps=spec.cruise_mps, others=(self.fixed, self._others(driver))
        )
        plan_s, plan_v = driver.plan_s, driver.plan_v
        if "collision" not in config.without:
            accel = (driver.v[now] - driver.v[now - 1]) / DT_S if now > 0 else 0.0
            plan = look.plan(s0=s, v0=v, a0=float(np.clip(accel, -2.0, 1.5)), first_step=now, config=config)
            if plan is None:
                return "conflict_predicted"
            if plan.s[-1] < path.shifts[-1][1] + 0.5:
                return "would_not_complete"
            plan_s = np.concatenate([driver.plan_s[:now], plan.s])
            plan_v = np.concatenate([driver.plan_v[:now], plan.v])
        sumo_lane, _ = self.simulation.lane(spec.vehicle_id)
        cell = self.world.grid.cell_of_sumo_lane.get(sumo_lane)
        if cell is None:
            return "off_its_lane"
        link = self.world.grid.lateral(cell, option.side)
        if link is None:
            return "no_adjacent_lane"
        edges = edges_along(self.world, target, link.target)
        if edges is None:
            return "target_not_beside_front"
        sumo_target = self.world.grid.sumo_lane_id(link.target)
        self.simulation.change_lane(spec.vehicle_id, self.world.grid.lane_index(link.target), edges=edges)
        shift = Shift(
            index=len(path.shifts) - 1, side=option.side, source_lane=driver.path.segment_at(s).lane_id,
            target_lane=option.target.lane_id, requested_step=now, gap_front_m=option.front.distance_m,
            gap_rear_m=option.rear.distance_m,
        )  # fmt: skip
        stage = Stage.RETURN if driver.stage is Stage.PASS else Stage.ENTER
        if leader is not None and stage is Stage.ENTER:
            driver.leader_id = leader.track_id
        return _Attempt(driver, path, target, plan_s, plan_v, sumo_target, shift, stage)

    def _conclude(self, attempt: _Attempt, step: int) -> None:
        """Keep the new path if SUMO did change lanes; else restore the route and try again later."""
        driver = attempt.driver
        if not driver.running:
            return
        lane, _ = self.simulation.lane(driver.spec.vehicle_id)
        cell = self.world.grid.cell_of_sumo_lane.get(lane)
        beside = {segment.lane_id for segment in attempt.target.segments}
        own = {segment.lane_id for segment in driver.path.segments if segment.end > driver.s[-1]}
        changed = lane == attempt.target_sumo_lane or (cell is not None and cell.lane_id in beside - own)
        if not changed:
            driver.reason = "sumo_waits_for_gap"
            driver.retry_at = step + _RETRY_STEPS
            edges = edges_along(self.world, driver.path, cell) if cell is not None else None
            if edges:
                self.simulation.set_route(driver.spec.vehicle_id, edges)
            return
        driver.path = attempt.path
        driver.plan_s, driver.plan_v = attempt.plan_s, attempt.plan_v
        driver.shifts.append(attempt.shift)
        driver.stage = attempt.stage
        driver.reason = None
        self._publish(driver, step)

    def _replan(self, driver: Driver, now: int) -> None:
        """Adjust timing to what the others turned out to do."""
        spec = driver.spec
        look = self.world.prospect(
            driver.path, spec.size, cruise_mps=spec.cruise_mps, others=(self.fixed, self._others(driver))
        )
        accel = (driver.v[now] - driver.v[now - 1]) / DT_S if now > 0 else 0.0
        plan = look.plan(
            s0=driver.s[now],
            v0=driver.v[now],
            a0=float(np.clip(accel, -2.0, 1.5)),
            first_step=now,
            config=self.world.config,
        )
        driver.replan_at = now + _REPLAN_STEPS
        driver.replans += 1
        if plan is not None:
            driver.plan_s = np.concatenate([driver.plan_s[:now], plan.s])
            driver.plan_v = np.concatenate([driver.plan_v[:now], plan.v])
            self._publish(driver, now)

    def _publish(self, driver: Driver, now: int) -> None:
        """Let the others see the new prediction."""
        row = self.drivers.index(driver)
        one = predicted_traffic(
            [(driver.spec.vehicle_id, driver.path, driver.spec.size, driver.plan_s[now:])],
            self.world.num_steps,
            first_step=now,
        )
        for name in ("position", "heading", "velocity", "present"):
            getattr(self._fleet, name)[row, now:] = getattr(one, name)[0, now:]

    def _others(self, driver: Driver) -> Traffic:
        rows = [row for row, other in enumerate(self.drivers) if other is not driver and other.objection is None]
        return self._fleet.rows(rows)

    def _vehicles(self, driver: Driver) -> Traffic:
        """Who can be overtaken."""
        return self.world.vehicles.joined(self.fixed).joined(self._others(driver))

    def driven(self) -> list[DrivenVehicle]:
        """Traces of the vehicles that SUMO took; beyond the map's edge they go on as planned, from their last speed."""
        traces = []
        for driver in self.drivers:
            if driver.objection is not None:
                continue
            s, v = np.array(driver.s), np.array(driver.v)
            missing = self.world.num_steps - s.size
            if missing > 0:
                planned = driver.plan_v[-missing - 1 :]
                onward = np.maximum(v[-1] + planned[1:] - planned[0], 0.0)
                s = np.concatenate([s, s[-1] + DT_S * np.cumsum(onward)])
                v = np.concatenate([v, onward])
            traces.append(DrivenVehicle(driver.spec, driver.path, s, v))
        return traces
