"""Which vehicles may close in on a vehicle ahead: a cheap test, before lanes are matched."""

import numpy as np

from hid2.kernels.compiled import inner, kernel
from netconvert.geometry import BoolArray, FloatArray, IntArray

# No tunables, spare time: whoever may close in passes this test, and is then measured on the lanes.
_SLACK_M = 0.5
_ONCOMING = -0.2  # cosine of the angle between two that do not follow each other, not even round a corner
_SHARPEST_M, _LATERAL_MPS2 = 6.0, 6.0  # radius of the bend that may lie ahead at any speed, and by the speed
_NEAR_M = 50.0  # who is farther away all the time leads nobody at a critical TTC


@inner
def _aside(own: int, t: int, place: FloatArray, row_of: IntArray, position: FloatArray, heading: FloatArray) -> float:
    """How far to the left of an agent's own future track a place lies, m; straight on behind the track's end."""
    aside = 0.0
    for k in range(t, row_of.shape[1]):
        i = row_of[own, k]
        if i < 0:
            break
        dx, dy = place[0] - position[i, 0], place[1] - position[i, 1]
        cosine, sine = np.cos(heading[i]), np.sin(heading[i])
        aside = dy * cosine - dx * sine
        if dx * cosine + dy * sine <= 0.0:
            break
    return aside


@inner
def _closes_in(
    own: int, t: int, i: int, place: FloatArray, motion: FloatArray, apart: float, beside: float, row_of: IntArray,
    position: FloatArray, heading: FloatArray, speed: float, leaves: bool, critical: float,  # noqa: FBT001
) -> bool:  # fmt: skip
    """Whether an agent closes in, fast enough, on somebody ahead of it who may be on its way.

    apart, beside: centre to centre where their boxes touch end to end and side to side, m.
    """
    dx, dy = place[0] - position[i, 0], place[1] - position[i, 1]
    closing = speed - np.hypot(motion[0], motion[1])
    if closing <= 0.0 or np.hypot(dx, dy) - apart > critical * closing + _SLACK_M:
        return False
    beside = beside + _SLACK_M
    if not leaves:
        return bool(abs(_aside(own, t, place, row_of, position, heading)) < beside)
    cosine, sine = np.cos(heading[i]), np.sin(heading[i])
    ahead = dx * cosine + dy * sine
    radius = max(_SHARPEST_M, speed * speed / _LATERAL_MPS2)
    return bool(abs(dy * cosine - dx * sine) < beside + ahead * ahead / (2 * radius))


@kernel("(i8, i8[:,::1], f8[:,::1], f8[::1], f8[:,::1], f8[::1], f8[::1], b1, i8, f8,)")
def vehicles_ahead(
    own: int, row_of: IntArray, position: FloatArray, heading: FloatArray, velocity: FloatArray, length: FloatArray,
    width: FloatArray, leaves: bool, first: int, critical: float,  # noqa: FBT001
) -> tuple[BoolArray, bool]:  # fmt: skip
    """Who is ahead of an agent at some step, not far, (A,), and whether it closes in on one of `first` and later."""
    agents, steps = row_of.shape
    near, closes_in = np.zeros(agents, dtype=np.bool_), False
    for t in range(steps):
        i = row_of[own, t]
        if i < 0:
            continue
        cosine, sine = np.cos(heading[i]), np.sin(heading[i])
        speed = np.hypot(velocity[i, 0], velocity[i, 1])
        for other in range(agents):
            j = row_of[other, t]
            if j < 0 or other == own:
                continue
            dx, dy = position[j, 0] - position[i, 0], position[j, 1] - position[i, 1]
            if dx * dx + dy * dy > _NEAR_M * _NEAR_M:
                continue
            ahead = dx * cosine + dy * sine
            if ahead <= 0.0 or np.cos(heading[j] - heading[i]) < _ONCOMING:
                continue
            near[other] = True
            if closes_in or other < first:
                continue
            closes_in = _closes_in(
                own, t, i, position[j], velocity[j], (length[own] + length[other]) / 2,
                (width[own] + width[other]) / 2, row_of, position, heading, speed, leaves, critical,
            )  # fmt: skip
    return near, closes_in


@kernel(
    "(i8[:,::1], f8[:,::1], f8[::1], f8[:,::1], b1[::1], f8[::1], f8[::1], i8[::1], f8[:,::1], f8[::1], f8[:,::1], f8,)"
)
def closing_vehicles(
    row_of: IntArray, position: FloatArray, heading: FloatArray, velocity: FloatArray, moving: BoolArray,
    apart: FloatArray, beside: FloatArray, steps: IntArray, place: FloatArray, direction: FloatArray,
    motion: FloatArray, critical: float,
) -> BoolArray:  # fmt: skip
    """Which agents, (A,), close in at some step on a track of rows (M,) that is not theirs."""
    found = np.zeros(row_of.shape[0], dtype=np.bool_)
    for agent in range(row_of.shape[0]):
        if not moving[agent]:
            continue
        for k in range(steps.shape[0]):
            i = row_of[agent, steps[k]]
            if i < 0:
                continue
            dx, dy = place[k, 0] - position[i, 0], place[k, 1] - position[i, 1]
            if dx * dx + dy * dy > _NEAR_M * _NEAR_M:
                continue
            ahead = dx * np.cos(heading[i]) + dy * np.sin(heading[i])
            if ahead <= 0.0 or np.cos(direction[k] - heading[i]) < _ONCOMING:
                continue
            speed = np.hypot(velocity[i, 0], velocity[i, 1])
            if _closes_in(
                agent, steps[k], i, place[k], motion[k], apart[agent], beside[agent], row_of, position, heading, speed,
                False, critical,
            ):  # fmt: skip
                found[agent] = True
                break
    return found
