"""Motions for events: where they begin, whom they keep to, and what makes them no plans."""

from dataclasses import replace

import numpy as np
import pytest

from hid2.insertion.event_motions import Along, Rules, Wanted, first_met_s, kept_to, motions
from hid2.occupancy.along_path import PathOccupancy
from hid2.params import EventSearch

STEPS, STEP_S = 60, 0.1
NOBODY = np.zeros((0, STEPS))


def along(*others: tuple[float, float], own: bool = False, cap: float = 20.0) -> Along:
    """A straight path of 300 m with vehicles that hold so much of it, 5 m, from a place on, at a constant speed."""
    low = np.array([[s + STEP_S * v * step for step in range(STEPS)] for s, v in others]).reshape(-1, STEPS)
    speed = np.array([[v] * STEPS for _, v in others]).reshape(-1, STEPS)
    with_it = np.ones(low.shape, dtype=np.bool_)
    taken = PathOccupancy(np.arange(len(others)), low, low + 5.0, speed, with_it, ~with_it)
    return Along(np.full(3001, cap), taken, np.full(len(others), own), 300.0, 0.0)


def rules(target_mps: float = 10.0, *, order: int = 1, ahead_m: float = 50.0, changes: bool = False) -> Rules:
    """With a target at a place at step 0 that keeps its speed; both 5 m long."""
    ahead = ahead_m + target_mps * STEP_S * np.arange(STEPS)
    return Rules(order, 5.0, changes, 0.0, np.full(STEPS, target_mps), ahead, 1.8, 0.6, STEP_S, EventSearch())


def wanted(place: float, speed: float, *, before: float = 0.0, later: float = np.nan, gap: float = 10.0) -> Wanted:
    """One motion with its moment at step 20."""
    one = np.array([20])
    return Wanted(one, np.array([place]), np.array([gap]), np.array([speed]), np.array([before]), np.array([later]))


def test_a_motion_is_at_its_place_at_the_moment_with_its_speed_and_steady_before() -> None:
    """10 m/s for 2 s before 100 m: it begins at 80 m."""
    speeds, way = motions(wanted(100.0, 10.0), rules(), along(), along()).motion(0)
    assert way[20] == pytest.approx(100.0)
    assert way[0] == pytest.approx(80.0)
    assert speeds[:21] == pytest.approx(10.0)


def test_an_acceleration_before_the_moment_is_what_was_wanted_and_nobody_drives_backwards() -> None:
    """1 m/s2 up to 10 m/s at step 20: 8 m/s at step 0; 10 m/s2: it stands until 1 s before."""
    speeds, _ = motions(wanted(100.0, 10.0, before=1.0), rules(), along(), along()).motion(0)
    assert speeds[0] == pytest.approx(8.0)
    speeds, way = motions(wanted(100.0, 10.0, before=10.0), rules(), along(), along()).motion(0)
    assert speeds[0] == 0.0
    assert way[0] == pytest.approx(way[9])


def test_who_keeps_to_the_target_comes_to_its_speed_and_who_does_not_to_its_own() -> None:
    """Of 8 m/s, ahead of a target at 10 m/s."""
    keeping, _ = motions(wanted(85.0, 8.0), rules(), along(), along()).motion(0)
    going, _ = motions(wanted(85.0, 8.0, later=8.0), rules(), along(), along()).motion(0)
    assert keeping[-1] == pytest.approx(10.0, abs=0.8)
    assert going[21:] == pytest.approx(8.0)


def test_a_slower_vehicle_ahead_is_kept_off_afterwards() -> None:
    """One at 6 m/s from 98 m on, 110 m at 2 s: whoever is at 100 m then with 10 m/s ends behind it, and not faster."""
    slow = along((98.0, 6.0))
    speeds, way = motions(wanted(100.0, 10.0, later=10.0), rules(), slow, slow).motion(0)
    assert way[-1] < slow.taken.low[0, -1]
    assert speeds[-1] < 7.5


def test_a_motion_through_somebody_is_free_until_it_meets_it() -> None:
    """One that stands at 90 to 95 m; at 10 m/s from 80 m on the motion comes too near within the first second."""
    standing = along((90.0, 0.0))
    one = wanted(100.0, 10.0)
    fan = motions(one, rules(), standing, standing)
    assert first_met_s(fan, rules(), standing, standing)[0] <= 1.0
    assert np.isinf(first_met_s(fan, rules(), along(), along())[0])


