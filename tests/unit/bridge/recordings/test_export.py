"""Writing scenes: the same rows bit for bit, the same request the same bytes, never half a folder."""

import itertools
import json
import uuid
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from av2.datasets.motion_forecasting.scenario_serialization import (
    load_argoverse_scenario_parquet,
    serialize_argoverse_scenario_parquet,
)
from av2.map.map_api import ArgoverseStaticMap
from written import edit_json, edit_rows, fake_generated, write_fake

from bridge.config import load_config, new_scenario_id
from bridge.recordings.export import parquet_bytes, with_generated
from bridge.recordings.recording import Recording
from bridge.recordings.scenario import read_scenario
from netconvert.errors import ExportError


@pytest.fixture
def scenario(data_scenes: dict[str, Path]) -> Recording:
    return read_scenario(data_scenes["arterial"])


def table_with_fake(scenario: Recording, *, focal: str | None = None) -> pa.Table:
    """The rows of a scenario with those of made-up vehicles."""
    tracks, sidecar, new_id = fake_generated(scenario)
    focal_track_id = focal or scenario.focal_track_id
    return with_generated(scenario, tracks, sidecar, new_id=new_id, focal_track_id=focal_track_id).table


def test_folder_holds_three_files_with_the_map_of_the_source(scenario: Recording, tmp_path: Path) -> None:
    folder = write_fake(scenario, tmp_path)
    new_id = folder.name
    assert folder.parent == tmp_path / "train"
    assert sorted(path.name for path in folder.iterdir()) == [
        f"hid2_{new_id}.json",
        f"log_map_archive_{new_id}.json",
        f"scenario_{new_id}.parquet",
    ]
    assert [path for path in tmp_path.rglob("*") if path.name.startswith(".")] == []
    map_path = folder / f"log_map_archive_{new_id}.json"
    assert set(ArgoverseStaticMap.from_json(map_path).vector_lane_segments) == set(scenario.graph.lanes)
    assert map_path.read_bytes() == scenario.map_path.read_bytes()
    assert write_fake(replace(scenario, split=None), tmp_path).parent == tmp_path


def test_file_is_as_avs_own_serializer_writes_it(scenario: Recording, tmp_path: Path) -> None:
    """Columns, types and index of a scene that av2 itself loads and serializes again."""
    folder = write_fake(scenario, tmp_path)
    path = folder / f"scenario_{folder.name}.parquet"
    serialize_argoverse_scenario_parquet(tmp_path / "theirs.parquet", load_argoverse_scenario_parquet(path))
    ours, theirs = pd.read_parquet(path), pd.read_parquet(tmp_path / "theirs.parquet")
    assert {"gen_0", "gen_1"} <= set(theirs.track_id)
    assert list(ours.columns) == list(theirs.columns)
    assert ours.dtypes.equals(theirs.dtypes)
    assert ours.index.equals(pd.RangeIndex(len(ours)))
    key = ["track_id", "timestep"]
    for column in ours.columns:
        left, right = (frame.sort_values(key)[column].to_numpy() for frame in (ours, theirs))
        assert (left == right).all(), column
    schema = pq.read_schema(path)
    assert [(field.name, str(field.type)) for field in schema] == [
        ("observed", "bool"), ("track_id", "string"), ("object_type", "string"), ("object_category", "int64"),
        ("timestep", "int64"), ("position_x", "double"), ("position_y", "double"), ("heading", "double"),
        ("velocity_x", "double"), ("velocity_y", "double"), ("scenario_id", "string"), ("start_timestamp", "double"),
        ("end_timestamp", "double"), ("num_timestamps", "int64"), ("focal_track_id", "string"), ("city", "string"),
        ("map_id", "uint64"), ("slice_id", "string"),
    ]  # fmt: skip


def test_columns_are_those_of_the_source_and_recorded_rows_are_kept_to_the_last_bit(
    copy_scene: Callable[..., Path],
) -> None:
    """Negative zero and the smallest numbers too. What the source lacks is not invented; what is its own is kept."""
    folder = copy_scene()

    def change(rows: pd.DataFrame) -> pd.DataFrame:
        rows.loc[3, ["velocity_x", "velocity_y"]] = [-0.0, 5e-324]
        rows.loc[4, "position_x"] = np.nextafter(1.0, 2.0)
        return rows.drop(columns=["map_id", "slice_id"]).assign(note="seen")

    edit_rows(folder, change)
    scenario = read_scenario(folder)
    table = table_with_fake(scenario)
    assert table.schema.names == scenario.table.schema.names
    assert set(table.column("note").to_pylist()[scenario.table.num_rows :]) == {None}
    for name in set(table.schema.names) - {"scenario_id"}:
        ours, source = table.column(name)[: scenario.table.num_rows], scenario.table.column(name)
        if pa.types.is_floating(ours.type):
            assert (ours.to_numpy().view(np.int64) == source.to_numpy().view(np.int64)).all()
        assert ours.equals(source)
    (new_id,) = set(table.column("scenario_id").to_pylist())
    assert new_id != scenario.scenario_id


