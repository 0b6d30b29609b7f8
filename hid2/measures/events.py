"""One event between an inserted vehicle and its target, by their exported positions: gap, TTC, PET, DRAC."""

import math
from dataclasses import dataclass

import numpy as np

from hid2.agents import Track
from hid2.measures.arrays import stack
from hid2.measures.encounters import CROSSING_RAD
from hid2.measures.post_encroachment import encroachments
from hid2.measures.time_to_collision import ttc_to_anything

#: TTC and PET above this are not told apart, s.
CAP_S = 10.0
#: Drivers brake before this TTC, s: 90 % of the followers of lane changes (see method.md).
HUMAN_BRAKES_S = 4.7
#: Slower than this a target has no closing speed, m/s. No tunable, against rounding.
_CLOSES_MPS = 0.05


@dataclass(frozen=True, slots=True)
class EventMeasures:
    """What an event was like for its target, which is recorded and does not react.

    gap_m: bumper to bumper along the target's heading at the moment of the event, whoever is ahead;
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


def measure_event(own: Track, target: Track, *, at_step: int, since_step: int, step_s: float) -> EventMeasures:
    """Measures of an event at a step, TTC and DRAC from since_step on.

    Errors: ValueError where one of the two is not there at that step.
    """
    mine, theirs = _row(own, at_step), _row(target, at_step)
    offset, heading = own.position[mine] - target.position[theirs], target.heading[theirs]
    along = offset[0] * math.cos(heading) + offset[1] * math.sin(heading)
    speed, other_speed = np.hypot(*own.velocity[mine]), np.hypot(*target.velocity[theirs])
    gap = abs(along) - 0.5 * (own.size.length_m + target.size.length_m)
    min_ttc_s, drac = _closing(own, target, since_step, step_s)
    return EventMeasures(
        gap_m=float(gap), speed_difference_mps=float(speed - other_speed), min_ttc_s=min_ttc_s,
        pet_s=post_encroachment_of(own, target, step_s=step_s), drac_mps2=drac,
        brakes_mps2=_braking(own, at_step, step_s),
    )  # fmt: skip


def post_encroachment_of(own: Track, target: Track, *, step_s: float) -> float | None:
    """PET of two tracks, s; None where their paths do not cross within CAP_S."""
    arrays = stack([own, target], step_s=step_s)
    found = encroachments(arrays, cap_s=CAP_S, agents=np.arange(2), crossing_rad=CROSSING_RAD)
    return found[0].pet_s if found else None


def _braking(own: Track, at_step: int, step_s: float) -> float:
    speed = np.hypot(*own.velocity[own.timesteps >= at_step].T)
    return float(max(0.0, -np.gradient(speed, step_s).min())) if speed.size > 1 else 0.0


def _closing(own: Track, target: Track, since_step: int, step_s: float) -> tuple[float | None, float]:
    """Smallest TTC of the pair, s, and the target's largest DRAC, m/s2, from a step on."""
    arrays = stack([own, target], step_s=step_s)
    ttc_s = ttc_to_anything(arrays, cap_s=CAP_S)
    rows = np.flatnonzero((arrays.agent == 1) & (arrays.step >= since_step) & (arrays.row_of[0, arrays.step] >= 0))
    if not rows.size or ttc_s[rows].min() >= CAP_S:
        return None, 0.0
    other = arrays.velocity[arrays.row_of[0, arrays.step[rows]]]
    forward = np.stack([np.cos(arrays.heading[rows]), np.sin(arrays.heading[rows])], axis=1)
    closing = np.sum((arrays.velocity[rows] - other) * forward, axis=1)
    # at a closing speed w the gap is w TTC, and the deceleration that takes it away w^2 / (2 gap)
    counts = (closing > _CLOSES_MPS) & (ttc_s[rows] < CAP_S)
    drac = closing[counts] / (2.0 * np.maximum(ttc_s[rows][counts], 1e-3))
    return float(ttc_s[rows].min()), float(drac.max(initial=0.0))


def _row(track: Track, step: int) -> int:
    found = np.flatnonzero(track.timesteps == step)
    if not found.size:
        raise ValueError(f"track {track.track_id} has no state at step {step}")
    return int(found[0])
