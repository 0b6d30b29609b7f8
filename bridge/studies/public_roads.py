"""A page of public roads: published figures of lane changes beside each rule's, untuned, tuned and with causes.

A page is a TOML file (data/public/ngsim.toml; README.md in this folder): roads, published figures and rules. A rule is
tuned on the roads with `tune = true` alone; every other road is a test. Runs are resumed like a batch's.
"""

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
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
from bridge.studies.gap_acceptance import troutbeck
from bridge.studies.road_traffic import CELL_M, CELL_S
from bridge.studies.run import RunsReport
from bridge.studies.statistics import LONG_GAP_S
from bridge.studies.study import Value, configured, grid, read_run
from hid2.agents import FloatArray
from hid2.params import Config
from hid2.resampling import Estimate, interval, ratio, redrawn
from netconvert.errors import ConfigError

#: What drives a road, and one on which lane changes are asked for and laid across.
WORK, WORK_ASKED = "bridge.studies.study_work:measure_roads", "bridge.studies.study_work:measure_runs"
#: What a road has to reproduce before lane changes are looked at: shares of flow and speed that it may be off.
WITHIN = {"flow_veh_per_h": 0.03, "speed_mps": 0.10}
#: Of gaps that those of the ramp accept: a critical gap, from so many at least, and shares (Bham 2008) from, below, s.
SIDES, FEWEST_GAPS = ("lag", "lead"), 8
SHARES = {"below_0.5_s": (0.0, 0.5), "from_0.5_to_1.7_s": (0.5, 1.7)}
#: What may be published of a road, beside changes per vehicle of start lanes and from the ramp.
MEASURES = (
    *WITHIN, "changes_per_vehicle", "changes_per_veh_km", "duration_mean_s", "duration_sd_s", "duration_median_s",
    *(f"critical_{side}_gap_{what}_s" for side in SIDES for what in ("mean", "sd")),
    *(f"accepted_{side}_gaps_{name}" for side in SIDES for name in SHARES),
)  # fmt: skip
_Changes = dict[str, Value]


class Counts(RoadPart):
    """What was published of a road, by measure. vehicles: by start lane from the left, the ramp last, for the error.

    start_to_end: vehicles by start and end lane, the ramps last.
    """

    name: str
    published: dict[str, Annotated[float, Field(ge=0)]] = Field(default={})
    vehicles: list[float] = Field(default=[])
    start_to_end: list[list[float]] = Field(default=[])


class _RoadEntry(RoadPart):
    file: str
    counts: str = ""
    tune: bool = False
    asked: bool = False
    why: str = ""
    set: _Changes = Field(default={})


class _PageRule(RoadPart):
    name: str
    set: _Changes = Field(default={})
    vary: dict[str, Annotated[list[Value], Field(min_length=1)]] = Field(default={})

    @property
    def points(self) -> list[_Changes]:
        """What tuning chooses from: nothing changed, and every combination."""
        return [{}, *grid(self.vary)] if self.vary else [{}]

    @property
    def last(self) -> str:
        """The variant that counts."""
        return "tuned" if self.vary else "as set"


class _Cause(RoadPart):
    says: str
    set: Annotated[_Changes, Field(min_length=1)]


class _Densities(RoadPart):
    """Borders of a ladder of densities, veh/km of a lane, and up to which of both lanes a slope is told."""

    borders: Annotated[list[float], Field(min_length=2)]
    critical: float = Field(gt=0)


class _PageFile(RoadPart):
    """The TOML file as it is."""

    title: str
    seeds: int = Field(default=3, ge=1, le=1000)
    tuning_seeds: int = Field(default=1, ge=1, le=1000)
    cause_seeds: int = Field(default=1, ge=1, le=1000)
    config: dict[str, Any] = Field(default={})
    road: Annotated[list[_RoadEntry], Field(min_length=1)]
    rule: Annotated[list[_PageRule], Field(min_length=1)]
    cause: list[_Cause] = Field(default=[])
    densities: _Densities | None = None


