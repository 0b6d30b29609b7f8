"""The rollout of a candidate: how it would drive on among all agents with known motion, and what it would meet.

    known: recorded agents by their true future, vehicles kept in rounds before, candidates chosen so far by rollouts

The loop is compiled (`kernels/rollout.py`): no SUMO in it, but SUMO's EIDM without its noise (whatever
`car_following.model` is), the guard and the road. Unlike in the simulation Algorithm 1 is asked once a second (every
.3 s while it passes), and no vehicle slows down for a gap or takes another way. Rollouts say which candidates start;
what is exported is SUMO's.
"""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from hid2.agents import BoxSize, FloatArray
from hid2.conflicts.guard import Guard, OwnMotion
from hid2.conflicts.signals import AMBER_S
from hid2.judge.findings import FOLLOWER_HEADWAY_S, FOLLOWER_LACKS_MPS2, MOVES_M, export_bounds
from hid2.judge.states import contacts_at_end, lacked_braking, recorded_headways, sustained_headway
from hid2.kernels.rollout import CONTACT, LAG_TTC, LEAD_TTC, met_by, roll
from hid2.manoeuvre import ManoeuvreDue, advance
from hid2.measures.arrays import STANDS_FOR_S, STANDS_MPS
from hid2.motion.route import DrivenPath, Jump
from hid2.motion.smoothing import Motion, trajectory
from hid2.occupancy.along_path import PathOccupancy
from hid2.occupancy.gaps import Gaps, gaps_from_poses, gaps_on_path
from hid2.occupancy.shown import Shown, shown_on
from hid2.occupancy.traffic import BoolArray, Traffic
from hid2.once import once
from hid2.policy.overtake import Stage
from hid2.policy.roads import Roads
from hid2.policy.rules import ASSUMED_ANSWER
from hid2.reasons import Reason
from hid2.scene import ACROSS_S, Scene
from hid2.vehicle import DrivenVehicle, Start
from netconvert.lane_graph import Side, TurnType
from netconvert.net_xml import speed_limit_mps

# Not parameters from here to _NEAR_GAPS_M: they save time.
_LOOKS_S = 1.0  # time between two looks of a vehicle that waits for a gap, s
_PASSING_LOOKS_S = 0.3  # time between two looks of a vehicle that passes, s: passing is short, waiting long
_HINDERED_S = 4.0  # TTC to a new candidate below which a follower chosen before is rolled out anew, s
_FOLLOWS_M = 3.0  # spare gap with which no follower has a critical TTC to its leader on its path, m
_ASIDE_M = 12.0  # lateral distance at which no follower has a critical TTC on its path, m
_NEAR_GAPS_M = 40.0  # distance on an axis beyond which an agent is in no gap that a vehicle looks at, m
_NONE = Traffic.none(1)
#: Least share of its desired speed that a vehicle drives at, but for what is ahead of it. No tunable.
SLOWEST_SHARE = 0.25
#: Gap to the leader below which a vehicle that stands counts as queuing, m. No tunable.
QUEUE_M = 8.0
#: Largest desired speed of SUMO's EIDM on a link of the net that turns, m/s; on other links it is the lane's limit.
_TURN_MPS = {TurnType.LEFT: 8.0, TurnType.RIGHT: 6.0}


@dataclass(frozen=True, eq=False, slots=True)
class Rollout:
    """A motion on a path: s (K,) m and v (K,) m/s at the scene's steps from `step` on.

    memory (K, M): the state of the driver's model (EIDM) at each step, from which a next part goes on.
    """

    path: DrivenPath
    step: int
    s: FloatArray
    v: FloatArray
    memory: FloatArray

    def until(self, step: int) -> "Rollout":
        """The same up to a step, that one included."""
        count = step - self.step + 1
        return replace(self, s=self.s[:count], v=self.v[:count], memory=self.memory[:count])

    @property
    def on_path(self) -> "Rollout":
        """The same as long as the centre has not left the map."""
        return self.until(self.step + int((self.s <= self.path.exit_m).sum()) - 1)


@dataclass(frozen=True, eq=False, slots=True)
class RolledOut:
    """A candidate with the parts of its motion, and as known traffic beyond the scene's end (one agent)."""

    start: Start
    parts: tuple[Rollout, ...]
    traffic: Traffic


