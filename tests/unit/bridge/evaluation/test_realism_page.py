"""What the report says of realism in words, for figures that are known."""

import numpy as np
import pytest

from bridge.pages.parts import macros
from hid2.evaluation.critics import MISSING, critique
from hid2.evaluation.windows import WINDOW


def plain_words(critics):
    """The sentences, a line each."""
    return [line for line in macros("report.html.j2").plain(critics).splitlines() if line]


def verdict(auc, *, critic="trees", view="all", recordings="all", low=0.5, high=0.7):
    return {"critic": critic, "view": view, "recordings": recordings, "auc": auc, "low": low, "high": high,
            "generated": 900, "recorded": 300, "scenes": 5}  # fmt: skip


def critics(auc, **more):
    return {
        "verdicts": [verdict(0.55, critic="logistic"), verdict(auc)], "negative_control": [verdict(0.51)],
        "constant_speed_control": [verdict(0.97)], "drivers_control": [],
        "betrays": [{"feature": "drift across the lane", "auc": 0.36}], "missing": None,
    } | more  # fmt: skip


def test_the_page_says_how_often_the_best_critic_is_right_and_what_betrays_most_in_plain_words():
    text = " ".join(plain_words(critics(0.63)))
    assert "right 63 times of 100 (between 50 and 70, depending on which scenes are looked at)" in text
    assert "by guessing it is right 50 times of 100" in text
    assert not any(word in text for word in ("AUC", "Jensen", "bootstrap", "quantile", "stratum", "distribution"))
    assert "drift across the lane (generated vehicles have less of it)" in text
    assert len(plain_words(critics(0.51, betrays=[{"feature": "speed", "auc": 0.53}]))) == 1


def test_a_package_that_is_missing_is_not_said_to_be_too_few_scenes():
    assert "too few scenes" in plain_words(critics(0.6, verdicts=[]))[0]
    (line,) = plain_words(critics(0.6, verdicts=[], missing=MISSING))
    assert "scikit-learn, the extra `critics`, is not installed" in line
    assert "pip install scikit-learn" in line
    assert "too few" not in line


@pytest.mark.slow
def test_verdicts_are_given_by_kind_of_recording():
    """Six scenes, three of them of each kind; accelerations and places alike for both kinds of vehicles."""
    rng = np.random.default_rng(0)
    same = np.zeros(480, dtype=WINDOW)
    same["scene"] = rng.integers(0, 6, 480)
    same["speed_mps"], same["accel_mps2"] = rng.uniform(3, 12, 480), rng.normal(0, 0.6, 480)
    same["offset_m"] = rng.normal(0, 0.3, 480)
    same["labelled"], same["halves"] = same["scene"] % 2, rng.integers(0, 2**16, 480)
    same["generated"] = rng.random(480) < 0.5
    found = critique(same, control=same)
    assert {entry["recordings"] for entry in found["verdicts"]} == {"all", "tracker", "labelled"}
    assert {entry["critic"] for entry in found["verdicts"]} == {"logistic", "trees"}
    assert min(entry["auc"] for entry in found["constant_speed_control"] if entry["view"] == "all") > 0.9
    assert found["drivers_control"]
    assert all(0.2 < entry["auc"] < 0.8 for entry in found["negative_control"])


def test_without_the_extra_nothing_is_judged_and_it_is_said(monkeypatch, caplog):
    rows = np.ones(40, dtype=WINDOW)
    rows["generated"], rows["scene"] = np.arange(40) % 2 == 0, np.arange(40) % 4 // 2
    monkeypatch.setattr("hid2.evaluation.critics.find_spec", lambda _: None)
    found = critique(rows, rows)
    assert (found["verdicts"], found["drivers_control"], found["betrays"]) == ([], [], [])
    assert found["missing"] == MISSING
    assert MISSING in caplog.text
    assert "pip install scikit-learn" in MISSING
