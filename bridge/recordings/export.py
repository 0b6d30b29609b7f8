"""A generated scene on disk: parquet as av2's own serializer writes it, the source's map, the sidecar."""

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from pyarrow.pandas_compat import get_logical_type

from bridge.files import explained
from bridge.interruption import hidden_folder, tidied
from bridge.recordings.folders import WRITTEN
from bridge.recordings.recording import Recording
from bridge.recordings.scenario import SCENARIO_COLUMNS, STEP_S, track_columns
from bridge.recordings.sidecar import RecordingRecord, Sidecar, sidecar_bytes, sidecar_path
from hid2.agents import FOCAL_CATEGORY, SCORED_CATEGORY, Track
from netconvert.errors import ExportError


def with_generated(
    scenario: Recording, generated: Sequence[Track], sidecar: Sidecar, *, new_id: str, focal_track_id: str
) -> Recording:
    """The scene that a recording becomes with generated tracks, as a reader has it.

    Its rows are the source's, bit for bit, and behind them those of the generated tracks, in the source's columns and
    types. Changed in recorded ones: scenario_id, and where the focal track is another one, focal_track_id and the
    category of the former.
    """
    table, recorded = scenario.table, scenario.tracks
    ids = {"scenario_id": new_id, "focal_track_id": focal_track_id}
    changed = {name: pa.repeat(value, table.num_rows) for name, value in ids.items()}
    if focal_track_id != scenario.focal_track_id:
        category = table.column("object_category")
        changed["object_category"] = pc.if_else(pc.equal(category, FOCAL_CATEGORY), SCORED_CATEGORY, category)
        recorded = tuple(replace(t, category=SCORED_CATEGORY) if t.category == FOCAL_CATEGORY else t for t in recorded)
    for name, values in changed.items():
        row, field = table.column_names.index(name), table.schema.field(name)
        table = table.set_column(row, field, values.cast(field.type))
    ours = [replace(t, category=FOCAL_CATEGORY) if t.track_id == focal_track_id else t for t in generated]
    return replace(
        scenario,
        scenario_id=new_id,
        focal_track_id=focal_track_id,
        tracks=(*recorded, *ours),
        table=_with_rows(table, ours, scenario.observed_steps),
        sizes=sidecar.boxes,
        sidecar=sidecar,
    )


def write_recording(made: Recording, out_dir: Path, *, extra: Mapping[str, bytes] | None = None) -> Path:
    """Write OUT/[split/]id/ with parquet, map and sidecar; returns the folder. extra: more files, by name.

    Everything is written to a hidden folder beside and then renamed; a folder that is there already is replaced.
    Errors: ExportError, also for a scene that was recorded.
    """
    check_step(made)
    if made.sidecar is None:
        raise ExportError(f"{made.folder}: was recorded, nothing is inserted; expected a scene of `generate`")
    files = {
        f"scenario_{made.scenario_id}.parquet": parquet_bytes(made.table),
        f"log_map_archive_{made.scenario_id}.json": map_bytes(made),
        sidecar_path(Path(), made.scenario_id).name: sidecar_bytes(made.sidecar),
        **(extra or {}),
    }
    folder = (out_dir / made.split if made.split else out_dir) / made.scenario_id
    write_folder(folder, files)
    return folder


def check_step(scenario: Recording) -> None:
    """Refuse a recording with other steps than the format's, before anything is made of it. Errors: ExportError."""
    if scenario.step_s != STEP_S:
        raise ExportError(
            f"{scenario.folder}: steps of {scenario.step_s:g} s, but readers of Argoverse 2 scenes take them for "
            f"{STEP_S:g} s: its reader has to give states every {STEP_S:g} s (CONTRIBUTING.md, a new format)"
        )


def with_motion(scenario: Recording, driven: Sequence[Track]) -> Recording:
    """A recording of which some tracks were driven otherwise: their rows, behind all others, are new ones."""
    by_id = {track.track_id: track for track in driven}
    table = _with_rows(scenario.table, driven, scenario.observed_steps)
    is_old = np.isin(table.column("track_id").to_numpy(), list(by_id)) & (np.arange(len(table)) < len(scenario.table))
    tracks = tuple(by_id.get(track.track_id, track) for track in scenario.tracks)
    return replace(scenario, tracks=tracks, table=table.filter(pa.array(~is_old)))


