"""Rules that decide whether a gap is taken, to be exchanged: the paper's, MOBIL, SUMO's LC2013, a function of a user's.

A rule is pure: what a vehicle sees of a gap at one step in, a decision out. Below a least speed and length of lane left
every rule refuses, and a user's is not asked; the paper's cells and gaps are the paper's rule.
"""

import importlib
import math
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from hid2.drivers.driver import Driver
from hid2.params import LaneChange
from hid2.policy.lane_change import OPEN, Gap, SumoAnswer, gap_refusals
from hid2.reasons import Reason
from netconvert.errors import ConfigError
from netconvert.lane_graph import Side

#: Least gain of speed for a discretionary lane change by the paper's rule, unless `rule_with` says otherwise, m/s: as
#: over a leader that is worth an overtake (`overtake.speed_advantage_mps`).
INCENTIVE_MPS = 1.5
#: Answer that is assumed of SUMO before SUMO drives: the lane is wanted, and free.
ASSUMED_ANSWER = SumoAnswer(frozenset({"foreseen"}), blocked_ahead=False, blocked_behind=False)


#: Reasons by the names of conditions that a user's rule may answer one by one; names beside these are the rule's own.
_CONDITIONS = {"lead": Reason.FRONT_GAP, "lag": Reason.REAR_GAP, "cells": Reason.CELLS_OCCUPIED}


@dataclass(frozen=True, slots=True)
class GapView:
    """One look at a gap: all that a rule is told. m, s, m/s, m/s2; Gap: bumper gap and speed, `OPEN` (inf, 0) for none.

    front, rear: new leader and new follower; own_front, own_rear: those on the lane that would be left; waited_s: since
    the trigger; cells_free: sigma = 0 in cells j-1, j, j+1 of l'; remaining_m: length of l' left; tau_s, accel_mps2,
    decel_mps2, min_gap_m: the own driver's. sumo: what SUMO answers, only for the rule LC2013;
    vehicle_id: the same at every point of a study.
    """

    time_s: float
    waited_s: float
    side: Side
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
    vehicle_id: str = ""


#: Views that a user's rule is tried with before any scene is driven: a free road, and a gap between two vehicles.
_FREE = GapView(
    time_s=2.0, waited_s=0.5, side="left", speed_mps=10.0, desired_mps=12.0, length_m=4.5, tau_s=1.2, accel_mps2=1.5,
    decel_mps2=2.0, min_gap_m=2.0, cells_free=True, front=OPEN, rear=OPEN, own_front=OPEN, own_rear=OPEN,
    remaining_m=150.0,
)  # fmt: skip
_BETWEEN = replace(_FREE, front=Gap(20.0, 9.0), rear=Gap(15.0, 11.0), own_front=Gap(12.0, 8.0), own_rear=Gap(9.0, 10.0))


def rule_refusals(view: GapView, params: LaneChange) -> tuple[Reason, ...]:
    """Every condition of the rule `lane_change.rule` that a gap does not meet, in its order; empty where it takes it.

    Errors: ConfigError for a user's rule that cannot be imported, or answers with no True, False, or these by name.
    """
    found = []
    if view.speed_mps < params.min_speed_mps:
        found.append(Reason.TOO_SLOW)
    if view.remaining_m < params.min_remaining_m:
        found.append(Reason.LANE_ENDS)
    if params.rule == "paper":
        found += gap_refusals(
            speed_mps=view.speed_mps, cells_free=view.cells_free, front=view.front, rear=view.rear, params=params
        )
    elif params.rule == "MOBIL":
        found += mobil_refusals(view, params)
    elif params.rule == "LC2013":
        found += _lc2013_refusals(view)
    elif not found:
        found += _answer(params.rule, view, rule_arguments(params))
    return tuple(found)


def rule_reason(view: GapView, params: LaneChange) -> Reason | None:
    """The first of `rule_refusals`; None where the rule takes the gap."""
    return next(iter(rule_refusals(view, params)), None)


