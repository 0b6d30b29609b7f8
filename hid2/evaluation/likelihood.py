"""Simulated agents as the field measures them: how likely the recorded motion is among that of rollouts ("WOSAC-like").

Waymo's Open Sim Agents Challenge (WOSAC, Montali et al., arXiv 2305.12032): features of every agent at every step, a
histogram of each feature over the rollouts and steps of an agent, and in it the likelihood of what was recorded.
Bins, pseudocounts and weights are those of its configuration of 2023; the page of `hid2 resimulate` says what is not.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import shapely
from scipy.signal import savgol_filter
from scipy.spatial import cKDTree

from hid2.agents import FloatArray, IntArray
from hid2.kernels.box_pairs import time_to_collision
from hid2.measures.arrays import BoolArray
from hid2.measures.time_to_collision import CAP_S
from hid2.occupancy.traffic import Traffic
from netconvert.geometry import box_corners
from netconvert.lane_graph import LaneGraph


class Feature(NamedTuple):
    """A feature: name, unit, range and number of bins, weight in the sum, group.

    of: for an indication (two bins), the feature that at some step is not above 0 (a distance), or above 0 (off the
    road), where it holds.
    """

    name: str
    unit: str
    low: float
    high: float
    bins: int
    weight: float
    group: str
    of: str = ""


_KINEMATICS, _OBJECTS, _MAP = "kinematics", "nearest object", "map"
FEATURES = (
    Feature("speed", "m/s", 0.0, 25.0, 10, 0.05, _KINEMATICS),
    Feature("acceleration", "m/s²", -12.0, 12.0, 11, 0.05, _KINEMATICS),
    Feature("yaw rate", "rad/s", -0.628, 0.628, 11, 0.05, _KINEMATICS),
    Feature("yaw acceleration", "rad/s²", -3.14, 3.14, 11, 0.05, _KINEMATICS),
    Feature("distance to the nearest object", "m", -5.0, 40.0, 10, 0.10, _OBJECTS),
    Feature("time to collision", "s", 0.0, CAP_S, 10, 0.10, _OBJECTS),
    Feature("collision", "", 0.0, 1.0, 2, 0.25, _OBJECTS, of="distance to the nearest object"),
    Feature("distance to the road's edge", "m", -20.0, 40.0, 10, 0.05, _MAP),
    Feature("off the road", "", 0.0, 1.0, 2, 0.25, _MAP, of="distance to the road's edge"),
)
GROUPS = (_KINEMATICS, _OBJECTS, _MAP)
#: Pseudocounts of a bin, and of an indication's: what the challenge has; others give other figures.
_PSEUDO, _PSEUDO_INDICATION = 0.1, 0.001
#: Filter over positions and headings before they are differentiated, s, and its degree: recorded tracks of Argoverse 2
#: are a tracker's (LO 1.7 m/s2), those of the challenge are not. No tunable: other filters measure something else.
_FILTER_S, _DEGREE = 1.1, 2
#: Points of the road's edge are so far apart, m: bins are 6 m wide.
_EDGE_STEP_M = 0.5


@dataclass(frozen=True, eq=False, slots=True)
class Features:
    """Values and whether they are known, (F, N, T): by feature that is no indication, agent and step."""

    values: FloatArray
    known: BoolArray

    def agents(self, rows: IntArray) -> "Features":
        """Some of the agents, also several times."""
        return Features(self.values[:, rows], self.known[:, rows])

    def joined(self, *others: "Features") -> "Features":
        """The agents of all."""
        every = (self, *others)
        return Features(
            np.concatenate([one.values for one in every], axis=1), np.concatenate([one.known for one in every], axis=1)
        )  # fmt: skip


class RoadEdge:
    """How far boxes reach beyond the drivable area of a map."""

    def __init__(self, graph: LaneGraph) -> None:
        self._area = graph.drivable
        shapely.prepare(self._area)
        edge = shapely.segmentize(shapely.boundary(self._area), _EDGE_STEP_M)
        self._edge = cKDTree(shapely.get_coordinates(edge))

    def beyond_m(self, corners: FloatArray) -> FloatArray:
        """(...) m of the corners (..., 4, 2) farthest out: positive off the road, negative on it."""
        xy = corners.reshape(-1, 2)
        away_m, _ = self._edge.query(xy)
        outside = ~shapely.contains_xy(self._area, xy[:, 0], xy[:, 1])
        return np.asarray(np.where(outside, away_m, -away_m).reshape(corners.shape[:-1]).max(axis=-1))


def features(traffic: Traffic, rows: IntArray, edge: RoadEdge, *, step_s: float) -> Features:
    """Features of some agents (N,) among all, at every step: the recording's, or a rollout's with its history."""
    present = traffic.present[rows]
    position, heading = traffic.position[rows], np.unwrap(traffic.heading[rows], axis=1)
    position, heading = _filtered(position, present, step_s), _filtered(heading, present, step_s)
    moved, seen = _central(position, present, step_s)
    speed = np.hypot(moved[..., 0], moved[..., 1])
    accel, seen_accel = _central(speed, seen, step_s)
    yaw, seen_yaw = _central(heading, present, step_s)
    yaw_accel, seen_yaw_accel = _central(yaw, seen_yaw, step_s)
    corners = box_corners(
        traffic.position, traffic.heading, length_m=traffic.length_m[:, None], width_m=traffic.width_m[:, None]
    )  # fmt: skip
    beyond = np.where(present, edge.beyond_m(corners[rows]), 0.0)
    near, ttc = _nearest(traffic, rows, corners), _ttc(traffic, rows)
    values = np.stack([speed, accel, yaw, yaw_accel, near, ttc, beyond])
    return Features(values, np.stack([seen, seen_accel, seen_yaw, seen_yaw_accel, present, present, present]))


def _filtered(values: FloatArray, present: BoolArray, step_s: float) -> FloatArray:
    """(N, T, ...) each agent's run of steps through a Savitzky-Golay filter; shorter runs as they are."""
    window, found = 2 * round(_FILTER_S / step_s / 2) + 1, values.copy()
    for row, there in enumerate(present):
        steps = np.flatnonzero(there)
        if steps.size >= window:
            found[row, steps] = savgol_filter(values[row, steps], window, _DEGREE, axis=0)
    return found


