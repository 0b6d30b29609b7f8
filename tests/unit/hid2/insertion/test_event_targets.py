"""Targets of events: which lanes a recorded vehicle drives."""

from dataclasses import replace

import numpy as np
import pytest
from hand_drawn import draw_crossing
from inserted import recorded, scene_on

from hid2.insertion.event_targets import target_of


def test_lanes_of_a_target_are_those_it_drives_and_what_is_on_none_or_points_against_its_motion_is_none() -> None:
    """What is ahead of a box that is turned round would be behind it. Speeds are those of the positions, not stated."""
    road, track = draw_crossing(), recorded(20.5, 0.0, 10.0)
    target = target_of(scene_on(road, replace(track, velocity=0.9 * track.velocity)), 0)
    assert target is not None
    assert target.speed[10] == pytest.approx(10.0)
    assert (target.lane_at(10), target.lanes_from(10), target.lanes_before(10)) == (1, (1, 2, 3), ())
    off_road = scene_on(road, recorded(20.0, 40.0, 10.0))
    assert target_of(off_road, 0) is None
    assert np.all(off_road.traffic.present[0])
    turned = scene_on(road, replace(track, heading=track.heading + np.pi))
    assert target_of(turned, 0) is None
