"""Synthetic recordings in other formats: the Argoverse 1 data set of data/, and a sensor log of a scene."""

import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
from pyarrow import feather
from scipy.spatial.transform import Rotation

from bridge.recordings.scenario import Scenario, read_scenario

ROOT = Path(__file__).parents[2]
LOG_ID = "11111111-2222-3333-4444-555555555555"
FIRST_NS = 315_966_000_000_000_000
AV_AHEAD_M = 1.4
CATEGORIES = {"vehicle": "REGULAR_VEHICLE", "bus": "BUS", "pedestrian": "PEDESTRIAN", "cyclist": "BICYCLIST"}


def make_argoverse1(out: Path) -> Path:
    """The data set of data/make_argoverse1.py."""
    spec = importlib.util.spec_from_file_location("make_argoverse1", ROOT / "data" / "make_argoverse1.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    module.make(out)
    return out


def track_uuid(track_id: str) -> str:
    """The name of a track in the log."""
    return f"uuid-{track_id}"


def make_log(scene: Path, out: Path, *, sweeps: int = 130) -> Path:
    """A sensor log of a scene of 110 steps, whose agents stand still after the last one; returns its folder.

    The egovehicle drives on a slope and a bank, 20 cm above the ground: boxes are given in its tilted frame.
    """
    scenario = read_scenario(scene)
    log = out / LOG_ID
    (log / "map").mkdir(parents=True)
    annotations, poses = log_tables(scenario, sweeps)
    write_feather(annotations, log / "annotations.feather")
    write_feather(poses, log / "city_SE3_egovehicle.feather")
    document = json.loads(next(scene.glob("log_map_archive_*.json")).read_text())
    for lane in document["lane_segments"].values():
        del lane["centerline"]
        lane["predecessors"] = lane["predecessors"][:1]
    path = log / "map" / f"log_map_archive_{LOG_ID}____PIT_city_47896.json"
    path.write_text(json.dumps(document))
    return log


def log_tables(scenario: Scenario, sweeps: int) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Annotations and poses."""
    boxes, poses = [], []
    av = scenario.track("AV")
    for sweep in range(sweeps):
        stamp = FIRST_NS + 100_000_000 * sweep + 200_000 * (sweep % 3)
        step = min(sweep, 109)
        row = int(np.searchsorted(av.timesteps, step))
        ego = Rotation.from_euler("ZYX", [av.heading[row], 0.03, -0.02])
        origin = np.array([*av.position[row], 0.2]) - ego.apply([AV_AHEAD_M, 0.0, 0.0])
        poses.append([stamp, *ego.as_quat(), *origin])
        for track in scenario.tracks:
            found = np.flatnonzero(track.timesteps == step)
            if not len(found) or track.track_id == "AV":
                continue
            heading = Rotation.from_euler("ZYX", [track.heading[found[0]], 0.0, 0.0])
            place = ego.inv().apply(np.array([*track.position[found[0]], 0.8]) - origin)
            size = [track.size.length_m + 0.1, track.size.width_m, 1.5]
            category = CATEGORIES.get(track.object_type, "SIGN")
            name = track_uuid(track.track_id)
            boxes.append([stamp, name, category, *size, *(ego.inv() * heading).as_quat(), *place])
    pose = ["qx", "qy", "qz", "qw", "tx_m", "ty_m", "tz_m"]
    columns = ["timestamp_ns", "track_uuid", "category", "length_m", "width_m", "height_m", *pose]
    return pd.DataFrame(boxes, columns=columns), pd.DataFrame(poses, columns=["timestamp_ns", *pose])


def write_feather(frame: pd.DataFrame, path: Path) -> None:
    """As pandas writes it."""
    feather.write_feather(pa.Table.from_pandas(frame, preserve_index=False), str(path))
