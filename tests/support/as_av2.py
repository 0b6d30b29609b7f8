"""Whether a recorded scene is read as av2 reads it, to the last bit."""

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from av2.datasets.motion_forecasting.scenario_serialization import load_argoverse_scenario_parquet

from bridge.recordings.recording import Recording
from bridge.recordings.scenario import read_scenario


def read_as_av2(folder: Path) -> Recording:
    """The scene of a folder. Errors: AssertionError where anything in it is not as av2 has it."""
    scenario = read_scenario(folder)
    path = folder / f"scenario_{folder.name}.parquet"
    theirs = load_argoverse_scenario_parquet(path)
    assert (scenario.scenario_id, scenario.city) == (theirs.scenario_id, theirs.city_name)
    assert scenario.focal_track_id == theirs.focal_track_id
    assert scenario.table.equals(pq.read_table(path))
    ours = {track.track_id: track for track in scenario.tracks}
    assert set(ours) == {track.track_id for track in theirs.tracks}
    for track in theirs.tracks:
        mine = ours[track.track_id]
        assert (mine.object_type, mine.category) == (track.object_type.value, track.category.value)
        assert mine.timesteps.tolist() == [state.timestep for state in track.object_states]
        assert np.array_equal(mine.position, [state.position for state in track.object_states])
        assert np.array_equal(mine.velocity, [state.velocity for state in track.object_states])
        assert np.array_equal(mine.heading, [state.heading for state in track.object_states])
    return scenario
