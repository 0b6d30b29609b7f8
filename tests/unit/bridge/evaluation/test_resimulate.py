"""Recorded vehicles of the synthetic scenes, driven again."""

from pathlib import Path

import numpy as np
import pytest

from bridge.evaluation.resimulate import Resimulation
from bridge.recordings.scenario import read_scenario
from bridge.recordings.sidecar import read_sidecar, sidecar_path
from hid2.evaluation.likelihood import NOW
from hid2.evaluation.resimulated import Left, begin, own_path
from hid2.params import Config
from hid2.policy.roads import Roads
from hid2.scene import build_scene


@pytest.fixture(scope="module")
def made(data_scenes: dict[str, Path]) -> Resimulation:
    return Resimulation(read_scenario(data_scenes["intersection"]))


@pytest.fixture(scope="module")
def rollouts(made: Resimulation):
    return list(made.rollouts(Config(), 3, model="calibrated", vehicles=made.vehicles))


def test_every_vehicle_is_driven_or_left_with_a_reason(made):
    vehicles = {track.track_id for track in made.recording.tracks if track.object_type in {"vehicle", "bus"}}
    driven = {one.track.track_id for one in made.vehicles}
    assert driven | made.left.keys() == vehicles
    assert not driven & made.left.keys()
    for track in made.recording.tracks:
        if track.track_id in driven:
            assert track.category > 0
            assert track.path_m > 5.0
        elif made.left.get(track.track_id) is Left.FRAGMENT:
            assert track.category == 0


def test_history_and_all_others_are_as_recorded_and_vehicles_go_on_from_the_present_without_a_jump(made, rollouts):
    """The first driven step is that of the speed at the present, within what a car can change in 0.1 s and noise.

    One at a time leaves the others as recorded, too, and drives at the pace of them all: no prior decides.
    """
    rows = [one.row for one in made.vehicles]
    others = [row for row in range(len(made.logged.ids)) if row not in rows]
    for rollout in rollouts:
        np.testing.assert_array_equal(rollout.position[others], made.logged.position[others])
        np.testing.assert_array_equal(rollout.present[others], made.logged.present[others])
        np.testing.assert_array_equal(rollout.position[:, : NOW + 1], made.logged.position[:, : NOW + 1])
        for one in made.vehicles:
            step = rollout.position[one.row, NOW + 1] - rollout.position[one.row, NOW]
            assert np.hypot(*step) == pytest.approx(0.1 * one.speed_mps, abs=0.1)
            assert rollout.present[one.row, NOW:].all()
    own, *rows = rows
    (rollout,) = made.rollouts(Config(), 1, model="calibrated", vehicles=made.vehicles[:1])
    np.testing.assert_array_equal(rollout.position[rows], made.logged.position[rows])
    assert np.abs(rollout.position[own] - made.logged.position[own]).max() > 0.1
    other = Config.model_validate({"spawn": {"prior_speed_mps": 14.0}})
    (same,) = made.rollouts(other, 1, model="calibrated", vehicles=made.vehicles[:1])
    np.testing.assert_array_equal(same.position, rollout.position)


def test_rollouts_and_drivers_differ_and_the_same_seed_gives_the_same(made, rollouts):
    again = list(made.rollouts(Config(), 2, model="calibrated", vehicles=made.vehicles))
    for first, second in zip(rollouts, again, strict=False):
        np.testing.assert_array_equal(first.position, second.position)
    assert np.abs(rollouts[0].position - rollouts[1].position).max() > 0.5
    (default,) = made.rollouts(Config(), 1, model="default", vehicles=made.vehicles)
    assert np.abs(default.position - rollouts[0].position).max() > 5.0


def test_a_rollout_as_recorded_is_what_was_recorded(made):
    """Velocities, from which TTC is worked out, are by one rule in both."""
    logged, through = made.logged, [one for one in made.vehicles if made.logged.present[one.row, -1]]
    driven = [(logged.position[one.row, NOW:], logged.heading[one.row, NOW:]) for one in through]
    same, rows = made._with(through, driven), [one.row for one in through]
    there = logged.present[rows]
    assert there.any()
    np.testing.assert_array_equal(same.velocity[rows][there], logged.velocity[rows][there])


def test_constant_velocity_is_that_of_the_half_second_before(made):
    (rollout,) = made.rollouts(Config(), 32, model="constant velocity", vehicles=made.vehicles)
    for one in made.vehicles:
        went = rollout.position[one.row, 90] - rollout.position[one.row, NOW]
        np.testing.assert_allclose(went, 8.0 * one.velocity, atol=1e-9)
        past = made.logged.position[one.row, NOW - 5 : NOW + 1]
        np.testing.assert_allclose(one.velocity, (past[-1] - past[0]) / 0.5, atol=0.5)


def test_driver_keeps_no_more_from_its_leader_than_at_the_present(made):
    """With a gap of 4 m at 8 m/s a driver that wants 1.1 s would brake at once: it came with .5 s at most."""
    scene = build_scene(made._grid, [], config=Config(), num_steps=100, step_s=0.1, last_observed_step=39)
    one = max(made.vehicles, key=lambda one: one.speed_mps)
    for gap_m, tau_s in ((4.0, 0.5), (float("inf"), None)):
        near = type(one)(one.row, one.track, one.route, one.position, one.heading, one.velocity, gap_m)
        start = begin(
            scene, Roads(scene), near, own_path(scene, near), np.random.default_rng(0), number=0, usual_mps=8.0
        )
        assert start.start_mps == pytest.approx(one.speed_mps)
        assert (start.driver.tau_s == tau_s) == (tau_s is not None)


def test_written_rollout_is_a_scene_that_says_what_it_is(made, rollouts, tmp_path):
    folder = made.write(rollouts[1], Config(), 1, tmp_path)
    read = read_scenario(folder)
    assert read.num_steps == made.recording.num_steps
    assert len(read.tracks) == len(made.recording.tracks)
    row = made.vehicles[0].row
    track = read.track(made.vehicles[0].track.track_id)
    np.testing.assert_allclose(track.position[track.timesteps > NOW], rollouts[1].position[row, NOW + 1 :], atol=1e-6)
    assert track.timesteps[-1] == made.recording.num_steps - 1
    sidecar = read_sidecar(sidecar_path(folder, folder.name))
    assert sidecar.replay.mode == "reactive"
    assert set(sidecar.replay.late_s) == {one.track.track_id for one in made.vehicles}
    assert sidecar.source_scenario_id == made.recording.scenario_id


def test_vehicles_keep_to_the_lanes_that_they_were_recorded_on(made, rollouts):
    for one in made.vehicles:
        line = np.concatenate([made.recording.graph.lanes[lane].centerline for lane in one.route])
        xy = rollouts[0].position[one.row, NOW : NOW + 40]
        assert np.hypot(*(xy[:, None] - line[None]).transpose(2, 0, 1)).min(axis=1).max() < 6.0
