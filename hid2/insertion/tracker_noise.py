"""What a tracker adds to exported states (`export.noise = tracker`), as recorded vehicles of the same scene have it.

Argoverse 2 has smoothed the positions of its trackers up to the ends of tracks, where they stay back: vehicles begin
and end at half their speed. What trackers state follows motion late: headings trail in turns, speeds while braking.
Beside that each inserted vehicle has the errors of a recorded one, around smooth motion that is late by as much.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Literal

import numpy as np

from hid2.agents import AV_ID, VEHICLE_TYPES, FloatArray, Track
from hid2.insertion.finalise import states_of_inserted
from hid2.judge.findings import NOISE_BOUNDS, Bounds
from hid2.judge.states import of_boxes, of_end, of_road
from hid2.measures.arrays import FRAGMENT
from hid2.occupancy.agent_states import AgentStates
from hid2.scene import Scene
from netconvert.geometry import wrap_angle

#: Window, s, and degree of Argoverse 2's own Savitzky-Golay smoothing. No tunables but found: with these the speed of
#: positions over the stated one is that of 28 recorded tracks at each of the first 13 steps, within .02.
_FILTER_S, _FILTER_DEGREE = 1.9, 2
#: Speed of positions over the stated one at the first step (median of tracks) below which positions are smoothed so.
_STAYS_BACK = 0.8
#: Window, s, and degree of the polynomial that errors are measured around. No tunables: it follows drivers alone.
_WINDOW_S, _DEGREE = 3.1, 4
#: Window of the fit to headings less the late course, s: within it paths sway in the lane, headings hardly do.
_HEADING_S = 5.1
#: Delays of stated speeds and headings behind positions, and of velocity directions behind headings, s. No tunables but
#: found: with these the errors of 38 recorded tracks are least (any scene left out: .20 to .30, .30 to .55, .10).
_SPEED_LATE_S, _HEADING_LATE_S, _VELOCITY_LATE_S = 0.25, 0.5, 0.1
#: Speed below which a vehicle tells no errors, and has smaller ones, down to none at a standstill, m/s.
_MOVES_MPS = 2.0
#: Shares of its errors tried for a vehicle, in turn: with all errors it may touch what it passes closely.
_SHARES = (1.0, 0.5, 0.25, 0.0)
_STREAM = 83  # random stream: a name


@dataclass(frozen=True, eq=False, slots=True)
class TrackerErrors:
    """Those of a recording. is_smoothed: its positions are, up to the ends of tracks.

    of_vehicles: of each recorded one that moves, (4, N): of place along the course, m, speed, m/s, heading, and the
    direction of the velocity beside that, both as what is driven to the side by it, m/s: slow vehicles turn by more.
    """

    is_smoothed: bool
    of_vehicles: tuple[FloatArray, ...]

    def drawn(self, rng: np.random.Generator, count: int) -> FloatArray:
        """(4, count) of one vehicle from a step on, of either sign, forwards; none where no vehicle tells any."""
        if not self.of_vehicles:
            return np.zeros((4, count))
        steps = np.array([errors.shape[1] for errors in self.of_vehicles])
        errors = self.of_vehicles[int(rng.choice(steps.size, p=steps / steps.sum()))]
        joined = errors - np.linspace(-0.5, 0.5, errors.shape[1]) * (errors[:, -1:] - errors[:, :1])
        first, sign = int(rng.integers(errors.shape[1])), rng.choice((-1.0, 1.0))
        return np.asarray(sign * np.take(joined, np.arange(first, first + count), axis=1, mode="wrap"))


def tracker_errors(tracks: Sequence[Track], *, step_s: float) -> TrackerErrors:
    """Of recorded tracks, the recording vehicle's and fragments left out; it was not tracked, and those were lost."""
    begins: list[float] = []
    found: list[FloatArray] = []
    for track in tracks:
        steps, stated = track.timesteps, np.hypot(*track.velocity.T)
        if track.object_type not in VEHICLE_TYPES or track.category == FRAGMENT or track.track_id == AV_ID:
            continue
        if steps.size != steps[-1] - steps[0] + 1:  # it was lost in between
            continue
        if steps.size > 1 and stated[:2].min() > _MOVES_MPS:
            begins.append(float(np.hypot(*(track.position[1] - track.position[0]))) / (step_s * stated[:2].mean()))
        errors = _errors_of(track, step_s)
        if errors is not None:
            found.append(errors)
    return TrackerErrors(bool(begins) and float(np.median(begins)) < _STAYS_BACK, tuple(found))


def _errors_of(track: Track, step_s: float) -> FloatArray | None:
    """(4, N) of a track while it moves, its ends and boxes that are turned round left out; None of a short one."""
    end, most = _odd(_FILTER_S / step_s) // 2 + 1, _odd(_WINDOW_S / step_s)
    inside = slice(end, track.timesteps.size - end)
    position, heading = track.position[inside], np.unwrap(track.heading[inside])
    window = min(most, _odd(len(position) - 1))
    if window < end:
        return None
    smooth = _fitted(position, window)
    velocity = np.gradient(smooth, step_s, axis=0)
    speed, course = np.hypot(*velocity.T), np.unwrap(np.arctan2(*velocity.T[::-1]))
    off = wrap_angle(heading - _late(course, _HEADING_LATE_S, step_s))
    slip = wrap_angle(np.arctan2(*track.velocity[inside].T[::-1]) - _late(heading, _VELOCITY_LATE_S, step_s))
    slow_window = min(_odd(_HEADING_S / step_s), _odd(len(off) - 1))
    turned = heading - _fitted(heading, window) + _fitted(np.unwrap(off), slow_window, _FILTER_DEGREE)
    tells = np.flatnonzero(
        (speed > _MOVES_MPS) & (np.maximum(np.abs(turned), np.abs(slip)) <= NOISE_BOUNDS.heading_rad)
    )
    longest = max(np.split(tells, np.flatnonzero(np.diff(tells) > 1) + 1), key=len)
    if longest.size < window:
        return None
    return np.stack([
        ((position - smooth) * velocity).sum(axis=1) / np.maximum(speed, _MOVES_MPS),
        np.hypot(*track.velocity[inside].T) - _late(speed, _SPEED_LATE_S, step_s), turned * speed, slip * speed,
    ])[:, longest]  # fmt: skip


