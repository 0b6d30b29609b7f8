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
from hid2.occupancy.gaps import gaps_on_path, gaps_to_all
from hid2.occupancy.traffic import BoolArray
from hid2.params import EventSearch

_FASTER_MPS = 0.05  # by less nobody closes in; no tunable, against rounding


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

    @property
    def is_own_there(self) -> BoolArray:
        """(T,) whether the target is on the path."""
        return np.asarray(np.isfinite(self.taken.low[self.own]).any(axis=0))

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

    def rows(self, rows: BoolArray | IntArray) -> "Wanted":
        """Some of them."""
        return Wanted(
            self.at[rows], self.place[rows], self.gap_m[rows], self.speed_mps[rows], self.before_mps2[rows],
            self.later_mps[rows],
        )  # fmt: skip


@dataclass(frozen=True, eq=False, slots=True)
class Rules:
    """What motions keep to: order as in a plan (-1 behind the target), lengths: half of both boxes, m.

    changes: whether the vehicle changes lanes at the moment, from `before` to `after`; brakes_mps2: after the moment;
    target_mps (T,), ahead (T,) m: of the target, ahead None where it is not followed; ttc_s: least TTC to all
    others; tau_s: time gap of the driver; search: gaps and accelerations.
    """

    order: int
    lengths: float
    changes: bool
    brakes_mps2: float
    target_mps: FloatArray
    ahead: FloatArray | None
    ttc_s: float
    tau_s: float
    step_s: float
    search: EventSearch


@dataclass(frozen=True, eq=False, slots=True)
class Half:
    """What motions of a fan do up to their moment, or after it; those that are alike there are one.

    wanted (U,); speeds (U, T) m/s and way (U, T) m, 0 at the steps of the other half; of (N,): the row of each motion.
    """

    wanted: Wanted
    speeds: FloatArray
    way: FloatArray
    of: IntArray
    is_first: bool

    def steps(self) -> range:
        """Steps at which some motion is in this half."""
        at, end = self.wanted.at, self.way.shape[1]
        return range(int(at.max(initial=-1)) + 1) if self.is_first else range(int(at.min(initial=end)) + 1, end)

    def has(self, steps: IntArray | int) -> BoolArray:
        """(U,) or (U, K) whether motions are in this half at steps."""
        at = self.wanted.at if isinstance(steps, int) else self.wanted.at[:, None]
        return np.asarray((steps <= at) == self.is_first)

    def rows(self, rows: BoolArray) -> "Half":
        """Of some motions."""
        used, of = np.unique(self.of[rows], return_inverse=True)
        return Half(self.wanted.rows(used), self.speeds[used], self.way[used], of, self.is_first)


@dataclass(frozen=True, eq=False, slots=True)
class Fan:
    """Motions (N,), by their moments at (N,) and their two halves."""

    at: IntArray
    until: Half
    since: Half

    def way_at(self, steps: IntArray) -> FloatArray:
        """(N,) m, where each is at a step of its own."""
        first, second = self.until, self.since
        return np.where(steps <= self.at, first.way[first.of, steps], second.way[second.of, steps])

    def rows(self, rows: BoolArray) -> "Fan":
        """Some of them."""
        return Fan(self.at[rows], self.until.rows(rows), self.since.rows(rows))

    def motion(self, row: int) -> tuple[FloatArray, FloatArray]:
        """Speed (T,) m/s and way (T,) m of one of them."""
        first, second = self.until, self.since
        is_first = np.arange(first.way.shape[1]) <= self.at[row]
        speed, way = (
            np.where(is_first, one[first.of[row]], two[second.of[row]])
            for one, two in ((first.speeds, second.speeds), (first.way, second.way))
        )
        return speed, way


def motions(wanted: Wanted, rules: Rules, before: Along, after: Along) -> Fan:
    """All motions that are wanted; whether they are free is another matter."""
    until, of_until = _unlike(wanted, wanted.before_mps2)
    since, of_since = _unlike(wanted, wanted.later_mps)
    first, second = wanted.rows(until), wanted.rows(since)
    return Fan(
        wanted.at,
        Half(first, *_until(first, rules, before), of_until, is_first=True),
        Half(second, *_since(second, rules, after), of_since, is_first=False),
    )


