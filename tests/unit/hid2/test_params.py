from itertools import product

import pytest
from pydantic import BaseModel, ValidationError

from hid2.agents import Policy
from hid2.params import Config, LaneChange, Request, Turn


@pytest.mark.parametrize(
    ("section", "values", "named"),
    [
        (Request, {"trigger_min_s": 3.0, "trigger_max_s": 2.0}, "trigger_max_s"),
        (Request, dict.fromkeys(Policy, 0.0), "shares sum to 0"),
        (Request, {"bus_share": 0.6, "truck_share": 0.6}, "bus_share"),
        (LaneChange, {"min_duration_s": 5.0, "max_duration_s": 4.0}, "max_duration_s"),
        (Turn, {"left_trough": 0.8, "right_trough": 0.8}, "f_right > f_left"),
        (Request, {"agents": -1}, "agents"),
        (Request, {"agent": 1}, "agent"),
        (Turn, {"trough_at": float("nan")}, "trough_at"),
    ],
)
def test_values_that_contradict_each_other_are_refused_by_name(
    section: type[BaseModel], values: dict[str, float], named: str
) -> None:
    with pytest.raises(ValidationError, match=named):
        section(**values)


def test_configuration_is_frozen() -> None:
    with pytest.raises(ValidationError, match="frozen"):
        Config().request.agents = 3  # type: ignore[misc]


def test_ablations_are_the_three_of_the_paper() -> None:
    for some in product((True, False), repeat=3):
        names = {name for name, chosen in zip(("topology", "collision", "smoothing"), some, strict=True) if chosen}
        assert Config(without=frozenset(names)).without == names  # type: ignore[arg-type]
    with pytest.raises(ValidationError):
        Config(without=frozenset({"grid"}))  # type: ignore[arg-type]