class Site(NamedTuple):
    """A road with what was published of it. entry: what the page says of it."""

    road_file: Path
    road: Road
    counts: Counts
    entry: _RoadEntry


@dataclass(frozen=True, slots=True)
class PublicRoads:
    """A page, resolved."""

    source: Path
    file: _PageFile
    sites: tuple[Site, ...]

    def config(self, site: Site, rule: _PageRule, changes: Mapping[str, Value], seed: int) -> Config:
        """The configuration of a run. Errors: ConfigError."""
        own = {"request.agents": 0, **site.entry.set, **rule.set, **changes, "request.seed": seed}
        return configured(self.file.config, own, source=str(self.source))


def read_public(path: Path) -> PublicRoads:
    """Read a page and the files that it names, relative to it. Errors: ConfigError with file, key, value."""
    file = read_toml_as(_PageFile, path, "a page of public roads")
    sites = []
    for entry in file.road:
        road_file, counts_file = path.parent / entry.file, path.parent / entry.counts
        road, counts = read_road(road_file), Counts(name=road_file.stem)
        if entry.counts:
            counts = read_toml_as(Counts, counts_file, "published counts")
        known = (*MEASURES, *road.from_lanes)
        if unknown := counts.published.keys() - known:
            raise ConfigError(f"{counts_file}: unknown key 'published.{min(unknown)}'; expected {', '.join(known)}")
        there = len(counts.vehicles) == len(road.from_lanes) and counts.published.keys() >= {*road.from_lanes}
        if entry.tune and not there:
            said = f"vehicles: {len(counts.vehicles)} values on a road to tune on, expected one for each of"
            raise ConfigError(f"{counts_file}: {said} {', '.join(road.from_lanes)}, which have to be published")
        sites.append(Site(road_file, road, counts, entry))
    if any(rule.vary for rule in file.rule) and not any(site.entry.tune for site in sites):
        raise ConfigError(f"{path}: rule.vary, and no road with tune = true; expected one to tune on")
    page = PublicRoads(path, file, tuple(sites))
    for site, rule in itertools.product(sites, file.rule):  # all that is wrong is said before anything is driven
        for changes in [*rule.points, *(cause.set for cause in file.cause)]:
            page.config(site, rule, changes, 0)
    return page