def _late(values: FloatArray, by_s: float, step_s: float) -> FloatArray:
    """Values (N,) as they were so many s before each step; before the first step they do not change."""
    return np.asarray(np.interp(np.arange(len(values)) - by_s / step_s, np.arange(len(values)), values))


def _fitted(
    values: FloatArray, window: int, degree: int = _DEGREE, *, ends: Literal["interp", "nearest"] = "interp"
) -> FloatArray:
    """Values (N, ...) fitted by a polynomial around each step; ends: as scipy has it."""
    from scipy.signal import savgol_filter  # its import takes longer than a scene without noise

    return np.asarray(savgol_filter(values, window, degree, axis=0, mode=ends), dtype=np.float64)


def _odd(steps: float) -> int:
    """The nearest odd number."""
    return 2 * round(0.5 * (steps - 1.0)) + 1


def with_noise(
    scene: Scene, tracks: Sequence[Track], courses: Sequence[FloatArray], seed: Sequence[int]
) -> list[Track]:
    """Inserted tracks as the scene's tracker would have them; boxes, road and the scene's end are as safe as before.

    courses: of each, (N,) rad: the direction of its path, without the swaying in the lane, which trackers do not see.
    Each has its errors as far as they leave it clear of all others, of those before it with their errors.
    """
    errors = tracker_errors(scene.tracks, step_s=scene.step_s)
    clean = [states_of_inserted(scene, track) for track in tracks]
    found: list[Track] = []
    so_far = scene.states
    for number, track in enumerate(tracks):
        rng = np.random.default_rng([*seed, _STREAM, number])
        full = _noisy(track, courses[number], errors, rng, step_s=scene.step_s)
        others = so_far.joined(*clean[number + 1 :])
        for share in _SHARES:
            noisy = _between(track, full, share)
            states = states_of_inserted(scene, noisy)
            if share == 0.0 or _is_clear(scene, others.joined(states), track):
                break
        found.append(noisy)
        so_far = so_far.joined(states)
    return found


def _is_clear(scene: Scene, states: AgentStates, track: Track) -> bool:
    """Whether the judge finds nothing on the last agent's box, on the road below it, and at its end and others'."""
    row, bounds = states.arrays.num_agents - 1, Bounds(scene.config.limits, scene.config.conflict)
    inserted = np.flatnonzero(states.arrays.generated[:row]).tolist()
    found = chain(
        of_boxes(states, row, np.arange(row), spare_m=0.0), of_end(states, row, np.arange(row), bounds),
        of_road(states, row, track.size, bounds),
        (one for other in inserted for one in of_end(states, other, np.array([row]), bounds)),
    )  # fmt: skip
    return next(found, None) is None


def _noisy(
    track: Track, course: FloatArray, errors: TrackerErrors, rng: np.random.Generator, *, step_s: float
) -> Track:
    """A track with the errors of a tracker."""
    speed, window = np.hypot(*track.velocity.T), _odd(_FILTER_S / step_s)
    along, faster, *aside = np.minimum(speed / _MOVES_MPS, 1.0) * errors.drawn(rng, speed.size)
    turned, slips = aside / np.maximum(speed, _MOVES_MPS)
    position = track.position
    if errors.is_smoothed and speed.size >= window:
        position = _fitted(position, window, _FILTER_DEGREE, ends="nearest")
    heading = _late(np.unwrap(course), _HEADING_LATE_S, step_s) + turned
    moves_to = _late(heading, _VELOCITY_LATE_S, step_s) + slips
    return replace(
        track, position=position + along[:, None] * np.stack([np.cos(track.heading), np.sin(track.heading)], axis=1),
        heading=wrap_angle(heading), velocity=np.maximum(_late(speed, _SPEED_LATE_S, step_s) + faster, 0.0)[:, None]
        * np.stack([np.cos(moves_to), np.sin(moves_to)], axis=1),
    )  # fmt: skip


def _between(clean: Track, noisy: Track, share: float) -> Track:
    """A track with a share of its errors, each within `NOISE_BOUNDS`."""
    place, turned, velocity = noisy.position - clean.position, wrap_angle(noisy.heading - clean.heading), noisy.velocity
    most_m = NOISE_BOUNDS.place_of(np.hypot(*clean.velocity.T))
    place = place * _at_most(share, np.hypot(*place.T), most_m)[:, None]
    turned = turned * _at_most(share, np.abs(turned), NOISE_BOUNDS.heading_rad)
    off = velocity - clean.velocity
    off = off * _at_most(share, np.hypot(*off.T), NOISE_BOUNDS.velocity_mps)[:, None]
    return replace(
        clean, position=clean.position + place, heading=wrap_angle(clean.heading + turned),
        velocity=clean.velocity + off,
    )  # fmt: skip


def _at_most(share: float, size: FloatArray, most: FloatArray | float) -> FloatArray:
    """The share of errors of some size that is no larger than the most."""
    return np.minimum(share, most / np.maximum(size, 1e-9))
