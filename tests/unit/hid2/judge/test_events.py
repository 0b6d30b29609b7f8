"""Measures of an event between a vehicle and its target: gap, TTC, DRAC, PET."""

from dataclasses import replace

import numpy as np
import pytest
from hand_drawn import draw_box, draw_lane, draw_road

from hid2.agents import BoxSize, Track
from hid2.judge.events import brakes_for, crossing_steps, measure_event, post_encroachment_of
from hid2.measures.conflicts import conflicts
from hid2.measures.lane_matching import flatten_lanes
from hid2.occupancy.agent_states import AgentStates, agent_states
from netconvert.lane_graph import LaneGraph

CAR = BoxSize(4.0, 2.0)


def _drive(x_m: float, y_m: float, speed_mps: float, *, heading: float = 0.0) -> Track:
    """A car of 4 m by 2 m that drives straight on from a point for 60 steps."""
    box = draw_box(x_m, y_m, heading, speed_mps, steps=60)
    return Track("car", "vehicle", 1, np.arange(60), box.position[0], box.heading[0], box.velocity[0], CAR)


def pair(*tracks: Track) -> AgentStates:
    """A vehicle and its target."""
    return agent_states(tracks, flatten_lanes(draw_road()), num_steps=80, step_s=0.1)


def test_target_that_closes_in_has_gap_ttc_and_drac() -> None:
    """Target at 10 m/s, vehicle 20 m ahead (16 m bumper to bumper) at 8 m/s: 2 m/s closing, TTC 8 s at step 0.

    A step later the gap is 0.2 m less. At step 30 it is 10 m: TTC 5 s, DRAC 2 * 2 / (2 * 10) = 0.2 m/s2. Up to step 59
    the gap falls to 16 - 5.9 * 2 = 4.2 m: TTC 2.1 s, DRAC 4 / 8.4.

    What comes more than 3 s later is not the event: from step 20 to 50 the gap falls to 6 m. Step 70 has no state.
    Velocities are those of the positions: that the target is stated to stand counts nowhere.
    """
    target = _drive(0.0, 0.0, 10.0)
    states = pair(_drive(20.0, 0.0, 8.0), replace(target, velocity=0.0 * target.velocity))
    found = measure_event(states, "lead", 0, 1, at_step=30)
    assert found.gap_m == pytest.approx(10.0)
    assert found.speed_difference_mps == pytest.approx(-2.0)
    assert (found.min_ttc_s, found.ttc_at_s) == (pytest.approx(2.1, abs=1e-6), pytest.approx(5.9))
    assert found.headway_s == pytest.approx(0.82)  # 4.2 m and a length of 4 m at 10 m/s
    assert found.drac_mps2 == pytest.approx(4.0 / 8.4, rel=1e-6)
    assert brakes_for(found.min_ttc_s, found.drac_mps2)
    assert found.pet_s is None
    found = measure_event(states, "lead", 0, 1, at_step=20)
    assert (found.min_ttc_s, found.ttc_at_s) == (pytest.approx(3.0, abs=1e-6), pytest.approx(5.0))
    assert found.headway_s == pytest.approx(1.0)
    assert found.drac_mps2 == pytest.approx(4.0 / 12.0, rel=1e-6)
    with pytest.raises(ValueError, match="no state at step 70"):
        measure_event(states, "lead", 0, 1, at_step=70)


def test_target_that_falls_back_needs_no_braking() -> None:
    """The vehicle ahead is faster: never closing in, no TTC, DRAC 0, and nobody brakes."""
    found = measure_event(pair(_drive(20.0, 0.0, 12.0), _drive(0.0, 0.0, 10.0)), "lead", 0, 1, at_step=10)
    assert (found.min_ttc_s, found.ttc_at_s, found.drac_mps2) == (None, None, 0.0)
    assert not brakes_for(None, 1.0)
    assert found.headway_s == pytest.approx(2.2)  # 20 m front to front at step 0, 22 m at the moment


def test_cut_in_counts_since_the_vehicle_is_half_way_over() -> None:
    """The target is slower from step 30 on: at step 40 it closes in no more, 1.5 s before it does, 2 m/s over 2.2 m."""
    speed = np.where(np.arange(60) < 30, 10.0, 8.0)
    way = np.concatenate([[0.0], np.cumsum(0.1 * speed[:-1])])
    slower = replace(
        _drive(0.0, 0.0, 10.0), position=np.column_stack([way, np.zeros(60)]),
        velocity=np.column_stack([speed, np.zeros(60)]),
    )  # fmt: skip
    states = pair(_drive(12.0, 0.0, 8.0), slower)
    assert measure_event(states, "lead", 0, 1, at_step=40).min_ttc_s is None
    found = measure_event(states, "cut_in", 0, 1, at_step=40)
    assert (found.min_ttc_s, found.ttc_at_s) == (pytest.approx(1.1), pytest.approx(2.9))


