"""The paper's experiments that need no training, from generation to the finished table beside the paper's figures.

table1: realism and safety with 10 vehicles added. ablation: without topology, collision checks, smoothing.
density: 0 to 40 vehicles added. diversity: scenes by number of agents and behaviour, before and after.
"""

import csv
import html
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

from bridge.batch.engine import Settings, Task, execute_here
from bridge.batch.isolation import Failure, describe_error
from bridge.batch.scan import Selection, facts_of, wanted
from bridge.evaluation import report
from bridge.evaluation.aggregate import SourceSums, estimate
from bridge.evaluation.diversity import Diversity
from bridge.evaluation.scene_metrics import Row, measure
from bridge.files import make_folder, table_file, write_text
from bridge.recordings.scenario import find_sources, read_scenario
from hid2.evaluation.metrics import METRICS, Metric
from hid2.evaluation.safety import prepare_map
from hid2.params import Config, Limits, Request
from netconvert.errors import ConfigError, ExportError

Experiment = Literal["table1", "ablation", "density", "diversity"]
EXPERIMENTS: tuple[Experiment, ...] = ("table1", "ablation", "density", "diversity")

#: LO, LA, JE, SCR, ORR: what the paper reports.
COLUMNS: tuple[Metric, ...] = tuple(metric for metric in METRICS if metric.key in report.PAPER_ORIGINAL)
#: Further columns that the paper does not have.
MORE_COLUMNS: tuple[Metric, ...] = tuple(metric for metric in METRICS if metric.key == "footprint_orr")
#: Numbers of vehicles added in the paper's density figure.
ADDED = (0, 5, 10, 20, 40)
#: The paper's ablation table: component switched off, LO, LA, JE, SCR, ORR.
PAPER_ABLATION: Mapping[str, Mapping[str, float]] = {
    "full": report.PAPER_HID2,
    "topology": {"lo": 1.491, "la": 0.483, "je": 7.842, "scr": 0.101, "orr": 0.225},
    "collision": {"lo": 1.449, "la": 0.433, "je": 7.087, "scr": 0.282, "orr": 0.125},
    "smoothing": {"lo": 2.379, "la": 1.188, "je": 9.156, "scr": 0.072, "orr": 0.141},
}
_NAMES = {"full": "with everything on", "dense": "with the default mix", "rare": "with a mix of rare behaviours"}
_NAMES |= {part: f"without {part}" for part in ("topology", "collision", "smoothing")}
_NAMES |= {str(number): f"where {number} were asked for" for number in ADDED}
#: The mix of the diversity experiment: the paper's underrepresented behaviours.
_RARE_MIX = {"straight": 0.2, "left_turn": 0.2, "right_turn": 0.2, "lane_change": 0.25, "overtake": 0.15}
#: The paper's templates have more tracks than this.
TEMPLATE_AGENTS = 40


class Setting(NamedTuple):
    """One row of an experiment: its name and the configuration that it runs (None: nothing is generated)."""

    name: str
    config: Config | None


@dataclass(frozen=True, slots=True)
class Outcome:
    """Scene rows of a setting, one per source scene and seed, and the scenes that failed with the reason."""

    setting: Setting
    rows: tuple[Row, ...]
    failures: tuple[str, ...]


def run_experiment(
    name: Experiment,
    *,
    scenes: Path | Sequence[Path],
    out_dir: Path,
    seeds: int = 10,
    jobs: int = 1,
    agents: int = 10,
    on_scene: Callable[[int, int], None] | None = None,
) -> Path:
    """Run one experiment of the paper on recorded scenes; returns the page that it wrote.

    Writes <name>.html, <name>.csv (the table), <name>_scenes.csv (one row per scene and seed) and <name>.json into
    out_dir. `agents`: vehicles added in table1, ablation and diversity. on_scene(done, total) is called as generated
    scenes are done. Errors: ConfigError for an unknown name, or where no scene has as many agents as
    diversity needs; ScenarioError where there is no scene; ExportError.
    """
    if name not in EXPERIMENTS:
        raise ConfigError(f"experiment {name!r}, expected one of {', '.join(EXPERIMENTS)}")
    if seeds < 1:
        raise ConfigError(f"seeds {seeds}, expected at least 1")
    places = [scenes] if isinstance(scenes, Path) else list(scenes)
    folders = find_sources(places)
    if name == "diversity":
        facts, unread = facts_of(folders, jobs=jobs)
        try:
            folders = wanted(folders, facts, unread, Selection(min_agents=TEMPLATE_AGENTS + 1))
        except ConfigError:
            raise ConfigError(
                f"{', '.join(map(str, places))}: no scene of more than {TEMPLATE_AGENTS} agents, which diversity needs "
                "as templates; give real ones by --scenes DIR"
            ) from None
    make_folder(out_dir)
    outcomes = _run(folders, _settings(name, agents), seeds=seeds, jobs=jobs, on_scene=on_scene)
    try:
        return _write(name, outcomes, out_dir, seeds=seeds, sources=len(folders), agents=agents)
    except OSError as error:
        raise ExportError(f"{out_dir}: cannot write the experiment ({error})") from error


