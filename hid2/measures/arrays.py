"""Tracks of one scene as flat arrays: the common input of every measure of the evaluation."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from hid2.agents import ROAD_TYPES, VEHICLE_TYPES, FloatArray, IntArray, Track
from netconvert.geometry import BoolArray as BoolArray

#: Extent of its path, m, and time seen, s, above which a vehicle counts as moving.
MOVING_EXTENT_M, MOVING_S = 5.0, 1.0
#: Speed below which an agent does not move at a step, m/s: it has neither a direction of motion nor a curvature.
MOVES_MPS = 1.0
#: Speed below which a vehicle stands, m/s, and least duration of standing, s.
STANDS_MPS, STANDS_FOR_S = 0.3, 0.5
#: Category of tracker fragments (AV2's TRACK_FRAGMENT).
FRAGMENT = 0


def is_generated_id(track_id: str) -> bool:
    """Whether the id is one that the export gives to generated tracks."""
    return track_id.startswith("gen_")


#: Fields of `SceneArrays` by agent, and by row; the others number agents and rows.
_BY_AGENT = ("category", "generated", "vehicle", "fragment", "moving", "length", "width")
_BY_ROW = ("step", "position", "heading", "velocity")


@dataclass(frozen=True, eq=False, slots=True)
class SceneArrays:
    """All tracks of a scene, row by row (N rows, sorted by agent and step; A agents; T steps).

    first (A + 1,): rows first[a]:first[a + 1] belong to agent a. step (N,). agent (N,).
    position (N, 2) m, box centre, city frame; heading (N,) rad; velocity (N, 2) m/s, as stated; length, width (A,) m.
    generated, vehicle, fragment, moving (A,) masks; row_of (A, T): the row of an agent at a step, -1 where absent.
    """

    track_ids: tuple[str, ...]
    object_types: tuple[str, ...]
    category: IntArray
    generated: BoolArray
    vehicle: BoolArray
    fragment: BoolArray
    moving: BoolArray
    length: FloatArray
    width: FloatArray
    first: IntArray
    agent: IntArray
    step: IntArray
    position: FloatArray
    heading: FloatArray
    velocity: FloatArray
    row_of: IntArray
    step_s: float

    @property
    def num_agents(self) -> int:
        """A."""
        return len(self.track_ids)

    @property
    def num_steps(self) -> int:
        """T."""
        return int(self.row_of.shape[1])

    @property
    def moving_vehicles(self) -> BoolArray:
        """(A,) vehicles that move at some time."""
        return np.asarray(self.vehicle & self.moving)

    @property
    def moving_on_roads(self) -> BoolArray:
        """(A,) agents of ROAD_TYPES that move at some time."""
        return np.asarray(self.moving & np.isin(self.object_types, list(ROAD_TYPES)))

    @property
    def clean(self) -> BoolArray:
        """(A,) moving vehicles that are no tracker fragments."""
        return np.asarray(self.moving & self.whole_vehicles)

    @property
    def whole_vehicles(self) -> BoolArray:
        """(A,) vehicles that are no tracker fragments."""
        return np.asarray(self.vehicle & ~self.fragment)

    @property
    def driven(self) -> "SceneArrays":
        """The same with velocities by the positions: those that a tracker states may be others for a second."""
        return replace(self, velocity=self.derivative(self.position))

    @property
    def rows_per_agent(self) -> IntArray:
        """(A,) steps at which each agent is present."""
        return np.diff(self.first)

    @classmethod
    def of(cls, counts: IntArray, step: IntArray, num_steps: int, **known: Any) -> "SceneArrays":  # noqa: ANN401
        """Arrays of agents with so many rows each (A,), at these steps (N,), the other fields as they are known."""
        first = np.concatenate([np.zeros(1, np.int64), np.cumsum(counts)])
        agent = np.repeat(np.arange(len(counts)), counts)
        row_of = np.full((len(counts), num_steps), -1, dtype=np.int64)
        row_of[agent, step] = np.arange(len(step))
        return cls(first=first, agent=agent, step=step, row_of=row_of, **known)

    @classmethod
    def joined(cls, every: Sequence["SceneArrays"]) -> "SceneArrays":
        """The agents of all, of the same scene, in this order: T is the same."""
        parts = {name: np.concatenate([getattr(one, name) for one in every]) for name in (*_BY_AGENT, *_BY_ROW)}
        return cls.of(
            np.concatenate([one.rows_per_agent for one in every]),
            num_steps=every[0].num_steps,
            track_ids=tuple(name for one in every for name in one.track_ids),
            object_types=tuple(kind for one in every for kind in one.object_types),
            step_s=every[0].step_s,
            **parts,
        )

    def agents(self, chosen: Sequence[int]) -> "SceneArrays":
        """Some of the agents, in the order given."""
        rows = np.concatenate([np.arange(self.first[agent], self.first[agent + 1]) for agent in chosen])
        return SceneArrays.of(
            self.rows_per_agent[list(chosen)],
            num_steps=self.num_steps,
            track_ids=tuple(self.track_ids[one] for one in chosen),
            object_types=tuple(self.object_types[one] for one in chosen),
            step_s=self.step_s,
            **{name: getattr(self, name)[list(chosen)] for name in _BY_AGENT},
            **{name: np.ascontiguousarray(getattr(self, name)[rows]) for name in _BY_ROW},
        )

    def derivative(self, values: FloatArray) -> FloatArray:
        """Time derivative of a row-wise quantity (N,) or (N, K), track by track; 0 for tracks of one row."""
        found, time_s = np.zeros(values.shape), self.step_s * self.step
        for a, b in pairwise(self.first.tolist()):
            if b - a > 1:  # one that is not seen for a while has unequal steps
                found[a:b] = np.gradient(values[a:b], time_s[a:b], axis=0)
        return found

    def mean_per_agent(self, values: FloatArray) -> FloatArray:
        """Mean of a row-wise quantity (N,) over each agent's rows: (A,)."""
        return np.asarray(np.add.reduceat(values, self.first[:-1]) / self.rows_per_agent, dtype=np.float64)


