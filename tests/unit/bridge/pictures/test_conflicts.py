"""Conflicts of a scene that is held, as values and as marks; how they are measured: tests/unit/hid2/measures."""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest

from bridge.generation.scene import TrafficScene
from bridge.pictures.render import draw_conflicts
from bridge.recordings.scenario import read_scenario
from hid2.agents import BoxSize, Track
from netconvert.errors import ConfigError

STEPS = 110
SIZE = BoxSize(4.5, 1.9)


@pytest.fixture
def scene(data_scenes):
    """The arterial without its traffic, and a start on one of its lanes: (scenario, origin, direction)."""
    scenario = read_scenario(data_scenes["arterial"])
    lane = max(scenario.graph.lanes.values(), key=lambda lane: lane.length_m)
    origin, direction = lane.centerline[0], lane.centerline[1] - lane.centerline[0]
    return replace(scenario, tracks=()), origin, direction / np.linalg.norm(direction)


def track(name, start, velocity):
    """A car at constant velocity for 11 s."""
    times = np.arange(STEPS) * 0.1
    position, heading = start + times[:, None] * velocity, np.full(STEPS, np.arctan2(velocity[1], velocity[0]))
    return Track(name, "vehicle", 1, np.arange(STEPS), position, heading, np.tile(velocity, (STEPS, 1)), SIZE)


def found(scenario, *tracks, **options):
    return TrafficScene(replace(scenario, tracks=tracks)).conflicts(**options)


def test_only_those_of_one_track(scene):
    scenario, origin, along = scene
    across = np.array([-along[1], along[0]])
    cars = [track(name, origin + (k // 2) * 40 * across, 5 * along) for k, name in enumerate("abcd")]
    assert {(one.first_id, one.second_id) for one in found(scenario, *cars)} == {("a", "b"), ("c", "d")}
    assert {(one.first_id, one.second_id) for one in found(scenario, *cars, agent="d")} == {("c", "d")}
    with pytest.raises(ConfigError, match="no track 'e'"):
        found(scenario, *cars, agent="e")


def test_each_conflict_is_a_mark_and_a_text(scene):
    scenario, origin, along = scene
    conflicts = found(scenario, *(track(name, origin, 5 * along) for name in "ab"))
    figure, axes = plt.subplots()
    draw_conflicts(axes, conflicts)
    assert len(axes.lines) == len(conflicts) == 1
    assert [text.get_text() for text in axes.texts] == ["a, b: rear end, TTC 0.0 s, PET 0.0 s at 0.0 s"]
    plt.close(figure)