def refusals_unasked(view: GapView, params: LaneChange, *, mandatory: bool) -> tuple[Reason, ...]:
    """What keeps a vehicle without a request from changing lanes into a gap. mandatory: its route leads there.

    The paper's rule has no incentive: it gets one where the leader there (none: the desired speed) is faster than
    the one here by `incentive` of `lane_change.rule_with`, m/s. MOBIL has its incentive, a user's rule decides alone.
    """
    if params.rule == "paper" and not mandatory:
        there, here = (
            view.desired_mps if math.isinf(one.distance_m) else min(one.speed_mps, view.desired_mps)
            for one in (view.front, view.own_front)
        )
        if there - here <= rule_arguments(params).get("incentive", INCENTIVE_MPS):
            return (Reason.RULE_REFUSES,)
    wanted = {Reason.MOBIL_NO_ADVANTAGE} if mandatory else set()
    return tuple(one for one in rule_refusals(view, params) if one not in wanted)


def rule_arguments(params: LaneChange) -> dict[str, float]:
    """`lane_change.rule_with` by name."""
    parts = (part.partition("=") for part in params.rule_with.replace(" ", "").split(",") if part)
    return {name: float(value) for name, _, value in parts}


def refusal_of_lane(
    driver: Driver, params: LaneChange, *, speed_mps: float, side: Side = "left", front: Gap = OPEN, rear: Gap = OPEN
) -> Reason | None:
    """Why a rule would not leave a slower leader for the lane beside, free but for what is told; None: it would.

    It is asked at the rule's least speed or faster, at the end of its patience (`give_up_s`), behind a leader half as
    fast. SUMO, which LC2013 asks, is taken to agree.
    """
    v = max(speed_mps, params.min_speed_mps)
    view = replace(
        _FREE, side=side, time_s=params.give_up_s, waited_s=params.give_up_s, speed_mps=v,
        desired_mps=max(v, driver.desired_mps), tau_s=driver.tau_s, accel_mps2=driver.accel_mps2,
        decel_mps2=driver.decel_mps2, min_gap_m=driver.min_gap_m,
        remaining_m=params.min_remaining_m + _FREE.remaining_m,
        front=front, rear=rear, own_front=Gap(driver.min_gap_m + driver.tau_s * v, 0.5 * v),
        sumo=ASSUMED_ANSWER if params.rule == "LC2013" else None,
    )  # fmt: skip
    return rule_reason(view, params)


def try_rule(params: LaneChange) -> None:
    """Import the function that `lane_change.rule` names and try it with its arguments.

    Errors: ConfigError with file and line where it does not do what `rule_refusals` expects.
    """
    for view in (_FREE, _BETWEEN):
        _answer(params.rule, view, rule_arguments(params))


def name_of_rule(rule: Callable[..., object]) -> str:
    """What `lane_change.rule` calls a function. Errors: ConfigError for one that cannot be found by a name."""
    module, name = getattr(rule, "__module__", ""), getattr(rule, "__qualname__", "")
    if getattr(sys.modules.get(module), name, None) is not rule:
        said = f"{place_in(None, rule)}{name or repr(rule)} is not found by its name in {module or 'any module'}"
        raise ConfigError(f"lane_change.rule: {said}; expected a function at the top of a module or notebook")
    return f"{module}:{name}"


def check_user_rule(params: LaneChange) -> str:
    """As `try_rule`; returns the file of the function's module. Errors: ConfigError, also where there is none."""
    try_rule(params)
    file = getattr(sys.modules[params.rule.partition(":")[0]], "__file__", None)
    if file is None:
        raise ConfigError(f"lane_change.rule = {params.rule!r}: its module has no file, expected one of your own")
    return str(file)


