"""Conflicts by surrogate measures of safety, TTC and PET, as whoever reads the exported positions sees them.

Evaluation.md, SSAM. The driven path knows that a vehicle is about to leave its lane; its positions do not, until it
has.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numba import njit

from hid2.agents import IntArray, Track
from hid2.evaluation.safety import CROSSING_RAD, encroachments
from hid2.measures.arrays import SceneArrays, is_moving, stack
from hid2.measures.box_pairs import encroaches
from hid2.measures.following import leaders
from hid2.measures.lane_matching import FlatLanes, match_lanes

_SLACK_M = 0.5
_ONCOMING = -0.2  # cosine of the angle between two that do not follow each other, not even round a corner
_SHARPEST_M, _LATERAL_MPS2 = 6.0, 6.0  # radius of the bend that may lie ahead at any speed, and by the speed
_NEAR_M = 50.0  # who is farther away all the time leads nobody at a critical TTC


@dataclass(frozen=True, eq=False, slots=True)
class RecordedVehicles:
    """The recorded vehicles of a scene, which do not brake for generated ones, and the lanes that vehicles drive on."""

    tracks: Sequence[Track]
    lanes: FlatLanes
    num_steps: int
    arrays: SceneArrays = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Put the tracks into arrays, once."""
        object.__setattr__(self, "arrays", stack(self.tracks, num_steps=self.num_steps))

    def conflict_with(self, track: Track, *, ttc_s: float, pet_s: float) -> str | None:
        """What would come of a generated track: one that comes up behind it at a TTC below ttc_s, a PET below pet_s."""
        if pet_s > 0.0 and self._is_crossed_by(track, pet_s):
            return "pet"
        behind = self._closing_in_on(track, ttc_s) if ttc_s > 0.0 else np.zeros(0, dtype=np.int64)
        if behind.size and self.with_generated([track]).followed_conflicts(critical_s=ttc_s, by=behind):
            return "ttc_of_recorded"
        return None

    def _is_crossed_by(self, track: Track, critical_s: float) -> bool:
        """Whether a track crosses the path of any moving vehicle at a PET below critical_s."""
        if not is_moving(track.position):
            return False
        seen = self.arrays
        return bool(
            encroaches(
                np.flatnonzero(seen.vehicle & seen.moving), seen.position, seen.heading, seen.length, seen.width,
                seen.first, seen.step, track.timesteps, track.position, track.heading, *track.size,
                math.ceil(critical_s / seen.step_s - 1e-9), CROSSING_RAD,
            )
        )  # fmt: skip

    def _closing_in_on(self, track: Track, critical_s: float) -> IntArray:
        """Rows of those who may follow a track at a TTC below critical_s: whom it pays to match to lanes."""
        seen = self.arrays
        return np.flatnonzero(
            _followers(
                seen.row_of, seen.position, seen.heading, seen.velocity, seen.moving,
                (seen.length + track.size.length_m) / 2, (seen.width + track.size.width_m) / 2,
                track.timesteps, track.position, track.heading, track.velocity, critical_s,
            )
        )  # fmt: skip

    def with_generated(self, generated: Sequence[Track]) -> "ExportedPositions":
        """As they are exported together."""
        arrays = self.arrays.joined(stack(generated, num_steps=self.num_steps))
        return ExportedPositions(self.tracks, generated, self.lanes, self.num_steps, arrays)


