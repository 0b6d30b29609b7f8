"""The paper's experiments that need no training: scenes of every setting, generated and measured, and their pages.

table1: realism and safety with 10 vehicles added, by data set. ablation: without topology, collision checks, smoothing.
density: 0 to 40 vehicles added. diversity: scenes by number of agents and behaviour, before and after, of the whole
data set and of the paper's templates. Tables and figures stand beside the paper's own.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from markupsafe import Markup
from scipy.signal import savgol_filter

from bridge.batch.engine import OnDone, work_on_each
from bridge.batch.isolation import Failure, attempts
from bridge.evaluation.scene_metrics import Row, measure
from bridge.evaluation.totals import Diversity, SourceSums, estimate
from bridge.files import make_folder, write_json, write_rows, write_text
from bridge.pages import charts
from bridge.pages import parts as pages
from bridge.pictures import figures
from bridge.recordings.folders import Address, Choices, Source
from bridge.recordings.sources import find_sources, read_recording
from hid2.agents import Track
from hid2.evaluation.metrics import METRICS, Metric
from hid2.params import Config, Request
from hid2.resampling import Estimate

Experiment = Literal["table1", "ablation", "density", "diversity"]

#: Numbers of vehicles added in the paper's density figure.
ADDED = (0, 5, 10, 20, 40)
#: The paper does not say how its Argoverse 1 tracks were smoothed. With this filter (samples, degree) tracks seen at
#: every step come to its JE, and near its LO and LA. For comparison alone: nothing that is generated depends on it.
_SMOOTHED_FORMAT, _FILTER_SAMPLES, _FILTER_DEGREE = "argoverse1", 13, 3
_TIMEOUT_S = 600.0  # of a scene that is generated and measured once
#: The mix of the diversity experiment: the paper's underrepresented behaviours.
_RARE_MIX = {"straight": 0.2, "left_turn": 0.2, "right_turn": 0.2, "lane_change": 0.25, "overtake": 0.15}

#: The paper's Table 1, Argoverse 2.
PAPER_ORIGINAL = {"lo": 1.648, "la": 0.476, "je": 8.106, "scr": 0.072, "orr": 0.142}
PAPER_HID2 = {"lo": 1.465, "la": 0.486, "je": 7.801, "scr": 0.051, "orr": 0.114}
#: LO, LA, JE, SCR, ORR: what the paper reports.
COLUMNS: tuple[Metric, ...] = tuple(metric for metric in METRICS if metric.key in PAPER_ORIGINAL)
#: The same, and a column that the paper does not have.
SHOWN: tuple[Metric, ...] = (*COLUMNS, *(metric for metric in METRICS if metric.key == "footprint_orr"))
#: The paper's ablation table: component switched off, LO, LA, JE, SCR, ORR.
PAPER_ABLATION: Mapping[str, Mapping[str, float]] = {
    "full": PAPER_HID2,
    "topology": {"lo": 1.491, "la": 0.483, "je": 7.842, "scr": 0.101, "orr": 0.225},
    "collision": {"lo": 1.449, "la": 0.433, "je": 7.087, "scr": 0.282, "orr": 0.125},
    "smoothing": {"lo": 2.379, "la": 1.188, "je": 9.156, "scr": 0.072, "orr": 0.141},
}
#: The lower half of the paper's Table 1: Argoverse 1, recorded and with HiD2's vehicles.
PAPER_ARGOVERSE1 = {"lo": 1.414, "la": 0.838, "je": 11.192, "scr": 0.030, "orr": 0.009}
PAPER_HID2_ARGOVERSE1 = {"lo": 1.378, "la": 0.976, "je": 11.031, "scr": 0.020, "orr": 0.007}
#: Measures that rise with the number of vehicles added in the paper's figure.
PAPER_RISES = ("scr", "orr")
_NAMES = {"full": "with everything on", "dense": "with the default mix", "rare": "with a mix of rare behaviours"}
_NAMES |= {part: f"without {part}" for part in ("topology", "collision", "smoothing")}
_NAMES |= {str(number): f"where {number} were asked for" for number in ADDED}
#: The paper's templates have more tracks than this.
TEMPLATE_AGENTS = 40


class Setting(NamedTuple):
    """One row of an experiment: its name and the configuration that it runs (None: nothing is generated).

    smoothed: recorded positions of Argoverse 1 are also measured smoothed, of tracks seen at every step.
    """

    name: str
    config: Config | None
    smoothed: bool = False


class SettingRows(NamedTuple):
    """Scene rows of a setting, one per source scene and seed, those smoothed, and the scenes that failed, with why."""

    setting: Setting
    rows: list[Row]
    smoothed: list[Row]
    failures: list[str]


def settings_of(name: Experiment, agents: int) -> list[Setting]:
    """The rows of an experiment; agents: vehicles added where it has no numbers of its own."""
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
    return [Setting("hid2", base, smoothed=True)]


def run_settings(
    folders: Sequence[Address], settings: Sequence[Setting], *, seeds: int, jobs: int, on_scene: OnDone
) -> list[SettingRows]:
    """Generate and measure every setting on every scene with every seed, each scene in a process of its own."""
    outcomes, shared = [SettingRows(setting, [], [], []) for setting in settings], (tuple(settings), seeds)
    timeout_s = _TIMEOUT_S * seeds * len(settings)
    for folder, made in work_on_each(
        generate_and_measure, folders, shared=shared, jobs=jobs, chunk=1, timeout_s=timeout_s, on_item=on_scene
    ):
        name = folder.name[:8]
        if isinstance(made, Failure):
            for outcome in outcomes:
                outcome.failures.append(f"{name}: {made.message}")
            continue
        for setting, seed, found in made:
            if isinstance(found, Failure):
                outcomes[setting].failures.append(f"{name}, seed {seed}: {found.message}")
            else:
                outcomes[setting].rows.append(found[0])
                outcomes[setting].smoothed.extend(found[1:])
    return outcomes


def generate_and_measure(
    shared: tuple[tuple[Setting, ...], int], folder: Address
) -> list[tuple[int, int, list[Row] | Failure]]:
    """The work on a scene: number of the setting, seed, and the scene's row of each; a second one where smoothed."""
    from bridge.generation.generate import generate, prepare  # libsumo: only where scenes are made

    settings, seeds = shared
    scenario = read_recording(folder)
    is_rough = isinstance(folder, Source) and folder.format == _SMOOTHED_FORMAT
    items = [(k, seed) for k, setting in enumerate(settings) for seed in range(seeds if setting.config else 1)]
    prepared = prepare(scenario, next((s.config for s in settings if s.config), Config()))

    def rows(item: tuple[int, int]) -> list[Row]:
        setting, seed = settings[item[0]], item[1]
        recorded, inserted, sidecar = {setting.name: scenario.tracks}, tuple[Track, ...](), None
        if setting.smoothed and is_rough:
            recorded["smoothed"] = smoothed(scenario.tracks, scenario.num_steps, step_s=scenario.step_s)
        if setting.config is not None:
            request = setting.config.request.model_copy(update={"seed": seed})
            scene = generate(prepared, setting.config.model_copy(update={"request": request}))
            inserted, sidecar = scene.generated, scene.sidecar
        about = {"city": scenario.city, "seed_run": seed}
        return [
            {"setting": name} | about | measure(scenario, (*tracks, *inserted), sidecar).scene
            for name, tracks in recorded.items()
        ]

    return [(*item, found) for item, found in zip(items, attempts(rows, items), strict=True)]


