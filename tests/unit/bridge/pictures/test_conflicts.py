"""Conflicts of a scene that is held, as values and as marks; how they are measured: tests/unit/hid2/measures."""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest

from bridge.generation.scene import TrafficScene, read_scene
from bridge.pictures.render import draw_conflicts
from bridge.recordings.scenario import read_scenario
from hid2.agents import BoxSize, Track
from netconvert.errors import ConfigError

STEPS = 110
SIZE = BoxSize(4.5, 1.9)


@pytest.fixture
def scene(data_scenes):
    """The arterial without its traffic, and a start on one of its lanes: (scenario, origin, direction, across)."""
    scenario = read_scenario(data_scenes["arterial"])
    lane = max(scenario.graph.lanes.values(), key=lambda lane: lane.length_m)
    origin, direction = lane.centerline[0], lane.centerline[1] - lane.centerline[0]
    direction = direction / np.linalg.norm(direction)
    return replace(scenario, tracks=()), origin, direction, np.array([-direction[1], direction[0]])


def track(name, start, velocity):
    """A car at constant velocity for 11 s."""
    times = np.arange(STEPS) * 0.1
    return Track(
        track_id=name,
        object_type="vehicle",
        category=1,
        timesteps=np.arange(STEPS),
        position=start + times[:, None] * velocity,
        heading=np.full(STEPS, np.arctan2(velocity[1], velocity[0])),
        velocity=np.tile(velocity, (STEPS, 1)),
        size=SIZE,
    )


def found(scenario, *tracks, **options):
    return TrafficScene(replace(scenario, tracks=tracks)).conflicts(**options)


def test_crossing_has_the_pet_and_the_place(scene):
    r"""
    Both at 10 m/s through one point, B half a second after the boxes of A have left it.

        A ------+------>      A's centre is there at 2.0 s, B's at 2.5 s + the time of the two half boxes
                |
                B
    """
    scenario, origin, along, across = scene
    meeting = origin + 30 * along
    length, width = SIZE.length_m, SIZE.width_m
    behind_s = (length / 2 + width / 2) / 10 * 2  # A's rear leaves B's strip; B's front reaches A's strip
    cars = (
        track("7", meeting - 20 * along, 10 * along),
        track("gen_0", meeting - (20 + 10 * (behind_s + 0.5)) * across, 10 * across),
    )
    (one,) = found(scenario, *cars, ttc_s=0.0)
    assert (one.kind, one.first_id, one.second_id, one.ttc_s) == ("crossing", "7", "gen_0", None)
    assert one.pet_s == pytest.approx(0.5, abs=0.2)
    assert np.linalg.norm([one.x_m, one.y_m] - meeting) < 1.0
    assert one.time_s == pytest.approx(2.0, abs=0.5)
    assert found(scenario, *cars, ttc_s=0.0, pet_s=0.2) == []


def test_follower_that_closes_in_and_touches_is_one_conflict(scene):
    """At 10 m/s, 20 m behind a leader at 5 m/s: TTC is below 1.5 s from 2.5 s on, the boxes touch at 4 s."""
    scenario, origin, along, _ = scene
    cars = (
        track("8", origin + 10 * along, 10 * along),
        track("9", origin + 10 * along + (SIZE.length_m + 20) * along, 5 * along),
    )
    (one,) = found(scenario, *cars)
    assert (one.kind, one.ttc_s) == ("rear_end", 0.0)
    assert (one.start_s, one.time_s) == (pytest.approx(2.5, abs=0.11), pytest.approx(4.0, abs=0.11))
    assert found(scenario, *cars, ttc_s=2.5)[0].start_s == pytest.approx(1.5, abs=0.11)


def test_only_those_of_one_track(scene):
    scenario, origin, along, across = scene
    cars = [track(name, origin + (k // 2) * 40 * across, 5 * along) for k, name in enumerate("abcd")]
    assert {(one.first_id, one.second_id) for one in found(scenario, *cars)} == {("a", "b"), ("c", "d")}
    assert {(one.first_id, one.second_id) for one in found(scenario, *cars, agent="d")} == {("c", "d")}
    with pytest.raises(ConfigError, match="no track 'e'"):
        found(scenario, *cars, agent="e")


def test_generated_vehicles_touch_nothing(made_scene):
    """What the method promises, seen by the function that draws it."""
    met = [one for one in read_scene(made_scene).conflicts(ttc_s=4.0) if "gen_" in one.first_id + one.second_id]
    assert met
    assert all(one.ttc_s is None or one.ttc_s > 0.0 for one in met)


def test_each_conflict_is_a_mark_and_a_text(scene):
    scenario, origin, along, _ = scene
    conflicts = found(scenario, *(track(name, origin, 5 * along) for name in "ab"))
    figure, axes = plt.subplots()
    draw_conflicts(axes, conflicts)
    assert len(axes.lines) == len(conflicts) == 1
    assert [text.get_text() for text in axes.texts] == ["a, b: rear end, TTC 0.0 s, PET 0.0 s at 0.0 s"]
    plt.close(figure)
