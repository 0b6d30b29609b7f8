"""What a scene may be at most, and what its readers demand: anything beyond is refused at reading, in one line."""

import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from written import edit_json, edit_rows, in_first_lane

from bridge.files import MAX_FILE_MB
from bridge.recordings import limits
from bridge.recordings.scenario import read_scenario
from netconvert.errors import Hid2Error, MapError, ScenarioError

Document = dict[str, Any]


def refused(folder: Path, said: str) -> None:
    with pytest.raises(Hid2Error, match=said) as caught:
        read_scenario(folder)
    assert isinstance(caught.value, MapError | ScenarioError)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 1000


def _points(document: Document) -> list[dict[str, float]]:
    lists = [area["area_boundary"] for area in document["drivable_areas"].values()]
    for lane in document["lane_segments"].values():
        lists += [lane["left_lane_boundary"], lane["right_lane_boundary"], lane.get("centerline") or []]
    return [point for points in lists for point in points]


def _scale(factor: float, shift: float = 0.0) -> Callable[[Document], None]:
    def change(document: Document) -> None:
        for point in _points(document):
            point.update(x=point["x"] * factor + shift, y=point["y"] * factor + shift)

    return change


def _long_lane(length_m: float) -> Callable[[Document], None]:
    def change(lane: dict[str, Any]) -> None:
        (begin, *_, end), axes = lane["centerline"], ("x", "y")
        stretched = length_m / math.dist(*([point[axis] for axis in axes] for point in (begin, end)))
        for name in ("left_lane_boundary", "right_lane_boundary", "centerline"):
            first = lane[name][0]
            far = {axis: first[axis] + stretched * (end[axis] - begin[axis]) for axis in axes}
            lane[name] = [first, {**first, **far}]

    return in_first_lane(change)


def _many_lanes(document: Document) -> None:
    lane = next(iter(document["lane_segments"].values()))
    for lane_id in range(1, limits.MAX_LANES + 2):
        document["lane_segments"][str(lane_id)] = {**lane, "id": lane_id}


def _flat(document: Document) -> None:
    for area in document["drivable_areas"].values():
        area["area_boundary"] = 3 * area["area_boundary"][:1]


MAPS: dict[str, tuple[Callable[[Document], Any], str]] = {
    "without end": (_scale(1e300), "expected at most"),
    "far away": (_scale(1.0, 1e8), "a coordinate of 1.*e\\+08 m"),
    "a lane of 100 km": (_long_lane(1e5), "lane .*: length, m: 100000, expected at most 5000"),
    "too many lanes": (_many_lanes, r"lane segments: 30\d\d, expected at most 3000"),
    "an id beyond 64 bit": (in_first_lane(lambda lane: lane["successors"].append(2**64)), "an integer of 64 bit"),
    "an id of 4,000 digits": (in_first_lane(lambda lane: lane.update(left_neighbor_id=int("9" * 4000))), "64 bit"),
    "no drivable area": (lambda document: document["drivable_areas"].clear(), "no drivable area, expected"),
    "drivable areas without ground": (_flat, "drivable areas of 0 m2 in all"),
}


@pytest.mark.parametrize("name", MAPS)
def test_map_is_refused(copy_scene: Callable[..., Path], name: str) -> None:
    change, said = MAPS[name]
    folder = copy_scene("curve")
    edit_json(next(folder.glob("log_map_archive_*.json")), change)
    refused(folder, said)


@pytest.mark.parametrize("raw", [b"[" * 200_000, b'{"lane_segments": ' + b"9" * 5000 + b"}"], ids=["deep", "digits"])
def test_map_that_wears_out_its_parser_is_refused(copy_scene: Callable[..., Path], raw: bytes) -> None:
    folder = copy_scene("curve")
    next(folder.glob("log_map_archive_*.json")).write_bytes(raw)
    refused(folder, "not JSON|no object")


