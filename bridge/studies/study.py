"""Parameter studies: a paired design over parameters, scenes and seeds, run by the batch engine, told in tables.

A study is a TOML file (examples in data/studies, the page README.md in this folder). Its runs are resumed like those of
a batch.
"""

import gzip
import io
import itertools
import json
import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from bridge.batch.batch import RUNS, Run, SceneJob
from bridge.batch.manifest import DONE, ManifestRow
from bridge.batch.scan import Selection, wanted
from bridge.config import config_from_dict, config_sha256, functions_of, new_scenario_id
from bridge.files import MAX_FILE_MB, explained, one_line, read_packed, untabled
from bridge.recordings.export import write_folder
from bridge.recordings.folders import Address
from bridge.recordings.recording import Recording
from bridge.recordings.sources import find_sources
from bridge.toml import read_toml_as
from hid2.params import Config
from netconvert.errors import BatchError, ConfigError, ScenarioError

#: Stands for request.trigger_min_s and request.trigger_max_s: a fixed trigger time.
TRIGGER = "trigger_s"
#: Before the name of an argument of a rule of a user's own: what `lane_change.rule_with` has of it.
_RULE = "rule."
#: By what keys begin with, the rule that alone reads them; the last one stands for any of a user's own.
_OWN_RULE = "module:function"
_READ_BY = {
    "lane_change.time_gap_": "paper",
    "lane_change.min_gap_m": "paper",
    "lane_change.braking_mps2": "paper",
    "lane_change.mobil_": "MOBIL",
    "lane_change.lc_": "LC2013",
    _RULE: _OWN_RULE,
}
#: Of each run, in a folder of its own below OUT/runs: what was measured, and every look at a gap.
RUN_FILE, LOOKS_FILE = "run.json.gz", "looks.csv.gz"
#: Tables in RUN_FILE.
RUN_TABLES = ("requests", "flow", "lane_changes", "conflicts")
#: What decides in a run, and leaves vehicles, drivers, sites and traffic as they are.
_DECIDES = ("lane_change", "overtake", "conflict", "signals", "car_following", "driving")
#: What changes the traffic itself: allowed, but its values are compared between different vehicles.
_CHANGES_TRAFFIC = ("flow.veh_per_h_lane", "flow.min_headway_s", "drivers")

if TYPE_CHECKING:
    import pandas as pd

Value = float | int | str | bool
Point = Mapping[str, Value]


class _File(BaseModel):
    """The TOML file as it is."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    scenes: list[str] = []
    can: list[str] = []
    seeds: Annotated[int, Field(ge=1, le=100_000, strict=True)] | Annotated[list[int], Field(min_length=1)] = 1
    design: Literal["grid", "latin_hypercube"] = "grid"
    samples: int = Field(default=0, ge=0, le=1_000_000)
    sample_seed: int = Field(default=0, ge=0)
    kind: Literal["lane_change", "overtake"] = "lane_change"  # a turn takes no gap
    vary: dict[str, Annotated[list[FiniteFloat | int | str | bool], Field(min_length=1)]] = Field(min_length=1)
    config: dict[str, Any] = {}


@dataclass(frozen=True, slots=True)
class Study:
    """A study, resolved. points: what varies; configs[p][k]: configuration of point p with the k-th seed.

    paired: nothing that varies changes which vehicles take part.
    """

    name: str
    kind: str
    folders: tuple[Address, ...]
    points: tuple[Point, ...]
    seeds: tuple[int, ...]
    configs: tuple[tuple[Config, ...], ...]
    paired: bool

    @property
    def jobs(self) -> list[SceneJob]:
        """The runs; those of one scene and seed, which share vehicles, in one job."""
        of_seeds = [tuple(map(Run, configs)) for configs in zip(*self.configs, strict=True)]
        return [SceneJob(folder, runs) for folder in self.folders for runs in of_seeds]

    @property
    def rules(self) -> frozenset[str]:
        """Rules and behaviours of a user's own in it, each "module:name"."""
        return frozenset(name for configs in self.configs for config in configs for name in functions_of(config))

    @property
    def keys(self) -> tuple[str, ...]:
        """What varies."""
        return tuple(key for key in self.points[0] if len({point[key] for point in self.points}) > 1)


