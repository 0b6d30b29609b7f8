"""The pages of the paper's experiments (`experiments`): finished tables and figures beside the paper's own."""

import csv
import html
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from bridge.evaluation import pages, report
from bridge.evaluation.aggregate import Estimate, SourceSums, estimate
from bridge.evaluation.diversity import Diversity
from bridge.evaluation.experiments import ADDED, EXPERIMENTS, Experiment, Outcome, run_settings, settings_of
from bridge.evaluation.paper_tables import COLUMNS, flat, html_table, lines_of
from bridge.evaluation.scene_metrics import Row
from bridge.files import explained, make_folder, table_file, write_json, write_text
from bridge.recordings.folders import Choices
from bridge.recordings.sources import find_sources
from hid2.measures.manoeuvres import ManeuverKind
from netconvert.errors import ConfigError

#: Measures that rise with the number of vehicles added in the paper's figure.
PAPER_RISES = ("scr", "orr")
_NAMES = {"full": "with everything on", "dense": "with the default mix", "rare": "with a mix of rare behaviours"}
_NAMES |= {part: f"without {part}" for part in ("topology", "collision", "smoothing")}
_NAMES |= {str(number): f"where {number} were asked for" for number in ADDED}
#: The paper's templates have more tracks than this.
TEMPLATE_AGENTS = 40


def run_experiment(
    name: Experiment,
    *,
    scenes: Path | Sequence[Path],
    out_dir: Path,
    choices: Choices | None = None,
    seeds: int = 10,
    jobs: int = 1,
    agents: int = 10,
    on_scene: Callable[[int, int], None] | None = None,
) -> Path:
    """Run one experiment of the paper on recorded scenes; returns the page that it wrote.

    Writes <name>.html, <name>.csv (the table), <name>_scenes.csv (one row per scene and seed) and <name>.json into
    out_dir. scenes: recordings of any format, with the choices that some leave open. `agents`: vehicles added in
    table1, ablation and diversity. on_scene(done, total) is called as generated scenes are done. Errors: ConfigError
    for an unknown name; ScenarioError where there is no scene; ExportError.
    """
    if name not in EXPERIMENTS:
        raise ConfigError(f"experiment {name!r}, expected one of {', '.join(EXPERIMENTS)}")
    if seeds < 1:
        raise ConfigError(f"seeds {seeds}, expected at least 1")
    folders = find_sources([scenes] if isinstance(scenes, Path) else scenes, choices)
    make_folder(out_dir)
    outcomes = run_settings(folders, settings_of(name, agents), seeds=seeds, jobs=jobs, on_scene=on_scene)
    with explained(out_dir):
        return _write(name, outcomes, out_dir, seeds=seeds, sources=len(folders), agents=agents)


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
        content["asked_and_done"] = _asked_and_done(outcomes[1:])
        parts += [*report.diversity_parts(content), *_asked_parts(content["asked_and_done"])]
        templates = {row["source"] for row in before if row["tracks"] > TEMPLATE_AGENTS}
        if templates and len(templates) < len(before):
            chosen = [[row for row in rows if row["source"] in templates] for rows in (after, before)]
            content["templates"] = Diversity.of(*chosen).content()
            parts += [_TEMPLATES_TEXT.format(len(templates)), *report.diversity_parts(content["templates"])]
        _write_rows(_diversity_rows(content), out_dir / f"{name}.csv")
        figures.save(charts.diversity_figure(content), out_dir / f"{name}.png")
    else:
        lines = lines_of(name, outcomes)
        content["lines"] = [
            {"row": line.label, **{key: dict(value) for key, value in line.values.items()}} for line in lines
        ]
        parts.append(html_table(lines))
        _write_rows([flat(line) for line in lines], out_dir / f"{name}.csv")
        if name == "density":
            series = {_placed(o): (SourceSums.of(o.rows), o.setting.config is not None) for o in outcomes}
            counted = _of(outcomes, sources)
            shown = charts.density_figure(_density(series), of=counted)
            parts.append(pages.picture(shown, f"{_DENSITY_CAPTION} Of {counted}."))
            parts.append(f"<p>{html.escape(_directions(_density(series)))}</p>")
            figures.save(charts.density_figure(_density(series), of=counted), out_dir / f"{name}.png")
    write_json(out_dir / f"{name}.json", content)
    path = out_dir / f"{name}.html"
    write_text(path, pages.page(_TITLES[name], parts))
    return path


_DENSITY_CAPTION = (
    "Each panel: the measure against the number of vehicles placed in a scene, in the mean. Solid: recorded and "
    "generated together, "
    "with the 95 % interval over recorded scenes (few scenes, wide interval: it is the same scenes at every number, so "
    "that the slope is surer than the level); dashed: generated vehicles alone."
)


def _placed(outcome: Outcome) -> float:
    """Vehicles placed in a scene, in the mean."""
    placed: int = sum(row["generated"] for row in outcome.rows)
    return round(placed / max(1, len(outcome.rows)), 1)


def _directions(points: Mapping[str, Mapping[str, Sequence[tuple[float, Estimate]]]]) -> str:
    """Where a measure goes the other way than in the paper, from the fewest vehicles to the most."""
    differs = []
    for metric in COLUMNS:
        values = [estimate.value for _, estimate in points[metric.key]["combined"] if estimate.value is not None]
        if metric.key in PAPER_RISES and len(values) > 1 and values[-1] <= values[0]:
            name = metric.label.split(":")[0]
            differs.append(f"{name} falls here, from {values[0]:.3f} to {values[-1]:.3f}, and rises in the paper")
    if not differs:
        return "SCR and ORR rise with the number of vehicles, as in the paper's figure."
    return (
        "The direction differs from the paper's figure: "
        + "; ".join(differs)
        + ". Inserted vehicles touch nobody and stay on the road: each lowers the share of those that do."
    )


