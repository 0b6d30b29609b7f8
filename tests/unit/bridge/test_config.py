"""Configuration: what overrides what, what is refused and how, and the way to TOML and back."""

import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from bridge import config as configs
from hid2.params import GROUPS, Config, Event
from netconvert.errors import ConfigError

REMOVED = Path(__file__).parents[3] / "bridge/removed.toml"


def test_set_overrides_options_and_options_override_the_file(tmp_path: Path) -> None:
    path = tmp_path / "c.toml"
    path.write_text("[request]\nagents = 3\nseed = 3\nvariants = 3\n")
    config = configs.load_config(path, ["request.agents=1"], {"request.agents": 2, "request.seed": 2})
    assert (config.request.agents, config.request.seed, config.request.variants) == (1, 2, 3)


def test_values_may_be_of_numpy_and_ablations_are_a_list() -> None:
    flags = {"request.agents": np.int64(3), "request.lane_change": np.float32(0.5)}
    flags |= {"request.trigger_list_s": np.array([1.0, 2.0])}
    request = configs.load_config(None, [], flags).request
    assert (request.agents, request.lane_change, request.trigger_list_s) == (3, 0.5, (1.0, 2.0))
    assert configs.load_config(None, ["without=topology,smoothing"]).without == {"topology", "smoothing"}
    assert configs.load_config(None, ["without="]).without == frozenset()


