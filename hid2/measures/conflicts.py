"""Two agents against each other, and conflicts in SSAM's terms: TTC, PET, DRAC, MaxS, DeltaS, class by angle.

Definitions and thresholds: Surrogate Safety Assessment Model (Gettman et al. 2008, FHWA-HRT-08-051).
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from hid2.agents import FloatArray, IntArray
from hid2.kernels.box_pairs import swept_paths_cross
from hid2.measures.arrays import SceneArrays
from hid2.measures.post_encroachment import CROSSING_RAD, encroachments
from hid2.measures.time_to_collision import CAP_S, ttc_to_anything
from netconvert.geometry import differences, wrap_angle

#: A conflict has a TTC below the first, or paths that cross within the second, s (SSAM's thresholds).
CONFLICT_TTC_S, CONFLICT_PET_S = 1.5, 5.0
#: Angles between the two headings below the first are rear-end, above the second crossing conflicts (SSAM's, deg).
REAR_END_DEG, CROSSING_DEG = 30.0, 80.0
#: Slower than this no gap closes, m/s, and no follower has a headway. No tunable, against rounding.
_CLOSES_MPS = 0.05


@dataclass(frozen=True, eq=False, slots=True)
class PairCourse:
    """A follower and another agent at the steps at which both are there (K,).

    rows, other: rows of the two; ttc_s: of the boxes at constant velocities, inf above the cap; gap_m: bumper to bumper
    along the follower's heading, negative where they are side by side; drac_mps2: deceleration that takes the closing
    speed w along that heading away within w TTC, w / (2 TTC), 0 without a TTC, and of one step where less is left, also
    where boxes touch; headway_s: front to front; brakes_mps2: how hard the follower slows down, 0 where it does not.
    """

    step: IntArray
    rows: IntArray
    other: IntArray
    ttc_s: FloatArray
    gap_m: FloatArray
    drac_mps2: FloatArray
    headway_s: FloatArray
    brakes_mps2: FloatArray

    def during(self, first: int, last: int) -> "PairCourse":
        """From a step to another."""
        keep = (self.step >= first) & (self.step <= last)
        return PairCourse(*(getattr(self, name)[keep] for name in self.__slots__))


def pair_course(arrays: SceneArrays, follower: int, other: int, *, cap_s: float = CAP_S) -> PairCourse:
    """How a follower meets another agent."""
    pair = arrays.agents([follower, other])
    steps = np.flatnonzero((pair.row_of >= 0).all(axis=0))
    own, its = pair.row_of[0, steps], pair.row_of[1, steps]
    ttc_s = ttc_to_anything(pair, cap_s=cap_s)[own]
    known = ttc_s < cap_s
    forward = np.stack([np.cos(pair.heading[own]), np.sin(pair.heading[own])], axis=1)
    ahead_m = np.sum((pair.position[its] - pair.position[own]) * forward, axis=1)
    closing = np.sum((pair.velocity[own] - pair.velocity[its]) * forward, axis=1)
    speed = np.sum(pair.velocity[own] * forward, axis=1)
    drac = np.where(known & (closing > _CLOSES_MPS), closing / (2.0 * np.maximum(ttc_s, arrays.step_s)), 0.0)
    front_m = ahead_m + 0.5 * (pair.length[1] - pair.length[0])
    slows = -differences(np.hypot(*pair.velocity[own].T), arrays.step_s)
    return PairCourse(
        step=steps, rows=arrays.row_of[follower, steps], other=arrays.row_of[other, steps],
        ttc_s=np.where(known, ttc_s, np.inf), gap_m=ahead_m - 0.5 * (pair.length[0] + pair.length[1]),
        drac_mps2=drac, brakes_mps2=np.maximum(slows, 0.0),
        headway_s=np.where(speed > _CLOSES_MPS, front_m / np.maximum(speed, _CLOSES_MPS), np.inf),
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class TrafficConflict:
    """One conflict; the second vehicle is the one that comes to the place of conflict later.

    start_s, end_s: TTC below the threshold, or the crossing's two passages; time_s: of the least TTC; ttc_s, pet_s:
    least, None above the thresholds; drac_mps2: largest of the second vehicle; max_s_mps: MaxS, larger speed of the two
    over the conflict; delta_s_mps: DeltaS, length of the difference of velocities at time_s; angle_deg: between the
    headings then, -180 to 180, positive where the second comes from the right; kind: rear_end, lane_change, crossing;
    x_m, y_m: between the two then, or where they pass the crossing, city frame.
    """

    first_id: str
    second_id: str
    kind: str
    start_s: float
    end_s: float
    time_s: float
    ttc_s: float | None
    pet_s: float | None
    drac_mps2: float
    max_s_mps: float
    delta_s_mps: float
    angle_deg: float
    x_m: float
    y_m: float

    @property
    def text(self) -> str:
        """The conflict in a few words."""
        told = (("TTC", self.ttc_s), ("PET", self.pet_s))
        measured = ", ".join(f"{name} {value:.1f} s" for name, value in told if value is not None)
        return f"{self.first_id}, {self.second_id}: {self.kind.replace('_', ' ')}, {measured} at {self.time_s:.1f} s"


def conflicts(
    arrays: SceneArrays, *, ttc_s: float = CONFLICT_TTC_S, pet_s: float = CONFLICT_PET_S
) -> list[TrafficConflict]:
    """Every conflict between two vehicles of which one moves, by start; a TTC above the threshold for 5 s ends one.

    ttc_s, pet_s: thresholds of the TTC and of the PET of paths that cross.
    """
    crossing = _crossings(arrays, pet_s)
    found: list[TrafficConflict] = []
    for a, b in sorted({*_near_pairs(arrays, ttc_s), *crossing}):
        course = pair_course(arrays, a, b, cap_s=ttc_s)
        close, met_s = course.step[np.isfinite(course.ttc_s)], crossing.get((a, b))
        passed = _passed(arrays, a, b) if met_s is not None else {}
        if passed and not close.size:
            close = course.step[(course.step >= min(passed.values())) & (course.step <= max(passed.values()))]
        if not close.size:
            continue
        for part in np.split(close, np.flatnonzero(np.diff(close) * arrays.step_s > CONFLICT_PET_S) + 1):
            span = course.during(int(part[0]), int(part[-1]))
            first = _first(arrays, (a, b), span, passed)
            found.append(_conflict(arrays, (first, a + b - first), span, met_s, passed))
    return sorted(found, key=lambda one: (one.start_s, one.first_id, one.second_id))


def _crossings(arrays: SceneArrays, pet_s: float) -> dict[tuple[int, int], float]:
    """PET, s, of moving vehicles on paths that cross within pet_s; of those there within so long of each other."""
    since, until = arrays.step[arrays.first[:-1]], arrays.step[arrays.first[1:] - 1]
    moving, apart = np.flatnonzero(arrays.vehicle & arrays.moving), pet_s / arrays.step_s
    found: dict[tuple[int, int], float] = {}
    for own in moving.tolist():
        met = (since[moving] <= until[own] + apart) & (until[moving] >= since[own] - apart) & (moving <= own)
        pairs = encroachments(arrays, since=own, cap_s=pet_s, agents=moving[met])
        found |= {(one.first, one.second): one.pet_s for one in pairs if one.pet_s <= pet_s}
    return found


def _passed(arrays: SceneArrays, a: int, b: int) -> dict[int, int]:
    """Steps by vehicle at which two pass the place where their paths cross."""
    own, its = (slice(int(arrays.first[one]), int(arrays.first[one + 1])) for one in (a, b))
    position, heading = arrays.position, arrays.heading
    at, then = swept_paths_cross(
        position[own], heading[own], arrays.length[a], position[its], heading[its], arrays.length[b],
        math.sin(CROSSING_RAD),
    )  # fmt: skip
    return {a: int(arrays.step[own][at]), b: int(arrays.step[its][then])}


def _first(arrays: SceneArrays, agents: tuple[int, int], span: PairCourse, passed: Mapping[int, int]) -> int:
    """The one of two that passes a crossing first, or else is ahead at the least TTC, by the faster one's heading."""
    if passed:
        return min(passed, key=passed.__getitem__)
    at = int(np.argmin(span.ttc_s))
    pair = int(span.rows[at]), int(span.other[at])
    fast = max(pair, key=lambda row: float(np.hypot(*arrays.velocity[row])))
    forward = np.array([math.cos(arrays.heading[fast]), math.sin(arrays.heading[fast])])
    return agents[0] if (arrays.position[pair[0]] - arrays.position[pair[1]]) @ forward >= 0.0 else agents[1]


