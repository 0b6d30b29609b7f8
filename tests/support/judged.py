"""A generated scene as the second checker judges it once it is written."""

import tempfile
from functools import lru_cache
from pathlib import Path

from second_checker import Finding, check_scene
from second_claims import seen
from second_scene import SecondScene, read_scene
from second_states import check_states

from bridge.generation.scene import TrafficScene


@lru_cache(maxsize=1)
def as_written(scene: TrafficScene) -> SecondScene:
    """The scene, written and read again without hid2's help."""
    with tempfile.TemporaryDirectory() as out:
        return read_scene(scene.write(Path(out)), scene.source.folder)


def manoeuvres_seen(scene: TrafficScene) -> dict[str, set[str]]:
    """Kinds of manoeuvres that are seen in the scene as it is written, by track id of the inserted vehicles."""
    second = as_written(scene)
    return {track.track_id: seen(second, track) for track in second.inserted}


def check_generated(scene: TrafficScene) -> list[Finding | str]:
    """Everything that is wrong with an exported scene."""
    second, replay = as_written(scene), scene.sidecar.replay
    found: list[Finding | str] = [*check_scene(second), *check_states(second)]
    states = sum(len(track.timesteps) for track in scene.source.tracks)
    if max(replay.max_position_error_m, replay.max_heading_error_rad) > 0.001:
        found.append(f"replay is off by {replay.max_position_error_m} m or {replay.max_heading_error_rad} rad")
    if replay.checked and replay.states < states:
        found.append(f"replayed {replay.states} states of {states}")
    return found
