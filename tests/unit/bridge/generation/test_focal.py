"""Which inserted vehicle becomes the focal track."""

from pathlib import Path

import numpy as np
import pytest

from bridge.config import load_config
from bridge.generation.generate import generate
from bridge.recordings.scenario import read_scenario


@pytest.fixture(scope="module")
def scenes(data_scenes: dict[str, Path]):
    """The arterial with an inserted focal track, by the radius in which neighbours count."""
    scenario = read_scenario(data_scenes["arterial"])
    asked = ["request.agents=8", "request.straight=0.3", "request.lane_change=0.5", "request.trigger_max_s=3"]
    asked += ["request.focal=generated"]
    found = {}
    for radius in (50, 20):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("bridge.generation.generate._FOCAL_RADIUS_M", radius)
            found[radius] = generate(scenario, load_config(None, asked))
    return found


def neighbours(scene, track, radius_m):
    at = np.array(
        [t.position[t.timesteps == 49][0] for t in (*scene.source.tracks, *scene.generated) if 49 in t.timesteps]
    )
    return int((np.hypot(*(at - track.position[49]).T) <= radius_m).sum())


@pytest.mark.parametrize("radius", [50, 20])
def test_the_focal_track_does_its_manoeuvre_and_has_the_most_neighbours(scenes, radius):
    """Among the vehicles that live through the scene and have a manoeuvre that is done, none has more."""
    scene = scenes[radius]
    done = {
        agent.track_id for agent in scene.sidecar.agents if any(m.status == "done" for m in agent.maneuvers)
    }  # fmt: skip
    assert scene.recording.focal_track_id in done
    whole = {track.track_id: track for track in scene.generated if len(track.timesteps) == 110}
    counts = {name: neighbours(scene, track, radius) for name, track in whole.items() if name in done}
    assert counts[scene.recording.focal_track_id] == max(counts.values())
    assert len(counts) > 1


def test_one_track_is_focal(scenes):
    tracks = scenes[50].generated
    assert [track.track_id for track in tracks if track.category == 3] == [scenes[50].recording.focal_track_id]
