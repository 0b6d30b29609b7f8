"""Real scenes read as av2 reads them."""

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from av2.datasets.motion_forecasting.scenario_serialization import load_argoverse_scenario_parquet

from bridge.recordings.scenario import find_scenarios, read_scenario


def test_real_scene_reads_as_av2_reads_it(real_scene: Path) -> None:
    scenario = read_scenario(real_scene)
    path = real_scene / f"scenario_{real_scene.name}.parquet"
    theirs = load_argoverse_scenario_parquet(path)
    assert (scenario.scenario_id, scenario.city) == (theirs.scenario_id, theirs.city_name)
    assert scenario.focal_track_id == theirs.focal_track_id
    assert scenario.num_steps == (50 if real_scene.parent.name == "test" else 110)
    assert scenario.split == real_scene.parent.name
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


def test_sizes_of_labelled_scenes_are_used(real_scenes: list[Path]) -> None:
    for folder in real_scenes:
        scenario = read_scenario(folder)
        labelled = (folder / "agent_sizes.csv").is_file()
        assert labelled == (folder.name[:8] in ("3b3570b4", "7fab2350"))
        assert scenario.track("AV").size == ((4.877, 2.0) if labelled else (4.5, 1.9))


def test_all_six_are_found_from_the_root(shared_data: Path, real_scenes: list[Path]) -> None:
    assert find_scenarios(shared_data / "av2") == sorted(real_scenes)
