"""Argoverse 2 motion-forecasting scenarios: parquet and map of a folder -> tracks, lane graph, untouched rows."""

import csv
import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import FailFast, TypeAdapter, ValidationError
from typing_extensions import TypedDict

from bridge.config import is_corridor
from bridge.files import one_line, read_received
from bridge.recordings import limits
from bridge.recordings.folders import MAP_PATTERN, PARQUET_PATTERN, SIZES_FILE, Source, only_file, source_id, split_of
from bridge.recordings.map_rules import check_ground, read_source_map
from bridge.recordings.recording import Recording, Rows
from bridge.recordings.sidecar import BoxLength, BoxWidth, Provenance, RecordingRecord, Sidecar, sidecar_in
from hid2.agents import AV_ID, DEFAULT_SIZES, FOCAL_CATEGORY, BoxSize, FloatArray, IntArray, Track
from netconvert.av2_map import Breach
from netconvert.errors import MapError, NoSceneError, ScenarioError
from netconvert.geometry import wrap_angle
from netconvert.lane_graph import LaneGraph

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
SCHEMA = pa.schema([(name, types[0]) for name, types in REQUIRED_COLUMNS.items()])
#: Columns that say the same in every row.
SCENARIO_COLUMNS = ("scenario_id", "start_timestamp", "end_timestamp", "num_timestamps", "focal_track_id", "city")
#: Columns that messages name a row by.
_NAMES_A_ROW = ("track_id", "timestep", "track_uuid", "timestamp_ns")
MOTION_COLUMNS = ("position_x", "position_y", "heading", "velocity_x", "velocity_y")
_Row = TypeVar("_Row")


class _Sizes(TypedDict):
    track_id: str
    length_m: BoxLength
    width_m: BoxWidth


_SIZES = TypeAdapter(Annotated[list[_Sizes], FailFast()])


def read_scenario(folder: Path) -> Recording:
    """Read scenario_<id>.parquet, log_map_archive_<id>.json and the sizes that lie beside them.

    Sizes (m) come from the sidecar of a generated scene, from agent_sizes.csv, else by object type. Observed are the
    first 50 timesteps, in a generated scene those of its recording. A scene beyond `limits` is refused, and one that
    breaks what readers of the format demand: nothing recorded is repaired.
    Errors: ScenarioError or MapError with file, id, value and what was expected.
    """
    rows, known, sidecar = read_rows(folder)
    map_path = only_file(folder, MAP_PATTERN, MapError)
    if rows.scenario_id != source_id(folder):
        path = only_file(folder, PARQUET_PATTERN, ScenarioError)
        raise ScenarioError(f"{path}: scenario_id {rows.scenario_id!r}, expected the id in the file's name")
    source = Source(folder, known.format, rows.scenario_id, split_of(folder), known.first_step, map_path)
    return recording_of(source, rows, read_source_map(map_path), provenance=known.provenance, sidecar=sidecar)


def recording_of(source: Source, rows: Rows, graph: LaneGraph, **more: Any) -> Recording:  # noqa: ANN401
    """A recording of rows that were checked and a map that they have to lie on; more: other fields of `Recording`.

    Errors: ScenarioError.
    """
    check_ground(rows.tracks, graph, str(source.path))
    assert source.map_path is not None
    own = {one.name: getattr(rows, one.name) for one in fields(rows)}
    given = {name: getattr(source, name) for name in ("map_path", "split", "format", "start")}
    return Recording(**own, **more, **given, graph=graph, folder=source.path)


def read_rows(folder: Path) -> tuple[Rows, RecordingRecord, Sidecar | None]:
    """The rows of a scenario folder, checked as `read_scenario` does, what is known of their recording, the sidecar.

    A recorded scene with sizes beside it was labelled by people, any other one tracked. Errors: ScenarioError.
    """
    if not folder.is_dir():
        raise NoSceneError(f"{folder}: no such folder, expected a scenario folder")
    path = only_file(folder, PARQUET_PATTERN, ScenarioError)
    table, sidecar = read_table(path), sidecar_in(folder)
    by: Provenance = "human" if (folder / SIZES_FILE).exists() else "tracker"
    recorded = RecordingRecord(format="argoverse2", provenance=by, step_s=STEP_S, observed_steps=OBSERVED_STEPS)
    known, sizes = recorded if sidecar is None else sidecar.recording, sizes_of(folder, sidecar)
    rows = split_rows(table, name=str(path), sizes=sizes, observed_steps=known.observed_steps)
    return replace(rows, step_s=known.step_s), known, sidecar


