"""Seeded damage to files: the same seed, the same damage.

damage(path, rng) changes a file in place and says how: structure and values within its format (JSON, parquet, feather,
TOML, CSV, XML, arrays), or bytes without regard to it. mutate_scene(folder, seed) does so to a scene, one to three
times, or to the geometry of its map.
"""

import json
import math
import random
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from pyarrow import feather

#: What comes in the place of a value in JSON; `json` writes the last three as NaN and infinities.
WILD: tuple[Any, ...] = (
    None, True, -1, 0, 1, 2**31, 2**63, 2**70, 0.5, 1e-320, 1e9, 1e308, "", "x", "NaN", "../../x", "\0", "a\nb",
    "x" * 5000, [], {}, [[]], {"x": 1}, math.nan, math.inf, -math.inf,
)  # fmt: skip
WILD_FLOATS = (math.nan, math.inf, -math.inf, 0.0, -0.0, 1e-320, 1e308, -1e308, 1e6, 1e9)
WILD_INTS = (-(2**63), -1, 0, 1, 49, 50, 109, 110, 111, 2**31, 2**63 - 1)
WILD_TEXTS = ("", " ", "AV", "gen_0", "vehicle", "x" * 5000, "a\nb", "\x1b[2J", "../x", "ä", "\u202e")
WILD_TOML = (
    "nan", "inf", "-inf", "-1", "0", "1e308", "-0.0", str(2**70), "true", '""', '"x"', '"a\\nb"', '"../../x"',
    '"\\u001b[2J"', f'"{"x" * 5000}"', "[]", "[[]]", "[1, 2, 3]", "[nan, 1]", "{}", "{x = 1}", "1979-05-27", "=", "",
    "[x]", "[[x]]", "a.b.c",
)  # fmt: skip
#: Values, and in TOML keys too.
_VALUE = re.compile(r'(?<=")[^"<>]+(?=")|(?<=[,\n])[^,\n]+(?=[,\n])')
_TOML = re.compile(r"(?m)(?<== )[^\n]+|^[\w.\[\]]+")


def damage(path: Path, rng: random.Random) -> str:
    """Damage a file; what is too damaged for its format, and one of five, loses some of its bytes."""
    if rng.random() < 0.8:
        try:
            return f"{path.suffix}: {CHANGES[path.suffix](path, rng)}"
        except (ValueError, OSError, pa.ArrowException, LookupError, TypeError, AttributeError, OverflowError):
            pass
    path.write_bytes(mutate_bytes(path.read_bytes(), rng))
    return f"bytes of {path.suffix}"


def mutate_scene(folder: Path, seed: int) -> str:
    """Damage a scene; returns what was done."""
    rng = random.Random(seed)
    (map_path,) = folder.glob("log_map_archive_*.json")
    (table_path,) = folder.glob("scenario_*.parquet")
    said = []
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        kind = rng.choices(("map", "geometry", "table", "sizes"), weights=(35, 20, 40, 5))[0]
        if kind == "sizes":
            said.append(_write_sizes(folder / "agent_sizes.csv", rng))
        elif kind == "geometry":
            said.append(_change_geometry(map_path, rng))
        else:
            said.append(damage(map_path if kind == "map" else table_path, rng))
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


def _change_json(path: Path, rng: random.Random) -> str:
    """Walk down to some value, then replace it, drop it, double it, or let it change places."""
    document = json.loads(path.read_bytes())
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
    path.write_text(json.dumps(document))
    return f"{how} {'.'.join(trail)[-80:]}"


