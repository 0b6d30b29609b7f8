"""Whether the tracks of a recording fit its map and each other: figures over its moving vehicles, which count alike."""

import math
from typing import NamedTuple

import numpy as np
import shapely

from hid2.agents import FloatArray, IntArray
from hid2.measures.arrays import MOVING_EXTENT_M, SceneArrays
from hid2.measures.lane_matching import FlatLanes, directions_of_motion, lanes_near
from netconvert.geometry import wrap_angle

#: Distance from a lane's centreline from which a point does not fit the lane, m: half a lane. On it, it fits fully.
_HALF_LANE_M = 1.75
#: Longest shift that is tried, any way, and spacing of the shifts, m.
_SHIFTS_TO_M, _SHIFT_STEP_M = 6.0, 0.5
#: Share of the best shift's gain from which a smaller shift is told instead: the rest may come from along the road.
_SHARE_OF_GAIN = 0.9
#: Least gain of a shift, as a share of the vehicles: some fit another lane by chance.
_LEAST_GAIN = 0.1
#: Most points of a vehicle, and of all where there are many vehicles: they bound the time.
_POINTS_EACH, _POINTS = 8, 240


class Plausibility(NamedTuple):
    """Figures of a scene.

    moving: moving vehicles; mapped: those of them that come within the convex hull of the drivable areas; ground: mean
    over these of the share of their points there that lie on a drivable area, 0 without any; turned: moving vehicles
    with a heading mostly more than 45 degrees off their motion; stated: for x and y the median ratio of the way by
    the velocities to the displacement, and of how many vehicles, those displaced by MOVING_EXTENT_M along that axis;
    shift_m: by how much all tracks would have to be shifted to fit the lanes better, 0 where none does; gain: share of
    the vehicles that fit a lane only after a shift of more than half a lane.
    """

    moving: int
    mapped: int
    ground: float
    turned: int
    stated: tuple[tuple[float, int], ...]
    shift_m: float
    gain: float


def plausibility(arrays: SceneArrays, lanes: FlatLanes) -> Plausibility:
    """The figures of a recorded scene."""
    agents = np.flatnonzero(arrays.moving_vehicles)
    direction = directions_of_motion(arrays.position, arrays.heading, arrays.first, step_s=arrays.step_s)
    off = np.abs(wrap_angle(arrays.heading - direction)) > np.pi / 4
    spread = np.linspace(0.0, 1.0, min(_POINTS_EACH, max(2, _POINTS // max(1, len(agents)))))
    first, last = arrays.first[agents, None], arrays.first[agents + 1, None] - 1
    rows = (first + spread * (last - first)).astype(np.int64)  # (vehicles, points)
    x, y = arrays.position[rows].transpose(2, 0, 1)
    drivable = lanes.graph.drivable
    inside, ground = (shapely.contains_xy(area, x, y) for area in (drivable.convex_hull, drivable))
    mapped = inside.any(axis=1)
    shares = ground[mapped].sum(axis=1) / inside[mapped].sum(axis=1)
    shift_m, gain = _shift(arrays, direction, rows.ravel(), lanes) if len(rows) else (0.0, 0.0)
    return Plausibility(
        moving=len(agents),
        mapped=len(shares),
        ground=float(shares.mean()) if len(shares) else 0.0,
        turned=int((off[rows].mean(axis=1) > 0.5).sum()),
        stated=_stated(arrays, agents),
        shift_m=shift_m,
        gain=gain,
    )


def _stated(arrays: SceneArrays, agents: IntArray) -> tuple[tuple[float, int], ...]:
    """The `stated` of `Plausibility`."""
    step_ways = (arrays.velocity[1:] + arrays.velocity[:-1]) / 2 * (np.diff(arrays.step) * arrays.step_s)[:, None]
    passed = np.vstack([np.zeros((1, 2)), np.cumsum(step_ways, axis=0)])
    first, last = arrays.first[agents], arrays.first[agents + 1] - 1
    ways, moves = passed[last] - passed[first], arrays.position[last] - arrays.position[first]
    tells = np.abs(moves) > MOVING_EXTENT_M
    ratios = (ways[there, axis] / moves[there, axis] for axis, there in enumerate(tells.T))
    return tuple((float(np.median(ratio)) if len(ratio) else 1.0, len(ratio)) for ratio in ratios)


def _shift(arrays: SceneArrays, direction: FloatArray, rows: IntArray, lanes: FlatLanes) -> tuple[float, float]:
    """The shift_m and the gain of `Plausibility`.

    A point counts 1 on the centreline of a lane of its direction, 0 off it, and -1 on a lane against it alone.
    """
    steps = np.arange(-_SHIFTS_TO_M, _SHIFTS_TO_M + _SHIFT_STEP_M / 2, _SHIFT_STEP_M)
    shifts = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    shifts = shifts[np.hypot(*shifts.T) <= _SHIFTS_TO_M]
    shifts = shifts[np.argsort(np.hypot(*shifts.T), kind="stable")]
    lengths_m, course = np.hypot(*shifts.T), direction[rows]
    aside = np.stack([-np.sin(course), np.cos(course)], axis=1) @ shifts.T  # (points, shifts), to the left
    nearest = _distance(arrays.position[rows], course, aside, lanes)
    against = _distance(arrays.position[rows], course + math.pi, -aside, lanes)
    fits = np.maximum(0.0, 1.0 - nearest / _HALF_LANE_M)
    fits[(nearest >= _HALF_LANE_M) & (against < _HALF_LANE_M)] = -1.0
    score = fits.mean(axis=0)
    gain, beyond = score.max() - score[0], score.max() - score[lengths_m <= _HALF_LANE_M].max()
    best = int(np.argmax(score >= score[0] + _SHARE_OF_GAIN * gain))
    return float(lengths_m[best]) if gain >= _LEAST_GAIN else 0.0, float(beyond)


def _distance(position: FloatArray, course: FloatArray, aside: FloatArray, lanes: FlatLanes) -> FloatArray:
    """Distance (points, shifts), m, to the nearest centreline of that course; aside: shifts to its left, m."""
    every = np.ones(len(course), dtype=np.bool_)
    _, _, d, _, count = lanes_near(lanes, position, course, every, beyond_m=_SHIFTS_TO_M)
    nearest = np.full(aside.shape, np.inf)
    for slot in range(int(count.max(initial=0))):
        there = np.flatnonzero(slot < count)
        nearest[there] = np.minimum(nearest[there], np.abs(d[there, slot, None] + aside[there]))
    return nearest
