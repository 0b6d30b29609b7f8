"""Argoverse 2 motion-forecasting scenarios: parquet and map of a folder -> tracks, lane graph, untouched rows."""

import csv
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq
from pyarrow._compute import call_function  # pyarrow.compute takes longer to import than a scene to read

from bridge.config import is_corridor
from bridge.files import one_line, read_regular
from bridge.recordings import limits
from bridge.recordings.folders import MAP_PATTERN, PARQUET_PATTERN, SIZES_FILE, only_file
from bridge.recordings.folders import SPLITS as SPLITS
from bridge.recordings.folders import find_scenarios as find_scenarios
from bridge.recordings.folders import source_id as source_id
from bridge.recordings.folders import split_of as split_of
from bridge.recordings.map_rules import read_source_map
from bridge.recordings.recording import AV_ID as AV_ID
from bridge.recordings.recording import FOCAL_CATEGORY as FOCAL_CATEGORY
from bridge.recordings.recording import Provenance, Recording
from bridge.recordings.sidecar import RecordingRecord, Sidecar, read_sidecar, sidecar_path
from hid2.agents import DEFAULT_SIZES, BoxSize, FloatArray, IntArray, Track
from netconvert.errors import MapError, NoSceneError, ScenarioError

#: A recording of this format, which generated scenes are in as well.
Scenario = Recording

#: The format's seconds from one timestep to the next, observed timesteps, and timesteps at most.
STEP_S, OBSERVED_STEPS, MAX_STEPS = 0.1, 50, 110

#: Columns that every scenario has, in the order of the format, with their types.
REQUIRED_COLUMNS: Mapping[str, tuple[pa.DataType, ...]] = {
    "observed": (pa.bool_(),),
    "track_id": (pa.string(), pa.large_string()),
    "object_type": (pa.string(), pa.large_string()),
    "object_category": (pa.int64(),),
    "timestep": (pa.int64(),),
    "position_x": (pa.float64(),),
    "position_y": (pa.float64(),),
    "heading": (pa.float64(),),
    "velocity_x": (pa.float64(),),
    "velocity_y": (pa.float64(),),
    "scenario_id": (pa.string(), pa.large_string()),
    "start_timestamp": (pa.float64(), pa.int64()),  # av2's serializer writes the type of its own timestamps
    "end_timestamp": (pa.float64(), pa.int64()),
    "num_timestamps": (pa.int64(),),
    "focal_track_id": (pa.string(), pa.large_string()),
    "city": (pa.string(), pa.large_string()),
}
#: Columns that say the same in every row.
SCENARIO_COLUMNS = ("scenario_id", "start_timestamp", "end_timestamp", "num_timestamps", "focal_track_id", "city")
_MOTION_COLUMNS = ("position_x", "position_y", "heading", "velocity_x", "velocity_y")


class Rows(NamedTuple):
    """The rows of a scenario, checked, and the tracks in them; observed_steps and step_s as in `Recording`."""

    scenario_id: str
    city: str
    focal_track_id: str
    num_steps: int
    tracks: tuple[Track, ...]
    observed_steps: int = OBSERVED_STEPS
    step_s: float = STEP_S

    @property
    def last_observed(self) -> int:
        """The last observed timestep."""
        return min(self.observed_steps, self.num_steps) - 1


def read_scenario(folder: Path) -> Scenario:
    """Read scenario_<id>.parquet, log_map_archive_<id>.json and the sizes that lie beside them.

    Sizes (m) come from the sidecar of a generated scene, from agent_sizes.csv, else by object type. Observed are the
    first 50 timesteps, in a generated scene those of its recording. A scene beyond `limits` is refused, and one that
    breaks what readers of the format demand: nothing recorded is repaired.
    Errors: ScenarioError or MapError with file, id, value and what was expected.
    """
    if not folder.is_dir():
        raise NoSceneError(f"{folder}: no such folder, expected a scenario folder")
    parquet_path = only_file(folder, PARQUET_PATTERN, ScenarioError)
    map_path = only_file(folder, MAP_PATTERN, MapError)
    table = read_table(parquet_path)
    known = recording_record(folder)
    sizes = read_sizes(folder)
    rows = split_rows(table, name=str(parquet_path), sizes=sizes, observed_steps=known.observed_steps)
    if rows.scenario_id != source_id(folder):
        raise ScenarioError(f"{parquet_path}: scenario_id {rows.scenario_id!r}, expected the id in the file's name")
    graph = read_source_map(map_path)
    limits.check_ground(rows.tracks, graph, str(folder))
    return Recording(
        scenario_id=rows.scenario_id,
        city=rows.city,
        focal_track_id=rows.focal_track_id,
        num_steps=rows.num_steps,
        tracks=rows.tracks,
        graph=graph,
        table=table,
        folder=folder,
        map_path=map_path,
        split=split_of(folder),
        observed_steps=known.observed_steps,
        step_s=known.step_s,
        format=known.format,
        provenance=known.provenance,
        sizes=sizes,
        start=known.first_step,
    )


