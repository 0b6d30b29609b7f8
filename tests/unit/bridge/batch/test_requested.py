"""What was asked for by name, and what of it came about nowhere, by the rows of a manifest."""

from dataclasses import replace

import pytest

from bridge.batch.manifest import DONE, QUARANTINED, ManifestRow
from bridge.batch.requested import came_about_nowhere, named_behaviours
from hid2.params import Config, Event, Request
from hid2.policies import Policy
from hid2.policy.behaviours import BEHAVIOURS

EVENTS = Config(event=(Event(kind="cut_in"), Event(kind="lead", target="x: y", count=2)))
NAMED = (Policy.LANE_CHANGE, Policy.OVERTAKE)


def row(**values: object) -> ManifestRow:
    return ManifestRow("a", "val", 0, 0, DONE, placed=2)._replace(**values)


@pytest.mark.parametrize(("rows", "nowhere"), [
    ([row(not_done="cut_in with av: event_no_place (1)")], ["cut_in with av"]),
    ([row(not_done="cut_in with av: event_no_place (1)"), row()], []),
    ([row(not_done="lead with x: y: event_no_place (1)")], []),
    ([row(not_done="lead with x: y: event_no_place (1); lead with x: y: no (1)")], ["lead with x: y"]),
    ([row(not_done="overtake: no_leader (2); lane_change: left:front_gap (1)", lane_change=1)], ["overtake"]),
    ([row(not_done="overtake: no_leader (2)"), row(overtake=1)], []),
    ([row(not_done="right_turn: no_site (2)")], []), ([row(placed=0), row(placed=0)], ["any vehicle"]),
    ([row(placed=0), row()], []), ([row(status=QUARANTINED, placed=0)], []), ([], []),
])  # fmt: skip
def test_what_came_about_in_none_of_the_scenes_is_named(rows: list[ManifestRow], nowhere: list[str]) -> None:
    assert came_about_nowhere(rows, EVENTS, NAMED) == nowhere


def test_no_vehicle_is_missed_where_none_was_asked_for() -> None:
    assert came_about_nowhere([row(placed=0)], Config(request=Request(agents=0)), ()) == []


def test_behaviour_of_ones_own_is_missed_by_what_it_is_seen_as(monkeypatch: pytest.MonkeyPatch) -> None:
    own = replace(BEHAVIOURS[Policy.LANE_CHANGE], policy=Policy("keep_right"))
    monkeypatch.setitem(BEHAVIOURS, own.policy, own)
    rows, config = [row(not_done="lane_change: lane_ends (2)")], Config(request=Request(own="mine:keep_right=1"))
    found = [came_about_nowhere(each, config, [own.policy]) for each in (rows, [*rows, row(lane_change=1)])]
    assert found == [["keep_right"], []]


def test_behaviours_are_named_by_the_option_or_by_another_share_than_the_usual() -> None:
    """The usual shares: straight .6, turns .1, lane changes .15, overtakes .05."""
    assert named_behaviours(Request(), by_option=False) == ()
    assert named_behaviours(Request(overtake=0.3, left_turn=0.0, straight=0.2), by_option=False) == (Policy.OVERTAKE,)
    option = Request(straight=0.5, lane_change=0.15, overtake=0.0, left_turn=0.0, right_turn=0.0)
    assert named_behaviours(option, by_option=True) == (Policy.LANE_CHANGE,)