def _near_pairs(arrays: SceneArrays, ttc_s: float) -> Iterator[tuple[int, int]]:
    """Pairs of vehicles, one of them moving, that are near enough at some step for a TTC below the threshold."""
    starts, stops = arrays.first[:-1], arrays.first[1:]
    since, until = arrays.step[starts], arrays.step[stops - 1]
    reach_m, counts = 0.5 * np.hypot(arrays.length, arrays.width), arrays.vehicle
    for a in np.flatnonzero(counts).tolist():
        later = counts & (since <= until[a]) & (until >= since[a]) & (arrays.moving | arrays.moving[a])
        later[: a + 1] = False
        own = np.arange(starts[a], stops[a])
        rows = arrays.row_of[np.ix_(np.flatnonzero(later), arrays.step[own])]  # (K, steps of a)
        apart = arrays.position[rows] - arrays.position[own]
        closing = arrays.velocity[rows] - arrays.velocity[own]
        reach = reach_m[later][:, None] + reach_m[a] + ttc_s * np.hypot(*np.moveaxis(closing, -1, 0))
        near = ((rows >= 0) & (np.hypot(*np.moveaxis(apart, -1, 0)) <= reach)).any(axis=1)
        yield from ((a, b) for b in np.flatnonzero(later)[near].tolist())


