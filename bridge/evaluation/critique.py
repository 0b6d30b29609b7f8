"""What the critics say of an evaluation's windows, with their controls, as values for metrics.json and the report."""

import logging
from importlib.util import find_spec
from typing import Any

import numpy as np

from hid2.evaluation.critics import (
    JUDGED,
    Critic,
    Packed,
    View,
    betrayals,
    constant_on_the_middle,
    halves_apart,
    judge,
)

_LOG = logging.getLogger(__name__)
#: Splits of the recorded tracks over which the negative control is averaged.
_SPLITS = 3
#: Recordings by how they were made, as `Packed.labelled` has them.
_KINDS = (("all", None), ("tracker", 0.0), ("labelled", 1.0))
#: Features named in the report.
_NAMED = 6
#: Said in the report and on stderr.
MISSING = (
    "the critics are not computed: scikit-learn, the extra `critics`, is not installed; install it "
    "(`pip install scikit-learn`, in a clone `sh setup.sh`) and evaluate again"
)


def critique(found: Packed, control: Packed | None = None) -> dict[str, Any]:
    """Verdicts of the critics by kind of recording, negative and positive controls, and what betrays most.

    control: recorded windows with those of other drivers, which the critics must tell, such as SUMO's default ones.
    Without the extra `critics` there are none, which is logged, and `missing` says so.
    """
    missing = MISSING if find_spec("sklearn") is None else None
    if missing is not None:
        _LOG.warning("%s", missing)
        found, control = found.of(found.scene < 0), None
    verdicts = [
        {"recordings": kind, **verdict}
        for kind, number in _KINDS
        for verdict in _all_of(found if number is None else found.of(found.labelled == number))
    ]
    return {
        "missing": missing,
        "verdicts": verdicts,
        "negative_control": [entry for critic, view in JUDGED if (entry := _halves(found, critic, view)) is not None],
        "constant_speed_control": _all_of(constant_on_the_middle(found)),
        "drivers_control": _all_of(control) if control is not None else [],
        "betrays": [{"feature": name, "auc": auc} for name, auc in betrayals(found)[:_NAMED]],
    }


def _all_of(found: Packed) -> list[dict[str, Any]]:
    return [verdict._asdict() for critic, view in JUDGED if (verdict := judge(found, critic, view)) is not None]


def _halves(found: Packed, critic: Critic, view: View) -> dict[str, Any] | None:
    """Recorded against recorded: mean over splits of the AUC and of the ends of its interval."""
    verdicts = [judge(halves_apart(found, split), critic, view) for split in range(_SPLITS)]
    known = [(one.auc, one.low, one.high) for one in verdicts if one is not None]
    if not known:
        return None
    means = [[value for value in column if value is not None] for column in zip(*known, strict=True)]
    auc, low, high = (float(np.mean(values)) if values else None for values in means)
    return {"critic": critic, "view": view, "auc": auc, "low": low, "high": high}
