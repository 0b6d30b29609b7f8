"""How far generated motion is from recorded motion: distances of distributions, and a classifier that must tell them.

Features and bins follow the Waymo sim-agents challenge where it has them (speed, acceleration, yaw rate, TTC); this is
no Waymo score. Every distance stands beside its floor: the distance between two halves of the recorded tracks.
"""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hid2.agents import FloatArray, IntArray
from hid2.evaluation.kinematics import Motion
from hid2.evaluation.safety import CAP_S, Safety
from hid2.kernels.track_features import track_features_vector
from hid2.measures.arrays import BoolArray, SceneArrays


class Feature(NamedTuple):
    """One quantity with the range and number of bins of its histogram; values outside count in the end bins."""

    name: str
    label: str
    unit: str
    low: float
    high: float
    bins: int


FEATURES = (
    Feature("speed", "speed", "m/s", 0.0, 25.0, 10),
    Feature("longitudinal_accel", "longitudinal acceleration", "m/s²", -12.0, 12.0, 11),
    Feature("lateral_accel", "lateral acceleration", "m/s²", -6.0, 6.0, 11),
    Feature("yaw_rate", "yaw rate", "rad/s", -0.628, 0.628, 11),
    Feature("jerk", "jerk (magnitude)", "m/s³", 0.0, 30.0, 10),
    Feature("ttc", "time to collision", "s", 0.0, CAP_S, 10),
    Feature("time_gap", "time gap to the leader", "s", 0.0, 5.0, 10),
    Feature("lane_change_duration", "lane-change duration", "s", 0.0, 10.0, 10),
)
#: Fine bins within each bin: Wasserstein distances are exact to a fine bin.
FINE = 40
#: Rows at either end of a track whose derivatives are one-sided.
END_ROWS = 2
#: Random splits of the recorded tracks into halves; the floor is the median over them.
SPLITS = 16

#: Histograms (fine bins) by feature name.
Histograms = dict[str, IntArray]


def empty_histograms() -> Histograms:
    """No samples yet."""
    return {feature.name: np.zeros(feature.bins * FINE, dtype=np.int64) for feature in FEATURES}


def histogram(feature: Feature, values: npt.ArrayLike) -> IntArray:
    """(bins * FINE,) counts of the values, those outside the range in the end bins."""
    place = fine_bin(feature, np.asarray(values, dtype=np.float64))
    return np.asarray(np.bincount(place, minlength=feature.bins * FINE), dtype=np.int64)


def fine_bin(feature: Feature, values: FloatArray) -> IntArray:
    """The fine bin of each value: the same shape."""
    fine = (values - feature.low) / (feature.high - feature.low) * feature.bins * FINE
    return np.asarray(np.clip(fine.astype(np.int64), 0, feature.bins * FINE - 1))


def jensen_shannon(feature: Feature, first: IntArray, second: IntArray) -> float | None:
    """Jensen-Shannon distance (root of the divergence, base 2: 0 to 1) over the bins; None without samples."""
    p = first.reshape(feature.bins, FINE).sum(axis=1).astype(np.float64)
    q = second.reshape(feature.bins, FINE).sum(axis=1).astype(np.float64)
    if not p.sum() or not q.sum():
        return None
    p, q = p / p.sum(), q / q.sum()
    middle = (p + q) / 2
    divergence = (_relative_entropy(p, middle) + _relative_entropy(q, middle)) / 2
    return float(np.sqrt(max(divergence, 0.0)))


def wasserstein(feature: Feature, first: IntArray, second: IntArray) -> float | None:
    """Wasserstein-1 distance in the feature's unit, within its range; None without samples."""
    if not first.sum() or not second.sum():
        return None
    width = (feature.high - feature.low) / (feature.bins * FINE)
    apart = np.cumsum(first) / first.sum() - np.cumsum(second) / second.sum()
    return float(np.abs(apart).sum() * width)


def _relative_entropy(p: FloatArray, q: FloatArray) -> float:
    some = p > 0
    return float((p[some] * np.log2(p[some] / q[some])).sum())


class Distance(NamedTuple):
    """Distance of generated from recorded motion in one feature, and the floor (None where samples lack)."""

    feature: Feature
    jensen_shannon: float | None
    jensen_shannon_floor: float | None
    wasserstein: float | None
    wasserstein_floor: float | None
    generated: int
    recorded: int