def _change_table(path: Path, rng: random.Random) -> str:
    """A column or rows of a table: left out, doubled, renamed, cast, or with other values."""
    read, write = (pq.read_table, pq.write_table) if path.suffix == ".parquet" else (_read_feather, _write_feather)
    table = read(path)
    number = rng.randrange(table.num_columns)
    field, column = table.schema.field(number), table.column(number)
    how = rng.choice(("values", "values", "values", "constant", "drop", "double", "rename", "cast", "nulls", "rows"))
    every = range(table.num_rows)
    rows = rng.sample(every, rng.choice((1, 1, table.num_rows // 2)))
    if how == "drop":
        table = table.remove_column(number)
    elif how == "double":
        table = table.append_column(field.name, column)
    elif how == "rename":
        other = rng.choice((field.name[::-1], "city"))
        table = table.rename_columns([other if name == field.name else name for name in table.schema.names])
    elif how == "cast":
        kind = rng.choice((pa.string(), pa.large_string(), pa.int32(), pa.float32(), pa.float64(), pa.binary()))
        table = table.set_column(number, field.name, column.cast(kind))
    elif how == "rows":
        table = table.take(pa.array(rng.choice((rows, sorted(set(every) - set(rows)), list(every[::-1])))))
    else:
        values = column.to_pylist()
        wild = None if how == "nulls" else rng.choice(_pool(values[rows[0]]))
        for row in every if how == "constant" else rows:
            is_list = isinstance(values[row], list) and wild is not None
            values[row] = [*values[row][:-1], wild] if is_list else wild
        table = table.set_column(number, field.name, pa.array(values, field.type))
    write(table, path)
    return f"{how} of {field.name}"


def _pool(value: Any) -> Sequence[Any]:
    """Wild values of the type of one, or of what a list has."""
    if isinstance(value, bool):
        return True, False
    return WILD_TEXTS if isinstance(value, str) else WILD_INTS if isinstance(value, int) else WILD_FLOATS


def _read_feather(path: Path) -> pa.Table:
    return feather.read_table(path)


def _write_feather(table: pa.Table, path: Path) -> None:
    feather.write_feather(table, str(path))


def _change_text(path: Path, rng: random.Random) -> str:
    """Another value, or a line left out, doubled or moved."""
    text, is_toml = path.read_text(), path.suffix == ".toml"
    if rng.random() < 0.3:
        lines = text.splitlines(keepends=True)
        line = lines.pop(rng.randrange(len(lines)))
        lines[rng.randrange(len(lines)) : 0] = rng.choice(([], [line], [line, line]))
        path.write_text("".join(lines))
        return "lines"
    found = rng.choice(list((_TOML if is_toml else _VALUE).finditer(text)))
    wild = str(rng.choice(WILD_TOML if is_toml else (*WILD_TEXTS, *WILD_FLOATS, *WILD_INTS)))
    path.write_text(text[: found.start()] + wild + text[found.end() :], encoding="utf-8", errors="surrogateescape")
    return f"{found[0][:40]!r}"


def _change_array(path: Path, rng: random.Random) -> str:
    array = np.load(path)
    how = rng.choice(("type", "shape", "rows", "value"))
    if how == "type":
        array = array.astype(rng.choice(("f2", "i8", "c16", "U3", "?")))
    elif how == "shape":
        array = array.reshape(-1)
    elif how == "rows":
        array = array[: rng.randrange(3)]
    else:
        array = array.astype(np.float64)
        array.flat[rng.randrange(array.size)] = rng.choice(WILD_FLOATS)
    np.save(path, array)
    return how


CHANGES: dict[str, Callable[[Path, random.Random], str]] = {
    ".json": _change_json, ".parquet": _change_table, ".feather": _change_table, ".npy": _change_array,
    ".csv": _change_text, ".xml": _change_text, ".toml": _change_text,
}  # fmt: skip


def _change_geometry(path: Path, rng: random.Random) -> str:
    """Lines of one lane or of all, scaled, moved, turned round; or links, types and drivable areas of a map."""
    try:
        document = json.loads(path.read_bytes())
        lanes = list(document["lane_segments"].values())
        how = rng.choice(("scale", "shift", "jitter", "reverse", "collapse", "links", "type", "areas", "area"))
        if how == "links":
            ids = [int(key) for key in document["lane_segments"]] + [-5, 2**40]
            lane = rng.choice(lanes)
            lane["successors"] = rng.choices(ids, k=rng.randrange(6))
            lane["left_neighbor_id"], lane["right_neighbor_id"] = rng.choice(ids), rng.choice([*ids, None])
        elif how == "type":
            for lane in rng.sample(lanes, rng.randrange(1, len(lanes) + 1)):
                lane["lane_type"] = rng.choice(("VEHICLE", "BIKE", "BUS"))
                lane["is_intersection"] = rng.random() < 0.5
                lane["left_lane_mark_type"] = rng.choice(("SOLID_WHITE", "NONE", "DASHED_WHITE", "UNKNOWN"))
        elif how == "areas":
            areas = document["drivable_areas"]
            for key in rng.sample(list(areas), rng.randrange(1, len(areas) + 1)):
                del areas[key]
        elif how == "area":
            rng.shuffle(rng.choice(list(document["drivable_areas"].values()))["area_boundary"])
        else:
            factor = rng.choice((-1.0, 0.0, 0.5, 3.0, 1e2, 1e4, 1e8))
            for lane in lanes if rng.random() < 0.4 else [rng.choice(lanes)]:
                for name in ("left_lane_boundary", "right_lane_boundary", "centerline"):
                    _change_points(lane.get(name) or [], how, factor, rng)
    except (ValueError, LookupError, TypeError, AttributeError):
        return "geometry: too damaged before"
    path.write_text(json.dumps(document))
    return f"{how} of lanes"


def _change_points(points: list[dict[str, float]], how: str, factor: float, rng: random.Random) -> None:
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


def _write_sizes(path: Path, rng: random.Random) -> str:
    cells = ("AV", "310100", "4.5", "1.9", "-1", "nan", "inf", "1e308", "", '"', "x" * 200_000, "\0", "ä")
    lines = ["track_id,length_m,width_m" if rng.random() < 0.8 else "a,b"]
    lines += [",".join(rng.choices(cells, k=rng.choice((2, 3, 3, 3, 4)))) for _ in range(rng.randrange(4))]
    path.write_text("\n".join(lines))
    return "sizes"
