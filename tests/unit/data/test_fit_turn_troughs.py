"""The script that fits the shapes of turns to recorded ones."""

import importlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hand_drawn import draw_track

from bridge.config import load_config
from hid2.measures.arrays import stack
from hid2.params import Turn
from hid2.policy.roads import turn_shape


@pytest.fixture(scope="module")
def script(data_root: Path) -> Iterator[ModuleType]:
    """The script lies in the folder of the synthetic data, outside any package."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.syspath_prepend(str(data_root.parent))
        yield importlib.import_module("fit_turn_troughs")


def _turns(script: ModuleType, *, left: int, right: int, left_trough: float = 0.6, right_trough: float = 0.8):
    """Turns of a shape, half of them 0.05 above it and half as much below: their median is the shape."""
    return [
        (side, turn_shape(script.ALPHA, trough, 0.35) + (0.05 if k % 2 else -0.05))
        for side, count, trough in (("left", left, left_trough), ("right", right, right_trough))
        for k in range(count)
    ]


def test_troughs_of_both_sides_and_their_place_are_recovered(script: ModuleType) -> None:
    turn, lines = script.report(_turns(script, left=20, right=24), 3, prior=Turn())
    assert (turn.left_trough, turn.right_trough, turn.trough_at) == (0.6, 0.8, 0.35)
    assert lines[1].startswith("left: 20 turns; trough 0.600 at 0.35")


def test_a_side_with_few_turns_keeps_the_prior_and_says_so_as_do_fits_that_contradict_the_paper(
    script: ModuleType,
) -> None:
    """Fewer than twenty turns; f_right > f_left."""
    prior = Turn()
    turn, lines = script.report(_turns(script, left=19, right=0), 1, prior=prior)
    assert turn == prior
    assert "left: 19 turns; fewer than 20: the prior stays" in lines[1]
    assert lines[2].startswith("right: 0 turns; fewer than 20: the prior stays")
    turn, lines = script.report(_turns(script, left=20, right=20, right_trough=0.5), 1, prior=prior)
    assert turn == prior
    assert "right 0.5 is not above left 0.6" in lines[-1]


def test_turns_of_the_synthetic_intersection_are_found(
    script: ModuleType, data_root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One car turns left over its whole lane; another one turns right and is seen to 0.88 of its lane only."""
    script.main([data_root])
    written, said = capsys.readouterr()
    out = tmp_path / "turn.toml"
    out.write_text(written)
    assert "3 scenes" in said
    assert "left: 1 turns" in said
    assert "right: 0 turns" in said
    assert load_config(out, []).turn == Turn()


def test_profile_is_speed_over_speed_at_the_entrance(script: ModuleType) -> None:
    """20 m before a lane of 20 m at 10 m/s, then slower by 2.5 m/s2 to 5 m/s, which takes 2 s and 15 m.

    At 18 m, alpha = 0.9, the filter of 1.1 s is past the change: 5 m/s. At the entrance it sees 0.5 s of slowing.
    """
    t = 0.1 * np.arange(80)
    slowing = np.clip(t - 2.0, 0.0, 2.0)
    s = -20 + 10 * np.minimum(t, 2.0) + 10 * slowing - 1.25 * slowing**2 + 5 * np.maximum(t - 4.0, 0.0)
    car = draw_track(range(len(s)), s, heading=np.linspace(0.0, 2.0, len(s)))
    arrays = stack([car], step_s=0.1)
    inside = np.flatnonzero((s > -0.01) & (s <= 20))
    profile = script._profile(arrays, 0, inside[0], inside[-1], s[inside] / 20, sign=1)
    assert profile[0] == 1.0
    assert 5.0 / 10.0 < profile[18] < 5.0 / 9.5
    jump = replace(car, position=np.column_stack([np.where(s > 8, s + 3.0, s), np.zeros(len(s))]))
    unclean = script._profile(stack([jump], step_s=0.1), 0, inside[0], inside[-1], s[inside] / 20, sign=1)
    assert unclean is None
    assert script._profile(arrays, 0, inside[0], inside[-1], s[inside] / 20, sign=-1) is None
    assert script._profile(arrays, 0, inside[0], inside[3], s[inside[:4]] / 20, sign=1) is None  # a part of the lane
