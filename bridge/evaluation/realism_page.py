"""The report's section on realism: how closely generated vehicles drive like recorded ones, in words and figures."""

import html
from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from bridge.evaluation.charts import distribution_figure
from bridge.evaluation.pages import linked, macro, number, picture, table, with_interval
from bridge.evaluation.totals import Evaluation
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
#: A constant-speed vehicle has to be found out so often, SUMO's default drivers so often, for the critics to count.
_CONSTANT_FOUND, _DEFAULTS_FOUND = 0.90, 0.75


def realism_section(evaluation: Evaluation) -> str:
    """The section as HTML; empty where nothing was inserted."""
    realism = evaluation.metrics["realism"]
    if not evaluation.totals.realism.generated["speed"].sum():
        return ""
    names = {feature.name: feature for feature in FEATURES}
    rows = [
        (
            linked(f"{names[item['feature']].label}, {item['unit']}"),
            number(item["jensen_shannon"]),
            number(item["jensen_shannon_floor"]),
            number(item["jensen_shannon_ratio"], 1),
            number(item["wasserstein"]),
            number(item["wasserstein_floor"]),
            f"{item['generated_samples']:,}",
            f"{item['recorded_samples']:,}",
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
        "sections.html.j2", "realism", evaluation.metrics["scenes"], plain, _critics_table(critics),
        _tails_table(realism["tails"], names), table(head, rows), shown,
    )  # fmt: skip


def _of_100(auc: float) -> int:
    return round(100 * auc)


def plain_words(critics: Mapping[str, Any], tails: Sequence[Mapping[str, Any]]) -> list[str]:
    """How close the driving is, in sentences that need no statistics."""
    verdicts = [v for v in critics["verdicts"] if v["recordings"] == "all" and v["view"] == "all"]
    if not verdicts:
        return ["There are too few scenes to say how close the driving is: at least two recorded ones are needed."]
    best = max(verdicts, key=lambda v: v["auc"])
    spread = (
        f" (between {_of_100(best['low'])} and {_of_100(best['high'])}, depending on which scenes are looked at)"
        if best["low"] is not None
        else ""
    )
    task = (
        "Take one recorded and one generated vehicle in the same kind of traffic, each for four seconds. A program is "
        "trained to say which of the two is the generated one; by guessing it is right 50 times of 100. "
    )
    programs = f"The most successful of {len(verdicts)} programs" if len(verdicts) > 1 else "Our program"
    words = [
        f"{task}{programs} is right {_of_100(best['auc'])} times of 100{spread}: the nearer to 50, the more alike.",
        f"{best['scenes']} recorded scenes hold enough of both kinds to judge by.",
    ]
    words += _by_recordings(critics["verdicts"], best["critic"])
    recorded = [v for v in critics["negative_control"] if v["critic"] == best["critic"] and v["view"] == "all"]
    constant = [v for v in critics["constant_speed_control"] if v["view"] == "all"]
    if recorded:
        words.append(
            "For comparison: between two halves of the recorded vehicles, which differ by nothing but chance, it is "
            f"right {_of_100(recorded[0]['auc'])} times of 100."
        )
    if constant:
        found = max(v["auc"] for v in constant)
        verdict = "so it is able to see a difference" if found >= _CONSTANT_FOUND else "so it is easily fooled"
        words.append(
            "Vehicles that keep one speed on the very middle of the lane, as nobody drives, it finds out "
            f"{_of_100(found)} times of 100: {verdict}."
        )
    if critics["drivers_control"]:
        found = max(v["auc"] for v in critics["drivers_control"] if v["view"] == "all")
        verdict = "" if found >= _DEFAULTS_FOUND else ", fewer than critics of worth would"
        words.append(
            f"Vehicles with the other drivers of the control's scenes are found out {_of_100(found)} times of "
            f"100{verdict}."
        )
    told = [b for b in critics["betrays"] if abs(b["auc"] - 0.5) >= _TELLING][:3]
    if told:
        listed = "; ".join(
            f"{b['feature']} (generated vehicles have {'more' if b['auc'] > 0.5 else 'less'} of it)" for b in told
        )
        words.append(f"What gives generated vehicles away most: {listed}.")
    else:
        words.append(
            f"None of the {len(FEATURE_NAMES)} quantities that the programs see gives generated vehicles away by "
            f"itself: by its size alone one is right at most {_of_100(0.5 + _TELLING)} times of 100, over all scenes."
        )
    return words + _tails_in_words(tails)


#: A single quantity tells from here on: 58 of 100.
_TELLING = 0.08
#: Tails of the generated vehicles count as different from here on, ratio.
_APART = 1.5
_CAUTIOUS = {
    "time_gap": ("Those who follow closest (the lowest 5 of 100) keep", "s behind the vehicle ahead"),
    "ttc": ("The tightest 5 of 100 moments of closing in leave", "s to a contact"),
}


def _by_recordings(verdicts: Sequence[Mapping[str, Any]], critic: str) -> list[str]:
    """How often that critic is right on the scenes of either kind of recording, where there are both."""
    own = [v for v in verdicts if v["recordings"] != "all" and (v["critic"], v["view"]) == (critic, "all")]
    if len(own) < len(_RECORDINGS) - 1:
        return []
    told = [f"{_of_100(v['auc'])} times of 100 on the {v['scenes']} {_RECORDINGS[v['recordings']]}" for v in own]
    words = [f"Trained and tried on either kind apart, it is right {' and '.join(told)}."]
    if any(v["auc"] < 0.5 for v in own):
        words.append(
            "Less than 50 is no sign of realism: what it learned on the other scenes of the kind does not hold there."
        )
    return words


def _tails_in_words(tails: Sequence[Mapping[str, Any]]) -> list[str]:
    """Whether generated vehicles are too cautious or too bold, and what is usual, in sentences."""
    words = []
    for item in tails:
        if item["feature"] not in _CAUTIOUS or item["generated"] is None or item["recorded"] is None:
            continue
        row, middle = item["shares"].index(0.05), item["shares"].index(0.5)
        ours, theirs = item["generated"][row], item["recorded"][row]
        begin, unit = _CAUTIOUS[item["feature"]]
        ratio = ours / max(theirs, 1e-6)
        verdict = "much the same" if 1 / _APART < ratio < _APART else "too cautious" if ratio > 1 else "too bold"
        usual = f"{item['generated'][middle]:.1f} and {item['recorded'][middle]:.1f} s in the middle of all"
        words.append(f"{begin} {ours:.1f} {unit} when generated and {theirs:.1f} when recorded ({usual}): {verdict}.")
    return words


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