def table_of(tracks: Sequence[Track], same: Mapping[str, object], *, observed_steps: int) -> pa.Table:
    """The rows of tracks in the columns of the format. same: what every row says, by column."""
    columns = track_columns(tracks, observed_steps)
    count = len(columns["timestep"])
    constants = {name: pa.repeat(pa.scalar(value, SCHEMA.field(name).type), count) for name, value in same.items()}
    return pa.table(columns | constants, schema=SCHEMA)


def track_columns(tracks: Sequence[Track], observed_steps: int) -> dict[str, pa.Array]:
    """The columns that differ from row to row, of tracks one after the other."""
    timestep = np.concatenate([np.empty(0, np.int64), *(track.timesteps for track in tracks)])
    each = (np.column_stack([track.position, track.heading, track.velocity]) for track in tracks)
    motion = np.concatenate([np.empty((0, len(MOTION_COLUMNS))), *each])
    owner = np.repeat(np.arange(len(tracks)), [len(track.timesteps) for track in tracks]).tolist()
    return {
        "observed": pa.array(timestep < observed_steps),
        "track_id": pa.array([tracks[k].track_id for k in owner], pa.string()),
        "object_type": pa.array([tracks[k].object_type for k in owner], pa.string()),
        "object_category": pa.array([tracks[k].category for k in owner], pa.int64()),
        "timestep": pa.array(timestep),
        **dict(zip(MOTION_COLUMNS, map(pa.array, motion.T), strict=True)),
    }


def read_table(path: Path) -> pa.Table:
    """The rows of a parquet file, every required column present, of its type and without nulls.

    Errors: ScenarioError.
    """

    def read(content: io.BytesIO) -> pa.Table:
        file = pq.ParquetFile(content)
        found = file.metadata  # before anything is unpacked, what the file says of itself
        unpacked_mb = sum(found.row_group(k).total_byte_size for k in range(found.num_row_groups)) / 1e6
        check_size(str(path), rows=found.num_rows, columns=found.num_columns, unpacked_mb=unpacked_mb)
        return file.read(use_threads=False)

    table = read_arrow(path, read, kind="parquet", wanted="a scenario in parquet")
    check_columns(table, str(path), REQUIRED_COLUMNS)
    return table


def log_of(table: pa.Table) -> str:
    """The drive that a scene was cut from, as its rows tell; "" where they do not."""
    return str(table.column("slice_id")[0].as_py() or "") if "slice_id" in table.column_names else ""


def read_arrow(path: Path, read: Callable[[io.BytesIO], pa.Table], *, kind: str, wanted: str) -> pa.Table:
    """A file of Arrow's, as `read` makes a table of its bytes. kind, wanted: for messages. Errors: ScenarioError."""
    try:
        table = read(io.BytesIO(read_received(path, ScenarioError, wanted=wanted)))
        table.validate(full=True)
    except MemoryError as error:  # one that is written once may stand in every row
        raise ScenarioError(
            f"{path}: unpacks to more memory than there is or it may take, expected {limits.MAX_TABLE_MB} MB at most"
        ) from error
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        said = one_line(str(error).strip().partition("\n")[0], most=200)
        raise ScenarioError(f"{path}: not a {kind} file ({said}), expected {wanted}") from error
    return table


