"""Windows of 4 s of driving as the coefficients of fits: what critics, distributions and the calibration look at.

A polynomial over 41 steps keeps the driving and averages out the noise of a tracker; single steps do not. The
first and the last second of a track are left out, and so are windows in which the lane is changed: manoeuvres are
compared by their own table.
"""

from typing import Any, NamedTuple

import numpy as np

from hid2.agents import FloatArray, IntArray
from hid2.evaluation.safety import Safety
from hid2.measures.arrays import BoolArray, SceneArrays

#: Length of a window, what is left out at both ends of a track, and the distance of two windows' middles, s.
WINDOW_S, TRIMMED_S, STRIDE_S = 4.0, 1.0, 0.5
#: Windows slower than this on average are those of standing vehicles: noise, no driving.
MIN_SPEED_MPS = 1.0
# No tunables: what a window is, the same for recorded and generated vehicles and for every configuration.
#: Between two steps the lateral offset jumps by more than this where the lane is changed, m.
_JUMP_M = 1.5
#: A leader is the same one over this share of the window and nearer than this at its middle, m.
_LED_SHARE, _LED_M = 0.8, 60.0
#: A window turns where the path's direction changes by more than this, rad.
_TURNS_RAD = 0.35


class Windows(NamedTuple):
    """Windows (M,) of one scene. Fits are in seconds from the middle of the window, lowest power first.

    agent: number of the track. s_cubic (M, 3), s_quartic (M, 4): s(t) - s(0), m; the
    cubic's are speed, half the acceleration, a sixth of the jerk. d_parabola (M, 3), d_cubic (M, 4): lateral offset
    from the lane's middle, m, left positive. yaw (M, 2): rate, rad/s, and half its change. gap_m, closing_mps: to the
    leader, by a line; gap_m inf without one. turning, led (M,); clean: on a lane all the while and changing none.
    """

    agent: IntArray
    s_cubic: FloatArray
    s_quartic: FloatArray
    d_parabola: FloatArray
    d_cubic: FloatArray
    yaw: FloatArray
    gap_m: FloatArray
    closing_mps: FloatArray
    turning: BoolArray
    led: BoolArray

    @property
    def speed_mps(self) -> FloatArray:
        """(M,) at the middle."""
        return self.s_cubic[:, 0]

    @property
    def accel_mps2(self) -> FloatArray:
        """(M,) at the middle."""
        return 2.0 * self.s_cubic[:, 1]

    @property
    def jerk_mps3(self) -> FloatArray:
        """(M,)."""
        return 6.0 * self.s_cubic[:, 2]

    @property
    def lateral_accel_mps2(self) -> FloatArray:
        """(M,) at the middle: speed times yaw rate."""
        return self.s_cubic[:, 0] * self.yaw[:, 0]

    def rows(self, chosen: BoolArray | IntArray) -> "Windows":
        """Some of the windows."""
        some: list[Any] = [values[chosen] for values in self]
        return Windows(*some)


def windows(arrays: SceneArrays, safe: Safety, members: BoolArray) -> Windows:
    """Windows of the agents in `members` (A,), in the order of agents and time."""
    size = round(WINDOW_S / arrays.step_s) + 1
    trimmed, stride = round(TRIMMED_S / arrays.step_s), max(1, round(STRIDE_S / arrays.step_s))
    time = np.asarray(arrays.step_s * (np.arange(size) - size // 2), dtype=np.float64)
    fits: dict[int, FloatArray] = {
        degree: np.asarray(np.linalg.pinv(np.vander(time, degree + 1, increasing=True)), dtype=np.float64)
        for degree in (2, 3, 4)
    }
    each = [np.zeros((0, size), dtype=np.int64)]  # joined with nothing, so that no windows are no special case
    for agent in np.flatnonzero(members).tolist():
        first, last = int(arrays.first[agent]) + trimmed, int(arrays.first[agent + 1]) - trimmed
        rows = np.arange(first, last - size + 1, stride)[:, None] + np.arange(size)
        each.append(rows[arrays.step[rows[:, -1]] - arrays.step[rows[:, 0]] == size - 1])  # none across a gap
    found = (_of_track(arrays, safe, rows, time, fits) for k, rows in enumerate(each) if len(rows) or not k)
    return Windows(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


def _of_track(
    arrays: SceneArrays, safe: Safety, rows: IntArray, time: FloatArray, fits: dict[int, FloatArray]
) -> Windows:
    middle = len(time) // 2
    position = arrays.position[rows]
    fitted = np.einsum("kt,mtc->mkc", fits[3], position)
    slope = np.einsum("tk,mkc->mtc", np.vander(time, 3, increasing=True) * np.array([1.0, 2.0, 3.0]), fitted[:, 1:])
    pace = np.hypot(slope[..., 0], slope[..., 1])
    along = slope / np.maximum(pace, 1e-9)[..., None]
    # a step along the fitted direction: the noise of both its ends goes out of the sum
    step = np.einsum("mtc,mtc->mt", np.diff(position, axis=1), 0.5 * (along[:, 1:] + along[:, :-1]))
    s = np.concatenate([np.zeros((len(rows), 1)), np.cumsum(step, axis=1)], axis=1)
    lane, d = safe.matches.lane[rows], safe.matches.d[rows]
    direction = np.unwrap(safe.matches.direction[rows], axis=1)
    yaw = direction @ fits[2].T
    leader = safe.leaders.agent[rows]
    same = (leader == leader[:, middle : middle + 1]) & (leader >= 0)
    gap = np.where(same, np.where(np.isfinite(safe.leaders.gap_m[rows]), safe.leaders.gap_m[rows], 0.0), 0.0)
    line = _weighted_lines(gap, same, time)
    led = (same.mean(axis=1) >= _LED_SHARE) & (line[:, 0] < _LED_M)
    clean = (lane >= 0).all(axis=1) & (np.abs(np.diff(d, axis=1)).max(axis=1) < _JUMP_M)
    moves = s[:, -1] > MIN_SPEED_MPS * (time[-1] - time[0])
    turns = (safe.lanes.turn[np.maximum(lane, 0)] != 0).any(axis=1) | (np.ptp(direction, axis=1) > _TURNS_RAD)
    found = Windows(
        agent=arrays.agent[rows[:, middle]],
        s_cubic=(s @ fits[3].T)[:, 1:],
        s_quartic=(s @ fits[4].T)[:, 1:],
        d_parabola=d @ fits[2].T,
        d_cubic=d @ fits[3].T,
        yaw=yaw[:, 1:],
        gap_m=np.where(led, line[:, 0], np.inf),
        closing_mps=np.where(led, -line[:, 1], 0.0),
        turning=turns,
        led=led,
    )
    return found.rows(clean & moves)


def _weighted_lines(values: FloatArray, known: BoolArray, time: FloatArray) -> FloatArray:
    """(M, 2) value at the middle and slope of a line through the known values (M, T); zeros where there are none."""
    weight = known.astype(np.float64)
    total = np.maximum(weight.sum(axis=1), 1.0)
    centre = (weight @ time) / total
    mean = (weight * values).sum(axis=1) / total
    offset = time - centre[:, None]
    spread = (weight * offset * offset).sum(axis=1)
    slope = (weight * offset * values).sum(axis=1) / np.where(spread > 0, spread, 1.0)
    return np.column_stack([mean - slope * centre, slope])
