"""A recording and tracks to insert, written as a generated scene, and its sidecar; a scene with another id."""

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from bridge.batch.manifest import files_sha256, output_files
from bridge.config import config_sha256, config_to_dict
from bridge.recordings.export import recording_record_of, with_generated, write_recording
from bridge.recordings.recording import Recording
from bridge.recordings.sidecar import GeneratorRecord, PlacedRecord, ReplayRecord, RequestedRecord, Sidecar
from hid2.agents import Track
from hid2.params import Config


def write_scene(
    scenario: Recording, tracks: Sequence[Track], sidecar: Sidecar, out: Path, *, new_id: str, focal_track_id: str
) -> Path:
    """Returns its folder."""
    return write_recording(with_generated(scenario, tracks, sidecar, new_id=new_id, focal_track_id=focal_track_id), out)


def made_up_sidecar(scenario: Recording, config: Config, **said: Any) -> Sidecar:
    """A sidecar of nobody inserted and nothing replayed, but for what is said."""
    usual = {
        "source_scenario_id": scenario.scenario_id,
        "generator": GeneratorRecord(version="test", code_sha256="0" * 64, libraries={}),
        "recording": recording_record_of(scenario),
        "sumo_version": "none",
        "seed": config.request.seed,
        "variant": 0,
        "config": config_to_dict(config),
        "config_sha256": config_sha256(config),
        "replay": ReplayRecord(states=0, max_position_error_m=0.0, max_heading_error_rad=0.0),
        "requested": RequestedRecord(agents=0, behaviours={}),
        "placed": PlacedRecord(agents=0, behaviours={}),
    }
    return Sidecar(**(usual | said))


def copy_with_new_id(source: Path, folder: Path, new_id: str) -> Path:
    """A copy of a scene, of this id; returns its folder."""
    folder.mkdir(parents=True)
    table = pq.read_table(next(source.glob("scenario_*.parquet")))
    index = table.schema.get_field_index("scenario_id")
    column = pa.array([new_id] * table.num_rows, table.schema.field(index).type)
    pq.write_table(table.set_column(index, "scenario_id", column), folder / f"scenario_{new_id}.parquet")
    shutil.copyfile(next(source.glob("log_map_archive_*.json")), folder / f"log_map_archive_{new_id}.json")
    return folder


def contents(out: Path) -> dict[str, str]:
    """Digest of every scenario folder below out, by its path."""
    folders = {path.parent for path in out.rglob("scenario_*.parquet")}
    return {folder.relative_to(out).as_posix(): files_sha256(output_files(folder)) for folder in folders}