def recording_record(folder: Path) -> RecordingRecord:
    """What is known of the recording in a scenario folder: by the sidecar of a generated scene, else by the format.

    A recorded scene with sizes beside it was labelled by people, any other one tracked. Errors: ScenarioError.
    """
    known = next((sidecar.recording for sidecar in _sidecars(folder)), None)
    if known is not None:
        return known
    provenance: Provenance = "human" if (folder / SIZES_FILE).exists() else "tracker"
    return RecordingRecord(format="argoverse2", provenance=provenance, step_s=STEP_S, observed_steps=OBSERVED_STEPS)


def _sidecars(folder: Path) -> list[Sidecar]:
    return [read_sidecar(path) for path in sorted(folder.glob(sidecar_path(folder, "*").name))]


def read_rows(folder: Path) -> Rows:
    """The rows of a scenario folder, checked as `read_scenario` does, without its map. Errors: ScenarioError."""
    if not folder.is_dir():
        raise NoSceneError(f"{folder}: no such folder, expected a scenario folder")
    path = only_file(folder, PARQUET_PATTERN, ScenarioError)
    known = recording_record(folder)
    sizes = read_sizes(folder)
    rows = split_rows(read_table(path), name=str(path), sizes=sizes, observed_steps=known.observed_steps)
    return rows._replace(step_s=known.step_s)


def read_table(path: Path) -> pa.Table:
    """The rows of a parquet file, every required column present, of its type and without nulls.

    Errors: ScenarioError.
    """
    try:
        file = pq.ParquetFile(io.BytesIO(read_regular(path, most_mb=limits.MAX_FILE_MB)))
        _check_table_size(file.metadata, str(path))
        table = file.read(use_threads=False)
        table.validate(full=True)
    except FileNotFoundError:
        raise ScenarioError(f"{path}: no such file, expected a scenario in parquet") from None
    except MemoryError:
        raise
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise ScenarioError(f"{path}: not a parquet file ({_first_line(error)})") from error
    _check_columns(table, str(path))
    return table


def split_rows(
    table: pa.Table, *, name: str, sizes: Mapping[str, BoxSize], observed_steps: int = OBSERVED_STEPS
) -> Rows:
    """Check the rows of a scenario and split them by track.

    name: what messages call the table; sizes: boxes by track id, by object type where a track has none.
    Errors: ScenarioError with track, timestep, value and what was expected.
    """
    _check_columns(table, name)
    same = {column: _one_value(table, column, name) for column in SCENARIO_COLUMNS}
    for column in ("scenario_id", "focal_track_id", "city"):
        _check_name(str(same[column]), f"{name}: {column}")
    encoded = call_function("dictionary_encode", [table.column("track_id")]).combine_chunks()
    ids: list[str] = encoded.dictionary.to_pylist()
    if len(ids) > limits.MAX_TRACKS:
        raise ScenarioError(f"{name}: {len(ids)} tracks, expected at most {limits.MAX_TRACKS}")
    for track_id in ids:
        _check_name(track_id, f"{name}: track_id")
    code = np.asarray(encoded.indices.to_numpy(zero_copy_only=False), dtype=np.int64)
    timestep = _numbers(table, "timestep").astype(np.int64, copy=False)

    order = _order(code, timestep)
    code, timestep = code[order], timestep[order]
    where = _Where(name, ids, code, timestep)
    motion = np.column_stack([_numbers(table, column)[order] for column in _MOTION_COLUMNS])
    category = _numbers(table, "object_category")[order]
    kind_encoded = call_function("dictionary_encode", [table.column("object_type")]).combine_chunks()
    kinds: list[str] = kind_encoded.dictionary.to_pylist()
    kind = np.asarray(kind_encoded.indices.to_numpy(zero_copy_only=False))[order]

    most_steps = longest(str(same["scenario_id"]))
    _check_timesteps(code, timestep, _numbers(table, "observed")[order], where, (observed_steps, most_steps))
    _check_motion(motion, where)
    for known in kinds:
        if known not in DEFAULT_SIZES:
            raise ScenarioError(f"{name}: object_type {known[:40]!r}, expected one of {', '.join(DEFAULT_SIZES)}")
    outside = (category < 0) | (category > FOCAL_CATEGORY)
    if outside.any():
        row = int(np.flatnonzero(outside)[0])
        raise ScenarioError(f"{where(row)}: object_category {category[row]}, expected 0, 1, 2 or 3")
    starts = np.concatenate([[0], np.flatnonzero(np.diff(code)) + 1])
    run = np.repeat(starts, np.diff(np.concatenate([starts, [len(code)]])))
    for column, values in (("object_category", category), ("object_type", kind)):
        changed = values != values[run]
        if changed.any():
            raise ScenarioError(f"{where(int(np.flatnonzero(changed)[0]))}: {column} changes within the track")

    heading = motion[:, 2]
    if np.abs(heading).max() > np.pi:
        beyond = np.abs(heading) > np.pi
        heading = np.where(beyond, np.pi - np.mod(np.pi - heading, 2 * np.pi), heading)
    position, velocity = np.ascontiguousarray(motion[:, :2]), np.ascontiguousarray(motion[:, 3:])
    tracks = []
    for start, stop in zip(starts, [*starts[1:], len(code)], strict=True):
        track_id, object_type = ids[code[start]], kinds[kind[start]]
        tracks.append(
            Track(
                track_id=track_id,
                object_type=object_type,
                category=int(category[start]),
                timesteps=timestep[start:stop],
                position=position[start:stop],
                heading=heading[start:stop],
                velocity=velocity[start:stop],
                size=sizes.get(track_id, DEFAULT_SIZES[object_type]),
            )
        )
    if (code[starts[:-1]] > code[starts[1:]]).any():  # keep the order of first rows
        tracks.sort(key=lambda track: ids.index(track.track_id))
    steps, stated = int(timestep.max()) + 1, int(str(same["num_timestamps"]))
    if not steps <= stated <= most_steps:
        raise ScenarioError(f"{name}: num_timestamps {stated}, expected {steps}, as many as there are, to {most_steps}")
    _check_focal(tracks, str(same["focal_track_id"]), name, last_observed=observed_steps - 1)
    return Rows(
        scenario_id=str(same["scenario_id"]),
        city=str(same["city"]),
        focal_track_id=str(same["focal_track_id"]),
        num_steps=steps,
        tracks=tuple(tracks),
        observed_steps=observed_steps,
    )


