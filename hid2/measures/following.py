"""The leader on the lane path: gap, time gap, time headway and TTC to it (SSAM's car-following case)."""

from dataclasses import dataclass

import numpy as np

from hid2.agents import FloatArray, IntArray
from hid2.kernels.gaps import lane_leaders
from hid2.measures.arrays import SceneArrays
from hid2.measures.driven_lanes import LaneView
from hid2.measures.lane_matching import Matches

#: Look-ahead on a path for leaders, m.
HORIZON_M = 100.0
#: Speed below which a follower has no time gap, m/s.
MIN_SPEED_MPS = 1.0


@dataclass(frozen=True, eq=False, slots=True)
class LaneLeaders:
    """The next vehicle ahead on each row's lane path (N,); rows without one have agent -1 and infinite values.

    gap_m bumper to bumper; time_gap_s = gap / follower's speed; ttc_s, inf if not closing.
    """

    agent: IntArray
    gap_m: FloatArray
    time_gap_s: FloatArray
    ttc_s: FloatArray


def leaders(view: LaneView) -> LaneLeaders:
    """Leader of every vehicle row on its lane path: lane, the lanes it drives next, then the straightest successors.

    A vehicle ahead leads where the two boxes overlap across the lane.
    """
    arrays, lanes, matches = view.arrays, view.lanes, view.matches
    successors = np.full((len(lanes.successors), max([1, *map(len, lanes.successors)])), -1, dtype=np.int64)
    for k, targets in enumerate(lanes.successors):
        successors[k, : len(targets)] = targets
    agent, gap = lane_leaders(
        matches.lane, matches.s, matches.d, arrays.row_of, _next_lane_row(arrays, matches), arrays.length, arrays.width,
        lanes.length_m, successors, lanes.straight, HORIZON_M,
    )  # fmt: skip
    speed = np.hypot(arrays.velocity[:, 0], arrays.velocity[:, 1])
    led = agent >= 0
    leader_row = np.where(led, arrays.row_of[np.where(led, agent, 0), arrays.step], 0)
    closing = np.where(led, speed - speed[leader_row], 0.0)
    positive = led & (closing > 1e-9)
    return LaneLeaders(
        agent=agent,
        gap_m=gap,
        time_gap_s=time_gaps(np.where(led, gap, np.inf), speed),
        ttc_s=np.where(positive, np.maximum(gap, 0.0) / np.where(positive, closing, 1.0), np.inf),
    )


def time_gaps(gap_m: FloatArray, speed_mps: FloatArray) -> FloatArray:
    """Time gaps (N,) s to leaders so far ahead (N,), inf for none; inf for followers that hardly move."""
    return np.asarray(np.where(speed_mps > MIN_SPEED_MPS, gap_m / np.maximum(speed_mps, MIN_SPEED_MPS), np.inf))


def _next_lane_row(arrays: SceneArrays, matches: Matches) -> IntArray:
    """(N,) the next row of the same agent on another lane, -1 if there is none."""
    switches = np.flatnonzero((np.diff(matches.lane) != 0) & (np.diff(arrays.agent) == 0)) + 1
    following = np.append(switches, -1)[np.searchsorted(switches, np.arange(len(matches.lane)), side="right")]
    return np.where((following >= 0) & (arrays.agent[following] == arrays.agent), following, -1)