def _unlike(wanted: Wanted, other: FloatArray) -> tuple[IntArray, IntArray]:
    """First row of each group of motions alike at the moment and in something else, and for each row its group."""
    same = np.nan_to_num(np.stack([wanted.at, wanted.place, wanted.gap_m, wanted.speed_mps, other]), nan=-1e9)
    order = np.lexsort(same)
    begins = np.concatenate([np.ones(min(order.size, 1), dtype=np.bool_), (np.diff(same[:, order]) != 0.0).any(axis=0)])
    group = np.empty(order.size, dtype=np.int64)
    group[order] = np.cumsum(begins) - 1
    return order[begins], group


def _until(wanted: Wanted, rules: Rules, before: Along) -> tuple[FloatArray, FloatArray]:
    """Speeds (N, T) m/s and ways (N, T) m up to the moment; 0 after it."""
    dt, rows = rules.step_s, np.arange(wanted.at.size)
    speeds, way = np.zeros((2, wanted.at.size, rules.target_mps.size))
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
    return speeds, way


def _since(wanted: Wanted, rules: Rules, after: Along) -> tuple[FloatArray, FloatArray]:
    """Speeds (N, T) m/s and ways (N, T) m after the moment; 0 up to it."""
    steps, dt, search = rules.target_mps.size, rules.step_s, rules.search
    slows_mps2, speeds_up_mps2 = -search.slows_mps2, search.speeds_up_mps2
    speeds, way = np.zeros((2, wanted.at.size, steps))
    keeps, others = np.isnan(wanted.later_mps), after.taken.same_direction & ~after.own[:, None]
    later = np.where(keeps, wanted.speed_mps, wanted.later_mps)
    v, s = wanted.speed_mps.copy(), wanted.place.copy()
    for step in range(int(wanted.at.min(initial=steps)) + 1, steps):
        here = wanted.at < step
        accel = np.clip(search.speed_pull_per_s * (later - v), slows_mps2, speeds_up_mps2)
        if rules.ahead is not None:
            apart = rules.order * (s - rules.ahead[step - 1]) - rules.lengths
            gap = np.maximum(np.minimum(wanted.gap_m, search.kept_gap_m), search.ahead_gap_m + search.ahead_gap_s * v)
            kept = search.speed_pull_per_s * (rules.target_mps[step - 1] - v)
            kept = kept + rules.order * search.gap_pull_per_s2 * (gap - apart)
            accel = np.where(keeps, np.clip(kept, slows_mps2, speeds_up_mps2), accel)
            if rules.brakes_mps2:
                braking = (step - wanted.at) * dt <= search.brakes_s
                accel = np.where(braking, -rules.brakes_mps2, accel)
        near = gaps_on_path(after.taken, s + after.from_m, step - 1, among=others)
        kept_ahead = search.leader_speed_pull_per_s * (near.lag_mps - v) - search.leader_gap_pull_per_s2 * (
            near.lag_m - search.leader_gap_m - (rules.tau_s + search.leader_gap_s) * near.lag_mps
        )
        accel = np.maximum(accel, np.minimum(kept_ahead, speeds_up_mps2))
        led = search.leader_speed_pull_per_s * (near.lead_mps - v) + search.leader_gap_pull_per_s2 * (
            near.lead_m - search.leader_gap_m - (rules.tau_s + search.leader_gap_s) * v
        )
        accel = np.minimum(accel, np.maximum(led, -search.leader_brakes_mps2))
        v = np.where(here, np.clip(v + accel * dt, 0.0, after.at(s + after.from_m)), v)
        s = np.where(here, s + v * dt, s)
        speeds[here, step], way[here, step] = v[here], s[here]
    return speeds, way


