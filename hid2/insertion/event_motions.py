"""Motions with which a vehicle may come about an event: many at once along one path, and which of them are free.

All motions of a fan are worked out backwards and forwards from the moment of the event: there a vehicle is at a place
with a speed; before, its acceleration is constant, or it moves as the target does; afterwards it keeps to the target,
or goes to a speed, and keeps off whoever is ahead and behind. What is recorded is known for the whole scene, so that
motions that would meet somebody go before anything is driven.
"""

from dataclasses import dataclass

import numpy as np

from hid2.agents import FloatArray, IntArray
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.occupancy.along_path import PathOccupancy
from hid2.occupancy.traffic import BoolArray

#: How a driver of an event keeps to the target: pull towards its speed, 1/s, and towards the gap, 1/s2.
_SPEED_PULL, _GAP_PULL = 0.6, 0.15
SLOWS_MPS2, SPEEDS_UP_MPS2 = -1.5, 1.4
#: Ahead of the target a vehicle keeps at least this gap, m, and so much of its speed, s; a gap asked for counts up to.
_AHEAD_GAP_M, _AHEAD_TIME_S, _KEEPS_M = 5.0, 0.3, 12.0
#: The same to who is ahead of it: pulls, gap and time; and how hard it brakes for it, m/s2.
_LEADER_PULL, _LEADER_GAP_PULL, _LEADER_GAP_M, _LEADER_TIME_S, _LEADER_MPS2 = 0.7, 0.25, 2.5, 0.7, -2.4
_BRAKES_FOR_S = 1.5
#: Kept to boxes by plan, m; to who is ahead up to the event, m and s.
_MARGIN_M, _HEAD_M, _HEAD_S = 0.35, 1.5, 0.35
#: A lateral motion touches the lane left so long after the moment, and the lane that it goes to so long before, s.
_STILL_THERE_S, _ALREADY_THERE_S = 1.2, 1.3


@dataclass(frozen=True, eq=False, slots=True)
class Along:
    """A path with everybody on it, and what the road allows.

    cap (S,) m/s at the table of its line; taken: recorded vehicles and those kept, (A, T); own: rows of the target
    there; exit_m: where it ends; from_m: a place on it minus that place on the path that motions are given on.
    """

    cap: FloatArray
    taken: PathOccupancy
    own: BoolArray
    exit_m: float
    from_m: float

    def at(self, s: FloatArray) -> FloatArray:
        """What the road allows at places (N,) m."""
        return np.asarray(self.cap[np.clip((s / TABLE_STEP_M).astype(np.int64), 0, self.cap.size - 1)])


@dataclass(frozen=True, eq=False, slots=True)
class Wanted:
    """Motions that are wanted (N,): at step at, at place m on the path, with speed_mps.

    before_mps2: acceleration before, nan where it moves as the target does; later_mps: speed that it goes to
    afterwards, nan where it keeps to the target, with gap_m.
    """

    at: IntArray
    place: FloatArray
    gap_m: FloatArray
    speed_mps: FloatArray
    before_mps2: FloatArray
    later_mps: FloatArray

    def rows(self, rows: BoolArray) -> "Wanted":
        """Some of them."""
        return Wanted(
            self.at[rows], self.place[rows], self.gap_m[rows], self.speed_mps[rows], self.before_mps2[rows],
            self.later_mps[rows],
        )  # fmt: skip


@dataclass(frozen=True, eq=False, slots=True)
class Rules:
    """What motions keep to: order as in a plan (-1 behind the target), lengths: half of both boxes, m.

    changes: whether the vehicle changes lanes at the moment, from `before` to `after`; brakes_mps2: after the moment;
    target_mps (T,), ahead (T,) m: of the target, ahead None where it is not followed; ttc_s: least TTC to all others.
    """

    order: int
    lengths: float
    changes: bool
    brakes_mps2: float
    target_mps: FloatArray
    ahead: FloatArray | None
    ttc_s: float
    step_s: float