def split_rows(
    table: pa.Table, *, name: str, sizes: Mapping[str, BoxSize], observed_steps: int = OBSERVED_STEPS
) -> Rows:
    """Check the rows of a scenario and split them by track.

    name: what messages call the table; sizes: boxes by track id, by object type where a track has none.
    Errors: ScenarioError with track, timestep, value and what was expected.
    """
    rows = RowArrays.of(table, observed_steps=observed_steps)
    for _, said in row_breaches(rows):
        raise ScenarioError(f"{name}: {said}")
    same = {name: str(rows.constants[name][0]) for name in ("scenario_id", "city", "focal_track_id")}
    tracks, steps = tracks_of(rows, sizes), rows.num_steps
    return Rows(
        **same, table=table, sizes=sizes, num_steps=steps, tracks=tracks, observed_steps=observed_steps, step_s=STEP_S
    )


@dataclass(frozen=True, eq=False, slots=True)
class RowArrays:
    """The rows of a scenario as arrays (N,), by track, in the order of their first rows, and timestep.

    ids, kinds: what code and kind are indices into; motion: (N, 5), columns as in MOTION_COLUMNS; constants: different
    values of each column that says the same in every row; observed_steps, step_s: as in `Recording`.
    """

    table: pa.Table
    ids: list[str]
    kinds: list[str]
    code: IntArray
    kind: IntArray
    timestep: IntArray
    category: IntArray
    observed: npt.NDArray[np.bool_]
    motion: FloatArray
    constants: Mapping[str, list[Any]]
    observed_steps: int
    step_s: float

    @staticmethod
    def of(table: pa.Table, *, observed_steps: int = OBSERVED_STEPS, step_s: float = STEP_S) -> "RowArrays":
        """Those of a table that has the format's columns."""

        def encoded(column: str) -> tuple[list[str], IntArray]:
            values = table.column(column).dictionary_encode().combine_chunks()
            return values.dictionary.to_pylist(), values.indices.to_numpy(zero_copy_only=False).astype(np.int64)

        (ids, code), (kinds, kind) = encoded("track_id"), encoded("object_type")
        timestep = np.asarray(table.column("timestep").to_numpy())
        by_track = np.lexsort((timestep, code))
        order = slice(None) if (np.diff(by_track) == 1).all() else by_track  # recorded files are in this order
        by_row = code[order], kind[order], timestep[order]
        category, observed = (table.column(name).to_numpy()[order] for name in ("object_category", "observed"))
        motion = np.column_stack([table.column(column).to_numpy()[order] for column in MOTION_COLUMNS])
        constants = {name: table.column(name).unique().to_pylist() for name in SCENARIO_COLUMNS}
        return RowArrays(table, ids, kinds, *by_row, category, observed, motion, constants, observed_steps, step_s)

    @property
    def num_steps(self) -> int:
        """Last timestep + 1."""
        return int(self.timestep.max()) + 1

    @property
    def last_observed(self) -> int:
        """The last observed timestep."""
        return self.observed_steps - 1

    @property
    def starts(self) -> IntArray:
        """The first row of each track, in the order of ids."""
        return np.searchsorted(self.code, np.arange(len(self.ids)))

    def of_track(self, code: int) -> slice:
        """Rows of a track."""
        return slice(*np.searchsorted(self.code, [code, code + 1]).tolist())

    def where(self, row: int) -> str:
        """Names a row in messages."""
        return f"track {self.ids[self.code[row]]!r}, timestep {self.timestep[row]}"


