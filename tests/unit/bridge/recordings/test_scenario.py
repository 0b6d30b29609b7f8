"""Reading scenarios: what comes out of good ones, and what is said about bad ones."""

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from as_av2 import read_as_av2
from written import edit_rows, in_cell

from bridge.recordings.folders import split_of
from bridge.recordings.scenario import read_scenario
from bridge.recordings.sources import find_scenarios, find_sources
from hid2.agents import DEFAULT_SIZES
from netconvert.errors import MapError, ScenarioError


def test_scene_reads_as_av2_reads_it_and_its_map_is_left_alone(data_scene: Path) -> None:
    map_path = data_scene / f"log_map_archive_{data_scene.name}.json"
    before = map_path.read_bytes()
    scenario = read_as_av2(data_scene)
    assert map_path.read_bytes() == before
    assert set(json.loads(before)["lane_segments"]) == {str(lane) for lane in scenario.graph.lanes}


def test_tracks_keep_the_order_of_their_first_rows(copy_scene: Callable[..., Path]) -> None:
    folder = copy_scene()
    before = read_scenario(folder).tracks
    edit_rows(folder, lambda rows: rows.iloc[::-1])
    for track, same in zip(before, reversed(read_scenario(folder).tracks), strict=True):
        assert same.track_id == track.track_id
        assert np.array_equal(same.timesteps, track.timesteps)
        assert np.array_equal(same.position, track.position)


def test_headings_are_wrapped_only_where_they_need_it(copy_scene: Callable[..., Path]) -> None:
    folder = copy_scene()
    before = read_scenario(folder).track("AV").heading
    edit_rows(
        folder, lambda rows: rows.assign(heading=rows.heading.where(rows.timestep != 3, rows.heading + 2 * np.pi))
    )
    after = read_scenario(folder).track("AV").heading
    assert np.array_equal(np.delete(after, 3), np.delete(before, 3))
    assert after[3] == pytest.approx(before[3])


def test_sizes_come_from_the_file_beside_and_else_from_the_type(copy_scene: Callable[..., Path]) -> None:
    folder = copy_scene()
    (folder / "agent_sizes.csv").write_text("track_id,length_m,width_m\nAV,4.9,2.0\n")
    scenario = read_scenario(folder)
    assert scenario.track("AV").size == (4.9, 2.0)
    assert (scenario.provenance, read_scenario(copy_scene("curve")).provenance) == ("human", "tracker")
    bus = next(track for track in scenario.tracks if track.object_type == "bus")
    assert bus.size == DEFAULT_SIZES["bus"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("track_id,length_m\nAV,4.9\n", "line 2: no width_m, expected one"),
        ("track_id,length_m,width_m\nAV,4.9,2.0\nfocal,4.9\n", "line 3: no width_m, expected one"),
        ("track_id,length_m,width_m\nAV,long,2.0\n", "line 2: length_m 'long'"),
        ("track_id,length_m,width_m\nAV,-4.9,2.0\n", "line 2: length_m .-4.9., expected greater than 0"),
    ],
)
def test_bad_sizes_are_named(copy_scene: Callable[..., Path], text: str, said: str) -> None:
    folder = copy_scene()
    (folder / "agent_sizes.csv").write_text(text)
    with pytest.raises(ScenarioError, match=said) as caught:
        read_scenario(folder)
    assert "agent_sizes.csv" in str(caught.value)


def test_scenarios_are_found_from_folder_split_and_root_and_no_folder_is_said(
    data_root: Path, data_scenes: dict[str, Path], tmp_path: Path
) -> None:
    assert find_scenarios(data_scenes["arterial"]) == [data_scenes["arterial"]]
    assert find_scenarios(data_root / "val") == [data_scenes["intersection"]]
    assert find_scenarios(data_root) == sorted(data_scenes.values())
    with pytest.raises(ScenarioError, match="no such folder"):
        read_scenario(tmp_path / "nowhere")