def smoothed(tracks: Sequence[Track], num_steps: int, *, step_s: float) -> tuple[Track, ...]:
    """Tracks seen at every step by a Savitzky-Golay filter over their positions."""
    found = []
    for track in tracks:
        if len(track.timesteps) == num_steps:
            position = savgol_filter(track.position, _FILTER_SAMPLES, _FILTER_DEGREE, axis=0)
            velocity = np.gradient(position, step_s, axis=0)
            found.append(replace(track, position=position, velocity=velocity))
    return tuple(found)


# Pages ----------------------------------------------------------------------------------------------------------------


def run_experiment(
    name: Experiment,
    *,
    scenes: Path | Sequence[Path],
    out_dir: Path,
    choices: Choices | None = None,
    seeds: int = 10,
    jobs: int = 1,
    agents: int = 10,
    on_scene: OnDone = None,
) -> Path:
    """Run one experiment of the paper on recorded scenes; returns the page that it wrote.

    Writes <name>.html, <name>.csv (the table), <name>_scenes.csv (one row per scene and seed) and <name>.json into
    out_dir. scenes: recordings of any format, with the choices that some leave open. `agents`: vehicles added in
    table1, ablation and diversity. on_scene(done, total) is called as generated scenes are done. Errors: ScenarioError
    where there is no scene; ExportError.
    """
    folders = find_sources([scenes] if isinstance(scenes, Path) else scenes, choices)
    make_folder(out_dir)
    outcomes = run_settings(folders, settings_of(name, agents), seeds=seeds, jobs=jobs, on_scene=on_scene)
    figures.style()
    _write_rows([row for one in outcomes for row in (*one.rows, *one.smoothed)], out_dir / f"{name}_scenes.csv")
    made = [row for outcome in outcomes if outcome.setting.config for row in outcome.rows]
    counts = {"made": len(made), "sources": len(folders), "vehicles": sum(row["generated"] for row in made)}
    parts: list[Markup] = [_about(name, outcomes, counts, seeds=seeds, agents=agents)]
    content: dict[str, Any] = {"experiment": name, "seeds": seeds, "scenes": len(folders)}
    if name == "diversity":
        content |= _diversity(outcomes, parts)
        _write_rows(_diversity_rows(content), out_dir / f"{name}.csv")
        figures.save(charts.diversity_figure(content), out_dir / f"{name}.png")
    else:
        content["lines"] = lines = lines_of(name, outcomes)
        parts.append(_prose("table_of", lines, SHOWN))
        _write_rows([flat(line) for line in lines], out_dir / f"{name}.csv")
    if name == "density":
        points = _density(outcomes)
        shown = charts.density_figure(points, of=str(_prose("of", counts)))
        parts.append(_prose("density", counts, figures.data_uri(shown), _differing(points)))
        figures.save(shown, out_dir / f"{name}.png")
    write_json(out_dir / f"{name}.json", content)
    path = out_dir / f"{name}.html"
    write_text(path, pages.page(_TITLES[name], parts))
    return path


