"""A page of public roads: published figures of lane changes beside each rule's, untuned, tuned and with causes.

A page is a TOML file (data/public/ngsim.toml; README.md in this folder): roads, published figures and rules. A rule is
tuned on the roads with `tune = true` alone; every other road is a test. Runs are resumed like a batch's.
"""

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
from pydantic import AfterValidator, Field
from scipy import stats

from bridge.batch.batch import OnRow, Options, SceneJob, run_batch
from bridge.batch.batch import Run as BatchRun
from bridge.batch.manifest import DONE, ManifestRow
from bridge.config import config_sha256
from bridge.files import one_line, write_rows, write_text
from bridge.pages.parts import text
from bridge.recordings.road import Road, RoadPart, read_road, write_road
from bridge.studies.gap_acceptance import troutbeck
from bridge.studies.road_traffic import CELL_M, CELL_S
from bridge.studies.run import RunsReport
from bridge.studies.statistics import LONG_GAP_S, estimates
from bridge.studies.study import Value, check_different, configured, grid, read_run
from bridge.toml import read_toml_as
from hid2.agents import FloatArray
from hid2.params import Config
from hid2.resampling import Estimate, ratio
from netconvert.errors import ConfigError

#: What drives a road.
WORK = "bridge.studies.road_traffic:measure_roads"
#: What a road has to reproduce before lane changes are looked at: shares of flow and speed that it may be off.
WITHIN = {"flow_veh_per_h": 0.03, "speed_mps": 0.10}
#: Of gaps that those of the ramp accept: shares (Bham 2008) from, below, s.
SIDES, SHARES = ("lag", "lead"), {"below_0.5_s": (0.0, 0.5), "from_0.5_to_1.7_s": (0.5, 1.7)}
_CELL = ["own", "there", "changes", "km"]
#: What may be published of a road, beside changes per vehicle of start lanes and from the ramp.
MEASURES = (
    *WITHIN, "changes_per_vehicle", "changes_per_veh_km", "duration_mean_s", "duration_sd_s", "duration_median_s",
    *(f"critical_{side}_gap_{what}_s" for side in SIDES for what in ("mean", "sd")),
    *(f"accepted_{side}_gaps_{name}" for side in SIDES for name in SHARES),
)  # fmt: skip
Changes = Mapping[str, Value]
_Named = Annotated[Path, AfterValidator(lambda path, info: info.context / path)]


class Counts(RoadPart):
    """What was published of a road, by measure. vehicles: by start lane from the left, the ramp last, for the error.

    start_to_end: vehicles by start and end lane, the ramps last; tendency: how changes go with densities, as published.
    """

    name: str
    published: dict[str, Annotated[float, Field(ge=0)]] = Field(default={})
    vehicles: list[float] = Field(default=[])
    start_to_end: list[list[float]] = Field(default=[])
    tendency: str = ""


class RoadSite(RoadPart):
    """A road and what was published of it, as files; set: configuration of this road alone."""

    file: _Named
    counts: _Named | None = None
    tune: bool = False
    why: str = ""
    set: dict[str, Value] = Field(default={})

    @cached_property
    def road(self) -> Road:
        """The road. Errors: ConfigError."""
        return read_road(self.file)

    @cached_property
    def told(self) -> Counts:
        """What was published. Errors: ConfigError."""
        return read_toml_as(Counts, self.counts, "published counts") if self.counts else Counts(name=self.file.stem)


class PageRule(RoadPart):
    """A rule; vary: values that tuning chooses from."""

    name: str
    set: dict[str, Value] = Field(default={})
    vary: dict[str, Annotated[list[Value], Field(min_length=1)]] = Field(default={})


