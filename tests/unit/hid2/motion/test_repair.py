from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hid2.agents import BoxSize, Policy, Track
from hid2.motion.repair import DrivenVehicle, settle, settle_as_planned, settled_traffic
from hid2.motion.verify import first_overlap, limit_exceeded
from hid2.params import Config, Request
from hid2.scene import PlannedVehicle, World, build_world, predicted_traffic
from netconvert.cells import build_cell_grid
from netconvert.lane_graph import LaneGraph

CAR = BoxSize(4.5, 1.9)
NOBODY = predicted_traffic([], 110)


@pytest.fixture
def world(road: Callable[..., LaneGraph]) -> Callable[..., World]:
    """world(*tracks, length_m=200, request={...}) -> a straight road of two lanes."""

    def make(*tracks: Track, request: dict[str, Any] | None = None, **shape: Any) -> World:
        grid = build_cell_grid(road(**shape))
        config = Config(request=Request(**(request or {})))
        return build_world(grid, tracks, config=config, num_steps=110, last_observed_step=49)

    return make


def _driven(world: World, s: np.ndarray, v: np.ndarray, *, name: str = "v1", lane_id: int = 1) -> DrivenVehicle:
    path = world.path((lane_id,))
    spec = PlannedVehicle(
        vehicle_id=name, policy=Policy.STRAIGHT, object_type="vehicle", size=CAR, own_size=CAR, route=(lane_id,),
        path=path, s0=float(s[0]), v0=float(v[0]), cruise_mps=float(max(v.max(), 3.0)), trigger_s=0.0, plan_s=s,
        plan_v=v, sides=(), intended_path=path, intended_s=s,
    )  # fmt: skip
    return DrivenVehicle(spec, path, s, v)


def _steady(world: World, x: float, speed: float, **more: Any) -> DrivenVehicle:
    return _driven(world, x + 0.1 * speed * np.arange(110), np.full(110, speed), **more)


def test_quiet_drive_is_settled_as_it_was(world: Callable[..., World]) -> None:
    scene = world()
    (settled,), failed = settle(scene, [_steady(scene, 20.0, 9.0)], (), NOBODY)
    assert failed == []
    assert settled.retimed == 0
    assert settled.num_steps == 110
    assert settled.motion.s == pytest.approx(20.0 + 0.9 * np.arange(110), abs=0.3)
    assert np.abs(settled.trajectory.position[:, 1]).max() < 1e-6


def test_jerky_drive_comes_out_within_limits(world: Callable[..., World]) -> None:
    """SUMO's braking from 9 to 3 m/s within one step and speeding up again."""
    scene = world()
    v = np.where((np.arange(110) > 30) & (np.arange(110) < 60), 3.0, 9.0)
    s = 20.0 + np.concatenate([[0.0], np.cumsum(0.1 * v[1:])])
    (settled,), _ = settle(scene, [_driven(scene, s, v)], (), NOBODY)
    assert limit_exceeded(settled.trajectory, scene.config.limits, step_s=0.1) is None


def test_drive_into_somebody_recorded_is_retimed(world: Callable[..., World], track: Callable[..., Track]) -> None:
    """Someone stands at 120 m from the start on; SUMO's trace, which ran through, is replaced by one that stops."""
    scene = world(track(range(110), np.full(110, 120.0)))
    (settled,), failed = settle(scene, [_steady(scene, 20.0, 12.0)], (), NOBODY)
    assert failed == []
    assert first_overlap(settled.trajectory, CAR, scene.traffic, margin_m=0.0) is None
    assert settled.motion.s[-1] < 120.0 - 4.5
    assert settled.min_ttc_s >= 1.5


def test_vehicle_that_cannot_be_saved_comes_back_with_the_reason(
    world: Callable[..., World], track: Callable[..., Track]
) -> None:
    """14 m/s, 10 m before a standing vehicle."""
    scene = world(track(range(110), np.full(110, 60.0)))
    settled, ((spec, reason),) = settle(scene, [_steady(scene, 45.0, 14.0)], (), NOBODY)
    assert settled == []
    assert spec.vehicle_id == "v1"
    assert reason


def test_vehicle_ends_where_its_front_leaves_the_map(world: Callable[..., World]) -> None:
    """12 m/s from 100 m: the front bumper reaches the end of 200 m after (97.75 / 12) s = 8.1 s, step 81."""
    scene = world()
    (settled,), _ = settle(scene, [_steady(scene, 100.0, 12.0)], (), NOBODY)
    assert settled.num_steps == pytest.approx(82, abs=2)


def test_vehicle_that_would_leave_before_it_is_predicted_is_slowed_or_dropped(world: Callable[..., World]) -> None:
    """From 150 m at 12 m/s it is gone after 4 s, before timestep 49."""
    scene = world()
    settled, failed = settle(scene, [_steady(scene, 150.0, 12.0)], (), NOBODY)
    assert len(settled) + len(failed) == 1
    assert all(vehicle.num_steps >= 51 for vehicle in settled)


