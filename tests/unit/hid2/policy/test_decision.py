"""Algorithm 1 line by line: what is decided for one agent at one step."""

from dataclasses import replace
from typing import Any

import pytest

from hid2.agents import Policy
from hid2.params import LaneChange, Overtake
from hid2.policy.decision import Decision, Observation, decide
from hid2.policy.lane_change import OPEN, Gap, LaneOption
from hid2.policy.overtake import Stage
from netconvert.cells import Cell
from netconvert.lane_graph import TurnType

LEFT = LaneOption(
    side="left", target=Cell(2, 5), cells_free=True, front=OPEN, rear=OPEN,
    remaining_m=100.0, corridor_m=100.0,
)  # fmt: skip
RIGHT = replace(LEFT, side="right", target=Cell(3, 5))
SEEN = Observation(
    time_s=2.0, cell=Cell(1, 5), next_cell=Cell(1, 6), lane_turn=TurnType.STRAIGHT, speed_mps=10.0, desired_mps=10.0,
    request=Policy.LANE_CHANGE, trigger_s=2.0, stage=Stage.WAITING, leader=None, options=(LEFT,),
)  # fmt: skip
OVERTAKE = Overtake(
    d_obs_m=40.0, d_overtake_m=40.0, speed_advantage_mps=1.5, safe_front_m=6.0, safe_rear_m=8.0, return_gap_m=5.0
)
SLOW = Gap(15.0, 4.0, "9")


def _decide(**changes: Any) -> Decision:
    return decide(replace(SEEN, **changes), lane_change=LaneChange(), overtake=OVERTAKE)


def test_line_1_without_a_request_the_agent_goes_straight_to_the_next_cell() -> None:
    assert _decide(request=Policy.STRAIGHT) == Decision(Policy.STRAIGHT, Cell(1, 6))


def test_line_3_before_the_trigger_the_agent_goes_on() -> None:
    """t = 1.9 < t_trigger = 2: no reason either, since nothing is due."""
    assert _decide(time_s=1.9) == Decision(Policy.STRAIGHT, Cell(1, 6))


def test_lines_3_to_5_at_the_trigger_a_free_adjacent_lane_is_taken() -> None:
    assert _decide() == Decision(Policy.LANE_CHANGE, Cell(2, 5), "left")


def test_line_3_without_an_adjacent_lane_the_reason_says_so() -> None:
    assert _decide(options=()) == Decision(Policy.STRAIGHT, Cell(1, 6), reason="no_adjacent_lane")


def test_line_3_waits_while_the_rear_cell_is_occupied() -> None:
    assert _decide(options=(replace(LEFT, cells_free=False),)).reason == "cells_occupied"


def test_second_side_is_tried_when_the_first_is_closed() -> None:
    assert _decide(options=(replace(LEFT, cells_free=False), RIGHT)) == Decision(
        Policy.LANE_CHANGE, Cell(3, 5), "right"
    )


def test_first_side_wins_when_both_are_open() -> None:
    assert _decide(options=(RIGHT, LEFT)).side == "right"


@pytest.mark.parametrize("stage", [Stage.DONE, Stage.ABORTED])
def test_request_that_is_settled_is_not_due_again(stage: Stage) -> None:
    assert _decide(stage=stage) == Decision(Policy.STRAIGHT, Cell(1, 6))


def test_lines_6_to_9_a_slower_leader_within_d_obs_is_overtaken() -> None:
    assert _decide(request=Policy.OVERTAKE, leader=SLOW) == Decision(Policy.OVERTAKE, Cell(2, 5), "left")


def test_line_6_without_a_leader_there_is_nothing_to_overtake() -> None:
    assert _decide(request=Policy.OVERTAKE) == Decision(Policy.STRAIGHT, Cell(1, 6), reason="no_leader")


def test_line_7_each_gap_is_checked() -> None:
    front = replace(LEFT, front=Gap(3.0, 4.0))
    rear = replace(LEFT, rear=Gap(3.0, 12.0))
    short = replace(LEFT, corridor_m=39.0)
    reasons = [
        _decide(request=Policy.OVERTAKE, leader=SLOW, options=(option,)).reason for option in (front, rear, short)
    ]
    assert reasons == ["front_gap", "rear_gap", "corridor_short"]


def test_line_10_an_overtake_that_is_not_feasible_goes_straight_on() -> None:
    blocked = _decide(request=Policy.OVERTAKE, leader=SLOW, options=(replace(LEFT, cells_free=False),))
    assert (blocked.policy, blocked.target, blocked.side) == (Policy.STRAIGHT, Cell(1, 6), None)


def test_return_stage_waits_until_the_leader_is_passed() -> None:
    beside: dict[str, Any] = {"request": Policy.OVERTAKE, "stage": Stage.PASS, "options": (RIGHT,)}
    assert _decide(**beside, passed_gap_m=2.0).reason == "not_ahead"
    assert _decide(**beside, passed_gap_m=6.0) == Decision(Policy.OVERTAKE, Cell(3, 5), "right")


@pytest.mark.parametrize(
    ("turn", "policy"),
    [
        (TurnType.STRAIGHT, Policy.STRAIGHT),
        (TurnType.LEFT, Policy.LEFT_TURN),
        (TurnType.RIGHT, Policy.RIGHT_TURN),
    ],
)
def test_lines_12_to_20_otherwise_the_lane_type_is_the_policy(turn: TurnType, policy: Policy) -> None:
    assert _decide(request=Policy.STRAIGHT, lane_turn=turn) == Decision(policy, Cell(1, 6))


def test_last_cell_of_a_lane_has_no_next_one() -> None:
    assert _decide(request=Policy.STRAIGHT, next_cell=None).target is None