@dataclass(frozen=True)
class RoadResult:
    """What came of a rule on a road over its seeds. changes: of the configuration, beside the rule's own."""

    site: Site
    rule: str
    variant: str
    changes: Mapping[str, Value]
    runs: Sequence[Mapping[str, Any]]

    @cached_property
    def measures(self) -> dict[str, Estimate]:
        """By name, with intervals over seeds; that of a critical gap is of the likelihood, over vehicles."""
        if self.site.entry.asked:
            return _durations(self.runs)
        found = {
            name: ratio(*np.array([run["ratios"][name] for run in self.runs], dtype=np.float64).T)
            for name in self.runs[0]["ratios"]
        }
        lanes = [name for name in self.site.road.from_lanes[: self.site.road.lanes] if name in self.published]
        ours = [found[name].value or 0.0 for name in lanes]
        theirs = [self.published[name] for name in lanes]
        if min(len(set(ours)), len(set(theirs))) > 1:
            found["rank_correlation"] = Estimate(float(stats.spearmanr(ours, theirs).statistic))
        for side in SIDES if any("gap" in name for name in self.published) else ():
            gaps = [np.array([one for one in run[side] if one[1] < LONG_GAP_S]).reshape(-1, 2) for run in self.runs]
            for name, (low, high) in SHARES.items():
                among = np.array([((low <= one[:, 1]) & (one[:, 1] < high)).sum() for one in gaps], dtype=np.float64)
                found[f"accepted_{side}_gaps_{name}"] = ratio(among, np.array([len(one) for one in gaps], dtype=float))
            every = np.concatenate(gaps)
            told = troutbeck(*every.T) if len(every) >= FEWEST_GAPS else (Estimate(None), Estimate(None))
            found |= {f"critical_{side}_gap_{what}_s": one for what, one in zip(("mean", "sd"), told, strict=True)}
        return found

    @property
    def published(self) -> dict[str, float]:
        """What was published of the road, by measure."""
        return self.site.counts.published

    def off(self, name: str) -> float | None:
        """How far a measure is from that published, as a share; None where one of them is not told."""
        ours, theirs = self.measures[name].value if name in self.measures else None, self.published.get(name)
        return None if ours is None or not theirs else ours / theirs - 1.0

    def first(self, runs: int) -> "RoadResult":
        """The same of the first runs alone."""
        return replace(self, runs=self.runs[:runs])

    @property
    def reproduces(self) -> bool:
        """Whether the road has its flow and speed."""
        return all(abs(self.off(name) or 0.0) <= most for name, most in WITHIN.items())

    @property
    def error(self) -> float:
        """Mean difference of changes per vehicle by start lane and from the ramp, weighed by published vehicles."""
        apart = [abs((self.measures[name].value or 0.0) - self.published[name]) for name in self.site.road.from_lanes]
        return float(np.average(apart, weights=self.site.counts.vehicles))

    @property
    def end_shares(self) -> list[list[float]]:
        """Shares of each start lane that end in each lane."""
        table = np.sum([run["start_to_end"] for run in self.runs], axis=0, dtype=np.float64)
        return (table / np.maximum(table.sum(axis=1, keepdims=True), 1.0)).tolist()  # type: ignore[no-any-return]

    @property
    def _cells(self) -> list[FloatArray]:
        return [np.array(run["cells"], dtype=np.float64).reshape(-1, 4) for run in self.runs]

    def ladder(self, borders: Sequence[float]) -> list[list[Estimate]]:
        """Changes per veh-km on the lane of origin, by its density (rows) and by that of the target lane."""
        count = len(borders) - 1
        sums = np.zeros((2, count, count, len(self._cells)))
        for number, cells in enumerate(self._cells):
            steps = np.digitize(cells[:, :2], borders) - 1
            inside = ((steps >= 0) & (steps < count)).all(axis=1)
            np.add.at(sums[..., number], (slice(None), *steps[inside].T), cells[inside, 2:].T)
        return [[ratio(*sums[:, own, there]) for there in range(count)] for own in range(count)]

    def slopes(self, critical: float) -> list[Estimate]:
        """Of changes per veh-km by the density of origin and target lane, both below critical, veh/km.

        By least squares in which a cell weighs as the veh-km driven in it; with intervals over seeds.
        """
        left, right = [], []
        for cells in self._cells:
            own, there, changes, km = cells[(cells[:, :2] < critical).all(axis=1) & (cells[:, 3] > 0.0)].T
            design = np.stack([np.ones_like(own), own, there])
            left.append(design * km @ design.T)
            right.append(design @ changes)

        def solved(weights: FloatArray) -> FloatArray:
            found = np.linalg.lstsq(np.tensordot(weights, left, 1), np.tensordot(weights, right, 1), rcond=None)[0]
            return np.asarray(found[1:], dtype=np.float64)

        return _redrawn(solved, len(left))


def _durations(runs: Sequence[Mapping[str, Any]]) -> dict[str, Estimate]:
    """Of all lane changes of which start and end were seen."""
    each = [[row["duration_s"] for row in run["lane_changes"] if row["complete"]] for run in runs]

    def told(weights: FloatArray) -> FloatArray:
        every = np.concatenate([one * int(times) for one, times in zip(each, weights, strict=True)])
        return np.array([every.mean(), every.std(), np.median(every)] if every.size else [np.nan] * 3)

    names = [name for name in MEASURES if name.startswith("duration")]
    return dict(zip(names, _redrawn(told, len(each)), strict=True))


def _redrawn(statistic: Callable[[FloatArray], FloatArray], runs: int) -> list[Estimate]:
    """Figures (K,) of how often each run counts, with intervals where there are several runs."""
    whole = statistic(np.ones(runs))
    drawn = redrawn(statistic, runs) if runs > 1 else np.zeros((0, len(whole)))
    return [interval(float(one), drawn[:, number]) for number, one in enumerate(whole)]