def motions(wanted: Wanted, rules: Rules, before: Along, after: Along) -> tuple[FloatArray, FloatArray]:
    """Speeds (N, T) m/s and ways (N, T) m of wanted motions; whether they are free is another matter."""
    steps, dt = rules.target_mps.size, rules.step_s
    count = wanted.at.size
    speeds, way = np.zeros((count, steps)), np.zeros((count, steps))
    rows = np.arange(count)
    speeds[rows, wanted.at], way[rows, wanted.at] = wanted.speed_mps, wanted.place
    v, s = wanted.speed_mps.copy(), wanted.place.copy()
    difference = wanted.speed_mps - rules.target_mps[wanted.at]
    as_target = np.isnan(wanted.before_mps2)
    for step in range(int(wanted.at.max(initial=0)) - 1, -1, -1):
        here = wanted.at > step
        s = np.where(here, s - v * dt, s)
        free = np.where(
            as_target,
            rules.target_mps[step] + difference * step / np.maximum(wanted.at, 1),
            wanted.speed_mps - np.where(as_target, 0.0, wanted.before_mps2) * (wanted.at - step) * dt,
        )
        v = np.where(here, np.minimum(np.maximum(free, 0.0), before.at(s)), v)
        speeds[here, step], way[here, step] = v[here], s[here]
    keeps = np.isnan(wanted.later_mps)
    later = np.where(keeps, wanted.speed_mps, wanted.later_mps)
    v, s = wanted.speed_mps.copy(), wanted.place.copy()
    for step in range(int(wanted.at.min(initial=steps)) + 1, steps):
        here = wanted.at < step
        accel = np.clip(_SPEED_PULL * (later - v), SLOWS_MPS2, SPEEDS_UP_MPS2)
        if rules.ahead is not None:
            apart = rules.order * (s - rules.ahead[step - 1]) - rules.lengths
            gap = np.maximum(np.minimum(wanted.gap_m, _KEEPS_M), _AHEAD_GAP_M + _AHEAD_TIME_S * v)
            kept = _SPEED_PULL * (rules.target_mps[step - 1] - v) + rules.order * _GAP_PULL * (gap - apart)
            accel = np.where(keeps, np.clip(kept, SLOWS_MPS2, SPEEDS_UP_MPS2), accel)
            if rules.brakes_mps2:
                braking = (step - wanted.at) * dt <= _BRAKES_FOR_S
                accel = np.where(braking, -rules.brakes_mps2, accel)
        room, follows = _behind_of(after, s + after.from_m, step - 1)
        kept_ahead = _LEADER_PULL * (follows - v) - _LEADER_GAP_PULL * (room - _LEADER_GAP_M - _LEADER_TIME_S * follows)
        accel = np.maximum(accel, np.minimum(kept_ahead, SPEEDS_UP_MPS2))
        room, lead = _ahead_of(after, s + after.from_m, step - 1)
        led = _LEADER_PULL * (lead - v) + _LEADER_GAP_PULL * (room - _LEADER_GAP_M - _LEADER_TIME_S * v)
        accel = np.minimum(accel, np.maximum(led, _LEADER_MPS2))
        v = np.where(here, np.clip(v + accel * dt, 0.0, after.at(s + after.from_m)), v)
        s = np.where(here, s + v * dt, s)
        speeds[here, step], way[here, step] = v[here], s[here]
    return speeds, way


def free(wanted: Wanted, rules: Rules, before: Along, after: Along, speeds: FloatArray, way: FloatArray) -> FloatArray:
    """(N,) time, s, at which a motion first touches somebody, or comes too near to anybody but the target; else inf."""
    steps, dt = rules.target_mps.size, rules.step_s
    until = np.full(wanted.at.size, np.inf)
    still, already = round(_STILL_THERE_S / dt), round(_ALREADY_THERE_S / dt)
    for step in range(steps):
        s, v = way[:, step], speeds[:, step]
        bad = np.zeros(wanted.at.size, dtype=np.bool_)
        looks = [(before, np.ones(wanted.at.size, dtype=np.bool_))]
        if rules.changes:
            looks = [(before, step <= wanted.at + still), (after, step >= wanted.at - already)]
        for along, on in looks:
            if on.any():
                bad |= on & _is_met(along, s + along.from_m, v, step, rules, up_to_event=step <= wanted.at)
        until = np.where(bad & (until > step), step, until)
    return until * dt


