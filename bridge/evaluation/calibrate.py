"""`hid2 calibrate`: recorded scenes to drivers.toml, with a table and a figure for each quantity."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from bridge.batch.engine import sorted_out, work_on_each
from bridge.evaluation.evaluate import write_table
from bridge.files import write_text
from bridge.pages.parts import Section, macro, page
from bridge.pictures import figures
from bridge.recordings.scenario import read_scenario, source_id
from bridge.recordings.sources import find_sources
from hid2.agents import FloatArray, IntArray
from hid2.evaluation.calibration import Extra, Quantity, calibrate, drivers_of
from hid2.evaluation.safety import Safety, safety
from hid2.evaluation.windows import Windows, windows
from hid2.measures.arrays import BoolArray, SceneArrays, stack
from hid2.measures.lane_matching import flatten_lanes
from hid2.measures.manoeuvres import ManeuverKind, detect
from hid2.params import Drivers
from netconvert.errors import ConfigError, ScenarioError

#: Speed below which a vehicle stands, m/s, and gap to a leader in a queue, m.
_STANDS_MPS, _QUEUE_M = 0.3, 8.0
_CHUNK = 20
_TEMPLATE = "calibration.html.j2"


class SceneDriving(NamedTuple):
    """What calibration keeps of a scene: drivers are numbered within it."""

    name: str
    city: str
    labelled: bool
    seen: Windows
    extra: Extra

    def rows(self, chosen: BoolArray) -> "SceneDriving":
        """Some of the windows."""
        usual_mps = self.extra.usual_mps[chosen]
        return self._replace(seen=self.seen.rows(chosen), extra=self.extra._replace(usual_mps=usual_mps))


class Calibration(NamedTuple):
    """Quantities by group ("all", "city ...", "lane ...", "recordings ..."), scenes read, and those that failed."""

    groups: dict[str, list[Quantity]]
    scenes: list[SceneDriving]
    failures: list[tuple[Path, str]]


def calibrate_folder(
    roots: Sequence[Path], out: Path, *, without: Sequence[str] = (), jobs: int = 1,
    on_scene: Callable[[int, int], None] | None = None,
) -> Calibration:  # fmt: skip
    """Measure how people drive in the recorded scenes below some folders, and write what was found.

    Writes `out` (TOML, the section [drivers] of a configuration) and, beside it, STEM.csv (quantities) and STEM.html
    (the same with figures). without: ids of scenes to leave out, such as those to be generated from.
    Scenes that hid2 wrote are passed over. Errors: ConfigError where no scene is left, ScenarioError where none can be
    read; ExportError where something cannot be written.
    """
    found = [address for address in find_sources(roots) if isinstance(address, Path)]
    root = ", ".join(map(str, roots))
    there = {source_id(folder): folder for folder in found}
    if not there:
        raise ConfigError(f"{root}: no Argoverse 2 scene, which calibration reads; expected scenario_<id>.parquet")
    unknown = sorted(set(without) - there.keys())
    if unknown:
        raise ConfigError(f"--without {unknown[0]}: no such scene in {root}, expected the id of one, as {min(there)}")
    folders = [folder for name, folder in there.items() if name not in without]
    if not folders:
        raise ConfigError(f"{root}: --without leaves no scene to calibrate with, expected at least one")
    scenes, failures = sorted_out(
        work_on_each(observe_scene, folders, shared=None, jobs=jobs, chunk=_CHUNK, timeout_s=120, on_item=on_scene)
    )
    if not scenes:
        raise ScenarioError(f"{root}: no scene can be read; the first: {failures[0][0]}: {failures[0][1]}")
    scenes.sort(key=lambda scene: scene.name)
    prior = Drivers()
    groups = {name: calibrate(*pooled(part), prior=prior) for name, part in _groups(scenes)}
    result = Calibration(groups, scenes, failures)
    rows = quantity_rows(result.groups)
    write_table(out.with_name(f"{out.stem}.csv"), rows)
    write_text(out.with_name(f"{out.stem}.html"), _page(result, rows))
    write_text(out, drivers_toml(result.groups["all"], prior, result.scenes))
    return result


def observe_scene(_shared: None, folder: Path) -> SceneDriving:
    """What one recorded scene shows of driving: clean tracks of moving vehicles. Errors: ScenarioError, MapError."""
    scenario = read_scenario(folder)
    arrays = stack(scenario.tracks, num_steps=scenario.num_steps, step_s=scenario.step_s)
    safe = safety(arrays, flatten_lanes(scenario.graph))
    clean = arrays.clean & ~arrays.generated
    seen = windows(arrays, safe, clean)
    done = detect(arrays, safe.lanes, safe.matches)
    durations = [one.duration_s for one in done if one.kind is ManeuverKind.LANE_CHANGE and one.complete]
    return SceneDriving(
        name=scenario.scenario_id,
        city=scenario.city,
        labelled=scenario.provenance == "human",
        seen=seen,
        extra=Extra(
            _usual_speed(seen.agent, seen.speed_mps, seen.turning),
            _standing_gaps(arrays, safe, clean),
            np.array(durations, dtype=np.float64),
        ),
    )


def _usual_speed(driver: IntArray, speed: FloatArray, turning: BoolArray) -> FloatArray:
    """(M,) median over the drivers of the scene, apart for turns, of the median speed of each: its traffic's."""
    usual = np.ones(len(speed))
    for kind in (False, True):
        own = turning == kind
        medians = [np.median(speed[own & (driver == one)]) for one in np.unique(driver[own])]
        if medians:
            usual[own] = max(float(np.median(medians)), 1.0)
    return usual


