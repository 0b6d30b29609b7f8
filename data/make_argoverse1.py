"""Make a synthetic data set in exactly the format of Argoverse 1 (1.1): sequences and the map files of two cities.

    python data/make_argoverse1.py OUT

    OUT/{train,val,test_obs}/data/<n>.csv   TIMESTAMP,TRACK_ID,OBJECT_TYPE,X,Y,CITY_NAME; 50 time stamps, test_obs 20
    OUT/map_files/                          vector maps in XML, rasters of the drivable area with their transformations

The scenes in data/av2 are its streets and its traffic: MIA is the arterial beside the curve, PIT the intersection. What
the format does not tell is left out: headings, sizes, types, lane boundaries, markings, pedestrian crossings.
"""

import json
import sys
from pathlib import Path
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np
import pyarrow.parquet as pq
import shapely

from netconvert.lane_graph import TurnType, turn_type

HERE = Path(__file__).parent
#: Numbers of the cities' maps, and the date in the names of rasters, as in the data set.
CITY_IDS, DATE = {"MIA": 10316, "PIT": 10314}, "2019_05_28"
#: Steps of a sequence, of one in test_obs, and from one sequence of a scene to the next.
STEPS, OBSERVED, STRIDE = 50, 20, 30
_TURNS = {TurnType.STRAIGHT: "NONE", TurnType.LEFT: "LEFT", TurnType.RIGHT: "RIGHT"}
_MARGIN_M = 20


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


def make(out: Path) -> list[Path]:
    """Write the data set under out; returns the sequences."""
    number, written = 1, []
    for piece in PIECES:
        folder = out / piece.split / "data"
        folder.mkdir(parents=True, exist_ok=True)
        table = pq.read_table(next(HERE.glob(f"av2/*/{piece.scenario_id}/scenario_*.parquet"))).to_pandas()
        count = OBSERVED if piece.split == "test_obs" else STEPS
        for first in range(0, 110 - STEPS + 1, STRIDE):
            path = folder / f"{number}.csv"
            path.write_text(sequence(table, piece, first, count, number), encoding="ascii")
            written.append(path)
            number += 1
    for city in CITY_IDS:
        write_map(city, out / "map_files")
    return written


def sequence(table: Any, piece: Piece, first: int, count: int, number: int) -> str:  # noqa: ANN401  # a data frame
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
        document = json.loads(next(HERE.glob(f"av2/*/{piece.scenario_id}/log_map_archive_*.json")).read_text())
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


def _add_way(lane: dict[str, Any], shift: Any, nodes: list[str], ways: list[str]) -> None:  # noqa: ANN401
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


def _points(points: list[dict[str, float]]) -> Any:  # noqa: ANN401  # (N, 2)
    return np.array([(point["x"], point["y"]) for point in points])


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python data/make_argoverse1.py OUT")
    for made in make(Path(sys.argv[1])):
        print(made)
