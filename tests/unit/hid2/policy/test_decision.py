"""Algorithm 1 line by line: what is decided for one agent at one step."""

from dataclasses import replace
from typing import Any

import pytest

from hid2.agents import Policy
from hid2.drivers.driver import usual_driver
from hid2.params import LaneChange, Overtake
from hid2.policy.decision import Decision, Observation, decide
from hid2.policy.lane_change import OPEN, Gap, LaneOption
from hid2.policy.overtake import Stage
from netconvert.cells import Cell
from netconvert.lane_graph import TurnType

LEFT = LaneOption(
    side="left", target=Cell(2, 5), cells_free=True, front=OPEN, rear=OPEN, remaining_m=100.0, corridor_m=100.0
)
RIGHT = replace(LEFT, side="right", target=Cell(3, 5))
SEEN = Observation(
    time_s=2.0, next_cell=Cell(1, 6), lane_turn=TurnType.STRAIGHT, speed_mps=10.0,
    driver=usual_driver(10.0), request=Policy.LANE_CHANGE, trigger_s=2.0, stage=Stage.WAITING, leader=None,
    options=(LEFT,),
)  # fmt: skip
OVERTAKE = Overtake(
    d_obs_m=40.0, d_overtake_m=40.0, speed_advantage_mps=1.5, safe_front_m=6.0, safe_rear_m=8.0, return_gap_m=5.0
)
SLOW = Gap(15.0, 4.0, "9")


def _decide(**changes: Any) -> Decision:
    return decide(replace(SEEN, **changes), lane_change=LaneChange(), overtake=OVERTAKE)


STRAIGHT_ON = Decision(Policy.STRAIGHT, Cell(1, 6))
CLOSED = replace(LEFT, cells_free=False)


@pytest.mark.parametrize(
    ("changes", "decision"),
    [
        ({"request": Policy.STRAIGHT}, STRAIGHT_ON),
        ({"time_s": 1.9}, STRAIGHT_ON),  # 1.9 s < t_trigger = 2 s: no reason either, since nothing is due
        ({}, Decision(Policy.LANE_CHANGE, Cell(2, 5), "left")),
        ({"options": ()}, replace(STRAIGHT_ON, reason="no_adjacent_lane")),
        ({"options": (CLOSED,)}, replace(STRAIGHT_ON, reason="cells_occupied")),
        ({"options": (CLOSED, RIGHT)}, Decision(Policy.LANE_CHANGE, Cell(3, 5), "right")),
        ({"options": (RIGHT, LEFT)}, Decision(Policy.LANE_CHANGE, Cell(3, 5), "right")),
        ({"stage": Stage.DONE}, STRAIGHT_ON),
        ({"stage": Stage.ABORTED}, STRAIGHT_ON),
        ({"request": Policy.OVERTAKE, "leader": SLOW}, Decision(Policy.OVERTAKE, Cell(2, 5), "left")),
        ({"request": Policy.OVERTAKE}, replace(STRAIGHT_ON, reason="no_leader")),
        ({"request": Policy.OVERTAKE, "leader": SLOW, "speed_mps": 1.9}, replace(STRAIGHT_ON, reason="too_slow")),
        ({"request": Policy.STRAIGHT, "lane_turn": TurnType.LEFT}, Decision(Policy.LEFT_TURN, Cell(1, 6))),
        ({"request": Policy.STRAIGHT, "lane_turn": TurnType.RIGHT}, Decision(Policy.RIGHT_TURN, Cell(1, 6))),
        ({"request": Policy.STRAIGHT, "next_cell": None}, Decision(Policy.STRAIGHT, None)),
    ],
    ids=[
        "line 1: without a request the agent goes straight to the next cell",
        "line 3: before the trigger the agent goes on",
        "lines 3 to 5: at the trigger a free adjacent lane is taken",
        "line 3: without an adjacent lane the reason says so", "line 3: waits while the rear cell is occupied",
        "the second side is tried when the first is closed", "the first side wins when both are open",
        "a request that is done is not due again",
        "a request that is given up is not due again",
        "lines 6 to 9: a slower leader within d_obs is overtaken",
        "line 6: without a leader there is nothing to overtake",
        "line 7: what is too slow to change lanes is too slow to overtake",
        "lines 12 to 20: on a left turn that is the policy",
        "lines 12 to 20: on a right turn that is the policy",
        "the last cell of a lane has no next one",
    ],
)  # fmt: skip
def test_what_algorithm_1_decides(changes: dict[str, Any], decision: Decision) -> None:
    assert _decide(**changes) == decision


def test_return_stage_waits_until_the_leader_is_passed() -> None:
    beside: dict[str, Any] = {"request": Policy.OVERTAKE, "stage": Stage.PASS, "options": (RIGHT,)}
    assert _decide(**beside, passed_gap_m=2.0).reason == "not_ahead"
    assert _decide(**beside, passed_gap_m=6.0) == Decision(Policy.OVERTAKE, Cell(3, 5), "right")
