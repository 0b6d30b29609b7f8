"""A page of public roads: published counts of lane changes beside those of each rule, untuned, tuned and with causes.

A page is a TOML file (data/public/ngsim.toml; README.md in this folder) that names roads, published counts and rules. A
rule is tuned on the roads with `tune = true` alone; every other road is a test. Runs are resumed like a batch's.
"""

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field
from scipy import stats

from bridge.batch.batch import Options, Progress, SceneJob, run_batch
from bridge.batch.batch import Run as BatchRun
from bridge.batch.manifest import DONE, ManifestRow
from bridge.config import config_sha256, read_toml_as
from bridge.files import write_rows, write_text
from bridge.pages.parts import text
from bridge.recordings.corridor import write_road
from bridge.recordings.road import Road, RoadPart, read_road
from bridge.studies.run import RunsReport
from bridge.studies.study import Value, configured, read_run
from hid2.params import Config
from hid2.resampling import Estimate, ratio
from netconvert.errors import ConfigError

WORK = "bridge.studies.study_work:measure_roads"
#: What a road has to reproduce before lane changes are looked at: shares of flow and speed that it may be off.
FLOW_WITHIN, SPEED_WITHIN = 0.03, 0.10
UNTUNED, TUNED = "untuned", "tuned"
_Changes = dict[str, Value]


class Counts(RoadPart):
    """What was published of a road. Lanes are start lanes, from the left; start_to_end: the ramps are the last."""

    name: str
    flow_veh_per_h: float = Field(gt=0)
    speed_mps: float = Field(gt=0)
    vehicles: Annotated[list[float], Field(min_length=2)]
    changes_per_vehicle: Annotated[list[float], Field(min_length=2)]
    ramp_vehicles: float = Field(default=0.0, ge=0)
    ramp_changes_per_vehicle: float = Field(default=0.0, ge=0)
    all_changes_per_vehicle: float = Field(gt=0)
    changes_per_veh_km: float = Field(gt=0)
    start_to_end: list[list[float]] = Field(default=[])

    @property
    def weighed(self) -> list[tuple[float, float]]:
        """Vehicles and changes per vehicle of each start lane, and of the ramp if there is one."""
        ramp = [(self.ramp_vehicles, self.ramp_changes_per_vehicle)] if self.ramp_vehicles else []
        return [*zip(self.vehicles, self.changes_per_vehicle, strict=True), *ramp]


class _RoadEntry(RoadPart):
    file: str
    counts: str
    tune: bool = False
    set: _Changes = Field(default={})


class _PageRule(RoadPart):
    name: str
    set: _Changes = Field(default={})
    vary: dict[str, Annotated[list[Value], Field(min_length=1)]] = Field(default={})


class _Cause(RoadPart):
    says: str
    set: Annotated[_Changes, Field(min_length=1)]


class _PageFile(RoadPart):
    """The TOML file as it is."""

    seeds: int = Field(default=3, ge=1, le=1000)
    tuning_seeds: int = Field(default=1, ge=1, le=1000)
    cause_seeds: int = Field(default=1, ge=1, le=1000)
    config: dict[str, Any] = Field(default={})
    road: Annotated[list[_RoadEntry], Field(min_length=1)]
    rule: Annotated[list[_PageRule], Field(min_length=1)]
    cause: list[_Cause] = Field(default=[])


class Site(NamedTuple):
    """A road with what was published of it. set: of the configuration, on this road."""

    road_file: Path
    road: Road
    counts: Counts
    tune: bool
    set: Mapping[str, Value]


@dataclass(frozen=True, slots=True)
class PublicRoads:
    """A page, resolved."""

    source: Path
    file: _PageFile
    sites: tuple[Site, ...]

    def config(self, site: Site, rule: _PageRule, changes: Mapping[str, Value], seed: int) -> Config:
        """The configuration of a run. Errors: ConfigError."""
        own = {"request.agents": 0, **site.set, **rule.set, **changes, "request.seed": seed}
        return configured(self.file.config, own, source=str(self.source))