def first_met_s(fan: Fan, rules: Rules, before: Along, after: Along) -> FloatArray:
    """(N,) time, s, at which a motion first touches somebody, or comes too near to anybody but the target; else inf."""
    first, second = (_first_met(half, rules, before, after)[half.of] for half in (fan.until, fan.since))
    return np.minimum(first, second) * rules.step_s


def _first_met(half: Half, rules: Rules, before: Along, after: Along) -> FloatArray:
    """(U,) step at which somebody is first met in a half; inf for never."""
    dt, at = rules.step_s, half.wanted.at
    until = np.full(at.size, np.inf)
    still, already = round(rules.search.leaves_s / dt), round(rules.search.arrives_s / dt)
    for step in half.steps():
        rows = np.flatnonzero(np.isinf(until) & half.has(step))  # who has met somebody is not looked at again
        s, v = half.way[rows, step], half.speeds[rows, step]
        bad = np.zeros(rows.size, dtype=np.bool_)
        looks = [(before, np.ones(rows.size, dtype=np.bool_))]
        if rules.changes:
            looks = [(before, step <= at[rows] + still), (after, step >= at[rows] - already)]
        for along, on in looks:
            if on.any():
                bad |= on & _is_met(along, s + along.from_m, v, step, rules, up_to_event=half.is_first)
        until[rows[bad]] = step
    return until


def kept_to(fan: Fan, rules: Rules, there: BoolArray) -> tuple[FloatArray, FloatArray]:
    """(N,) smallest TTC, s, and largest DRAC, m/s2, of vehicle and target; -1 s where they come nearer than margin_m.

    From the moment on, with a change of lanes from when half of `arrives_s` is left.
    there (T,): whether the target is on the path; elsewhere it closes in on nobody.
    """
    halves = [(half.of, *_kept_to(half, rules, there)) for half in (fan.until, fan.since)]
    (ttc, drac), (later_ttc, later_drac) = ((ttc[of], drac[of]) for of, ttc, drac in halves)
    return np.minimum(ttc, later_ttc), np.maximum(drac, later_drac)


def _kept_to(half: Half, rules: Rules, there: BoolArray) -> tuple[FloatArray, FloatArray]:
    """(U,) the same of a half."""
    assert rules.ahead is not None
    arrives = round(0.5 * rules.search.arrives_s / rules.step_s) if rules.changes else 0
    span = half.steps()
    steps = np.arange(max(span.start, int(half.wanted.at.min(initial=span.stop)) - arrives), span.stop)
    looked = there[steps] & half.has(steps) & (steps >= half.wanted.at[:, None] - arrives)
    apart = rules.order * (half.way[:, steps] - rules.ahead[steps]) - rules.lengths
    closing = rules.order * (rules.target_mps[steps] - half.speeds[:, steps])
    closes = looked & (closing > _FASTER_MPS)
    with np.errstate(divide="ignore", invalid="ignore"):
        ttc = np.where(closes, apart / closing, np.inf)
        drac = np.where(closes, closing * closing / (2.0 * np.maximum(apart, 0.1)), 0.0)
    touched = (looked & (apart < rules.search.margin_m)).any(axis=1)
    return np.where(touched, -1.0, ttc.min(axis=1, initial=np.inf)), drac.max(axis=1, initial=0.0)


def _is_met(along: Along, s: FloatArray, v: FloatArray, step: int, rules: Rules, *, up_to_event: bool) -> BoolArray:
    """(N,) whether somebody is touched, or closed in on, at a step."""
    search, near = rules.search, gaps_to_all(along.taken, s, step)
    others = (along.taken.same_direction[:, step] & ~along.own)[:, None]
    closing = v - near.along_mps
    bad = np.minimum(near.lead_m, near.lag_m) < search.margin_m
    bad |= others & (closing > _FASTER_MPS) & (near.lead_m < rules.ttc_s * closing)
    bad |= others & (closing < -_FASTER_MPS) & (near.lag_m < -rules.ttc_s * closing)
    if up_to_event:
        bad |= others & (near.lead_m < search.min_gap_m + rules.tau_s * v)
    return np.asarray(bad.any(axis=0))
