"""A behaviour in a folder of a user's own is asked for, driven, seen, recorded and drawn as the paper's are."""

import pickle
from collections.abc import Iterator
from pathlib import Path

import pytest

from bridge.batch.requested import check_request
from bridge.batch.scan import Selection, facts_of, select
from bridge.config import functions_of, load_config, parse_behaviours
from bridge.generation.generate import generate
from bridge.pictures.figures import kinds_in
from bridge.recordings.scenario import read_scenario
from hid2.agents import Policy
from hid2.policy.behaviours import BEHAVIOURS, load_own
from hid2.reasons import Reason
from netconvert.errors import ConfigError

KEEP_RIGHT = """
from hid2.agents import Policy
from hid2.measures.manoeuvres import ManeuverKind
from hid2.policy.behaviours import Behaviour
from hid2.reasons import Reason

keep_right = Behaviour(
    Policy("keep_right"), "keep right", "KR", (ManeuverKind.LANE_CHANGE,), Reason.MAP_OFFERS_NO_LANE_CHANGE,
    site_order=4, sides=("right",),
)
late = Behaviour(
    Policy("late"), "late lane change", "LL", (ManeuverKind.LANE_CHANGE,), Reason.MAP_OFFERS_NO_LANE_CHANGE, 4,
    sides=("right", "left"),
    is_shown=lambda states, seen: seen.crossing_s > 4.0 and seen.track_id in states.arrays.track_ids,
)
other_name = keep_right
told = Behaviour(Policy("told"), "told", "TO", ("lane_change",), Reason.MAP_OFFERS_NO_LANE, 5, sides=("left",))
early = Behaviour(Policy("early"), "early", "EA", late.seen_as, late.no_map, "5", sides=("left",))
passes = Behaviour(Policy("passes"), "passes", "PA", (ManeuverKind.OVERTAKE,), late.no_map, 5, sides=("left",))
fails = Behaviour(
    Policy("fails"), "fails", "FA", late.seen_as, Reason.MAP_OFFERS_NO_LANE, 5, sides=("left",),
    is_shown=lambda states, seen: seen.nothing,
)
number = 3
"""


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A module with behaviours, which are forgotten after the test."""
    name = f"own_{tmp_path.name.replace('-', '_')}"
    (tmp_path / f"{name}.py").write_text(KEEP_RIGHT, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    before = dict(BEHAVIOURS)
    yield name
    BEHAVIOURS.clear()
    BEHAVIOURS.update(before)


def test_own_behaviour_is_asked_for_driven_seen_and_recorded(module: str, data_scenes: dict[str, Path]) -> None:
    flags = parse_behaviours(f"{module}:keep_right=1")
    config = load_config(None, ["request.agents=6", "request.trigger_max_s=1"], flags)
    assert functions_of(config) == {f"{module}:keep_right": "request.own"}
    made = generate(read_scenario(data_scenes["arterial"]), config)
    assert made.sidecar is not None
    asked = [agent for agent in made.sidecar.agents if agent.policy == "keep_right"]
    done = [record for agent in asked for record in agent.maneuvers if record.status == "done"]
    assert done
    assert {record.kind for record in done} == {"lane_change"}
    graph = made.recording.graph
    assert all(graph.neighbor(record.source_lane or 0, "right") == record.target_lane for record in done)
    assert made.sidecar.requested.behaviours[Policy("keep_right")] == 1.0
    assert made.sidecar.placed.behaviours[Policy("keep_right")] == len(asked)
    shown = kinds_in(made.recording)
    assert {shown[agent.track_id] for agent in asked} == {"generated"}
    assert set(Policy) == {"straight", "left_turn", "right_turn", "lane_change", "overtake"}


def test_own_predicate_says_what_counts_as_done(module: str, data_scenes: dict[str, Path]) -> None:
    """Of lane changes that SUMO drives, those that it does not hold for are told with their reason."""
    flags = parse_behaviours(f"{module}:late=1")
    config = load_config(None, ["request.agents=8", "request.trigger_max_s=1", "request.seed=0"], flags)
    sidecar = generate(read_scenario(data_scenes["arterial"]), config).sidecar
    assert sidecar is not None
    crossed = [(record.crossing_s, record.reason) for _, record in sidecar.asked if record.crossing_s is not None]
    assert {reason for _, reason in crossed} == {None, Reason.NOT_AS_ASKED}
    assert all((reason is None) is (crossing_s > 4.0) for crossing_s, reason in crossed)


def test_scan_looks_for_an_own_behaviour(module: str, data_scenes: dict[str, Path]) -> None:
    name = f"{module}:keep_right"
    facts, _ = facts_of([data_scenes["arterial"], data_scenes["curve"]], (name, "lead:focal"))
    assert facts[0].events == f"lead:focal {name}"
    assert select(facts, Selection(can=(name,))) == [fact for fact in facts if name in fact.events]
    with pytest.raises(ConfigError, match="no attribute 'missing'"):
        facts_of([data_scenes["arterial"]], (f"{module}:missing",))


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("missing", "no attribute 'missing'"),
        ("number", "is 3, expected a Behaviour of Policy\\('number'\\)"),
        ("other_name", "expected a Behaviour of Policy\\('other_name'\\)"),
        ("passes", "expected sides and seen_as = \\(ManeuverKind.LANE_CHANGE,\\)"),
        ("told", "seen_as = 'lane_change', expected an instance of ManeuverKind"),
        ("early", "site_order = '5', expected a valid integer"),
    ],
)
def test_what_is_no_behaviour_is_said(module: str, name: str, said: str) -> None:
    with pytest.raises(ConfigError, match=f"request.own: '{module}:{name}'.* ?{said}"):
        load_own([f"{module}:{name}"])


def test_predicate_that_fails_is_told_before_any_scene_is_driven(
    module: str, data_scenes: dict[str, Path], here: None
) -> None:
    late, fails = (load_config(None, [], parse_behaviours(f"{module}:{name}=1")) for name in ("late", "fails"))
    check_request([*data_scenes.values()], late, [Policy("late")], jobs=1)
    with pytest.raises(ConfigError, match=rf"behaviour fails: .* \(3 of 3\); .*{module}.py:\d+: Attribute"):
        check_request([*data_scenes.values()], fails, [Policy("fails")], jobs=1)


def test_policy_of_a_name_is_one_object_and_shares_that_are_named_are_all_that_there_are() -> None:
    """As with the paper's: one that is not named gets none, one that is named twice is an error."""
    assert Policy("overtake") is Policy.OVERTAKE
    assert pickle.loads(pickle.dumps(Policy("keep_right"))) is Policy("keep_right")  # own bytes
    before = {"request.own": "mine:x=0.5"}
    config = load_config(None, [], before | parse_behaviours("straight=1"))
    assert config.request.own_behaviours == {}
    with pytest.raises(ConfigError, match="'mine:x' is given twice"):
        parse_behaviours("mine:x=.2, mine:x=.3")
