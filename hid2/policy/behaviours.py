"""The behaviours that a vehicle can be asked for: one record for each policy of the paper, iterated everywhere else.

A sixth one is such a record in a module of a user's own, which `request.own` names (`load_own`).
"""

import importlib
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from pydantic import ConfigDict, TypeAdapter, ValidationError

from hid2.agents import Policy
from hid2.measures.manoeuvres import Maneuver, ManeuverKind
from hid2.occupancy.agent_states import AgentStates
from hid2.policy.rules import place_in
from hid2.reasons import Reason
from netconvert.errors import ConfigError
from netconvert.lane_graph import SIDES, Side, TurnType


@dataclass(frozen=True, slots=True)
class Behaviour:
    """One behaviour."""

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(strict=True, revalidate_instances="always")
    policy: Policy
    label: str
    """As a reader would say it."""
    short: str
    """As in the figures of the paper."""
    seen_as: tuple[ManeuverKind, ...]
    """What the detectors call it when a vehicle does it, the usual one first; none: it does nothing else."""
    no_map: Reason
    """Why no vehicle does it where the map has no place for it."""
    site_order: int
    """Requests choose their sites in this order: what needs the most room first."""
    mark: str = ""
    """Matplotlib's marker of the place where it was done; none: nothing to mark."""
    turn: TurnType | None = None
    """The map must offer a lane that turns so."""
    sides: tuple[Side, ...] = ()
    """It changes lanes once, to one of these sides; none: it does not, or comes back."""
    is_shown: Callable[[AgentStates, Maneuver], bool] = lambda states, seen: True
    """Whether one of a kind of `seen_as`, seen in the exported states of its vehicle alone, is what was asked for."""

    @property
    def changes_lanes(self) -> bool:
        """Whether a vehicle that does it leaves its lane for one beside."""
        return bool(self.sides) or self.policy is Policy.OVERTAKE


#: Behaviours by policy, the commonest first: of several that a vehicle shows, the last one counts.
BEHAVIOURS: dict[Policy, Behaviour] = {
    behaviour.policy: behaviour
    for behaviour in (
        Behaviour(Policy.STRAIGHT, "straight", "ST", (), Reason.MAP_OFFERS_NO_LANE, 5),
        Behaviour(
            Policy.RIGHT_TURN,
            "right turn",
            "RT",
            (ManeuverKind.RIGHT_TURN,),
            Reason.MAP_OFFERS_NO_RIGHT_TURN,
            3,
            mark=">",
            turn=TurnType.RIGHT,
        ),
        Behaviour(
            Policy.LEFT_TURN,
            "left turn",
            "LT",
            (ManeuverKind.LEFT_TURN,),
            Reason.MAP_OFFERS_NO_LEFT_TURN,
            2,
            mark="<",
            turn=TurnType.LEFT,
        ),
        Behaviour(
            Policy.LANE_CHANGE,
            "lane change",
            "LC",
            (ManeuverKind.LANE_CHANGE, ManeuverKind.PASS, ManeuverKind.OBSTACLE_AVOIDANCE),
            Reason.MAP_OFFERS_NO_LANE_CHANGE,
            4,
            mark="D",
            sides=SIDES,
        ),
        Behaviour(
            Policy.OVERTAKE, "overtake", "OT", (ManeuverKind.OVERTAKE,), Reason.MAP_OFFERS_NO_OVERTAKE, 1, mark="*"
        ),
    )
}
#: The paper's policy of a vehicle on a lane that turns.
POLICY_OF_TURN: Mapping[TurnType, Policy] = {
    behaviour.turn: policy for policy, behaviour in BEHAVIOURS.items() if behaviour.turn is not None
}
#: What one of a user's own is seen as that is driven so: by its turn, None for a lane change.
_DRIVEN = {one.turn: one.seen_as[:1] for one in BEHAVIOURS.values() if one.turn is not None or one.sides}
_SEEN = {kind: behaviour for behaviour in BEHAVIOURS.values() for kind in behaviour.seen_as}


def behaviour_seen(kind: ManeuverKind) -> Behaviour:
    """The behaviour that a manoeuvre seen belongs to. Errors: KeyError for a kind that no behaviour names."""
    return _SEEN[kind]


def is_shown(policy: Policy, states: AgentStates, seen: Maneuver) -> bool:
    """What `Behaviour.is_shown` says. Errors: ConfigError with file and line where a user's own gives no answer."""
    asks = BEHAVIOURS[policy].is_shown
    try:
        answer: object = asks(states, seen)
    except Exception as error:  # whatever a user's code may raise
        said = f"{place_in(error, asks, __file__)}{type(error).__name__}: {error!s:.200}"
        raise ConfigError(f"request.own: {policy}: is_shown: {said}; expected True or False") from error
    if not isinstance(answer, bool | np.bool_):
        said = f"{place_in(None, asks)}it answered {answer!r:.100}"
        raise ConfigError(f"request.own: {policy}: is_shown: {said}, expected True or False")
    return bool(answer)


def load_own(names: Collection[str]) -> dict[str, Policy]:
    """Import behaviours of a user's own, "module:name", so that they can be asked for; their policies by these names.

    Errors: ConfigError for what cannot be imported, is no `Behaviour`, has another name, is not seen as driven.
    """
    loaded = {}
    for name in names:
        module, _, policy = name.partition(":")
        try:
            found = getattr(importlib.import_module(module), policy)
        except (Exception, SystemExit) as error:  # whatever a user's code may raise
            said = f"{type(error).__name__}: {error!s:.200}"
            raise ConfigError(f"request.own: {name!r}: {said}; expected a module that Python finds here") from error
        wanted = f"a Behaviour of Policy({policy!r}), which is none of the paper's"
        if not isinstance(found, Behaviour) or found.policy != policy or found.policy in tuple(Policy):
            raise ConfigError(f"request.own: {name!r} is {found!r:.200}, expected {wanted}")
        try:
            TypeAdapter(Behaviour).validate_python(found)
        except ValidationError as error:
            first = error.errors()[0]
            said = f"{first['loc'][0]} = {first['input']!r:.100}, {first['msg'].replace('Input should be', 'expected')}"
            raise ConfigError(f"request.own: {name!r}: {said}") from error
        if bool(found.sides) is (found.turn is not None) or found.seen_as[:1] != _DRIVEN.get(found.turn):
            wanted = "sides and seen_as = (ManeuverKind.LANE_CHANGE,), or a turn and its kind"
            raise ConfigError(f"request.own: {name!r}: expected {wanted}")
        BEHAVIOURS[found.policy], loaded[name] = found, found.policy
    return loaded