def test_sources_are_recorded_scenes_each_once(
    data_root: Path, data_scenes: dict[str, Path], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A root with what was generated from it beside, the root again, and one scene under another name."""
    root = tmp_path / "root"
    shutil.copytree(data_root, root)
    generated = root / "val" / "generated"
    shutil.copytree(data_scenes["intersection"], generated)
    (generated / "hid2_generated.json").write_text("{}")
    (tmp_path / "link").symlink_to(root / "val" / data_scenes["intersection"].name)
    found = find_sources([root, tmp_path / "link", root / "train"])
    assert found == [root / scene.relative_to(data_root) for scene in sorted(data_scenes.values())]
    assert caplog.messages == [
        f"{root}: 1 of 4 scenes passed over, which hid2 wrote",
        f"{tmp_path / 'link'} (and 2 more): given more than once, done once",
    ]
    with pytest.raises(ScenarioError, match=r"generated: holds generated scenes only .*; give recorded ones"):
        find_sources([root, generated])


def test_split_is_that_of_the_name_also_behind_links(
    data_root: Path, data_scenes: dict[str, Path], tmp_path: Path
) -> None:
    """A split may be a link to wherever there was room, or a scene a link into a split."""
    scene = data_scenes["curve"]
    shutil.copytree(data_root / "train", tmp_path / "disk" / "argoverse-train")
    (tmp_path / "train").symlink_to(tmp_path / "disk" / "argoverse-train")
    (tmp_path / "scene").symlink_to(scene)
    assert read_scenario(tmp_path / "train" / scene.name).split == "train"
    assert read_scenario(tmp_path / "scene").split == "train"
    assert read_scenario(tmp_path / "disk" / "argoverse-train" / scene.name).split is None
    assert split_of(Path(scene.name)) is None


def test_a_folder_that_may_not_be_read_does_not_hide_the_scenes_beside_it(
    data_root: Path, data_scenes: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:  # fmt: skip
    """Such as lost+found at the root of a disk; one that is hidden is not looked into."""
    root = tmp_path / "root"
    shutil.copytree(data_root, root)
    shutil.copytree(data_root / "train", root / ".trash")
    (root / "lost+found").mkdir()
    iterdir = Path.iterdir

    def refuse(path: Path) -> Iterator[Path]:
        if path.name == "lost+found":
            raise PermissionError(13, "Permission denied", str(path))
        return iterdir(path)

    monkeypatch.setattr(Path, "iterdir", refuse)
    assert [path.name for path in find_scenarios(root)] == [path.name for path in sorted(data_scenes.values())]
    assert f"{root / 'lost+found'}: cannot be read (Permission denied)" in caplog.messages


def test_missing_map_and_missing_or_second_parquet_are_said(copy_scene: Callable[..., Path]) -> None:
    folder = copy_scene()
    (map_path,) = folder.glob("log_map_archive_*.json")
    raw = map_path.read_bytes()
    map_path.unlink()
    with pytest.raises(MapError, match=r"no log_map_archive_<id>.json in .*; expected exactly one"):
        read_scenario(folder)
    map_path.write_bytes(raw)
    (folder / "scenario_other.parquet").write_bytes(b"")
    with pytest.raises(ScenarioError, match=r"2 files scenario_<id>.parquet in .*; expected exactly one"):
        read_scenario(folder)
    for path in folder.glob("scenario_*.parquet"):
        path.unlink()
    assert find_scenarios(folder) == [folder]
    with pytest.raises(ScenarioError, match=r"no scenario_<id>.parquet in .*; expected exactly one"):
        read_scenario(folder)


COLUMNS = [
    "observed", "track_id", "object_type", "object_category", "timestep", "position_x", "position_y", "heading",
    "velocity_x", "velocity_y", "scenario_id", "start_timestamp", "end_timestamp", "num_timestamps", "focal_track_id",
    "city",
]  # fmt: skip


def test_a_missing_column_and_a_wrong_dtype_are_named(copy_scene: Callable[..., Path]) -> None:
    folder = copy_scene()
    (path,) = folder.glob("scenario_*.parquet")
    whole = pd.read_parquet(path)
    for column in COLUMNS:
        whole.assign(**{column: np.arange(len(whole), dtype=np.int16)}).to_parquet(path)
        with pytest.raises(ScenarioError, match=f"column '{column}' is int16, expected"):
            read_scenario(folder)
        whole.drop(columns=column).to_parquet(path)
        with pytest.raises(ScenarioError, match=f"no column '{column}', expected"):
            read_scenario(folder)


@pytest.mark.parametrize(
    ("column", "value", "said"),
    [
        ("track_id", None, "track_id is null or NaN, expected"),
        # pandas writes NaN as null, other writers as NaN
        ("position_x", np.nan, "track '310100', timestep 5: position_x is nan, expected a finite number"),
    ],
)
def test_nulls_and_nan_are_named(copy_scene: Callable[..., Path], column: str, value: float | None, said: str) -> None:
    (path,) = copy_scene().glob("scenario_*.parquet")
    table = pq.read_table(path)
    index = table.schema.get_field_index(column)
    values = table.column(index).to_pylist()
    values[5] = value
    pq.write_table(table.set_column(index, table.schema.field(index), [values]), path)
    with pytest.raises(ScenarioError, match=said):
        read_scenario(path.parent)


def _scored_focal(rows: pd.DataFrame) -> pd.DataFrame:
    return rows.assign(object_category=rows.object_category.where(rows.object_category < 3, 2))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (in_cell("AV", 7, "position_x", np.nan), r"row \d+ \(track_id 'AV', timestep 7\): position_x is null or NaN"),
        (in_cell("AV", 7, "position_y", np.inf), "track 'AV', timestep 7: position_y is inf"),
        (in_cell("AV", 7, "timestep", 8), "track 'AV', timestep 8: more than one row, expected one"),
        (in_cell("AV", 109, "timestep", 110), "track 'AV', timestep 110: expected timesteps 0 to 109"),
        (in_cell("AV", 7, "observed", False), "track 'AV', timestep 7: observed is False, expected True"),
        (in_cell("AV", 7, "object_category", 4), "track 'AV', timestep 7: object_category 4, expected 0, 1, 2 or 3"),
        (in_cell("AV", 7, "object_category", 2), "track 'AV', timestep 7: object_category changes within the track"),
        (in_cell("AV", 7, "object_type", "spaceship"), "object_type 'spaceship', expected one of vehicle, bus"),
        (in_cell("AV", 7, "city", "miami"), r"column 'city' has 2 values \['austin', 'miami'\], expected one"),
        (_scored_focal, "tracks of category 3: none, expected focal_track_id '310100' alone"),
        (lambda rows: rows.assign(focal_track_id="x"), "category 3: '310100', expected focal_track_id 'x' alone"),
        (lambda rows: rows[(rows.track_id != "310100") | (rows.timestep < 49)], "0 to 48, expected it present at 49"),
        (lambda rows: rows[rows.track_id != "AV"], "no track 'AV' among 25"),
        (lambda rows: rows.iloc[:0], "no rows"),
    ],
)
def test_a_bad_row_is_named(
    copy_scene: Callable[..., Path], change: Callable[[pd.DataFrame], pd.DataFrame], said: str
) -> None:
    folder = copy_scene()
    edit_rows(folder, change)
    with pytest.raises(ScenarioError, match=said) as caught:
        read_scenario(folder)
    assert "scenario_" in str(caught.value)
