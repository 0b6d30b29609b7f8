"""Rules that decide whether a gap is taken, to be exchanged: the paper's, MOBIL, SUMO's LC2013, a function of a user's.

A rule is pure: what a vehicle sees of a gap at one step in, a decision out. Every rule is asked for a gap that the lane
can be changed in at all (speed, length of lane left); the paper's cells and gaps are the paper's rule.
"""

import importlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from hid2.params import LaneChange
from hid2.policy.lane_change import Gap, lane_change_reason
from hid2.reasons import Reason
from netconvert.errors import ConfigError


@dataclass(frozen=True, slots=True)
class SumoAnswer:
    """What SUMO's LC2013 makes of one side: its motives (none: it does not want to), and who is in its way there."""

    motives: frozenset[str]
    blocked_ahead: bool
    blocked_behind: bool


@dataclass(frozen=True, slots=True)
class GapView:
    """One look at a gap: all that a rule is told. m, s, m/s, m/s2; Gap: bumper gap and speed, inf where nobody is.

    front, rear: new leader and new follower; own_front, own_rear: those on the lane that would be left; waited_s: since
    the trigger; cells_free: sigma = 0 in cells j-1, j, j+1 of l'; remaining_m: length of l' left; tau_s, accel_mps2,
    decel_mps2, min_gap_m: the own driver's. sumo: what SUMO answers, only for the rule LC2013.
    """

    time_s: float
    waited_s: float
    side: Literal["left", "right"]
    speed_mps: float
    desired_mps: float
    length_m: float
    tau_s: float
    accel_mps2: float
    decel_mps2: float
    min_gap_m: float
    cells_free: bool
    front: Gap
    rear: Gap
    own_front: Gap
    own_rear: Gap
    remaining_m: float
    sumo: SumoAnswer | None = None


#: A user's rule: whether the gap is taken.
UserRule = Callable[[GapView], bool]


def rule_reason(view: GapView, params: LaneChange) -> Reason | None:
    """Why the rule `lane_change.rule` does not take a gap; None where it does.

    Errors: ConfigError for a user's rule that cannot be imported or does not answer True or False.
    """
    if params.rule == "paper":
        return lane_change_reason(
            speed_mps=view.speed_mps, cells_free=view.cells_free, front=view.front, rear=view.rear,
            remaining_m=view.remaining_m, params=params,
        )  # fmt: skip
    if view.speed_mps < params.min_speed_mps:
        return Reason.TOO_SLOW
    if view.remaining_m < params.min_remaining_m:
        return Reason.LANE_ENDS
    if params.rule == "MOBIL":
        return mobil_reason(view, params)
    if params.rule == "LC2013":
        return _lc2013_reason(view)
    answer = user_rule(params.rule)(view)
    if not isinstance(answer, bool):
        raise ConfigError(f"lane_change.rule = {params.rule!r}: it answered {answer!r}, expected True or False")
    return None if answer else Reason.RULE_REFUSES


def user_rule(name: str) -> UserRule:
    """The function that "module:function" names. Errors: ConfigError."""
    module, _, function = name.partition(":")
    try:
        found = getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError) as error:
        raise ConfigError(f"lane_change.rule = {name!r}: {error}; expected a module that Python finds here") from error
    if not callable(found):
        raise ConfigError(f"lane_change.rule = {name!r}: no function, expected module:function")
    return found  # type: ignore[no-any-return]


def idm_mps2(speed_mps: float, ahead: Gap, view: GapView) -> float:
    """Acceleration by the intelligent driver model behind a leader (Treiber, Hennecke and Helbing 2000), m/s2.

    With the parameters of the driver in `view`, for others too: nobody knows theirs. Desired speed at least the speed.
    """
    desired = max(view.desired_mps, speed_mps, 0.1)
    free = 1.0 - (speed_mps / desired) ** 4
    if math.isinf(ahead.distance_m):
        return view.accel_mps2 * free
    closing = speed_mps - ahead.speed_mps
    wanted = view.min_gap_m + max(
        0.0, speed_mps * view.tau_s + 0.5 * speed_mps * closing / math.sqrt(view.accel_mps2 * view.decel_mps2)
    )
    return view.accel_mps2 * (free - (wanted / max(ahead.distance_m, 0.1)) ** 2)


def mobil_reason(view: GapView, params: LaneChange) -> Reason | None:
    """MOBIL (Kesting, Treiber and Helbing 2007): safety for the new follower, then the incentive with politeness p.

    a_c' - a_c + p (a_n' - a_n + a_o' - a_o) > threshold - bias, by the intelligent driver model.
    """
    if view.front.distance_m <= 0.0 or view.rear.distance_m <= 0.0:
        return Reason.CELLS_OCCUPIED
    own = Gap(view.rear.distance_m, view.speed_mps)
    follower_after = idm_mps2(view.rear.speed_mps, own, view)
    if math.isfinite(view.rear.distance_m) and follower_after < -params.mobil_safe_mps2:
        return Reason.MOBIL_UNSAFE
    advantage = idm_mps2(view.speed_mps, view.front, view) - idm_mps2(view.speed_mps, view.own_front, view)
    others = 0.0
    if math.isfinite(view.rear.distance_m):
        joined = Gap(view.rear.distance_m + view.length_m + view.front.distance_m, view.front.speed_mps)
        others += follower_after - idm_mps2(view.rear.speed_mps, joined, view)
    if math.isfinite(view.own_rear.distance_m):
        joined = Gap(view.own_rear.distance_m + view.length_m + view.own_front.distance_m, view.own_front.speed_mps)
        behind = Gap(view.own_rear.distance_m, view.speed_mps)
        others += idm_mps2(view.own_rear.speed_mps, joined, view) - idm_mps2(view.own_rear.speed_mps, behind, view)
    gain = advantage + params.mobil_politeness * others
    return None if gain > params.mobil_threshold_mps2 - params.mobil_bias_mps2 else Reason.MOBIL_NO_ADVANTAGE


def _lc2013_reason(view: GapView) -> Reason | None:
    """SUMO's own model: it wants the lane (strategic, cooperative, speed gain, keep right) and finds it free."""
    if view.sumo is None or not view.sumo.motives:
        return Reason.LC2013_NO_MOTIVE
    if view.sumo.blocked_behind:
        return Reason.REAR_GAP
    return Reason.FRONT_GAP if view.sumo.blocked_ahead else None