def _settings(name: Experiment, agents: int) -> list[Setting]:
    base = Config(request=Request(agents=agents))
    if name == "ablation":
        parts: tuple[Literal["topology", "collision", "smoothing"], ...] = ("topology", "collision", "smoothing")
        return [Setting("full", base)] + [
            Setting(p, base.model_copy(update={"without": frozenset({p})})) for p in parts
        ]
    if name == "density":
        return [Setting(str(n), Config(request=Request(agents=n)) if n else None) for n in ADDED]
    if name == "diversity":
        rare = Config(request=Request.model_validate({"agents": agents, **_RARE_MIX}))
        return [Setting("recorded", None), Setting("dense", base), Setting("rare", rare)]
    return [Setting("hid2", base)]


def _run(
    folders: Sequence[Path],
    settings: Sequence[Setting],
    *,
    seeds: int,
    jobs: int,
    on_scene: Callable[[int, int], None] | None,
) -> list[Outcome]:
    """Generate and measure every setting on every scene with every seed, in isolated processes."""
    items = [(k, seed) for k, setting in enumerate(settings) for seed in range(seeds if setting.config else 1)]
    tasks = (
        Task(f"paper-{n}", "bridge.evaluation.paper:generate_and_measure", (folder, tuple(settings)), tuple(items))
        for n, folder in enumerate(folders)
    )
    rows: dict[tuple[int, int, int], Row] = {}
    failures: dict[int, list[str]] = {}
    done = 0
    for result in execute_here(tasks, jobs=min(jobs, len(folders)), settings=Settings(timeout_s=600)):
        scene = int(result.task.key.removeprefix("paper-"))
        for outcome in result.outcomes:
            done += 1
            setting, seed = outcome.item
            failure = outcome.failure or (outcome.value if isinstance(outcome.value, Failure) else None)
            if failure is not None:
                failures.setdefault(setting, []).append(f"{folders[scene].name[:8]}, seed {seed}: {failure.message}")
            else:
                rows[setting, scene, seed] = outcome.value
        if on_scene is not None:
            on_scene(done, len(items) * len(folders))
    return [
        Outcome(setting, tuple(rows[key] for key in sorted(rows) if key[0] == k), tuple(sorted(failures.get(k, []))))
        for k, setting in enumerate(settings)
    ]


def generate_and_measure(
    shared: tuple[Path, tuple[Setting, ...]], items: Sequence[tuple[int, int]]
) -> Iterator[Row | Failure]:
    """The work of a process: one scene row for each (setting, seed)."""
    from bridge.generation.generate import generate, prepare  # libsumo: only where scenes are made

    folder, settings = shared
    scenario = read_scenario(folder)
    ground = prepare_map(scenario.graph)
    prepared = prepare(scenario, next((s.config for s in settings if s.config), Config()))
    for number, seed in items:
        config = settings[number].config
        try:
            if config is None:
                tracks, sidecar = scenario.tracks, None
            else:
                request = config.request.model_copy(update={"seed": seed})
                scene = generate(prepared, config.model_copy(update={"request": request}))
                tracks, sidecar = (*scenario.tracks, *scene.generated), scene.sidecar
            measures = measure(
                tracks,
                ground,
                sidecar,
                limits=Limits(),
                num_steps=scenario.num_steps,
                source=scenario.scenario_id,
            )
        except Exception as error:  # noqa: BLE001  # listed with its reason
            yield describe_error(error)
        else:
            yield {"setting": settings[number].name, "city": scenario.city, "seed_run": seed} | measures.scene


# Tables


class _Line(NamedTuple):
    """A line of a table: who, then value and interval (or the paper's figure) by metric key."""

    label: str
    values: Mapping[str, Mapping[str, float | None]]


def _ours(label: str, rows: Sequence[Row], group: str) -> _Line:
    sums = SourceSums.of(rows)
    return _Line(label, {m.key: estimate(sums, m, group).as_dict() for m in (*COLUMNS, *MORE_COLUMNS)})


