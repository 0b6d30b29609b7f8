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
from bridge.files import explained
from bridge.recordings.export import parquet_bytes, write_folder
from bridge.recordings.limits import MAX_CORRIDOR_STEPS, MAX_LANE_M
from bridge.recordings.scenario import AV_ID, FOCAL_CATEGORY, LAST_OBSERVED, STEP_S
from netconvert.errors import ConfigError

_LANE_M, _SHOULDER_M = 3.5, 4.0
_LEAST_M, _MOST_LANES = 100.0, 8
_POINT_EVERY_M = 10.0


def write_corridor(out_dir: Path, *, length_m: float, lanes: int, seconds: float) -> Path:
    """Write OUT/corridor-.../ with parquet and map; returns the folder. Lanes 1, 2, ... from the right.

    Errors: ConfigError for a value out of its range; ExportError.
    """
    least_s, most_s = (LAST_OBSERVED + 1) * STEP_S, MAX_CORRIDOR_STEPS * STEP_S
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
    with explained(folder):
        write_folder(
            folder,
            {
                f"scenario_{scenario_id}.parquet": parquet_bytes(_table(scenario_id, steps)),
                f"log_map_archive_{scenario_id}.json": json.dumps(_map(length_m, lanes)).encode(),
            },
        )
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
    timestep = np.tile(np.arange(steps), 2)
    count = timestep.size
    zeros = pa.array(np.zeros(count))

    def each(first: Any, second: Any) -> list[Any]:  # noqa: ANN401
        return [first] * steps + [second] * steps

    return pa.table(
        {
            "observed": pa.array(timestep <= LAST_OBSERVED),
            "track_id": pa.array(each("1", AV_ID), pa.string()),
            "object_type": pa.array(each("vehicle", "vehicle"), pa.string()),
            "object_category": pa.array(each(FOCAL_CATEGORY, 1), pa.int64()),
            "timestep": pa.array(timestep, pa.int64()),
            "position_x": pa.array(np.array(each(20.0, 30.0))),
            "position_y": pa.array(np.full(count, -_LANE_M / 2 - _SHOULDER_M / 2)),
            "heading": zeros,
            "velocity_x": zeros,
            "velocity_y": zeros,
            "scenario_id": pa.array([scenario_id] * count, pa.string()),
            "start_timestamp": zeros,
            "end_timestamp": pa.array(np.full(count, (steps - 1) * STEP_S * 1e9)),
            "num_timestamps": pa.array([steps] * count, pa.int64()),
            "focal_track_id": pa.array(["1"] * count, pa.string()),
            "city": pa.array(["corridor"] * count, pa.string()),
        }
    )