_TITLES: Mapping[str, str] = {
    "table1": "Table 1: realism and safety of recorded and generated traffic",
    "ablation": "Ablation: what each component is for",
    "density": "Effect of adding different numbers of vehicles",
    "diversity": "Diversity before and after",
}


def _prose(name: str, *arguments: object) -> Markup:
    return pages.macro("paper.html.j2", name, *arguments)


def _about(name: Experiment, outcomes: Sequence[SettingRows], counts: Row, *, seeds: int, agents: int) -> Markup:
    placed = [f"{_placed(o)} {_NAMES.get(o.setting.name, '')}".strip() for o in outcomes if o.setting.config]
    kinds = {(row["format"], row["provenance"]) for o in outcomes for row in o.rows}
    return _prose(
        "about", name, counts, f"seeds 0 to {seeds - 1}" if seeds > 1 else "seed 0",
        "0 to 40 vehicles" if name == "density" else f"{agents} vehicles", placed,
        len({provenance for kind, provenance in kinds if kind != "argoverse1"}) > 1,
        any(kind == "argoverse1" for kind, _ in kinds),
        [f"{o.setting.name}, {failure}" for o in outcomes for failure in o.failures],
    )  # fmt: skip


def _placed(outcome: SettingRows) -> float:
    """Vehicles placed in a scene, in the mean."""
    placed: int = sum(row["generated"] for row in outcome.rows)
    return round(placed / max(1, len(outcome.rows)), 1)


# Tables ---------------------------------------------------------------------------------------------------------------


#: A line of a table: its label as `row`, then value and interval (or the paper's figure) by metric key.
Line = dict[str, Any]


def _line(label: str, rows: Sequence[Row], what: str | Mapping[str, float]) -> Line:
    """A line of a group of our rows, or of the paper's figures."""
    if isinstance(what, str):
        sums = SourceSums.of(rows)
        return {"row": label} | {m.key: estimate(sums, m, what)._asdict() for m in SHOWN}
    return {"row": label} | {key: Estimate(value)._asdict() for key, value in what.items()}


#: Table 1: lines with the paper's figures, or with the group that they are of; of Argoverse 1 also whether smoothed.
_ARGOVERSE2: Sequence[tuple[str, str | Mapping[str, float]]] = (
    ("paper: Argoverse 2", PAPER_ORIGINAL), ("ours: recorded scenes", "original"),
    ("paper: HiD2", PAPER_HID2), ("ours: recorded and generated", "combined"),
    ("ours: generated vehicles alone", "generated"),
)  # fmt: skip
_ARGOVERSE1: Sequence[tuple[str, str | Mapping[str, float], bool]] = (
    ("paper: Argoverse 1", PAPER_ARGOVERSE1, False),
    ("ours: Argoverse 1, recorded, positions as they are", "original", False),
    ("ours: Argoverse 1, recorded, smoothed, tracks seen at every step", "original", True),
    ("paper: HiD2 on Argoverse 1", PAPER_HID2_ARGOVERSE1, False),
    ("ours: Argoverse 1, recorded and generated, positions as they are", "combined", False),
    ("ours: Argoverse 1, recorded and generated, smoothed, tracks seen at every step", "combined", True),
    ("ours: Argoverse 1, generated vehicles alone", "generated", False),
)
_MADE_BY = {"tracker": "tracked on board", "human": "labelled by people"}


