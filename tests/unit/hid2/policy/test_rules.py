"""Lane-change rules that can be exchanged: values in, a decision out."""

from dataclasses import replace
from pathlib import Path

import pytest
from gap_view import VIEW

from hid2.drivers.driver import usual_driver
from hid2.params import LaneChange
from hid2.policy import rules
from hid2.policy.lane_change import OPEN, Gap, SumoAnswer
from hid2.reasons import Reason
from netconvert.errors import ConfigError


def _mobil(view: rules.GapView, params: LaneChange) -> Reason | None:
    return next(rules.mobil_refusals(view, params), None)


MOBIL = LaneChange(rule="MOBIL", mobil_bias_mps2=0.0, mobil_threshold_mps2=0.1, mobil_safe_mps2=2.0)


def test_idm_by_hand() -> None:
    """At the desired speed 1 - 1 = 0; behind 12 m at the same speed s* = 2 + 10 = 12: another -1."""
    assert rules.idm_mps2(10.0, OPEN, VIEW) == pytest.approx(0.0)
    assert rules.idm_mps2(10.0, Gap(12.0, 10.0), VIEW) == pytest.approx(-1.0)
    # closing in by 2 m/s: s* = 2 + 10 + 10 * 2 / 2 = 22, over 22 m
    assert rules.idm_mps2(10.0, Gap(22.0, 8.0), VIEW) == pytest.approx(-1.0)


AT_12_M = Gap(12.0, 10.0)
POLITE = "mobil_politeness"


@pytest.mark.parametrize(
    ("seen", "changed", "reason"),
    [
        # behind a leader at 12 m the lane beside is worth 0 - (-1) = 1 m/s2; on a free road it is worth nothing
        ({"own_front": AT_12_M}, {}, None),
        ({}, {}, Reason.MOBIL_NO_ADVANTAGE),
        ({}, {"mobil_bias_mps2": 0.2}, None),  # the bias takes the place of an advantage
        # a follower 6 m behind at 10 m/s: s* = 12, so 0 - 4 = -4 m/s2, beyond the 2 allowed
        ({"own_front": AT_12_M, "rear": Gap(6.0, 10.0)}, {}, Reason.MOBIL_UNSAFE),
        # own advantage 1; the new follower, at 12 m now instead of nobody ahead, loses 1: worth it below p = 0.9
        ({"own_front": AT_12_M, "rear": AT_12_M}, {POLITE: 0.0}, None),
        ({"own_front": AT_12_M, "rear": AT_12_M}, {POLITE: 0.85}, None),
        ({"own_front": AT_12_M, "rear": AT_12_M}, {POLITE: 0.95}, Reason.MOBIL_NO_ADVANTAGE),
        # nothing to win for itself; the old follower at 12 m loses its leader and wins 1: at p = 0.2 more than 0.1
        ({"own_rear": AT_12_M}, {POLITE: 0.0}, Reason.MOBIL_NO_ADVANTAGE),
        ({"own_rear": AT_12_M}, {POLITE: 0.2}, None),
        # leaders at 12 m here and there: no advantage. The old follower has 12 + 4 + 12 = 28 m then, -(12 / 28)^2 =
        # -.184: it wins .816 m/s2, more than the threshold of .1 from p = .123 on
        ({"own_front": AT_12_M, "own_rear": AT_12_M, "front": AT_12_M}, {POLITE: 0.12}, Reason.MOBIL_NO_ADVANTAGE),
        ({"own_front": AT_12_M, "own_rear": AT_12_M, "front": AT_12_M}, {POLITE: 0.125}, None),
    ],
)
def test_mobil_weighs_advantage_safety_and_what_followers_lose_and_win(
    seen: dict[str, Gap], changed: dict[str, float], reason: Reason | None
) -> None:
    assert _mobil(replace(VIEW, **seen), MOBIL.model_copy(update=changed)) == reason


@pytest.mark.parametrize(
    ("sumo", "reason"),
    [
        (None, Reason.LC2013_NO_MOTIVE),
        (SumoAnswer(frozenset(), False, False), Reason.LC2013_NO_MOTIVE),
        (SumoAnswer(frozenset({"speedGain"}), False, False), None),
        (SumoAnswer(frozenset({"speedGain"}), True, False), Reason.FRONT_GAP),
        (SumoAnswer(frozenset({"cooperative"}), False, True), Reason.REAR_GAP),
    ],
)
def test_lc2013_wants_and_can(sumo: SumoAnswer | None, reason: Reason | None) -> None:
    assert rules.rule_reason(replace(VIEW, sumo=sumo), LaneChange(rule="LC2013")) == reason


