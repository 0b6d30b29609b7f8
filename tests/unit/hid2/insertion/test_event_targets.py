"""Targets of events: which lanes a recorded vehicle drives."""

from dataclasses import replace

import numpy as np
import pytest
from hand_drawn import draw_lane
from inserted import recorded, scene_on

from hid2.insertion.event_targets import target_of
from hid2.scene import Scene
from netconvert.lane_graph import LaneGraph


@pytest.fixture
def scene() -> Scene:
    """Lane 1 along +x over 300 m, lane 9 across it along +y at x = 150; one at 10 m/s on lane 1 from 50.5 m on."""
    lanes = draw_lane(1, [(0.0, 0.0), (300.0, 0.0)]), draw_lane(9, [(150.0, -60.0), (150.0, 60.0)])
    return scene_on(LaneGraph({one.lane_id: one for one in lanes}), recorded(50.5, 0.0, 10.0))


def test_lanes_of_a_target_are_those_it_drives_and_who_is_on_none_or_points_against_its_motion_is_none(
    scene: Scene,
) -> None:
    """What is ahead of a box that is turned round would be behind it. Speeds are those of the positions, not stated."""
    track = recorded(50.5, 0.0, 10.0)
    target = target_of(scene_on(scene.grid.graph, replace(track, velocity=0.9 * track.velocity)), 0)
    assert target is not None
    assert target.speed[10] == pytest.approx(10.0)
    assert (target.lane_at(10), target.lanes_from(10), target.lanes_before(10)) == (1, (1,), ())
    off_road = scene_on(scene.grid.graph, recorded(50.0, 40.0, 10.0))
    assert target_of(off_road, 0) is None
    assert np.all(off_road.traffic.present[0])
    turned = scene_on(scene.grid.graph, replace(track, heading=track.heading + np.pi))
    assert target_of(turned, 0) is None