def _papers(label: str, figures: Mapping[str, float]) -> _Line:
    return _Line(label, {key: {"value": value, "low": None, "high": None} for key, value in figures.items()})


def _lines(name: Experiment, outcomes: Sequence[Outcome]) -> list[_Line]:
    if name == "table1":
        rows = outcomes[0].rows
        return [
            _papers("paper: Argoverse 2", report.PAPER_ORIGINAL),
            _ours("ours: recorded scenes", rows, "original"),
            _papers("paper: HiD2", report.PAPER_HID2),
            _ours("ours: recorded and generated", rows, "combined"),
            _ours("ours: generated vehicles alone", rows, "generated"),
        ]
    if name == "ablation":
        lines = []
        for outcome in outcomes:
            what = "everything on" if outcome.setting.name == "full" else f"without {outcome.setting.name}"
            lines += [
                _papers(f"paper: {what}", PAPER_ABLATION[outcome.setting.name]),
                _ours(f"ours: {what}, recorded and generated", outcome.rows, "combined"),
                _ours(f"ours: {what}, generated alone", outcome.rows, "generated"),
            ]
        return lines
    return [
        line
        for outcome in outcomes
        for line in (
            _ours(f"{outcome.setting.name} asked for: recorded and generated", outcome.rows, "combined"),
            _ours(f"{outcome.setting.name} asked for: generated alone", outcome.rows, "generated"),
        )
        if outcome.setting.config is not None or "alone" not in line.label
    ]


_TITLES: Mapping[str, str] = {
    "table1": "Table 1: realism and safety of recorded and generated traffic",
    "ablation": "Ablation: what each component is for",
    "density": "Effect of adding different numbers of vehicles",
    "diversity": "Diversity before and after",
}


def _write(
    name: Experiment, outcomes: Sequence[Outcome], out_dir: Path, *, seeds: int, sources: int, agents: int
) -> Path:
    from bridge.evaluation import charts
    from bridge.pictures import figures

    figures.style()
    all_rows = [row for outcome in outcomes for row in outcome.rows]
    _write_rows(all_rows, out_dir / f"{name}_scenes.csv")
    parts = [_about(name, outcomes, seeds=seeds, sources=sources, agents=agents)]
    content: dict[str, Any] = {"experiment": name, "seeds": seeds, "scenes": sources}
    if name == "diversity":
        before, after = outcomes[0].rows, [row for outcome in outcomes[1:] for row in outcome.rows]
        content |= Diversity.of(after, before).content()
        parts += report.diversity_parts(content)
        _write_rows(_diversity_rows(content), out_dir / f"{name}.csv")
        figures.save(charts.diversity_figure(content), out_dir / f"{name}.png")
    else:
        lines = _lines(name, outcomes)
        content["lines"] = [
            {"row": line.label, **{key: dict(value) for key, value in line.values.items()}} for line in lines
        ]
        parts.append(_html_table(lines))
        _write_rows([_flat(line) for line in lines], out_dir / f"{name}.csv")
        if name == "density":
            series = {int(o.setting.name): (SourceSums.of(o.rows), o.setting.config is not None) for o in outcomes}
            counted = _of(outcomes, sources)
            shown = charts.density_figure(_density(series), of=counted)
            parts.append(report.picture(shown, f"{_DENSITY_CAPTION} Of {counted}."))
            figures.save(charts.density_figure(_density(series), of=counted), out_dir / f"{name}.png")
    write_text(out_dir / f"{name}.json", json.dumps(content, indent=1, allow_nan=False) + "\n")
    path = out_dir / f"{name}.html"
    write_text(path, report.page(_TITLES[name], parts))
    return path


_DENSITY_CAPTION = (
    "Each panel: the measure against the number of vehicles asked for in each scene. Solid: recorded and "
    "generated together, "
    "with the 95 % interval over recorded scenes (few scenes, wide interval: it is the same scenes at every number, so "
    "that the slope is surer than the level); dashed: generated vehicles alone."
)


def _density(series: Mapping[int, tuple[SourceSums, bool]]) -> dict[str, dict[str, list[tuple[int, Any]]]]:
    """Estimates by metric and group along the numbers added."""
    return {
        metric.key: {
            group: [
                (added, estimate(sums, metric, group))
                for added, (sums, generates) in sorted(series.items())
                if generates or group == "combined"
            ]
            for group in ("combined", "generated")
        }
        for metric in COLUMNS
    }