def _with_rows(table: pa.Table, tracks: Sequence[Track], observed_steps: int) -> pa.Table:
    """A table and behind it the rows of tracks, in its columns and types; what all its rows say, theirs say too."""
    added = track_columns(tracks, observed_steps)
    count, columns = len(added["timestep"]), []
    for field, recorded in zip(table.schema, table.columns, strict=True):
        if field.name in (*SCENARIO_COLUMNS, "map_id", "slice_id"):
            new = pa.repeat(recorded[0], count)
        else:  # or a column of the source's own
            new = added[field.name].cast(field.type) if field.name in added else pa.nulls(count, field.type)
        columns.append(pa.concat_arrays([*recorded.chunks, new]))
    return pa.Table.from_arrays(columns, schema=pa.schema([(field.name, field.type) for field in table.schema]))


def parquet_bytes(table: pa.Table) -> bytes:
    """The file that pandas would write for it, read with a RangeIndex. Same rows, same bytes."""

    def told(name: str | None, pandas_type: str, numpy_type: str, metadata: object = None) -> dict[str, Any]:
        names = {"name": name, "field_name": name}
        return {**names, "pandas_type": pandas_type, "numpy_type": numpy_type, "metadata": metadata}

    kinds = ((field.name, get_logical_type(field.type), field.type.to_pandas_dtype()) for field in table.schema)
    columns = [told(name, kind, np.dtype(made).name) for name, kind, made in kinds]
    told_of_all = {
        "index_columns": [{"kind": "range", "name": None, "start": 0, "stop": table.num_rows, "step": 1}],
        "column_indexes": [told(None, "unicode", "object", {"encoding": "UTF-8"})],
        "columns": columns,
        "creator": {"library": "pyarrow", "version": pa.__version__},
        "pandas_version": "1.3.4",  # the version of the format, as in recorded files
    }
    sink = io.BytesIO()
    pq.write_table(table.replace_schema_metadata({"pandas": json.dumps(told_of_all)}), sink, compression="snappy")
    return sink.getvalue()


def map_bytes(scenario: Recording) -> bytes:
    """The map that goes with a recording: the source's byte for byte, with centrelines where it has none."""
    raw = scenario.map_path.read_bytes() if scenario.map_json is None else scenario.map_json
    document = json.loads(raw)
    lacking = [lane for lane in document["lane_segments"].values() if not lane.get("centerline")]
    for lane in lacking:
        points = scenario.graph.lanes[int(lane["id"])].centerline
        lane["centerline"] = [{"x": x, "y": y, "z": 0.0} for x, y in points.tolist()]
    return json.dumps(document).encode() if lacking else raw


def write_folder(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files into a hidden folder beside, then put it in the place of folder, with what a user laid into that.

    Errors: ExportError.
    """
    with explained(folder):
        folder.parent.mkdir(parents=True, exist_ok=True)
        with hidden_folder(folder.parent) as beside:
            new, old = beside / "new", beside / "old"
            new.mkdir()
            for name, content in files.items():
                (new / name).write_bytes(content)

            def put_back() -> None:  # what was there, or the user's part of it
                if old.exists() and not folder.exists():
                    old.rename(folder)
                for one in old.iterdir() if old.is_dir() else ():
                    if one.name not in files and not one.name.startswith(WRITTEN):
                        one.rename(folder / one.name)

            with tidied(put_back):
                if folder.exists():
                    folder.rename(old)
                new.rename(folder)


def recording_record_of(scenario: Recording) -> RecordingRecord:
    """What a sidecar says about a recording."""
    measured = {track_id: (size.length_m, size.width_m) for track_id, size in sorted(scenario.sizes.items())}
    chosen = scenario.map_path.is_file() and scenario.sequence is not None
    return RecordingRecord(
        format=scenario.format,
        provenance=scenario.provenance,
        step_s=scenario.step_s,
        observed_steps=scenario.observed_steps,
        first_step=scenario.start,
        map=scenario.map_path.name if chosen else None,
        sizes=measured,
    )