def read_study(path: Path | str, *, scenes: Sequence[Path | str] | None = None) -> Study:
    """Read a study. scenes: take the place of those in the file, where paths are relative to it.

    Errors: ConfigError with file, key, value; also where a path holds no scene.
    """
    path = Path(path)
    content = read_toml_as(_File, path, "a study")
    given: dict[str, Sequence[Value]] = {f"vary.{key}": values for key, values in content.vary.items()}
    if isinstance(content.seeds, list):
        given["seeds"] = content.seeds
    for key, values in given.items():
        check_different(values, f"{path}: {key} = {values!r:.200}", "expected each value once")
    places = [*map(Path, scenes or ())] or [path.parent / scene for scene in content.scenes]
    if not places:
        raise ConfigError(f"{path}: no key 'scenes', expected folders of recorded scenes: add it, or give --scenes")
    try:
        folders = tuple(find_sources(places))
    except ScenarioError as error:
        hint = "" if scenes else "; --scenes gives others than the file"
        raise ConfigError(f"{path}: scenes: {error}{hint}") from error
    if content.can:
        try:
            folders = tuple(wanted(folders, Selection(can=content.can))[0])
        except ConfigError as error:
            raise ConfigError(f"{path}: can = {content.can!r}: {error}") from error
    seeds = tuple(range(content.seeds)) if isinstance(content.seeds, int) else tuple(content.seeds)
    if content.design == "grid" and (unused := content.model_fields_set & {"samples", "sample_seed"}):
        key = min(unused)
        raise ConfigError(
            f"{path}: {key} = {getattr(content, key)} with design = 'grid', which has every combination of the values; "
            f"expected design = 'latin_hypercube', or no {key}"
        )
    points = tuple(grid(content.vary) if content.design == "grid" else _latin_hypercube(content, path))
    told = [", ".join(f"{key} = {value}" for key, value in point.items()) for point in points]
    check_different(told, f"{path}: samples = {content.samples}", "expected fewer samples, or wider bounds")
    configs = tuple(
        tuple(configured(content.config, {**point, "request.seed": seed}, source=str(path)) for seed in seeds)
        for point in points
    )
    rules = {_OWN_RULE if ":" in each[0].lane_change.rule else each[0].lane_change.rule for each in configs}
    for key in content.vary:
        if key != TRIGGER and not key.startswith((*(f"{section}." for section in _DECIDES), _RULE, *_CHANGES_TRAFFIC)):
            raise ConfigError(
                f"{path}: vary.{key}: would choose other vehicles or sites, and nothing could be compared; "
                f"expected {TRIGGER}, flow.veh_per_h_lane, rule.ARGUMENT, or a key of "
                f"{', '.join((*_DECIDES, 'drivers'))}"
            )
        reader = next((rule for prefix, rule in _READ_BY.items() if key.startswith(prefix)), None)
        if reader is not None and reader not in rules:
            raise ConfigError(
                f"{path}: vary.{key}: not read with lane_change.rule = {min(rules)!r}, and nothing would differ; "
                f"expected config.lane_change.rule = '{reader}', or another key"
            )
    if any(config.request.agents == "max" for config in configs[0]):
        raise ConfigError(f"{path}: config.request.agents = 'max', expected a number of vehicles")
    if any(config.request.entering > 0.0 for config in configs[0]):
        raise ConfigError(f"{path}: config.request.entering: in studies vehicles enter by flow.veh_per_h_lane: leave 0")
    paired = not any(key.startswith(_CHANGES_TRAFFIC) for key in content.vary)
    return Study(path.stem, content.kind, folders, points, seeds, configs, paired)


def check_different(values: Sequence[Value], given: str, expected: str) -> None:
    """Errors: ConfigError for a value that is there more than once, and would count as another one."""
    for value, times in Counter(values).items():
        if times > 1:
            raise ConfigError(f"{given}: {value!r:.200} is there {times} times, {expected}")


def tables(study: Study, rows: Iterable[ManifestRow], out_dir: Path) -> "dict[str, pd.DataFrame]":
    """What the runs have written, by name: runs, looks, and RUN_TABLES. Errors: BatchError."""
    import pandas as pd

    numbered = enumerate(zip(study.points, study.configs, strict=True))
    points = {config_sha256(one): (number, point) for number, (point, configs) in numbered for one in configs}
    every: dict[str, list[dict[str, Any]]] = {table: [] for table in ("runs", *RUN_TABLES)}
    looks: list[pd.DataFrame] = []
    for row in rows:
        number, point = points[row.config_sha256]
        config, folder = study.configs[number][0], out_dir / row.folder
        # the design's own trigger_s is a column of its own: that of a request in a flow is later by its entry
        own = {("trigger_after_s" if key == TRIGGER else key): value for key, value in point.items()}
        name = {"scene": row.scenario, "city": row.city, "point": number, **own, "seed": row.seed}
        name |= {"replay": config.driving.replay}
        found: dict[str, list[dict[str, Any]]] = {table: [] for table in RUN_TABLES}
        if row.status == DONE:
            with _of_a_run(folder, "study"):
                found = read_run(folder, RUN_TABLES, "study")
                # those count that were triggered, and not in the warm-up of a flow
                found["requests"] = [
                    {**one, "accepted": bool(one["accepted"]),
                     "counted": one["waited_s"] is not None and one["trigger_s"] >= config.flow.counted_from_s}
                    for one in found["requests"] if one["kind"] == study.kind
                ]  # fmt: skip
                table = io.BytesIO(read_packed(folder / LOOKS_FILE, most_mb=MAX_FILE_MB))
                own_looks = pd.read_csv(table, dtype={"lead_id": str, "lag_id": str, "vehicle": str})
                for column in ("lead_id", "lag_id"):
                    own_looks[column] = own_looks[column].map(untabled, na_action="ignore")
                named = pd.DataFrame(name, index=own_looks.index)
                looks.append(named.join(own_looks.drop(columns=["round", "track_id"])))
        found["runs"] = [{
            "status": row.status, "reason": row.reason, "vehicles": row.placed, "requests": len(found["requests"]),
            "accepted": sum(request["accepted"] for request in found["requests"]), "seconds": row.seconds,
            "folder": row.folder,
        }]  # fmt: skip
        for name_of, told in every.items():
            told += [{**name, **one} for one in found[name_of]]
    known = {table: pd.DataFrame(told) for table, told in every.items()}
    known["looks"] = pd.concat(looks) if looks else pd.DataFrame()
    if study.paired and every["requests"]:  # the same vehicles at every point at which there are any
        asked = known["requests"]
        times = asked.groupby(["scene", "seed", "vehicle"])["counted"].transform("sum")
        asked["counted"] &= times == asked.loc[asked["counted"], "point"].nunique()
    # columns of numbers are numbers, also where all of a run's are missing
    endings = ("_s", "_m", "_mps", "_mps2")
    return {
        table: frame.astype({column: float for column in frame.columns if str(column).endswith(endings)})
        for table, frame in known.items()
    }