def _answer(name: str, view: GapView, arguments: Mapping[str, float]) -> list[Reason]:
    """What the user's rule "module:function" has against a gap. Errors: ConfigError with file and line."""
    module, _, function = name.partition(":")
    rule, wanted = None, "a module that Python finds here"
    try:
        rule = getattr(importlib.import_module(module), function)
        wanted = " and ".join(["a function of a GapView", *arguments]) + " that answers True or False"
        answer = rule(view, **arguments)
        if isinstance(answer, bool | np.bool_):
            return [] if answer else [Reason.RULE_REFUSES]
        if isinstance(answer, dict) and answer and all(isinstance(one, bool | np.bool_) for one in answer.values()):
            return [_CONDITIONS.get(condition, Reason.RULE_REFUSES) for condition, holds in answer.items() if not holds]
        said = f"{place_in(None, rule)}it answered {answer!r:.100}"
    except (Exception, SystemExit) as error:  # whatever a user's code may raise
        said = f"{place_in(error, rule)}{type(error).__name__}: {getattr(error, 'msg', error)!s:.200}"
        raise ConfigError(f"lane_change.rule = {name!r}: {said}; expected {wanted}") from error
    raise ConfigError(f"lane_change.rule = {name!r}: {said}, expected True or False, or these by condition")


def place_in(error: BaseException | None, function: object, caller: str = __file__) -> str:
    """File and line in a user's code that an error comes from, else of the function; nothing where there is none.

    caller: the file that calls the function, which is not the user's.
    """
    if isinstance(error, SyntaxError):
        return f"{error.filename}:{error.lineno}: "
    passed_on = (caller, importlib.__file__)
    frames = traceback.extract_tb(error.__traceback__) if error is not None else []
    own = [one for one in frames if one.filename not in passed_on and not one.filename.startswith("<frozen")]
    code = getattr(function, "__code__", None)
    if own:
        last = next(one for one in reversed(own) if one.filename == own[0].filename)
        return f"{last.filename}:{last.lineno}: "
    return f"{code.co_filename}:{code.co_firstlineno}: " if code is not None else ""


def idm_mps2(speed_mps: float, ahead: Gap, view: GapView) -> float:
    """Acceleration of the driver in `view` by the intelligent driver model (Treiber, Hennecke, Helbing 2000), m/s2."""
    free = 1.0 - (speed_mps / max(view.desired_mps, speed_mps, 0.1)) ** 4
    if math.isinf(ahead.distance_m):
        return view.accel_mps2 * free
    closing = speed_mps - ahead.speed_mps
    wanted = view.min_gap_m + max(
        0.0, speed_mps * view.tau_s + 0.5 * speed_mps * closing / math.sqrt(view.accel_mps2 * view.decel_mps2)
    )
    return view.accel_mps2 * (free - (wanted / max(ahead.distance_m, 0.1)) ** 2)


def _is_agent_beside(view: GapView) -> bool:
    return view.front.distance_m <= 0.0 or view.rear.distance_m <= 0.0


def mobil_refusals(view: GapView, params: LaneChange) -> Iterator[Reason]:
    """MOBIL (Kesting, Treiber and Helbing 2007): safety for the new follower, then the incentive with politeness p.

    a_c' - a_c + p (a_n' - a_n + a_o' - a_o) > threshold - bias, by the intelligent driver model.
    """
    if _is_agent_beside(view):
        yield Reason.CELLS_OCCUPIED
    follower_after = idm_mps2(view.rear.speed_mps, Gap(view.rear.distance_m, view.speed_mps), view)
    if math.isfinite(view.rear.distance_m) and follower_after < -params.mobil_safe_mps2:
        yield Reason.MOBIL_UNSAFE
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
    if gain <= params.mobil_threshold_mps2 - params.mobil_bias_mps2:
        yield Reason.MOBIL_NO_ADVANTAGE


def _lc2013_refusals(view: GapView) -> Iterator[Reason]:
    """SUMO's own model: it wants the lane (strategic, cooperative, speed gain, keep right) and finds it free."""
    if _is_agent_beside(view):  # SUMO may not be shown it
        yield Reason.CELLS_OCCUPIED
    if view.sumo is None or not view.sumo.motives:
        yield Reason.LC2013_NO_MOTIVE
    if view.sumo is not None and view.sumo.blocked_behind:
        yield Reason.REAR_GAP
    if view.sumo is not None and view.sumo.blocked_ahead:
        yield Reason.FRONT_GAP
