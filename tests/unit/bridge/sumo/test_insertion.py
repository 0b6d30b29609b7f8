from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from bridge.sumo.insertion import edges_along, insert
from bridge.sumo.replay import met_by
from bridge.sumo.simulation import Simulation
from hid2.agents import BoxSize, Policy
from hid2.motion.route import DrivenPath, shifted_path
from hid2.occupancy.traffic import Traffic
from hid2.params import Config
from hid2.policy.lane_change import blend_paths
from hid2.scene import PlannedVehicle, World, build_world
from netconvert.cells import Cell, build_cell_grid
from netconvert.lane_graph import LaneGraph, LaneSegment, turn_type
from netconvert.net_xml import net_bytes


@pytest.fixture(scope="module")
def world() -> World:
    """Two lanes of 100 m, then lane 3 of 20 m on from lane 1; edges 1#0 .. 1#24 hold a cell of both lanes.

    lane 2  --------------------
    lane 1  -------------------- lane 3 -----
    0                         100          120
    """
    lanes = {}
    for lane_id, points, successors in (
        (1, [(0.0, 0.0), (100.0, 0.0)], (3,)),
        (2, [(0.0, 3.5), (100.0, 3.5)], ()),
        (3, [(100.0, 0.0), (120.0, 0.0)], ()),
    ):
        centerline = np.array(points)
        lanes[lane_id] = LaneSegment(
            lane_id=lane_id, centerline=centerline, left_boundary=None, right_boundary=None, lane_type="VEHICLE",
            is_intersection=False, successors=successors, left_neighbor_id=2 if lane_id == 1 else None,
            right_neighbor_id=1 if lane_id == 2 else None, left_mark_type="DASHED_WHITE",
            right_mark_type="DASHED_WHITE", width_m=3.5, turn=turn_type(centerline, is_intersection=False),
        )  # fmt: skip
    return build_world(build_cell_grid(LaneGraph(lanes)), (), config=Config(), num_steps=110, last_observed_step=49)


@pytest.fixture
def sumo(world: World, tmp_path: Path) -> Iterator[Simulation]:
    net = tmp_path / "road.net.xml"
    net.write_bytes(net_bytes(world.grid))
    with Simulation(net, seed=0, step_s=0.1) as simulation:
        yield simulation


def _across(world: World, path: DrivenPath, target: DrivenPath, start_m: float) -> DrivenPath:
    blend = blend_paths(path.raw, target.raw, start_m=start_m, length_m=20.0, step_m=1.0, max_shift_m=5.5)
    assert blend is not None
    return shifted_path(path, target, blend, smoothing=world.config.smoothing, limits=world.config.limits)


def test_edges_go_from_the_cell_to_the_end_of_the_route(world: World) -> None:
    """From cell 23 of lane 1: two edges of it and the five of lane 3."""
    edges = edges_along(world, world.path((1, 3)), Cell(1, 23))
    assert edges == ("1#23", "1#24", "3#0", "3#1", "3#2", "3#3", "3#4")


def test_lane_that_the_path_does_not_use_has_no_edges(world: World) -> None:
    assert edges_along(world, world.path((1,)), Cell(2, 3)) is None


def test_path_that_came_back_to_its_lane_goes_on_from_there(world: World) -> None:
    """An overtake leaves lane 1 and comes back to it: the way on does not begin with its first cells again."""
    out = _across(world, world.path((1, 3)), world.path((2,)), 10.0)
    back = _across(world, out, world.path((1, 3)), 50.0)
    assert [segment.lane_id for segment in back.segments] == [1, 2, 1, 3]
    assert edges_along(world, back, Cell(1, 22)) == ("1#22", "1#23", "1#24", "3#0", "3#1", "3#2", "3#3", "3#4")


def _spec(world: World, s0: float, v0: float) -> PlannedVehicle:
    path = world.path((1, 3))
    plan = s0 + v0 * 0.1 * np.arange(110)
    return PlannedVehicle(
        vehicle_id="v1", policy=Policy.STRAIGHT, object_type="vehicle", size=BoxSize(4.5, 1.9),
        own_size=BoxSize(4.2, 1.8), route=(1, 3), path=path, s0=s0, v0=v0, cruise_mps=10.0, trigger_s=0.0, plan_s=plan,
        plan_v=np.full(110, v0), sides=(), intended_path=path, intended_s=plan,
    )  # fmt: skip


@pytest.mark.parametrize("s0", [10.0, 21.75, 97.0, 99.0])
def test_vehicle_is_inserted_with_its_box_where_it_was_planned(sumo: Simulation, world: World, s0: float) -> None:
    """Centre at s0, so the front bumper at s0 + 2.25 m, which may already be on the next cell or lane."""
    sumo.step()
    assert insert(sumo, world, _spec(world, s0, 7.0)) is None
    assert sumo.pose("v1") == pytest.approx((s0 + 2.25, 0.0, 90.0), abs=0.01)
    assert sumo.speed("v1") == pytest.approx(7.0)


def test_only_who_may_be_met_is_replayed_again(world: World) -> None:
    """It drives from 10 to 65 m: met are who stands on its lane and beside it, not who is 30 m aside or 180 m ahead."""
    standing = np.zeros((4, 110, 2))
    standing[:, :, 0] = np.array([50.0, 60.0, 60.0, 250.0])[:, None]
    standing[:, :, 1] = np.array([0.0, 7.0, 30.0, 0.0])[:, None]
    traffic = Traffic(
        ids=("on", "beside", "aside", "off"), position=standing, heading=np.zeros((4, 110)),
        velocity=np.zeros((4, 110, 2)), present=np.ones((4, 110), dtype=bool), length_m=np.full(4, 4.5),
        width_m=np.full(4, 1.9),
    )  # fmt: skip
    assert met_by(traffic, [_spec(world, 10.0, 5.0)]).ids == ("on", "beside")
    assert met_by(traffic, []).ids == ()
