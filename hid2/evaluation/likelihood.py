"""Simulated agents as the field measures them: how likely the recorded motion is among that of rollouts ("WOSAC-like").

Waymo's Open Sim Agents Challenge (WOSAC, Montali et al., arXiv 2305.12032): features of every agent at every step, a
histogram of each over an agent's rollouts and steps, and in it the likelihood of what was recorded. Bins, pseudocounts
and weights are those of its configuration of 2023; the page of `hid2 resimulate` says what differs.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import shapely
from scipy.spatial import cKDTree

from hid2.agents import FloatArray, IntArray
from hid2.kernels.box_pairs import time_to_collision
from hid2.measures.arrays import BoolArray
from hid2.measures.surrogates import CAP_S
from hid2.occupancy.traffic import Traffic
from netconvert.geometry import box_corners
from netconvert.lane_graph import LaneGraph


class MetricFeature(NamedTuple):
    """A feature: range and number of bins, weight in the sum, group. of: what an indication (two bins) is made of."""

    name: str
    low: float
    high: float
    bins: int
    weight: float
    group: str
    of: str = ""


KINEMATICS, OBJECTS, MAP = GROUPS = ("kinematics", "objects", "map")
_NEAREST, _EDGE = "distance to the nearest object, m", "distance to the road's edge, m"
FEATURES = (
    MetricFeature("speed, m/s", 0.0, 25.0, 10, 0.05, KINEMATICS),
    MetricFeature("acceleration, m/s²", -12.0, 12.0, 11, 0.05, KINEMATICS),
    MetricFeature("yaw rate, rad/s", -0.628, 0.628, 11, 0.05, KINEMATICS),
    MetricFeature("yaw acceleration, rad/s²", -3.14, 3.14, 11, 0.05, KINEMATICS),
    MetricFeature(_NEAREST, -5.0, 40.0, 10, 0.10, OBJECTS),
    MetricFeature("time to collision, s", 0.0, CAP_S, 10, 0.10, OBJECTS),
    MetricFeature(_EDGE, -20.0, 40.0, 10, 0.05, MAP),
    MetricFeature("collision", 0.0, 1.0, 2, 0.25, OBJECTS, of=_NEAREST),
    MetricFeature("off the road", 0.0, 1.0, 2, 0.25, MAP, of=_EDGE),
)
#: Last step of the history and last one that is scored: 1.1 s are known, 8 s are driven. Pseudocounts of a bin, and of
#: a bin of an indication. No tunables: what the challenge has.
NOW, LAST, _PSEUDO, _PSEUDO_INDICATION = 10, 90, 0.1, 0.001
#: Largest spacing of points of the road's edge, m. No tunable: bins are 6 m wide.
_EDGE_STEP_M = 0.5
#: Distance beyond the road's edge (...), m, of the farthest of corners (..., 4, 2), m; below 0 inside.
BeyondEdge = Callable[[FloatArray], FloatArray]


class Features(NamedTuple):
    """Values and whether they are known, (F, N, T): by feature that is no indication, agent and step."""

    values: FloatArray
    known: BoolArray

    def agents(self, rows: IntArray) -> "Features":
        """Some of the agents, also several times."""
        return Features(self.values[:, rows], self.known[:, rows])


def beyond_edge(graph: LaneGraph) -> BeyondEdge:
    """How far boxes reach out of the drivable area of a map."""
    edge = cKDTree(shapely.get_coordinates(shapely.segmentize(shapely.boundary(graph.drivable), _EDGE_STEP_M)))

    def of(corners: FloatArray) -> FloatArray:
        inside = shapely.contains_xy(graph.drivable, corners[..., 0], corners[..., 1])
        return np.asarray((edge.query(corners)[0] * np.where(inside, -1.0, 1.0)).max(axis=-1))

    return of


def features(traffic: Traffic, rows: IntArray, beyond: BeyondEdge, *, step_s: float) -> Features:
    """Features of agents (N,) among all, step by step: as recorded, or of a rollout with its history."""
    present = traffic.present[rows]
    velocity, moved = _central(traffic.position[rows], present, step_s)
    acceleration, changed = _central(np.hypot(velocity[..., 0], velocity[..., 1]), moved, step_s)
    yaw, _ = _central(np.unwrap(traffic.heading[rows], axis=1, period=np.pi), present, step_s)
    yaw_acceleration, _ = _central(yaw, moved, step_s)
    corners = box_corners(
        traffic.position, traffic.heading, length_m=traffic.length_m[:, None], width_m=traffic.width_m[:, None]
    )
    row_of = np.full(traffic.present.shape, -1, dtype=np.int64)
    row_of[traffic.present] = np.arange(traffic.present.sum())
    position, heading, velocities = (
        np.ascontiguousarray(one[traffic.present]) for one in (traffic.position, traffic.heading, traffic.velocity)
    )
    ttc_s, _ = time_to_collision(position, heading, velocities, traffic.length_m, traffic.width_m, row_of, CAP_S)
    values = np.stack([
        np.hypot(velocity[..., 0], velocity[..., 1]), acceleration, yaw, yaw_acceleration,
        _nearest(traffic, rows, corners), ttc_s[row_of[rows]], beyond(corners[rows]),
    ])  # fmt: skip
    return Features(values, np.stack([moved, changed, moved, changed, present, present, present]))


def _central(values: FloatArray, known: BoolArray, step_s: float) -> tuple[FloatArray, BoolArray]:
    """(N, T, ...) central differences, and where they are known (N, T): both neighbours are."""
    seen = np.zeros_like(known)
    seen[:, 1:-1] = known[:, 2:] & known[:, :-2]
    return np.gradient(values, step_s, axis=1), seen


def _nearest(traffic: Traffic, rows: IntArray, corners: FloatArray) -> FloatArray:
    """(N, T) m from each box to the nearest other one, 0 where they overlap; at most the range's end."""
    reach = 0.5 * np.hypot(traffic.length_m, traffic.width_m)
    found = np.full((len(rows), traffic.num_steps), FEATURES[4].high)
    for place, row in enumerate(rows.tolist()):
        apart = np.hypot(*np.moveaxis(traffic.position - traffic.position[row], -1, 0))
        apart[~(traffic.present & traffic.present[row])] = apart[row] = np.inf
        # boxes are no nearer than their circles, nor is the nearest one farther than centres are
        agent, step = np.nonzero(apart - reach[:, None] - reach[row] < np.minimum(apart.min(axis=0), found[place]))
        boxes, own = shapely.polygons(corners[agent, step]), shapely.polygons(corners[row, step])
        np.minimum.at(found[place], step, shapely.distance(boxes, own))
    return found


