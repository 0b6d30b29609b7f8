"""What the scripts share: the real scenes, in `$HID2_SHARED_DATA` or else beside the project, and how critics score."""

import os
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from bridge.recordings.recording import Recording
from bridge.recordings.scenario import read_scenario
from bridge.recordings.sources import find_scenarios

SHARED_DATA = Path(os.environ.get("HID2_SHARED_DATA") or Path(__file__).resolve().parents[3].joinpath("shared", "data"))
#: The fourteen real scenes.
ROOTS = [SHARED_DATA / "av2", SHARED_DATA / "wide"]


def scenes_below(roots: Iterable[Path]) -> Iterator[Recording]:
    """Scenes of data sets, in the order of their folders."""
    return (read_scenario(folder) for root in roots for folder in find_scenarios(root))


def scores_of_trees(
    x: np.ndarray, inserted: np.ndarray, weight: np.ndarray, fold: np.ndarray, **trees: int
) -> np.ndarray:
    """(N,) scores of gradient-boosted trees of depth 3, each fold judged by those that the others trained."""
    from sklearn.ensemble import HistGradientBoostingClassifier
    from threadpoolctl import threadpool_limits

    score = np.zeros(len(x))
    for one in np.unique(fold):
        own = fold == one
        critic = HistGradientBoostingClassifier(max_depth=3, random_state=0, **trees)
        with threadpool_limits(1):
            critic.fit(x[~own], inserted[~own], sample_weight=weight[~own])
            score[own] = critic.predict_proba(x[own])[:, 1]
    return score
