"""The behaviours that a vehicle can be asked for: one record for each policy of the paper, iterated everywhere else.

A sixth policy is a member of `Policy`, a share in `params.Request`, a record here, a detector in
`measures.manoeuvres`, and a colour in the pictures; a test says which of them is missing.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from hid2.agents import Policy
from hid2.measures.manoeuvres import ManeuverKind
from hid2.params import Config
from hid2.policy.overtake import stretch_m
from netconvert.lane_graph import TurnType


@dataclass(frozen=True, slots=True)
class Behaviour:
    """One behaviour. turn, beside_m: what the map must offer beyond a lane; both None: nothing."""

    policy: Policy
    label: str
    """As a reader would say it."""
    short: str
    """As in the figures of the paper."""
    seen_as: tuple[ManeuverKind, ...]
    """What the detectors call it when a vehicle does it, the usual one first; none: whoever does nothing else."""
    turn: TurnType | None = None
    """The map must offer a lane that turns so."""
    beside_m: Callable[[Config], float] | None = None
    """The map must offer a same-direction lane beside, that may be changed to, for so many metres."""


#: By policy, the commonest first: of several that a vehicle shows, the last one counts.
BEHAVIOURS: Mapping[Policy, Behaviour] = {
    behaviour.policy: behaviour
    for behaviour in (
        Behaviour(Policy.STRAIGHT, "straight", "ST", ()),
        Behaviour(Policy.RIGHT_TURN, "right turn", "RT", (ManeuverKind.RIGHT_TURN,), turn=TurnType.RIGHT),
        Behaviour(Policy.LEFT_TURN, "left turn", "LT", (ManeuverKind.LEFT_TURN,), turn=TurnType.LEFT),
        Behaviour(
            Policy.LANE_CHANGE,
            "lane change",
            "LC",
            (ManeuverKind.LANE_CHANGE, ManeuverKind.PASS, ManeuverKind.OBSTACLE_AVOIDANCE),
            beside_m=lambda config: config.lane_change.min_remaining_m,
        ),
        Behaviour(
            Policy.OVERTAKE,
            "overtake",
            "OT",
            (ManeuverKind.OVERTAKE,),
            beside_m=stretch_m,
        ),
    )
}
_SEEN = {kind: behaviour for behaviour in BEHAVIOURS.values() for kind in behaviour.seen_as}


def behaviour_seen(kind: ManeuverKind) -> Behaviour:
    """The behaviour that a manoeuvre seen belongs to. Errors: KeyError for a kind that no behaviour names."""
    return _SEEN[kind]
