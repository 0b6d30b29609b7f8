"""Critics: classifiers that must tell generated from recorded driving, and the controls that they are held against.

Two of them, of scikit-learn (the extra `critics`): ridge-penalised logistic regression, and gradient-boosted trees.
They see windows of 4 s as fits, so that tracker noise does not decide. Generated and recorded windows weigh the same in
each stratum of scene, speed band, turning and presence of a leader. A critic judges scenes that it was not trained on.

Controls say what a figure means. Negative: recorded against recorded, 0.5 within its interval. Positive: the generated
windows at constant speed on the lane's middle, which a critic that is worth its name tells at 0.9 or more.
"""

import logging
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from typing import Any, Literal, NamedTuple

import numpy as np

from hid2.agents import FloatArray, IntArray
from hid2.evaluation.windows import WINDOW_S, Windows
from hid2.measures.arrays import BoolArray
from hid2.resampling import ratio

# What the critics are, no tunables: with other numbers no two figures could be compared.
#: Least windows of either kind in a stratum that counts; bounds of the bands of speed, m/s. No tunables.
_LEAST, _BANDS = 2, (2.0, 5.0, 8.0, 11.0)
_FOLDS = 5
_FAR_M = 60.0


#: Kinds of critics, and what of the driving a critic is shown.
Critic = Literal["logistic", "trees"]
View = Literal["speed", "lateral", "all"]


class Verdict(NamedTuple):
    """AUC of a critic, 95 % interval by drawing scenes again (three at least), windows of either kind, scenes."""

    critic: Critic
    view: View
    auc: float
    low: float | None
    high: float | None
    generated: int
    recorded: int
    scenes: int


#: Features by name, in the order of `features`: those of speed, of the place in the lane, and the rest.
SPEED_FEATURES = (
    "speed", "acceleration", "size of the acceleration", "jerk", "size of the jerk", "acceleration at the beginning",
    "acceleration at the end",
)  # fmt: skip
LATERAL_FEATURES = (
    "offset to the left", "distance from the lane's middle", "drift to the left", "drift across the lane",
    "bend of the place in the lane to the left", "weaving about the place in the lane",
)  # fmt: skip
OTHER_FEATURES = (
    "yaw rate", "change of the yaw rate", "gap to the leader", "closing speed", "time gap",
    "acceleration times closing speed",
)  # fmt: skip
FEATURE_NAMES = SPEED_FEATURES + LATERAL_FEATURES + OTHER_FEATURES
_COLUMNS: Mapping[View, slice] = {
    "speed": slice(0, len(SPEED_FEATURES)),
    "lateral": slice(len(SPEED_FEATURES), len(SPEED_FEATURES) + len(LATERAL_FEATURES)),
    "all": slice(0, len(FEATURE_NAMES)),
}


def features(found: Windows) -> FloatArray:
    """(M, F) FEATURE_NAMES of windows."""
    half = 0.5 * WINDOW_S
    v, a, j = found["speed_mps"], found["accel_mps2"], found["jerk_mps3"]
    d, drift, bend = found["offset_m"], found["drift_mps"], found["bend_mps2"]
    gap, closing = np.minimum(found["gap_m"], _FAR_M), found["closing_mps"]
    return np.column_stack([
        v, a, np.abs(a), j, np.abs(j), a - j * half, a + j * half,
        d, np.abs(d), drift, np.abs(drift), bend, np.abs(bend),
        np.abs(found["yaw_radps"]), np.abs(found["yaw_bend_radps2"]), gap, closing, gap / np.maximum(v, 1.0),
        a * closing,
    ])  # fmt: skip


def constant_on_the_middle(found: Windows) -> Windows:
    """The positive control: generated windows as if driven at constant speed on the lane's middle."""
    found = found.copy()
    for name in ("accel_mps2", "jerk_mps3", "offset_m", "drift_mps", "bend_mps2"):
        found[name][found["generated"]] = 0.0
    return found


def halves_apart(found: Windows, split: int) -> Windows:
    """The negative control: recorded windows, of which those of one half of the tracks pass as generated."""
    recorded: Windows = found[~found["generated"]]
    recorded["generated"] = recorded["halves"] >> split & 1
    return recorded


def strata(found: Windows) -> IntArray:
    """(M,) stratum of the matching: scene, speed band, turning, led."""
    scene = np.unique(found["scene"], return_inverse=True)[1]
    band = np.searchsorted(_BANDS, found["speed_mps"])
    return np.asarray(scene * 20 + band * 4 + found["turning"] * 2 + found["led"], dtype=np.int64)


def matched_weights(stratum: IntArray, generated: BoolArray) -> FloatArray:
    """(M,) weights by which both kinds weigh the same in each stratum, and it what the smaller kind counts; else 0."""
    _, place = np.unique(stratum, return_inverse=True)
    ours, theirs = (np.bincount(place, weights=kind) for kind in (generated, ~generated))
    both = np.where(np.minimum(ours, theirs) >= _LEAST, np.minimum(ours, theirs), 0.0)
    return np.asarray(both[place] / np.where(generated, ours[place], theirs[place]), dtype=np.float64)


def weighted_auc(scores: FloatArray, labels: BoolArray, weights: FloatArray) -> float | None:
    """AUC of weighted samples: the chance that a positive scores above a negative, ties half; None with one class."""
    from sklearn.metrics import roc_auc_score

    there = weights > 0
    if len(np.unique(labels[there])) < 2:
        return None
    return float(roc_auc_score(labels[there], scores[there], sample_weight=weights[there]))