def read_public(path: Path) -> PublicRoads:
    """Read a page and the files that it names, relative to it. Errors: ConfigError with file, key, value."""
    file = read_toml_as(_PageFile, path, "a page of public roads")
    sites = []
    for entry in file.road:
        road_file, counts_file = path.parent / entry.file, path.parent / entry.counts
        road, counts = read_road(road_file), read_toml_as(Counts, counts_file, "published counts")
        for name, values in (("vehicles", counts.vehicles), ("changes_per_vehicle", counts.changes_per_vehicle)):
            if len(values) != road.lanes:
                raise ConfigError(
                    f"{counts_file}: {name}: {len(values)} values, expected one for each of {road.lanes} lanes of "
                    f"{road_file}"
                )
        sites.append(Site(road_file, road, counts, entry.tune, entry.set))
    if any(rule.vary for rule in file.rule) and not any(site.tune for site in sites):
        raise ConfigError(f"{path}: rule.vary, and no road with tune = true; expected one to tune on")
    page = PublicRoads(path, file, tuple(sites))
    for site, rule in itertools.product(sites, file.rule):  # all that is wrong is said before anything is driven
        for changes in [*_points(rule), *(cause.set for cause in file.cause)]:
            page.config(site, rule, changes, 0)
    return page


def _points(rule: _PageRule) -> list[_Changes]:
    """What tuning chooses from: nothing changed, and every combination."""
    grid = (dict(zip(rule.vary, values, strict=True)) for values in itertools.product(*rule.vary.values()))
    return [{}, *grid] if rule.vary else [{}]


class RoadResult(NamedTuple):
    """What came of a rule on a road over its seeds. changes: of the configuration, beside the rule's own."""

    site: Site
    rule: str
    variant: str
    changes: Mapping[str, Value]
    runs: Sequence[Mapping[str, Any]]

    def per_vehicle(self, lanes: Sequence[int]) -> Estimate:
        """Changes per vehicle of start lanes (rows), with the interval over seeds."""
        changes, vehicles = (
            np.array([sum(run[key][lane] for lane in lanes) for run in self.runs], dtype=np.float64)
            for key in ("changes", "vehicles")
        )
        return ratio(changes, vehicles)

    @property
    def each(self) -> list[Estimate]:
        """Changes per vehicle by start lane, the ramp last."""
        return [self.per_vehicle([lane]) for lane in range(len(self.site.counts.weighed))]

    @property
    def every(self) -> Estimate:
        """Changes per vehicle of all."""
        return self.per_vehicle(range(self.site.road.beside_number))

    @property
    def per_veh_km(self) -> Estimate:
        """Changes of those counted per kilometre that vehicles drove."""
        return ratio(*np.array([(sum(run["changes"]), run["veh_km"]) for run in self.runs], dtype=np.float64).T)

    def mean(self, key: str) -> float:
        """Of all runs."""
        return float(np.mean([run[key] for run in self.runs]))

    @property
    def off(self) -> tuple[float, float]:
        """How far flow and speed are from those published, as shares."""
        counts = self.site.counts
        return self.mean("flow_veh_per_h") / counts.flow_veh_per_h - 1, self.mean("speed_mps") / counts.speed_mps - 1

    @property
    def reproduces(self) -> bool:
        """Whether the road has its flow and speed."""
        return abs(self.off[0]) <= FLOW_WITHIN and abs(self.off[1]) <= SPEED_WITHIN

    @property
    def misses(self) -> float:
        """By how much changes per vehicle of all are off, as a share."""
        return (self.every.value or 0.0) / self.site.counts.all_changes_per_vehicle - 1

    @property
    def error(self) -> float:
        """Mean difference of changes per vehicle by start lane and from the ramp, weighed by published vehicles."""
        published = self.site.counts.weighed
        apart = [abs((ours.value or 0.0) - theirs) for ours, (_, theirs) in zip(self.each, published, strict=True)]
        return float(np.average(apart, weights=[vehicles for vehicles, _ in published]))

    @property
    def rank(self) -> float | None:
        """Spearman's correlation over start lanes, without the ramp; None where all of ours are alike."""
        ours = [one.value or 0.0 for one in self.each[: self.site.road.lanes]]
        if len(set(ours)) < 2:
            return None
        return float(stats.spearmanr(ours, self.site.counts.changes_per_vehicle).statistic)

    @property
    def end_shares(self) -> list[list[float]]:
        """Shares of each start lane that end in each lane."""
        table = np.sum([run["start_to_end"] for run in self.runs], axis=0, dtype=np.float64)
        return (table / np.maximum(table.sum(axis=1, keepdims=True), 1.0)).tolist()  # type: ignore[no-any-return]


_Asked = tuple[Site, _PageRule, str, Mapping[str, Value], int]


