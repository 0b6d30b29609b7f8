"""One event between an inserted vehicle and its target, by their exported states: gap, TTC, PET, DRAC."""

from dataclasses import dataclass

import numpy as np

from hid2.agents import BoxSize
from hid2.measures.conflicts import pair_course
from hid2.measures.encounters import CROSSING_RAD
from hid2.measures.post_encroachment import encroachments
from hid2.occupancy.agent_states import AgentStates
from hid2.occupancy.gaps import gaps_from_pose

#: TTC and PET above this are not told apart, s.
CAP_S = 10.0
#: Drivers brake before this TTC, s: 90 % of the followers of lane changes (see method.md).
HUMAN_BRAKES_S = 4.7


@dataclass(frozen=True, slots=True)
class EventMeasures:
    """What an event was like for its target, which is recorded and does not react.

    gap_m: bumper to bumper along the target's heading at the moment of the event, whichever is ahead;
    speed_difference_mps: speed of the vehicle minus that of the target then; min_ttc_s: smallest two-dimensional TTC
    from then on, None where it is never below CAP_S; pet_s: where the paths cross; drac_mps2: largest deceleration that
    the target would have needed, 0 where it never closes in; brakes_mps2: hardest braking of the vehicle itself from
    the moment on, 0 where it never brakes; human_brakes: whether a human would have braked.
    """

    gap_m: float
    speed_difference_mps: float
    min_ttc_s: float | None
    pet_s: float | None
    drac_mps2: float
    brakes_mps2: float

    @property
    def human_brakes(self) -> bool:
        """Whether TTC came below the one before which drivers brake."""
        return self.min_ttc_s is not None and self.min_ttc_s < HUMAN_BRAKES_S


def measure_event(states: AgentStates, own: int, target: int, *, at_step: int, since_step: int) -> EventMeasures:
    """Measures of an event of a vehicle and its target, two rows, at a step; TTC and DRAC from since_step on.

    Errors: ValueError where one of the two is not there at that step.
    """
    arrays = states.arrays
    row, there = (_row(states, agent, at_step) for agent in (own, target))
    forward = np.array([np.cos(arrays.heading[there]), np.sin(arrays.heading[there])])
    box, here = BoxSize(arrays.length[target], arrays.width[target]), states.traffic.rows([own]).at(at_step)
    seen, speed = gaps_from_pose(arrays.position[there], forward, box, here), np.hypot(*arrays.velocity.T)
    later, course = speed[row : states.row_span(own).stop], pair_course(arrays, target, own, cap_s=CAP_S)
    course = course.during(since_step, arrays.num_steps)
    min_ttc_s = float(course.ttc_s.min(initial=np.inf))
    return EventMeasures(
        gap_m=float(seen.gap_m[0]), speed_difference_mps=float(speed[row] - speed[there]),
        min_ttc_s=min_ttc_s if min_ttc_s < CAP_S else None, pet_s=post_encroachment_of(states, own, target),
        drac_mps2=float(course.drac_mps2.max(initial=0.0)),
        brakes_mps2=float(np.max(-np.gradient(later, arrays.step_s), initial=0.0)) if later.size > 1 else 0.0,
    )  # fmt: skip


def post_encroachment_of(states: AgentStates, own: int, target: int) -> float | None:
    """PET of two agents, s; None where their paths do not cross within CAP_S."""
    pair = np.sort(np.array([own, target]))
    found = encroachments(states.arrays, cap_s=CAP_S, agents=pair, crossing_rad=CROSSING_RAD)
    return found[0].pet_s if found else None


def _row(states: AgentStates, agent: int, step: int) -> int:
    row = int(states.arrays.row_of[agent, step])
    if row < 0:
        raise ValueError(f"track {states.arrays.track_ids[agent]} has no state at step {step}")
    return row
