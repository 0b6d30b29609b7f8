"""Spread of start sites over seeds and variants."""

import numpy as np
import pytest

from hid2.insertion.spread import Spread, by_weight


def _first(seed: int, variant: int, weight: np.ndarray, number: int = 0, of: int = 1) -> int:
    spread = Spread.of([seed, variant, 7])
    order = spread.order(weight, np.random.default_rng(0), number=number, of=of, kind=0, round_number=0)
    return int(order[0])


@pytest.mark.parametrize("by", ["variant", "seed"])
def test_seeds_and_variants_cover_the_sites_instead_of_repeating_them(by: str) -> None:
    """20 variants (or seeds) over 100 sites of one weight: no site twice, and none of ten stretches is left out.

    Five of five vehicles of one scene: one in each fifth of the line, wherever it begins.
    """
    weight = np.ones(100)
    first = [_first(0, k, weight) if by == "variant" else _first(k, 0, weight) for k in range(20)]
    assert len(set(first)) == 20
    assert len({site // 10 for site in first}) == 10
    of_one = sorted(_first(3, 4, weight, number, 5) for number in range(5))
    assert all(15 <= gap <= 25 for gap in np.diff(of_one))


def test_heavier_sites_come_first_more_often() -> None:
    """One half of the sites weighs three times as much as the other: three of four vehicles begin there."""
    weight = np.repeat([3.0, 1.0], 50)
    first = np.array([_first(0, variant, weight) for variant in range(400)])
    assert (first < 50).mean() == pytest.approx(0.75, abs=0.02)


def test_sites_without_weight_are_left_out_and_all_others_come_up_once() -> None:
    """Sites 0 to 4 weigh nothing."""
    weight = np.concatenate([np.zeros(5), np.ones(20)])
    spread = Spread.of([1, 2, 3])
    order = spread.order(weight, np.random.default_rng(0), number=0, of=1, kind=2, round_number=1)
    assert sorted(order.tolist()) == list(range(5, 25))
    assert by_weight(np.zeros(4), np.random.default_rng(0)).size == 0
    assert spread.order(np.zeros(4), np.random.default_rng(0), number=0, of=1, kind=0, round_number=0).size == 0
