from collections.abc import Callable

import numpy as np
import pytest

from hid2.agents import BoxSize
from hid2.conflicts.cases import Prospect, priority, prospect, road_most, transition_rejected
from hid2.motion.route import DrivenPath
from hid2.occupancy.along_path import path_occupancy
from hid2.occupancy.sigma import FREE, GENERATED, ORIGINAL
from hid2.occupancy.traffic import Traffic
from hid2.params import Config, Conflict

CAR = BoxSize(4.5, 1.9)
CONFIG = Config(conflict=Conflict(margin_lateral_m=0.25, margin_front_m=1.0, ttc_min_s=1.5))


@pytest.fixture
def look(straight_path: DrivenPath) -> Callable[..., Prospect]:
    """look(traffic, recorded=None) -> what a vehicle on the x axis that wants 12 m/s has before it."""

    def make(*others: Traffic, recorded: Traffic | None = None) -> Prospect:
        known = None
        if recorded is not None:
            known = path_occupancy(straight_path.line, recorded, length_m=4.5, width_m=1.9, margin_lateral_m=0.25)
        return prospect(
            straight_path, CAR, np.full(straight_path.line.table_xy.shape[0], 12.0),
            road_most(straight_path.line, CONFIG), others, config=CONFIG, num_steps=110, earliest_exit_step=51,
            known=known,
        )  # fmt: skip

    return make


def test_case_1_cell_held_by_an_original_agent_rejects_the_transition() -> None:
    assert transition_rejected(ORIGINAL)
    assert not transition_rejected(FREE)
    assert not transition_rejected(GENERATED)


def test_case_2_executing_before_pending_then_closer_then_the_lower_id() -> None:
    keys = {
        "executing far": priority(executing=True, distance_m=90.0, vehicle_id="v9"),
        "pending near": priority(executing=False, distance_m=5.0, vehicle_id="v5"),
        "pending far, lower id": priority(executing=False, distance_m=20.0, vehicle_id="v1"),
        "pending far, higher id": priority(executing=False, distance_m=20.0, vehicle_id="v2"),
    }
    assert sorted(keys, key=keys.__getitem__) == list(keys)


def test_case_3_timing_is_adjusted_to_who_crosses(
    look: Callable[..., Prospect], box: Callable[..., Traffic], straight_path: DrivenPath
) -> None:
    """A bus crosses x = 70 after 5 s, when 12 m/s would bring the vehicle there too: the plan comes at another time."""
    ahead = look(box(70.0, -40.0, np.pi / 2, 8.0, length_m=11.0, width_m=2.8))
    constant = 10.0 + 1.2 * np.arange(110)
    assert ahead.is_blocked(constant, 0)
    plan = ahead.plan(s0=10.0, v0=12.0, a0=0.0, first_step=0, config=CONFIG)
    assert plan is not None
    assert not ahead.is_blocked(plan.s, 0)
    assert np.abs(plan.v - 12.0).max() > 0.5


def test_nothing_is_blocked_on_an_empty_road(look: Callable[..., Prospect], box: Callable[..., Traffic]) -> None:
    assert not look(box(0.0, 40.0)).is_blocked(10.0 + 1.2 * np.arange(60), 0)


def test_driven_motion_is_checked_from_its_first_step_on(
    look: Callable[..., Prospect], box: Callable[..., Traffic]
) -> None:
    """Somebody stands at 50 m up to step 20; a motion that passes there from step 30 on is free."""
    from dataclasses import replace

    standing = box(50.0, 0.0)
    gone = replace(standing, present=(np.arange(110) < 20)[None])
    assert look(gone).is_blocked(np.linspace(45.0, 55.0, 10), 5)
    assert not look(gone).is_blocked(np.linspace(45.0, 55.0, 10), 30)


def test_bounds_keep_the_side_on_which_a_motion_is(look: Callable[..., Prospect], box: Callable[..., Traffic]) -> None:
    """A car at 40 m behind, one at 80 m ahead: between 40 + 4.5 + 0.6 and 80 - 4.5 - 0.6 (0.6 of the margin of 1 m)."""
    bounds = look(box(40.0, 0.0).joined(box(80.0, 0.0))).bounds(np.full(110, 60.0))
    assert bounds is not None
    assert bounds.low[0] == pytest.approx(45.1, abs=0.6)
    assert bounds.high[0] == pytest.approx(74.9, abs=0.6)
    assert bounds.ttc_room[0] == pytest.approx(74.9, abs=0.6)


def test_no_bounds_between_two_who_leave_no_room(look: Callable[..., Prospect], box: Callable[..., Traffic]) -> None:
    assert look(box(56.0, 0.0).joined(box(64.0, 0.0))).bounds(np.full(110, 60.0)) is None


def test_ttc_is_the_gap_over_the_closing_speed(look: Callable[..., Prospect], box: Callable[..., Traffic]) -> None:
    """Own 10 m/s at x = 10, leader 5 m/s at 40: bumper gap 25.5 m, 5.1 s; smallest after 3 s: 10.5 / 5 = 2.1 s."""
    ahead = look(box(40.0, 0.0, 0.0, 5.0))
    s = 10.0 + np.arange(31)
    assert ahead.min_ttc_s(s[:1], np.full(1, 10.0)) == pytest.approx(5.1, abs=0.15)
    assert ahead.min_ttc_s(s, np.full(31, 10.0)) == pytest.approx(2.1, abs=0.15)
    assert ahead.min_ttc_s(s, np.full(31, 5.0)) == np.inf


def test_ttc_counts_leaders_only_not_who_crosses(look: Callable[..., Prospect], box: Callable[..., Traffic]) -> None:
    crossing = look(box(40.0, 0.0, np.pi / 2, 0.0))
    assert crossing.min_ttc_s(10.0 + np.arange(20), np.full(20, 10.0)) == np.inf


def test_only_generated_followers_are_owed_a_ttc(look: Callable[..., Prospect], box: Callable[..., Traffic]) -> None:
    """A follower at 14 m/s, 20 m behind one at 10: gap 15.5 m closes at 4 m/s, 3.9 s.

    A generated one is ours to keep comfortable; what a recorded one does was driven by someone who saw another scene.
    """
    follower = box(10.0, 0.0, 0.0, 14.0)
    s, v = 30.0 + np.arange(1), np.full(1, 10.0)
    assert look(follower).min_follower_ttc_s(s, v) == pytest.approx(3.9, abs=0.15)
    assert look(recorded=follower).min_follower_ttc_s(s, v) == np.inf


def test_bounds_keep_a_motion_on_the_map_until_it_may_leave(
    look: Callable[..., Prospect], box: Callable[..., Traffic]
) -> None:
    """The road of 200 m ends for the centre of a car of 4.5 m at 197.75 m; it may leave from step 51 on."""
    bounds = look(box(40.0, 0.0)).bounds(100.0 + 2.0 * np.arange(110))
    assert bounds is not None
    assert np.all(bounds.high[:51] == pytest.approx(197.75))
    assert np.all(np.isinf(bounds.high[51:]))
