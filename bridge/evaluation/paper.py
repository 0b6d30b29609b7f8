"""The paper's experiments that need no training: scenes of every setting, generated and measured, and their pages.

table1: realism and safety with 10 vehicles added, by data set. ablation: without topology, collision checks, smoothing.
density: 0 to 40 vehicles added. diversity: scenes by number of agents and behaviour, before and after, of the whole
data set and of the paper's templates. Tables stand beside the paper's; the last two are figures there.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.signal import savgol_filter

from bridge.batch.engine import OnDone, work_on_each
from bridge.batch.isolation import Failure, attempts
from bridge.evaluation.scene_metrics import Row, measure
from bridge.evaluation.totals import Diversity, SourceSums, estimate
from bridge.files import make_folder, write_json, write_rows
from bridge.pages import charts
from bridge.pages import parts as pages
from bridge.pictures import figures
from bridge.recordings.folders import Address, Choices, Source
from bridge.recordings.sources import find_sources, fitting, read_recording
from hid2.agents import Track
from hid2.evaluation.metrics import METRICS, Metric
from hid2.params import Config, Request
from hid2.resampling import Estimate

Experiment = Literal["table1", "ablation", "density", "diversity"]

#: Numbers of vehicles added in the paper's density figure.
ADDED = (0, 5, 10, 20, 40)
#: The paper does not say how its Argoverse 1 tracks were smoothed. With this filter (samples, degree) tracks seen at
#: every step come to its JE, and near its LO and LA. For comparison alone: nothing that is generated depends on it.
_FILTER_SAMPLES, _FILTER_DEGREE = 13, 3
#: Kinds of scenes of Table 1: of Argoverse 1, the same with smoothed tracks, of any other format.
_ROUGH, _SMOOTHED, _OTHER = "argoverse1", "smoothed", "other"
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
#: Measures that rise with the number of vehicles added in the paper's figure; the others fall.
PAPER_RISES = ("scr", "orr")
_NAMES = {"full": "with everything on", "dense": "with the default mix", "rare": "with a mix of rare behaviours"}
_NAMES |= {part: f"without {part}" for part in ("topology", "collision", "smoothing")}
_NAMES |= {str(number): f"where {number} were asked for" for number in ADDED}
#: Number of tracks above which a scene is one of the paper's templates.
TEMPLATE_AGENTS = 40


def settings_of(name: Experiment, agents: int) -> Mapping[str, Config | None]:
    """The rows of an experiment by name, with the configuration that each runs (None: nothing is generated).

    agents: vehicles added where it has no numbers of its own.
    """
    base = Config(request=Request(agents=agents))
    if name == "ablation":
        parts: tuple[Literal["topology", "collision", "smoothing"], ...] = ("topology", "collision", "smoothing")
        return {"full": base} | {p: base.model_copy(update={"without": frozenset({p})}) for p in parts}
    if name == "density":
        return {str(n): Config(request=Request(agents=n)) if n else None for n in ADDED}
    if name == "diversity":
        rare = Config(request=Request.model_validate({"agents": agents, **_RARE_MIX}))
        return {"recorded": None, "dense": base, "rare": rare}
    return {"hid2": base}


#: Scene rows by setting, one per source scene and seed; in table1 those that are smoothed apart, if any.
_Rows = Mapping[str, list[Row]]


def run_settings(
    name: Experiment, folders: Sequence[Address], *, agents: int, seeds: int, jobs: int, on_scene: OnDone
) -> tuple[_Rows, list[str]]:
    """Generate and measure every setting on every scene with every seed, each scene in a process of its own.

    Returns the rows and, by setting, a line for each scene that failed.
    """
    settings = settings_of(name, agents)
    rows: dict[str, list[Row]] = {setting: [] for setting in settings}
    failures: dict[str, list[str]] = {setting: [] for setting in settings}
    each = work_on_each(
        generate_and_measure, folders, (name, agents, seeds), jobs=jobs, chunk=1,
        timeout_s=_TIMEOUT_S * seeds * len(settings), on_item=on_scene,
    )  # fmt: skip
    for folder, made in each:
        scene = folder.name[:8]
        every = [(one, "", made) for one in settings] if isinstance(made, Failure) else made
        for setting, seed, found in every:
            if isinstance(found, Failure):
                failures[setting].append(f"{setting}, {scene}{seed}: {found.message}")
            else:
                for row in found:
                    rows.setdefault(row["setting"], []).append(row)
    return rows, [line for lines in failures.values() for line in lines]


def generate_and_measure(
    shared: tuple[Experiment, int, int], folder: Address
) -> list[tuple[str, str, list[Row] | Failure]]:
    """The work on a scene: setting, seed in words, and the scene's row of each; in table1 a second one, smoothed.

    Recorded positions of Argoverse 1 are smoothed, of tracks seen at every step.
    """
    from bridge.generation.generate import generate, prepare  # libsumo: only where scenes are made

    name, agents, seeds = shared
    settings, scenario = settings_of(name, agents), read_recording(folder)
    is_rough = name == "table1" and isinstance(folder, Source) and folder.format == _ROUGH
    items = [(setting, seed) for setting, config in settings.items() for seed in range(seeds if config else 1)]
    prepared = prepare(scenario, next((config for config in settings.values() if config), Config()))

    def rows(item: tuple[str, int]) -> list[Row]:
        (setting, seed), config = item, settings[item[0]]
        recorded, inserted, sidecar = {setting: scenario.tracks}, tuple[Track, ...](), None
        if is_rough:
            recorded[_SMOOTHED] = smoothed(scenario.tracks, scenario.num_steps, step_s=scenario.step_s)
        if config is not None:
            request = config.request.model_copy(update={"seed": seed})
            scene = generate(prepared, config.model_copy(update={"request": request}))
            inserted, sidecar = scene.generated, scene.sidecar
        about = {"city": scenario.city, "seed_run": seed}
        return [
            {"setting": one} | about | measure(scenario, (*tracks, *inserted), sidecar).scene
            for one, tracks in recorded.items()
        ]

    found = zip(items, attempts(rows, items), strict=True)
    return [(setting, f", seed {seed}", each) for (setting, seed), each in found]


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
    name: Experiment, scenes: Path | Sequence[Path], out_dir: Path, choices: Choices | None = None, *, seeds: int = 10,
    jobs: int = 1, agents: int = 10, on_scene: OnDone = None,
) -> Path:  # fmt: skip
    """Run one experiment of the paper on recorded scenes; returns the page that it wrote.

    Writes <name>.html, <name>.csv (the table), <name>_scenes.csv (one row per scene and seed) and <name>.json into
    out_dir. scenes: recordings of any format, with the choices that some leave open. `agents`: vehicles added in
    table1, ablation and diversity. on_scene(done, total) is called as generated scenes are done. Errors: ScenarioError
    where there is no scene; ExportError.
    """
    folders = fitting(find_sources([scenes] if isinstance(scenes, Path) else scenes, choices), choices)
    make_folder(out_dir)
    rows, failures = run_settings(name, folders, agents=agents, seeds=seeds, jobs=jobs, on_scene=on_scene)
    generating = [setting for setting, config in settings_of(name, agents).items() if config]
    figures.style()
    _write_rows([row for each in rows.values() for row in each], out_dir / f"{name}_scenes.csv")
    made = [row for setting in generating for row in rows[setting]]
    kinds = {(row["format"], row["provenance"]) for each in rows.values() for row in each}
    content: dict[str, Any] = {"experiment": name, "seeds": seeds, "scenes": len(folders)}
    shown: dict[str, Any] = {
        "name": name, "failures": failures, "metrics": SHOWN, "lines": [], "diversities": [],
        "counts": {"made": len(made), "sources": len(folders), "vehicles": sum(row["generated"] for row in made)},
        "of_seeds": f"seeds 0 to {seeds - 1}" if seeds > 1 else "seed 0",
        "asked": "0 to 40 vehicles" if name == "density" else f"{agents} vehicles",
        "placed": [f"{_placed(rows[setting])} {_NAMES.get(setting, '')}".strip() for setting in generating],
        "two_kinds": len({provenance for kind, provenance in kinds if kind != _ROUGH}) > 1,
        "argoverse1": any(kind == _ROUGH for kind, _ in kinds),
    }  # fmt: skip
    if name == "diversity":
        found = _diversity(rows)
        content |= found[0] | ({"templates": found[1]} if found[1:] else {})
        told = content["behaviours"]
        table = [
            {"behaviour": kind} | {when: of["scenes_with"][kind] / max(1, of["scenes"]) for when, of in told.items()}
            for kind in told["before"]["scenes_with"]
        ]
        figures.save(charts.diversity_figure(content), out_dir / f"{name}.png")
        pictures = [figures.data_uri(charts.diversity_figure(each)) for each in found]
        shown["diversities"] = list(zip(found, pictures, strict=True))
    else:
        content["lines"] = shown["lines"] = lines_of(name, rows, generating)
        table = [flat(line) for line in shown["lines"]]
    if name == "density":
        points = _density(rows, generating)
        drawn = charts.density_figure(points, of=str(pages.macros("paper.html.j2", **shown).of()))
        shown |= {"picture": figures.data_uri(drawn), "differs": _differing(points)}
        figures.save(drawn, out_dir / f"{name}.png")
    _write_rows(table, out_dir / f"{name}.csv")
    write_json(out_dir / f"{name}.json", content)
    path = out_dir / f"{name}.html"
    pages.write_page(path, "paper.html.j2", **shown)
    return path


def _placed(rows: Sequence[Row]) -> float:
    """Vehicles placed in a scene, in the mean."""
    return round(float(np.mean([row["generated"] for row in rows] or 0.0)), 1)


# Tables ---------------------------------------------------------------------------------------------------------------


#: A line of a table: its label as `row`, then value and interval (or the paper's figure) by metric key.
Line = dict[str, Any]


def _line(label: str, rows: Sequence[Row], what: str | Mapping[str, float]) -> Line:
    """A line of a group of our rows, or of the paper's figures."""
    if isinstance(what, str):
        sums = SourceSums(rows)
        return {"row": label} | {m.key: estimate(sums, m, what)._asdict() for m in SHOWN}
    return {"row": label} | {key: Estimate(value)._asdict() for key, value in what.items()}


