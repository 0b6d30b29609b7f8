from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hid2.agents import BoxSize, Track
from hid2.insertion.draws import Draws
from hid2.motion.route import DrivenPath
from hid2.params import Config, Request, Spawn
from hid2.scene import World, build_world, predicted_traffic
from netconvert.cells import Cell, build_cell_grid
from netconvert.lane_graph import LaneGraph


@pytest.fixture
def world(road: Callable[..., LaneGraph], track: Callable[..., Track]) -> Callable[..., World]:
    """world(tracks, request={...}, ...) -> a scene on a two-lane road of 200 m."""

    def make(*tracks: Track, num_steps: int = 110, request: dict[str, Any] | None = None, **sections: Any) -> World:
        config = Config(request=Request(**(request or {})), **sections)
        return build_world(
            build_cell_grid(road()),
            tracks,
            config=config,
            num_steps=num_steps,
            last_observed_step=min(49, num_steps - 1),
        )

    return make


def _moving(track: Callable[..., Track], x0: float, y: float, speed: float, **more: Any) -> Track:
    return track(range(60), x0 + 0.1 * speed * np.arange(60), y, **more)


def test_speeds_of_a_lane_are_those_of_its_recorded_traffic(
    world: Callable[..., World], track: Callable[..., Track]
) -> None:
    scene = world(_moving(track, 10.0, 0.0, 8.0), _moving(track, 10.0, 3.5, 14.0, track_id="u"))
    assert scene.lane_speeds[1] == pytest.approx([8.0])
    assert scene.lane_speeds[2] == pytest.approx([14.0])
    assert sorted(scene.scene_speeds) == pytest.approx([8.0, 14.0])


@pytest.mark.parametrize(
    "more",
    [{"category": 0}, {"object_type": "pedestrian"}, {"object_type": "cyclist"}],
    ids=["fragment", "pedestrian", "cyclist"],
)
def test_fragments_and_other_road_users_set_no_speed(
    more: dict[str, Any], world: Callable[..., World], track: Callable[..., Track]
) -> None:
    scene = world(_moving(track, 10.0, 0.0, 8.0, **more))
    assert not scene.scene_speeds
    assert not scene.lane_speeds


def test_parked_vehicle_sets_no_speed(world: Callable[..., World], track: Callable[..., Track]) -> None:
    assert not world(_moving(track, 10.0, 0.0, 0.0)).scene_speeds


def test_desired_speed_is_of_the_lane_else_of_the_scene_else_the_prior(
    world: Callable[..., World], track: Callable[..., Track]
) -> None:
    still = Spawn(speed_noise=0.0, prior_speed_mps=9.0)
    draws = Draws(np.random.default_rng(0))
    scene = world(_moving(track, 10.0, 0.0, 8.0), spawn=still)
    assert scene.speed_sample(1, draws) == pytest.approx(8.0)
    assert scene.speed_sample(2, draws) == pytest.approx(8.0)
    assert world(spawn=still).speed_sample(1, draws) == pytest.approx(9.0)


def test_desired_speed_stays_within_its_bounds(world: Callable[..., World], track: Callable[..., Track]) -> None:
    draws = Draws(np.random.default_rng(0))
    scene = world(_moving(track, 0.0, 0.0, 30.0), spawn=Spawn(speed_noise=0.5, min_speed_mps=3.0, max_speed_mps=20.0))
    drawn = [scene.speed_sample(1, draws) for _ in range(200)]
    assert min(drawn) >= 3.0
    assert max(drawn) == 20.0


@pytest.mark.parametrize(
    ("request_", "steps", "earliest"),
    [({}, 110, 51), ({"focal": "generated"}, 110, 110), ({"generated_category": 2}, 110, 110), ({}, 50, 50)],
)
def test_vehicles_that_are_predicted_stay_as_long_as_they_must(
    request_: dict[str, Any], steps: int, earliest: int, world: Callable[..., World]
) -> None:
    """Context vehicles to timestep 49 at least, scored and focal ones through the whole scene."""
    assert world(num_steps=steps, request=request_).earliest_exit_step == earliest


def test_paths_and_recorded_intervals_are_made_once(world: Callable[..., World], track: Callable[..., Track]) -> None:
    scene = world(_moving(track, 10.0, 0.0, 8.0))
    path = scene.path((1,))
    assert scene.path((1,)) is path
    assert scene.recorded_on(path, BoxSize(4.5, 1.9)) is scene.recorded_on(path, BoxSize(4.5, 1.9))
    assert scene.cell_at(path, 13.0) == Cell(1, 3)


def test_recorded_occupancy_is_known_beforehand(world: Callable[..., World], track: Callable[..., Track]) -> None:
    """8 m/s from x = 10: after 5 s at 50 m, in cell 12 (48 .. 52), as is known from the start."""
    scene = world(_moving(track, 10.0, 0.0, 8.0))
    row = scene.grid.index_of[Cell(1, 12)]
    assert (scene.occupancy.sigma[0, row], scene.occupancy.sigma[50, row]) == (0, 1)


def test_predicted_boxes_follow_the_plan_until_the_map_ends(straight_path: DrivenPath) -> None:
    """10 m/s from 150 m on a lane of 200 m: the front bumper passes its end when the centre is beyond 197.75 m."""
    plan = 150.0 + np.arange(110)
    traffic = predicted_traffic([("v1", straight_path, BoxSize(4.5, 1.9), plan)], 110)
    assert traffic.position[0, 10].tolist() == pytest.approx([160.0, 0.0], abs=1e-6)
    assert traffic.velocity[0, 10].tolist() == pytest.approx([10.0, 0.0], abs=1e-6)
    assert np.flatnonzero(traffic.present[0]).tolist() == list(range(48))


def test_plan_from_a_later_step_is_present_from_there_on(straight_path: DrivenPath) -> None:
    traffic = predicted_traffic([("v1", straight_path, BoxSize(4.5, 1.9), np.full(80, 50.0))], 110, first_step=30)
    assert traffic.present[0].tolist() == [False] * 30 + [True] * 80


def test_nobody_predicted_is_an_empty_traffic() -> None:
    assert predicted_traffic([], 110).present.shape == (0, 110)


def test_cell_of_a_place_on_a_path(road: Callable[..., LaneGraph]) -> None:
    """200 m of lane in 50 cells of 4 m."""
    scene = build_world(build_cell_grid(road()), (), config=Config(), num_steps=110, last_observed_step=49)
    path = scene.path((1,))
    assert [scene.cell_at(path, s).index for s in (0.0, 3.9, 4.1, 198.0)] == [0, 0, 1, 49]
