"""Observe, decide, act, step: vehicles driven by SUMO's car following and steered by Algorithm 1 through libsumo."""

from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from bridge.sumo import steering
from bridge.sumo.fleet import Fleet
from bridge.sumo.poses import front_arc_m
from bridge.sumo.replay import Replay, ReplayErrors
from bridge.sumo.shown import ever_shown, shown_at
from bridge.sumo.simulation import Simulation
from hid2.agents import IntArray
from hid2.conflicts.reaction import Reactions
from hid2.insertion.entry_sites import entry_speed
from hid2.kernels.steering import CAUSES
from hid2.occupancy.shown import UNSEEN_STEPS
from hid2.occupancy.traffic import Traffic
from hid2.policy.behaviours import BEHAVIOURS
from hid2.policy.roads import POLICIES
from hid2.reasons import Reason
from hid2.scene import Scene
from hid2.vehicle import DrivenVehicle, Start

#: A limit on a vehicle's speed, m/s, and its cause.
Limit = tuple[float, str]

_BINDS_MPS = 0.05  # tolerance within which a limit is what decided the speed driven: book-keeping


@dataclass(eq=False, slots=True)
class FleetSimulation:
    """One simulation of a fleet, each vehicle from its own first step on.

    checked: every recorded agent is replayed at every step, and its pose in SUMO compared; else only while a vehicle is
    to see it. Where recorded vehicles react, the fleet's scene is a new one whenever one yields, and
    `reactions` says how late they are.
    """

    fleet: Fleet
    simulation: Simulation
    checked: bool = True
    replay_errors: ReplayErrors = field(init=False)
    reactions: Reactions | None = field(init=False, default=None)
    _replay: Replay = field(init=False)

    def run(self) -> list[DrivenVehicle]:
        """All steps of the scene; a vehicle's first state is its start.

        before step t   by the states of t - 1: Algorithm 1, limits; SUMO is told, recorded agents are put where they
                        are at t
        SUMO steps      then vehicles that start at t are inserted, and the states of t are read
        """
        fleet, simulation, step_s = self.fleet, self.simulation, self.fleet.scene.step_s
        simulation.rewind()
        recorded = fleet.scene.num_recorded if self.checked else 0
        replay = self._replay = Replay(simulation, self._replayed(), step_s=step_s, checked=recorded)
        for back in range(UNSEEN_STEPS, 0, -1):
            replay.warm_up(back)
            simulation.step()

        def follow_mps(recorded: int, speed_mps: float, gap_m: float, leader_mps: float) -> float:
            return simulation.follow_speed(replay.names[recorded], speed_mps, gap_m=gap_m, leader_mps=leader_mps)

        if fleet.scene.config.driving.replay != "fixed":  # recorded vehicles react, by SUMO's car following
            self.reactions = Reactions(fleet.scene, follow_mps)
        for step in range(fleet.scene.num_steps):
            attempts, limits = self._steer(step) if step > 0 else ({}, {})
            for row, vehicle in enumerate(fleet.vehicles):
                if vehicle.start.step == step:  # `shown_at` shows SUMO its leaders before it is inserted
                    fleet.along_m[row] = vehicle.start.start_m
            replay.place(step, shown_at(fleet, step))
            simulation.step()
            self._enter(step)
            replay.check(step)
            self._read(step, attempts, limits)
        self.replay_errors = replay.errors
        return fleet.vehicles

    def _steer(self, step: int) -> tuple[dict[int, steering.Attempt], dict[int, Limit]]:
        """Observe, decide and act before a step, by the states of the step before (`now`).

        Returns the lane changes that SUMO was asked for, and limits of speed, by vehicle. Recorded vehicles that react
        take their next step; a vehicle that braking does not help may take another way.
        """
        fleet, now = self.fleet, step - 1
        traffic = cache(fleet.traffic)  # put together at the first use
        if self.reactions is not None:
            generated = fleet.kept.at(now).joined(traffic()) if fleet.kept.ids else traffic()
            if self.reactions.advance(step, generated):
                fleet.look_anew(self.reactions.scene)
                self._replay.take(fleet.recorded_and_kept)
        attempts: dict[int, steering.Attempt] = {}
        rows = fleet.here
        if not rows.size:
            return attempts, {}
        limits = steering.limits_of(fleet, rows, now)
        for k, row in enumerate(rows.tolist()):
            lane_policy = POLICIES[limits.policy[k]]
            if BEHAVIOURS[fleet.vehicles[row].start.request.policy].changes_lanes:
                attempt = steering.apply_policy(fleet, self.simulation, row, now, traffic, lane_policy)
                if attempt is not None:
                    attempts[row] = attempt
                steering.let_pass(fleet, row, now, limits, k)
            else:  # `decide` has nothing to choose: it would return this policy
                fleet.vehicles[row].policies[lane_policy] += 1
            if limits.braking_fails[k] and steering.take_another_way(fleet, self.simulation, row, now):
                for column, renewed in zip(limits, steering.limits_of(fleet, rows[k:], now), strict=True):
                    column[k:] = renewed  # its own, and of those after it, which see where it goes
                self._replay.take(fleet.recorded_and_kept)  # others may have to be shown on this way
        fleet.yielding[rows] = limits.yields
        return attempts, self._drive(rows, limits, now)

    def _replayed(self) -> Traffic:
        """Recorded agents and those kept, as they are put into SUMO."""
        anywhere = self.checked or self.fleet.scene.config.driving.replay != "fixed"  # reacting ones may be
        return self.fleet.recorded_and_kept if anywhere else ever_shown(self.fleet)

    def _drive(self, rows: IntArray, limits: steering.SpeedLimits, now: int) -> dict[int, Limit]:
        """Tell SUMO how fast vehicles wish to drive and may drive at the coming step; returns the limits by vehicle."""
        fleet, told = self.fleet, {}
        columns = rows, fleet.desired_mps[rows, now], limits.mps, limits.cause, limits.waits_for
        for row, desired, mps, cause, leader in zip(*(column.tolist() for column in columns), strict=True):
            vehicle, limit_mps = fleet.vehicles[row], None
            if cause >= 0:
                told[row] = mps, CAUSES[cause]
                limit_mps = max(0.0, mps)
            if leader >= 0:
                vehicle.waited_for[fleet.vehicles[leader].vehicle_id] += 1
            self.simulation.drive(vehicle.vehicle_id, desired_mps=desired, limit_mps=limit_mps)
        return told

    def _enter(self, step: int) -> None:
        """Insert each vehicle that begins; after the step, so that the state of its first step is the start."""
        scene = self.fleet.scene
        for row, vehicle in enumerate(self.fleet.vehicles):
            start = vehicle.start
            if start.step != step:
                continue
            speed: float | None = start.start_mps
            if step > 0 and "collision" not in scene.config.without:
                speed = entry_speed(start, self.fleet.traffic(), scene.config, step_s=scene.step_s)
            if speed is None:
                vehicle.not_inserted = Reason.NO_ROOM_AT_EDGE
            else:
                vehicle.start = replace(start, start_mps=speed)
                vehicle.not_inserted = insert(self.simulation, scene, vehicle.start)
            if vehicle.not_inserted is not None:
                self.fleet.along_m[row] = np.nan

    def _read(self, step: int, attempts: dict[int, steering.Attempt], limits: dict[int, Limit]) -> None:
        """Take down what SUMO did, what came of what it was asked for, and which of the limits decided the speed."""
        inside = self.simulation.vehicle_ids()
        for row, vehicle in enumerate(self.fleet.vehicles):
            if not vehicle.running or step < vehicle.start.step:
                continue
            if vehicle.vehicle_id not in inside:
                if not vehicle.s:
                    vehicle.not_inserted = Reason.SUMO_REFUSES_INSERTION
                else:
                    vehicle.left_at = step
                self.fleet.leave(row)
            elif not vehicle.s:
                self.fleet.begin(row)
            else:
                speed, limit = self.simulation.speed(vehicle.vehicle_id), limits.get(row)
                lane, front_m = self.simulation.lane(vehicle.vehicle_id)
                if limit is not None and speed > limit[0] - _BINDS_MPS:
                    vehicle.limited[limit[1]] += 1
                if row in attempts:
                    steering.conclude(self.fleet, self.simulation, attempts[row], lane)
                self.fleet.update_from_sumo(row, lane, front_m, speed)


def insert(simulation: Simulation, scene: Scene, start: Start) -> Reason | None:
    """Insert a vehicle at its cell, position and speed, with its driver. Returns why it was not; None where it was."""
    front = front_arc_m(start.start_m, start.size.length_m)
    segment = start.path.segment_at(front)
    lane_m = segment.lane_m(front)
    cell = scene.grid.cell_at(segment.lane_id, lane_m)
    edges = steering.edges_along(scene, start.path, cell)
    if edges is None:
        return Reason.NO_ROUTE
    begin = float(scene.grid.edges_m[cell.lane_id][cell.index])
    message = simulation.insert(
        start.vehicle_id, edges=edges, lane_id=scene.grid.sumo_lane_id(cell), front_m=max(0.0, lane_m - begin),
        speed_mps=start.start_mps, driver=start.driver, size=start.size,
        max_speed_mps=float(max(start.desired[0], start.start_mps)),
    )  # fmt: skip
    if message is None and "collision" in scene.config.without:
        simulation.disregard_others(start.vehicle_id)
    return None if message is None else Reason.SUMO_REFUSES_INSERTION