def row_breaches(rows: RowArrays) -> Iterator[Breach]:
    """What is wrong with the rows of a scenario, by the rules that every scene has to keep: a reader refuses others."""
    same = rows.constants
    most_steps = limits.MAX_CORRIDOR_STEPS if is_corridor(str(same["scenario_id"][0])) else MAX_STEPS
    for column, values in same.items():
        if len(values) != 1:
            shown = one_line(str(values[:3]), most=200)
            yield "constant", f"column {column!r} has {len(values)} values {shown}, expected one"
    if len(rows.ids) > limits.MAX_TRACKS:
        yield "columns", f"{len(rows.ids)} tracks, expected at most {limits.MAX_TRACKS}"
    names = [(column, str(same[column][0])) for column in ("scenario_id", "focal_track_id", "city")]
    for what, text in (*names, *(("track_id", track_id) for track_id in rows.ids)):  # which go into files and messages
        if not text or len(text) > limits.MAX_NAME or not text.isprintable():
            said = f"{what} {one_line(text, most=60)!r}: expected 1 to {limits.MAX_NAME} characters that can be printed"
            yield "city" if what == "city" else "columns", said
    for rule, wrong, said, *values in _masks(rows, most_steps):
        found = np.flatnonzero(wrong)
        if len(found):
            row = int(found[0])
            more = f" (and {len(found) - 1} more rows)" if len(found) > 1 else ""
            yield rule, f"{rows.where(row)}: {said.format(*(of[row] for of in values))}{more}"
    steps, stated = rows.num_steps, int(same["num_timestamps"][0])
    if not steps <= stated <= most_steps:
        said_steps = f"expected {steps}, as many as there are, to {most_steps}"
        yield "timestep", f"num_timestamps {stated}, {said_steps}"
    yield from _focal_breaches(rows, str(same["focal_track_id"][0]))
    if AV_ID not in rows.ids:
        yield "av", f"no track {AV_ID!r} among {len(rows.ids)}, readers of the format need one"


def _masks(rows: RowArrays, most_steps: int) -> Iterator[tuple[Any, ...]]:
    """Rules on single rows: name, which rows break it, what is said of one, and (N,) values that are said with it."""
    timestep, code, category, motion = rows.timestep, rows.code, rows.category, rows.motion
    yield "timestep", (timestep < 0) | (timestep >= most_steps), f"expected timesteps 0 to {most_steps - 1}"
    again = np.append(False, (np.diff(code) == 0) & (np.diff(timestep) == 0))
    yield "duplicate", again, "more than one row, expected one"
    seen = timestep < rows.observed_steps
    yield "observed", rows.observed != seen, "observed is {}, expected {}", rows.observed, seen
    for column, values in zip(MOTION_COLUMNS, motion.T, strict=True):
        yield "finite", ~np.isfinite(values), f"{column} is {{}}, expected a finite number", values
    speed, most = np.abs(motion[:, 3:]).max(axis=1), limits.MAX_SPEED_MPS
    yield "columns", speed > most, f"velocity {{:.6g}} m/s, expected at most {most:g} m/s", speed
    unknown, wanted = ~np.isin(rows.kinds, list(DEFAULT_SIZES)), ", ".join(DEFAULT_SIZES)
    shown = np.array([repr(kind[:40]) for kind in rows.kinds])[rows.kind]
    yield "object-type", unknown[rows.kind], f"object_type {{}}, expected one of {wanted}", shown
    beyond = (category < 0) | (category > FOCAL_CATEGORY)
    yield "category", beyond, "object_category {}, expected 0, 1, 2 or 3", category
    for column, values in (("object_category", category), ("object_type", rows.kind)):
        yield "constant", values != values[rows.starts[code]], f"{column} changes within the track"


def _focal_breaches(rows: RowArrays, focal_track_id: str) -> Iterator[Breach]:
    focals = [rows.ids[code] for code in np.unique(rows.code[rows.category == FOCAL_CATEGORY])]
    if focals != [focal_track_id]:
        have = ", ".join(map(repr, focals)) or "none"
        said = f"tracks of category {FOCAL_CATEGORY}: {have}, expected focal_track_id {focal_track_id!r} alone"
        yield "focal", said
    for track_id in focals:
        steps = rows.timestep[rows.of_track(rows.ids.index(track_id))]
        if rows.last_observed not in steps:
            lasts = f"lasts from timestep {steps[0]} to {steps[-1]}, expected it present at {rows.last_observed}"
            yield "focal", f"focal track {track_id!r} {lasts}"