class PublicRoads(RoadPart):
    """A page. cause: by what it says, what it sets on every road.

    densities: borders of a ladder, veh/km of a lane; slopes_below: up to which of both lanes a slope is told;
    not_shown: of these roads and counts, beside what no page shows.
    """

    title: str
    seeds: int = Field(default=3, ge=1, le=1000)
    config: dict[str, Any] = Field(default={})
    road: Annotated[list[RoadSite], Field(min_length=1)]
    rule: Annotated[list[PageRule], Field(min_length=1)]
    cause: dict[str, Changes] = Field(default={})
    densities: list[float] = Field(default=[])
    not_shown: list[str] = Field(default=[])
    slopes_below: float = Field(default=np.inf, gt=0)

    def configs(self, site: RoadSite, rule: PageRule, changes: Changes, source: str = "a page") -> Iterator[Config]:
        """The configurations of the runs, one for each seed. Errors: ConfigError."""
        for seed in range(self.seeds):
            own = {"request.agents": 0, **site.set, **rule.set, **changes, "request.seed": seed}
            yield configured(self.config, own, source=source)


def read_public(path: Path) -> PublicRoads:
    """Read a page and the files that it names, relative to it. Errors: ConfigError with file, key, value."""
    page = read_toml_as(PublicRoads, path, "a page of public roads")
    check_different([rule.name for rule in page.rule], f"{path}: rule.name", "expected another name for each rule")
    for site in page.road:
        counts, lanes = site.told, site.road.from_lanes
        known = (*MEASURES, *lanes)
        if unknown := counts.published.keys() - known:
            raise ConfigError(f"{site.counts}: unknown key 'published.{min(unknown)}'; expected {', '.join(known)}")
        rows, lengths = counts.start_to_end, {len(row) for row in counts.start_to_end}
        if rows and (len(rows) != len(lanes) or lengths not in ({site.road.lanes}, {site.road.lanes + 1})):
            said = f"a row for each of {', '.join(lanes)}, all of a value for each lane and the ramps or for each lane"
            raise ConfigError(f"{site.counts}: start_to_end: {len(rows)} rows, expected {said}")
        if site.tune and not (len(counts.vehicles) == len(lanes) and counts.published.keys() >= {*lanes}):
            said = f"vehicles: {len(counts.vehicles)} values on a road to tune on, expected one for each of"
            raise ConfigError(f"{site.counts}: {said} {', '.join(lanes)}, which have to be published")
        if site.tune and site.road.asked:
            raise ConfigError(
                f"{path}: tune = true with {site.file}, on which no traffic enters by itself; expected one "
                "with period.veh_per_h above 0, or no tune"
            )
    if any(rule.vary for rule in page.rule) and not any(site.tune for site in page.road):
        raise ConfigError(f"{path}: rule.vary, and no road with tune = true; expected one to tune on")
    if page.densities != sorted(set(page.densities)) or len(page.densities) == 1:
        raise ConfigError(f"{path}: densities = {page.densities}, expected borders that rise, two or more")
    for site, rule in itertools.product(page.road, page.rule):  # all that is wrong is said before anything is driven
        for changes in [{}, *grid(rule.vary), *page.cause.values()]:
            next(page.configs(site, rule, changes, str(path)))
    return page