def read_sizes(folder: Path) -> dict[str, BoxSize]:
    """Boxes by track id from agent_sizes.csv (columns track_id, length_m, width_m) and a sidecar, where they exist.

    Errors: ScenarioError.
    """
    sizes: dict[str, BoxSize] = {}
    path = folder / SIZES_FILE
    if path.exists():
        try:
            text = read_regular(path, most_mb=limits.MAX_FILE_MB).decode()
            for number, row in enumerate(csv.DictReader(text.splitlines()), start=2):
                sizes[row["track_id"]] = _size(row, f"{path} line {number}")
        except OSError as error:
            raise ScenarioError(f"{path}: cannot be read ({error.strerror})") from error
        except (KeyError, UnicodeDecodeError, csv.Error) as error:
            raise ScenarioError(
                f"{path}: expected columns track_id, length_m, width_m ({_first_line(error)})"
            ) from error
    for sidecar in _sidecars(folder):
        sizes.update(sidecar.boxes)
    return sizes


class _Where:
    """Names a row in messages."""

    def __init__(self, name: str, ids: list[str], code: IntArray, timestep: IntArray) -> None:
        self._name, self._ids, self._code, self._timestep = name, ids, code, timestep

    def __call__(self, row: int) -> str:
        return f"{self._name}: track {self._ids[self._code[row]]!r}, timestep {self._timestep[row]}"


def _size(row: Mapping[str, str], where: str) -> BoxSize:
    try:
        size = BoxSize(float(row["length_m"]), float(row["width_m"]))
    except (TypeError, ValueError):
        raise ScenarioError(
            f"{where}: length_m {row['length_m']!r}, width_m {row['width_m']!r}, expected metres"
        ) from None
    if not (0 < size.width_m < 10 and 0 < size.length_m < 50):
        raise ScenarioError(f"{where}: box {size.length_m} x {size.width_m} m, expected above 0 and below 50 x 10 m")
    return size


def _check_name(text: str, where: str) -> None:
    """Refuse ids and names that are empty, endless, or do not print: they go into files, tables and messages."""
    if not text or len(text) > limits.MAX_NAME or not text.isprintable():
        shown = one_line(text, most=60)
        raise ScenarioError(f"{where} {shown!r}: expected 1 to {limits.MAX_NAME} characters that can be printed")


def _check_table_size(found: pq.FileMetaData, name: str) -> None:
    """Before anything is unpacked, by what the file says of itself."""
    unpacked_mb = sum(found.row_group(k).total_byte_size for k in range(found.num_row_groups)) / 1e6
    for what, number, most in (
        ("rows", found.num_rows, limits.MAX_ROWS),
        ("columns", found.num_columns, limits.MAX_COLUMNS),
        ("MB unpacked", unpacked_mb, limits.MAX_TABLE_MB),
    ):
        if not 0 <= number <= most:
            raise ScenarioError(f"{name}: {number:g} {what}, expected at most {most}")


