"""The scene of a recording, as the method knows it: on its grid, with its tracks."""

from collections.abc import Sequence

from bridge.recordings.recording import Recording
from hid2.agents import Track
from hid2.params import Config
from hid2.scene import Scene, build_scene
from netconvert.cells import CellGrid, build_cell_grid


def grid_of(recording: Recording, config: Config) -> CellGrid:
    """Its lanes in cells. Errors: MapError."""
    return build_cell_grid(recording.graph, cell_m=config.grid.cell_m)


def scene_of(
    recording: Recording, config: Config, grid: CellGrid | None = None, *, tracks: Sequence[Track] | None = None
) -> Scene:
    """The scene; grid: where it is known; tracks: where recorded vehicles drive otherwise. Errors: MapError."""
    return build_scene(
        grid_of(recording, config) if grid is None else grid,
        recording.tracks if tracks is None else tracks,
        config=config,
        num_steps=recording.num_steps,
        step_s=recording.step_s,
        last_observed_step=recording.last_observed,
    )