@dataclass(frozen=True)
class RoadResult:
    """What came of a rule on a road over its seeds. changes: of the configuration, beside the rule's own."""

    site: RoadSite
    rule: str
    variant: str
    changes: Changes
    runs: list[Mapping[str, Any]]

    @cached_property
    def measures(self) -> dict[str, Estimate]:
        """By name, with intervals over seeds; that of a critical gap is of the likelihood, over vehicles."""
        if self.site.road.asked:
            changes = self._every("lane_changes", ["duration_s", "complete"])
            seconds = changes.loc[changes["complete"] == 1.0, ["duration_s", "run"]]

            def moments(weights: FloatArray) -> FloatArray:
                every = np.repeat(seconds["duration_s"].to_numpy(), weights.astype(int))
                return np.array([every.mean(), every.std(), np.median(every)] if every.size else [np.nan] * 3)

            names = [name for name in MEASURES if name.startswith("duration")]
            return dict(zip(names, estimates(seconds, moments, unit=["run"]), strict=True))
        road, published = self.site.road, self.site.told.published
        found = {
            name: ratio(*np.array([run["ratios"][name] for run in self.runs], dtype=np.float64).T)
            for name in self.runs[0]["ratios"]
        }
        lanes = [name for name in road.from_lanes[: road.lanes] if name in published]
        ours, theirs = [found[name].value or 0.0 for name in lanes], [published[name] for name in lanes]
        if min(len(set(ours)), len(set(theirs))) > 1:
            found["rank_correlation"] = Estimate(float(stats.spearmanr(ours, theirs).statistic))
        for side in SIDES if any("gap" in name for name in published) else ():
            gaps = self._every(side, ["rejected_s", "taken_s"]).fillna({"taken_s": np.inf})
            runs, taken_s = gaps.loc[gaps["taken_s"] < LONG_GAP_S, ["run", "taken_s"]].to_numpy().T
            for name, (low, high) in SHARES.items():
                among = pd.Series(taken_s).between(low, high, inclusive="left").groupby(runs).agg(["sum", "count"])
                found[f"accepted_{side}_gaps_{name}"] = ratio(*among.to_numpy(np.float64).T)
            told = troutbeck(*gaps[["rejected_s", "taken_s"]].to_numpy().T)
            found |= {f"critical_{side}_gap_{what}_s": one for what, one in zip(("mean", "sd"), told, strict=True)}
        return found

    def off(self, name: str) -> float | None:
        """How far a measure is from that published, as a share; None where one of them is not told."""
        ours, theirs = self.measures.get(name, Estimate(None)).value, self.site.told.published.get(name)
        return None if ours is None or not theirs else ours / theirs - 1.0

    @property
    def reproduces(self) -> bool | None:
        """Whether the road has its flow and speed; None where neither is known."""
        known = [abs(off) <= most for name, most in WITHIN.items() if (off := self.off(name)) is not None]
        return all(known) if known else None

    @property
    def error(self) -> float:
        """Mean difference of changes per vehicle by start lane and from the ramp, weighed by published vehicles."""
        counts, lanes = self.site.told, self.site.road.from_lanes
        apart = [abs((self.measures[name].value or 0.0) - counts.published[name]) for name in lanes]
        return float(np.average(apart, weights=counts.vehicles))

    def _every(self, table: str, columns: list[str]) -> pd.DataFrame:
        """The rows of every run, with its number."""
        each = (pd.DataFrame(run[table], columns=columns, dtype=float) for run in self.runs)
        return pd.concat([rows.assign(run=number) for number, rows in enumerate(each)], ignore_index=True)

    def ladder(self, borders: Sequence[float]) -> list[list[Estimate]]:
        """Changes per veh-km on the lane of origin, by its density (rows) and by that of the target lane."""
        cells, count = self._every("cells", _CELL), len(borders) - 1
        steps = [pd.cut(cells[name], borders, right=False, labels=False) for name in ("own", "there")]
        whole = pd.MultiIndex.from_product([range(count), range(count), range(len(self.runs))])
        sums = cells.groupby([*steps, "run"])[["changes", "km"]].sum().reindex(whole, fill_value=0.0).to_numpy()
        return [[ratio(*one.T) for one in row] for row in sums.reshape(count, count, len(self.runs), 2)]

    def slopes(self, critical: float) -> list[Estimate]:
        """Of changes per veh-km by the density of origin and target lane, both below critical, veh/km.

        By least squares in which a cell weighs as the veh-km driven in it; with intervals over seeds.
        """
        cells = self._every("cells", _CELL).query("own < @critical and there < @critical and km > 0")
        design = cells[["own", "there"]].assign(level=1.0).to_numpy()

        def solved(weights: FloatArray) -> FloatArray:
            root = np.sqrt(weights * cells["km"].to_numpy())
            rate = cells["changes"].to_numpy() / cells["km"].to_numpy()
            return np.asarray(np.linalg.lstsq(design * root[:, None], rate * root, rcond=None)[0][:2])

        return estimates(cells, solved, unit=["run"])


