from dataclasses import replace

import numpy as np
import pytest
from hand_drawn import draw_lane

from bridge.sumo.replay import Replay
from bridge.sumo.simulation import Simulation
from hid2.occupancy.traffic import Traffic
from netconvert.cells import build_cell_grid
from netconvert.lane_graph import LaneGraph
from netconvert.net_xml import net_bytes

STEPS = 40


@pytest.fixture(scope="module")
def net() -> bytes:
    """One lane of 100 m along +x."""
    return net_bytes(build_cell_grid(LaneGraph({1: draw_lane(1, [(0.0, 0.0), (100.0, 0.0)])})))


def _traffic() -> Traffic:
    """Five agents: on the lane, off it, crossing, standing, and one whose heading runs through pi; 40 steps."""
    time = 0.1 * np.arange(STEPS)
    flat = np.zeros(STEPS)
    position = np.stack([
        np.column_stack([5.0 + 9.0 * time, flat]),
        np.column_stack([5.0 + 3.0 * time, flat - 12.0]),
        np.column_stack([flat + 50.0, -10.0 + 5.0 * time]),
        np.column_stack([flat + 70.0, flat + 0.4]),
        np.column_stack([80.0 - 2.0 * time, flat + 6.0]),
    ])  # fmt: skip
    heading = np.stack([flat, flat + 0.3, flat + np.pi / 2, flat, np.pi + 0.02 * (time - 2.0)])
    heading = (heading + np.pi) % (2 * np.pi) - np.pi
    return Traffic(
        ids=("lane", "off", "cross", "still", "west"),
        position=position,
        heading=heading,
        velocity=np.zeros((5, STEPS, 2)),
        present=np.ones((5, STEPS), dtype=bool),
        length_m=np.array([4.5, 1.8, 0.6, 11.0, 4.5]),
        width_m=np.array([1.9, 0.6, 0.6, 2.8, 1.9]),
    )


def _run(net: bytes, traffic: Traffic) -> Replay:
    with Simulation(net, seed=0, step_s=0.1) as simulation:
        replay = Replay(simulation, traffic, step_s=0.1)
        for step in range(STEPS):
            replay.place(step, {})
            simulation.step()
            replay.check(step)
    return replay


def test_every_state_is_replayed_exactly_and_nobody_is_lost_who_comes_late_leaves_early_or_comes_back(
    net: bytes,
) -> None:
    """Present in steps 0-4 and 10-14; another only in the last step: 11 states, each exact."""
    replay = _run(net, _traffic())
    assert replay.errors.states == 5 * STEPS
    assert replay.errors.max_position_error_m < 1e-6
    assert replay.errors.max_heading_error_rad < 1e-6
    present = np.zeros((2, STEPS), dtype=bool)
    present[0, :5] = present[0, 10:15] = present[1, -1] = True
    replay = _run(net, replace(_traffic().rows([0, 1]), present=present))
    assert replay.errors.states == 11
    assert replay.errors.max_position_error_m < 1e-6


def test_deviation_is_measured(net: bytes) -> None:
    """The check itself: states that were moved by 0.25 m behind its back are told as such."""
    with Simulation(net, seed=0, step_s=0.1) as simulation:
        replay = Replay(simulation, _traffic(), step_s=0.1)
        replay.place(0, {})
        simulation.place_all([("r3", 70.0 + 5.5 + 0.25, 0.4, 90.0, None)])
        simulation.step()
        replay.check(0)
    assert replay.errors.max_position_error_m == pytest.approx(0.25)


def test_speed_of_a_leader_is_known_from_the_first_step_on(net: bytes) -> None:
    """Warmed up two steps back, an agent that drives 9 m/s has that speed in SUMO at step 0, not 0."""
    moving = _traffic().rows([0])
    moving.velocity[..., 0] = 9.0
    with Simulation(net, seed=0, step_s=0.1) as sumo:
        replay = Replay(sumo, moving, step_s=0.1)
        for back in (2, 1):
            replay.warm_up(back)
            sumo.step()
        replay.place(0, {0: ("1#1", 0)})
        sumo.step()
        assert sumo.speed("r0") == pytest.approx(9.0, abs=0.01)
