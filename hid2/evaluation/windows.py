"""Windows of 4 s of driving as the coefficients of fits: what critics, distributions and the calibration look at.

A polynomial over 41 steps keeps the driving and averages out the noise of a tracker; single steps do not. The
first and the last second of a track are left out, and so are windows in which the lane is changed: manoeuvres are
compared by their own table.
"""

import hashlib
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from hid2.agents import FloatArray, IntArray
from hid2.measures.arrays import BoolArray, SceneArrays
from hid2.measures.driven_lanes import LaneView
from hid2.measures.following import LaneLeaders

#: Length of a window, time left out at both ends of a track, and time between two windows' middles, s.
WINDOW_S, TRIMMED_S, STRIDE_S = 4.0, 1.0, 0.5
#: Mean speed up to which a window is one of a standing vehicle, m/s: noise, no driving.
MIN_SPEED_MPS = 1.0
#: Number of random splits of the recorded tracks into halves, for floors and the negative control.
SPLITS = 16
# What a window is, the same for recorded and generated vehicles and for every configuration: no tunables.
_JUMP_M = 1.5  # jump of the lateral offset between two steps from which the lane is changed, m
TURNS_RAD = 0.35  # range of the path's direction above which a window turns, rad
#: Least share of a window with the same leader, and bound of the gap to it at the middle, m. No tunables.
_LED_SHARE, _LED_M = 0.8, 60.0

#: A window: the recorded scene that it is of, the number of its vehicle there, whether that is generated, whether
#: people labelled the recording (else a tracker), and as SPLITS bits the halves of the recorded tracks that it is in.
#: Speed, acceleration and jerk along the path are those of a cubic at the middle; the place in the lane, left positive,
#: its drift and bend of a parabola; the yaw rate and its change of another one; gap to and closing speed on the leader
#: of a line, the gap inf without a leader. turning, led: whether the vehicle turns, and has a leader. drawn: by which
#: those are chosen that critics look at, where there are many.
WINDOW = np.dtype([
    ("scene", "O"), ("agent", "i8"), ("generated", "?"), ("labelled", "?"), ("halves", "i8"),
    ("speed_mps", "f8"), ("accel_mps2", "f8"), ("jerk_mps3", "f8"),
    ("offset_m", "f8"), ("drift_mps", "f8"), ("bend_mps2", "f8"), ("yaw_radps", "f8"), ("yaw_bend_radps2", "f8"),
    ("gap_m", "f8"), ("closing_mps", "f8"), ("turning", "?"), ("led", "?"), ("drawn", "f8"),
])  # fmt: skip
#: Any number of them (M,): columns by name, rows by mask.
Windows: TypeAlias = npt.NDArray[np.void]


