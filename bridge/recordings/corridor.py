"""A synthetic recording: a straight one-way road of any length, lanes and duration, for studies of traffic flow.

It has the columns of the other scenes, its id begins with `corridor-`, and it is no scene of Argoverse. Readers of the
format demand a recording vehicle and a focal track: both stand on the shoulder, off the lanes. Traffic enters in a
study (`flow.veh_per_h_lane`).
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from bridge.config import CORRIDOR_PREFIX
from bridge.recordings.export import parquet_bytes, write_folder
from bridge.recordings.limits import MAX_CORRIDOR_STEPS, MAX_LANE_M
from bridge.recordings.scenario import AV_ID, FOCAL_CATEGORY, OBSERVED_STEPS, STEP_S, table_of
from hid2.agents import DEFAULT_SIZES, Track
from netconvert.errors import ConfigError

_LANE_M, _SHOULDER_M = 3.5, 4.0
_LEAST_M, _MOST_LANES = 100.0, 8
_POINT_EVERY_M = 10.0


def write_corridor(out_dir: Path, *, length_m: float, lanes: int, seconds: float) -> Path:
    """Write OUT/corridor-.../ with parquet and map; returns the folder. Lanes 1, 2, ... from the right.

    Errors: ConfigError for a value out of its range; ExportError.
    """
    least_s, most_s = OBSERVED_STEPS * STEP_S, MAX_CORRIDOR_STEPS * STEP_S
    for name, value, least, most, unit in (
        ("length", length_m, _LEAST_M, MAX_LANE_M, " m"),
        ("lanes", lanes, 2, _MOST_LANES, ""),
        ("seconds", seconds, least_s, most_s, " s"),
    ):
        if not least <= value <= most:
            raise ConfigError(f"--{name} {value:g}: expected {least:g} to {most:g}{unit}")
    steps = round(seconds / STEP_S)
    scenario_id = f"{CORRIDOR_PREFIX}{length_m:g}m-{lanes}lanes-{seconds:g}s"
    folder = out_dir / scenario_id
    files = {
        f"scenario_{scenario_id}.parquet": parquet_bytes(_table(scenario_id, steps)),
        f"log_map_archive_{scenario_id}.json": json.dumps(_map(length_m, lanes)).encode(),
    }
    write_folder(folder, files)
    return folder


def _map(length_m: float, lanes: int) -> dict[str, Any]:
    x = np.linspace(0.0, length_m, max(2, int(length_m / _POINT_EVERY_M) + 1))

    def line(y: float) -> list[dict[str, float]]:
        return [{"x": round(float(at), 2), "y": round(y, 2), "z": 0.0} for at in x]

    segments = {}
    for lane in range(1, lanes + 1):
        y = (lane - 1) * _LANE_M
        segments[str(lane)] = {
            "id": lane,
            "is_intersection": False,
            "lane_type": "VEHICLE",
            "centerline": line(y),
            "left_lane_boundary": line(y + _LANE_M / 2),
            "right_lane_boundary": line(y - _LANE_M / 2),
            "left_lane_mark_type": "DASHED_WHITE" if lane < lanes else "SOLID_WHITE",
            "right_lane_mark_type": "DASHED_WHITE" if lane > 1 else "SOLID_WHITE",
            "left_neighbor_id": lane + 1 if lane < lanes else None,
            "right_neighbor_id": lane - 1 if lane > 1 else None,
            "predecessors": [],
            "successors": [],
        }
    low, high = -_LANE_M / 2 - _SHOULDER_M, (lanes - 0.5) * _LANE_M + 1.0
    corners = [(-30.0, low), (length_m + 30.0, low), (length_m + 30.0, high), (-30.0, high)]
    area = [{"x": round(a, 2), "y": round(b, 2), "z": 0.0} for a, b in corners]
    return {
        "drivable_areas": {"1": {"area_boundary": area, "id": 1}},
        "lane_segments": segments,
        "pedestrian_crossings": {},
    }


def _table(scenario_id: str, steps: int) -> pa.Table:
    """The two vehicles on the shoulder, at every step."""
    tracks = [
        Track(
            track_id=track_id,
            object_type="vehicle",
            category=category,
            timesteps=np.arange(steps),
            position=np.tile([x, -_LANE_M / 2 - _SHOULDER_M / 2], (steps, 1)),
            heading=np.zeros(steps),
            velocity=np.zeros((steps, 2)),
            size=DEFAULT_SIZES["vehicle"],
        )
        for track_id, category, x in (("1", FOCAL_CATEGORY, 20.0), (AV_ID, 1, 30.0))
    ]
    same = {"scenario_id": scenario_id, "start_timestamp": 0.0, "end_timestamp": (steps - 1) * STEP_S * 1e9}
    same |= {"num_timestamps": steps, "focal_track_id": "1", "city": "corridor"}
    return table_of(tracks, same, observed_steps=OBSERVED_STEPS)
