"""Intervals by drawing units again: those of theory, and none where there is nothing to draw."""

import numpy as np
import pytest

from hid2.resampling import RESAMPLES, draws, interval, ratio, redrawn


def test_no_interval_from_two_units_and_no_value_from_none() -> None:
    assert ratio(np.array([1.0, 1.0]), np.array([1.0, 3.0])) == (0.5, None, None)
    assert ratio(np.array([0.0]), np.array([0.0])) == (None, None, None)


def test_every_draw_holds_as_many_units_as_there_are() -> None:
    found = list(draws(7))
    assert sum(map(len, found)) == RESAMPLES
    assert all((block.sum(axis=1) == 7).all() for block in found)


def test_interval_of_a_mean_is_that_of_theory() -> None:
    """400 normal values of SD 2: the mean is sure to 1.96 * 2 / sqrt(400) = 0.196 on both sides."""
    values = np.random.default_rng(4).normal(5.0, 2.0, 400)
    found = ratio(values, np.ones(400))
    assert found.value == pytest.approx(values.mean())
    assert found.low == pytest.approx(values.mean() - 1.96 * values.std() / 20, abs=0.03)
    assert found.high == pytest.approx(values.mean() + 1.96 * values.std() / 20, abs=0.03)


def test_ratio_is_the_statistic_of_the_weights() -> None:
    above, below = np.array([1.0, 3.0, 2.0]), np.array([10.0, 10.0, 5.0])
    drawn = redrawn(lambda weights: np.array([weights @ above / (weights @ below)]), 3)
    assert interval(6.0 / 25.0, drawn[:, 0]) == pytest.approx(ratio(above, below))


def test_draws_without_a_value_count_for_nothing_unless_they_are_most() -> None:
    drawn = np.array([1.0, 2.0, np.nan, 3.0])
    assert interval(2.0, drawn) == pytest.approx((2.0, 1.05, 2.95))
    assert interval(2.0, np.array([1.0, np.nan, np.nan])) == (2.0, None, None)
    assert interval(np.nan, drawn) == (None, None, None)