def test_follower_is_settled_behind_its_leader_whatever_their_order(world: Callable[..., World]) -> None:
    """The follower's trace runs into the leader's: the leader keeps its motion, the follower adapts."""
    scene = world()
    follower, leader = _steady(scene, 20.0, 12.0, name="v1"), _steady(scene, 50.0, 6.0, name="v2")
    settled, failed = settle(scene, [follower, leader], (), NOBODY)
    assert failed == []
    assert [vehicle.driven.spec.vehicle_id for vehicle in settled] == ["v2", "v1"]
    assert settled[0].motion.s == pytest.approx(50.0 + 0.6 * np.arange(110), abs=0.4)
    assert first_overlap(settled[1].trajectory, CAR, settled_traffic(settled[:1], 110), margin_m=0.0) is None


def test_vehicles_of_earlier_rounds_stay_as_they_are(world: Callable[..., World]) -> None:
    scene = world()
    first, _ = settle(scene, [_steady(scene, 60.0, 6.0, name="v1")], (), NOBODY)
    fixed = settled_traffic(first, 110)
    (second,), _ = settle(scene, [_steady(scene, 20.0, 12.0, name="v2")], first, fixed)
    assert second.driven.spec.vehicle_id == "v2"
    assert first_overlap(second.trajectory, CAR, fixed, margin_m=0.0) is None


def test_start_is_the_planned_one(world: Callable[..., World]) -> None:
    scene = world()
    (settled,), _ = settle(scene, [_steady(scene, 33.3, 7.7)], (), NOBODY)
    assert (settled.motion.s[0], settled.motion.v[0]) == pytest.approx((33.3, 7.7))
    assert settled.trajectory.position[0] == pytest.approx([33.3, 0.0], abs=1e-6)


def test_nobody_to_settle_is_fine(world: Callable[..., World]) -> None:
    assert settle(world(), [], (), NOBODY) == ([], [])


def test_nobody_waits_at_the_edge_of_the_map_for_the_step_from_which_it_may_leave(world: Callable[..., World]) -> None:
    """Of 200 m the front reaches the end with the centre at 197.75 m: one that stops at 197 m goes on or is dropped."""
    scene = world()
    v = np.maximum(3.0 - 0.06 * np.arange(110), 0.0)
    s = 197.0 - np.sum(0.1 * v[1:]) + np.concatenate([[0.0], np.cumsum(0.1 * v[1:])])
    settled, failed = settle(scene, [_driven(scene, s, v)], (), NOBODY)
    assert len(settled) + len(failed) == 1
    assert all(reason == "stops_at_map_edge" for _, reason in failed)
    assert all(vehicle.motion.v[vehicle.motion.s > 193.0].min() >= 0.5 for vehicle in settled)


def test_who_is_left_without_by_another_is_settled_first_once_more(world: Callable[..., World]) -> None:
    """A slow one, and a fast one behind it that goes first because it turns: it keeps its speed, and the slow one,
    which would have to be faster than it can to keep out of its way, is left without. The other way round both live.
    """
    scene = world(length_m=400.0)
    slow = _steady(scene, 60.0, 4.0, name="v2")
    fast = _steady(scene, 20.0, 12.0, name="v1")
    fast = replace(fast, spec=replace(fast.spec, policy=Policy.LEFT_TURN))
    settled, failed = settle(scene, [fast, slow], (), NOBODY)
    assert failed == []
    by_id = {vehicle.driven.spec.vehicle_id: vehicle for vehicle in settled}
    assert set(by_id) == {"v1", "v2"}
    assert by_id["v2"].motion.s == pytest.approx(60.0 + 0.4 * np.arange(110), abs=0.4)
    assert first_overlap(by_id["v1"].trajectory, CAR, settled_traffic([by_id["v2"]], 110), margin_m=0.0) is None


def test_vehicle_may_drive_as_planned_where_sumo_was_slower(world: Callable[..., World]) -> None:
    scene = world(length_m=400.0)
    driven = _steady(scene, 20.0, 8.0)
    plan_s, plan_v = 20.0 + 1.0 * np.arange(110), np.full(110, 10.0)
    planned = replace(driven.spec, v0=10.0, cruise_mps=10.0, plan_s=plan_s, plan_v=plan_v)
    (settled,), _ = settle(scene, [replace(driven, spec=planned)], (), NOBODY)
    anew = settle_as_planned(scene, settled, ())
    assert anew is not None
    assert anew.motion.s == pytest.approx(plan_s, abs=0.3)
    assert anew.driven is settled.driven
    assert anew.retimed == settled.retimed + 1
    in_the_way, _ = settle(scene, [_steady(scene, 60.0, 6.0, name="v2")], (), NOBODY)
    behind = settle_as_planned(scene, settled, in_the_way)
    assert behind is not None
    assert behind.motion.s[-1] < in_the_way[0].motion.s[-1]