def test_a_generated_focal_track_demotes_the_recorded_one(scenario: Recording) -> None:
    rows = table_with_fake(scenario, focal="gen_1").to_pandas()
    assert set(rows.focal_track_id) == {"gen_1"}
    assert set(rows[rows.object_category == 3].track_id) == {"gen_1"}
    assert set(rows[rows.track_id == scenario.focal_track_id].object_category) == {2}
    before = scenario.table.to_pandas()
    others = (before.track_id != scenario.focal_track_id).to_numpy()
    recorded = rows.iloc[: len(before)]
    assert (recorded.object_category.to_numpy() == before.object_category.to_numpy())[others].all()


def test_centrelines_are_added_where_the_source_has_none(copy_scene: Callable[..., Path], tmp_path: Path) -> None:
    folder = copy_scene("curve")
    (map_path,) = folder.glob("log_map_archive_*.json")
    before = json.loads(map_path.read_text())
    edit_json(map_path, lambda document: [lane.pop("centerline") for lane in document["lane_segments"].values()])
    out = write_fake(read_scenario(folder), tmp_path)
    after = json.loads((out / f"log_map_archive_{out.name}.json").read_text())
    for key, lane in after["lane_segments"].items():
        known = before["lane_segments"][key]
        lines = lane.pop("centerline"), known.pop("centerline")
        assert {"x", "y", "z"} == set(lines[0][0])
        ends, wanted = ([[line[i][axis] for axis in "xy"] for i in (0, -1)] for line in lines)
        assert np.abs(np.array(ends) - wanted).max() < 0.02
        assert lane == known


def test_ids_are_uuids_and_differ_in_source_configuration_seed_and_variant() -> None:
    config, other = load_config(), load_config(None, ["request.agents=11"])
    values = itertools.product("ab", (config, other), (0, 1), (0, 1))
    ids = {new_scenario_id(source, chosen, seed, variant) for source, chosen, seed, variant in values}
    assert len(ids) == 16
    assert all(str(uuid.UUID(new_id)) == new_id and uuid.UUID(new_id).version == 5 for new_id in ids)


def test_a_folder_there_is_replaced_but_for_what_a_user_laid_into_it(scenario: Recording, tmp_path: Path) -> None:
    folder = write_fake(scenario, tmp_path)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    (folder / "gaps_old.csv.gz").write_text("of an earlier run")
    (folder / f"scenario_{folder.name}.parquet").write_bytes(b"spoiled")
    (folder / "notes.txt").write_text("mine")
    write_fake(scenario, tmp_path)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before | {"notes.txt": b"mine"}
    assert list(folder.parent.iterdir()) == [folder]


@pytest.mark.parametrize("there_before", [False, True])
def test_a_failure_leaves_nothing_half_written(
    scenario: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, there_before: bool
) -> None:
    before = {}
    if there_before:
        before = {path: path.read_bytes() for path in write_fake(scenario, tmp_path).iterdir()}
    write = Path.write_bytes

    def full(path: Path, data: bytes) -> int:
        if path.name.startswith("hid2_"):
            raise OSError(28, "No space left on device")
        return write(path, data)

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(ExportError, match="No space left on device"):
        write_fake(scenario, tmp_path)
    train = tmp_path / "train"
    assert len(list(train.iterdir())) == there_before
    assert {path: path.read_bytes() for path in train.rglob("*") if path.is_file()} == before


def test_a_rename_that_fails_puts_the_old_folder_back(
    scenario: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = write_fake(scenario, tmp_path)
    rename = Path.rename

    def refuse(path: Path, target: Path) -> Path:
        if path.name == "new":
            raise OSError(13, "Permission denied")
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", refuse)
    with pytest.raises(ExportError, match="Permission denied"):
        write_fake(scenario, tmp_path)
    assert len(list(folder.iterdir())) == 3
    assert list(folder.parent.iterdir()) == [folder]


def test_bytes_do_not_depend_on_how_the_source_was_chunked(scenario: Recording) -> None:
    half = scenario.table.num_rows // 2
    chunked = replace(scenario, table=pa.concat_tables([scenario.table[:half], scenario.table[half:]]))
    tables = [table_with_fake(scene) for scene in (scenario, chunked)]
    assert parquet_bytes(tables[0]) == parquet_bytes(tables[1])
