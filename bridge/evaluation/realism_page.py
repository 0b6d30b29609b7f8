"""The report's section on realism: how closely generated vehicles drive like recorded ones, in words and figures."""

import html
from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from bridge.evaluation.totals import Evaluation
from bridge.pages.charts import distribution_figure
from bridge.pages.parts import linked, macro, number, picture, table, with_interval
from hid2.evaluation.critics import FEATURE_NAMES
from hid2.evaluation.realism import FEATURES

#: How the critics and what they are shown are named in the report.
_CRITIC_NAMES = {
    "logistic": "a weighted sum (logistic regression)",
    "trees": "a series of yes-no questions (gradient-boosted trees)",
    "temporal": "one that sees the course of the four seconds (random convolutions)",
}
_VIEW_NAMES = {"speed": "shown speed alone", "lateral": "shown the place in the lane alone", "all": "shown everything"}
_RECORDINGS = {"all": "all scenes", "tracker": "scenes recorded by a tracker", "labelled": "scenes labelled by people"}


def realism_section(evaluation: Evaluation) -> str:
    """The section as HTML; empty where nothing was inserted."""
    realism = evaluation.metrics["realism"]
    if not evaluation.totals.realism.generated["speed"].sum():
        return ""
    names = {feature.name: feature for feature in FEATURES}
    rows = [
        (
            linked(f"{names[item['feature']].label}, {item['unit']}"),
            *(
                number(item[f"jensen_shannon{part}"], digits)
                for part, digits in (("", 3), ("_floor", 3), ("_ratio", 1))
            ),
            *(number(item[name]) for name in ("wasserstein", "wasserstein_floor")),
            *(f"{item[name]:,}" for name in ("generated_samples", "recorded_samples")),
        )
        for item in realism["distances"]
    ]
    head = (
        "feature", linked("Jensen-Shannon"), "floor of Jensen-Shannon", "Jensen-Shannon / floor", linked("Wasserstein"),
        "floor of Wasserstein", "generated samples", "recorded samples",
    )  # fmt: skip
    caption = "Distributions behind the table; end bins hold what lies beyond."
    shown = picture(distribution_figure(evaluation.totals.realism), caption, _furthest(realism["distances"], names))
    critics = realism["critics"]
    plain = plain_words(critics, realism["tails"])
    return macro(
        "report.html.j2", "realism", evaluation.metrics["scenes"], plain, _critics_table(critics),
        _tails_table(realism["tails"], names), table(head, rows), shown,
    )  # fmt: skip


def plain_words(critics: Mapping[str, Any], tails: Sequence[Mapping[str, Any]]) -> list[Markup]:
    """How close the driving is, in sentences that need no statistics."""
    told = macro("report.html.j2", "plain", critics, tails, _RECORDINGS, len(FEATURE_NAMES))
    return [line for line in told.splitlines() if line]


def _critics_table(critics: Mapping[str, Any]) -> Markup:
    def row(first: str, v: Mapping[str, Any]) -> tuple[str, ...]:
        found = {"value": v["auc"], "low": v["low"], "high": v["high"]}
        counts = (f"{v['generated']:,}", f"{v['recorded']:,}", str(v["scenes"])) if "scenes" in v else ("", "", "")
        return (f"{first}{_CRITIC_NAMES[v['critic']]}, {_VIEW_NAMES[v['view']]}", with_interval(found, 2), *counts)

    rows = [row(f"{_RECORDINGS[v['recordings']]}: ", v) for v in critics["verdicts"]]
    rows += [row("recorded against recorded: ", v) for v in critics["negative_control"]]
    rows += [row("constant speed on the lane’s middle: ", v) for v in critics["constant_speed_control"]]
    rows += [row("drivers of the control: ", v) for v in critics["drivers_control"]]
    return table(("told apart", linked("AUC"), "generated windows", "recorded windows", "scenes"), rows)


def _tails_table(tails: Sequence[Mapping[str, Any]], names: Mapping[str, Any]) -> Markup:
    shares = tails[0]["shares"] if tails else []
    rows = [
        (linked(f"{names[item['feature']].label}, {item['unit']}, {who}"), *(number(value, 2) for value in item[key]))
        for item in tails
        for key, who in (("recorded", "recorded"), ("generated", "generated"))
        if item[key] is not None
    ]
    return table(("quantile", *(f"{share:.0%}" for share in shares)), rows)


def _furthest(distances: Sequence[Mapping[str, Any]], names: Mapping[str, Any]) -> str:
    """Which features differ most and least from recorded ones, in a sentence; none where nothing can be compared."""
    known = sorted((d for d in distances if d["jensen_shannon_ratio"]), key=lambda d: float(d["jensen_shannon_ratio"]))
    if len(known) < 2:
        return ""
    least, most = known[0], known[-1]
    return html.escape(
        f"generated and recorded vehicles differ most in {names[most['feature']].label} "
        f"({most['jensen_shannon_ratio']:.1f} times the floor) and least in {names[least['feature']].label} "
        f"({least['jensen_shannon_ratio']:.1f} times)."
    )