#: Lines of Table 1: the scenes they are of, and the paper's figures for these or the group of ours.
_TABLE1: Sequence[tuple[str, str, str | Mapping[str, float]]] = (
    ("paper: Argoverse 2", _OTHER, PAPER_ORIGINAL),
    ("ours: recorded scenes", _OTHER, "original"),
    ("paper: HiD2", _OTHER, PAPER_HID2),
    ("ours: recorded and generated", _OTHER, "combined"),
    ("ours: generated vehicles alone", _OTHER, "generated"),
    ("paper: Argoverse 1", _ROUGH, PAPER_ARGOVERSE1),
    ("ours: Argoverse 1, recorded, positions as they are", _ROUGH, "original"),
    ("ours: Argoverse 1, recorded, smoothed, tracks seen at every step", _SMOOTHED, "original"),
    ("paper: HiD2 on Argoverse 1", _ROUGH, PAPER_HID2_ARGOVERSE1),
    ("ours: Argoverse 1, recorded and generated, positions as they are", _ROUGH, "combined"),
    ("ours: Argoverse 1, recorded and generated, smoothed, tracks seen at every step", _SMOOTHED, "combined"),
    ("ours: Argoverse 1, generated vehicles alone", _ROUGH, "generated"),
)
_MADE_BY = {"tracker": "tracked on board", "human": "labelled by people"}


