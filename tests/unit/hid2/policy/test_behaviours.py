"""The records of behaviours: none is missing wherever one is named."""

from collections import Counter

from hid2.agents import Policy
from hid2.measures.manoeuvres import TURNS, ManeuverKind
from hid2.params import Request
from hid2.policy.behaviours import BEHAVIOURS, behaviour_seen
from netconvert.lane_graph import TurnType


def test_every_policy_has_one_record_and_a_share_in_a_request() -> None:
    assert set(BEHAVIOURS) == set(Policy)
    assert all(behaviour.policy is policy for policy, behaviour in BEHAVIOURS.items())
    assert set(Request().behaviours) == set(BEHAVIOURS)
    for field in ("label", "short", "site_order", "no_map"):
        names = Counter(getattr(behaviour, field) for behaviour in BEHAVIOURS.values())
        assert names.most_common(1)[0][1] == 1, field


def test_every_kind_that_detectors_tell_apart_belongs_to_one_behaviour() -> None:
    kinds = Counter(kind for behaviour in BEHAVIOURS.values() for kind in behaviour.seen_as)
    assert kinds == Counter(ManeuverKind)
    assert all(kind in behaviour_seen(kind).seen_as for kind in ManeuverKind)
    assert [policy for policy, behaviour in BEHAVIOURS.items() if not behaviour.seen_as] == [Policy.STRAIGHT]


def test_every_turn_of_a_map_is_a_behaviour_that_is_detected() -> None:
    turning = [behaviour.turn for behaviour in BEHAVIOURS.values() if behaviour.turn is not None]
    assert Counter(turning) == Counter(turn for turn in TurnType if turn is not TurnType.STRAIGHT)
    assert {behaviour_seen(kind).turn for kind in TURNS.values()} == {TurnType.LEFT, TurnType.RIGHT}
