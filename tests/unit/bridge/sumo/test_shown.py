"""Whom SUMO may have to be shown, and when: places along one road, worked out by hand."""

import numpy as np
from hand_drawn import draw_two_lanes
from inserted import recorded, scene_on, start_on

from bridge.sumo.shown import shown_when
from hid2.agents import Policy, Track
from hid2.occupancy.along_path import path_occupancy
from hid2.occupancy.traffic import BoolArray
from hid2.scene import Scene


def _scene(*tracks: Track) -> Scene:
    return scene_on(draw_two_lanes(400.0), *tracks)


def _shown(scene: Scene, policy: Policy = Policy.STRAIGHT) -> BoolArray:
    """Who has to be shown to one that starts at x = 40 with 10 m/s, its desired speed."""
    start = start_on(scene, (1,), 40.0, 10.0, policy=policy)
    seen = path_occupancy(start.path.line, scene.future, start.box)
    return shown_when(scene.traffic, [start], [seen], step_s=scene.step_s)


def test_who_is_ahead_is_shown_who_is_behind_is_not_and_who_is_beside_to_one_that_may_change_lanes() -> None:
    scene = _scene(recorded(60.0, 0.0), recorded(20.0, 0.0, name="behind"), recorded(60.0, 3.5, name="beside"))
    assert _shown(scene).all(axis=1).tolist() == [True, False, False]
    assert _shown(scene).any(axis=1).tolist() == [True, False, False]
    scene = _scene(recorded(60.0, 3.5), recorded(10.0, 3.5, name="behind"))
    assert _shown(scene, Policy.LANE_CHANGE).any(axis=1).tolist() == [True, False]


def test_who_is_far_ahead_is_shown_once_it_may_be_near() -> None:
    """Its rear end is at 237.75 less the own half, 235.5 or 0.5 m less.

    Shown from 40 + 4.5 + 120 + 11 t = 235 on, t = 6.4 s, and three steps before, so that SUMO knows its speed.
    """
    shown = _shown(_scene(recorded(240.0, 0.0)))[0]
    assert 58 <= int(np.flatnonzero(shown)[0]) <= 63
    assert shown[63:].all()


def test_who_crosses_is_shown_around_its_time_on_the_road_only() -> None:
    """From y = -60 upwards with 10 m/s: on the road at 5.5 to 6.5 s, half lengths and half widths 3.2 m."""
    shown = np.flatnonzero(_shown(_scene(recorded(100.0, -60.0, 10.0, heading=np.pi / 2)))[0])
    assert 50 <= int(shown[0]) <= 56
    assert 62 <= int(shown[-1]) <= 67
    assert shown.tolist() == list(range(int(shown[0]), int(shown[-1]) + 1))