@pytest.mark.parametrize(
    ("pattern", "what"), [("*.parquet", "giant"), ("*.json", "pipe"), ("agent_sizes.csv", "giant")]
)
def test_pipe_and_giant_are_refused_unread(copy_scene: Callable[..., Path], pattern: str, what: str) -> None:
    folder = copy_scene("curve")
    path = next(folder.glob(pattern), folder / pattern)
    path.unlink(missing_ok=True)
    if what == "pipe":
        os.mkfifo(path)
    else:
        path.touch()
        os.truncate(path, 10**12)
    refused(folder, "not a regular file" if what == "pipe" else f"more than {MAX_FILE_MB} MB")


def test_table_with_more_than_the_memory_holds_is_refused(
    copy_scene: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A text that is written once may stand in every row: 150 kB that unpack to 13 GB ended an export of many."""

    def read(*_: object, **__: object) -> None:
        raise pa.ArrowMemoryError("realloc of size 4096000000 failed")

    monkeypatch.setattr(pq.ParquetFile, "read", read)
    refused(copy_scene("curve"), r"scenario_.*\.parquet: unpacks to more memory .* expected 256 MB at most")


def _times(column: str, factor: float) -> Callable[[pd.DataFrame], pd.DataFrame]:
    return lambda rows: rows.assign(**{column: rows[column] * factor})


TABLES: dict[str, tuple[Callable[[pd.DataFrame], pd.DataFrame], str]] = {
    "num_timestamps 50": (lambda rows: rows.assign(num_timestamps=50), "num_timestamps 50, expected 110, .* to 110"),
    "no city": (lambda rows: rows.assign(city=""), "city '': expected 1 to 200 characters"),
    "a city without end": (lambda rows: rows.assign(city="x" * 150_000), "city 'x*.* expected 1 to 200 characters"),
    "another id than its file": (lambda rows: rows.assign(scenario_id="x"), "scenario_id 'x', expected the id in"),
    "an id that clears the screen": (
        lambda rows: rows.assign(track_id=rows.track_id.replace({"AV": "AV\x1b[2J"})), r"track_id 'AV\\+x1b\[2J'"),
    "positions far apart": (_times("position_x", 1e4), "track '.*' and the map: spread over .* at most 10000 m"),
    "a velocity beyond all": (
        lambda rows: rows.assign(velocity_x=rows.velocity_x.where(rows.index != 5, 1e200)),
        "velocity 1e\\+200 m/s, expected at most 1000 m/s",
    ),
    "too many tracks": (
        lambda rows: pd.concat([rows, *(rows.iloc[:1].assign(track_id=str(-k)) for k in range(limits.MAX_TRACKS))]),
        r"20\d\d tracks, expected at most 2000",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", TABLES)
def test_table_is_refused(copy_scene: Callable[..., Path], name: str) -> None:
    change, said = TABLES[name]
    folder = copy_scene("curve")
    edit_rows(folder, change)
    refused(folder, said)


def _mine_twice(table: pa.Table) -> pa.Table:
    """Also of a column that nobody asks for: its rows could not be written back."""
    return table.append_column("mine", zeros := pa.array(np.zeros(table.num_rows))).append_column("mine", zeros)


def _city_no_text(table: pa.Table) -> pa.Table:
    city = pa.array([b"\xff\xfe"] * table.num_rows, pa.binary()).view(pa.string())
    return table.set_column(table.schema.get_field_index("city"), "city", city)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (_mine_twice, "more than one column 'mine', expected each once"),
        (lambda _: pa.table({"x": np.zeros(limits.MAX_ROWS + 1)}), r"200001 rows, expected at most 200000"),  # unread
        (_city_no_text, "not a parquet file .*UTF8"),
    ],
)
def test_parquet_is_refused(copy_scene: Callable[..., Path], change: Callable[[pa.Table], pa.Table], said: str) -> None:
    folder = copy_scene("curve")
    (path,) = folder.glob("*.parquet")
    pq.write_table(change(pq.read_table(path)), path)
    refused(folder, said)
