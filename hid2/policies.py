"""The names of the policies; a module of its own, so that reading a configuration imports no numpy."""

from enum import StrEnum


class Policy(StrEnum):
    """The paper's policy_i (section Agent Policy)."""

    STRAIGHT = "straight"
    LEFT_TURN = "left_turn"
    RIGHT_TURN = "right_turn"
    LANE_CHANGE = "lane_change"
    OVERTAKE = "overtake"
