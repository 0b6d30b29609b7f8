"""Synthetic recordings in other formats: a data set of Argoverse 1, and a sensor log of a scene."""

import json
from pathlib import Path
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import shapely
from pyarrow import feather
from scipy.spatial.transform import Rotation

from bridge.recordings.recording import Recording
from bridge.recordings.scenario import read_scenario
from netconvert.lane_graph import TurnType, turn_type

LOG_ID = "11111111-2222-3333-4444-555555555555"
FIRST_NS = 315_966_000_000_000_000
AV_AHEAD_M = 1.4
CATEGORIES = {"vehicle": "REGULAR_VEHICLE", "bus": "BUS", "pedestrian": "PEDESTRIAN", "cyclist": "BICYCLIST"}
#: Numbers of the cities' maps, and the date in the names of rasters, as in the data set.
CITY_IDS, DATE = {"MIA": 10316, "PIT": 10314}, "2019_05_28"
#: Steps of a sequence, of one in test_obs, and from one sequence of a scene to the next.
STEPS, OBSERVED, STRIDE = 50, 20, 30
_TURNS = {TurnType.STRAIGHT: "NONE", TurnType.LEFT: "LEFT", TurnType.RIGHT: "RIGHT"}
_MARGIN_M = 20
AV2 = Path(__file__).parents[2] / "data" / "av2"


class Piece(NamedTuple):
    """A scene of data/av2: its city, the split of its sequences, and how far it is moved, m."""

    scenario_id: str
    city: str
    split: str
    shift: tuple[float, float]


PIECES = (
    Piece("c58d7c2e-a9c9-5311-9808-c6a914afd19f", "MIA", "train", (0.0, 0.0)),
    Piece("2112b63e-58e4-5604-a86c-b243689827da", "MIA", "test_obs", (-3780.0, -1150.0)),
    Piece("bf8c5e9d-76de-5c6f-a44b-69cc2c9a318a", "PIT", "val", (0.0, 0.0)),
)


def make_argoverse1(out: Path) -> Path:
    """A data set in exactly the format of Argoverse 1 (1.1): sequences and the map files of two cities.

    OUT/{train,val,test_obs}/data/<n>.csv   TIMESTAMP,TRACK_ID,OBJECT_TYPE,X,Y,CITY_NAME; 50 time stamps, test_obs 20
    OUT/map_files/                          vector maps in XML, rasters of the drivable area with their transformations

    The scenes in data/av2 are its streets and its traffic: MIA is the arterial beside the curve, PIT the intersection.
    What the format does not tell is left out: headings, sizes, types, lane boundaries, markings, crossings.
    """
    number = 1
    for piece in PIECES:
        folder = out / piece.split / "data"
        folder.mkdir(parents=True, exist_ok=True)
        table = pq.read_table(next(AV2.glob(f"*/{piece.scenario_id}/scenario_*.parquet"))).to_pandas()
        count = OBSERVED if piece.split == "test_obs" else STEPS
        for first in range(0, 110 - STEPS + 1, STRIDE):
            rows = sequence(table, piece, first, count, number)
            (folder / f"{number}.csv").write_text(rows, encoding="ascii")
            number += 1
    for city in CITY_IDS:
        write_map(city, out / "map_files")
    return out


def sequence(table: Any, piece: Piece, first: int, count: int, number: int) -> str:  # a data frame
    """One CSV file: rows by time, the time stamps some milliseconds off."""
    kinds = table.object_type.isin(["vehicle", "bus"])
    rows = table[kinds & (table.timestep >= first) & (table.timestep < first + count)]
    names = {name: f"00000000-0000-0000-0000-{k:012d}" for k, name in enumerate(sorted(table.track_id.unique()))}
    lines = ["TIMESTAMP,TRACK_ID,OBJECT_TYPE,X,Y,CITY_NAME"]
    for row in rows.sort_values(["timestep", "track_id"], kind="stable").itertuples():
        step = row.timestep - first
        stamp = 315_970_000 + 100 * number + 0.1 * step + 0.001 * ((7 * step) % 9 - 4)
        kind = "AV" if row.track_id == "AV" else "AGENT" if row.object_category == 3 else "OTHERS"
        x, y = float(row.position_x) + piece.shift[0], float(row.position_y) + piece.shift[1]
        lines.append(f"{stamp!r},{names[row.track_id]},{kind},{x!r},{y!r},{piece.city}")
    return "\n".join([*lines, ""])