@pytest.mark.parametrize("rule", ["paper", "MOBIL", "LC2013", "tests_of_rules:anything"])
def test_no_rule_is_asked_where_the_lane_cannot_be_changed_in(rule: str) -> None:
    """25 m of the target lane are asked for: 24 are too few, and 25 are enough by the paper's rule."""
    params = LaneChange(rule=rule, min_remaining_m=25.0)
    assert rules.rule_reason(replace(VIEW, remaining_m=24.0), params) == Reason.LANE_ENDS
    assert rule != "paper" or rules.rule_reason(replace(VIEW, remaining_m=25.0), params) is None
    assert rules.rule_reason(replace(VIEW, speed_mps=1.0), params) == Reason.TOO_SLOW


def test_users_function_is_asked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "own_rule.py").write_text("def patient(view):\n    return view.waited_s >= 2.0\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    params = LaneChange(rule="own_rule:patient")
    assert rules.rule_reason(VIEW, params) == Reason.RULE_REFUSES
    assert rules.rule_reason(replace(VIEW, waited_s=2.0), params) is None
    for name, words in (("nowhere_to_find:f", "No module"), ("math:nothing", "nothing")):
        with pytest.raises(ConfigError, match=words):
            rules.rule_reason(VIEW, LaneChange(rule=name))


#: Files of a rule `accept` that no scene may be driven with: the text, the line that is to blame, and what is said.
UNSOUND = {
    "syntax": ("def accept(view):\n    return (\n", 2, "SyntaxError: '(' was never closed"),
    "import": ("import math\nmath.nothing\n", 2, "AttributeError: module 'math' has no attribute 'nothing'"),
    "missing": ("import nowhere_to_find\n", 1, "ModuleNotFoundError: No module named 'nowhere_to_find'"),
    "exit": ("import sys\nsys.exit('bye')\n", 2, "SystemExit: bye"),
    "raises": (
        "def help(v):\n    return 1 / 0\ndef accept(v):\n    return help(v)\n",
        2,
        "ZeroDivisionError: division",
    ),
    "raises elsewhere": (
        "import json\ndef accept(v):\n    return json.loads('x')\n",
        3,
        "JSONDecodeError: Expecting value",
    ),
    "behind a vehicle": ("def accept(v):\n    return v.front.distance_m > 99 or v.no\n", 2, "has no attribute 'no'"),
    "signature": ("\ndef accept(a, b):\n    return True\n", 2, "TypeError: accept() missing 1 required positional"),
    "answer": ("def accept(view):\n    return 1\n", 1, "it answered 1, expected True or False"),
    "long answer": ("def accept(view):\n    return 'x' * 10**6\n", 1, "it answered 'xxx"),
}


@pytest.mark.parametrize("name", UNSOUND)
def test_unsound_rule_is_refused_with_file_and_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, name: str) -> None:
    text, line, said = UNSOUND[name]
    module = f"unsound_{list(UNSOUND).index(name)}"
    (tmp_path / f"{module}.py").write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(ConfigError) as caught:
        rules.check_user_rule(LaneChange(rule=f"{module}:accept"))
    assert f"lane_change.rule = '{module}:accept': {tmp_path / module}.py:{line}: " in str(caught.value)
    assert said in str(caught.value)
    assert len(str(caught.value)) < 600