def _standing_gaps(arrays: SceneArrays, safe: Safety, clean: BoolArray) -> FloatArray:
    """(D,) gap, m, that each clean vehicle kept while it and the vehicle ahead stood."""
    speed = np.hypot(arrays.velocity[:, 0], arrays.velocity[:, 1])
    leader = safe.leaders.agent
    rows = np.flatnonzero((leader >= 0) & clean[arrays.agent] & (speed < _STANDS_MPS))
    ahead = arrays.row_of[leader[rows], arrays.step[rows]]
    gap = safe.leaders.gap_m[rows]
    rows = rows[(ahead >= 0) & (speed[ahead] < _STANDS_MPS) & (gap > 0.0) & (gap < _QUEUE_M)]
    return np.array(
        [np.median(safe.leaders.gap_m[rows[arrays.agent[rows] == one]]) for one in np.unique(arrays.agent[rows])]
    )


def _groups(scenes: Sequence[SceneDriving]) -> Iterator[tuple[str, list[SceneDriving]]]:
    yield "all", list(scenes)
    for city in sorted({scene.city for scene in scenes}):
        yield f"city {city}", [scene for scene in scenes if scene.city == city]
    for kind in sorted({scene.labelled for scene in scenes}):
        yield f"recordings {('tracker', 'labelled')[kind]}", [scene for scene in scenes if scene.labelled is kind]
    for name, turning in (("straight", False), ("turning", True)):
        yield f"lane {name}", [scene.rows(scene.seen.turning == turning) for scene in scenes]


def pooled(scenes: Sequence[SceneDriving]) -> tuple[Windows, Extra]:
    """Windows and extras of several scenes; drivers get numbers of their own."""
    parts, before = [], 0
    for scene in scenes:
        parts.append(scene.seen._replace(agent=scene.seen.agent + before))
        before += int(scene.seen.agent.max(initial=-1)) + 1
    seen = Windows(*(np.concatenate(values) for values in zip(*parts, strict=True)))
    extra = Extra(*(np.concatenate(values) for values in zip(*(scene.extra for scene in scenes), strict=True)))
    return seen, extra


def drivers_toml(found: Sequence[Quantity], prior: Drivers, scenes: Sequence[SceneDriving]) -> str:
    """The section [drivers] of a configuration: what was measured, and as comments what keeps its prior."""
    measured, by_name = drivers_of(found), {quantity.name: quantity for quantity in found}
    lines = [
        f"# Measured by hid2 calibrate in {len(scenes)} scenes: {', '.join(scene.name for scene in scenes[:20])}"
        + (" and others" if len(scenes) > 20 else ""),
        "",
        "[drivers]",
    ]
    for name in Drivers.model_fields:
        one = by_name.get(name)
        if one is not None and name in measured:
            lines.append(f"{name} = {json.dumps(one.value)}  # {one.low:.3g} to {one.high:.3g}, {one.drivers} drivers")
        else:
            seen = f", {one.drivers} drivers are too few" if one is not None and one.drivers else ""
            lines.append(f"# {name} keeps its prior {getattr(prior, name)}{seen}")
    return "\n".join(lines) + "\n"


def quantity_rows(groups: Mapping[str, Sequence[Quantity]]) -> list[dict[str, Any]]:
    """A row for each parameter of each group."""
    return [
        {
            "group": group, "parameter": one.name, "value": one.value, "low": one.low, "high": one.high,
            "drivers": one.drivers, "source": "measured" if one.measured else "prior", "ks": one.ks, "what": one.what,
        }
        for group, found in groups.items()
        for one in found
    ]  # fmt: skip


def _page(result: Calibration, rows: Sequence[Mapping[str, Any]]) -> str:
    figures.style()
    shown = {quantity.what: quantity for quantity in reversed(result.groups["all"]) if quantity.measured}
    drawn = [(quantity, figures.data_uri(_distribution(quantity))) for quantity in reversed(shown.values())]
    sections = [
        Section("quantities", "Quantities", macro(_TEMPLATE, "quantities", rows)),
        Section("figures", "Recorded and fitted distributions", macro(_TEMPLATE, "distributions", drawn)),
    ]
    return page("How people drive in these recordings", [macro(_TEMPLATE, "intro", len(result.scenes))], sections)


def _distribution(quantity: Quantity) -> Figure:
    figure, ax = plt.subplots(figsize=(5.2, 2.8), layout="constrained")
    ordered = np.sort(quantity.values)
    ax.step(ordered, (np.arange(len(ordered)) + 1) / len(ordered), where="post", color=figures.DARK_GREY,
            label="recorded drivers")  # fmt: skip
    if quantity.law is not None:
        share = np.linspace(0.01, 0.99, 99)
        ax.plot(quantity.law(share), share, color=figures.GENERATED, linestyle="--", label="fitted")
    ax.set(xlabel=quantity.what, ylabel="share of drivers below")
    ax.legend(fontsize=8)
    return figure
