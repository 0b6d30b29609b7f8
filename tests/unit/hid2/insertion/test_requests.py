"""What is asked for in a scene: drawn rounding of the mix, and triggers as the user gives them."""

from collections import Counter

import numpy as np
import pytest
from scipy.stats import kstest

from hid2.agents import Policy
from hid2.insertion.requests import draw_mix, draw_requests
from hid2.params import Config, Request

SHARES = {
    Policy.STRAIGHT: 0.6, Policy.LEFT_TURN: 0.1, Policy.RIGHT_TURN: 0.1, Policy.LANE_CHANGE: 0.15,
    Policy.OVERTAKE: 0.05,
}  # fmt: skip


def _triggers(count: int, *, duration_s: float = 10.9, **request: float | tuple[float, ...]) -> list[float]:
    config, rng = Config(request=Request(**request)), np.random.default_rng(1)
    return [one.trigger_s for one in draw_requests(config, rng, count=count, duration_s=duration_s)]


@pytest.mark.parametrize("count", [0, 1, 7, 10, 40])
def test_mix_adds_up_to_the_count_and_is_off_by_less_than_one(count: int) -> None:
    for seed in range(50):
        found = Counter(draw_mix(SHARES, np.random.default_rng(seed), count=count))
        assert sum(found.values()) == count
        assert all(abs(found[policy] - share * count) < 1.0 for policy, share in SHARES.items())


def test_shares_are_met_in_the_mean() -> None:
    """5 % of 10 is one overtake in every other scene; 15 % is one lane change or two; of a share of nothing nobody."""
    rng = np.random.default_rng(1)
    found = [Counter(draw_mix(SHARES, rng, count=10)) for _ in range(2000)]
    for policy, share in SHARES.items():
        assert np.mean([one[policy] for one in found]) == pytest.approx(10 * share, abs=0.05)
    assert {one[Policy.OVERTAKE] for one in found} == {0, 1}
    assert {one[Policy.LANE_CHANGE] for one in found} == {1, 2}
    only = {policy: float(policy is Policy.OVERTAKE) for policy in Policy}
    for seed in range(20):
        assert draw_mix(only, np.random.default_rng(seed), count=9) == [Policy.OVERTAKE] * 9


@pytest.mark.parametrize(
    ("asked", "duration_s", "low", "high"),
    [
        ({"trigger_min_s": 6.0, "trigger_max_s": 8.0}, 10.9, 6.0, 8.0),
        ({"trigger_min_s": 1.0, "trigger_max_s": 8.0}, 10.9, 1.0, 8.0),
        ({"trigger_max_s": 8.0}, 4.9, 0.5, 8.0),  # what was asked for is kept in a short scene
        ({}, 10.9, 0.5, 0.36 * 10.9),
        ({}, 4.9, 0.5, 0.36 * 4.9),
        ({}, 300.0, 0.5, 4.0),
    ],
)
def test_range_of_triggers_is_uniform_to_its_end(
    asked: dict[str, float], duration_s: float, low: float, high: float
) -> None:
    """200 requests, some of them in the last tenth; a range that nobody asked for ends early in a short scene."""
    drawn = _triggers(200, duration_s=duration_s, **asked)
    assert kstest(drawn, "uniform", args=(low, high - low)).pvalue > 0.05
    assert max(drawn) > high - 0.1 * (high - low)


def test_list_of_triggers_is_drawn_from_alike_and_a_fixed_one_is_exactly_that() -> None:
    """2, 4, 6 s: none but these, each for a third of 600 within 4 SD (4 sqrt(600 * 2 / 9) = 46)."""
    assert _triggers(50, trigger_min_s=6.0, trigger_max_s=6.0) == [6.0] * 50
    drawn = Counter(_triggers(600, trigger_list_s=(2.0, 4.0, 6.0)))
    assert set(drawn) == {2.0, 4.0, 6.0}
    assert all(abs(count - 200) < 47 for count in drawn.values())


def test_requests_are_numbered_and_drawn_once_for_all() -> None:
    config = Config()
    one, other = (draw_requests(config, np.random.default_rng(3), count=10, duration_s=10.9) for _ in range(2))
    assert one == other
    assert [request.number for request in one] == list(range(10))
