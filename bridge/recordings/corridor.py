"""A synthetic recording: a straight one-way road of any length, lanes and duration, for studies of traffic flow.

It has the columns of the other scenes, its id begins with `corridor-`, and it is no scene of Argoverse. Readers of the
format demand a recording vehicle and a focal track: both stand on the shoulder, off the lanes. Traffic enters in a
study (`flow.veh_per_h_lane`), or as the file of a road says, which then lies beside.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bridge.config import CORRIDOR_PREFIX
from bridge.recordings.export import parquet_bytes, write_folder
from bridge.recordings.limits import MAX_CORRIDOR_STEPS, MAX_LANE_M
from bridge.recordings.road import MOST_LANES, ROAD_FILE, Lane, read_road
from bridge.recordings.scenario import AV_ID, OBSERVED_STEPS, STEP_S, table_of
from hid2.agents import DEFAULT_SIZES, FOCAL_CATEGORY, Track
from netconvert.errors import ConfigError

#: A motorway's usual widths, m, the shortest road on which vehicles meet, and points as far apart as on real maps.
_LANE_M, _SHOULDER_M, _LEAST_M, _POINT_EVERY_M = 3.5, 4.0, 100.0, 10.0


def write_corridor(out_dir: Path, *, length_m: float, lanes: int, seconds: float) -> Path:
    """Write OUT/corridor-.../ with parquet and map; returns the folder. Lanes 1, 2, ... from the right.

    Errors: ConfigError for a value out of its range; ExportError.
    """
    least_s, most_s = OBSERVED_STEPS * STEP_S, MAX_CORRIDOR_STEPS * STEP_S
    for name, value, least, most, unit in (
        ("length", length_m, _LEAST_M, MAX_LANE_M, " m"),
        ("lanes", lanes, 2, MOST_LANES, ""),
        ("seconds", seconds, least_s, most_s, " s"),
    ):
        if not least <= value <= most:
            raise ConfigError(f"--{name} {value:g}: expected {least:g} to {most:g}{unit}")
    scenario_id = f"{CORRIDOR_PREFIX}{length_m:g}m-{lanes}lanes-{seconds:g}s"
    straight = [
        Lane(n, lanes + 1 - n, 0.0, length_m, False, n + 1 if n < lanes else None, n - 1 if n > 1 else None, ())
        for n in range(1, lanes + 1)
    ]
    return _written(out_dir, scenario_id, straight, lanes, round(seconds / STEP_S))


def write_road(out_dir: Path, file: Path) -> Path:
    """Write OUT/corridor-NAME-DIGEST/ of the file of a road, with that file; returns the folder.

    Errors: ConfigError with file, key, value; ExportError.
    """
    road, content = read_road(file), file.read_bytes()
    if road.seconds > MAX_CORRIDOR_STEPS * STEP_S:
        raise ConfigError(f"{file}: period until {road.seconds:g} s, expected {MAX_CORRIDOR_STEPS * STEP_S:g} at most")
    scenario_id = f"{CORRIDOR_PREFIX}{file.stem}-{hashlib.sha256(content).hexdigest()[:8]}"
    steps = round(max(road.seconds, OBSERVED_STEPS * STEP_S) / STEP_S)
    return _written(out_dir, scenario_id, road.stretches(), road.lanes, steps, {ROAD_FILE: content})


def _written(
    out_dir: Path, name: str, stretches: Sequence[Lane], lanes: int, steps: int, more: Mapping[str, bytes] = {}
) -> Path:
    y, size, still = -(_LANE_M + _SHOULDER_M) / 2, DEFAULT_SIZES["vehicle"], (np.zeros(steps), np.zeros((steps, 2)))
    tracks = [  # the two vehicles on the shoulder, at every step
        Track(track_id, "vehicle", category, np.arange(steps), np.tile([x, y], (steps, 1)), *still, size)
        for track_id, category, x in (("1", FOCAL_CATEGORY, 20.0), (AV_ID, 1, 30.0))
    ]
    same = {"scenario_id": name, "start_timestamp": 0.0, "end_timestamp": (steps - 1) * STEP_S * 1e9}
    same |= {"num_timestamps": steps, "focal_track_id": "1", "city": "corridor"}
    table = parquet_bytes(table_of(tracks, same, observed_steps=OBSERVED_STEPS))
    streets = json.dumps(_map(stretches, lanes)).encode()
    files = {f"scenario_{name}.parquet": table, f"log_map_archive_{name}.json": streets, **more}
    write_folder(out_dir / name, files)
    return out_dir / name


def _map(stretches: Sequence[Lane], lanes: int) -> dict[str, Any]:
    def line(lane: Lane, y: float) -> list[dict[str, float]]:
        count = max(2, int((lane.end_m - lane.start_m) / _POINT_EVERY_M) + 1)
        x = np.linspace(lane.start_m, lane.end_m, count)
        return [{"x": round(float(at), 2), "y": round(y, 2), "z": 0.0} for at in x]

    led_to: dict[int, list[int]] = {lane.lane_id: [] for lane in stretches}
    for lane in stretches:
        for other in lane.successors:
            led_to[other].append(lane.lane_id)
    segments = {}
    for lane in stretches:
        y = (lanes - lane.number) * _LANE_M
        segments[str(lane.lane_id)] = {
            "id": lane.lane_id,
            "is_intersection": lane.crossing,
            "lane_type": "VEHICLE",
            "centerline": line(lane, y),
            "left_lane_boundary": line(lane, y + _LANE_M / 2),
            "right_lane_boundary": line(lane, y - _LANE_M / 2),
            "left_lane_mark_type": "SOLID_WHITE" if lane.closed or lane.left is None else "DASHED_WHITE",
            "right_lane_mark_type": "SOLID_WHITE" if lane.closed or lane.right is None else "DASHED_WHITE",
            "left_neighbor_id": lane.left,
            "right_neighbor_id": lane.right,
            "predecessors": led_to[lane.lane_id],
            "successors": list(lane.successors),
        }
    lowest = min(lanes - lane.number for lane in stretches)
    low, high = (lowest - 0.5) * _LANE_M - _SHOULDER_M, (lanes - 0.5) * _LANE_M + 1.0
    first, last = min(lane.start_m for lane in stretches), max(lane.end_m for lane in stretches)
    corners = [(first - 30.0, low), (last + 30.0, low), (last + 30.0, high), (first - 30.0, high)]
    area = [{"x": round(a, 2), "y": round(b, 2), "z": 0.0} for a, b in corners]
    areas = {"1": {"area_boundary": area, "id": 1}}
    return {"drivable_areas": areas, "lane_segments": segments, "pedestrian_crossings": {}}
