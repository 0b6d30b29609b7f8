"""Whether what is claimed of inserted vehicles can be seen in their states: manoeuvres, and events with a target.

A manoeuvre is what `measures.manoeuvres` detects. An event is seen from where its target is at that moment: in the lane
that it drives then, not in one that it changes to later.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hid2.judge.events import CUT_IN_S, HUMAN_BRAKES_S, crossing_steps, is_ahead, measure_event
from hid2.judge.findings import CLAIM_S, FIGURE_OFF, Finding, Quantity
from hid2.measures.driven_lanes import path_driven, run_at, runs_of
from hid2.measures.lane_matching import CHANGES_LANES, GOES_ON
from hid2.measures.manoeuvres import TURNS, Maneuver, ManeuverKind, detect
from hid2.occupancy.agent_states import AgentStates

#: Kinds that count as an overtake: passing a vehicle that stands does too, with a reason of its own.
_PASSED = (ManeuverKind.OVERTAKE, ManeuverKind.OBSTACLE_AVOIDANCE)


#: Figures of an event that the judge looks at, by their names in `EventMeasures`.
FIGURES = {
    "gap_m": Quantity.CLAIMED_GAP,
    "speed_difference_mps": Quantity.CLAIMED_SPEED,
    "min_ttc_s": Quantity.CLAIMED_TTC,
    "ttc_at_s": Quantity.CLAIMED_TTC_TIME,
    "headway_s": Quantity.CLAIMED_HEADWAY,
    "brakes_mps2": Quantity.CLAIMED_BRAKING,
    "pet_s": Quantity.CLAIMED_PET,
    "drac_mps2": Quantity.CLAIMED_DRAC,
}


class Claim(NamedTuple):
    """A manoeuvre that is told as done. at_s: when the centre first crosses a line, or of a turn when it begins."""

    track_id: str
    kind: ManeuverKind
    at_s: float


class EventClaim(NamedTuple):
    """An event that is told as done; figures: what is told of it, by the names of `EventMeasures`.

    ahead: whether the vehicle is ahead of its target, or crosses first.
    """

    kind: str
    track_id: str
    target_id: str
    at_s: float
    ahead: bool
    figures: Mapping[str, float | None] = {}


def manoeuvres(states: AgentStates, agent: int | None = None) -> list[Maneuver]:
    """All manoeuvres of the inserted vehicles of a scene, or of one agent."""
    return detect(states, among=np.flatnonzero(states.arrays.generated).tolist() if agent is None else [agent])


def moment_s(maneuver: Maneuver) -> float:
    """The time by which a manoeuvre is told: of a turn the start, else the crossing."""
    return maneuver.start_s if maneuver.kind in TURNS.values() else maneuver.crossing_s


def matching(claim: Claim, among: Sequence[Maneuver]) -> Maneuver | None:
    """The manoeuvre of that kind and track that is nearest to the time claimed; None where there is none."""
    own = [one for one in among if one.track_id == claim.track_id]
    if claim.kind is ManeuverKind.OVERTAKE:
        same = [one for one in own if one.kind is ManeuverKind.LANE_CHANGE and one.part_of in _PASSED]
    else:
        same = [one for one in own if one.kind is claim.kind]
    return min(same, key=lambda one: abs(moment_s(one) - claim.at_s), default=None)


def judge_claims(states: AgentStates, claims: Sequence[Claim], events: Sequence[EventClaim]) -> list[Finding]:
    """Claims not shown within CLAIM_S, by how many s, inf for never; and figures of events that are not the states'."""
    found, every, step_s = [], manoeuvres(states) if claims else [], states.arrays.step_s
    for claim in claims:
        shown = matching(claim, every)
        off_s = math.inf if shown is None else abs(moment_s(shown) - claim.at_s)
        if off_s > CLAIM_S:
            found.append(Finding(claim.track_id, round(claim.at_s / step_s), Quantity.CLAIM, off_s, CLAIM_S))
    for event in events:
        step = event_step(states, event)
        off_s, at_step = math.inf if step is None else abs(step * step_s - event.at_s), round(event.at_s / step_s)
        if off_s > CLAIM_S + 1e-9:
            found.append(Finding(event.track_id, at_step, Quantity.CLAIM, off_s, CLAIM_S, event.target_id))
        else:
            found += _wrong_figures(states, event)
    return found


def _wrong_figures(states: AgentStates, event: EventClaim) -> list[Finding]:
    """Figures of an event that are not the states', by how much, inf where one is missing; of a merge also its side."""
    own, target = (states.arrays.track_ids.index(name) for name in (event.track_id, event.target_id))
    at_step, found = round(event.at_s / states.arrays.step_s), []
    shown = measure_event(states, event.kind, own, target, at_step=at_step)
    if event.kind == "merge" and is_ahead(states, own, target, at_step) is not event.ahead:
        found.append(Finding(event.track_id, at_step, Quantity.CLAIM, math.inf, CLAIM_S, event.target_id))
    for name, told in event.figures.items():
        value = getattr(shown, name)
        off = abs(told - value) if None not in (told, value) else 0.0 if told is value else math.inf
        if off > FIGURE_OFF:
            found.append(Finding(event.track_id, at_step, FIGURES[name], off, FIGURE_OFF, event.target_id))
    return found


