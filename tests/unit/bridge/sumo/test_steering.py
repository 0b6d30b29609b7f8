"""What is read off SUMO's vehicles."""

import numpy as np
import pytest
from hand_drawn import draw_lane

from bridge.sumo.steering import Driver, Steering
from hid2.agents import BoxSize, Policy
from hid2.occupancy.traffic import Traffic
from hid2.params import Config
from hid2.scene import PlannedVehicle, World, build_world, predicted_traffic
from netconvert.cells import build_cell_grid
from netconvert.lane_graph import LaneGraph


@pytest.fixture
def world() -> World:
    """A straight lane of 100 m, nobody on it."""
    graph = LaneGraph({1: draw_lane(1, [(0.0, 0.0), (100.0, 0.0)])})
    return build_world(build_cell_grid(graph), (), config=Config(), num_steps=110, last_observed_step=49)


def _driver(world: World, plan_v: np.ndarray) -> Driver:
    path = world.path((1,))
    plan_s = 40.0 + 0.1 * np.cumsum(plan_v)
    spec = PlannedVehicle(
        vehicle_id="v0", policy=Policy.STRAIGHT, object_type="vehicle", size=BoxSize(4.5, 1.9),
        own_size=BoxSize(4.5, 1.9), route=(1,), path=path, s0=40.0, v0=5.0, cruise_mps=9.0, trigger_s=2.0,
        plan_s=plan_s, plan_v=plan_v, sides=(), intended_path=path, intended_s=plan_s,
    )  # fmt: skip
    return Driver(spec, path, plan_s.copy(), plan_v.copy(), ())


def _driven(world: World, driver: Driver) -> tuple[np.ndarray, np.ndarray]:
    nobody: Traffic = predicted_traffic([], world.num_steps)
    steering = Steering(world, None, nobody)  # type: ignore[arg-type]  # nothing is asked of SUMO here
    steering.drivers = [driver]
    (one,) = steering.driven()
    return one.s, one.v


def test_vehicle_goes_on_as_planned_behind_the_edge_of_the_map(world: World) -> None:
    """SUMO took it out behind step 69 at 6 m/s, where the plan was at 6.9 and went on speeding up by 0.1 m/s a step.

    From there on it does the same from its own speed: 6.1 m/s at step 70, 10.0 at step 109. It does not stop speeding
    up at once, which no smoothing within limits of jerk could follow.
    """
    driver = _driver(world, np.arange(110) * 0.1)
    driver.v, driver.s = [6.0] * 70, (40.0 + 0.6 * np.arange(70)).tolist()
    s, v = _driven(world, driver)
    assert s.size == v.size == 110
    assert v[69:] == pytest.approx(6.0 + 0.1 * np.arange(41))
    assert np.diff(s[69:]) == pytest.approx(0.1 * v[70:])
    assert s[:70].tolist() == driver.s


def test_vehicle_does_not_roll_back_behind_the_edge(world: World) -> None:
    driver = _driver(world, np.linspace(9.0, 0.0, 110))
    driver.v, driver.s = [1.0] * 70, (40.0 + 0.1 * np.arange(70)).tolist()
    s, v = _driven(world, driver)
    assert v.min() == 0.0
    assert np.all(np.diff(s) >= 0.0)


def test_trace_of_a_vehicle_that_stays_is_what_sumo_drove(world: World) -> None:
    driver = _driver(world, np.full(110, 5.0))
    driver.v, driver.s = [4.0] * 110, (40.0 + 0.4 * np.arange(110)).tolist()
    s, v = _driven(world, driver)
    assert s.tolist() == driver.s
    assert v.tolist() == driver.v