def stack(
    tracks: Sequence[Track],
    *,
    num_steps: int | None = None,
    step_s: float,
    is_generated: Callable[[str], bool] = is_generated_id,
) -> SceneArrays:
    """Put the tracks of a scene into flat arrays; a scene without tracks gives empty ones.

    `is_generated` tells generated from recorded tracks by their id.
    """
    tracks = [track for track in tracks if len(track.timesteps)]
    counts = np.array([len(track.timesteps) for track in tracks], dtype=np.int64)
    # joined with nothing, so that no tracks are no special case
    step = np.concatenate([np.zeros(0, np.int64), *(track.timesteps for track in tracks)]).astype(np.int64)
    position = np.concatenate([np.zeros((0, 2)), *(track.position for track in tracks)])
    low, high = (ends.reduceat(position, np.cumsum(counts) - counts, axis=0) for ends in (np.minimum, np.maximum))
    category = np.array([track.category for track in tracks], dtype=np.int64)
    return SceneArrays.of(
        counts,
        step,
        max(int(step.max(initial=-1)) + 1, num_steps or 0),
        track_ids=tuple(track.track_id for track in tracks),
        object_types=tuple(track.object_type for track in tracks),
        category=category,
        generated=np.array([is_generated(track.track_id) for track in tracks], dtype=bool),
        vehicle=np.array([track.object_type in VEHICLE_TYPES for track in tracks], dtype=bool),
        fragment=category == FRAGMENT,
        moving=(np.hypot(*(high - low).T) > MOVING_EXTENT_M) & (counts > round(MOVING_S / step_s)),
        length=np.array([track.size.length_m for track in tracks], dtype=np.float64),
        width=np.array([track.size.width_m for track in tracks], dtype=np.float64),
        position=position,
        heading=np.concatenate([np.zeros(0), *(track.heading for track in tracks)]),
        velocity=np.concatenate([np.zeros((0, 2)), *(track.velocity for track in tracks)]),
        step_s=step_s,
    )
