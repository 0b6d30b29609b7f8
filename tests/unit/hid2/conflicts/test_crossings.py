"""A crossing of 3.4 m from y = -6 to 6 over the x axis, which a vehicle of 2 m in width drives along."""

from collections.abc import Callable

import numpy as np
import pytest
from hand_drawn import draw_box

from hid2.conflicts.stop_lines import CrossingOnPath, PedestrianCrossings
from hid2.motion.route import DrivenPath
from hid2.occupancy.traffic import Traffic

QUAD = np.array([(99.8, -6.0), (99.8, 6.0), (103.2, 6.0), (103.2, -6.0)])
#: Every agent counts that is anywhere on the crossing.
WIDE = {"_STRIP_M": 5.0, "_STRIP_S": 20.0}
UP = np.pi / 2


@pytest.fixture
def look(straight_path: DrivenPath, monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[CrossingOnPath]]:
    def on(*walkers: Traffic, quads: tuple[np.ndarray, ...] = (QUAD,), width_m: float = 2.0, **changed: float):
        for name, value in changed.items():
            monkeypatch.setattr(f"hid2.conflicts.stop_lines.{name}", value)
        return PedestrianCrossings(np.reshape(quads, (-1, 4, 2)), walkers[0].joined(*walkers[1:]), 0.1).on(
            straight_path, width_m
        )

    return on


def _steps(found: list[CrossingOnPath]) -> list[int]:
    (one,) = found
    return np.flatnonzero(one.occupied).tolist()


def test_crossings_of_a_path_are_known_by_arc_length(look) -> None:
    """Points of the path every 0.5 m: the first on the crossing is at 100, the last at 103. In the order of driving."""
    nobody = draw_box(0.0, 0.0).rows([])
    second = QUAD - np.array([50.0, 0.0])
    found = look(nobody, quads=(QUAD, second))
    assert [(one.entry_m, one.exit_m) for one in found] == [(50.0, 53.0), (100.0, 103.0)]
    assert not found[0].occupied.any()
    assert found[0].occupied.shape == (110,)
    assert look(nobody, quads=()) == []


@pytest.mark.parametrize(("width_m", "count"), [(2.0, 1), (1.6, 0)])
def test_only_crossings_that_the_swept_width_touches_count(look, width_m: float, count: int) -> None:
    """A crossing that ends 0.9 m beside the path: half of 2 m reaches it, half of 1.6 m does not."""
    assert len(look(draw_box(0.0, 0.0), quads=(QUAD + np.array([0.0, 6.9]),), width_m=width_m)) == count


@pytest.mark.parametrize(
    ("changed", "first", "last"),
    [
        ({}, 11, 60),  # 3 s before the strip, 1 + 1 m to each side, which is walked on from step 41 to 60
        (WIDE, 6, 80),  # 1.5 s before the crossing, |y| < 6, which is walked on from step 21 to 80
        ({**WIDE, "_AHEAD_S": 0.0}, 16, 80),  # within 1 m of it, y > -7; behind it, at step 81, it walks away
    ],
)
def test_a_pedestrian_holds_up_from_before_it_is_in_the_way_until_it_has_left(
    look, changed: dict[str, float], first: int, last: int
) -> None:
    """y = -10.05 + 0.2 step."""
    assert _steps(look(draw_box(101.5, -10.05, UP, 2.0), **changed)) == list(range(first, last + 1))


@pytest.mark.parametrize(("y", "steps"), [(1.9, list(range(110))), (2.1, [])])
def test_who_stands_on_the_crossing_is_waited_for_where_the_vehicle_passes(look, y: float, steps: list) -> None:
    """The strip reaches 1 m beyond the vehicle's side: to y = 2."""
    assert _steps(look(draw_box(101.5, y, UP, 0.0))) == steps


def test_who_moves_along_the_path_is_absent_turns_back_or_stands_beside_does_not_cross_it(look) -> None:
    """A cyclist that rides ahead over the crossing at 5 m/s, or comes the other way; one at 50 degrees crosses.

    Of one that stands in the way, seen from step 40 on, nobody knows before. One stands 0.5 m beside the end of the
    crossing, or walks away from there.
    """
    assert _steps(look(draw_box(90.0, 0.0, 0.0, 5.0))) == []
    assert _steps(look(draw_box(110.0, 0.0, np.pi, 5.0))) == []
    assert _steps(look(draw_box(99.0, -3.0, np.radians(50.0), 5.0))) != []
    assert _steps(look(draw_box(101.5, 0.0, UP, 0.0, first=40))) == list(range(40, 110))
    assert _steps(look(draw_box(101.5, -6.5, UP, 0.0), **WIDE)) == []
    assert _steps(look(draw_box(101.5, -6.5, -UP, 1.0), **WIDE)) == []
