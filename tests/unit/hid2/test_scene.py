from typing import Any

import numpy as np
import pytest
from hand_drawn import draw_road, draw_track

from hid2.agents import BoxSize, Track
from hid2.drivers.driver import place_of_lane
from hid2.params import Config, Request, Spawn
from hid2.scene import Scene, build_scene, clearance_box
from netconvert.cells import build_cell_grid


def scene_of(*tracks: Track, num_steps: int = 110, request: dict[str, Any] | None = None, **sections: Any) -> Scene:
    """A scene on a two-lane road of 200 m."""
    config = Config(request=Request(**(request or {})), **sections)
    last = min(49, num_steps - 1)
    grid = build_cell_grid(draw_road())
    return build_scene(grid, tracks, config=config, num_steps=num_steps, last_observed_step=last, step_s=0.1)


def _moving(x0: float, y: float, speed: float, **more: Any) -> Track:
    return draw_track(range(60), x0 + 0.1 * speed * np.arange(60), y, **more)


def test_speeds_of_a_lane_are_those_of_its_recorded_traffic() -> None:
    scene = scene_of(_moving(10.0, 0.0, 8.0), _moving(10.0, 3.5, 14.0, track_id="u"))
    assert scene.lane_speeds[1] == pytest.approx([8.0])
    assert scene.lane_speeds[2] == pytest.approx([14.0])
    assert sorted(scene.scene_speeds) == pytest.approx([8.0, 14.0])


@pytest.mark.parametrize(
    "more",
    [{"category": 0}, {"object_type": "pedestrian"}, {"object_type": "cyclist"}, {"speed": 0.0}],
    ids=["fragment", "pedestrian", "cyclist", "parked"],
)
def test_fragments_other_road_users_and_parked_vehicles_set_no_speed(more: dict[str, Any]) -> None:
    scene = scene_of(_moving(**{"x0": 10.0, "y": 0.0, "speed": 8.0, **more}))
    assert not scene.scene_speeds
    assert not scene.lane_speeds


def test_who_drives_too_short_a_way_or_time_sets_no_speed(monkeypatch: pytest.MonkeyPatch) -> None:
    """8 m/s for 5.9 s are 47.2 m in 60 steps."""
    one = _moving(10.0, 0.0, 8.0)
    for from_m, from_s, counts in ((47.0, 6.0, True), (48.0, 6.0, False), (47.0, 6.1, False)):
        monkeypatch.setattr("hid2.measures.arrays.MOVING_EXTENT_M", from_m)
        monkeypatch.setattr("hid2.scene.MOVING_S", from_s)
        assert bool(scene_of(one).scene_speeds) is counts


def test_speed_of_a_lane_is_drawn_there_else_from_the_scene_else_it_is_the_prior() -> None:
    """Lane 1 has 8 m/s alone, lane 2 nobody, so that the scene's 8 count; an empty scene has the prior of 9 m/s."""
    rng = np.random.default_rng(0)
    scene = scene_of(_moving(10.0, 0.0, 8.0))
    assert [scene.lane_speed(lane_id, rng) for lane_id in (1, 2)] == pytest.approx([8.0, 8.0])
    assert scene_of(spawn=Spawn(prior_speed_mps=9.0)).lane_speed(1, rng) == 9.0


def test_lane_without_traffic_is_driven_as_the_nearest_of_its_street() -> None:
    """Lane 1 has 12 m/s, lane 2 beside it none: 12, though the scene has one of 9 m/s, off all lanes, as well."""
    rng = np.random.default_rng(0)
    scene = scene_of(_moving(10.0, 0.0, 12.0), _moving(10.0, 60.0, 9.0, track_id="b"))
    assert sorted(scene.scene_speeds) == pytest.approx([9.0, 12.0])
    assert {round(scene.lane_speed(2, rng), 6) for _ in range(40)} == {12.0}


def test_no_vehicle_of_a_lane_crawls_where_its_traffic_drives() -> None:
    """Two at 12 m/s and one at 2: .7 of the median, 8.4 m/s, is the least that is drawn."""
    tracks = (_moving(10.0, 0.0, 12.0, track_id="a"), _moving(60.0, 0.0, 12.0, track_id="b"))
    scene, rng = scene_of(*tracks, _moving(150.0, 0.0, 2.0, track_id="c")), np.random.default_rng(0)
    assert scene.usual_speed(1) == pytest.approx(12.0)
    assert {round(scene.lane_speed(1, rng), 6) for _ in range(60)} == {8.4, 12.0}


def test_place_on_a_lane_is_that_of_recorded_vehicles_within_10_m_else_one_of_the_lane() -> None:
    """One at .4 m to the left from 50 to 150 m: there .4, elsewhere, and on the lane beside, what the lane is given."""
    scene = scene_of(_moving(50.0, 0.4, 100.0 / 5.9))
    here, beside = (scene.place_on(scene.paths.along((lane,)), np.array([20.0, 105.0, 190.0])) for lane in (1, 2))
    law = scene.config.drivers
    assert here == pytest.approx([place_of_lane(law, 1), 0.4, place_of_lane(law, 1)])
    assert beside == pytest.approx(np.full(3, place_of_lane(law, 2)))


def test_clearance_box_covers_both_and_is_rounded_up() -> None:
    """4.31 x 1.81 m in fact, 4.5 x 1.9 m to who knows no size: 4.5 x 1.9; 5.2 x 2.05 m: up to 5.5 x 2.1."""
    assumed = BoxSize(4.5, 1.9)
    small, large = clearance_box(BoxSize(4.31, 1.81), assumed), clearance_box(BoxSize(5.2, 2.05), assumed)
    assert (small.length_m, small.width_m) == pytest.approx((4.5, 1.9))
    assert (large.length_m, large.width_m) == pytest.approx((5.5, 2.1))


@pytest.mark.parametrize(
    ("request_", "steps", "earliest"),
    [({}, 110, 50), ({"focal": "generated"}, 110, 110), ({"generated_category": 2}, 110, 110), ({}, 50, 50)],
)
def test_vehicles_that_are_predicted_stay_as_long_as_they_must(
    request_: dict[str, Any], steps: int, earliest: int
) -> None:
    """Context vehicles to timestep 49 at least, scored and focal ones through the whole scene."""
    assert scene_of(num_steps=steps, request=request_).first_exit_step == earliest