def run_public(page: PublicRoads, out_dir: Path, options: Options, *, on_row: OnRow | None = None) -> RunsReport:
    """Tune each rule, test it, try the causes, and write the page. Errors: BatchError, ConfigError, ExportError."""
    names = {next(page.configs(page.road[0], rule, {})).lane_change.rule for rule in page.rule}  # the user's own file
    contents = f"page of public roads: {one_line(page.title, most=200)}"
    how = replace(options, function=WORK, functions=names, resume=True, contents=contents)
    run_batch([], out_dir, how)  # refuses the folder of another page before a road is written
    folders = {site.file: write_road(out_dir / "roads", site.file) for site in page.road}
    rows: dict[tuple[str, str], ManifestRow] = {}

    def driven(asked: Iterable[tuple[RoadSite, PageRule, str, Changes]]) -> list[RoadResult]:
        wanted: list[tuple[RoadResult, list[tuple[str, str]]]] = []
        jobs: dict[tuple[str, str], SceneJob] = {}
        for site, rule, variant, changes in asked:
            folder = folders[site.file]
            runs = {(folder.name, config_sha256(one)): one for one in page.configs(site, rule, changes)}
            jobs |= {key: SceneJob(folder, (BatchRun(one),)) for key, one in runs.items() if key not in rows}
            wanted.append((RoadResult(site, rule.name, variant, changes, []), list(runs)))
        found = run_batch(list(jobs.values()), out_dir, how, on_row=on_row)
        rows.update({(row.scenario, row.config_sha256): row for row in found})
        for result, keys in wanted:
            tables = ("lane_changes",) if result.site.road.asked else ("ratios", "cells", "start_to_end", *SIDES)
            own = [out_dir / rows[key].folder for key in keys if rows[key].status == DONE]
            result.runs.extend(read_run(folder, tables, "page of public roads") for folder in own)
        return [result for result, _ in wanted if result.runs]

    pairs = list(itertools.product(page.road, page.rule))
    tuned = [(site, rule, enumerate([{}, *grid(rule.vary)])) for site, rule in pairs if site.tune and rule.vary]
    tried = driven((site, rule, f"point {k}", changes) for site, rule, points in tuned for k, changes in points)
    best = {rule.name: _best([one for one in tried if one.rule == rule.name]) for rule in page.rule}
    tests = driven(
        (site, rule, variant, changes)
        for site, rule in pairs
        for variant, changes in ({"untuned": {}, "tuned": best[rule.name]} if rule.vary else {"as set": {}}).items()
    )
    every = itertools.product(pairs, page.cause.items())
    causes = driven((site, rule, says, {**best[rule.name], **more}) for (site, rule), (says, more) in every)
    table, told = out_dir / "public.csv", out_dir / "public.md"
    head = ("road", "rule", "variant", "measure", "published", "ours", "low", "high", "runs")
    write_rows(table, head, [
        (one.site.told.name, one.rule, one.variant, name, one.site.told.published.get(name), *ours, len(one.runs))
        for one in [*tests, *causes] for name, ours in one.measures.items()
    ])  # fmt: skip
    both = [
        (one, other)
        for one, other in itertools.product(causes, tests)
        if (one.site, one.rule) == (other.site, other.rule) and other.variant != "untuned"
    ]
    values: dict[str, object] = {"tried": tried, "best": best, "tests": tests, "causes": both, "within": WITHIN}
    write_text(told, text("public.md.j2", page=page, cell_m=CELL_M, cell_s=CELL_S, long_gap_s=LONG_GAP_S, **values))
    return RunsReport.of((told, table), rows.values())


def _best(tried: Sequence[RoadResult]) -> Changes:
    """The changes with the least error over the tuned roads, of those with which the roads have flow and speed.

    One without a result on every road comes last.
    """

    def order(one: RoadResult) -> tuple[int, bool, float]:
        same = [other for other in tried if other.variant == one.variant]
        return -len(same), not all(other.reproduces for other in same), sum(other.error for other in same)

    return min(tried, key=order).changes if tried else {}
