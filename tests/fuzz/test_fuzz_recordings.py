"""Damaged sequences, city maps and sensor logs: each is read, or refused in one line."""

import json
import random
import re
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from mutations import WILD, WILD_FLOATS, WILD_INTS, WILD_TEXTS, mutate_bytes
from pyarrow import feather
from recordings import LOG_ID, make_argoverse1, make_log

from bridge.recordings.folders import Choices
from bridge.recordings.sources import find_recordings, read_recording
from netconvert.errors import Hid2Error

SEEDS = 120
#: Longest that reading a damaged recording may take, s of processor time.
READ_S = 10.0
_VALUE = re.compile(r'(?<=")[^"<>]+(?=")|(?<=[,\n])[^,\n]+(?=[,\n])')


def _change_text(path: Path, rng: random.Random) -> None:
    """Another value in the place of one of a CSV or XML file."""
    text = path.read_text()
    found = list(_VALUE.finditer(text))
    value = rng.choice(found)
    wild = str(rng.choice((*WILD_TEXTS, *WILD_FLOATS, *WILD_INTS)))
    path.write_text(text[: value.start()] + wild + text[value.end() :], encoding="utf-8", errors="surrogateescape")


def _change_lines(path: Path, rng: random.Random) -> None:
    """A line left out, doubled or moved."""
    lines = path.read_text().splitlines(keepends=True)
    at = rng.randrange(len(lines))
    line = lines.pop(at)
    lines[rng.randrange(len(lines)) : 0] = rng.choice(([], [line], [line, line]))
    path.write_text("".join(lines))


def _change_array(path: Path, rng: random.Random) -> None:
    array = np.load(path)
    change = rng.randrange(4)
    if change == 0:
        array = array.astype(rng.choice(("f2", "i8", "c16", "U3", "?")))
    elif change == 1:
        array = array.reshape(-1)
    elif change == 2:
        array = array[: rng.randrange(3)]
    else:
        array = array.astype(np.float64)
        array.flat[rng.randrange(array.size)] = rng.choice(WILD_FLOATS)
    np.save(path, array)


def _change_bytes(path: Path, rng: random.Random) -> None:
    path.write_bytes(mutate_bytes(path.read_bytes(), rng))


def _change_feather(path: Path, rng: random.Random) -> None:
    table = feather.read_table(path)
    at = rng.randrange(table.num_columns)
    name, column = table.schema.names[at], table.column(at).to_pylist()
    change = rng.randrange(4)
    if change == 0:
        table = table.drop_columns([name])
    elif change == 1:
        table = table.slice(rng.randrange(table.num_rows), rng.randrange(table.num_rows))
    else:
        wild = WILD_INTS if isinstance(column[0], int) else WILD_FLOATS if isinstance(column[0], float) else WILD_TEXTS
        for row in [rng.randrange(len(column))] if change == 2 else range(len(column)):
            column[row] = rng.choice((None, *wild)) if change == 2 else wild[0]
        table = table.set_column(at, name, pa.array(column))
    feather.write_feather(table, str(path))


def _change_json(path: Path, rng: random.Random) -> None:
    document = json.loads(path.read_text())
    part = document
    for _ in range(rng.randrange(1, 6)):
        keys = list(part) if isinstance(part, dict) else list(range(len(part)))
        key = rng.choice(keys)
        if not isinstance(part[key], dict | list) or not part[key]:
            break
        part, parent = part[key], part
        if rng.random() < 0.2:
            part = parent
            break
    keys = list(part) if isinstance(part, dict) else list(range(len(part)))
    part[rng.choice(keys)] = rng.choice(WILD)
    path.write_text(json.dumps(document))


Change = Callable[[Path, random.Random], None]
CHANGES: dict[str, tuple[Change, ...]] = {
    ".csv": (_change_text, _change_text, _change_lines, _change_bytes),
    ".xml": (_change_text, _change_text, _change_lines, _change_bytes),
    ".npy": (_change_array, _change_bytes),
    ".feather": (_change_feather, _change_feather, _change_bytes),
    ".json": (_change_json, _change_bytes),
}


def judge(made: Path, address: str, seed: int, place: Path) -> bool:
    """Whether a damaged copy was refused; it must be in one line, and soon."""
    copy = place / str(seed)
    shutil.copytree(made, copy)
    rng = random.Random(seed)
    files = sorted(path for path in copy.rglob("*") if path.suffix in CHANGES)
    path = rng.choice(files)
    try:
        rng.choice(CHANGES[path.suffix])(path, rng)
    except (ValueError, OSError, pa.ArrowException, OverflowError, UnicodeError, IndexError):
        _change_bytes(path, rng)
    began, message = time.process_time(), ""
    try:
        for found in find_recordings([copy / address], Choices(stride=10)):
            read_recording(found)
    except Hid2Error as error:
        message = str(error)
    except Exception as error:
        raise AssertionError(f"seed {seed} ({path.name}): {type(error).__name__}: {error}") from error
    finally:
        shutil.rmtree(copy)
    assert time.process_time() - began < READ_S, f"seed {seed} ({path.name})"
    assert "\n" not in message, f"seed {seed} ({path.name}): {message}"
    assert len(message) < 1500, f"seed {seed} ({path.name})"
    return bool(message)


@pytest.fixture(scope="module")
def sequences(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One sequence on the map of its city."""
    root = tmp_path_factory.mktemp("fuzz")
    made = make_argoverse1(root / "made")
    (root / "one" / "val" / "data").mkdir(parents=True)
    shutil.copyfile(made / "val/data/7.csv", root / "one/val/data/7.csv")
    (root / "one" / "map_files").mkdir()
    for path in (made / "map_files").glob("*PIT*"):
        shutil.copyfile(path, root / "one" / "map_files" / path.name)
    return root / "one"


@pytest.fixture(scope="module")
def logs(data_scenes: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("fuzz-logs")
    make_log(data_scenes["curve"], root, sweeps=112)
    return root


def test_damaged_sequences_and_city_maps_are_refused_in_one_line_or_read(sequences: Path, tmp_path: Path) -> None:
    refused = sum(judge(sequences, "val/data/7.csv", seed, tmp_path) for seed in range(SEEDS))
    assert SEEDS > refused > SEEDS // 4


def test_damaged_logs_are_refused_in_one_line_or_read(logs: Path, tmp_path: Path) -> None:
    refused = sum(judge(logs, LOG_ID, seed, tmp_path) for seed in range(SEEDS))
    assert SEEDS > refused > SEEDS // 4