def _about(name: Experiment, outcomes: Sequence[Outcome], *, seeds: int, sources: int, agents: int) -> str:
    placed = [
        f"{sum(row['generated'] for row in o.rows) / max(1, len(o.rows)):.1f} {_NAMES.get(o.setting.name, '')}".strip()
        for o in outcomes
        if o.setting.config is not None
    ]
    failures = [f"{o.setting.name}, {failure}" for o in outcomes for failure in o.failures]
    asked = "0 to 40 vehicles" if name == "density" else f"{agents} vehicles"
    text = (
        f"<p>{sources} recorded scene{'s' if sources > 1 else ''}, each with seeds 0 to {seeds - 1}, {asked} asked for."
        f" Placed in a scene, in the mean: {', '.join(placed)}. Of {_of(outcomes, sources)}.</p>"
    )
    if name != "diversity":
        text += _COLUMNS_TEXT
    if name == "ablation":
        text += _ABLATION_TEXT
    if name == "diversity":
        text += _DIVERSITY_TEXT
    if failures:
        text += (
            "<p class=bad>Not generated:</p><ul>"
            + "".join(f"<li>{html.escape(line)}</li>" for line in failures)
            + "</ul>"
        )
    return text


def _of(outcomes: Sequence[Outcome], sources: int) -> str:
    """How many scenes and vehicles an experiment is of."""
    made = [row for outcome in outcomes if outcome.setting.config is not None for row in outcome.rows]
    vehicles = sum(int(row["generated"]) for row in made)
    return f"{len(made)} generated scenes made from {sources} recorded, with {vehicles} generated vehicles in all"


_COLUMNS_TEXT = (
    "<p><b>LO</b>, <b>LA</b>, <b>JE</b>: mean magnitude of longitudinal acceleration, lateral acceleration and jerk, "
    "from positions, over all road users. <b>SCR</b>: share of vehicles whose box overlaps another one's (IoU above "
    "0.02) at some step. <b>ORR</b>: share of positions off the drivable area; <b>footprint ORR</b>: share of boxes "
    "with a corner more than 0.3 m off it. Lower is smoother or safer; recorded tracks carry tracker noise, so that "
    "even perfect driving beside them lowers every mean. Generated vehicles alone are held against every road user for "
    "SCR, the other rows against vehicles.</p><p>Small print: 95 % interval by bootstrap over recorded scenes (all "
    "seeds of a scene are drawn together). The paper's lines, without interval, are its own figures for Argoverse 2, "
    "on its own, far larger choice of scenes: compare the change from row to row, not the level.</p>"
)
_ABLATION_TEXT = (
    "<p>Without <b>topology</b> vehicles drive straight on where they are, whatever the lanes do: smooth, off the road."
    " Without <b>collision</b> checks they keep to their lanes and run into others. Without <b>smoothing</b> the raw "
    "simulated motion is exported: safe, with jerks. Each shows in the rows of generated vehicles alone; the others "
    "dilute it.</p>"
)
_DIVERSITY_TEXT = (
    f"<p>As in the paper, the scenes are recorded ones of more than {TEMPLATE_AGENTS} agents, before and after. After: "
    "all scenes made with either mix, the default one for density and one of turns, lane changes and overtakes for "
    "behaviours. The paper gives its comparison as a figure without numbers: more scenes in every higher band, and "
    "more of every behaviour but straight driving.</p>"
)


def _html_table(lines: Sequence[_Line]) -> str:
    columns = (*COLUMNS, *MORE_COLUMNS)
    empty = {"value": None, "low": None, "high": None}
    rows = [(line.label, *(report.with_interval(line.values.get(m.key, empty)) for m in columns)) for line in lines]
    head = ("", *(m.label.split(":")[0] + (f", {m.unit}" if m.unit != "share" else "") for m in columns))
    return report.table(head, rows)


def _flat(line: _Line) -> Row:
    row: Row = {"row": line.label}
    for metric in (*COLUMNS, *MORE_COLUMNS):
        value = line.values.get(metric.key, {"value": None, "low": None, "high": None})
        row |= {metric.key: value["value"], f"{metric.key}_low": value["low"], f"{metric.key}_high": value["high"]}
    return row


def _diversity_rows(content: Mapping[str, Any]) -> list[Row]:
    behaviours = content["behaviours"]
    return [
        {
            "behaviour": kind,
            **{when: part["scenes_with"][kind] / max(1, part["scenes"]) for when, part in behaviours.items()},
        }
        for kind in behaviours["before"]["scenes_with"]
    ]


def _write_rows(rows: Sequence[Row], path: Path) -> None:
    columns = list(dict.fromkeys(key for row in rows for key in row if not isinstance(row[key], dict)))
    with table_file(path) as stream:
        writer = csv.DictWriter(stream, columns, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)