def write_map(city: str, folder: Path) -> None:
    """The vector map and the raster of one city."""
    folder.mkdir(parents=True, exist_ok=True)
    nodes: list[str] = []
    ways: list[str] = []
    areas = []
    for piece in PIECES:
        if piece.city != city:
            continue
        shift = np.array(piece.shift)
        document = json.loads(next(AV2.glob(f"*/{piece.scenario_id}/log_map_archive_*.json")).read_text())
        for lane in document["lane_segments"].values():
            _add_way(lane, shift, nodes, ways)
        rings = (area["area_boundary"] for area in document["drivable_areas"].values())
        areas += [shapely.Polygon(_points(ring) + shift) for ring in rings]
    root = ["<?xml version='1.0' encoding='UTF-8'?>", "<ArgoverseVectorMap>", *nodes, *ways, "</ArgoverseVectorMap>"]
    number = CITY_IDS[city]
    vector = folder / f"pruned_argoverse_{city}_{number}_vector_map.xml"
    vector.write_text("\n".join([*root, ""]), encoding="ascii")
    ground = shapely.union_all(areas)
    left, bottom, right, top = ground.bounds
    low = np.floor([left - _MARGIN_M, bottom - _MARGIN_M])
    width, height = (int(size) for size in np.ceil(np.array([right, top]) + _MARGIN_M - low))
    x, y = np.meshgrid(low[0] + np.arange(width) + 0.5, low[1] + np.arange(height) + 0.5)
    pixels = shapely.contains_xy(ground, x, y).astype(np.uint8)
    se2 = np.array([[1.0, 0.0, -low[0]], [0.0, 1.0, -low[1]], [0.0, 0.0, 1.0]])
    np.save(folder / f"{city}_{number}_driveable_area_mat_{DATE}.npy", pixels)
    np.save(folder / f"{city}_{number}_npyimage_to_city_se2_{DATE}.npy", se2)


def _add_way(lane: dict[str, Any], shift: Any, nodes: list[str], ways: list[str]) -> None:
    line = _points(lane["centerline"]) + shift
    first = len(nodes)
    for k, (x, y) in enumerate(line.tolist(), start=first):
        nodes.append(f'  <node id="{k}" x="{x!r}" y="{y!r}" height="0.0" />')
    tags = {
        "has_traffic_control": False,
        "turn_direction": _TURNS[turn_type(line, is_intersection=lane["is_intersection"])],
        "is_intersection": bool(lane["is_intersection"]),
        "l_neighbor_id": lane["left_neighbor_id"],
        "r_neighbor_id": lane["right_neighbor_id"],
    }
    ways.append(f'  <way lane_id="{lane["id"]}">')
    ways += [f"    <tag k={quoteattr(key)} v={quoteattr(str(value))} />" for key, value in tags.items()]
    ways += [f'    <nd ref="{k}" />' for k in range(first, len(nodes))]
    ways += [f'    <tag k="predecessor" v="{other}" />' for other in lane["predecessors"]]
    ways += [f'    <tag k="successor" v="{other}" />' for other in lane["successors"]]
    ways.append("  </way>")


def _points(points: list[dict[str, float]]) -> Any:  # (N, 2)
    return np.array([(point["x"], point["y"]) for point in points])


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


def log_tables(scenario: Recording, sweeps: int) -> tuple[pd.DataFrame, pd.DataFrame]:
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
