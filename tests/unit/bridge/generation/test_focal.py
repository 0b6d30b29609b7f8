"""Which inserted vehicle becomes the focal track."""

from pathlib import Path

import numpy as np
import pytest

from bridge.config import load_config
from bridge.generation.generate import generate
from bridge.generation.scene import TrafficScene
from bridge.recordings.scenario import read_scenario
from hid2.agents import Track


@pytest.fixture(scope="module")
def scene(data_scenes: dict[str, Path]) -> TrafficScene:
    """The arterial with an inserted focal track."""
    asked = ["request.agents=8", "request.straight=0.3", "request.lane_change=0.5", "request.trigger_max_s=3"]
    return generate(read_scenario(data_scenes["arterial"]), load_config(None, [*asked, "request.focal=generated"]))


def neighbours(scene: TrafficScene, track: Track) -> int:
    """Tracks within 50 m at the last observed step."""
    at = np.array(
        [t.position[t.timesteps == 49][0] for t in (*scene.source.tracks, *scene.generated) if 49 in t.timesteps]
    )
    return int((np.hypot(*(at - track.position[49]).T) <= 50.0).sum())


def test_the_focal_track_does_its_manoeuvre_and_has_the_most_neighbours(scene: TrafficScene) -> None:
    """Among the vehicles that live through the scene and have a manoeuvre that is done, none has more."""
    done = {agent.track_id for agent in scene.sidecar.agents if any(m.status == "done" for m in agent.maneuvers)}
    assert scene.recording.focal_track_id in done
    whole = {track.track_id: track for track in scene.generated if len(track.timesteps) == 110}
    counts = {name: neighbours(scene, track) for name, track in whole.items() if name in done}
    assert counts[scene.recording.focal_track_id] == max(counts.values())
    assert len(counts) > 1


def test_one_track_is_focal(scene: TrafficScene) -> None:
    focal = [track.track_id for track in scene.generated if track.category == 3]
    assert focal == [scene.recording.focal_track_id]
