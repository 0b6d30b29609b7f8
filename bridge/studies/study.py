"""Parameter studies: a design over parameters, scenes and seeds, run by the batch engine, told in two tables.

A study is a TOML file (examples in data/studies). Its runs are resumed like those of a batch.
"""

import csv
import itertools
import json
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from bridge.batch.batch import Options, Progress, Run, SceneJob, run_batch
from bridge.batch.manifest import DONE, ManifestRow
from bridge.batch.scan import Selection, facts_of, wanted
from bridge.config import config_from_dict, config_sha256
from bridge.files import table_file
from bridge.recordings.folders import Address
from bridge.recordings.sources import find_sources
from hid2.params import Config
from netconvert.errors import ConfigError, ScenarioError

#: Stands for request.trigger_min_s and request.trigger_max_s: a fixed trigger time.
TRIGGER = "trigger_s"
#: Below OUT: one folder per run with what was measured, and the scenes where they are kept.
RUNS, SCENES, RUN_FILE = "runs", "scenes", "run.json"
#: Runs on one scene that share its map, net and process.
_CHUNK = 20

Value = float | int | str | bool
Point = Mapping[str, Value]


class _File(BaseModel):
    """The TOML file as it is."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    scenes: list[str] = Field(min_length=1)
    can: list[str] = []
    seeds: Annotated[int, Field(ge=1, le=100_000)] | list[int] = 1
    design: Literal["grid", "latin_hypercube"] = "grid"
    samples: int = Field(default=0, ge=0, le=1_000_000)
    sample_seed: int = Field(default=0, ge=0)
    kind: Literal["lane_change", "overtake", "left_turn", "right_turn"] = "lane_change"
    vary: dict[str, list[Value]] = Field(min_length=1)
    config: dict[str, Any] = {}


@dataclass(frozen=True, slots=True)
class Study:
    """A study, resolved. points: what varies; configs[p][k]: configuration of point p with the k-th seed."""

    name: str
    kind: str
    design: str
    folders: tuple[Address, ...]
    points: tuple[Point, ...]
    seeds: tuple[int, ...]
    configs: tuple[tuple[Config, ...], ...]

    @property
    def jobs(self) -> list[SceneJob]:
        """The runs, scene by scene, some at a time."""
        runs = [Run(config) for configs in self.configs for config in configs]
        return [
            SceneJob(folder, tuple(runs[start : start + _CHUNK]))
            for folder in self.folders
            for start in range(0, len(runs), _CHUNK)
        ]


@dataclass(frozen=True, slots=True)
class StudyReport:
    """What a study wrote. failed: runs without a result."""

    files: tuple[Path, ...]
    runs: int
    failed: int


def read_study(path: Path, *, scenes: Sequence[Path] | None = None) -> Study:
    """Read a study. scenes: take the place of those in the file, whose paths are relative to it.

    Errors: ConfigError with file, key, value; also where a path holds no scene.
    """
    try:
        content = _File.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file, expected a study in TOML") from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"{path}: not TOML ({error})") from error
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(str(part) for part in first["loc"])
        value = "is missing" if first["type"] == "missing" else f"= {first['input']!r}: {first['msg']}"
        raise ConfigError(f"{path}: {key} {value}") from error
    places = scenes or [path.parent / scene for scene in content.scenes]
    try:
        folders = tuple(find_sources(places))
    except ScenarioError as error:
        raise ConfigError(f"{path}: scenes: {error}") from error
    if content.can:
        try:
            folders = tuple(wanted(folders, *facts_of(folders), Selection(can=tuple(content.can))))
        except ConfigError as error:
            raise ConfigError(f"{path}: can = {content.can!r}: {error}") from error
    seeds = tuple(range(content.seeds)) if isinstance(content.seeds, int) else tuple(content.seeds)
    points = tuple(_grid(content.vary) if content.design == "grid" else _latin_hypercube(content, path))
    configs = tuple(
        tuple(_configured(content.config, {**point, "request.seed": seed}, source=str(path)) for seed in seeds)
        for point in points
    )
    return Study(path.stem, content.kind, content.design, folders, points, seeds, configs)


def run_study(
    study: Study,
    out_dir: Path,
    options: Options,
    *,
    keep_scenes: bool = False,
    on_row: Callable[[ManifestRow, Progress], None] | None = None,
) -> StudyReport:
    """Do the runs that are not done yet, then write runs.csv, manoeuvres.csv and the figures into out_dir.

    Errors: BatchError, ExportError.
    """
    from bridge.studies.study_figures import draw_study  # matplotlib, at the end

    work = "measure_and_keep_runs" if keep_scenes else "measure_runs"
    options = replace(options, function=f"bridge.studies.study_work:{work}")
    rows = run_batch(study.jobs, out_dir, options, on_row=on_row)
    runs, maneuvers = tables(study, rows, out_dir)
    files = [out_dir / "runs.csv", out_dir / "manoeuvres.csv"]
    for file, table in zip(files, (runs, maneuvers), strict=True):
        _write_table(file, table)
    figures = draw_study(study, maneuvers, out_dir)
    return StudyReport((*files, *figures), len(rows), sum(row.status != DONE for row in rows))


def tables(
    study: Study, rows: Iterable[ManifestRow], out_dir: Path
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Tidy tables: one row per run, and one per manoeuvre that was asked for."""
    points = {
        config_sha256(config): (number, point)
        for number, (point, configs) in enumerate(zip(study.points, study.configs, strict=True))
        for config in configs
    }
    runs, maneuvers = [], []
    for row in rows:
        number, point = points[row.config_sha256]
        name = {"scene": row.scenario, "city": row.city, "point": number, **point, "seed": row.seed}
        records = []
        if row.status == DONE:
            records = json.loads((out_dir / row.folder / RUN_FILE).read_text(encoding="utf-8"))
        # triggered_s is None where no vehicle could be found for the request; trigger_s may be a column of the design
        maneuvers += [{**name, **_renamed(record), "wait_s": _wait(record)} for record in records]
        mine = [record for record in records if record["kind"] == study.kind]
        runs.append(
            {
                **name,
                "status": row.status,
                "reason": row.reason,
                "requested": row.requested,
                "placed": row.placed,
                f"{study.kind}_requested": len(mine),
                f"{study.kind}_done": sum(record["status"] == "done" for record in mine),
                "min_ttc_s": _least(record["window_ttc_s"] for record in mine),
                "min_pet_s": _least(record["pet_s"] for record in mine),
                "seconds": row.seconds,
            }
        )
    return runs, maneuvers