def test_gap_of_a_merge_is_along_the_lanes_that_both_come_by() -> None:
    """Lanes 1 from the north and 2 from the west lead to 3. At step 30 one is 10 m past that, its target 15 m before.

    Centres are 25 m apart along the lanes, of which 15 m are along the target's heading; its time headway at 5 m/s is
    5 s. With the parts changed the vehicle is behind.
    """
    each = [
        draw_lane(1, [(0.0, 60.0), (0.0, 0.0)], successors=(3,)),
        draw_lane(2, [(-60.0, 0.0), (0.0, 0.0)], successors=(3,)),
        draw_lane(3, [(0.0, 0.0), (200.0, 0.0)]),
    ]
    lanes = flatten_lanes(LaneGraph({one.lane_id: one for one in each}))
    tracks = _drive(-20.0, 0.0, 10.0), _drive(0.0, 30.0, 5.0, heading=-np.pi / 2)
    states = agent_states(tracks, lanes, num_steps=80, step_s=0.1)
    found = measure_event(states, "merge", 0, 1, at_step=30)
    assert (found.gap_m, found.headway_s) == (pytest.approx(21.0), pytest.approx(5.0))
    behind = measure_event(states, "merge", 1, 0, at_step=30)
    assert (behind.gap_m, behind.headway_s) == (pytest.approx(21.0), None)


def test_gap_off_every_lane_is_along_the_heading_of_the_target() -> None:
    """20 m ahead and 5 m aside, 50 m from the road."""
    found = measure_event(pair(_drive(20.0, 55.0, 8.0), _drive(0.0, 50.0, 8.0)), "lead", 0, 1, at_step=0)
    assert found.gap_m == pytest.approx(16.0)


def test_gap_of_a_crossing_is_from_the_bumper_to_where_the_paths_cross() -> None:
    """The vehicle passes the point at step 20, when the target has 20 m to it, half a length of 2 m less."""
    states = pair(_drive(0.0, -20.0, 10.0, heading=np.pi / 2), _drive(-40.0, 0.0, 10.0))
    found = measure_event(states, "cross", 0, 1, at_step=20)
    assert (found.gap_m, found.headway_s) == (pytest.approx(18.0, abs=1.0), None)


def test_paths_may_cross_where_one_begins() -> None:
    """The vehicle begins 0.2 m before the point, there at step 0; the target comes 40 m at 1 m a step: step 40."""
    states = pair(_drive(0.0, -0.2, 10.0, heading=np.pi / 2), _drive(-40.2, 0.0, 10.0))
    assert crossing_steps(states, 0, 1) == (0, 40)


def test_what_crosses_first_needs_no_braking() -> None:
    """From the west at 10 m/s, 30 m before the point: there at step 30. From the south, 25 m before at 10 m/s, at 2 m/s
    from step 20 on: at step 45. Until then they head for each other: the second needed the DRAC that conflicts tell.
    """
    first, second = _drive(-30.0, 0.0, 10.0), _drive(0.0, -25.0, 10.0, heading=np.pi / 2)
    way = np.minimum(np.arange(60), 20) + 0.2 * np.maximum(np.arange(60) - 20, 0)
    states = pair(first, replace(second, position=np.column_stack([np.zeros(60), way - 25.0])))
    (told,) = conflicts(states.arrays)
    braking, passing = (
        measure_event(states, "cross", 0, 1, at_step=30),
        measure_event(states, "cross", 1, 0, at_step=45),
    )
    assert (braking.drac_mps2, passing.drac_mps2) == (pytest.approx(told.drac_mps2), 0.0)
    assert braking.min_ttc_s == passing.min_ttc_s == pytest.approx(told.ttc_s)
    assert brakes_for(braking.min_ttc_s, braking.drac_mps2)
    assert not brakes_for(passing.min_ttc_s, passing.drac_mps2)


def test_crossing_has_a_pet_and_paths_that_do_not_meet_have_none() -> None:
    """From the south at 10 m/s, 20 m before the crossing: there at step 20. From the west, 40 m before: at step 40.

    Between the rear bumper of the first, 2 m + 1 m (half the other's width) behind the point, and the front of the
    second, 3 m before it: 20 - 0.3 - 0.3 ... 2.0 s less 0.6 s. Swept boxes are longer by a step: 0.1 s to each side.
    """
    first = _drive(0.0, -20.0, 10.0, heading=np.pi / 2)
    second = _drive(-40.0, 0.0, 10.0)
    assert post_encroachment_of(pair(first, second), 0, 1) == pytest.approx(1.4, abs=0.21)
    assert post_encroachment_of(pair(_drive(0.0, 0.0, 10.0), _drive(0.0, 4.0, 10.0)), 0, 1) is None  # side by side
