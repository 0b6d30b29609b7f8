"""A recording and tracks to insert, written as a generated scene, and its sidecar; scenes changed by hand."""

import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from bridge.batch.manifest import files_sha256, output_files
from bridge.config import config_sha256, config_to_dict, load_config, new_scenario_id
from bridge.recordings import sidecar as said_of
from bridge.recordings.export import recording_record_of, with_generated, write_recording
from bridge.recordings.recording import Recording
from bridge.recordings.sidecar import PlacedRecord, ReplayRecord, RequestedRecord, Sidecar
from hid2.agents import BoxSize, Policy, Track
from hid2.params import Config


def write_scene(
    scenario: Recording, tracks: Sequence[Track], sidecar: Sidecar, out: Path, *, new_id: str, focal_track_id: str
) -> Path:
    """Returns its folder."""
    return write_recording(with_generated(scenario, tracks, sidecar, new_id=new_id, focal_track_id=focal_track_id), out)


def made_up_sidecar(scenario: Recording, config: Config, **said: Any) -> Sidecar:
    """A sidecar of nobody inserted and nothing replayed, but for what is said."""
    usual: dict[str, Any] = {"source_scenario_id": scenario.scenario_id, "recording": recording_record_of(scenario)}
    usual |= {"seed": config.request.seed, "variant": 0, "sumo_version": "none", "config": config_to_dict(config)}
    usual |= {"config_sha256": config_sha256(config), "requested": RequestedRecord(agents=0, behaviours={})}
    usual |= {"replay": ReplayRecord(states=0, max_position_error_m=0.0, max_heading_error_rad=0.0)}
    usual |= {"generator": said_of.GeneratorRecord(version="test", code_sha256="0" * 64, libraries={})}
    usual |= {"placed": PlacedRecord(agents=0, behaviours={})}
    return Sidecar(**(usual | said))


def fake_generated(scenario: Recording, *, count: int = 2, category: int = 1) -> tuple[list[Track], Sidecar, str]:
    """Tracks that drive circles of 50 m, a sidecar for them, an id.

    On a circle of radius 50 m at 10 m/s the angle grows by 0.2 rad/s: position 50 (cos a, sin a), heading a + pi/2,
    velocity 10 (-sin a, cos a).
    """
    config = load_config(None, [f"request.agents={count}"])
    steps = np.arange(scenario.num_steps)
    tracks = []
    for i in range(count):
        angle = 0.2 * 0.1 * steps + i
        circle = np.column_stack([np.cos(angle), np.sin(angle)])
        ahead = np.column_stack([-np.sin(angle), np.cos(angle)])
        heading = np.arctan2(ahead[:, 1], ahead[:, 0])
        tracks.append(
            Track(f"gen_{i}", "vehicle", category, steps, 50 * circle, heading, 10 * ahead, BoxSize(4.5, 1.9))
        )
    lane_id = min(scenario.graph.lanes)
    spawn = said_of.SpawnRecord(lane_segment_id=lane_id, cell=0, speed_mps=10.0)
    told = {"trigger_s": 1.0, "start_s": 1.5, "crossing_s": 3.0, "end_s": 4.5, "source_lane": lane_id}
    done = said_of.ManeuverRecord(kind="lane_change", status="done", target_lane=lane_id, **told)
    does = {"policy": Policy.LANE_CHANGE, "spawn": spawn, "route": (lane_id,), "maneuvers": (done,)}
    agents = tuple(said_of.AgentRecord(track_id=one.track_id, length_m=4.5, width_m=1.9, **does) for one in tracks)
    replay = ReplayRecord(states=scenario.table.num_rows, max_position_error_m=0.0, max_heading_error_rad=0.0)
    placed = PlacedRecord(agents=count, behaviours={Policy.LANE_CHANGE: count})
    asked = RequestedRecord(agents=count, behaviours=config.request.behaviours)
    sidecar = made_up_sidecar(scenario, config, replay=replay, requested=asked, placed=placed, agents=agents)
    return tracks, sidecar, new_scenario_id(scenario.scenario_id, config, 0, 0)


def write_fake(scenario: Recording, out: Path, *, focal: str | None = None, **made: int) -> Path:
    """Such a scene, written; returns its folder. made: count, category."""
    tracks, sidecar, new_id = fake_generated(scenario, **made)
    return write_scene(scenario, tracks, sidecar, out, new_id=new_id, focal_track_id=focal or scenario.focal_track_id)


def edit_rows(folder: Path, change: Callable[[pd.DataFrame], pd.DataFrame]) -> None:
    """Rewrite the parquet of a scenario folder."""
    (path,) = folder.glob("scenario_*.parquet")
    change(pd.read_parquet(path)).reset_index(drop=True).to_parquet(path)


def edit_json(path: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    """Change a JSON file in place."""
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))


def in_first_lane(change: Callable[[dict[str, Any]], Any]) -> Callable[[dict[str, Any]], Any]:
    """A change of a map, to its first lane."""
    return lambda document: change(next(iter(document["lane_segments"].values())))


def in_cell(track_id: str, timestep: int, column: str, value: Any) -> Callable[[pd.DataFrame], pd.DataFrame]:
    """A change of the rows of a scene, to one value of a track at a step."""

    def change(rows: pd.DataFrame) -> pd.DataFrame:
        rows.loc[(rows.track_id == track_id) & (rows.timestep == timestep), column] = value
        return rows

    return change


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


def standing(rows: pd.DataFrame, *, jitter_m: float = 0.0) -> pd.DataFrame:
    """Every track where it is first seen, but to and fro along x."""
    first = rows.groupby("track_id")[["position_x", "position_y"]].transform("first")
    x = first.position_x + jitter_m * (rows.timestep % 2)
    return rows.assign(position_x=x, position_y=first.position_y, velocity_x=0.0, velocity_y=0.0)