_Asked = tuple[Site, _PageRule, str, Mapping[str, Value], int]


def run_public(
    page: PublicRoads,
    out_dir: Path,
    options: Options,
    *,
    on_row: Callable[[ManifestRow, Progress], None] | None = None,
) -> RunsReport:
    """Tune each rule, test it, try the causes, and write the page. Errors: BatchError, ConfigError, ExportError."""
    file, sites = page.file, page.sites
    names = {page.config(sites[0], rule, {}, 0).lane_change.rule for rule in file.rule}  # the user's own file
    folders = {site.road_file: write_road(out_dir / "roads", site.road_file) for site in sites}
    rows: dict[tuple[str, str], ManifestRow] = {}

    def driven(asked: Iterable[_Asked]) -> list[RoadResult]:
        wanted = [(one, [page.config(one[0], one[1], one[3], seed) for seed in range(one[4])]) for one in asked]
        for function, called in ((WORK, False), (WORK_ASKED, True)):
            jobs = {
                (folders[site.road_file].name, config_sha256(config)):
                SceneJob(folders[site.road_file], (BatchRun(config),))
                for (site, *_), configs in wanted for config in configs if site.entry.asked == called
            }  # fmt: skip
            how = replace(options, function=function, functions=names, resume=True)
            found = run_batch([job for key, job in jobs.items() if key not in rows], out_dir, how, on_row=on_row)
            rows.update({(row.scenario, row.config_sha256): row for row in found})
        results = []
        for (site, rule, variant, changes, _), configs in wanted:
            own = [rows[folders[site.road_file].name, config_sha256(config)] for config in configs]
            keys = ("lane_changes",) if site.entry.asked else ("ratios", "cells", "start_to_end", *SIDES)
            told = [read_run(out_dir / row.folder, keys, "page of public roads") for row in own if row.status == DONE]
            results += [RoadResult(site, rule.name, variant, changes, told)] if told else []
        return results

    pairs = list(itertools.product(sites, file.rule))
    tried = driven(
        (site, rule, f"point {number}", changes, file.tuning_seeds)
        for site, rule in pairs if site.entry.tune and rule.vary for number, changes in enumerate(rule.points)
    )  # fmt: skip
    best = {rule.name: _best([one for one in tried if one.rule == rule.name]) for rule in file.rule}
    tests = driven(
        (site, rule, variant, changes, file.seeds)
        for site, rule in pairs
        for variant, changes in (*([("untuned", {})] if rule.vary else []), (rule.last, best[rule.name]))
    )  # fmt: skip
    causes = driven(
        (site, rule, cause.says, {**best[rule.name], **cause.set}, file.cause_seeds)
        for site, rule in pairs for cause in file.cause
    )  # fmt: skip
    table, told = out_dir / "public.csv", out_dir / "public.md"
    head = ("road", "rule", "variant", "measure", "published", "ours", "low", "high", "runs")
    write_rows(table, head, [
        (one.site.counts.name, one.rule, one.variant, name, one.published.get(name), *ours, len(one.runs))
        for one in [*tests, *causes] for name, ours in one.measures.items()
    ])  # fmt: skip
    values = {"page": page, "tried": tried, "best": best, "tests": tests, "causes": causes, "within": WITHIN}
    values |= {"cell_m": CELL_M, "cell_s": CELL_S, "long_gap_s": LONG_GAP_S}
    write_text(told, text("public.md.j2", **values))
    return RunsReport.of((told, table), rows.values())


def _best(tried: Sequence[RoadResult]) -> Mapping[str, Value]:
    """The changes with the least error over the tuned roads, of those with which the roads have flow and speed."""

    def order(one: RoadResult) -> tuple[bool, float]:
        same = [other for other in tried if other.variant == one.variant]
        return not all(other.reproduces for other in same), sum(other.error for other in same)

    return min(tried, key=order).changes if tried else {}
