"""Overtaking in three stages: enter, pass, return; each with its own feasibility check (paper, Overtaking)."""

from enum import StrEnum

from hid2.params import Config, Overtake
from hid2.policy.lane_change import Gap, LaneOption
from hid2.reasons import Reason

#: Duration of an overtake's lane changes over a usual one's, the shortest too. No tunable: `lane_change_mean_s` is.
SHIFT_RATIO = 0.68


class Stage(StrEnum):
    """Where a lane change or an overtake stands. ABORTED is a state: the vehicle stays in the lane it is in."""

    WAITING = "waiting"
    ENTER = "enter"
    PASS = "pass"  # noqa: S105
    RETURN = "return"
    DONE = "done"
    ABORTED = "aborted"


def shortest_shift_s(config: Config) -> float:
    """Shortest lateral motion of an overtake, s."""
    return SHIFT_RATIO * config.lane_change.min_duration_s


def stretch_m(config: Config) -> float:
    """Shortest stretch of two lanes side by side for an overtake, m: the corridor, and a short way back."""
    return config.overtake.d_overtake_m + shortest_shift_s(config) * config.spawn.prior_speed_mps


def enter_reason(option: LaneOption, *, leader: Gap | None, desired_mps: float, params: Overtake) -> Reason | None:
    """Why the overtake cannot begin now, None where it can: l' free, gaps at both ends, m * delta s >= d_overtake.

    NO_LANE is the paper's condition 1, apart from CELLS_OCCUPIED of a lane change, for which a vehicle slows down.
    """
    if leader is None or leader.distance_m > params.d_obs_m:
        return Reason.NO_LEADER
    if desired_mps - leader.speed_mps < params.speed_advantage_mps:
        return Reason.LEADER_NOT_SLOWER
    if not option.cells_free:
        return Reason.NO_LANE
    if option.front.distance_m < params.safe_front_m:
        return Reason.FRONT_GAP
    if option.rear.distance_m < params.safe_rear_m:
        return Reason.REAR_GAP
    if option.corridor_m < params.d_overtake_m:
        return Reason.CORRIDOR_SHORT
    return None


def return_reason(option: LaneOption, *, passed_gap_m: float, params: Overtake) -> Reason | None:
    """Why the return cannot begin now. passed_gap_m: bumper to bumper to the passed vehicle, negative beside it."""
    if passed_gap_m < params.return_gap_m:
        return Reason.NOT_AHEAD
    if not option.cells_free:
        return Reason.NO_LANE
    if option.front.distance_m < params.safe_front_m:
        return Reason.FRONT_GAP
    return None
