"""Algorithm 1 of the paper: the decision of one generated agent at one step. Values in, a value out."""

import math
from dataclasses import dataclass, field, replace

from hid2.agents import Policy
from hid2.drivers.driver import Driver
from hid2.params import LaneChange, Overtake
from hid2.policy.behaviours import BEHAVIOURS, POLICY_OF_TURN
from hid2.policy.lane_change import OPEN, Gap, LaneOption
from hid2.policy.overtake import Stage, enter_reason, return_reason
from hid2.policy.rules import GapView, rule_reason, rule_refusals
from hid2.reasons import Reason
from netconvert.cells import Cell
from netconvert.lane_graph import Side, TurnType


@dataclass(frozen=True, slots=True)
class Observation:
    """What the agent knows at time t: the cell ahead, lane type, request, leader, and adjacent lanes.

    leader: gap to the next vehicle on its lane, None where none is near or no overtake may begin; options: the lanes of
    the sides that the request allows, in the order in which they are tried; own_front, own_rear: gaps ahead and behind
    on its lane, OPEN also where no rule asks; passed_gap_m: as `gap_to_passed` has it; next_cell: of its lane, None at
    the lane's end.
    """

    time_s: float
    next_cell: Cell | None
    lane_turn: TurnType
    speed_mps: float
    driver: Driver
    request: Policy
    trigger_s: float
    stage: Stage
    leader: Gap | None
    options: tuple[LaneOption, ...]
    passed_gap_m: float = -math.inf
    length_m: float = 4.5
    own_front: Gap = OPEN
    own_rear: Gap = OPEN
    vehicle_id: str = ""


@dataclass(frozen=True, slots=True)
class Decision:
    """policy_i and g_i^{t+1}.

    reason: why the last lane looked at was not taken, or NO_ADJACENT_LANE; None where one is, or none is due; target:
    g_i^{t+1}, as the listing returns it; what is carried out is a change of lanes to `side`. answers: of each adjacent
    lane looked at, in order, the conditions that refuse it (of an overtake one), empty where it is taken.
    """

    policy: Policy
    target: Cell | None
    side: Side | None = None
    reason: Reason | None = None
    answers: tuple[tuple[Reason, ...], ...] = field(default=(), compare=False)


def is_due(stage: Stage, time_s: float, trigger_s: float) -> bool:
    """Whether a manoeuvre may begin, or an overtake turn back: from t_trigger on, and not while it is on its way."""
    return time_s >= trigger_s and stage in (Stage.WAITING, Stage.PASS)


def decide(seen: Observation, *, lane_change: LaneChange, overtake: Overtake) -> Decision:
    """Algorithm 1 (Agent Decision). Overtakes too wait for the trigger time, as only lane changes do in its listing.

    In its listing an agent that cannot change lanes overtakes; here each does what it is asked for, one of the two.
    The target is g_{l',j}, as in the paper's text (its listing has j+1). "Not feasible" is a reason, no exception.
    """
    reason: Reason | None = None
    answers: list[tuple[Reason, ...]] = []
    may_begin = is_due(seen.stage, seen.time_s, seen.trigger_s)
    if may_begin and BEHAVIOURS[seen.request].sides:  # a lane change: overtakes have no sides
        reason = Reason.NO_ADJACENT_LANE
        for option in seen.options:
            answers.append(rule_refusals(_view(seen, option), lane_change))
            reason = next(iter(answers[-1]), None)
            if reason is None:
                return Decision(seen.request, option.target, option.side, answers=tuple(answers))
    elif may_begin and seen.request is Policy.OVERTAKE:
        reason = Reason.NO_ADJACENT_LANE
        for option in seen.options:
            if seen.stage is Stage.PASS:
                reason = return_reason(option, passed_gap_m=seen.passed_gap_m, params=overtake)
            else:
                reason = enter_reason(option, leader=seen.leader, desired_mps=seen.driver.desired_mps, params=overtake)
                if reason is None:
                    view = _view(seen, option)
                    if lane_change.rule == "paper":  # `enter_reason` has looked at the gaps
                        view = replace(view, front=OPEN, rear=OPEN)
                    reason = rule_reason(view, lane_change)
            answers.append(() if reason is None else (reason,))
            if reason is None:
                return Decision(Policy.OVERTAKE, option.target, option.side, answers=tuple(answers))
    return Decision(policy_on(seen.lane_turn), seen.next_cell, reason=reason, answers=tuple(answers))


def policy_on(lane_turn: TurnType) -> Policy:
    """What Algorithm 1 comes to on a lane of a type where no manoeuvre is due or possible."""
    return POLICY_OF_TURN.get(lane_turn, Policy.STRAIGHT)


def _view(seen: Observation, option: LaneOption) -> GapView:
    """What a rule is told of one adjacent lane."""
    driver = seen.driver
    return GapView(
        time_s=seen.time_s, waited_s=max(0.0, seen.time_s - seen.trigger_s), side=option.side, speed_mps=seen.speed_mps,
        desired_mps=driver.desired_mps, length_m=seen.length_m, tau_s=driver.tau_s, accel_mps2=driver.accel_mps2,
        decel_mps2=driver.decel_mps2, min_gap_m=driver.min_gap_m, cells_free=option.cells_free, front=option.front,
        rear=option.rear, own_front=seen.own_front, own_rear=seen.own_rear, remaining_m=option.remaining_m,
        sumo=option.sumo, vehicle_id=seen.vehicle_id,
    )  # fmt: skip
