"""Damaged configurations, studies, compositions, forecasts and sidecars: each is read, or refused in one line."""

import random
import re
import time
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from baseline_file import write_baseline
from mutations import WILD_FLOATS, WILD_INTS, WILD_TEXTS, mutate_bytes

from bridge.config import load_config
from bridge.forecasting.composition import Composition
from bridge.forecasting.predictions import score_predictions
from bridge.recordings.scenario import read_scenario
from bridge.recordings.sidecar import read_sidecar
from bridge.studies.study import read_study
from bridge.toml import read_toml_as
from netconvert.errors import Hid2Error

SEEDS = 80
#: Longest that reading a damaged file may take, s of processor time.
READ_S = 5.0
#: What comes in the place of a value of TOML.
WILD_TOML = (
    "nan", "inf", "-inf", "-1", "0", "1e308", "-0.0", str(2**70), "true", '""', '"x"', '"a\\nb"', '"../../x"',
    '"\\u001b[2J"', f'"{"x" * 5000}"', "[]", "[[]]", "[1, 2, 3]", "[nan, 1]", "{}", "{x = 1}", "1979-05-27", "=", "",
)  # fmt: skip
_VALUE = re.compile(r"(?<== )[^\n]+")
_KEY = re.compile(r"(?m)^[\w.\[\]]+")

CONFIG = """[request]
agents = 8
lane_change = 0.4
trigger_min_s = 1.0
focal = "generated"
[drivers]
tau_mean_s = 1.2
wander_sd_mps = 0.3
[spawn]
rounds = 3
[[event]]
kind = "cut_in"
target = "av"
at_s = [5.0, 7.0]
gap_m = [6.0, 10.0]
count = 2
"""
STUDY = """scenes = ["{scene}"]
seeds = 2
kind = "lane_change"
[vary]
trigger_s = [1.0, 3.0]
"lane_change.give_up_s" = [5.0, 10.0]
[config.request]
agents = 4
lane_change = 1.0
"""
COMPOSITION = """layout = "av2"
seed = 1
[sources]
a = "{scene}"
[split]
val = 0.25
test = 0.25
[sets.all.take]
a = "all"
[validation.all.take]
a = 1
"""


def _read_composition(path: Path) -> Composition:
    return read_toml_as(Composition, path, "a composition")


def _change_toml(path: Path, rng: random.Random) -> None:
    """Another value, another key, or a line left out, doubled or moved."""
    text, how = path.read_text(), rng.randrange(4)
    if how == 0:
        lines = text.splitlines(keepends=True)
        line = lines.pop(rng.randrange(len(lines)))
        lines[rng.randrange(len(lines)) : 0] = rng.choice(([], [line], [line, line]))
        path.write_text("".join(lines))
        return
    found = rng.choice(list((_KEY if how == 1 else _VALUE).finditer(text)))
    wild = rng.choice(("x", "[x]", "[[x]]", "a.b.c", '"\\u001b[2J"') if how == 1 else WILD_TOML)
    path.write_text(text[: found.start()] + wild + text[found.end() :])


def _change_table(path: Path, rng: random.Random) -> None:
    table = pq.read_table(path)
    at = rng.randrange(table.num_columns)
    name, column = table.schema.names[at], table.column(at).to_pylist()
    how, row = rng.randrange(5), rng.randrange(len(column))
    if how == 0:
        table = table.drop_columns([name])
    elif how == 1:
        table = table.slice(row, rng.randrange(len(column)))
    elif how == 2:
        wild = rng.choice((WILD_INTS, WILD_FLOATS, WILD_TEXTS))
        table = table.set_column(at, name, pa.array([rng.choice(wild)] * len(column)))
    else:
        if isinstance(column[row], list) and column[row] and how == 3:
            column[row][rng.randrange(len(column[row]))] = rng.choice(WILD_FLOATS)
        else:
            wild = WILD_FLOATS if isinstance(column[row], float) else WILD_TEXTS
            column[row] = rng.choice((None, [] if isinstance(column[row], list) else rng.choice(wild)))
        table = table.set_column(at, name, pa.array(column, table.schema.field(at).type))
    pq.write_table(table, path)


def _change_bytes(path: Path, rng: random.Random) -> None:
    path.write_bytes(mutate_bytes(path.read_bytes(), rng))


Files = dict[str, tuple[bytes, Callable[[Path], object], Callable[[Path, random.Random], None]]]


@pytest.fixture(scope="module")
def files(data_root: Path, data_scenes: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Files:
    """Of each kind a sound file, how it is read, and how it is damaged."""
    folder = tmp_path_factory.mktemp("files")
    forecasts = write_baseline(data_root, folder / "forecasts.parquet", kind="constant-velocity").read_bytes()
    scene = str(data_scenes["curve"])
    return {
        "config.toml": (CONFIG.encode(), load_config, _change_toml),
        "study.toml": (STUDY.format(scene=scene).encode(), read_study, _change_toml),
        "composition.toml": (COMPOSITION.format(scene=scene).encode(), _read_composition, _change_toml),
        "forecasts.parquet": (forecasts, lambda path: score_predictions(data_root, predictions=path), _change_table),
    }


@pytest.fixture
def sidecar(data_scenes: dict[str, Path], fake_generated: Callable[..., tuple[object, object, str]]) -> bytes:
    _, found, _ = fake_generated(read_scenario(data_scenes["curve"]))
    return found.model_dump_json(indent=1).encode()  # type: ignore[attr-defined]


def judge(path: Path, read: Callable[[Path], object], seed: int) -> bool:
    """Whether a damaged file was refused, by an error that the command puts on a line; and soon."""
    began, refused = time.process_time(), False
    try:
        read(path)
    except Hid2Error as error:
        refused = bool(str(error))
    except Exception as error:
        raise AssertionError(f"seed {seed} ({path}): {type(error).__name__}: {error}") from error
    assert time.process_time() - began < READ_S, f"seed {seed} ({path})"
    return refused


@pytest.mark.parametrize("name", ["config.toml", "study.toml", "composition.toml", "forecasts.parquet"])
def test_damaged_file_is_refused_in_one_line_or_read(files: Files, tmp_path: Path, name: str) -> None:
    sound, read, change = files[name]
    path = tmp_path / name
    path.write_bytes(sound)
    assert not judge(path, read, -1), "the sound file is read"
    refused = 0
    for seed in range(SEEDS):
        path.write_bytes(sound)
        rng = random.Random(seed)
        try:
            (_change_bytes if seed % 4 == 3 else change)(path, rng)
        except (ValueError, OSError, pa.ArrowException, OverflowError):
            _change_bytes(path, rng)
        refused += judge(path, read, seed)
    assert SEEDS > refused > SEEDS // 4


def test_damaged_sidecar_is_refused_in_one_line_or_read(sidecar: bytes, tmp_path: Path) -> None:
    path = tmp_path / "hid2_x.json"
    refused = 0
    for seed in range(SEEDS):
        rng = random.Random(seed)
        text = sidecar.decode()
        found = rng.choice(list(re.finditer(r"(?<=: )[^\n,{\[]+", text)))
        wild = rng.choice(
            ("null", "-1", "NaN", "1e999", "9" * 400, '""', '"\\u001b[2J"', "[]", "{}", "[" * 3000, "true")
        )
        path.write_text(text[: found.start()] + wild + text[found.end() :])
        if seed % 4 == 3:
            path.write_bytes(mutate_bytes(sidecar, rng))
        refused += judge(path, read_sidecar, seed)
    assert SEEDS > refused > SEEDS // 4
