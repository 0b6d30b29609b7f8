"""Random numbers drawn in blocks."""

import numpy as np
import pytest

from hid2.insertion.draws import Draws


def test_same_seed_draws_the_same_and_another_does_not() -> None:
    def some(seed: int) -> list[float]:
        draws = Draws(np.random.default_rng(seed))
        return [draws.unit(), draws.normal(), draws.uniform(2.0, 5.0), *map(float, draws.permutation(7))]

    assert some(1) == some(1)
    assert some(1) != some(2)


def test_more_than_a_block_is_as_random_as_the_first() -> None:
    """20,000 of each: means and spreads of the distributions within four standard errors, no value twice."""
    draws = Draws(np.random.default_rng(0))
    units, normals = ([draw() for _ in range(20_000)] for draw in (draws.unit, draws.normal))
    assert len(set(units)) == len(set(normals)) == 20_000
    assert 0.0 <= min(units) < 0.001
    assert 0.999 < max(units) < 1.0
    assert np.mean(units) == pytest.approx(0.5, abs=4 * 0.289 / 141)
    assert np.mean(normals) == pytest.approx(0.0, abs=4 / 141)
    assert np.std(normals) == pytest.approx(1.0, abs=0.02)


def test_index_reaches_every_number_and_no_other() -> None:
    draws = Draws(np.random.default_rng(0))
    drawn = [draws.index(5) for _ in range(5000)]
    counts = np.bincount(drawn, minlength=5)
    assert counts.size == 5
    assert counts.min() > 900


def test_numbers_lie_between_their_bounds() -> None:
    draws = Draws(np.random.default_rng(0))
    low, high = np.array([0.0, 10.0, -3.0]), np.array([1.0, 10.0, -2.0])
    for _ in range(50):
        for drawn, least, most in zip(draws.between(low, high), low, high, strict=True):
            assert least <= drawn <= most
        assert 2.0 <= draws.uniform(2.0, 3.0) < 3.0
    assert sorted(draws.permutation(9)) == list(range(9))
