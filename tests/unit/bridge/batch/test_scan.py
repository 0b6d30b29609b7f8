"""Facts of scenes, and the choice among them."""

import csv
from collections.abc import Callable
from pathlib import Path

import pytest
from written import edit_rows, standing

from bridge.batch import scan
from bridge.batch.scan import EVENTS, SceneFacts, Selection, describe_scene, facts_of, select, wanted
from netconvert.errors import ConfigError


def fact(scenario: str, **values: object) -> SceneFacts:
    texts = ("folder", "scenario", "split", "city", "events")
    zeros = {name: 0 for name in SceneFacts._fields if name not in texts}
    return SceneFacts(Path(scenario), scenario, "val", "miami", **zeros, events="")._replace(**values)


FACTS = [
    fact("a", tracks=30, lane_change_m=100.0, events="cut_in:av lead:focal"),
    fact("b", tracks=50, city="austin", left_turns=2),
    fact("c", tracks=70, lane_change_m=10.0, left_turns=1, split="train"),
]


@pytest.mark.parametrize(("selection", "names"), [
    (Selection(), "abc"), (Selection(min_agents=50), "bc"), (Selection(cities=("Austin",)), "b"),
    (Selection(splits=("val",)), "ab"), (Selection(can=("lane_change",)), "ac"),
    (Selection(can=("lane_change", "left_turn")), "c"), (Selection(can=("right_turn",)), ""),
    (Selection(can=("cut_in:av", "lane_change")), "a"), (Selection(can=("cut_in:focal",)), ""),
    (Selection(sample=5), "abc"),
])  # fmt: skip
def test_selection(selection: Selection, names: str) -> None:
    assert [chosen.scenario for chosen in select(FACTS, selection)] == list(names)


def test_vehicles_that_stand_and_jitter_do_not_move(copy_scene: Callable[..., Path]) -> None:
    """To and fro by 10 cm at each of 109 steps: paths of 10.9 m that extend over nothing."""
    scene = copy_scene("curve")
    edit_rows(scene, lambda rows: standing(rows, jitter_m=0.1))
    assert describe_scene((), scene).moving == 0


def test_events_that_can_be_looked_for_are_those_that_the_page_and_the_help_name(
    data_scenes: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """All at once, as --events does; overtake is a policy and a kind of event. Without the seconds of the searches."""
    assert {name.partition(":")[2] for name in EVENTS} == {"av", "focal"}
    assert "looks for all, with av and focal" in Path("bridge/generation/README.md").read_text()
    monkeypatch.setattr(scan, "offered_events", lambda _, names: tuple(names))
    assert describe_scene(EVENTS, data_scenes["curve"]).events.split() == list(EVENTS)
    assert facts_of([], EVENTS) == ([], [])
    near = ("fly", "straight, "), ("cut_in:any", "cut_in:av, cut_in:focal$"), ("lane-change:av", "lane_change$")
    for name, expected in near:
        with pytest.raises(ConfigError, match=f"--can '{name}': expected one of {expected}"):
            facts_of([], (name,))


def test_sample_is_drawn_with_the_seed_and_takes_all_and_warns_where_there_are_fewer(
    caplog: pytest.LogCaptureFixture,
) -> None:
    many = [fact(str(number)) for number in range(100)]
    first = select(many, Selection(sample=10, seed=1))
    assert len(first) == 10
    assert select(many, Selection(sample=10, seed=1)) == first != select(many, Selection(sample=10, seed=2))
    assert [many.index(chosen) for chosen in first] == sorted(many.index(chosen) for chosen in first)
    assert first[::-1] == select(many[::-1], Selection(sample=10, seed=1)), "whatever the order of paths"
    assert select(many[:3], Selection(sample=3)) == many[:3]
    assert caplog.text == ""
    assert select(many[:3], Selection(sample=5)) == many[:3]
    assert "--sample 5: only 3 scenes are there" in caplog.text


def test_scene_that_cannot_be_read_is_tried_with_those_selected(monkeypatch: pytest.MonkeyPatch) -> None:
    """It may be wanted, and its reason is then where those of others are; it is in no sample, and not enough alone."""
    unread = [(Path("d"), "no map")]
    monkeypatch.setattr(scan, "facts_of", lambda at, *_, **__: ([one for one in FACTS if one.folder in at], unread))
    folders = [Path(name) for name in "dabc"]
    assert wanted(folders, Selection(min_agents=60)) == ([Path("d"), Path("c")], unread)
    assert wanted(folders, Selection(sample=3)) == (folders[1:], unread)
    with pytest.raises(ConfigError, match=r"none of 2 scenes is left by the selection"):
        wanted(folders[:2], Selection(min_agents=60))


def test_synthetic_maps_offer_what_they_were_made_for(data_scenes: dict[str, Path]) -> None:
    """On the arterial a vehicle can drive ahead of the focal track; events that are not asked for are not told."""
    facts = {name: describe_scene((), folder) for name, folder in data_scenes.items()}
    assert min(facts["arterial"].lane_change_m, facts["arterial"].overtake_m) > 500
    assert min(facts["intersection"].left_turns, facts["intersection"].right_turns) >= 4
    assert facts["curve"].lane_change_m == pytest.approx(304.0 + 296.0 - 2 * 25.0, abs=0.2)  # two lanes, one way
    assert describe_scene(("lead:focal",), data_scenes["arterial"]).events == "lead:focal"
    assert {found.events for found in facts.values()} == {""}
    assert all(found.at_49 <= found.tracks and found.moving <= found.vehicles for found in facts.values())


def test_real_scenes_have_the_figures_of_their_list_and_one_that_cannot_be_read_is_listed(
    real_scenes: list[Path], shared_data: Path, tmp_path: Path
) -> None:
    """Compared with av2_scenarios.csv, which was made by other means; of nine left turns one ends with the map."""
    with (shared_data / "av2_scenarios.csv").open() as file:
        listed = {next(iter(row.values())): row for row in csv.DictReader(file)}
    facts, failures = facts_of([real_scenes[0], tmp_path, real_scenes[4]])
    assert ([folder for folder, _ in failures], [one.left_turns for one in facts]) == ([tmp_path], [6, 8])
    for found in facts:
        (row,) = [row for key, row in listed.items() if found.scenario.startswith(key[:8])]
        assert (found.city, found.tracks, found.lanes) == (row["city"], int(row["tracks"]), int(row["lanes"]))