def kept_to(
    wanted: Wanted, rules: Rules, speeds: FloatArray, way: FloatArray, present: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """(N,) smallest TTC, s, and largest DRAC, m/s2, of vehicle and target from the moment on; -1 s where they touch."""
    assert rules.ahead is not None
    steps = np.arange(rules.target_mps.size)
    since = wanted.at - (round(0.5 * _ALREADY_THERE_S / rules.step_s) if rules.changes else 0)
    there = present[None, :] & (steps[None, :] >= since[:, None])
    apart = rules.order * (way - rules.ahead) - rules.lengths
    closing = rules.order * (rules.target_mps - speeds)
    with np.errstate(divide="ignore", invalid="ignore"):
        ttc = np.where(there & (closing > 0.05), apart / closing, np.inf)
        drac = np.where(there & (closing > 0.05), closing * closing / (2.0 * np.maximum(apart, 0.1)), 0.0)
    touched = (there & (apart < 1.0)).any(axis=1)
    return np.where(touched, -1.0, ttc.min(axis=1)), drac.max(axis=1)


def _ahead_of(along: Along, s: FloatArray, step: int) -> tuple[FloatArray, FloatArray]:
    """Room (N,) m to who is next ahead with the path, and its speed; the target is left out. inf where nobody is."""
    rows = along.taken.same_direction[:, step] & ~along.own & np.isfinite(along.taken.low[:, step])
    if not rows.any():
        return np.full(s.size, np.inf), np.zeros(s.size)
    low, speed = along.taken.low[rows, step], along.taken.along[rows, step]
    order = np.argsort(low)
    low, speed = np.append(low[order], np.inf), np.append(speed[order], 0.0)
    place = np.searchsorted(low, s)
    return low[place] - s, np.where(np.isfinite(low[place]), np.maximum(speed[place], 0.0), 0.0)


def _behind_of(along: Along, s: FloatArray, step: int) -> tuple[FloatArray, FloatArray]:
    """Room (N,) m to who comes next from behind with the path, and its speed; the target is left out."""
    rows = along.taken.same_direction[:, step] & ~along.own & np.isfinite(along.taken.low[:, step])
    if not rows.any():
        return np.full(s.size, np.inf), np.zeros(s.size)
    high, speed = along.taken.high[rows, step], along.taken.along[rows, step]
    order = np.argsort(high)
    high, speed = np.append(-np.inf, high[order]), np.append(0.0, speed[order])
    place = np.searchsorted(high, s) - 1
    return s - high[place], np.maximum(speed[place], 0.0)


def _is_met(
    along: Along, s: FloatArray, v: FloatArray, step: int, rules: Rules, *, up_to_event: BoolArray
) -> BoolArray:
    """(N,) whether somebody is touched, or closed in on, at a step."""
    taken = along.taken
    rows = np.isfinite(taken.low[:, step])
    if not rows.any():
        return np.zeros(s.size, dtype=np.bool_)
    low, high = taken.low[rows, step, None], taken.high[rows, step, None]
    own, same_direction, speed = (
        along.own[rows, None],
        taken.same_direction[rows, step, None],
        taken.along[rows, step, None],
    )
    bad = (s > low - _MARGIN_M) & (s < high + _MARGIN_M)
    with np.errstate(divide="ignore", invalid="ignore"):
        ahead, behind = low - s, s - high
        leads = same_direction & ~own & (ahead > 0)
        bad |= leads & (v > speed + 0.05) & (ahead < rules.ttc_s * (v - speed))
        bad |= leads & up_to_event & (ahead < _HEAD_M + _HEAD_S * v)
        bad |= same_direction & ~own & (behind > 0) & (speed > v + 0.05) & (behind < rules.ttc_s * (speed - v))
    return np.asarray(bad.any(axis=0))
