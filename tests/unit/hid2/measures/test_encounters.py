"""Whom vehicles meet, worked by hand on a straight road of two lanes, 3.5 m apart."""

import numpy as np
import pytest
from hand_drawn import SMALL_CAR, draw_driven, draw_road
from views import lane_view

from hid2.agents import BoxSize, Track
from hid2.measures.arrays import stack
from hid2.measures.encounters import encounters
from hid2.measures.following import leaders

STEPS = 60


def _track(name: str, x: np.ndarray, y: np.ndarray | float, *, kind: str = "vehicle") -> Track:
    """A road user of 4 m by 2 m (pedestrians: 0.6 m) at positions (T,) m, steps of 0.1 s, heading along its motion."""
    size = SMALL_CAR if kind == "vehicle" else BoxSize(0.6, 0.6)
    return draw_driven(name, np.column_stack([x, np.broadcast_to(y, x.shape)]), kind=kind, size=size)


def _steady(name: str, x_m: float, y_m: float, mps: float) -> Track:
    return _track(name, x_m + 0.1 * mps * np.arange(STEPS), y_m)


def met(*tracks: Track) -> dict[str, np.ndarray]:
    """Encounters on a road of two lanes, 300 m; tracks named gen_... are inserted."""
    arrays = stack(tracks, num_steps=STEPS, step_s=0.1)
    return encounters(arrays, leaders(lane_view(arrays, draw_road(lanes=2, length_m=300.0))))


@pytest.mark.parametrize(("apart_m", "far"), [(29.9, False), (30.1, True)])
def test_far_is_30_m_from_the_nearest_moving_recorded_vehicle(apart_m: float, far: bool) -> None:
    """Behind one that moves as fast; a parked one at 10 m and an inserted one at 5 m do not count."""
    found = met(
        _steady("gen_0", 20.0, 0.0, 10.0), _steady("ahead", 20.0 + apart_m, 0.0, 10.0),
        _steady("parked", 30.0, 3.5, 0.0), _steady("gen_1", 25.0, 3.5, 10.0),
    )  # fmt: skip
    assert found["far"][:2].tolist() == [far, True]  # itself is no other


def test_leader_within_three_seconds_for_one_second_is_followed() -> None:
    """Gap 20 m at 10 m/s, 2 s; the recorded leader is led by nobody. 40 m behind (3.6 s) nobody is followed."""
    found = met(_steady("gen_0", 20.0, 0.0, 10.0), _steady("ahead", 44.0, 0.0, 10.0))
    assert found["follows_recorded"].tolist() == [True, False]
    assert found["follows_inserted"].tolist() == [False, False]
    assert not met(_steady("gen_0", 20.0, 0.0, 10.0), _steady("ahead", 60.0, 0.0, 10.0))["follows_recorded"].any()


def test_braking_counts_behind_a_near_leader_only() -> None:
    """From 10 m/s with 1 m/s2, 20 m behind somebody who does the same: braking for it. Alone: not."""
    t = 0.1 * np.arange(STEPS)
    way = 10.0 * t - 0.5 * t * t
    behind, ahead = _track("gen_0", 20.0 + way, 0.0), _track("ahead", 44.0 + way, 0.0)
    assert met(behind, ahead)["brakes_recorded"].tolist() == [True, False]
    assert not met(behind)["brakes_recorded"].any()


def test_crossing_counts_by_the_kind_of_the_other_one() -> None:
    """East at 10 m/s, at x = 50 m after 3 s; a pedestrian walks north over x = 50 m and is at y = 0 after 1.5 s."""
    walks = _track("walker", np.full(STEPS, 50.0), -2.25 + 0.15 * np.arange(STEPS), kind="pedestrian")
    found = met(_steady("gen_0", 20.0, 0.0, 10.0), walks)
    assert found["crosses_pedestrian"].tolist() == [True, False]  # of vehicles only
    assert not found["crosses_recorded"].any()


def test_standing_needs_half_a_second() -> None:
    """One that stands all the time, one that never does."""
    found = met(_steady("gen_0", 20.0, 0.0, 0.0), _steady("gen_1", 60.0, 3.5, 8.0))
    assert found["stands"].tolist() == [True, False]