def write_run(
    out: Path, source: Recording, config: Config, told: Mapping[str, Any], more: Mapping[str, bytes] | None = None
) -> Path:
    """Write what was measured in a run, and more files by name, into a folder of its own. Errors: ExportError."""
    folder = out / RUNS / new_scenario_id(source.scenario_id, config, config.request.seed, 0)
    text = json.dumps(told, indent=1, allow_nan=False) + "\n"
    with explained(folder):
        write_folder(folder, {RUN_FILE: gzip.compress(text.encode(), mtime=0), **(more or {})})
    return folder


def read_run(folder: Path, wanted: Collection[str], what: str) -> dict[str, Any]:
    """What `write_run` told of a run; a folder that was continued may hold anything. Errors: BatchError."""
    with _of_a_run(folder, what):
        found: dict[str, Any] = json.loads(read_packed(folder / RUN_FILE, most_mb=MAX_FILE_MB))
        if lacking := set(wanted) - found.keys():
            raise ValueError(f"without {', '.join(sorted(lacking))}")
        return found


@contextmanager
def _of_a_run(folder: Path, what: str) -> Iterator[None]:
    """Whatever is wrong with a run's files is told with its folder. Errors: BatchError."""
    try:
        yield
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise BatchError(
            f"{folder}: not what a run of a {what} writes ({one_line(repr(error), most=300)}); "
            f"please remove this folder, or begin the {what} in another one"
        ) from error


def grid(vary: Mapping[str, Sequence[Value]]) -> list[dict[str, Value]]:
    """Every combination of the values."""
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
    points = []
    for row in qmc.LatinHypercube(d=len(content.vary), rng=content.sample_seed).random(content.samples).tolist():
        point: dict[str, Value] = {}
        for share, (key, (low, high)) in zip(row, content.vary.items(), strict=True):
            if isinstance(low, int) and isinstance(high, int):
                point[key] = low + int(share * (high - low + 1))
            else:
                point[key] = round(float(low) + share * (float(high) - float(low)), 6)
        points.append(point)
    return points


def configured(base: Mapping[str, Any], changes: Mapping[str, Value], *, source: str) -> Config:
    """The base configuration with dotted keys changed. Errors: ConfigError."""
    values = {key: dict(value) if isinstance(value, Mapping) else value for key, value in base.items()}
    expanded = {key: value for key, value in changes.items() if not key.startswith(_RULE)}
    if TRIGGER in expanded:
        expanded["request.trigger_min_s"] = expanded["request.trigger_max_s"] = expanded.pop(TRIGGER)
        values["request"] = {**values.get("request", {}), "trigger_list_s": []}  # it would come first
    arguments = ", ".join(f"{key[5:]}={value}" for key, value in changes.items() if key.startswith(_RULE))
    if arguments:
        given = values.get("lane_change", {}).get("rule_with")
        expanded["lane_change.rule_with"] = f"{given}, {arguments}" if given else arguments
    for key, value in expanded.items():
        section, dot, name = key.partition(".")
        if not dot:
            raise ConfigError(f"{source}: vary.{key}: expected {TRIGGER} or a key section.parameter of `hid2 config`")
        values.setdefault(section, {})[name] = value
    try:
        return config_from_dict(values, source=source)
    except ConfigError as error:
        told = (
            re.sub(r"request\.trigger_m(in|ax)_s", f"vary.{TRIGGER}", str(error)) if TRIGGER in changes else str(error)
        )
        raise ConfigError(told) from error