def judge(found: Windows, critic: Critic, view: View) -> Verdict | None:
    """Verdict of a critic on matched windows; None where fewer than two scenes hold both kinds."""
    weights = matched_weights(strata(found), found["generated"])
    found, weights = found[weights > 0], weights[weights > 0]
    scenes, scene = np.unique(found["scene"], return_inverse=True)
    if len(scenes) < 2:
        return None
    x, generated = features(found)[:, _COLUMNS[view]], found["generated"]
    fold, scores = scene % min(_FOLDS, len(scenes)), np.zeros(len(x))
    for k in range(int(fold.max()) + 1):
        test = fold == k
        scores[test] = _scores(critic, x[~test], generated[~test], weights[~test], x[test])
    parts = [
        (weights[own].sum(), auc)
        for own in scene == np.arange(len(scenes))[:, None]
        if (auc := weighted_auc(scores[own], generated[own], weights[own])) is not None
    ]
    size, aucs = np.array(parts).reshape(-1, 2).T
    value, low, high = ratio(size * aucs, size)
    auc = 0.5 if value is None else value  # a scene at least has windows of both kinds
    return Verdict(critic, view, auc, low, high, int(generated.sum()), int((~generated).sum()), len(aucs))


def betrayals(found: Windows) -> list[tuple[str, float]]:
    """AUC of each single feature on matched windows, those that betray most first; above .5: larger when generated."""
    weights = matched_weights(strata(found), found["generated"])
    if not (weights > 0).any():
        return []
    columns = zip(FEATURE_NAMES, features(found).T, strict=True)
    alone = [(name, weighted_auc(column, found["generated"], weights) or 0.5) for name, column in columns]
    return sorted(alone, key=lambda item: -abs(item[1] - 0.5))


def _scores(critic: Critic, x: FloatArray, generated: BoolArray, weights: FloatArray, new: FloatArray) -> FloatArray:
    """Scores (K,) of new samples (K, F) by a classifier that is fitted to others (M, F)."""
    from sklearn.ensemble import HistGradientBoostingClassifier
    from sklearn.linear_model import LogisticRegression
    from threadpoolctl import threadpool_limits

    found: Any = LogisticRegression(solver="newton-cholesky", tol=1e-6)
    if critic == "trees":
        found = HistGradientBoostingClassifier(
            learning_rate=0.1, max_iter=60, max_depth=3, max_bins=32, min_samples_leaf=3, l2_regularization=1.0,
            early_stopping=False,
        )  # fmt: skip
    mean = np.average(x, axis=0, weights=weights)
    spread = np.sqrt(np.average((x - mean) ** 2, axis=0, weights=weights))
    spread = np.where(spread > 1e-9, spread, 1.0)
    with threadpool_limits(1):  # of so few samples threads would wait for each other
        found.fit((x - mean) / spread, generated, sample_weight=weights)
        return np.asarray(found.decision_function((new - mean) / spread), dtype=np.float64)


#: Critics and views that are judged, in the order of the report.
JUDGED: Sequence[tuple[Critic, View]] = (
    ("logistic", "all"), ("trees", "speed"), ("trees", "lateral"), ("trees", "all"),
)  # fmt: skip
#: Number of splits of the recorded tracks over which the negative control is averaged. No tunable.
_SPLITS = 3
#: Number of features named in the report, those that betray most first. No tunable.
_NAMED = 6
#: Message in the report and on stderr where the critics are not computed.
MISSING = (
    "the critics are not computed: scikit-learn, the extra `critics`, is not installed; install it "
    "(`pip install scikit-learn`, in a clone `sh setup.sh`) and evaluate again"
)


def critique(found: Windows, control: Windows | None = None) -> dict[str, Any]:
    """Verdicts of the critics by kind of recording, negative and positive controls, and what betrays most.

    control: recorded windows with those of other drivers, which the critics must tell, such as SUMO's default ones.
    Without the extra `critics` there are none, which is logged, and `missing` says so.
    """
    missing = MISSING if find_spec("sklearn") is None else None
    if missing is not None:
        logging.getLogger(__name__).warning("%s", missing)
        found, control = found[:0], None
    kinds = {"all": found, "tracker": found[~found["labelled"]], "labelled": found[found["labelled"]]}
    verdicts = [{"recordings": kind, **verdict} for kind, some in kinds.items() for verdict in _all_of(some)]
    return {
        "missing": missing,
        "verdicts": verdicts,
        "negative_control": [entry for critic, view in JUDGED if (entry := _halves(found, critic, view)) is not None],
        "constant_speed_control": _all_of(constant_on_the_middle(found)),
        "drivers_control": _all_of(control) if control is not None else [],
        "betrays": [{"feature": name, "auc": auc} for name, auc in betrayals(found)[:_NAMED]],
    }


def _all_of(found: Windows) -> list[dict[str, Any]]:
    return [verdict._asdict() for critic, view in JUDGED if (verdict := judge(found, critic, view)) is not None]


def _halves(found: Windows, critic: Critic, view: View) -> dict[str, Any] | None:
    """Recorded against recorded: mean over splits of the AUC and of the ends of its interval."""
    verdicts = [judge(halves_apart(found, split), critic, view) for split in range(_SPLITS)]
    known = [(one.auc, one.low, one.high) for one in verdicts if one is not None]
    if not known:
        return None
    means = [[value for value in column if value is not None] for column in zip(*known, strict=True)]
    auc, low, high = (float(np.mean(values)) if values else None for values in means)
    return {"critic": critic, "view": view, "auc": auc, "low": low, "high": high}