def _central(values: FloatArray, known: BoolArray, step_s: float) -> tuple[FloatArray, BoolArray]:
    """(N, T, ...) central differences, and where they are known (N, T): both neighbours are."""
    found, seen = np.zeros_like(values), np.zeros_like(known)
    found[:, 1:-1] = (values[:, 2:] - values[:, :-2]) / (2.0 * step_s)
    seen[:, 1:-1] = known[:, 2:] & known[:, :-2]
    return found, seen


def _nearest(traffic: Traffic, rows: IntArray, corners: FloatArray) -> FloatArray:
    """(N, T) m from each box to the nearest other one, 0 where they overlap; twice the range where there is none."""
    boxes, far_m = shapely.polygons(corners), FEATURES[4].high
    reach = 0.5 * np.hypot(traffic.length_m, traffic.width_m)
    found = np.full((len(rows), traffic.num_steps), 2.0 * far_m)
    for place, row in enumerate(rows.tolist()):
        apart = np.hypot(*np.moveaxis(traffic.position - traffic.position[row], -1, 0))
        apart = np.where(traffic.present & traffic.present[row], apart, np.inf)
        apart[row] = np.inf
        # boxes are no nearer than their circles, nor is the nearest one farther than centres are
        agent, step = np.nonzero(apart - reach[:, None] - reach[row] < np.minimum(apart.min(axis=0), far_m))
        np.minimum.at(found[place], step, shapely.distance(boxes[agent, step], boxes[row, step]))
    return found


def _ttc(traffic: Traffic, rows: IntArray) -> FloatArray:
    """(N, T) s until a box touches another one at constant velocities, at most CAP_S."""
    row_of = np.full(traffic.present.shape, -1, dtype=np.int64)
    row_of[traffic.present] = np.arange(int(traffic.present.sum()))
    columns = (traffic.position, traffic.heading, traffic.velocity)
    position, heading, velocity = (np.ascontiguousarray(one[traffic.present]) for one in columns)
    ttc_s, _ = time_to_collision(position, heading, velocity, traffic.length_m, traffic.width_m, row_of, CAP_S)
    return np.asarray(np.where(traffic.present[rows], ttc_s[row_of[rows]], CAP_S))


def likelihoods(recorded: Features, rollouts: Sequence[Features], steps: slice) -> FloatArray:
    """(9, N) logarithms of the likelihood of each agent in each of `FEATURES`, mean over the steps; NaN: unknown.

    rollouts: of the same agents; each has a histogram of its own over all rollouts and steps.
    """
    names = [feature.name for feature in FEATURES if not feature.of]
    found = np.full((len(FEATURES), recorded.values.shape[1]), np.nan)
    for number, feature in enumerate(FEATURES):
        column = names.index(feature.of or feature.name)
        own, known = recorded.values[column, :, steps], recorded.known[column, :, steps]
        rolled = np.stack([one.values[column, :, steps] for one in rollouts], axis=1)
        there = np.stack([one.known[column, :, steps] for one in rollouts], axis=1)
        if feature.of:
            beyond = (lambda v: v <= 0.0) if feature.group == _OBJECTS else (lambda v: v > 0.0)
            own, rolled = ((beyond(v) & k).any(axis=-1, keepdims=True) for v, k in ((own, known), (rolled, there)))
            known, there = known.any(axis=-1, keepdims=True), there.any(axis=-1, keepdims=True)
        pseudo = _PSEUDO_INDICATION if feature.of else _PSEUDO
        for agent in np.flatnonzero(known.any(axis=1)):
            counts = np.bincount(_bins(feature, rolled[agent][there[agent]]), minlength=feature.bins) + pseudo
            found[number, agent] = np.log(counts / counts.sum())[_bins(feature, own[agent][known[agent]])].mean()
    return found


def _bins(feature: Feature, values: FloatArray) -> IntArray:
    """The bin of each value; those outside of the range are in the end bins."""
    share = (np.asarray(values, dtype=np.float64) - feature.low) / (feature.high - feature.low)
    return np.clip((share * feature.bins).astype(np.int64), 0, feature.bins - 1)


def scene_scores(found: FloatArray) -> FloatArray:
    """(9,) likelihood of a scene in each feature: the geometric mean over its agents (9, N)."""
    return np.asarray(np.exp(np.nanmean(found, axis=1)))


def weighted(scores: FloatArray, group: str | None = None) -> FloatArray:
    """(...) weighted mean of scores (9, ...) over the features of a group, or all."""
    weights = np.array([one.weight if group in (None, one.group) else 0.0 for one in FEATURES])
    return np.asarray(np.tensordot(weights, scores, axes=1) / weights.sum())
