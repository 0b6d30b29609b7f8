"""Two agents against each other, and conflicts in SSAM's terms: TTC, PET, DRAC, MaxS, DeltaS, class by angle.

Definitions and thresholds: Surrogate Safety Assessment Model (Gettman et al. 2008, FHWA-HRT-08-051).
"""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hid2.agents import FloatArray, IntArray
from hid2.measures.arrays import SceneArrays
from hid2.measures.surrogates import CAP_S, REAR_END_DEG, Encroachment, encroachments, time_to_collision
from netconvert.geometry import differences, wrap_angle

#: Thresholds of a conflict, s: TTC, and PET of paths that cross (SSAM's).
CONFLICT_TTC_S, CONFLICT_PET_S = 1.5, 5.0
#: Angle between the two headings above which a conflict is crossing, deg (SSAM's); rear-end below REAR_END_DEG.
CROSSING_DEG = 85.0
#: Speed below which no gap closes and no follower has a headway, m/s. No tunable, against rounding.
CLOSES_MPS = 0.05


@dataclass(frozen=True, eq=False, slots=True)
class PairCourse:
    """A follower and another agent at the steps at which both are there (K,).

    rows, other: rows of the two; ttc_s: of the boxes at constant velocities, inf above the cap; gap_m: bumper to bumper
    along the follower's heading, negative where they are side by side; drac_mps2: deceleration that takes the closing
    speed w along that heading away within w TTC, w / (2 TTC), 0 without a TTC, and of one step where less is left, also
    where boxes touch; follower_drac_mps2: w^2 / (2 gap), also of what comes from beside, as in lane changes; headway_s:
    front to front; brakes_mps2: how hard the follower slows down, 0 where it does not.
    """

    step: IntArray
    rows: IntArray
    other: IntArray
    ttc_s: FloatArray
    gap_m: FloatArray
    drac_mps2: FloatArray
    follower_drac_mps2: FloatArray
    headway_s: FloatArray
    brakes_mps2: FloatArray

    def during(self, first: int, last: int) -> "PairCourse":
        """From a step to another."""
        keep = (self.step >= first) & (self.step <= last)
        return PairCourse(*(getattr(self, name)[keep] for name in self.__slots__))

    def of_follower(self) -> dict[str, float]:
        """What the follower had to do, by column of the tables of lane changes; nothing of no step."""
        if not self.step.size:
            return {}
        behind = self.headway_s[(self.gap_m >= 0.0) & np.isfinite(self.headway_s)]
        return {
            "lag_brakes_mps2": float(self.brakes_mps2.max()),
            "lag_drac_mps2": float(self.follower_drac_mps2.max()),
        } | ({"lag_headway_s": float(behind.min())} if behind.size else {})