@dataclass(frozen=True, eq=False, slots=True)
class ExportedPositions:
    """Recorded vehicles and generated ones as they are exported, on the lanes that vehicles drive on.

    Lanes are matched only around vehicles that close in on anybody ahead.
    """

    recorded: Sequence[Track]
    generated: Sequence[Track]
    lanes: FlatLanes
    num_steps: int
    arrays: SceneArrays = field(repr=False)
    tracks: list[Track] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """All tracks, the recorded ones first, as in `arrays`."""
        object.__setattr__(self, "tracks", [*self.recorded, *self.generated])

    def following_conflicts(self, leaving: Sequence[bool], *, critical_s: float) -> list[tuple[int, int | None]]:
        """Rows of `generated` whose TTC to the leader on the lane path is below critical_s at some step, in order.

        Each with the row of that leader, None for a recorded one. leaving: whether a vehicle leaves its lane for
        another one; those that do not are known by where they drive to.
        """
        first = len(self.recorded)
        pairs = [
            (row - first, self._leader(row, 0, leaves=leaves, critical_s=critical_s))
            for row, leaves in enumerate(leaving, start=first)
        ]
        return [(row, self._generated(leader)) for row, leader in pairs if leader is not None]

    def followed_conflicts(self, *, critical_s: float, by: IntArray | None = None) -> list[int]:
        """Rows of `generated` that a recorded vehicle, which will not brake, runs up on: TTC below critical_s.

        by: rows of `recorded` that are looked at, all that move unless told.
        """
        first = len(self.recorded)
        rows = np.flatnonzero(self.arrays.moving[:first]) if by is None else by
        leaders_of = (self._leader(row, first, leaves=False, critical_s=critical_s) for row in rows.tolist())
        return sorted({leader - first for leader in leaders_of if leader is not None})

    def crossing_conflicts(self, *, critical_s: float) -> list[tuple[int, int | None]]:
        """Rows of `generated` that cross somebody's path at a PET below critical_s, in order.

        Each with the row of the other one, the earlier row second; None for a recorded one.
        """
        first = len(self.recorded)
        found = encroachments(self.arrays, since=first, cap_s=critical_s)
        pairs = [(c.second - first, self._generated(c.first)) for c in found if c.pet_s < critical_s]
        return sorted(pairs, key=lambda pair: pair[0])

    def _generated(self, row: int) -> int | None:
        """Row of `generated` of a row of all, None of a recorded one."""
        return row - len(self.recorded) if row >= len(self.recorded) else None

    def _leader(self, row: int, first: int, *, leaves: bool, critical_s: float) -> int | None:
        """Row of the leader, one of `first` and later, at the smallest TTC of a row, if that is below critical_s."""
        seen = self.arrays
        near, closes_in = _around(
            row, seen.row_of, seen.position, seen.heading, seen.velocity, seen.length, seen.width, leaves, first,
            critical_s,
        )  # fmt: skip
        if not closes_in:
            return None
        rows = [row, *np.flatnonzero(near).tolist()]  # itself first
        scene = stack([self.tracks[k] for k in rows], num_steps=self.num_steps)
        matches, _ = match_lanes(scene, self.lanes)
        led = leaders(scene, self.lanes, matches)
        own = slice(*scene.first[:2].tolist())
        counts = led.agent[own] > near[:first].sum()
        ttc_s = np.where(counts, led.ttc_s[own], np.inf)
        step = int(np.argmin(ttc_s))
        return rows[int(led.agent[own][step])] if ttc_s[step] < critical_s else None


@njit(cache=True)
def _aside(own, t, place, row_of, position, heading):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
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


@njit(cache=True)
def _closes_in(own, t, i, place, motion, apart, beside, row_of, position, heading, speed, leaves, critical):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Whether an agent closes in, fast enough, on somebody ahead of it who may be on its way.

    apart, beside: centre to centre where their boxes touch end to end and side to side, m.
    """
    dx, dy = place[0] - position[i, 0], place[1] - position[i, 1]
    closing = speed - np.hypot(motion[0], motion[1])
    if closing <= 0.0 or np.hypot(dx, dy) - apart > critical * closing + _SLACK_M:
        return False
    beside = beside + _SLACK_M
    if not leaves:
        return abs(_aside(own, t, place, row_of, position, heading)) < beside
    cosine, sine = np.cos(heading[i]), np.sin(heading[i])
    ahead = dx * cosine + dy * sine
    radius = max(_SHARPEST_M, speed * speed / _LATERAL_MPS2)
    return abs(dy * cosine - dx * sine) < beside + ahead * ahead / (2 * radius)


@njit(cache=True)
def _around(own, row_of, position, heading, velocity, length, width, leaves, first, critical):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
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


@njit(cache=True)
def _followers(row_of, position, heading, velocity, moving, apart, beside, steps, place, direction, motion, critical):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
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