def tracks_of(rows: RowArrays, sizes: Mapping[str, BoxSize]) -> tuple[Track, ...]:
    """The tracks of rows that keep the rules. sizes: boxes by track id, by object type where a track has none."""
    heading = rows.motion[:, 2]
    heading = np.where(np.abs(heading) > np.pi, wrap_angle(heading), heading)
    position, velocity = np.ascontiguousarray(rows.motion[:, :2]), np.ascontiguousarray(rows.motion[:, 3:])
    tracks = []
    for code, track_id in enumerate(rows.ids):
        own = rows.of_track(code)
        kind, category = rows.kinds[rows.kind[own.start]], int(rows.category[own.start])
        motion, size = (position[own], heading[own], velocity[own]), sizes.get(track_id, DEFAULT_SIZES[kind])
        tracks.append(Track(track_id, kind, category, rows.timestep[own], *motion, size))
    return tuple(tracks)


def sizes_of(folder: Path, sidecar: Sidecar | None) -> dict[str, BoxSize]:
    """Boxes by track id from agent_sizes.csv (columns track_id, length_m, width_m) and a sidecar, where they exist.

    Errors: ScenarioError.
    """
    sizes, path = dict[str, BoxSize](), folder / SIZES_FILE
    if path.exists():
        try:
            text = read_received(path, ScenarioError, wanted="sizes of tracks").decode()
            rows = [*csv.DictReader(text.splitlines(), restkey="more")]
        except (UnicodeDecodeError, csv.Error) as error:
            raise ScenarioError(f"{path}: expected columns track_id, length_m, width_m ({error})") from error
        sizes = {one["track_id"]: BoxSize(one["length_m"], one["width_m"]) for one in typed(_SIZES, rows, str(path))}
    return sizes if sidecar is None else sizes | sidecar.boxes


def typed(kind: TypeAdapter[list[_Row]], rows: Sequence[Mapping[str, Any]], name: str) -> list[_Row]:
    """Rows of a CSV file with a head, as of their types. name: for messages. Errors: ScenarioError."""
    try:
        return kind.validate_python(rows)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        row, column = first["loc"][:2]
        wanted = first["msg"].removeprefix("Input should be ")
        said = f"{column} {one_line(str(first['input']), most=60)!r}, expected {wanted}"
        if first["type"] == "missing" or first["input"] is None:  # no such column, or a line that ends before it
            said = f"no {column}, expected one"
        raise ScenarioError(f"{name} line {int(row) + 2}: {said}") from error


def check_size(name: str, *, rows: int, columns: int, unpacked_mb: float = 0.0) -> None:
    """Refuse a table beyond the limits. name: what messages call it. Errors: ScenarioError."""
    for what, number, most in (
        ("rows", rows, limits.MAX_ROWS),
        ("columns", columns, limits.MAX_COLUMNS),
        ("MB unpacked", unpacked_mb, limits.MAX_TABLE_MB),
    ):
        if not 0 <= number <= most:
            raise ScenarioError(f"{name}: {number:g} {what}, expected at most {most}")


def check_columns(table: pa.Table, name: str, wanted: Mapping[str, Sequence[pa.DataType]]) -> None:
    """Refuse a table without rows, or without columns wanted, each once, of one of its types and without nulls.

    name: what messages call it. Errors: ScenarioError.
    """
    names = table.column_names
    for column in names:
        if names.count(column) > 1:
            raise ScenarioError(f"{name}: more than one column {one_line(column, most=60)!r}, expected each once")
    for column, types in wanted.items():
        if column not in names:
            raise ScenarioError(f"{name}: no column {column!r}, expected {types[0]}")
        if table.schema.field(column).type not in types:
            raise ScenarioError(f"{name}: column {column!r} is {table.schema.field(column).type}, expected {types[0]}")
    for column, types in wanted.items():
        if table.column(column).null_count:  # what pandas makes of NaN
            row = int(np.flatnonzero(table.column(column).is_null().to_numpy())[0])
            where = ", ".join(f"{key} {table.column(key)[row].as_py()!r}" for key in wanted if key in _NAMES_A_ROW)
            raise ScenarioError(f"{name}: row {row} ({where}): {column} is null or NaN, expected {types[0]}")
    if table.num_rows == 0:
        raise ScenarioError(f"{name}: no rows, expected at least one")
