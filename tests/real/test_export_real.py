"""Real scenes written with vehicles added: av2 loads them, validation passes, every recorded bit is kept."""

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from av2.datasets.motion_forecasting.scenario_serialization import load_argoverse_scenario_parquet
from av2.map.map_api import ArgoverseStaticMap
from breaches import breaches
from written import write_fake

from bridge.recordings.scenario import read_scenario


@pytest.mark.parametrize(("number", "focal"), [(0, None), (1, "gen_1")])
def test_real_scene_with_vehicles_added_is_valid(
    real_scenes: list[Path], tmp_path: Path, number: int, focal: str | None, shared_data: Path
) -> None:
    real_scene = real_scenes[number]
    scenario = read_scenario(real_scene)
    folder = write_fake(scenario, tmp_path, focal=focal)
    new_id = folder.name
    assert [one for one in breaches(tmp_path, source=shared_data / "av2") if not one.is_note] == []

    table = pq.read_table(folder / f"scenario_{new_id}.parquet")
    source = pq.read_table(real_scene / f"scenario_{real_scene.name}.parquet")
    assert table.schema.names == source.schema.names
    for name in ("position_x", "position_y", "heading", "velocity_x", "velocity_y"):
        ours, theirs = (column.to_numpy().view(np.int64) for column in (table.column(name), source.column(name)))
        assert np.array_equal(ours[: len(theirs)], theirs)
    again = load_argoverse_scenario_parquet(folder / f"scenario_{new_id}.parquet")
    assert len(again.tracks) == len(scenario.tracks) + 2
    assert again.focal_track_id == (focal or scenario.focal_track_id)
    path = folder / f"log_map_archive_{new_id}.json"
    assert path.read_bytes() == scenario.map_path.read_bytes()
    assert len(ArgoverseStaticMap.from_json(path).vector_lane_segments) == len(
        json.loads(path.read_bytes())["lane_segments"]
    )
