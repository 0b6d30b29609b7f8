"""The names of the policies; a module of its own, so that reading a configuration imports no numpy."""

from collections.abc import Iterator
from typing import ClassVar

from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

_PAPER = "straight", "left_turn", "right_turn", "lane_change", "overtake"


class _Names(type):
    def __iter__(cls) -> "Iterator[Policy]":
        """Those of the paper."""
        return map(Policy, _PAPER)

    def __len__(cls) -> int:
        return len(_PAPER)


class Policy(str, metaclass=_Names):
    """The paper's policy_i (section Agent Policy), or one of a user's own, by its name: one object for each name."""

    __slots__ = ()
    STRAIGHT: "ClassVar[Policy]"
    LEFT_TURN: "ClassVar[Policy]"
    RIGHT_TURN: "ClassVar[Policy]"
    LANE_CHANGE: "ClassVar[Policy]"
    OVERTAKE: "ClassVar[Policy]"
    _known: "ClassVar[dict[str, Policy]]"

    def __new__(cls, name: str) -> "Policy":
        """The policy of a name."""
        return cls._known.setdefault(str(name), super().__new__(cls, name))

    @property
    def value(self) -> str:
        """Its name."""
        return str.__str__(self)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_after_validator_function(cls, core_schema.str_schema(pattern=r"^[A-Za-z_]\w*$"))


Policy._known = {}
for _name in _PAPER:
    setattr(Policy, _name.upper(), Policy(_name))