def event_step(states: AgentStates, claim: EventClaim) -> int | None:
    """The step at which an event is seen; None where it is not, or not on that side of the target.

    Of several cut-ins the nearest to the time claimed; lead and follow are looked for at that time alone.
    """
    ids = states.arrays.track_ids
    if claim.track_id not in ids or claim.target_id not in ids:
        return None
    own, target = ids.index(claim.track_id), ids.index(claim.target_id)
    near = round(claim.at_s / states.arrays.step_s)
    if claim.kind not in ("merge", "cross") and claim.ahead is (claim.kind == "follow"):  # only a follow is behind
        return None
    match claim.kind:
        case "cut_in":
            return _cut_in(states, own, target, near)
        case "overtake":
            passed = overtake_of(states, own, target)  # seen where it crosses back into the target's lane
            return None if passed is None else round(passed[1].crossing_s / states.arrays.step_s)
        case "merge":
            return _merged(states, own, target)
        case "cross":
            steps = crossing_steps(states, own, target)
            if steps is None or (steps[0] < steps[1]) is not claim.ahead or _merged(states, own, target) is not None:
                return None  # a merge is no crossing, though its paths meet
            return steps[0]
        case _:  # lead, follow
            return near if _leads(states, *((own, target) if claim.ahead else (target, own)), near) else None


def _cut_in(states: AgentStates, own: int, target: int, near: int) -> int | None:
    """Step at which it crosses from a lane beside the target's path into it, ahead of the target, and near; None: none.

    Near: within the time gap that is recommended, or the TTC before which drivers brake. The target is on that path
    since CLAIM_S at least, and until there: where it changes lanes itself, no vehicle cuts in on it.
    """
    arrays, link = states.arrays.driven, states.lanes.link
    runs, steps = runs_of(states, target), []
    for change in (one for one in manoeuvres(states, own) if one.kind is ManeuverKind.LANE_CHANGE):
        step = round(change.crossing_s / arrays.step_s)
        row, there = arrays.row_of[own, step], arrays.row_of[target, step]
        k = run_at(runs, int(there))
        if k is None:
            continue
        path, lanes = path_driven(states, runs, k)
        before = max(there - round(CLAIM_S / arrays.step_s), int(arrays.first[target]))
        if states.matches.lane[before] not in lanes:
            continue
        on_path = {int(states.lanes.lane_ids[lane]) for lane in lanes}
        if change.target_lane not in on_path or change.source_lane in on_path:
            continue
        left = next((n for n in range(k, len(runs) - 1) if link[runs[n].lane, runs[n + 1].lane] == CHANGES_LANES), None)
        (own_m, target_m, left_m), _ = path.frenet(
            arrays.position[[row, there, row if left is None else runs[left].last]]
        )
        gap_m = own_m - target_m - (arrays.length[own] + arrays.length[target]) / 2
        own_mps, target_mps = np.hypot(*arrays.velocity[[row, there]].T)
        if left_m >= own_m and 0.0 < gap_m < max(CUT_IN_S * target_mps, HUMAN_BRAKES_S * (target_mps - own_mps)):
            steps.append(step)
    return min(steps, key=lambda step: abs(step - near), default=None)


def overtake_of(states: AgentStates, own: int, other: int) -> tuple[Maneuver, Maneuver] | None:
    """The overtake of one vehicle by another and its change back; None where there is none."""
    every = manoeuvres(states.rows([own, other]), 0)
    for passed in (one for one in every if one.kind in _PASSED):
        back = [one for one in every if one.part_of is passed.kind and one.side == -passed.side]
        if back:
            return passed, back[-1]
    return None


def _merged(states: AgentStates, own: int, target: int) -> int | None:
    """Step at which it comes onto a lane that the target drives too, from one that it does not; None where none."""
    common = {run.lane for run in runs_of(states, target) if run.lane >= 0}
    for before, after in pairwise(runs_of(states, own)):
        if after.lane in common and before.lane not in common and before.lane >= 0:
            if states.lanes.link[before.lane, after.lane] != GOES_ON:
                continue
            return int(states.arrays.step[after.first])
    return None


def _leads(states: AgentStates, leader: int, follower: int, step: int) -> bool:
    """Whether one agent is the next vehicle ahead of another at a step, on the path that the other drives."""
    if states.arrays.row_of[follower, step] < 0 or states.arrays.row_of[leader, step] < 0:
        return False
    others = np.union1d(np.flatnonzero(states.arrays.vehicle), leader)
    next_ones, _ = states.leaders_on_path(follower, others[others != follower]).next_ones()
    return bool(next_ones[step] == leader)