@dataclass(eq=False)
class World:
    """What candidates are rolled out against. guard: knows those kept, by their final motion, and those chosen.

    target_id: of an event's target: its headway and braking are not asked, as the event is about the gap left to it.
    """

    scene: Scene
    roads: Roads
    guard: Guard
    target_id: str | None = None
    _kept: Traffic = field(init=False)
    _chosen: dict[str, RolledOut] = field(default_factory=dict)
    _newest: dict[tuple[DrivenPath, BoxSize], tuple[Traffic, PathOccupancy, Shown]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Nothing is chosen yet."""
        self._kept = self.guard.inserted_known

    def choose(self, *candidates: RolledOut, without: str = "") -> None:
        """Add candidates that later ones are rolled out against; one that was chosen before gets its new motion.

        without: id of one to drop. What was worked out for the traffic before the first change is kept, and the rest
        freed: for one round of sixty vehicles it would be gigabytes.
        """
        new, known = {one.start.vehicle_id: one for one in candidates}, self.guard.inserted_known
        first = next((row for row, name in enumerate(self._chosen) if name in {*new, without}), len(self._chosen))
        while len(known.ids) > len(self._kept.ids) + first:
            known = known.extends or self._kept
        self._chosen = {name: one for name, one in (self._chosen | new).items() if name != without}
        behind = list(self._chosen.values())[len(known.ids) - len(self._kept.ids) :]
        self.guard.inserted_known = known.joined(*(one.traffic for one in behind))

    def joined_by(self, *candidates: RolledOut, without: str = "") -> "World":
        """The same with candidates chosen, which need not be taken in the end; without: one that is rolled out anew."""
        guard = Guard(self.scene, self._kept, self.guard.stop_lines)
        found = World(self.scene, self.roads, guard, self.target_id)
        found._chosen, guard.inserted_known = self._chosen, self.guard.inserted_known
        found.choose(*candidates, without=without)
        return found

    def rolled_out(self, start: Start, parts: tuple[Rollout, ...]) -> RolledOut:
        """A candidate with its motion."""
        driven = []
        for part in parts:
            inside = part.on_path
            motion = Motion(inside.s, inside.v, np.zeros(inside.s.size), self.scene.step_s)
            driven.append((part.step, trajectory(part.path.line, motion, start.offset, start.size.length_m)))
        return RolledOut(start, parts, self.scene.known_traffic(start.vehicle_id, start.box, driven))

    def harm_to_followers(self, candidate: RolledOut, headway_s: float = FOLLOWER_HEADWAY_S) -> Reason | None:
        """What a recorded vehicle that comes up from behind suffers, on the path that it drives itself; None: nothing.

        Too little time to collision, harder braking than it does, or a headway below headway_s that is also below the
        least that it kept in the recording.
        """
        scene, own = self.scene, candidate.traffic.span(slice(self.scene.num_steps))
        movers, recorded, forward = scene.movers
        critical_s = scene.config.conflict.follower_ttc_min_s
        seen = gaps_from_poses(recorded.position, forward, (recorded.length_m[:, None], recorded.width_m[:, None]), own)
        speed = recorded.speed
        closing = speed - seen.along_mps
        room_m = np.maximum(_FOLLOWS_M + critical_s * closing, headway_s * speed)
        room_m = np.maximum(room_m, _FOLLOWS_M + np.maximum(closing, 0.0) ** 2 / (2.0 * FOLLOWER_LACKS_MPS2))
        near = (seen.along_m > -own.length_m) & (seen.gap_m < room_m) & (seen.aside_m < _ASIDE_M)
        near &= own.present & recorded.present
        for row in movers[near.any(axis=1)].tolist():
            led = scene.states.leaders_among(row, own)
            if led.ttc_s.min(initial=math.inf) < critical_s:
                return Reason.TTC_RECORDED_FOLLOWER
            if scene.states.arrays.track_ids[row] == self.target_id:
                continue
            if lacked_braking(scene.states, row, led)[0].max(initial=0.0) > FOLLOWER_LACKS_MPS2:
                return Reason.FOLLOWER_BRAKING
            length_m = own.length_m[0] - candidate.start.beyond_m
            if led.agents.size and self._headway_too_short(row, led.gap_m[0], length_m, headway_s):
                return Reason.FOLLOWER_HEADWAY
        return None

    def _headway_too_short(self, follower: int, gap_m: FloatArray, leader_m: float, least_s: float) -> bool:
        """Whether the headway of a recorded vehicle, gap_m (T,) behind a leader, is below least_s and its own least."""
        headway_s, _ = sustained_headway(gap_m, leader_m, self.scene.states.speed(follower), self.scene.step_s)
        if headway_s >= least_s:
            return False
        return self._recorded_headways_s.get(follower, math.inf) > headway_s

    @cached_property
    def _recorded_headways_s(self) -> dict[int, float]:
        return recorded_headways(self.scene.states)

    def gaps_at(self, path: DrivenPath, box: BoxSize, s: float, step: int) -> Gaps:
        """Of a vehicle that begins at an arc length, m, of a path at a step, to those next to it."""
        return gaps_on_path(self.guard.known_on(path, box), np.array([s]), step)

    def meets_after(self, candidate: RolledOut) -> bool:
        """Whether a candidate has a critical contact after its last step, all at constant velocity."""
        own = candidate.traffic
        last = int(np.flatnonzero(own.present[0, : self.scene.num_steps])[-1])
        here = self.scene.traffic.at(last).joined(self.guard.inserted_known.at(last))
        here = own.at(last).joined(here.rows(np.flatnonzero(here.present[:, 0]).tolist()))
        return any(True for _ in contacts_at_end(here, export_bounds(self.scene.config), step_s=self.scene.step_s))

    def to_roll_anew(self, candidate: RolledOut) -> list[RolledOut]:
        """Those chosen that may drive otherwise with a candidate: followers, lane changers near it, later entrants."""
        found = {
            name for name, one in self._chosen.items()
            if one.start.step > candidate.start.step or (len(one.parts) > 1 and self._may_be_in_gap(candidate, one))
        }  # fmt: skip
        for part in candidate.parts:
            met, known = self._met(candidate.start, part)
            followers = known.agents[met[:, LAG_TTC] < _HINDERED_S] - self.scene.num_recorded
            found |= {self.guard.inserted_known.ids[row] for row in followers[followers >= 0].tolist()}
        return [one for name, one in self._chosen.items() if name in found]

    def _may_be_in_gap(self, candidate: RolledOut, changer: RolledOut) -> bool:
        """Whether a candidate comes near a vehicle that changes lanes, on one of the lanes that this drives on."""
        own, other = candidate.traffic, changer.traffic
        apart_m = np.abs(own.position - other.position).max(axis=-1)[own.present & other.present]
        if apart_m.min(initial=math.inf) > _NEAR_GAPS_M:
            return False
        return bool(self.scene.met_on(changer.parts[-1].path, changer.start.box, own).agents.size)

    def roll(
        self, start: Start, *, path: DrivenPath | None = None, step: int | None = None,
        before: Rollout | None = None, last: int | None = None, target: DrivenPath | None = None,
    ) -> Rollout:  # fmt: skip
        """How a vehicle drives on: from its start, or from a step of the motion before on another path.

        last: step of the scene at which to stop looking, its last one unless told; target: path of the lane that it
        changes to, on which SUMO has it as soon as the change begins.
        """
        scene, box, driver = self.scene, start.box, start.driver
        path = path or start.path
        first = start.step if step is None else step
        last = scene.num_steps - 1 if last is None else min(last, scene.num_steps - 1)
        known, lines = self.guard.known_on(path, box), self.guard.stop_lines.on(path, box)
        shown = self._shown_on(path, box) if target is None else self._shown_beside(path, target, box)
        state, memory = (start.start_m, start.start_mps, 0.0), np.zeros(0)
        if before is not None:
            k = first - before.step
            gained_mps = float(before.v[k] - before.v[max(k - 1, 0)])
            state = float(before.s[k]), float(before.v[k]), gained_mps / scene.step_s
            memory = before.memory[k].copy()
        s, v, memories = roll(
            (first, last), state, start.desired, driver.following, scene.config.drivers.reaction_s, start.size.length_m,
            self.guard.horizon, scene.step_s, self.guard.brakes, self.roads.speeds(path, driver),
            *self.roads.lanes(path), known.low, known.high, known.along, known.same_direction, lines.stops_m(driver),
            lines.closed, lines.cause, shown.middle, shown.speed, shown.leads, shown.length_m, *self._links_on(path),
            memory, scene.config.grid.cell_m,
        )  # fmt: skip
        return Rollout(path, first, s, v, memories)

    def roll_manoeuvre(self, start: Start) -> tuple[DrivenVehicle, tuple[Rollout, ...]]:
        """How a vehicle drives on with Algorithm 1, by the configured rule: what becomes of it, and its motion.

        A part of the motion ends with each lane change, and the next one begins with the state that it ended in.
        """
        scene = self.scene
        vehicle, parts = DrivenVehicle(start, start.path), [self.roll(start)]
        step = max(start.step, math.ceil(start.request.trigger_s / scene.step_s - 1e-9))  # sums of steps
        ask_sumo = (lambda _: ASSUMED_ANSWER) if scene.config.lane_change.rule == "LC2013" else None
        while step < scene.num_steps:
            part, k = parts[-1], step - parts[-1].step
            if k >= part.s.size or part.s[k] > part.path.exit_m:  # met, or off the map
                break
            _drive_on(vehicle, part, step)
            is_due = advance(vehicle, scene, step)
            if vehicle.stage in (Stage.DONE, Stage.ABORTED):
                break
            if not is_due:  # on its way across
                over_m = part.path.lateral_spans[-1].end if part.path.lateral_spans else 0.0
                step = max(step + 1, part.step + int(np.searchsorted(part.s, over_m)))
                continue
            due = ManoeuvreDue(scene, vehicle, step, self.guard.inserted_known, _NONE)
            if vehicle.stage is Stage.PASS:
                short_m = scene.config.overtake.return_gap_m - due.passed_gap_m()
                if short_m > 0.0:
                    vehicle.reason = Reason.NOT_AHEAD  # what it would be told, sooner
                    waits_s = _PASSING_LOOKS_S
                    if short_m < vehicle.v[-1] * waits_s:
                        waits_s = short_m / vehicle.v[-1]
                    step += max(1, int(waits_s / scene.step_s))
                    continue
            across = due.observe_and_decide(ask_sumo)
            if vehicle.reason is Reason.SCENE_ENDS:
                break
            if across is not None and self._meets_on(vehicle, step, across.path):
                due.refuse(Reason.CONFLICT_PREDICTED)
            elif across is not None:
                across.taken_by(vehicle)
                onto = self.roll(start, path=across.path, step=step, before=part, target=across.shift.target)
                parts[-1] = part.until(step)
                parts.append(self._jumped(start, vehicle.path, onto, across.shift.side))
                vehicle.path = across.path
            step += scene.steps_in(_PASSING_LOOKS_S if vehicle.stage is Stage.PASS else _LOOKS_S)
        return vehicle, tuple(parts)

    def _jumped(self, start: Start, source: DrivenPath, onto: Rollout, side: Side) -> Rollout:
        """The motion onto another lane from the own place on; SUMO's jump to the facing cell fades out (`Jump`)."""
        grid, front = self.scene.grid, float(onto.s[0]) + 0.5 * start.size.length_m
        segment = next((one for one in source.followed if one.end > front), source.followed[-1])
        cell = grid.cell_at(segment.lane_id, segment.lane_m(front))
        facing = grid.lateral(cell, side)
        if facing is None:
            return onto
        off = grid.edges_m[facing.lane_id][cell.index] - grid.edges_m[cell.lane_id][cell.index]
        there = onto.path.s_on(facing.lane_id, segment.lane_m(front) + float(off), after=float(onto.s[0]))
        if there is None:
            return onto
        own = onto.s + (there - front)
        return replace(onto, s=own + Jump.onto(onto.path, float(own[0]), front - there).left_m(own))

    def _meets_on(self, vehicle: DrivenVehicle, step: int, path: DrivenPath) -> bool:
        """Whether the guard would not let a vehicle go across on a path."""
        start, state = vehicle.start, (vehicle.s[-1], vehicle.v[-1], 0.0)
        going = OwnMotion(state, float(start.desired[step]), self.roads.speeds(path, start.driver), start.driver)
        obstacles, fleet = self.guard.obstacles(path, start.box, []), np.array([[*state, 0.0, 1.0]])
        return self.guard.braking(obstacles, going, step, fleet, own=0, horizon_s=ACROSS_S).forbids(start.driver)

    def rejection_reason(self, start: Start, parts: tuple[Rollout, ...], *, ends: bool = True) -> Reason | None:
        """Why a candidate is not taken; None for nothing.

        What it meets or leaves too little time to, as the final check has it, and what no driver does: it enters on
        red, waits for a parked vehicle, stands in an intersection. Followers chosen before it are not asked: they are
        rolled out anew and brake for it (`to_roll_anew`).
        ends: whether the scene ends with the last part.
        """
        found = (self._part_rejection(start, part, is_last=ends and part is parts[-1]) for part in parts)
        return next((reason for reason in found if reason is not None), None)

    def _part_rejection(self, start: Start, rollout: Rollout, *, is_last: bool) -> Reason | None:
        scene, conflict = self.scene, self.scene.config.conflict
        inside = self._steps_on_map(start, rollout)
        stays_until = start.step + scene.steps_to_stay(start.step)
        leaves = is_last and inside < rollout.s.size and rollout.step + inside < stays_until
        if leaves or not inside:
            return Reason.LEAVES_TOO_EARLY
        met, known = self._met(start, rollout)
        is_recorded = known.agents < scene.num_recorded
        is_kept = ~is_recorded & (known.agents < scene.num_recorded + len(self._kept.ids))  # they brake for no new one
        least = met.min(axis=0, initial=math.inf)
        if least[CONTACT] < np.inf:
            return Reason.MEETS_RECORDED if is_recorded[np.argmin(met[:, CONTACT])] else Reason.MEETS_GENERATED
        unseen, steps = scene.unseen_on(rollout.path, start.box), rollout.step + np.arange(inside)
        if ((unseen.low[:, steps] < rollout.s[:inside]) & (rollout.s[:inside] < unseen.high[:, steps])).any():
            return Reason.MEETS_RECORDED
        if least[LEAD_TTC] < conflict.ttc_min_s:
            return Reason.TTC_LANE_LEADER
        if least[LAG_TTC] < max(conflict.follower_ttc_min_s, conflict.ttc_min_s):
            if met[is_recorded, LAG_TTC].min(initial=math.inf) < conflict.follower_ttc_min_s:
                return Reason.TTC_RECORDED_FOLLOWER
            if met[is_kept, LAG_TTC].min(initial=math.inf) < conflict.ttc_min_s:
                return Reason.MEETS_GENERATED
        if is_kept.any():
            seen = gaps_on_path(known, rollout.s[:inside], steps, among=known.same_direction & is_kept[:, None])
            length_m = start.box.length_m - start.beyond_m
            if sustained_headway(seen.lag_m, length_m, seen.lag_mps, scene.step_s)[0] < FOLLOWER_HEADWAY_S:
                return Reason.FOLLOWER_HEADWAY
        if is_last and rollout.s[inside - 1] - start.start_m < MOVES_M:
            return Reason.STANDS_THROUGHOUT
        lines = self.guard.stop_lines.on(rollout.path, start.box)
        if lines.is_passed(rollout.s, start.driver, first=rollout.step, closed_steps=scene.steps_in(AMBER_S)):
            return Reason.ENTERS_ON_RED
        if self._waits_for_parked(start, rollout):
            return Reason.BEHIND_PARKED
        return Reason.STOPS_IN_INTERSECTION if self._stops_in_intersection(rollout) else None

    def parked_on(self, path: DrivenPath, box: BoxSize) -> BoolArray:
        """(R,) which of those known on a path are recorded agents that are parked."""
        agents = self.guard.known_on(path, box).agents
        found = agents < self.scene.num_recorded
        found[found] = self.scene.parked[agents[found]]
        return found

    def _waits_for_parked(self, start: Start, rollout: Rollout) -> bool:
        """Whether a vehicle all but stands behind one that is parked: a driver would go round it."""
        at = np.flatnonzero(rollout.v < SLOWEST_SHARE * start.driver.desired_mps)
        if not at.size:
            return False
        seen = gaps_on_path(self.guard.known_on(rollout.path, start.box), rollout.s[at], rollout.step + at)
        near = (seen.leader >= 0) & (seen.lead_m < QUEUE_M)
        return bool(self.parked_on(rollout.path, start.box)[seen.leader[near]].any())

    def _stops_in_intersection(self, rollout: Rollout) -> bool:
        """Whether a vehicle stands inside an intersection, as `measures/encounters.py` has standing."""
        at = np.flatnonzero(rollout.v < STANDS_MPS)
        if not at.size:
            return False
        lanes, along, (ends, _, _) = self.scene.grid.graph.lanes, rollout.path.followed, self._links_on(rollout.path)
        link = np.searchsorted(ends, rollout.s[at], side="right")
        blocks = np.array([lanes[one.lane_id].is_intersection for one in along])[np.minimum(link, len(along) - 1)]
        runs = np.split(at[blocks], np.flatnonzero(np.diff(at[blocks]) > 1) + 1)
        return max(run.size for run in runs) >= self.scene.steps_in(STANDS_FOR_S)

    def _steps_on_map(self, start: Start, rollout: Rollout) -> int:
        """Steps of a motion before its front bumper leaves the map."""
        return int(np.searchsorted(rollout.s, rollout.path.exit_m - 0.5 * start.size.length_m, side="right"))

    def _met(self, start: Start, rollout: Rollout) -> tuple[FloatArray, PathOccupancy]:
        """Contact and TTCs of a motion with each known agent on its path (R, 3), as `met_by` has them; those agents."""
        known, inside = self.guard.known_on(rollout.path, start.box), self._steps_on_map(start, rollout)
        return met_by(
            rollout.s[:inside], rollout.v[:inside], rollout.step, known.low, known.high, known.along,
            known.same_direction, self.scene.step_s,
        ), known  # fmt: skip

    @once
    def _links_on(self, path: DrivenPath) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Of the lanes that SUMO has along a path: ends m, metres on the path for one on the lane, m/s for turns."""
        lanes, along = self.scene.grid.graph.lanes, path.followed
        ends = np.array([one.end for one in along])
        paces = np.array([(one.end - one.start) / max(one.lane_end - one.lane_start, 1e-9) for one in along])
        limit_mps = speed_limit_mps(self.scene.config.spawn.max_speed_mps)
        most_mps = [_TURN_MPS.get(lanes[one.lane_id].turn, limit_mps) for one in along]
        return ends, paces, np.array(most_mps)

    def _shown_on(self, path: DrivenPath, box: BoxSize) -> Shown:
        scene, known, newest = self.scene, self.guard.inserted_known, self._newest.get((path, box))
        if newest is not None and newest[0] is known:
            return newest[2]
        found, inserted = scene.shown_on(path, box), scene.met_on(path, box, known)
        if newest is not None and newest[1] is inserted:
            found = newest[2]
        elif inserted.agents.size:
            found = found.joined(shown_on(path, known, inserted, step_s=scene.step_s))
        self._newest[path, box] = known, inserted, found
        return found

    def _shown_beside(self, path: DrivenPath, target: DrivenPath, box: BoxSize) -> Shown:
        """Those on the path of a lane, by the arc length of a path that leads across to it."""
        over = path.lateral_spans[-1].end
        there, _ = target.frenet(path.line.position(np.array([over])))
        seen = self._shown_on(target, box)
        return replace(seen, middle=seen.middle - (float(there[0]) - over))


def _drive_on(vehicle: DrivenVehicle, part: Rollout, step: int) -> None:
    """A vehicle has driven the part of its motion up to a step."""
    since = vehicle.start.step + len(vehicle.s)
    driven = slice(since - part.step, step - part.step + 1)
    vehicle.s += part.s[driven].tolist()
    vehicle.v += part.v[driven].tolist()