def pair_course(arrays: SceneArrays, follower: int, other: int, *, cap_s: float = CAP_S) -> PairCourse:
    """How a follower meets another agent."""
    pair = arrays.agents([follower, other])
    steps = np.flatnonzero((pair.row_of >= 0).all(axis=0))
    own, its = pair.row_of[0, steps], pair.row_of[1, steps]
    ttc_s = time_to_collision(pair, cap_s=cap_s)[0][own]
    known = ttc_s < cap_s
    forward = np.stack([np.cos(pair.heading[own]), np.sin(pair.heading[own])], axis=1)
    ahead_m = np.sum((pair.position[its] - pair.position[own]) * forward, axis=1)
    closing = np.sum((pair.velocity[own] - pair.velocity[its]) * forward, axis=1)
    speed = np.sum(pair.velocity[own] * forward, axis=1)
    drac = np.where(known & (closing > CLOSES_MPS), closing / (2.0 * np.maximum(ttc_s, arrays.step_s)), 0.0)
    gap_m = ahead_m - 0.5 * (pair.length[0] + pair.length[1])
    closes = (closing > CLOSES_MPS) & (gap_m > 0.0)
    room_m = np.where(closes, np.maximum(gap_m, closing * arrays.step_s), 1.0)
    front_m = ahead_m + 0.5 * (pair.length[1] - pair.length[0])
    slows = -differences(np.hypot(*pair.velocity[own].T), arrays.step_s)
    return PairCourse(
        step=steps, rows=arrays.row_of[follower, steps], other=arrays.row_of[other, steps],
        ttc_s=np.where(known, ttc_s, np.inf), gap_m=gap_m, drac_mps2=drac,
        follower_drac_mps2=np.where(closes, closing**2 / (2.0 * room_m), 0.0), brakes_mps2=np.maximum(slows, 0.0),
        headway_s=np.where(speed > CLOSES_MPS, front_m / np.maximum(speed, CLOSES_MPS), np.inf),
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class TrafficConflict:
    """One conflict; the second vehicle is the one that comes to the place of conflict later."""

    first_id: Annotated[str, "the vehicle that is first at the place of conflict"]
    second_id: Annotated[str, "the other one"]
    kind: Annotated[str, "SSAM's class by the angle: rear_end below 30 degrees, crossing above 85, lane_change between"]
    start_s: Annotated[float, "from when the TTC is below 1.5 s; of a crossing without: when the first passes"]
    end_s: Annotated[float, "until when; of a crossing without: when the second passes"]
    time_s: Annotated[float, "time of the least TTC; of a crossing without: when the first passes"]
    ttc_s: Annotated[float | None, "TTC: least, of the boxes at constant velocities; empty: not below 1.5 s"]
    pet_s: Annotated[
        float | None,
        "PET: least, where the paths cross, else until the second comes where the first was; empty: above 5 s",
    ]
    drac_mps2: Annotated[float, "largest deceleration that the second needed to avoid the crash"]
    max_s_mps: Annotated[float, "MaxS: larger speed of the two during the conflict"]
    delta_s_mps: Annotated[
        float,
        "DeltaS: length of the difference of the velocities at time_s, of a crossing without a TTC as each passes",
    ]
    angle_deg: Annotated[
        float, "from the first's heading to the second's, at the same times; positive: it comes from the right"
    ]
    x_m: Annotated[float, "between the two at time_s, of a crossing without a TTC where they pass; city frame"]
    y_m: Annotated[float, "the same"]

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

    ttc_s, pet_s: thresholds of the TTC and of the PET of paths that cross. Velocities are those of the positions.
    """
    arrays = arrays.driven
    crossing = {(one.first, one.second): one for one in encroachments(arrays, cap_s=pet_s) if one.pet_s <= pet_s}
    near = time_to_collision(arrays, cap_s=ttc_s)[1] < ttc_s
    near &= np.outer(arrays.vehicle, arrays.vehicle) & (arrays.moving[:, None] | arrays.moving)
    found: list[TrafficConflict] = []
    for a, b in sorted({*zip(*(side.tolist() for side in np.nonzero(near)), strict=True), *crossing}):
        course, crossed = pair_course(arrays, a, b, cap_s=ttc_s), crossing.get((a, b))
        close = course.step[np.isfinite(course.ttc_s)]
        parts = np.split(close, np.flatnonzero(np.diff(close) * arrays.step_s > CONFLICT_PET_S) + 1)
        spans = [(int(part[0]), int(part[-1])) for part in parts if part.size]
        if crossed and not spans:
            spans = [(min(crossed.passed), max(crossed.passed))]
        found += [_conflict(arrays, (a, b), course.during(*steps), steps, crossed) for steps in spans]
    return sorted(found, key=lambda one: (one.start_s, one.first_id, one.second_id))


def _first(arrays: SceneArrays, agents: tuple[int, int], span: PairCourse, crossed: Encroachment | None) -> int:
    """The one of two that passes a crossing first, or else is ahead at the least TTC, by the faster one's heading."""
    if crossed:
        return agents[crossed.passed[1] < crossed.passed[0]]
    at = int(np.argmin(span.ttc_s))
    pair = int(span.rows[at]), int(span.other[at])
    fast = max(pair, key=lambda row: float(np.hypot(*arrays.velocity[row])))
    forward = np.array([math.cos(arrays.heading[fast]), math.sin(arrays.heading[fast])])
    return agents[0] if (arrays.position[pair[0]] - arrays.position[pair[1]]) @ forward >= 0.0 else agents[1]


def _conflict(
    arrays: SceneArrays, pair: tuple[int, int], span: PairCourse, steps: tuple[int, int], crossed: Encroachment | None
) -> TrafficConflict:
    """The conflict of a pair over some steps. span: where both are there then; crossed: where their paths cross."""
    first = _first(arrays, pair, span, crossed)
    second, ttc_s = sum(pair) - first, float(span.ttc_s.min(initial=np.inf))
    then = int(span.step[np.argmin(span.ttc_s)]) if math.isfinite(ttc_s) else steps[0]
    met = dict(zip(pair, crossed.passed if crossed and not math.isfinite(ttc_s) else (then, then), strict=True))
    one, other = (int(arrays.row_of[agent, met[agent]]) for agent in (first, second))
    x_m, y_m = arrays.position[[one, other]].mean(axis=0).tolist()
    needed = pair_course(arrays, second, first).during(*steps).drac_mps2
    pet_s = crossed.pet_s if crossed else _following_pet(arrays, first, second, steps)
    angle = math.degrees(float(wrap_angle(arrays.heading[other] - arrays.heading[one])))
    kind = "rear_end" if abs(angle) < REAR_END_DEG else "crossing" if abs(angle) > CROSSING_DEG else "lane_change"
    there = arrays.row_of[list(pair), steps[0] : steps[1] + 1]
    speeds = np.hypot(*arrays.velocity[there[there >= 0]].T)
    return TrafficConflict(
        first_id=arrays.track_ids[first], second_id=arrays.track_ids[second], kind=kind,
        start_s=round(steps[0] * arrays.step_s, 6), end_s=round(steps[1] * arrays.step_s, 6),
        time_s=round(then * arrays.step_s, 6), ttc_s=ttc_s if math.isfinite(ttc_s) else None, pet_s=pet_s,
        drac_mps2=float(needed.max(initial=0.0)), max_s_mps=float(speeds.max()),
        delta_s_mps=float(np.hypot(*(arrays.velocity[one] - arrays.velocity[other]))), angle_deg=angle,
        x_m=x_m, y_m=y_m,
    )  # fmt: skip


def _following_pet(arrays: SceneArrays, first: int, second: int, steps: tuple[int, int]) -> float | None:
    """Least time, s, from when a vehicle's rear bumper leaves a place during some steps until another comes there.

    It is there from its front on, for both lengths along its heading, within half the two widths of its line.
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
    long_m, wide_m = (size[first] + size[second] for size in (arrays.length, arrays.width))
    there = (along <= 0.0) & (along >= -long_m) & (aside < 0.5 * wide_m)
    later = behind - ahead[during][:, None]
    least = float(np.where(there & (later >= 0), later, np.inf).min(initial=np.inf)) * arrays.step_s
    return least if least < CONFLICT_PET_S else None
