"""Conflicts by surrogate measures of safety, TTC and PET, as whoever reads the exported positions sees them.

Evaluation.md, SSAM. The driven path knows that a vehicle is about to leave its lane; its positions do not, until it
has.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hid2.agents import IntArray, Track
from hid2.kernels.box_pairs import encroaches
from hid2.kernels.closing_in import closing_vehicles, vehicles_ahead
from hid2.measures.arrays import SceneArrays, is_moving, stack
from hid2.measures.following import leaders
from hid2.measures.lane_matching import FlatLanes, match_lanes
from hid2.measures.post_encroachment import CROSSING_RAD, encroachments
from hid2.reasons import Reason


@dataclass(frozen=True, eq=False, slots=True)
class RecordedVehicles:
    """The recorded vehicles of a scene, which do not brake for generated ones, and the lanes that vehicles drive on."""

    tracks: Sequence[Track]
    lanes: FlatLanes
    num_steps: int
    step_s: float
    arrays: SceneArrays = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Put the tracks into arrays, once."""
        object.__setattr__(self, "arrays", stack(self.tracks, num_steps=self.num_steps, step_s=self.step_s))

    def conflict_with(self, track: Track, *, ttc_s: float, pet_s: float) -> Reason | None:
        """What would come of a generated track: one that comes up behind it at a TTC below ttc_s, a PET below pet_s."""
        if pet_s > 0.0 and self._is_crossed_by(track, pet_s):
            return Reason.PET
        behind = self._closing_in_on(track, ttc_s) if ttc_s > 0.0 else np.zeros(0, dtype=np.int64)
        if behind.size and self.with_generated([track]).followed_conflicts(critical_s=ttc_s, by=behind):
            return Reason.TTC_RECORDED_FOLLOWER
        return None

    def _is_crossed_by(self, track: Track, critical_s: float) -> bool:
        """Whether a track crosses the path of any moving vehicle at a PET below critical_s."""
        if not is_moving(track.position, step_s=self.step_s):
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
            closing_vehicles(
                seen.row_of, seen.position, seen.heading, seen.velocity, seen.moving,
                (seen.length + track.size.length_m) / 2, (seen.width + track.size.width_m) / 2,
                track.timesteps, track.position, track.heading, track.velocity, critical_s,
            )
        )  # fmt: skip

    def with_generated(self, generated: Sequence[Track]) -> "ExportedPositions":
        """As they are exported together."""
        arrays = self.arrays.joined(stack(generated, num_steps=self.num_steps, step_s=self.step_s))
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
        near, closes_in = vehicles_ahead(
            row, seen.row_of, seen.position, seen.heading, seen.velocity, seen.length, seen.width, leaves, first,
            critical_s,
        )  # fmt: skip
        if not closes_in:
            return None
        rows = [row, *np.flatnonzero(near).tolist()]  # itself first
        scene = stack([self.tracks[k] for k in rows], num_steps=self.num_steps, step_s=seen.step_s)
        matches, _ = match_lanes(scene, self.lanes)
        led = leaders(scene, self.lanes, matches)
        own = slice(*scene.first[:2].tolist())
        counts = led.agent[own] > near[:first].sum()
        ttc_s = np.where(counts, led.ttc_s[own], np.inf)
        step = int(np.argmin(ttc_s))
        return rows[int(led.agent[own][step])] if ttc_s[step] < critical_s else None