def test_the_lane_that_is_left_is_no_matter_after_a_change_and_the_other_not_before() -> None:
    """A standing vehicle on the lane that was left, far behind the change, and one on the other before it."""
    one = wanted(100.0, 10.0, later=10.0)
    changing = rules(changes=True)
    first, second = along((112.0, 0.0)), along((76.0, 0.0))
    fan = motions(one, changing, first, second)
    met = first_met_s(fan, changing, first, along())[0]
    assert met < 2.0, "a standing leader is too near before the change"
    assert np.isinf(first_met_s(fan, changing, along(), second)[0])
    assert np.isfinite(first_met_s(fan, rules(), second, second)[0])


def test_time_to_collision_of_a_faster_target_behind_is_gap_over_speed_difference() -> None:
    """Target at 70 m at 2 s with 10 m/s, vehicle at 95 m with 8 m/s and holding it: 20 m and 2 m/s, later less."""
    one = wanted(95.0, 8.0, later=8.0)
    fan = motions(one, rules(), along(), along())
    ttc, drac = kept_to(fan, rules(), np.ones(STEPS, dtype=np.bool_))
    gap = 20.0 - 2.0 * STEP_S * (STEPS - 1 - 20)
    assert ttc[0] == pytest.approx(gap / 2.0)
    assert drac[0] == pytest.approx(4.0 / (2.0 * gap))


def test_a_pair_that_would_touch_has_no_time_to_collision() -> None:
    """The vehicle is where the target is."""
    one = wanted(72.0, 10.0)
    fan = motions(one, rules(), along(), along())
    assert kept_to(fan, rules(), np.ones(STEPS, dtype=np.bool_))[0][0] == -1.0


def test_a_target_that_has_left_the_path_closes_in_on_nobody() -> None:
    """One that comes up behind at 2 m/s: its TTC counts only up to the step at which it leaves."""
    one = wanted(95.0, 8.0, later=8.0)
    fan = motions(one, rules(), along(), along())
    there = np.arange(STEPS) <= 30
    assert kept_to(fan, rules(), there)[0][0] == pytest.approx((20.0 - 2.0 * STEP_S * 10) / 2.0)
    assert np.isinf(kept_to(fan, rules(), np.zeros(STEPS, dtype=np.bool_))[0][0])


def test_a_driver_with_a_short_time_gap_is_nearer_to_who_is_ahead() -> None:
    """Behind one at 6 m/s, both still after the longer gap."""
    slow = along((98.0, 6.0))
    one = wanted(100.0, 10.0, later=10.0)
    usual, short = rules(), replace(rules(), tau_s=0.25)
    assert motions(one, short, slow, slow).motion(0)[1][-1] > motions(one, usual, slow, slow).motion(0)[1][-1] + 1.0
    near = along((106.0, 10.0))
    fan = motions(wanted(120.0, 10.0, later=10.0), usual, near, near)
    assert first_met_s(fan, usual, near, near)[0] == 0.0
    assert np.isinf(first_met_s(fan, short, near, near)[0])


def test_motions_alike_in_one_half_are_those_that_each_would_be_alone() -> None:
    """Two accelerations before by two speeds after, beside one that is slower: each as it is worked out by itself."""
    kinds = [(before, later) for before in (0.0, 1.0) for later in (np.nan, 12.0)]
    ones = [wanted(100.0, 10.0, before=before, later=later) for before, later in kinds]
    ones.append(wanted(104.0, 8.0, gap=14.0))
    names = ("at", "place", "gap_m", "speed_mps", "before_mps2", "later_mps")
    together = Wanted(*(np.concatenate([getattr(one, name) for one in ones]) for name in names))
    others = along((70.0, 9.0), (150.0, 6.0))
    fan = motions(together, rules(), others, others)
    assert (fan.until.way.shape[0], fan.since.way.shape[0]) == (3, 3)
    some = fan.rows(np.array([False, True, True, False, True]))
    there = np.ones(STEPS, dtype=np.bool_)
    for row, one in enumerate(ones):
        alone = motions(one, rules(), others, others)
        assert np.array_equal(fan.motion(row), alone.motion(0))
        assert first_met_s(fan, rules(), others, others)[row] == first_met_s(alone, rules(), others, others)[0]
        assert [found[row] for found in kept_to(fan, rules(), there)] == [f[0] for f in kept_to(alone, rules(), there)]
    for row, of in enumerate((1, 2, 4)):
        assert np.array_equal(some.motion(row), fan.motion(of))