def _renamed(record: Mapping[str, Any]) -> dict[str, Any]:
    return {"triggered_s" if key == TRIGGER else key: value for key, value in record.items()}


def _wait(record: Mapping[str, Any]) -> float | None:
    if record["start_s"] is None or record["trigger_s"] is None:
        return None
    return round(float(record["start_s"]) - float(record["trigger_s"]), 6)


def _least(values: Iterable[float | None]) -> float | None:
    return min((value for value in values if value is not None), default=None)


def _grid(vary: Mapping[str, Sequence[Value]]) -> list[dict[str, Value]]:
    return [dict(zip(vary, values, strict=True)) for values in itertools.product(*vary.values())]


def _latin_hypercube(content: _File, path: Path) -> list[dict[str, Value]]:
    """Points of a Latin hypercube between the two bounds of each parameter; whole numbers where the bounds are."""
    from scipy.stats import qmc

    if content.samples < 1:
        raise ConfigError(f"{path}: samples = {content.samples}, expected the number of points of the hypercube")
    for key, bounds in content.vary.items():
        numbers = [bound for bound in bounds if isinstance(bound, int | float) and not isinstance(bound, bool)]
        if len(bounds) != 2 or len(numbers) != 2 or numbers[0] >= numbers[1]:
            raise ConfigError(f"{path}: vary.{key} = {bounds!r}, expected [low, high] with low < high")
    unit = qmc.LatinHypercube(d=len(content.vary), rng=content.sample_seed).random(content.samples)
    points = []
    for row in unit:
        point: dict[str, Value] = {}
        for share, (key, (low, high)) in zip(row, content.vary.items(), strict=True):
            if isinstance(low, int) and isinstance(high, int):
                point[key] = low + int(share * (high - low + 1))
            else:
                point[key] = round(float(low) + float(share) * (float(high) - float(low)), 6)
        points.append(point)
    return points


def _configured(base: Mapping[str, Any], changes: Mapping[str, Value], *, source: str) -> Config:
    """The base configuration with dotted keys changed. Errors: ConfigError."""
    values = {key: dict(value) if isinstance(value, Mapping) else value for key, value in base.items()}
    expanded = dict(changes)
    if TRIGGER in expanded:
        expanded["request.trigger_min_s"] = expanded["request.trigger_max_s"] = expanded.pop(TRIGGER)
    for key, value in expanded.items():
        section, dot, name = key.partition(".")
        if not dot:
            raise ConfigError(f"{source}: vary.{key}: expected {TRIGGER} or a key section.parameter of `hid2 config`")
        values.setdefault(section, {})[name] = value
    return config_from_dict(values, source=source)


def _write_table(path: Path, table: Sequence[Mapping[str, Any]]) -> None:
    columns = list(dict.fromkeys(key for row in table for key in row))
    with table_file(path) as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(table)