def lines_of(name: Experiment, rows: _Rows, generating: Sequence[str]) -> list[Line]:
    """The lines of an experiment's table, but for diversity, which has none. generating: settings that add vehicles."""
    lines: list[Line] = []
    if name == "table1":
        by_kind = {_SMOOTHED: rows.get(_SMOOTHED, []), _ROUGH: list[Row](), _OTHER: list[Row]()}
        for row in rows["hid2"]:
            by_kind[_ROUGH if row["format"] == _ROUGH else _OTHER].append(row)
        for label, kind, what in _TABLE1:
            if every := by_kind[kind]:
                lines.append(_line(label, every, what))
            for provenance, how in _MADE_BY.items() if kind == _OTHER and what in ("original", "combined") else ():
                own = [row for row in every if row["provenance"] == provenance]
                if 0 < len(own) < len(every):  # each kind apart as well
                    count = len({row["source"] for row in own})
                    lines.append(_line(f"{label}, {how} ({count} scene{'s' * (count != 1)})", own, what))
        return lines
    for asked, own in rows.items():
        said = f"{asked} asked for:"
        if name == "ablation":
            what = "everything on" if asked == "full" else f"without {asked}"
            lines, said = [*lines, _line(f"paper: {what}", (), PAPER_ABLATION[asked])], f"ours: {what},"
        lines.append(_line(f"{said} recorded and generated", own, "combined"))
        if asked in generating:
            lines.append(_line(f"{said} generated alone", own, "generated"))
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


def _density(rows: _Rows, generating: Sequence[str]) -> _Points:
    """Estimates by metric and group along the numbers placed."""
    series = [(_placed(own), SourceSums(own), one in generating) for one, own in rows.items()]
    series.sort(key=lambda one: one[0])

    def points(metric: Metric, group: str) -> list[tuple[float, Estimate]]:
        known = [(added, sums) for added, sums, made in series if made or group == "combined"]
        return [(added, estimate(sums, metric, group)) for added, sums in known]

    return {metric.key: {group: points(metric, group) for group in ("combined", "generated")} for metric in COLUMNS}


def _differing(points: _Points) -> list[str]:
    """Where a measure goes the other way than in the paper, from the fewest vehicles to the most."""
    differs = []
    for metric in COLUMNS:
        values = [estimate.value for _, estimate in points[metric.key]["combined"] if estimate.value is not None]
        here, there = ("falls", "rises") if metric.key in PAPER_RISES else ("rises", "falls")
        if len(values) > 1 and (values[-1] < values[0] if here == "falls" else values[-1] > values[0]):
            differs.append(
                f"{metric.key.upper()} {here} here, from {values[0]:.3f} to {values[-1]:.3f}, and {there} in the paper"
            )
    return differs


# Diversity ------------------------------------------------------------------------------------------------------------


def _diversity(rows: _Rows) -> list[dict[str, Any]]:
    """What recorded scenes, and those made with either mix, say: all, then those of the paper's templates if apart."""
    before, after = rows["recorded"], [*rows["dense"], *rows["rare"]]
    templates = {row["source"] for row in before if row["tracks"] > TEMPLATE_AGENTS}
    found = [Diversity(after, before).content()]
    if templates and len(templates) < len(before):
        chosen = [[row for row in each if row["source"] in templates] for each in (after, before)]
        found.append(Diversity(*chosen).content())
    return found


def _write_rows(rows: Sequence[Row], path: Path) -> None:
    columns = list(dict.fromkeys(key for row in rows for key in row if not isinstance(row[key], dict)))
    write_rows(path, columns, ([row.get(column) for column in columns] for row in rows))
