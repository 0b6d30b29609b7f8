"""Every behaviour has its colour, its name and its mark in pictures, and its kind in the sidecar."""

from typing import get_args

from matplotlib.lines import Line2D

from bridge.batch.manifest import ManifestRow
from bridge.batch.scan import ROOM, SceneFacts
from bridge.pictures import figures
from bridge.recordings.sidecar import ManeuverKind
from bridge.sumo.exchange import GUI_FACES
from hid2.policy.behaviours import BEHAVIOURS


def test_every_behaviour_has_a_colour_of_its_own_in_pictures_and_in_sumo_gui() -> None:
    for colours in (figures.POLICY_COLORS, {policy: GUI_FACES[policy.value] for policy in BEHAVIOURS}):
        assert set(colours) == set(BEHAVIOURS)
        assert len(set(colours.values())) == len(BEHAVIOURS)


def test_every_manoeuvre_that_can_be_asked_for_has_a_mark_and_a_kind_in_the_sidecar() -> None:
    asked = {behaviour.seen_as[0].value for behaviour in BEHAVIOURS.values() if behaviour.seen_as}
    assert set(get_args(ManeuverKind)) == asked
    marked = [behaviour.mark for behaviour in BEHAVIOURS.values() if behaviour.seen_as]
    assert len(set(marked)) == len(asked)
    assert all(mark in Line2D.markers and mark != " " for mark in marked)


def test_every_behaviour_is_counted_in_scans_and_manifests() -> None:
    assert set(ROOM) == {policy.value for policy in BEHAVIOURS}
    assert len({*ROOM.values()} & {*SceneFacts._fields}) == len(BEHAVIOURS)
    assert {policy.value for policy in BEHAVIOURS} <= set(ManifestRow._fields)