@pytest.mark.parametrize(("override", "said"), [
    ("request.agents=-3", "= -3, expected integer >= 0, <= 500, or max"), ("drivers.accel_mean_mps2=.1", ">= 0.6"),
    ("request.agents=many", "request.agents = 'many', expected integer"), ("drivers.tau_mean_s=.5", ">= 0.6, <= 4"),
    ("request.agent=3", "unknown key 'request.agent' .* did you mean request.agents"),
    ("reqest.agents=3", "unknown key 'reqest.agents' .* did you mean request.agents"),
    ("request.agents", "expected section.key=value"), ("limits.accel_min_mps2=-.1", ">= -10, <= -0.8"),
    ("turn.trough_at=nan", "turn.trough_at = nan, expected number >= 0.1"), ("lane_change.heading_deg=.1", ">= 1"),
    ("sites.standing_mps=0.4", "standing_mps = 0.4: no parameter any more, the method has 0.3; leave it out$"),
    ("export.filter_ratios=[]", "no parameter any more, .*; leave it out, or set smoothing.filter_s"),
    ("request.trigger_max_s=0.1", "trigger_max_s 0.1 is below trigger_min_s 0.5"),
    ("spawn.prior_speed_mps=30", "prior_speed_mps 30 is above max_speed_mps 20"), ("spawn.max_speed_mps=.1", ">= 1"),
    ("spawn.min_speed_mps=30", "min_speed_mps 30 is above max_speed_mps 20"), ("limits.accel_max_mps2=.1", ">= 0.6"),
    ("drivers.turn_lateral_min_mps2=4", "turn_lateral_min_mps2 4 is above turn_lateral_max_mps2 3.5"),
    ("request.spawn_leaders=1", "request.spawn_leaders = 1, expected true, false"),
    ("request.own=mine:x=.2, other:x=1.0", "two of one name, expected a name for each"),
    ("request.own=mine:x=2", r"'mine:x=2', expected module:name=share, ... \(shares from 0 to 1\)"),
    ("lane_change.rule_with=foo=3", "rule paper reads incentive of it"), ("lane_change.rule_with=b=1,b=2", "b.*twice"),
    ("lane_change.rule_with=b=1.2.3", "rule_with = 'b=1.2.3', expected name=number, ..."),
    ("without=brakes", "without = .*brakes.*, expected any of topology, collision, smoothing"),
])  # fmt: skip
def test_an_override_that_is_wrong_is_named_with_value_and_range(override: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        configs.load_config(None, [override])


@pytest.mark.parametrize(("text", "said"), [
    ("[request]\nagents = '3'\n", "request.agents = '3', expected integer"),
    ("request = 3\n", "request = 3, expected a table"), ("[request.agents]\na = 1\n", "request.agents = {'a': 1}"),
    ('[[event]]\nkind = "cutin"\n', "event 1: kind = 'cutin', expected cut_in, overtake, lead,"),
    ('[[event]]\nkind = "cut_in"\nat_s = [1, 2, 3]\n', r"event 1: at_s = .*, expected \[least, largest\]"),
    ('[[event]]\nkind = "lead"\nbrakes_mps2 = -3\n', "brakes_mps2 = -3, expected number >= 0, <= 4.05"),
    ("without = 'all'\n", "without = 'all'"), ("event = ['cut_in']\n", "event 1: 'cut_in', expected a table with kind"),
    ("[turn]\nleft_trough = 0.9\n", "must be above left_trough 0.9"),
    ("[request]\nsites = 'any'\nnear = 'focal'\n", "near 'focal' with sites 'any'"),
])  # fmt: skip
def test_a_file_that_is_wrong_is_named_with_key_value_and_range(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "c.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=said) as caught:
        configs.load_config(path)
    assert "c.toml" in str(caught.value)


def test_behaviours_that_are_given_replace_all_shares() -> None:
    config = configs.load_config(None, [], configs.parse_behaviours("lane_change=1, overtake=0.5"))
    shares = {policy.value: share for policy, share in config.request.behaviours.items()}
    assert shares == {"straight": 0, "left_turn": 0, "right_turn": 0, "lane_change": 1, "overtake": 0.5}


@pytest.mark.parametrize(("text", "said"), [
    ("lane_chnge=1", "'lane_chnge=1', expected name=share of straight, left_turn"),
    ("lane_change", "expected name=share"), ("straight=a", "straight: 'a', expected a share"),
    ("straight=1,straight=0", "'straight' is given twice"),
    ("straight=2", "request.straight = 2.0, expected number >= 0, <= 1"),
    ("straight=nan", "request.straight = nan"), ("straight=0", "the behaviour shares sum to 0"),
])  # fmt: skip
def test_behaviours_that_are_wrong_are_named(text: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        configs.load_config(None, [], configs.parse_behaviours(text))


@pytest.mark.parametrize(("text", "low", "high"), [("2", 2, 2), ("0.5:4", 0.5, 4), (" 1 : 2 ", 1, 2)])
def test_trigger_time_is_a_time_a_range_or_a_list(text: str, low: float, high: float) -> None:
    request = configs.load_config(None, [], configs.parse_trigger_time(text)).request
    assert (request.trigger_min_s, request.trigger_max_s) == (low, high)
    assert configs.load_config(None, [], configs.parse_trigger_time("2, 4,6")).request.trigger_list_s == (2.0, 4.0, 6.0)


@pytest.mark.parametrize("text", ["", "a", "1:", "1:2:3", "4:1", "-1", "inf"])
def test_a_trigger_time_that_is_wrong_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match=r"trigger"):
        configs.load_config(None, [], configs.parse_trigger_time(text))


CHANGED = ["request.agents=max", "without=topology,collision", "turn.trough_at=0.3", "request.trigger_list_s=[1, 2.5]"]


@pytest.mark.parametrize("overrides", [[], CHANGED])
def test_toml_or_values_and_back(tmp_path: Path, overrides: list[str]) -> None:
    config = configs.load_config(None, overrides)
    path = tmp_path / "c.toml"
    path.write_text(configs.config_to_toml(config))
    assert configs.load_config(path) == configs.config_from_dict(configs.config_to_dict(config)) == config


def test_digest_names_the_configuration_whatever_the_hash_seed() -> None:
    """The ablations are a set, whose order changes from process to process."""
    code = (
        "from bridge.config import *; "
        "c = load_config(None, ['without=topology,collision,smoothing']); print(config_sha256(c), config_to_dict(c))"
    )
    command = [sys.executable, "-c", code]
    first, second = (
        subprocess.run(command, env={"PYTHONHASHSEED": seed}, capture_output=True, check=True).stdout for seed in "12"
    )
    assert first == second
    assert configs.config_sha256(configs.load_config()) != configs.config_sha256(
        configs.load_config(None, ["request.seed=1"])
    )


def test_every_parameter_is_described_by_whom_it_is_for() -> None:
    rows = {row.key: row for row in configs.describe_config()}
    assert len(rows) == sum(
        len(values) if isinstance(values, dict) else 1 for values in configs.config_to_dict(Config()).values()
    )
    assert all(row.default and row.unit and row.range and row.source for row in rows.values())
    assert rows["grid.cell_m"][2:5] == ("4.0", "m", "number >= 1, <= 20")
    assert rows["request.agents"].range == "integer >= 0, <= 500, or max"
    assert rows["request.trigger_list_s"][2:5] == ("none", "s", "list of numbers >= 0, <= 60")
    assert rows["without"][2:5] == ("none", "-", "any of topology, collision, smoothing")
    groups = [row.group for row in rows.values()]
    assert list(dict.fromkeys(groups)) == ["request", "paper", "drivers", "limits", "criticality", "expert"]
    assert groups == sorted(groups, key=list(GROUPS).index)


def test_drivers_of_a_file_are_flags_of_their_section(tmp_path: Path) -> None:
    path = tmp_path / "drivers.toml"
    path.write_text("[drivers]\noffset_sd_m = 0.4\n# tau_mean_s keeps its prior 1.15\n")
    assert configs.read_drivers(path) == {"drivers.offset_sd_m": 0.4}
    assert configs.load_config(None, ["drivers.offset_sd_m=0.2"], configs.read_drivers(path)).drivers.offset_sd_m == 0.2


@pytest.mark.parametrize(("text", "said"), [
    ("[drivers]\noffset_sd_m = 4.0\n", "drivers.offset_sd_m = 4.0, expected"),
    ("[drivers]\noffset = 0.4\n", "unknown key 'drivers.offset'"),
    ("[drivers]\n[request]\nagents = 3\n", "section or key request, expected [drivers] alone"),
    ("", "no section [drivers]"), ("[drivers", "not TOML"),
])  # fmt: skip
def test_a_file_of_drivers_that_is_wrong_is_refused(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "drivers.toml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        configs.read_drivers(path)
    assert said in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(("kinds", "values", "criticality", "said"), [
    ([], {"target": "av", "gap_m": "2:3"}, ["ttc=1:2"], "--target, --gap, --criticality without --event; say"),
    (["cut_in"], {"gap_m": "wide"}, [], "--gap: 'wide', expected A:B"),
    (["cut_in"], {"at_s": "late"}, [], "--at: 'late', expected A or A:B"),
    (["cut_in"], {}, ["ttc=1:2", "ttc=2:3"], "--criticality 'ttc=2:3': ttc is asked for twice"),
    (["cut_in"], {}, ["thw=1:2"], "--criticality 'thw=1:2': expected ttc=A:B"),
    (["cut_in"], {}, ["ttc=low"], "--criticality ttc: 'low', expected A:B"),
])  # fmt: skip
def test_options_of_events_that_are_wrong_are_named(
    kinds: list[str], values: dict[str, str], criticality: list[str], said: str
) -> None:
    with pytest.raises(ConfigError, match=said):
        configs.parse_events(kinds, values, criticality)


@pytest.mark.parametrize("name", ["gap_m", "speed_difference_mps", "ttc_s", "drac_mps2"])
def test_band_of_an_event_has_two_ends_and_a_moment_need_not(name: str) -> None:
    """Nothing driven meets one value exactly; a moment has `event_search.moment_s` to both sides."""
    Event.model_validate({"kind": "cut_in", "at_s": 3.0, name: [2.0, 3.0]})
    for one in (2.0, [2.0, 2.0]):
        with pytest.raises(ValueError, match=f"{name} 2, expected a band of two values"):
            Event.model_validate({"kind": "cut_in", name: one})


@pytest.mark.parametrize(
    ("kind", "name", "low"), [("lead", "ttc_s", 10), ("cross", "pet_s", 11), ("follow", "drac_mps2", 0)]
)
def test_band_that_no_event_of_its_kind_can_be_within_is_refused(kind: str, name: str, low: float) -> None:
    """TTC and PET are told below 10 s, and the target of a follow is ahead. Just below, or in a lead, one can."""
    with pytest.raises(ValueError, match=r"less than 10 s: more is not told|follow, expected another kind"):
        Event.model_validate({"kind": kind, name: [low, 20.0]})
    Event.model_validate({"kind": "lead" if kind == "follow" else kind, name: [min(low, 9.9), 20.0]})


def test_key_of_an_earlier_version_is_taken_with_the_value_of_the_method_and_answered_with_another(
    tmp_path: Path,
) -> None:
    """All of them: a file of all parameters of an earlier version is one that asks for nothing."""
    removed = tomllib.loads(REMOVED.read_text())
    instead = removed.pop("instead")
    keys = {f"{section}.{name}": value for section, names in removed.items() for name, value in names.items()}
    known = {row.key for row in configs.describe_config()}
    assert set(instead) <= set(keys)
    assert set(instead.values()) <= known
    assert not known & set(keys)
    old = tmp_path / "old.toml"
    old.write_text(REMOVED.read_text().split("\n\n", 2)[2])
    assert configs.load_config(old) == Config()
    for key, value in keys.items():
        assert configs.load_config(None, [f"{key}={value}"]) == Config()
        with pytest.raises(ConfigError, match=f"{key} = .*no parameter any more.*{instead.get(key, '')}"):
            configs.load_config(None, [f"{key}=77"])
