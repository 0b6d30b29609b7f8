"""Seeded damage to scenes, bundles and manifests: the same seed, the same damage.

mutate_scene(folder, seed) changes the files of a scenario folder in place, one to three times, and says how. Structure
and values are changed within the format (JSON, parquet, CSV), and bytes without regard to it.
"""

import json
import math
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

#: What comes in the place of a value in JSON; `json` writes the last three as NaN and infinities.
WILD: tuple[Any, ...] = (
    None, True, -1, 0, 1, 2**31, 2**63, 2**70, 0.5, 1e-320, 1e9, 1e308, "", "x", "NaN", "../../x", "\0", "a\nb",
    "x" * 5000, [], {}, [[]], {"x": 1}, math.nan, math.inf, -math.inf,
)  # fmt: skip
WILD_FLOATS = (math.nan, math.inf, -math.inf, 0.0, -0.0, 1e-320, 1e308, -1e308, 1e6, 1e9)
WILD_INTS = (-(2**63), -1, 0, 1, 49, 50, 109, 110, 111, 2**31, 2**63 - 1)
WILD_TEXTS = ("", " ", "AV", "gen_0", "vehicle", "x" * 5000, "a\nb", "\x1b[2J", "../x", "ä", "\u202e")


def mutate_scene(folder: Path, seed: int) -> str:
    """Damage a scene; returns what was done."""
    rng = random.Random(seed)
    (map_path,) = folder.glob("log_map_archive_*.json")
    (table_path,) = folder.glob("scenario_*.parquet")
    said = []
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        kind = rng.choices(("map", "geometry", "table", "bytes", "sizes"), weights=(30, 20, 35, 10, 5))[0]
        try:
            if kind == "map":
                said.append(_edit_json(map_path, lambda document: _change_json(document, rng)))
            elif kind == "geometry":
                said.append(_edit_json(map_path, lambda document: _change_geometry(document, rng)))
            elif kind == "table":
                said.append(_change_table(table_path, rng))
            elif kind == "sizes":
                said.append(_write_sizes(folder / "agent_sizes.csv", rng))
            else:
                path = rng.choice((map_path, table_path))
                path.write_bytes(mutate_bytes(path.read_bytes(), rng))
                said.append(f"bytes of {path.suffix}")
        except (ValueError, OSError, pa.ArrowException, KeyError, TypeError, AttributeError, IndexError, OverflowError):
            said.append(f"{kind}: too damaged before")
    return "; ".join(said)


def mutate_bytes(raw: bytes, rng: random.Random) -> bytes:
    """Flip, cut, double, overwrite or insert bytes somewhere."""
    if not raw:
        return rng.randbytes(10)
    at, length = rng.randrange(len(raw)), rng.choice((1, 1, 4, 100, 5000))
    how = rng.randrange(5)
    if how == 0:
        return raw[:at] + bytes([raw[at] ^ (1 << rng.randrange(8))]) + raw[at + 1 :]
    if how == 1:
        return raw[:at]
    if how == 2:
        return raw[: at + length] + raw[at:]
    if how == 3:
        return raw[:at] + rng.randbytes(length) + raw[at + length :]
    return raw[:at] + rng.choice((b"\0", b"\n", b'"', b",", b"\xff", b"9" * 5000)) + raw[at:]


def _edit_json(path: Path, change: Callable[[Any], str]) -> str:
    document = json.loads(path.read_bytes())
    said = change(document)
    path.write_text(json.dumps(document))
    return said


def _change_json(document: Any, rng: random.Random) -> str:
    """Walk down to some value, then replace it, drop it, double it, or let it change places."""
    parent, key, trail = None, None, []
    node = document
    while isinstance(node, dict | list) and node and (parent is None or rng.random() < 0.85):
        parent = node
        key = rng.choice(list(node)) if isinstance(node, dict) else rng.randrange(len(node))
        node = node[key]
        trail.append(str(key))
    how = rng.choice(("replace", "replace", "drop", "double", "swap"))
    if how == "drop":
        del parent[key]
    elif how == "double" and isinstance(parent, list):
        parent.insert(key, parent[key])
    elif how == "swap" and len(parent) > 1:
        other = rng.choice(list(parent)) if isinstance(parent, dict) else rng.randrange(len(parent))
        parent[key], parent[other] = parent[other], parent[key]
    else:
        parent[key] = rng.choice(WILD)
    return f"{how} {'.'.join(trail)[-80:]}"


