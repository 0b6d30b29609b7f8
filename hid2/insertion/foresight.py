"""Manoeuvres as they are foreseen when a vehicle is placed: whether each would come about, and where it would lead.

A vehicle is placed for a manoeuvre only where the whole of it can be seen to fit into road, traffic and scene
(paper, Lane Change, Overtaking; the same checks are made again, at every step, while it drives).
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from hid2.agents import DEFAULT_SIZES, BoxSize, Policy, Track
from hid2.conflicts.cases import DT_S, Prospect
from hid2.conflicts.speed_plan import SpeedPlan
from hid2.kernels.compiled import planner_kernel
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.motion.route import DrivenPath, first_turn
from hid2.motion.verify import off_road_steps
from hid2.occupancy.traffic import Traffic
from hid2.policy.decision import LaneOption, Side
from hid2.policy.lane_change import lane_change_reason
from hid2.policy.maneuver import admissible_neighbor, gap_ahead_of, lane_options, lay_across, leader_on, returns_to
from hid2.policy.overtake import Leader, enter_reason, return_reason
from hid2.policy.turns import TURN_OF_POLICY
from hid2.scene import World, predicted_traffic

#: Of the lane beside, for a change that begins a little later than foreseen.
SPARE_LANE_M = 8.0
_SPARE_STEPS = 4  # a foreseen manoeuvre ends this long before the scene does: SUMO will be a little later
_TURN_SPARE_SHARE = 0.09  # of the scene: yielding to who crosses costs SUMO more time than the plan
#: Driven on the lane behind a turn, for it to be through.
BEHIND_TURN_M = 1.0
_ROAD_STEPS = 4  # between two looks at the corners of the box on a foreseen turn
_HURRY = 1.25  # of the desired speed, at most, on the whole way into a turn and through it
_RETURN_STEPS = 26  # lateral motion back into the lane, at its shortest
_RETURN_SPARE_M = 1.5
#: An overtake, out, past and back, takes at least so many steps.
PASS_STEPS = 65
_CHANGE_DELAYS = (0, 10, 24, 40)  # steps behind the trigger at which a manoeuvre is tried
_OVERTAKE_DELAYS = (0, 6, 12)
LATEST_S = max(*_CHANGE_DELAYS, *_OVERTAKE_DELAYS) * DT_S  # behind the trigger, that a manoeuvre is foreseen to begin
_CLAIM_BOX = BoxSize(8.0, 1.4)
_CLAIM_BEHIND_M, _CLAIM_STEPS = 8.0, 6
_SIGHT_M = 80.0  # to the leader at the start of the scene
_HASTE_MPS = 1.0  # above the desired speed, at most, while it passes
_NEVER_PASSED_M = 12.0  # who could get no further ahead at its best never gets past when planned in traffic
_FOLLOWING_MPS = 0.3  # faster than the leader while following it
_SPEEDING_UP_MPS2, _SLOWING_MPS2 = 1.2, 1.5
_LENGTH_STEP_M, _WIDTH_STEP_M = 0.5, 0.1
_FOLLOWER_SPARE_S = 0.6  # SUMO drives a little slower than the plan


@dataclass(frozen=True, eq=False, slots=True)
class Wish:
    """A vehicle that is looked for a place. steady: it keeps cruise_mps from the start."""

    policy: Policy
    vehicle_id: str
    object_type: str
    own_size: BoxSize
    trigger_s: float
    cruise_mps: float | None = None
    steady: bool = False
    size: BoxSize = field(init=False)
    """Box that covers the vehicle and what a reader without the sidecar takes it for."""

    def __post_init__(self) -> None:
        """Round up, so that vehicles of nearly the same size share what was computed about a path."""
        assumed, own = DEFAULT_SIZES[self.object_type], self.own_size
        length = math.ceil(max(own.length_m, assumed.length_m) / _LENGTH_STEP_M) * _LENGTH_STEP_M
        width = math.ceil(max(own.width_m, assumed.width_m) / _WIDTH_STEP_M) * _WIDTH_STEP_M
        object.__setattr__(self, "size", BoxSize(length, width))

    @property
    def trigger_step(self) -> int:
        """First step at which the manoeuvre is asked for."""
        return int(np.ceil(self.trigger_s / DT_S))


@dataclass(frozen=True, eq=False, slots=True)
class Intention:
    """What a vehicle is foreseen to do.

    path: with its manoeuvre on it; plan: its motion there; own: its motion on the path without the manoeuvre, up to
    where it begins; sides: where it looks for a lane, in order; claims: room on the lane beside that it will ask for.
    """

    path: DrivenPath
    plan: SpeedPlan
    own: SpeedPlan
    sides: tuple[Side, ...] = ()
    claims: Traffic | None = None


@dataclass(frozen=True, eq=False, slots=True)
class Foresight:
    """Looks ahead for one vehicle among the recorded ones, those of earlier rounds, and those planned before it.

    claims: room that manoeuvres planned before will ask for; nobody drives through it.
    """

    world: World
    fixed: Traffic
    predicted: Traffic
    claims: Traffic
    _looks: dict[tuple[DrivenPath, BoxSize], Prospect] = field(default_factory=dict)
    _vehicles: list[Traffic] = field(default_factory=list)
    _at_start: list[Traffic] = field(default_factory=list)

    @property
    def vehicles(self) -> Traffic:
        """Whom an overtaker may pass: recorded cars and buses, and all generated ones; joined once."""
        if not self._vehicles:
            self._vehicles.append(self.world.vehicles.joined(self.fixed, self.predicted))
        return self._vehicles[0]

    def prospect(self, path: DrivenPath, size: BoxSize, cruise_mps: float) -> Prospect:
        """Everybody along a path, at a desired speed."""
        return replace(self.along(path, size), desired=self.world.desired(path, cruise_mps))

    def along(self, path: DrivenPath, size: BoxSize) -> Prospect:
        """Everybody along a path, for one that goes as fast as the road allows; looked up once for each size of box."""
        look = self._looks.get((path, size))
        if look is None:
            everybody = self.fixed, self.predicted, self.claims
            look = self._looks[path, size] = self.world.prospect(path, size, cruise_mps=math.inf, others=everybody)
        return look

    @property
    def at_start(self) -> Traffic:
        """Everybody at step 0; joined once."""
        if not self._at_start:
            self._at_start.append(self.world.traffic.at(0).joined(self.fixed.at(0), self.predicted.at(0)))
        return self._at_start[0]

    def conflict(self, wish: Wish, intention: Intention) -> str | None:
        """Why a reader of the positions would not think it safe among the recorded vehicles, which will not brake."""
        critical = self.world.config.conflict
        if {"collision", "topology"} & self.world.config.without:
            return None
        one = predicted_traffic(
            [(wish.vehicle_id, intention.path, wish.own_size, intention.plan.s)], self.world.num_steps
        )
        there = np.flatnonzero(one.present[0])
        track = Track(
            wish.vehicle_id, wish.object_type, 1, there, one.position[0, there], one.heading[0, there],
            one.velocity[0, there], wish.own_size,
        )  # fmt: skip
        return self.world.recorded.conflict_with(
            track,
            ttc_s=critical.follower_ttc_min_s + (_FOLLOWER_SPARE_S if critical.follower_ttc_min_s > 0.0 else 0.0),
            pet_s=critical.pet_min_s,
        )

    def turn_end(self, wish: Wish, path: DrivenPath, s0: float, cruise_mps: float) -> float | str:
        """Arc length behind the first turn of the wanted kind, m; or why it cannot be driven, whoever is there.

        It must be through before the scene, or the map, ends.
        """
        turn = first_turn(self.world.grid.graph, path, TURN_OF_POLICY[wish.policy], after=s0)
        if turn is None or turn.end + BEHIND_TURN_M > path.exit_s - wish.size.length_m / 2:
            return "turn_leaves_map"
        end = turn.end + BEHIND_TURN_M
        desired = self.world.desired(path, cruise_mps)[int(s0 / TABLE_STEP_M) : int(end / TABLE_STEP_M)]
        lasting_s = float((TABLE_STEP_M / desired).sum()) / _HURRY
        return end if lasting_s < self.turned_by * DT_S else "turn_not_reached"

    @property
    def turned_by(self) -> int:
        """Step by which a foreseen turn is through."""
        return self.world.num_steps - math.ceil(_TURN_SPARE_SHARE * self.world.num_steps)

    def turn(self, wish: Wish, path: DrivenPath, plan: SpeedPlan, end: float) -> Intention | str:
        """Whether a plan gets behind the end of the turn, m, soon enough, and the box stays on the road on the way."""
        if plan.s[self.turned_by] < end:
            return "turn_not_reached"
        position, tangent, _ = path.line.motion(plan.s[::_ROAD_STEPS])
        heading = np.arctan2(tangent[:, 1], tangent[:, 0])
        off = off_road_steps(
            position, heading, wish.size, self.world.grid.graph.drivable, tolerance_m=self.world.road_tolerance_m
        )
        return "turn_off_road" if off.any() else Intention(path, plan, plan)

    def lane_change(
        self, wish: Wish, path: DrivenPath, plan: SpeedPlan, cruise_mps: float, sides: tuple[Side, ...]
    ) -> Intention | str:
        """Try the change at the trigger, then a little later, from the plan on the own lane."""
        change = self.world.config.lane_change
        reason = "scene_too_short"
        for delay in _CHANGE_DELAYS:
            step = wish.trigger_step + delay
            if step >= plan.s.size - int(change.min_duration_s / DT_S):
                break
            s, speed = float(plan.s[step]), float(plan.v[step])
            if speed < change.min_speed_mps:
                reason = "too_slow"
                continue
            later = path.segment_at(s + SPARE_LANE_M).lane_id
            lasting = tuple(side for side in sides if admissible_neighbor(self.world, later, side) is not None)
            if not lasting:
                reason = "lane_ends"
                continue
            least_m = change.min_remaining_m + SPARE_LANE_M
            for option, target in self._options(wish, path, step, s, speed, lasting, cruise_mps, least_m):
                unmet = lane_change_reason(
                    speed_mps=speed, cells_free=option.cells_free, front=option.front, rear=option.rear,
                    remaining_m=option.remaining_m - SPARE_LANE_M, params=change,
                )  # fmt: skip
                across = unmet or self._across(wish, path, target, plan, step, option.remaining_m, cruise_mps)
                if not isinstance(across, str):
                    claims = self._claim(target, option, speed, step, change.min_gap_m + 0.5 * speed)
                    return Intention(across[0], across[1], plan, (option.side, _opposite(option.side)), claims)
                reason = across
            reason = reason if reason != "scene_too_short" else "no_adjacent_lane"
        return f"lane_change_{reason}"

    def overtake(
        self, wish: Wish, path: DrivenPath, s0: float, v0: float, cruise_mps: float, *, obstacles: bool
    ) -> Intention | str:
        """Enter at the trigger or a little later, pass, and find room to return before the scene ends.

        The vehicle comes up to its leader at v0 where there is room for that; else it starts slower, down to the
        leader's own speed, follows it and speeds up on its way out. obstacles: a leader that stands may be passed too.
        """
        vehicles = self.vehicles
        first = self.leader_at_start(wish, path, s0)
        speeds = [v0]
        if first is not None and first.speed_mps + _FOLLOWING_MPS < v0:
            following = max(first.speed_mps, self.world.config.overtake.parked_mps) + _FOLLOWING_MPS
            speeds += [0.5 * (v0 + following), following]
        reason = "no_leader"
        for speed in speeds:
            found = self._overtake_from(wish, path, s0, speed, cruise_mps, vehicles, obstacles=obstacles)
            if isinstance(found, Intention):
                return found
            reason = found
            if reason != "leader_too_near":
                break
        return "no_leader" if reason == "no_leader" else f"overtake_{reason}"

    def _overtake_from(
        self, wish: Wish, path: DrivenPath, s0: float, v0: float, cruise_mps: float, vehicles: Traffic, *,
        obstacles: bool,
    ) -> Intention | str:  # fmt: skip
        overtake = self.world.config.overtake
        approach = self._approach(path, s0, v0)
        reason = "scene_too_short"
        for delay in _OVERTAKE_DELAYS:
            step = wish.trigger_step + delay
            if step >= self.world.num_steps - PASS_STEPS:
                break
            s, speed = float(approach.s[step]), float(approach.v[step])
            leader = leader_on(path, wish.size, s=s, step=step, d_obs_m=overtake.d_obs_m, vehicles=vehicles)
            if leader is None or (leader.speed_mps < overtake.parked_mps and not obstacles):
                reason = "no_leader"
                continue
            if leader.gap_m < self._braking_gap_m(speed, leader.speed_mps):
                return "leader_too_near"  # nearer still later on
            if not self._may_pass(wish, leader, vehicles, step, speed, cruise_mps):
                return "not_passed"
            for option, target in self._options(wish, path, step, s, speed, ("left", "right"), cruise_mps):
                unmet = enter_reason(
                    leader=leader, desired_mps=cruise_mps, lane_available=option.cells_free, ahead=option.front,
                    behind=option.rear, free_corridor_m=option.corridor_m, params=overtake,
                )  # fmt: skip
                entered = unmet or self._enter(wish, path, target, approach, step, option.remaining_m, cruise_mps)
                if isinstance(entered, str):
                    reason = entered
                    continue
                back = _opposite(option.side)
                done = self._return(wish, path, entered[0], entered[1], leader, back, vehicles, cruise_mps)
                if not isinstance(done, str):
                    claims = self._claim(target, option, speed, step, overtake.d_overtake_m).joined(done[2])
                    return Intention(done[0], done[1], entered[1], (option.side, back), claims)
                reason = done
            if reason == "not_passed":
                break  # later on there is less time for it
        return reason

    def leader_at_start(self, wish: Wish, path: DrivenPath, s0: float) -> Leader | None:
        """Vehicle that one starting at s0 would have ahead of it."""
        return leader_on(path, wish.size, s=s0, step=0, d_obs_m=_SIGHT_M, vehicles=self.vehicles)

    def following_apart_m(self, wish: Wish, lead: Wish) -> float:
        """Centre to centre distance at which an overtaker may follow a new leader at the leader's speed."""
        following, slow = self.world.config.car_following, lead.cruise_mps or 0.0
        boxes = 0.5 * (wish.size.length_m + lead.size.length_m)
        return boxes + self._braking_gap_m(slow + _FOLLOWING_MPS, slow) + following.min_gap_m

    def _may_pass(
        self, wish: Wish, leader: Leader, vehicles: Traffic, step: int, speed_mps: float, cruise_mps: float
    ) -> bool:
        """Whether one that speeds up from a step on, on a free lane, gets ahead of the leader in time to return."""
        following, last = self.world.config.car_following, self.world.num_steps - _RETURN_STEPS
        row = vehicles.ids.index(leader.track_id)
        if not vehicles.present[row, last]:
            return True
        led_m = float(np.hypot(*(vehicles.position[row, last] - vehicles.position[row, step])))
        lasting_s, gain_mps = (last - step) * DT_S, max(cruise_mps + _HASTE_MPS - speed_mps, 0.0)
        speeding_s = min(gain_mps / following.accel_mps2, lasting_s)
        own_m = speed_mps * lasting_s + following.accel_mps2 * speeding_s * (lasting_s - 0.5 * speeding_s)
        past_m = leader.gap_m + leader.length_m + wish.size.length_m + self.world.config.overtake.return_gap_m
        return own_m > led_m + past_m + _NEVER_PASSED_M

    def _approach(self, path: DrivenPath, s0: float, v0: float) -> SpeedPlan:
        """Motion at v0, slower where the road asks for it, as if nobody were ahead."""
        s, v = _approach(self.world.desired(path, v0), s0, v0, self.world.num_steps)
        return SpeedPlan(s=s, v=v, cost=0.0)

    def _braking_gap_m(self, speed_mps: float, leader_mps: float) -> float:
        """Gap at which SUMO's car following begins to brake for a leader; nearer than that it never overtakes."""
        following = self.world.config.car_following
        braking = (speed_mps**2 - leader_mps**2) / (2 * following.decel_mps2)
        return max(braking, 0.0) + speed_mps * following.tau_s

    def _enter(
        self, wish: Wish, path: DrivenPath, target: DrivenPath, approach: SpeedPlan, step: int, remaining_m: float,
        cruise_mps: float,
    ) -> tuple[DrivenPath, SpeedPlan] | str:  # fmt: skip
        """First stage, planned from the start of the scene: the path out, and the motion on it."""
        s, pace = float(approach.s[step]), float(approach.v[step])
        across = lay_across(
            self.world, path, target, s=s, step=step, pace_mps=0.5 * (pace + min(cruise_mps, pace + 4.0)),
            remaining_m=remaining_m, policy=wish.policy,
        )  # fmt: skip
        if isinstance(across, str):
            return across
        look = self.prospect(across, wish.size, cruise_mps)
        begins = across.shifts[-1][0]
        unhurried = look.desired.copy()  # it does not press its leader before it moves out
        before = slice(0, int(begins / TABLE_STEP_M))
        unhurried[before] = np.minimum(unhurried[before], max(pace, float(approach.v[0])))
        look = replace(look, desired=unhurried).held_back(step, begins)
        plan = look.plan(
            s0=float(approach.s[0]), v0=float(approach.v[0]), a0=0.0, first_step=0, config=self.world.config
        )
        return "conflict_predicted" if plan is None else (across, plan)

    def _return(
        self, wish: Wish, lane: DrivenPath, path: DrivenPath, plan: SpeedPlan, leader: Leader, side: Side,
        vehicles: Traffic, cruise_mps: float,
    ) -> tuple[DrivenPath, SpeedPlan, Traffic] | str:  # fmt: skip
        """Third stage: the first steps at which the passed vehicle is far enough behind."""
        overtake = self.world.config.overtake
        passed = np.flatnonzero(plan.s >= path.shifts[-1][1])
        reason = "not_passed"
        for step in passed[::3].tolist():
            if step >= plan.s.size - _RETURN_STEPS:
                break
            s = float(plan.s[step])
            gap = gap_ahead_of(
                path, wish.size, s=plan.s, step=step, lane=lane, passed_id=leader.track_id, vehicles=vehicles
            )
            if gap < overtake.return_gap_m + _RETURN_SPARE_M:
                continue
            reason = "return_no_adjacent_lane"
            if admissible_neighbor(self.world, path.segment_at(s + SPARE_LANE_M).lane_id, side) is None:
                continue
            for option, target in self._options(wish, path, step, s, float(plan.v[step]), (side,), cruise_mps):
                unmet = return_reason(
                    lead_gap_m=gap, lane_available=option.cells_free, ahead=option.front, params=overtake
                )
                back = unmet or self._across(wish, path, target, plan, step, option.remaining_m, cruise_mps)
                if not isinstance(back, str) and not returns_to(lane, back[0]):
                    back = "lanes_part"
                if not isinstance(back, str):
                    ahead_m = overtake.safe_front_m + _CLAIM_BEHIND_M
                    return *back, self._claim(target, option, float(plan.v[step]), step, ahead_m)
                reason = f"return_{back}"
        return reason

    def _claim(self, target: DrivenPath, option: LaneOption, speed_mps: float, step: int, ahead_m: float) -> Traffic:
        """Boxes that hold the lane beside free, from some metres behind to ahead_m ahead, when the change is due.

        They move with the vehicle. Without them those who are planned later fill the gap that was foreseen.
        """
        at = target.exit_s - option.remaining_m
        steps = np.arange(self.world.num_steps)
        moving = at + speed_mps * (steps - step) * DT_S
        offsets = np.arange(-_CLAIM_BEHIND_M, ahead_m + 0.5 * _CLAIM_BOX.length_m, _CLAIM_BOX.length_m)
        rows = [("claim", target, _CLAIM_BOX, moving + offset) for offset in offsets.tolist()]
        boxes = predicted_traffic(rows, self.world.num_steps)
        return replace(boxes, present=boxes.present & (np.abs(steps - step) <= _CLAIM_STEPS))

    def _options(
        self, wish: Wish, path: DrivenPath, step: int, s: float, speed_mps: float, sides: tuple[Side, ...],
        cruise_mps: float, least_m: float = 0.0,
    ) -> Iterator[tuple[LaneOption, DrivenPath]]:  # fmt: skip
        yield from lane_options(
            self.world, path, wish.size, s=s, step=step, sides=sides, others=(self.fixed, self.predicted),
            speed_mps=speed_mps, desired_mps=cruise_mps, least_m=least_m,
        )  # fmt: skip

    def _across(
        self, wish: Wish, path: DrivenPath, target: DrivenPath, plan: SpeedPlan, step: int, remaining_m: float,
        cruise_mps: float,
    ) -> tuple[DrivenPath, SpeedPlan] | str:  # fmt: skip
        """The path across from a step of a plan on, and the plan on it; or why there is none."""
        speed, s = float(plan.v[step]), float(plan.s[step])
        pace = max(speed, 0.5 * (speed + float(plan.v[min(step + 20, plan.v.size - 1)])))
        across = lay_across(
            self.world, path, target, s=s, step=step, pace_mps=pace, remaining_m=remaining_m, policy=wish.policy
        )
        if isinstance(across, str):
            return across
        look = self.prospect(across, wish.size, cruise_mps)
        accel = float(np.clip((plan.v[step] - plan.v[max(step - 1, 0)]) / DT_S, -2.0, 1.5))
        onward = look.plan(s0=s, v0=speed, a0=accel, first_step=step, config=self.world.config)
        if onward is None:
            return "conflict_predicted"
        if onward.s[-_SPARE_STEPS] < across.shifts[-1][1]:
            return "would_not_complete"
        return across, SpeedPlan(
            s=np.concatenate([plan.s[:step], onward.s]), v=np.concatenate([plan.v[:step], onward.v]), cost=onward.cost
        )


def _opposite(side: Side) -> Side:
    return "right" if side == "left" else "left"


@planner_kernel
def _approach(desired, s0, v0, steps):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    s, v = np.empty(steps), np.empty(steps)
    s[0], v[0] = s0, v0
    for k in range(1, steps):
        wanted = desired[min(int(s[k - 1] / TABLE_STEP_M), desired.size - 1)]
        v[k] = v[k - 1] + min(max(wanted - v[k - 1], -_SLOWING_MPS2 * DT_S), _SPEEDING_UP_MPS2 * DT_S)
        s[k] = s[k - 1] + 0.5 * (v[k] + v[k - 1]) * DT_S
    return s, v