def half_numbers(scene: str, track_ids: Sequence[str]) -> IntArray:
    """(A,) in which half of each split tracks fall, as SPLITS bits: by a hash of the name, the same in every run."""
    names = (f"{scene}/{track_id}".encode() for track_id in track_ids)
    digests = b"".join(hashlib.blake2b(name, digest_size=SPLITS // 8).digest() for name in names)
    bits = np.unpackbits(np.frombuffer(digests, dtype=np.uint8)).reshape(-1, SPLITS)
    return np.asarray(bits @ (1 << np.arange(SPLITS)), dtype=np.int64)


def compared(arrays: SceneArrays) -> BoolArray:
    """(A,) vehicles that are looked at: all that move, but for recorded fragments."""
    return np.asarray(arrays.moving_vehicles & (arrays.generated | ~arrays.fragment))


def lateral_accel_mps2(found: Windows) -> FloatArray:
    """(M,) m/s2 at the middles, left positive: speed times yaw rate."""
    return np.asarray(found["speed_mps"] * found["yaw_radps"], dtype=np.float64)


def windows(view: LaneView, led: LaneLeaders, *, scene: str, labelled: bool) -> Windows:
    """Windows of the vehicles `compared`, in the order of agents and time. led: leaders of the same rows."""
    arrays = view.arrays
    size = round(WINDOW_S / arrays.step_s) + 1
    trimmed, stride = round(TRIMMED_S / arrays.step_s), max(1, round(STRIDE_S / arrays.step_s))
    time = np.asarray(arrays.step_s * (np.arange(size) - size // 2), dtype=np.float64)
    found = [np.zeros(0, dtype=WINDOW)]
    for agent in np.flatnonzero(compared(arrays)).tolist():
        first, last = int(arrays.first[agent]) + trimmed, int(arrays.first[agent + 1]) - trimmed
        rows = np.arange(first, last - size + 1, stride)[:, None] + np.arange(size)
        rows = rows[arrays.step[rows[:, -1]] - arrays.step[rows[:, 0]] == size - 1]  # none across a gap
        if len(rows):
            found.append(_of_track(view, led, rows, time))
    every = np.concatenate(found)
    every["scene"], every["labelled"] = scene, labelled
    every["generated"] = arrays.generated[every["agent"]]
    every["halves"] = half_numbers(scene, arrays.track_ids)[every["agent"]]
    return every


def polynomial_fit(time: FloatArray, degree: int) -> FloatArray:
    """(degree + 1, T) what makes of values at the times of a window the coefficients of a polynomial, lowest first."""
    return np.asarray(np.linalg.pinv(np.vander(time, degree + 1, increasing=True)), dtype=np.float64)


def _of_track(view: LaneView, led: LaneLeaders, rows: IntArray, time: FloatArray) -> Windows:
    """Windows of one vehicle; rows (M, T): those of each."""
    arrays, matches, parabola, cubic = view.arrays, view.matches, polynomial_fit(time, 2), polynomial_fit(time, 3)
    middle, position = len(time) // 2, arrays.position[rows]
    fitted = np.einsum("kt,mtc->mkc", cubic, position)
    slope = np.einsum("tk,mkc->mtc", np.vander(time, 3, increasing=True) * np.array([1.0, 2.0, 3.0]), fitted[:, 1:])
    along = slope / np.maximum(np.hypot(slope[..., 0], slope[..., 1]), 1e-9)[..., None]
    # a step along the fitted direction: the noise of both its ends goes out of the sum
    step = np.einsum("mtc,mtc->mt", np.diff(position, axis=1), 0.5 * (along[:, 1:] + along[:, :-1]))
    s = np.concatenate([np.zeros((len(rows), 1)), np.cumsum(step, axis=1)], axis=1)
    lane, d = matches.lane[rows], matches.d[rows]
    direction, leader = np.unwrap(matches.direction[rows], axis=1), led.agent[rows]
    same = (leader == leader[:, middle : middle + 1]) & (leader >= 0)
    line = _weighted_lines(np.where(same & np.isfinite(led.gap_m[rows]), led.gap_m[rows], 0.0), same, time)
    is_led = (same.mean(axis=1) >= _LED_SHARE) & (line[:, 0] < _LED_M)
    turns = (view.lanes.turn[np.maximum(lane, 0)] != 0).any(axis=1) | (np.ptp(direction, axis=1) > TURNS_RAD)
    found = np.zeros(len(rows), dtype=WINDOW)
    found["agent"] = arrays.agent[rows[:, middle]]
    _, found["speed_mps"], half_accel, sixth_jerk = (s @ cubic.T).T
    found["accel_mps2"], found["jerk_mps3"] = 2.0 * half_accel, 6.0 * sixth_jerk
    found["offset_m"], found["drift_mps"], found["bend_mps2"] = (d @ parabola.T).T
    _, found["yaw_radps"], found["yaw_bend_radps2"] = (direction @ parabola.T).T
    found["gap_m"], found["closing_mps"] = np.where(is_led, line[:, 0], np.inf), np.where(is_led, -line[:, 1], 0.0)
    found["turning"], found["led"] = turns, is_led
    clean = (lane >= 0).all(axis=1) & (np.abs(np.diff(d, axis=1)).max(axis=1) < _JUMP_M)
    kept: Windows = found[clean & (s[:, -1] > MIN_SPEED_MPS * (time[-1] - time[0]))]
    return kept


def _weighted_lines(values: FloatArray, known: BoolArray, time: FloatArray) -> FloatArray:
    """(M, 2) value at the middle and slope of a line through the known values (M, T); zeros where there are none."""
    weight = known.astype(np.float64)
    total = np.maximum(weight.sum(axis=1), 1.0)
    centre, mean = (weight @ time) / total, (weight * values).sum(axis=1) / total
    offset = time - centre[:, None]
    spread = (weight * offset * offset).sum(axis=1)
    slope = (weight * offset * values).sum(axis=1) / np.where(spread > 0, spread, 1.0)
    return np.column_stack([mean - slope * centre, slope])
