"""A recording, whatever data set it came from: what generation, evaluation and pictures know of a scene."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path

import numpy as np
import pyarrow as pa

from bridge.recordings.sidecar import Provenance, Sidecar
from hid2.agents import BoxSize, FloatArray, Track
from hid2.measures.arrays import is_generated_id
from netconvert.errors import ConfigError
from netconvert.geometry import slopes
from netconvert.lane_graph import LaneGraph


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Rows:
    """The rows of a scene, checked, and the tracks in them, in the order of their first row.

    table: the rows in the columns of Argoverse 2, as the source has them where it has them; num_steps: last timestep
    + 1; observed_steps: the first so many are what a forecast may see; step_s: seconds from one timestep to the next;
    sizes: boxes that were measured, by track id, all others are by object type.
    """

    table: pa.Table
    scenario_id: str
    city: str
    focal_track_id: str
    num_steps: int
    tracks: tuple[Track, ...]
    observed_steps: int
    step_s: float
    sizes: Mapping[str, BoxSize] = field(default_factory=dict)

    @property
    def last_observed(self) -> int:
        """The last observed timestep: a track that is forecast is present here."""
        return min(self.observed_steps, self.num_steps) - 1


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class Recording(Rows):
    """One scene: recorded, or with vehicles that were inserted.

    folder: the folder or file that was read; map_path: its map; map_json: the map as Argoverse 2 has it, where map_path
    is none; start: first step of the source that is in it; sequence: the bytes of an Argoverse 1 file; sidecar: what is
    known of inserted vehicles, None: it was recorded.
    """

    graph: LaneGraph
    folder: Path
    map_path: Path
    split: str | None
    format: str = "argoverse2"
    provenance: Provenance = "tracker"
    map_json: bytes | None = None
    start: int = 0
    sequence: bytes | None = None
    sidecar: Sidecar | None = None

    def __repr__(self) -> str:
        """Id, city, and how much is in it."""
        size = f"{len(self.tracks)} tracks, {self.num_steps} steps of {self.step_s:g} s"
        return f"Recording({self.scenario_id}, {self.city}: {size})"

    def track(self, track_id: str) -> Track:
        """One track by id. Errors: ConfigError for an unknown one, with those that are most like it."""
        known = {track.track_id: track for track in self.tracks}
        if (track_id := str(track_id)) not in known:
            ordered = sorted(known, key=lambda name: (not is_generated_id(name), name))
            alike = ", ".join(get_close_matches(track_id, known, 5, 0.4) or ordered[:5])
            raise ConfigError(f"{self.folder}: no track {track_id!r} among {len(known)}; expected one of {alike}, ...")
        return known[track_id]


def velocity_of(position: FloatArray, samples: int, *, step_s: float, shortest: int = 3) -> FloatArray:
    """(N, 2) m/s: slopes of parabolas fitted over an unbroken run of positions (N, 2) m.

    A run of fewer samples takes the longest odd window, one shorter than the shortest its mean.
    """
    count = len(position)
    if count < shortest:
        return np.repeat((position[-1:] - position[:1]) / (step_s * max(count - 1, 1)), count, axis=0)
    return slopes(position, min(samples, count - (count + 1) % 2), step_s)