def run_public(
    page: PublicRoads,
    out_dir: Path,
    options: Options,
    *,
    on_row: Callable[[ManifestRow, Progress], None] | None = None,
) -> RunsReport:
    """Tune each rule, test it, try the causes, and write the page. Errors: BatchError, ConfigError, ExportError."""
    names = {page.config(page.sites[0], rule, {}, 0).lane_change.rule for rule in page.file.rule}  # the user's own file
    options = replace(options, function=WORK, functions=names, resume=True)
    folders = {site.road_file: write_road(out_dir / "roads", site.road_file) for site in page.sites}
    rows: dict[tuple[str, str], ManifestRow] = {}

    def driven(asked: Iterable[_Asked]) -> list[RoadResult]:
        wanted = [(one, [page.config(one[0], one[1], one[3], seed) for seed in range(one[4])]) for one in asked]
        jobs = {
            (folders[one[0].road_file].name, config_sha256(config)):
            SceneJob(folders[one[0].road_file], (BatchRun(config),))
            for one, configs in wanted for config in configs
        }  # fmt: skip
        found = run_batch([job for key, job in jobs.items() if key not in rows], out_dir, options, on_row=on_row)
        rows.update({(row.scenario, row.config_sha256): row for row in found})
        results = []
        for (site, rule, variant, changes, _), configs in wanted:
            own = [rows[folders[site.road_file].name, config_sha256(config)] for config in configs]
            told = [
                read_run(out_dir / row.folder, ("vehicles", "changes", "veh_km"), "page of public roads")
                for row in own if row.status == DONE
            ]  # fmt: skip
            if told:
                results.append(RoadResult(site, rule.name, variant, changes, told))
        return results

    file = page.file
    tried = driven(
        (site, rule, f"point {number}", changes, file.tuning_seeds)
        for rule in file.rule for site in page.sites if site.tune and rule.vary
        for number, changes in enumerate(_points(rule))
    )  # fmt: skip
    best = {rule.name: _best([one for one in tried if one.rule == rule.name]) for rule in file.rule}
    tests = driven(
        (site, rule, variant, changes, file.seeds)
        for site in page.sites for rule in file.rule
        for variant, changes in ((UNTUNED, {}), *([(TUNED, best[rule.name])] if rule.vary else []))
    )  # fmt: skip
    causes = driven(
        (site, rule, cause.says, {**best[rule.name], **cause.set}, file.cause_seeds)
        for site in page.sites for rule in file.rule for cause in file.cause
    )  # fmt: skip
    return RunsReport.of(_write(page, tried, best, tests, causes, out_dir), rows.values())


def _best(tried: Sequence[RoadResult]) -> Mapping[str, Value]:
    """The changes with the least error over the tuned roads, of those with which the roads have flow and speed."""
    points: dict[str, list[RoadResult]] = {}
    for one in tried:
        points.setdefault(one.variant, []).append(one)
    if not points:
        return {}
    found = min(
        points.values(), key=lambda own: (not all(one.reproduces for one in own), np.mean([one.error for one in own]))
    )
    return found[0].changes


def _write(
    page: PublicRoads, tried: Sequence[RoadResult], best: Mapping[str, Mapping[str, Value]],
    tests: Sequence[RoadResult], causes: Sequence[RoadResult], out_dir: Path,
) -> tuple[Path, ...]:  # fmt: skip
    table, told = out_dir / "public.csv", out_dir / "public.md"
    head = ("road", "rule", "variant", "measure", "published", "ours", "low", "high", "runs")
    write_rows(table, head, [row for one in [*tests, *causes] for row in _rows(one)])
    values = {"page": page, "tried": tried, "best": best, "tests": tests, "causes": causes}
    values["last"] = {rule.name: TUNED if rule.vary else UNTUNED for rule in page.file.rule}
    limits = {"flow_within": FLOW_WITHIN, "speed_within": SPEED_WITHIN}
    write_text(told, text("public.md.j2", **values, **limits))
    return told, table


def _rows(one: RoadResult) -> Iterable[tuple[object, ...]]:
    counts, road = one.site.counts, one.site.road
    rows: list[tuple[str, float | None, Estimate]] = [
        ("flow_veh_per_h", counts.flow_veh_per_h, Estimate(one.mean("flow_veh_per_h"))),
        ("speed_mps", counts.speed_mps, Estimate(one.mean("speed_mps"))),
        ("changes_per_vehicle", counts.all_changes_per_vehicle, one.every),
        ("changes_per_veh_km", counts.changes_per_veh_km, one.per_veh_km),
        ("rank_correlation", None, Estimate(one.rank)),
        ("missed_exits", None, Estimate(one.mean("missed_exits"))),
    ]
    names = [f"changes_per_vehicle_from_lane_{n}" for n in range(1, road.lanes + 1)]
    names.append("changes_per_vehicle_from_ramp")
    rows += [(name, theirs, ours) for name, (_, theirs), ours in zip(names, counts.weighed, one.each, strict=False)]
    for name, theirs, ours in rows:
        yield counts.name, one.rule, one.variant, name, theirs, *ours, len(one.runs)