def likelihoods(recorded: Features, rollouts: Sequence[Features]) -> FloatArray:
    """(9, N) logarithm of the likelihood of each agent in each of `FEATURES`, mean over its steps; NaN: not known."""
    names, steps = [feature.name for feature in FEATURES if not feature.of], slice(NOW + 1, LAST + 1)
    found = np.full((len(FEATURES), recorded.values.shape[1]), np.nan)
    for number, feature in enumerate(FEATURES):
        column, pseudo = names.index(feature.of or feature.name), _PSEUDO_INDICATION if feature.of else _PSEUDO
        for agent in range(found.shape[1]):
            own, *rolled = (
                _bins(feature, one.values[column, agent, steps][one.known[column, agent, steps]])
                for one in (recorded, *rollouts)
            )
            if own.size:
                counts = np.bincount(np.concatenate(rolled), minlength=feature.bins) + pseudo
                found[number, agent] = np.log(counts / counts.sum())[own].mean()
    return found


def _bins(feature: MetricFeature, values: FloatArray) -> IntArray:
    """The bin of each value, that at the end for one out of range; of an indication one for all, 1 where it holds."""
    if feature.of:
        holds = (values <= 0.0) if feature.of == _NEAREST else (values > 0.0)
        return np.full(min(values.size, 1), holds.any(), dtype=np.int64)
    share = (values - feature.low) / (feature.high - feature.low)
    return np.clip((share * feature.bins).astype(np.int64), 0, feature.bins - 1)


def scene_scores(found: FloatArray) -> FloatArray:
    """(9 + 4,) likelihood of a scene in each feature, the geometric mean over agents (9, N); of GROUPS; their sum."""
    scores = np.exp(np.nanmean(found, axis=1))
    weights = [[one.weight * (group in (one.group, "")) for one in FEATURES] for group in (*GROUPS, "")]
    return np.concatenate([scores, [np.average(scores, weights=one) for one in weights]])