@dataclass(eq=False, slots=True)
class RealismCounts:
    """Histograms of any number of scenes: all that the distances need, in constant memory.

    halves[k]: the recorded tracks of one half of split k; a track is in the same half in every copy of its scene.
    """

    generated: Histograms = field(default_factory=empty_histograms)
    recorded: Histograms = field(default_factory=empty_histograms)
    halves: list[Histograms] = field(default_factory=lambda: [empty_histograms() for _ in range(SPLITS)])

    def add(self, other: "RealismCounts") -> None:
        """Take the samples of another batch in."""
        for mine, theirs in zip(
            [self.generated, self.recorded, *self.halves], [other.generated, other.recorded, *other.halves], strict=True
        ):
            for name, counts in theirs.items():
                mine[name] += counts

    def distances(self) -> list[Distance]:
        """Distance and floor for each feature."""
        return [self._distance(feature) for feature in FEATURES]

    def _distance(self, feature: Feature) -> Distance:
        generated, recorded = self.generated[feature.name], self.recorded[feature.name]
        halves = [half[feature.name] for half in self.halves]
        return Distance(
            feature,
            jensen_shannon(feature, generated, recorded),
            _median(jensen_shannon(feature, half, recorded - half) for half in halves),
            wasserstein(feature, generated, recorded),
            _median(wasserstein(feature, half, recorded - half) for half in halves),
            int(generated.sum()),
            int(recorded.sum()),
        )