def _change_geometry(document: Any, rng: random.Random) -> str:
    lanes = list(document["lane_segments"].values())
    lane = rng.choice(lanes)
    lists = [lane["left_lane_boundary"], lane["right_lane_boundary"], lane.get("centerline") or []]
    if rng.random() < 0.4:
        for other in lanes:
            lists += [other["left_lane_boundary"], other["right_lane_boundary"], other.get("centerline") or []]
    how = rng.choice(("scale", "shift", "jitter", "reverse", "collapse", "links", "type", "areas", "area"))
    factor = rng.choice((-1.0, 0.0, 0.5, 3.0, 1e2, 1e4, 1e8))
    if how == "links":
        ids = [int(key) for key in document["lane_segments"]] + [-5, 2**40]
        lane["successors"] = rng.choices(ids, k=rng.randrange(6))
        lane["left_neighbor_id"], lane["right_neighbor_id"] = rng.choice(ids), rng.choice([*ids, None])
    elif how == "type":
        for other in rng.sample(lanes, rng.randrange(1, len(lanes) + 1)):
            other["lane_type"] = rng.choice(("VEHICLE", "BIKE", "BUS"))
            other["is_intersection"] = rng.random() < 0.5
            other["left_lane_mark_type"] = rng.choice(("SOLID_WHITE", "NONE", "DASHED_WHITE", "UNKNOWN"))
    elif how == "areas":
        areas = document["drivable_areas"]
        for key in rng.sample(list(areas), rng.randrange(1, len(areas) + 1)):
            del areas[key]
    elif how == "area":
        rng.shuffle(rng.choice(list(document["drivable_areas"].values()))["area_boundary"])
    else:
        _change_points(lists, how, factor, rng)
    return f"{how} of {'one lane' if len(lists) == 3 else 'all lanes'} ({factor:g})"


def _change_points(lists: list[Any], how: str, factor: float, rng: random.Random) -> None:
    for points in lists:
        if how == "reverse":
            points.reverse()
        for point in points:
            for axis in "xy":
                if how == "scale":
                    point[axis] *= factor
                elif how == "shift":
                    point[axis] += 10 * factor
                elif how == "jitter":
                    point[axis] += rng.gauss(0.0, 2.0)
                elif how == "collapse":
                    point[axis] = points[0][axis]


def _change_table(path: Path, rng: random.Random) -> str:
    table = pq.read_table(path)
    number = rng.randrange(table.num_columns)
    field = table.schema.field(number)
    how = rng.choice(
        ("values", "values", "values", "constant", "drop", "double", "rename", "cast", "nulls", "rows", "track")
    )
    rows = np.array(rng.sample(range(table.num_rows), rng.choice((1, 3, table.num_rows // 2))))
    if how == "drop":
        table = table.remove_column(number)
    elif how == "double":
        table = table.append_column(field.name, table.column(number))
    elif how == "rename":
        table = table.rename_columns(
            [rng.choice((n, n[::-1], "city")) if n == field.name else n for n in table.schema.names]
        )
    elif how == "cast":
        kind = rng.choice((pa.string(), pa.large_string(), pa.int32(), pa.float32(), pa.float64(), pa.binary()))
        table = table.set_column(number, field.name, table.column(number).cast(kind))
    elif how == "rows":
        order = rng.choice((rows, np.setdiff1d(np.arange(table.num_rows), rows), np.arange(table.num_rows)[::-1]))
        table = table.take(pa.array(order))
    elif how == "track":
        ids = table.column("track_id").to_pylist()
        which, shift = rng.choice(sorted(set(ids))), rng.choice((-60, -1, 1, 60))
        steps = [t + shift * (i == which) for i, t in zip(ids, table.column("timestep").to_pylist(), strict=True)]
        table = table.set_column(table.schema.get_field_index("timestep"), "timestep", pa.array(steps, pa.int64()))
        return _written(table, path, f"track {which} by {shift} steps")
    else:
        values = table.column(number).to_pylist()
        pool = WILD_FLOATS if pa.types.is_floating(field.type) else WILD_INTS
        pool = (
            WILD_TEXTS if pa.types.is_string(field.type) else (True, False) if pa.types.is_boolean(field.type) else pool
        )
        new = None if how == "nulls" else rng.choice(pool)
        for row in range(len(values)) if how == "constant" else rows:
            values[row] = new
        table = table.set_column(number, field.name, pa.array(values, field.type))
    return _written(table, path, f"{how} of {field.name}")


def _written(table: pa.Table, path: Path, said: str) -> str:
    pq.write_table(table, path)
    return said


def _write_sizes(path: Path, rng: random.Random) -> str:
    cells = ("AV", "310100", "4.5", "1.9", "-1", "nan", "inf", "1e308", "", '"', "x" * 200_000, "\0", "ä")
    lines = ["track_id,length_m,width_m" if rng.random() < 0.8 else "a,b"]
    lines += [",".join(rng.choices(cells, k=rng.choice((2, 3, 3, 3, 4)))) for _ in range(rng.randrange(4))]
    path.write_text("\n".join(lines))
    return "sizes"
