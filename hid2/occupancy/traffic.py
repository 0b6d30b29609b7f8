"""Boxes of many agents over time, as dense arrays: what is known, or predicted, of other agents."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hid2.agents import DEFAULT_SIZES, BoxSize, FloatArray, Track
from hid2.measures.arrays import MOVING_EXTENT_M
from hid2.measures.lane_matching import directions_of_motion
from netconvert.geometry import BoolArray as BoolArray
from netconvert.geometry import wrap_angle

#: Time before and after a step between which displacement is velocity, s. No tunable: what a tracker's velocity is.
_HALF_S = 0.2
#: Median difference from velocities by positions at which stated ones are not believed, m/s: no tracker is so bad.
_BELIEVED_MPS = 2.0
#: Arrays of `Traffic`, in their order: by agent and step, and all that have a row for each agent.
_BY_STEP = ("position", "heading", "velocity", "present")
_BY_AGENT = (*_BY_STEP, "length_m", "width_m")


@dataclass(frozen=True, eq=False, slots=True)
class Traffic:
    """Oriented boxes of A agents at T steps; the arrays do not change.

    position (A, T, 2) m, box centres; heading (A, T) rad; velocity (A, T, 2) m/s, from the positions; present (A, T):
    the agent has a state at that step or lies between two of its states (interpolated); length_m, width_m (A,).
    extends: its first agents, to which others were joined; memo: what `path_occupancy` and `shown_on` worked out.
    """

    ids: tuple[str, ...]
    position: FloatArray
    heading: FloatArray
    velocity: FloatArray
    present: BoolArray
    length_m: FloatArray
    width_m: FloatArray
    extends: "Traffic | None" = field(default=None, init=False, repr=False)
    memo: dict[Any, Any] = field(default_factory=dict, init=False, repr=False)

    @classmethod
    def none(cls, steps: int) -> "Traffic":
        """No agent at so many steps."""
        empty = np.zeros((0, steps))
        return cls((), np.zeros((0, steps, 2)), empty, np.zeros((0, steps, 2)), empty > 0.0, np.zeros(0), np.zeros(0))

    @property
    def num_steps(self) -> int:
        """T."""
        return int(self.present.shape[1])

    @property
    def speed(self) -> FloatArray:
        """(A, T) m/s, worked out each time."""
        return np.asarray(np.hypot(self.velocity[..., 0], self.velocity[..., 1]))

    @property
    def boxes(self) -> tuple[FloatArray, FloatArray, BoolArray, FloatArray, FloatArray]:
        """As compiled loops take them: centres, headings, where they are present, lengths and widths."""
        return self.position, self.heading, self.present, self.length_m, self.width_m

    def at(self, step: int) -> "Traffic":
        """The same agents at one step, T = 1."""
        return self.span(slice(step, step + 1))

    def span(self, span: slice) -> "Traffic":
        """The same agents over some steps."""
        part: dict[str, Any] = {name: np.ascontiguousarray(getattr(self, name)[:, span]) for name in _BY_STEP}
        return Traffic(self.ids, length_m=self.length_m, width_m=self.width_m, **part)

    def rows(self, rows: Sequence[int]) -> "Traffic":
        """Some of the agents."""
        index = np.asarray(rows, dtype=np.int64)
        return Traffic(tuple(self.ids[row] for row in rows), **{one: getattr(self, one)[index] for one in _BY_AGENT})

    def extended(self, steps: int, *, step_s: float) -> "Traffic":
        """The same, and beyond the last step so many more at constant velocity, of those that are there then."""
        ahead = step_s * np.arange(1, steps + 1)[None, :, None]
        last = self.num_steps - 1
        on: dict[str, Any] = {name: np.repeat(getattr(self, name)[:, last:], steps, axis=1) for name in _BY_STEP}
        on["position"] = self.position[:, last:] + ahead * self.velocity[:, last:]
        on = {name: np.concatenate([getattr(self, name), then], axis=1) for name, then in on.items()}
        return Traffic(self.ids, length_m=self.length_m, width_m=self.width_m, **on)

    def lasting(self, steps: int, *, step_s: float) -> "Traffic":
        """The same, and before the first and behind the last state of an agent so many more at constant velocity.

        step_s 0: at the place of that state.
        """
        found: dict[str, Any] = {name: getattr(self, name).copy() for name in _BY_STEP}
        first, behind = self.present.argmax(axis=1), self.present[:, ::-1].argmax(axis=1)
        ends = np.clip(np.arange(self.num_steps), first[:, None], self.num_steps - 1 - behind[:, None])
        apart = np.abs(np.arange(self.num_steps) - ends)
        row, more = np.nonzero((apart > 0) & (apart <= steps) & self.present.any(axis=1, keepdims=True))
        end = ends[row, more]
        for name in _BY_STEP:
            found[name][row, more] = getattr(self, name)[row, end]
        found["position"][row, more] += (step_s * (more - end))[:, None] * self.velocity[row, end]
        return replace(self, **found)

    def joined(self, *others: "Traffic") -> "Traffic":
        """Agents of all, self first."""
        every = [traffic for traffic in (self, *others) if traffic.ids]
        if len(every) <= 1:
            return every[0] if every else self
        ids = tuple(track_id for traffic in every for track_id in traffic.ids)
        arrays: dict[str, Any] = {name: np.concatenate([getattr(one, name) for one in every]) for name in _BY_AGENT}
        found = Traffic(ids, **arrays)
        object.__setattr__(found, "extends", every[0])
        return found


def traffic_of(
    tracks: Sequence[Track], num_steps: int, *, step_s: float,
    velocity_by: Callable[[FloatArray, float], FloatArray] | None = None,
) -> Traffic:  # fmt: skip
    """Dense arrays of recorded tracks; gaps inside a track are interpolated, headings the short way round.

    A box that points against its motion over MOVING_EXTENT_M, as trackers turn some round, is turned back: it is the
    same box. What stands they move by a metre or two, to any side.
    velocity_by: velocities (N, 2) m/s of positions (N, 2) m so many s apart; unless given by them or as stated, if that
    is believed, whichever is slower: leaders are taken to be no faster. At both ends of a track trackers smooth
    positions, and show a third less. Followers are taken to be no slower (`Scene.movers`).
    """
    count = len(tracks)
    position = np.zeros((count, num_steps, 2))
    heading = np.zeros((count, num_steps))
    velocity, stated = np.zeros((count, num_steps, 2)), np.zeros((count, num_steps, 2))
    present = np.zeros((count, num_steps), dtype=np.bool_)
    for row, track in enumerate(tracks):
        first, last = int(track.timesteps[0]), int(track.timesteps[-1])
        if last - first + 1 == track.timesteps.size:
            xy, angle, moved = track.position, track.heading, track.velocity
        else:
            steps = np.arange(first, last + 1)
            xy = np.stack([np.interp(steps, track.timesteps, track.position[:, axis]) for axis in (0, 1)], axis=1)
            angle = np.interp(steps, track.timesteps, np.unwrap(track.heading))
            moved = np.stack([np.interp(steps, track.timesteps, track.velocity[:, axis]) for axis in (0, 1)], axis=1)
        position[row, first : last + 1] = xy
        turned = np.cos(angle - directions_of_motion(xy, angle, np.array([0, len(xy)]), step_s=step_s)) < 0.0
        if turned.any():
            for at in np.split(np.arange(turned.size), np.flatnonzero(np.diff(turned)) + 1):
                turned[at] &= np.hypot(*(xy[at[-1]] - xy[at[0]])) > MOVING_EXTENT_M
            angle = np.where(turned, wrap_angle(angle + np.pi), angle)
        heading[row, first : last + 1] = angle
        present[row, first : last + 1] = True
        velocity[row, first : last + 1] = velocity_of(xy, step_s) if velocity_by is None else velocity_by(xy, step_s)
        stated[row, first : last + 1] = moved
    if velocity_by is None and are_believed(np.hypot(*(stated[present] - velocity[present]).T)):
        slower = np.hypot(*np.moveaxis(stated, -1, 0)) < np.hypot(*np.moveaxis(velocity, -1, 0))
        velocity = np.where(slower[..., None], stated, velocity)
    sizes = np.array([covering(track) for track in tracks], dtype=np.float64).reshape(-1, 2)
    ids = tuple(track.track_id for track in tracks)
    return Traffic(ids, position, heading, velocity, present, sizes[:, 0].copy(), sizes[:, 1].copy())


def covering(track: Track) -> BoxSize:
    """Box that covers the labelled one and the one that readers assume, as the format gives them no sizes."""
    assumed = DEFAULT_SIZES[track.object_type]
    return BoxSize(max(track.size.length_m, assumed.length_m), max(track.size.width_m, assumed.width_m))


def are_believed(apart_mps: FloatArray) -> bool:
    """Whether velocities that a recording states, so far apart from those by its positions (N,), are mostly right."""
    return bool(2 * np.count_nonzero(apart_mps < _BELIEVED_MPS) > apart_mps.size)


def velocity_of(xy: FloatArray, step_s: float) -> FloatArray:
    """Velocities (N, 2) m/s of positions (N, 2) m, over up to _HALF_S around each step: trackers jitter."""
    index, half = np.arange(len(xy)), max(1, round(_HALF_S / step_s))
    before, after = np.maximum(index - half, 0), np.minimum(index + half, len(xy) - 1)
    span = np.maximum(after - before, 1) * step_s
    return np.asarray((xy[after] - xy[before]) / span[:, None], dtype=np.float64)