def test_sound_rule_is_told_by_its_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "sound_rule.py").write_text("def accept(view):\n    return view.rear.distance_m > 10.0\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert rules.check_user_rule(LaneChange(rule="sound_rule:accept")) == str(tmp_path / "sound_rule.py")
    with pytest.raises(ConfigError, match="'builtins:bool': its module has no file"):
        rules.check_user_rule(LaneChange(rule="builtins:bool"))
    with pytest.raises(ConfigError, match="'math:pi': TypeError: 'float' object is not callable; expected a function"):
        rules.check_user_rule(LaneChange(rule="math:pi"))


def test_every_condition_that_says_no_is_told() -> None:
    """Cells taken, 1 m to either side at 10 m/s; MOBIL's follower would brake, and there is nothing to win."""
    crowded = replace(VIEW, cells_free=False, front=Gap(1.0, 10.0), rear=Gap(1.0, 10.0))
    assert rules.rule_refusals(crowded, LaneChange()) == (Reason.CELLS_OCCUPIED, Reason.FRONT_GAP, Reason.REAR_GAP)
    assert rules.rule_refusals(crowded, MOBIL) == (Reason.MOBIL_UNSAFE, Reason.MOBIL_NO_ADVANTAGE)
    assert rules.rule_refusals(VIEW, LaneChange()) == ()


def test_own_rule_takes_arguments_and_answers_by_condition(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "two_sided.py").write_text(
        "from numpy import bool_\n"
        "def accept(view, lead=1.0, b=1.0):\n"
        "    lag, mood = view.rear, bool_(True)\n"
        "    return {'lead': view.front.distance_m >= lead, 'lag': lag.distance_m >= b * lag.speed_mps, 'mood': mood}\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    params = LaneChange(rule="two_sided:accept", rule_with="b=1.5, lead=5")
    assert rules.rule_arguments(params) == {"b": 1.5, "lead": 5.0}
    near = replace(VIEW, front=Gap(4.0, 10.0), rear=Gap(14.0, 10.0))  # 1.4 s
    assert rules.rule_refusals(near, params) == (Reason.FRONT_GAP, Reason.REAR_GAP)
    assert rules.rule_refusals(near, LaneChange(rule="two_sided:accept", rule_with="b=1.3")) == ()
    unknown = LaneChange(rule="two_sided:accept", rule_with="gap=1.0")
    with pytest.raises(ConfigError, match=r"unexpected keyword .*; expected a function of a GapView and gap"):
        rules.check_user_rule(unknown)


def test_change_to_a_free_lane_is_expected_of_every_rule_with_an_incentive() -> None:
    """Behind a leader half as fast, LC2013 as if SUMO had a motive. MOBIL that wants 5 m/s2 more does not, at 2 m/s.

    By the IDM it gains 1.85 (2.2 + 2.3 + .5)^2 / 4.5^2 = 2.3 m/s2.
    """
    for rule in ("paper", "LC2013", "MOBIL"):
        assert rules.refusal_of_lane(usual_driver(10.0), LaneChange(rule=rule), speed_mps=10.0) is None
    never = LaneChange(rule="MOBIL", mobil_threshold_mps2=5.0, mobil_bias_mps2=0.0)
    assert rules.refusal_of_lane(usual_driver(10.0), never, speed_mps=2.0) is Reason.MOBIL_NO_ADVANTAGE


def test_rules_unasked_want_an_advantage_unless_mandatory() -> None:
    """Here 8 m/s ahead; there 9 m/s (1 m/s more: too little) or 9.6 m/s, 1.6 m/s more than 8: worth it by the paper's.

    MOBIL that must asks for safety alone.
    """
    params = LaneChange(rule="paper")
    slow = replace(VIEW, own_front=Gap(20.0, 8.0), front=Gap(60.0, 9.0))
    assert rules.refusals_unasked(slow, params, mandatory=False)
    assert not rules.refusals_unasked(slow, params, mandatory=True)
    fast = replace(slow, front=Gap(60.0, 9.6))
    assert not rules.refusals_unasked(fast, params, mandatory=False)
    assert rules.refusals_unasked(fast, params.model_copy(update={"rule_with": "incentive=2.0"}), mandatory=False)
    assert not rules.refusals_unasked(replace(slow, front=OPEN), params, mandatory=False)  # 10 m/s wished for
    assert rules.refusals_unasked(replace(fast, cells_free=False), params, mandatory=True)
    behind = replace(VIEW, own_front=OPEN, front=Gap(15.0, 8.0))  # slower there: nothing to gain
    assert rules.refusals_unasked(behind, MOBIL, mandatory=False)
    assert not rules.refusals_unasked(behind, MOBIL, mandatory=True)
    assert rules.refusals_unasked(replace(behind, rear=Gap(1.0, 14.0)), MOBIL, mandatory=True)