def _median(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else None


def half_of(scene: str, track_id: str) -> BoolArray:
    """(SPLITS,) in which half of each split a track falls: by a hash of its name, the same in every run."""
    digest = hashlib.blake2b(f"{scene}/{track_id}".encode(), digest_size=SPLITS // 8).digest()
    return np.unpackbits(np.frombuffer(digest, dtype=np.uint8)).astype(bool)


def row_features(arrays: SceneArrays, moved: Motion, safe: Safety) -> dict[str, FloatArray]:
    """Row-wise features (N,) by name; infinite where one is not defined. Lane-change durations are not row-wise."""
    inside = np.ones(len(arrays.agent), dtype=bool)
    for end in range(END_ROWS):
        inside[np.minimum(arrays.first[:-1] + end, arrays.first[1:] - 1)] = False
        inside[np.maximum(arrays.first[1:] - 1 - end, arrays.first[:-1])] = False
    values = {
        "speed": moved.speed,
        "longitudinal_accel": moved.longitudinal_accel,
        "lateral_accel": moved.lateral_accel,
        "yaw_rate": moved.yaw_rate,
        "jerk": moved.jerk_norm,
        "ttc": safe.ttc_s,
        "time_gap": safe.leaders.time_gap_s,
    }
    return {name: np.where(inside, value, np.inf) for name, value in values.items()}


def count_scene(
    scene: str,
    arrays: SceneArrays,
    features: Mapping[str, FloatArray],
    durations: Mapping[str, Sequence[float]],
    *,
    generated: BoolArray,
    recorded: BoolArray,
) -> RealismCounts:
    """Histograms of one scene. `scene` names the recorded scene; durations: of lane changes, by track id.

    generated, recorded (A,): the moving vehicles to compare.
    """
    agents = np.flatnonzero(recorded)
    # (SPLITS + 1, agents): which tracks each half holds, and in the last row all
    member = np.ones((SPLITS + 1, len(agents)), dtype=bool)
    for k, agent in enumerate(agents):
        member[:-1, k] = half_of(scene, arrays.track_ids[agent])
    number = np.full(arrays.num_agents, -1, dtype=np.int64)
    number[agents] = np.arange(len(agents))
    of_generated, owner = generated[arrays.agent], number[arrays.agent]
    counts = RealismCounts()
    for feature in FEATURES[:-1]:
        values = features[feature.name]
        defined = np.isfinite(values)
        counts.generated[feature.name] = histogram(feature, values[defined & of_generated])
        rows = defined & (owner >= 0)
        _count(counts, feature, values[rows], owner[rows], member)
    duration = FEATURES[-1]
    seen = [(a, value) for a, name in enumerate(arrays.track_ids) for value in durations.get(name, ())]
    counts.generated[duration.name] = histogram(duration, [value for a, value in seen if generated[a]])
    mine = [(number[a], value) for a, value in seen if number[a] >= 0]
    values, owners = np.array([v for _, v in mine]), np.array([n for n, _ in mine], dtype=np.int64)
    _count(counts, duration, values, owners, member)
    return counts


def _count(counts: RealismCounts, feature: Feature, values: FloatArray, owner: IntArray, member: BoolArray) -> None:
    """Histograms of recorded values (V,), each of track `owner`, for every half in `member` and for all."""
    place = fine_bin(feature, values)
    for k, tracks in enumerate(member):
        found = np.bincount(place[tracks[owner]], minlength=feature.bins * FINE)
        if k < SPLITS:
            counts.halves[k][feature.name] = found
        else:
            counts.recorded[feature.name] = found


# Classifier two-sample test

#: Features of whole tracks for the classifier: those that tracker noise does not reach, then those that it does.
DRIVING_FEATURES = (
    "mean_speed", "std_speed", "min_speed", "max_speed", "mean_lane_offset", "std_lane_offset", "heading_change",
    "median_time_gap", "has_leader",
)  # fmt: skip
MOTION_FEATURES = (
    "mean_abs_accel", "p95_abs_accel", "mean_abs_lateral", "p95_abs_lateral", "mean_abs_yaw_rate", "mean_jerk",
    "p95_jerk",
)  # fmt: skip


def track_features(arrays: SceneArrays, moved: Motion, safe: Safety, agent: int) -> FloatArray:
    """One vehicle as a vector: DRIVING_FEATURES, then MOTION_FEATURES."""
    rows = slice(int(arrays.first[agent]), int(arrays.first[agent + 1]))
    matched = safe.matches.lane[rows] >= 0
    gap = safe.leaders.time_gap_s[rows]
    features: FloatArray = track_features_vector(
        moved.speed[rows], safe.matches.d[rows][matched], safe.matches.direction[rows], gap[np.isfinite(gap)],
        np.abs(moved.longitudinal_accel[rows]), np.abs(moved.lateral_accel[rows]), np.abs(moved.yaw_rate[rows]),
        moved.jerk_norm[rows],
    )  # fmt: skip
    return features


def area_under_curve(scores: FloatArray, labels: BoolArray) -> float | None:
    """AUC: the chance that a positive scores above a negative, ties half (Mann-Whitney); None with one class only."""
    positives = int(labels.sum())
    negatives = len(labels) - positives
    if not positives or not negatives:
        return None
    # scipy.stats has both of these, and takes most of a second to import in every process
    _, place, count = np.unique(scores, return_inverse=True, return_counts=True)
    ranks = (np.cumsum(count) - (count - 1) / 2)[place]
    return float((ranks[labels].sum() - positives * (positives + 1) / 2) / (positives * negatives))


def logistic_regression(x: FloatArray, y: BoolArray, *, ridge: float = 1.0) -> FloatArray:
    """Weights (K + 1,), intercept last, of a ridge-penalised logistic regression by Newton's method.

    x (M, K) standardised features; the two classes weigh the same however many samples each has.
    """
    design = np.column_stack([x, np.ones(len(x))])
    target = y.astype(np.float64)
    balance = np.where(y, 0.5 / max(y.mean(), 1e-12), 0.5 / max(1 - y.mean(), 1e-12))
    penalty = np.diag([ridge] * x.shape[1] + [1e-6])
    weights = np.zeros(design.shape[1])
    for _ in range(50):
        p = 1.0 / (1.0 + np.exp(-np.clip(design @ weights, -500.0, 500.0)))
        gradient = design.T @ (balance * (p - target)) + penalty @ weights
        hessian = (design * (balance * p * (1 - p))[:, None]).T @ design + penalty
        step = np.linalg.solve(hessian, gradient)
        weights -= step
        if np.abs(step).max() < 1e-9:
            break
    return weights


def classifier_test(x: FloatArray, generated: BoolArray, scenes: Sequence[str], *, folds: int = 5) -> float | None:
    """Mean AUC over folds of a classifier that tells generated from recorded vehicles; 0.5: it cannot.

    x (M, K) features, generated (M,), scenes (M,) recorded scene of each sample: a scene is never split between
    training and test. None where no fold holds both kinds.
    """
    names = sorted(set(scenes))
    if len(names) < 2:
        return None
    fold_of = {name: k % min(folds, len(names)) for k, name in enumerate(names)}
    fold = np.array([fold_of[name] for name in scenes])
    found = []
    for k in range(int(fold.max()) + 1):
        train, test = fold != k, fold == k
        if not generated[train].any() or generated[train].all():
            continue
        mean, spread = x[train].mean(axis=0), x[train].std(axis=0)
        scaled = (x - mean) / np.where(spread > 1e-12, spread, 1.0)
        weights = logistic_regression(scaled[train], generated[train])
        auc = area_under_curve(scaled[test] @ weights[:-1] + weights[-1], generated[test])
        if auc is not None:
            found.append(auc)
    return float(np.mean(found)) if found else None
