"""One event between an inserted vehicle and its target, by their exported states: gap, TTC, PET, DRAC."""

import math
from dataclasses import dataclass

import numpy as np

from hid2.agents import FloatArray, IntArray
from hid2.kernels.box_pairs import paths_cross
from hid2.measures.conflicts import CLOSES_MPS, pair_course
from hid2.measures.driven_lanes import path_driven, run_at, runs_of
from hid2.measures.encounters import CROSSING_RAD
from hid2.measures.surrogates import encroachments
from hid2.occupancy.agent_states import AgentStates
from hid2.params import EVENT_CAP_S

#: TTC before which drivers brake, s: 90 % of the followers of lane changes do.
HUMAN_BRAKES_S = 4.7
#: Time gap to the target below which a lane change is a cut-in, s: the recommended one.
CUT_IN_S = 1.8
#: Time after its moment up to which an event is measured for its target, s. No tunable: the target does not react and
#: may later run into whatever is ahead of it.
AFTER_S = 3.0
#: Time before a cut-in from which on it is measured, s. No tunable: it comes across, and then may head past the target.
_BEFORE_S = 1.5


@dataclass(frozen=True, slots=True)
class EventMeasures:
    """What an event was like for its target, which is recorded and does not react.

    gap_m: bumper to bumper along the lanes driven at the moment of the event, whichever is ahead; of a crossing from
    the target's bumper to where the paths cross; speed_difference_mps: speed of the vehicle minus that of the target
    then; min_ttc_s: smallest two-dimensional TTC from then on for AFTER_S, of a cut-in from _BEFORE_S before, of a
    crossing of all steps, None where it is never below EVENT_CAP_S; ttc_at_s: when that is; headway_s: smallest
    time headway of the target behind the vehicle in AFTER_S from the moment on, front to front, None where it is never
    behind it; pet_s: where the paths cross; drac_mps2: largest deceleration that the target would have needed, in the
    time of min_ttc_s, 0 where none is told, or it crosses first; brakes_mps2: hardest braking of the vehicle itself
    in AFTER_S from the moment on, 0 where it never brakes.
    """

    gap_m: float
    speed_difference_mps: float
    min_ttc_s: float | None
    ttc_at_s: float | None
    headway_s: float | None
    pet_s: float | None
    drac_mps2: float
    brakes_mps2: float


def brakes_for(ttc_s: float | None, drac_mps2: float | None) -> bool:
    """Whether a human as the target would have braked: it closes in, and drivers brake before so short a TTC, s."""
    return bool(drac_mps2) and ttc_s is not None and ttc_s < HUMAN_BRAKES_S


def measure_event(states: AgentStates, kind: str, own: int, target: int, *, at_step: int) -> EventMeasures:
    """Measures of an event of a kind, of a vehicle and its target, two rows, at a step; velocities by the positions.

    Errors: ValueError where one of the two is not there at that step.
    """
    states, own, target = states.rows([own, target]), 0, 1
    arrays = states.arrays.driven
    row, there = (_row(states, agent, at_step) for agent in (own, target))
    speed, apart_m = np.hypot(*arrays.velocity.T), 0.5 * float(arrays.length[own] + arrays.length[target])
    steps = round(AFTER_S / arrays.step_s)
    until_step, later = at_step + steps, speed[row : min(row + steps + 1, states.row_span(own).stop)]
    whole = pair_course(arrays, target, own, cap_s=EVENT_CAP_S)
    since_step = at_step - round(_BEFORE_S / arrays.step_s) if kind == "cut_in" else at_step
    course = whole if kind == "cross" else whole.during(since_step, until_step)
    later_on = course.during(at_step, until_step)
    ahead_m = ahead_on_lanes(states, own, target, later_on.step)
    crossed = crossing_steps(states, own, target) if kind == "cross" else None
    if crossed is None:
        gap_m = abs(float(ahead_m[0])) - apart_m
    else:
        first, last = sorted(_row(states, target, step) for step in crossed)
        way_m = np.hypot(*np.diff(arrays.position[first : last + 1], axis=0).T).sum()
        gap_m = float(way_m) - 0.5 * float(arrays.length[target])
    speed_mps, fronts_m = speed[later_on.rows], ahead_m + float(arrays.length[own]) - apart_m
    follows = (ahead_m >= apart_m) & (speed_mps > CLOSES_MPS)
    headway_s = float((fronts_m[follows] / speed_mps[follows]).min(initial=math.inf))
    least = int(course.ttc_s.argmin()) if np.isfinite(course.ttc_s).any() else None
    return EventMeasures(
        gap_m=gap_m,
        speed_difference_mps=float(speed[row] - speed[there]),
        min_ttc_s=None if least is None else float(course.ttc_s[least]),
        ttc_at_s=None if least is None else float(course.step[least] * arrays.step_s),
        headway_s=None if kind == "cross" or math.isinf(headway_s) else headway_s,
        pet_s=post_encroachment_of(states, own, target),
        drac_mps2=float(course.drac_mps2.max(initial=0.0)) if crossed is None or crossed[0] < crossed[1] else 0.0,
        brakes_mps2=float(np.max(-np.gradient(later, arrays.step_s), initial=0.0)) if later.size > 1 else 0.0,
    )


def ahead_on_lanes(states: AgentStates, own: int, target: int, steps: IntArray) -> FloatArray:
    """How far (K,) m a vehicle's centre is ahead of its target's, along the lanes of the one behind at the first step.

    Off every lane, along the target's heading at each step.
    """
    arrays = states.arrays
    rows = arrays.row_of[[target, own]][:, steps]
    for behind, sign in ((target, 1), (own, -1)):
        runs = runs_of(states, behind)
        k = run_at(runs, int(rows[::sign][0, 0]))
        if k is not None:
            path, _ = path_driven(states, runs, k)
            behind_m, front_m = (path.frenet(arrays.position[one])[0] for one in rows[::sign])
            if front_m[0] > behind_m[0]:
                return np.asarray(sign * (front_m - behind_m))
    heading, offset = arrays.heading[rows[0]], arrays.position[rows[1]] - arrays.position[rows[0]]
    return np.asarray(offset[:, 0] * np.cos(heading) + offset[:, 1] * np.sin(heading))


def is_ahead(states: AgentStates, own: int, target: int, step: int) -> bool:
    """Whether a vehicle is ahead of its target at a step."""
    return bool(ahead_on_lanes(states, own, target, np.array([step]))[0] > 0.0)


def post_encroachment_of(states: AgentStates, own: int, target: int) -> float | None:
    """PET of two agents, s; None where their paths do not cross within EVENT_CAP_S."""
    pair = np.sort(np.array([own, target]))
    found = encroachments(states.arrays, cap_s=EVENT_CAP_S, agents=pair, crossing_rad=CROSSING_RAD)
    return found[0].pet_s if found else None


def crossing_steps(states: AgentStates, own: int, target: int) -> tuple[int, int] | None:
    """Steps at which the centres of two agents are where their paths cross, own and target's; None if they do not."""
    arrays, (a, b) = states.arrays, (states.row_span(agent) for agent in (own, target))
    at, there = paths_cross(
        arrays.position[a], arrays.heading[a], arrays.position[b], arrays.heading[b], math.sin(CROSSING_RAD)
    )
    return None if at < 0 else (int(arrays.step[a][at]), int(arrays.step[b][there]))


def _row(states: AgentStates, agent: int, step: int) -> int:
    row = int(states.arrays.row_of[agent, step])
    if row < 0:
        raise ValueError(f"track {states.arrays.track_ids[agent]} has no state at step {step}")
    return row
