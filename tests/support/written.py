"""A recording and tracks to insert, written as a generated scene."""

from collections.abc import Sequence
from pathlib import Path

from bridge.recordings.export import with_generated, write_recording
from bridge.recordings.recording import Recording
from bridge.recordings.sidecar import Sidecar
from hid2.agents import Track


def write_scene(
    scenario: Recording, tracks: Sequence[Track], sidecar: Sidecar, out: Path, *, new_id: str, focal_track_id: str
) -> Path:
    """Returns its folder."""
    return write_recording(with_generated(scenario, tracks, sidecar, new_id=new_id, focal_track_id=focal_track_id), out)