def _conflict(
    arrays: SceneArrays, pair: tuple[int, int], span: PairCourse, crossing_s: float | None, passed: Mapping[int, int]
) -> TrafficConflict:
    """The conflict of a pair, the first to be there first, over some steps.

    crossing_s: PET where their paths cross; passed: step at which each passes there, by vehicle.
    """
    first, second = pair
    at, steps = int(np.argmin(span.ttc_s)), (int(span.step[0]), int(span.step[-1]))
    then, ttc_s = int(span.step[at]), float(span.ttc_s[at])
    one, other = (int(arrays.row_of[agent, then]) for agent in pair)
    met = passed if passed and not math.isfinite(ttc_s) else dict.fromkeys(pair, then)
    x_m, y_m = arrays.position[[arrays.row_of[agent, step] for agent, step in met.items()]].mean(axis=0).tolist()
    course = pair_course(arrays, second, first).during(*steps)
    pet_s = crossing_s if crossing_s is not None else _following_pet(arrays, first, second, steps)
    angle = math.degrees(float(wrap_angle(arrays.heading[other] - arrays.heading[one])))
    kind = "rear_end" if abs(angle) < REAR_END_DEG else "crossing" if abs(angle) > CROSSING_DEG else "lane_change"
    speeds = np.hypot(*arrays.velocity[np.concatenate([span.rows, span.other])].T)
    return TrafficConflict(
        first_id=arrays.track_ids[first], second_id=arrays.track_ids[second], kind=kind,
        start_s=round(steps[0] * arrays.step_s, 6), end_s=round(steps[1] * arrays.step_s, 6),
        time_s=round(then * arrays.step_s, 6), ttc_s=ttc_s if math.isfinite(ttc_s) else None, pet_s=pet_s,
        drac_mps2=float(course.drac_mps2.max()), max_s_mps=float(speeds.max()),
        delta_s_mps=float(np.hypot(*(arrays.velocity[one] - arrays.velocity[other]))), angle_deg=angle,
        x_m=x_m, y_m=y_m,
    )  # fmt: skip


def _following_pet(arrays: SceneArrays, first: int, second: int, steps: tuple[int, int]) -> float | None:
    """Least time, s, from when a vehicle leaves a place during some steps until another's front comes there.

    The place is the rear bumper's; the front passes it where it is within half the two widths of the heading's line.
    """
    rows = [np.arange(arrays.first[one], arrays.first[one + 1]) for one in (first, second)]
    ahead, behind = (arrays.step[own] for own in rows)
    forward = [np.stack([np.cos(arrays.heading[own]), np.sin(arrays.heading[own])], axis=1) for own in rows]
    rear = arrays.position[rows[0]] - 0.5 * arrays.length[first] * forward[0]
    front = arrays.position[rows[1]] + 0.5 * arrays.length[second] * forward[1]
    during = (ahead >= steps[0]) & (ahead <= steps[1])
    to_place = rear[during][:, None] - front  # (K, J, 2)
    along = np.einsum("kjx,jx->kj", to_place, forward[1])
    aside = np.abs(np.einsum("kjx,jx->kj", to_place, forward[1][:, ::-1] * (-1.0, 1.0)))
    there = (along <= 0.0) & (aside < 0.5 * (arrays.width[first] + arrays.width[second]))
    there &= behind >= ahead[during][:, None]
    apart = np.where(there, behind - ahead[during][:, None], np.inf).min(axis=1, initial=np.inf) * arrays.step_s
    least = float(apart.min(initial=np.inf))
    return least if least < CONFLICT_PET_S else None