def lines_of(name: Experiment, outcomes: Sequence[SettingRows]) -> list[Line]:
    """The lines of an experiment's table, but for diversity, which has none."""
    lines: list[Line] = []
    if name == "table1":
        first, second = (
            [row for row in outcomes[0].rows if (row["format"] == "argoverse1") is one] for one in (True, False)
        )
        for label, what in _ARGOVERSE2 if second else ():
            lines.append(_line(label, second, what))
            for provenance, how in _MADE_BY.items() if what in ("original", "combined") else ():
                own = [row for row in second if row["provenance"] == provenance]
                if 0 < len(own) < len(second):  # each kind apart as well
                    count = len({row["source"] for row in own})
                    lines.append(_line(f"{label}, {how} ({count} scene{'s' * (count != 1)})", own, what))
        return lines + [
            _line(label, outcomes[0].smoothed if is_smoothed else first, what)
            for label, what, is_smoothed in _ARGOVERSE1
            if first
        ]
    for outcome in outcomes:
        asked, rows = outcome.setting.name, outcome.rows
        said = f"{asked} asked for:"
        if name == "ablation":
            what = "everything on" if asked == "full" else f"without {asked}"
            lines, said = [*lines, _line(f"paper: {what}", (), PAPER_ABLATION[asked])], f"ours: {what},"
        lines.append(_line(f"{said} recorded and generated", rows, "combined"))
        if outcome.setting.config is not None:
            lines.append(_line(f"{said} generated alone", rows, "generated"))
    return lines


def flat(line: Line) -> Row:
    """A line for the CSV file."""
    row: Row = {"row": line["row"]}
    for metric in SHOWN:
        value, low, high = line.get(metric.key, Estimate(None)._asdict()).values()
        row |= {metric.key: value, f"{metric.key}_low": low, f"{metric.key}_high": high}
    return row


# Density --------------------------------------------------------------------------------------------------------------

_Points = dict[str, dict[str, list[tuple[float, Estimate]]]]


def _density(outcomes: Sequence[SettingRows]) -> _Points:
    """Estimates by metric and group along the numbers placed."""
    series = {_placed(outcome): (SourceSums.of(outcome.rows), outcome.setting.config) for outcome in outcomes}

    def points(metric: Metric, group: str) -> list[tuple[float, Estimate]]:
        known = [(added, sums) for added, (sums, made) in sorted(series.items()) if made or group == "combined"]
        return [(added, estimate(sums, metric, group)) for added, sums in known]

    return {metric.key: {group: points(metric, group) for group in ("combined", "generated")} for metric in COLUMNS}


def _differing(points: _Points) -> list[str]:
    """Where a measure goes the other way than in the paper, from the fewest vehicles to the most."""
    differs = []
    for metric in COLUMNS:
        values = [estimate.value for _, estimate in points[metric.key]["combined"] if estimate.value is not None]
        if metric.key in PAPER_RISES and len(values) > 1 and values[-1] <= values[0]:
            name = metric.label.split(":")[0]
            differs.append(f"{name} falls here, from {values[0]:.3f} to {values[-1]:.3f}, and rises in the paper")
    return differs


# Diversity ------------------------------------------------------------------------------------------------------------


def _diversity(outcomes: Sequence[SettingRows], parts: list[Markup]) -> dict[str, Any]:
    """What the first setting, without generation, and all others say; the parts of the page are added."""
    before, after = outcomes[0].rows, [row for outcome in outcomes[1:] for row in outcome.rows]
    content = Diversity.of(after, before).content()
    parts.append(_diversity_part(content))
    templates = {row["source"] for row in before if row["tracks"] > TEMPLATE_AGENTS}
    if templates and len(templates) < len(before):
        chosen = [[row for row in rows if row["source"] in templates] for rows in (after, before)]
        content["templates"] = Diversity.of(*chosen).content()
        parts += [_prose("templates", len(templates)), _diversity_part(content["templates"])]
    return content


def _diversity_part(content: Mapping[str, Any]) -> Markup:
    """Figure and tables of scenes by density and behaviour, as the report has them."""
    shown = {"diversity": figures.data_uri(charts.diversity_figure(content))}
    return pages.macro("report.html.j2", "diversity", {"diversity": content}, shown)


def _diversity_rows(content: Mapping[str, Any]) -> list[Row]:
    told = content["behaviours"]
    return [
        {"behaviour": kind} | {when: of["scenes_with"][kind] / max(1, of["scenes"]) for when, of in told.items()}
        for kind in told["before"]["scenes_with"]
    ]


def _write_rows(rows: Sequence[Row], path: Path) -> None:
    columns = list(dict.fromkeys(key for row in rows for key in row if not isinstance(row[key], dict)))
    write_rows(path, columns, ([row.get(column) for column in columns] for row in rows))