def _check_columns(table: pa.Table, name: str) -> None:
    schema = table.schema
    names = schema.names
    for column in names:
        if names.count(column) > 1:
            raise ScenarioError(f"{name}: more than one column {one_line(column, most=60)!r}, expected each once")
    for column, types in REQUIRED_COLUMNS.items():
        indices = schema.get_all_field_indices(column)
        if len(indices) != 1:
            raise ScenarioError(f"{name}: no column {column!r}, expected {types[0]}")
        found = schema.field(indices[0]).type
        if found not in types:
            raise ScenarioError(f"{name}: column {column!r} is {found}, expected {types[0]}")
    for column, types in REQUIRED_COLUMNS.items():
        if table.column(column).null_count:  # what pandas makes of NaN
            row = int(np.flatnonzero(table.column(column).is_null().to_numpy())[0])
            track, step = table.column("track_id")[row].as_py(), table.column("timestep")[row].as_py()
            raise ScenarioError(
                f"{name}: track {track!r}, timestep {step}: {column} is null or NaN, expected {types[0]}"
            )
    if table.num_rows == 0:
        raise ScenarioError(f"{name}: no rows, expected at least one track")


def _numbers(table: pa.Table, column: str) -> npt.NDArray[Any]:
    return np.asarray(table.column(column).to_numpy())


def _one_value(table: pa.Table, column: str, name: str) -> object:
    values = call_function("unique", [table.column(column)])
    if len(values) != 1:
        shown = one_line(str(values[:3].to_pylist()), most=200)
        raise ScenarioError(f"{name}: column {column!r} has {len(values)} values {shown}, expected one")
    return values[0].as_py()


def _order(code: IntArray, timestep: IntArray) -> IntArray | slice:
    """What sorts rows by track and timestep; the identity for files that are sorted, as recorded ones are."""
    if ((np.diff(code) > 0) | ((np.diff(code) == 0) & (np.diff(timestep) > 0))).all():
        return slice(None)
    return np.asarray(np.lexsort((timestep, code)), dtype=np.int64)


def _check_motion(motion: FloatArray, where: _Where) -> None:
    if not np.isfinite(motion).all():
        row, column = np.argwhere(~np.isfinite(motion))[0]
        raise ScenarioError(
            f"{where(row)}: {_MOTION_COLUMNS[column]} is {motion[row, column]}, expected a finite number"
        )
    speed = np.abs(motion[:, 3:]).max(axis=1)
    if speed.max() > limits.MAX_SPEED_MPS:
        row = int(speed.argmax())
        raise ScenarioError(
            f"{where(row)}: velocity {speed[row]:.6g} m/s, expected at most {limits.MAX_SPEED_MPS:g} m/s"
        )


def longest(scenario_id: str) -> int:
    """Timesteps that a scene may have at most."""
    return limits.MAX_CORRIDOR_STEPS if is_corridor(scenario_id) else MAX_STEPS


def _check_timesteps(
    code: IntArray, timestep: IntArray, observed: npt.NDArray[np.bool_], where: _Where, counts: tuple[int, int]
) -> None:
    """counts: observed timesteps, and the most that a scene may have."""
    observed_steps, most_steps = counts
    outside = (timestep < 0) | (timestep >= most_steps)
    if outside.any():
        raise ScenarioError(f"{where(int(np.flatnonzero(outside)[0]))}: expected timesteps 0 to {most_steps - 1}")
    repeated = (np.diff(code) == 0) & (np.diff(timestep) == 0)
    if repeated.any():
        raise ScenarioError(f"{where(int(np.flatnonzero(repeated)[0]))}: more than one row, expected one")
    wrong = observed != (timestep < observed_steps)
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise ScenarioError(f"{where(row)}: observed is {observed[row]}, expected {timestep[row] < observed_steps}")


def _check_focal(tracks: list[Track], focal_track_id: str, name: str, *, last_observed: int) -> None:
    focals = [track for track in tracks if track.category == FOCAL_CATEGORY]
    if [track.track_id for track in focals] != [focal_track_id]:
        have = ", ".join(repr(track.track_id) for track in focals) or "none"
        raise ScenarioError(
            f"{name}: tracks of category {FOCAL_CATEGORY}: {have}, expected focal_track_id {focal_track_id!r} alone"
        )
    if last_observed not in focals[0].timesteps:
        raise ScenarioError(
            f"{name}: focal track {focal_track_id!r} lasts from timestep {focals[0].timesteps[0]} "
            f"to {focals[0].timesteps[-1]}, expected it present at {last_observed}"
        )
    if all(track.track_id != AV_ID for track in tracks):
        raise ScenarioError(f"{name}: no track {AV_ID!r} among {len(tracks)}, readers of the format need one")


def _first_line(error: Exception) -> str:
    return str(error).strip().split("\n", 1)[0]