def _asked_and_done(outcomes: Sequence[Outcome]) -> dict[str, dict[str, float]]:
    """Manoeuvres asked for and done in a scene, in the mean, by kind."""
    rows = [row for outcome in outcomes for row in outcome.rows]
    return {
        kind.value: {what: sum(row[f"{what}_{kind.value}"] for row in rows) / max(1, len(rows)) for what in _ASKED}
        for kind in ManeuverKind
    }


_ASKED = ("asked", "done")


def _asked_parts(counts: Mapping[str, Mapping[str, float]]) -> list[str]:
    rows = [
        (kind.replace("_", " "), *(pages.number(part[what], 2) for what in _ASKED)) for kind, part in counts.items()
    ]
    return [
        "<p>Manoeuvres of inserted vehicles in a scene, in the mean:</p>",
        pages.table(("manoeuvre", "asked for", "done"), rows),
    ]


def _density(series: Mapping[float, tuple[SourceSums, bool]]) -> dict[str, dict[str, list[tuple[float, Estimate]]]]:
    """Estimates by metric and group along the numbers placed."""
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
        if o.setting.config is not None and not o.setting.smoothed
    ]
    failures = [f"{o.setting.name}, {failure}" for o in outcomes for failure in o.failures]
    of_seeds = f"seeds 0 to {seeds - 1}" if seeds > 1 else "seed 0"
    asked = "0 to 40 vehicles" if name == "density" else f"{agents} vehicles"
    text = (
        f"<p>{sources} recorded scene{'s' if sources > 1 else ''}, each with {of_seeds}, {asked} asked for."
        f" Placed in a scene, in the mean: {', '.join(placed)}. Of {_of(outcomes, sources)}.</p>"
    )
    if name != "diversity":
        text += _COLUMNS_TEXT
    formats = {(row["format"], row["provenance"]) for o in outcomes for row in o.rows}
    if name == "table1" and len({provenance for kind, provenance in formats if kind != "argoverse1"}) > 1:
        text += _TABLE1_TEXT
    if name == "table1" and any(kind == "argoverse1" for kind, _ in formats):
        text += _ARGOVERSE1_TEXT
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
    made = [row for o in outcomes if o.setting.config is not None and not o.setting.smoothed for row in o.rows]
    vehicles = sum(int(row["generated"]) for row in made)
    return f"{len(made)} generated scenes made from {sources} recorded, with {vehicles} generated vehicles in all"


_COLUMNS_TEXT = (
    "<p><b>LO</b>, <b>LA</b>, <b>JE</b>: mean magnitude of longitudinal acceleration, lateral acceleration and jerk, "
    "from positions, over all road users. <b>SCR</b>: share of vehicles whose box overlaps another one's (IoU above "
    "0.02) at some step. <b>ORR</b>: share of positions off the drivable area; <b>footprint ORR</b>: share of boxes "
    "with a corner more than 0.3 m off it. Lower is smoother or safer; recorded tracks carry tracker noise, so that "
    "even perfect driving beside them lowers every mean. Generated vehicles alone are held against every road user for "
    "SCR, the other rows against vehicles.</p><p>Small print: 95 % interval by bootstrap over recorded scenes (all "
    "seeds of a scene are drawn together). The paper's lines, without interval, are its own figures, "
    "on its own, far larger choice of scenes: compare the change from row to row, not the level.</p>"
)
_TABLE1_TEXT = (
    "<p>Scenes <b>tracked on board</b> carry the noise of the recording vehicle's tracker, as all of the paper's do. "
    "Those <b>labelled by people</b>, windows of sensor logs, are smoother: hold the tracked ones against the paper's "
    "LO, LA and JE.</p>"
)
_ARGOVERSE1_TEXT = (
    "<p><b>Argoverse 1</b> has positions alone, without headings, sizes and types: every track is held to be a vehicle "
    "of 4.5 x 1.9 m, so that SCR and footprint ORR are upper bounds. Positions jump by decimetres, and their third "
    "derivative is mostly that: the paper's figures cannot be of raw positions. A filter over 1.3 s (13 samples, "
    "cubic; tracks of as many steps without a gap) takes most of it away; tracks seen at every step are those near the "
    "recording vehicle, jump less, and come nearest to the paper's figures. A map of Argoverse 2 ends where its scene "
    "does: what drives beyond it is off the road in ORR. Timesteps are 0.1 s, as every reader of the data set takes "
    "them; its own time stamps are up to twice as far apart, which makes accelerations by timesteps larger than they "
    "were.</p>"
)
_TEMPLATES_TEXT = "<h2>The paper's templates</h2><p>{} scenes of more than 40 agents alone:</p>"
_ABLATION_TEXT = (
    "<p>Without <b>topology</b> vehicles drive straight on where they are, whatever the lanes do: smooth, off the road."
    " Without <b>collision</b> checks they keep to their lanes and run into others. Without <b>smoothing</b> the raw "
    "simulated motion is exported: safe, with jerks. Each shows in the rows of generated vehicles alone; the others "
    "dilute it.</p>"
)
_DIVERSITY_TEXT = (
    f"<p>The whole data set, before and after; where it has scenes of more than {TEMPLATE_AGENTS} agents, the paper's "
    "templates, they follow alone. After: all scenes made with either mix, the default one for density and one of "
    "turns, lane changes and overtakes for behaviours. The paper gives its comparison as a figure without numbers: "
    "more scenes in every higher band, and more of every behaviour but straight driving.</p>"
)


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
