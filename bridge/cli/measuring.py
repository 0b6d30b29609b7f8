"""`hid2 evaluate`, `calibrate`, `study`, `paper`, `compose` ...: from scenes to figures, tables and data sets."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

from bridge.cli import options
from bridge.cli.generation import notes_of
from bridge.cli.places import check_scenes, tell_unread
from bridge.console import Activity, counted, print_json, say
from bridge.files import data_folder
from bridge.interruption import if_interrupted
from bridge.recordings.folders import Choices
from netconvert.errors import ConfigError, ScenarioError

#: Options of any way of a command.
_WITH_ANY = frozenset({"--out", "--jobs", "--verbose", "--quiet"})
_WITH_PREDICTIONS = _WITH_ANY | {"SCENES", "--predictions", "--bands", "--json"}


class Scored(NamedTuple):
    """Forecasts to score, in place of scenes to measure. given: all that is on the command line."""

    given: options.Given
    predictions: list[str] = options.option(
        "Score forecasts instead: a file in av2's submission format, or a baseline; given again: compare the "
        "files, further ones of a NAME being other seeds of it.",
        [],
        "[NAME=]FILE|constant-velocity|constant-turn-rate",
    )
    bands: str | None = options.option(
        "With --predictions: bands of scenes with more agents than each N.", None, "N,N,...", show_default="50,70,90"
    )
    as_json: bool = options.output("With --predictions: print the table as JSON.", False, None, "--json")


@options.command(reads=("out", "source", "control"), folders=("report",))
def evaluate(
    out: Path = options.argument(
        "SCENES", "Scenes to measure, generated or recorded: a scenario folder, a split folder or a root."
    ),
    report: Path = options.output("Folder for metrics.json, the tables and report.html.", ..., "REPORT", "-o", "--out"),
    *,
    source: list[Path] = options.option(
        "The source scenes: before is those of the scenes measured; repeatable.", [], "DIR"
    ),
    control: Path | None = options.option(
        "Scenes of the same sources with drivers that the critics must tell, as data/configs has them.", None, "DIR"
    ),
    scored: Scored,
    choices: Choices,
    jobs: int = options.JOBS,
    activity: Activity,
) -> bool:
    """Measure density, diversity, safety, kinematics and realism of any number of scenes, or score forecasts."""
    if scored.predictions:
        scored.given.check(_WITH_PREDICTIONS, "--predictions")
        return _score(out, scored, report, activity, jobs=jobs)
    if alone := sorted(scored.given & {"--json", "--bands"}):
        raise ConfigError(f"{alone[0]} without --predictions does nothing, expected the two together")
    from bridge.evaluation.evaluate import evaluate_folder

    activity.doing("measuring scenes")
    evaluation = evaluate_folder(
        out, report_dir=report, source=source, choices=choices, control=control, jobs=jobs, on_scene=activity.show
    )
    tell_unread(evaluation.failures)
    counts, left_out = evaluation.metrics["scenes"], len(evaluation.failures)
    activity.end()
    activity.note(
        f"{out}: {counted(counts['scenes'], 'scene')} made from {counts['sources']} recorded, with "
        f"{counted(counts['generated_vehicles'], 'generated vehicle')}"
        + (f"; {left_out} not readable, left out" if left_out else "")
    )
    activity.result(report / "report.html")
    return bool(evaluation.failures)


@options.command(reads=("scenes",), files=("out",))
def calibrate(
    scenes: list[Path] = options.argument("SCENE...", "Recorded scenes: scenario folders, splits or roots."),
    out: Path = options.output(
        "File to write; tables and a page go beside it.", Path("drivers.toml"), "DRIVERS.toml", "-o"
    ),
    *,
    without: list[str] = options.option("Leave a scene out, such as one to generate from; repeatable.", [], "ID"),
    jobs: int = options.JOBS,
    activity: Activity,
) -> bool:
    """Measure how people drive in recorded scenes, for `hid2 generate --drivers`."""
    from bridge.evaluation.calibrate import calibrate_folder

    activity.doing("measuring how people drive")
    failures = calibrate_folder(scenes, out, without=without, jobs=jobs, on_scene=activity.show)
    tell_unread(failures)
    activity.result(out, out.with_name(f"{out.stem}.html"))
    return bool(failures)


@options.command(reads=("scenes",), folders=("out",))
def resimulate(
    scenes: list[Path] = options.argument("SCENE...", "Recorded scenes, two or more: scenario folders, splits, roots."),
    out: Path = options.OUT,
    *,
    seeds: int = options.option("Rollouts of each scene.", 32, "N", min=1),
    take_out: Literal["all", "one"] = options.option(
        "Which vehicles are driven: all of a scene together, or one at a time, the others as recorded.", "all"
    ),
    write: int = options.option("Rollouts of each scene to write as scenes, into OUT/scenes.", 0, "K", min=0),
    seed: int = options.option("Seed of every random choice.", 0, "N", min=0),
    jobs: int = options.JOBS,
    activity: Activity,
) -> bool:
    """Take recorded vehicles out, drive them by SUMO, and score that as simulated agents are ("WOSAC-like")."""
    from bridge.evaluation.resimulate import ResimulationPlan, resimulate_folders

    activity.doing("calibrating and driving")
    plan = ResimulationPlan(seeds, take_out, write, seed)
    failures = resimulate_folders(scenes, out, plan, jobs=jobs, on_scene=activity.show)
    tell_unread(failures)
    activity.result(out / "resimulation.html")
    return bool(failures)


@options.command(reads=("scenes",), folders=("out",))
def study(
    file: Path = options.argument("STUDY.toml", "The study, as those in data/studies."),
    out: Path = options.OUT,
    *,
    scenes: list[Path] = options.option("Scenes instead of those in the file; repeatable.", [], "SCENE"),
    plan: float | None = options.option(
        "Run nothing, and say how many runs a difference of this size in the share that gets a gap needs.",
        None,
        "SHARE",
    ),
    trj: bool = options.output(
        "Beside each run driven now its trajectories for SSAM, trajectories.trj.", False, None, "--trj"
    ),
    batch: options.Batch,
    activity: Activity,
) -> bool:
    """Run a parameter study. Called again, it continues: completed runs are skipped."""
    from bridge.studies.run import plan_text, run_study
    from bridge.studies.study import read_study

    how = batch.options(resume=True)
    activity.doing("reading the study and its scenes")
    found = read_study(file, scenes=scenes)
    if plan is not None:
        activity.doing("drawing the first run")
        lines = list(plan_text(found, out, plan))
        activity.end()
        print(*lines, sep="\n")
        return False
    activity.doing("driving")
    activity.show(0, sum(len(job.runs) for job in found.jobs))
    report = run_study(found, out, how, trj=trj, on_row=notes_of(activity, out, go_on="the same command continues"))
    activity.result(*report.files)
    return bool(report.failed)


@options.command(folders=("out",))
def public(
    file: Path = options.argument("PAGE.toml", "Roads, published counts and rules, as data/public/ngsim.toml."),
    out: Path = options.OUT,
    *,
    batch: options.Batch,
    activity: Activity,
) -> bool:
    """Lane changes on public roads, published beside simulated, for rules untuned and tuned. Can be continued."""
    from bridge.studies.public_roads import read_public, run_public

    how, page = batch.options(), read_public(file)
    activity.doing("driving roads")
    report = run_public(page, out, how, on_row=notes_of(activity, out, go_on="the same command continues"))
    activity.note(f"{counted(report.runs, 'run')} in {report.seconds:.0f} s in all, {report.failed or 'none'} failed")
    activity.result(*report.files)
    return bool(report.failed)


@options.command(folders=("out",))
def make(
    what: Literal["corridor", "arterial"] = options.argument(
        "WHAT", "corridor: a straight one-way road; arterial: two lanes with signals, data/public/arterial.toml."
    ),
    out: Path = options.OUT,
    *,
    road: Path | None = options.option(
        "A road with ramps, signals and traffic of its own instead, as those in data/public.", None, "ROAD.toml"
    ),
    length: float | None = options.option("Length of a plain corridor, m.", None, "M", show_default="600"),
    lanes: int | None = options.option("Its lanes.", None, "N", show_default="2"),
    seconds: float | None = options.option("Duration of the recording, s.", None, "S", show_default="180"),
) -> None:
    """Make a synthetic scene for studies; it is no scene of Argoverse, and its id says so."""
    from bridge.recordings.road import write_corridor, write_road

    road = road or (data_folder() / "public" / "arterial.toml" if what == "arterial" else None)
    asked = {"length_m": length, "lanes": lanes, "seconds": seconds}
    given = {name: value for name, value in asked.items() if value is not None}
    if road is None:
        print(write_corridor(out, **{"length_m": 600.0, "lanes": 2, "seconds": 180.0, **given}))  # type: ignore[arg-type]
        return
    for name, value in given.items():
        option = "--" + name.removesuffix("_m")
        raise ConfigError(f"{option} {value:g}: {road.name} has its own; leave {option} out, or edit a copy of it")
    print(write_road(out, road))


class Plan(NamedTuple):
    """How much an experiment makes, and `prediction` trains or has of elsewhere. given: all on the command line."""

    given: options.Given
    seeds: int | None = options.option(
        "Seeds per scene, or of the training.", None, "N", min=1, show_default="10; prediction: 3"
    )
    variants: int | None = options.prediction("Scenes made of each recorded one.", None, "K", min=1, show_default="8")
    val: float | None = options.prediction(
        "Share of the scenes for validation.", None, "SHARE", min=0.01, max=0.9, show_default="0.3"
    )
    updates: int | None = options.prediction("Updates of each training.", None, "N", min=1, show_default="300")
    focal: options.ReadingName = options.prediction("What is forecast in generated scenes; both: by turns.", "both")
    composed: Path | None = options.prediction(
        "Data sets that compose made, with the controls, instead of new ones.", None, "ROOT"
    )
    predictions: Path | None = options.prediction(
        "Forecasts from elsewhere instead of the small forecaster's: SET/SEED/VALIDATION.parquet.", None, "DIR"
    )


_WITH_PAPER = _WITH_ANY | {"EXPERIMENT", "--scenes", "--seeds"}
_WITH_DENSITY = _WITH_PAPER | {"--map", "--window", "--stride"}
_WITH_TABLES = _WITH_DENSITY | {"--agents"}
_WITH_EXPERIMENT = {
    "density": _WITH_DENSITY,
    "prediction": _WITH_PAPER
    | {"--agents", "--variants", "--val", "--updates", "--focal", "--composed", "--predictions"},
    "--composed": _WITH_ANY | {"EXPERIMENT", "--composed", "--seeds", "--updates"},
    "--predictions": _WITH_ANY | {"EXPERIMENT", "--composed", "--predictions"},
}


@options.command(folders=("out",))
def paper(
    experiment: options.ExperimentName = options.argument(
        "EXPERIMENT", "One of table1, ablation, density, diversity, prediction."
    ),
    out: Path = options.OUT,
    *,
    scenes: list[Path] = options.option(
        "Recordings; diversity needs real ones of over 40 agents for the paper's part; repeatable.",
        [Path("data/av2")],
        "DIR",
        show_default=True,
    ),
    choices: Choices,
    plan: Plan,
    agents: int = options.option("Vehicles added, except in density.", 10, "N", min=0),
    jobs: int = options.JOBS,
    activity: Activity,
) -> None:
    """Run an experiment of the paper, from generation to the table beside the paper's; prediction needs `forecast`."""
    way: str = experiment
    if experiment == "prediction" and plan.composed:
        way = "--predictions" if plan.predictions else "--composed"
    plan.given.check(_WITH_EXPERIMENT.get(way, _WITH_TABLES), way)
    check_scenes([plan.composed] if plan.composed else [] if plan.predictions else scenes)
    if experiment == "prediction":
        from bridge.forecasting.experiment import TrainingPlan, run_prediction
        from hid2.params import Forecasting

        asked = {"variants": plan.variants, "val_share": plan.val, "updates": plan.updates}
        params = Forecasting.model_validate({name: value for name, value in asked.items() if value is not None})
        training = TrainingPlan(plan.seeds or 3, agents, plan.focal, params)
        page = run_prediction(scenes, out, training, plan.composed, plan.predictions, jobs=jobs, on_step=activity.step)
    else:
        from bridge.evaluation.paper import run_experiment

        activity.doing("generating and measuring")
        page = run_experiment(
            experiment, scenes, out, choices, seeds=plan.seeds or 10, agents=agents, jobs=jobs, on_scene=activity.show
        )
    activity.end()
    print(page)


def _tell_left_out(how: str, lines: Sequence[str], activity: Activity) -> None:
    shown = len(lines) if activity.verbose else 10
    for line in lines[:shown]:
        say(f"warning: {how}: {line}")
    if len(lines) > shown:
        say(f"warning: {how}: {len(lines) - shown} more (-v lists them)")


def _score(out: Path, scored: Scored, report: Path, activity: Activity, *, jobs: int) -> bool:
    """Score forecasts, or compare those of several files; returns whether some scene was left out."""
    from bridge.forecasting import predictions

    files, bands, as_json = scored.predictions, scored.bands, scored.as_json
    given = ",".join(map(str, predictions.BOUNDS)) if bands is None else bands.replace(" ", "")
    bounds = sorted({int(band) for band in given.split(",") if band.isdecimal()} - {0})
    if ",".join(map(str, bounds)) != given:
        raise ConfigError(f"--bands {bands!r}: expected numbers of agents, each larger than the last, joined by commas")
    activity.doing("scoring forecasts")
    how: dict[str, Any] = {"bounds": bounds, "jobs": jobs, "on_scene": activity.show}
    table: tuple[Sequence[str], Sequence[tuple[object, ...]]]
    if len(files) > 1:
        models = predictions.parse_models(files)
        found, left_out = predictions.compare_predictions(out, models, report, **how)
        table = (found[0]._fields, found) if as_json else (predictions.HEAD, predictions.rows_of(found))
        title, page = f"{len(models)} models", "comparison.html"
    else:
        file = files[0] if files[0] in predictions.BASELINES else predictions.parse_models(files).popitem()[1][0]
        scores, left_out = predictions.score_predictions(out, predictions=file, report_dir=report, **how)
        rows = predictions.band_rows(scores, bounds)
        table = predictions.TABLE_HEAD, rows if as_json else predictions.shown(rows)
        title, page = f"{len(scores)} scores", "predictions.html"
    _tell_left_out("not scored", left_out, activity)
    activity.table(title, *table, as_json=as_json)
    activity.result(*(() if as_json else (report / page,)))
    return bool(left_out)


@options.command(folders=("out",))
def compose(
    sources: list[str] = options.argument(
        "COMPOSITION.toml|SOURCE[:N]",
        "A composition, or sources of scenes and how many of each: a number, a share (0.5) or all.",
    ),
    *,
    out: Path | None = options.output("Data-set root to make (required).", None, "ROOT", "-o"),
    check: bool = options.output("Make nothing: check composed roots for leaks.", False),
    jobs: int = options.JOBS,
    as_json: bool = options.AS_JSON,
    activity: Activity,
) -> bool:
    """Make data-set roots of recorded and generated scenes for training and validation, without leaks.

    With SOURCEs one root is made, split by place, a tenth for validation. A composition can make several, the control
    experiments among them, with other splits, densities, layouts and seeds.
    """
    if check and out is not None:
        raise ConfigError(f"-o {out} does nothing with --check, which makes nothing; leave it out")
    if check:
        return _check([Path(text) for text in sources], activity, jobs=jobs, as_json=as_json)
    if out is None:
        raise ConfigError("missing -o/--out (see hid2 compose --help)")
    from bridge.forecasting.compose import compose as make
    from bridge.forecasting.composition import Composition, composition_of_sources
    from bridge.toml import read_toml_as

    if len(sources) == 1 and sources[0].endswith(".toml"):
        found = read_toml_as(Composition, Path(sources[0]), "a composition")
    else:
        found = composition_of_sources(sources)
    check_scenes([Path(place) for places in found.sources.values() for place in places])
    made = make(found, out, jobs=jobs, on_scene=activity.step)
    _tell_left_out("left out", made.left_out, activity)
    rows = [(name or ".", *counts.values()) for name, counts in made.counts.items()]
    activity.table(f"{out}: scenes", ("data set", "train", "val", "test"), rows, as_json=as_json)
    return bool(made.unread)


def _check(roots: list[Path], activity: Activity, *, jobs: int, as_json: bool) -> bool:
    """Look for leaks; returns whether there are any."""
    check_scenes(roots)
    activity.doing("looking for leaks")
    from bridge.forecasting.compose import check_leaks

    leaks = [leak for root in roots for leak in check_leaks(root, jobs=jobs, on_scene=activity.show)]
    activity.end()
    if as_json:
        print_json(("folder", "other", "why"), leaks)
    else:
        for leak in leaks:
            print(leak.text())
    activity.note(f"{', '.join(map(str, roots))}: {len(leaks) or 'no'} leak{'' if len(leaks) == 1 else 's'}")
    return bool(leaks)


@options.command(reads=("root", "scenes"), folders=("out",))
def forecast(
    root: Path = options.argument("ROOT", "A data-set root with train/ and val/, as compose makes."),
    out: Path = options.output("Folder for checkpoint.pt and predictions.parquet.", ..., "MODEL", "-o"),
    *,
    scenes: Path | None = options.option("Scenes to forecast.", None, "DIR", show_default="ROOT/val"),
    updates: int | None = options.option("Updates of the training.", None, "N", min=1, show_default="300"),
    seed: int = options.option("Seed of weights and batches.", 0, "N", min=0),
    resume: bool = options.running("Go on from MODEL/checkpoint.pt.", False),
    activity: Activity,
) -> bool:
    """Train a small forecaster and write its forecasts of the focal tracks (needs the extra `forecast`).

    VectorNet with six futures: an instrument to compare data sets with, no state of the art.
    """
    from bridge.forecasting.experiment import small_forecaster

    features, network = small_forecaster()
    from bridge.forecasting.predictions import write_forecasts
    from bridge.recordings.sources import find_scenarios
    from hid2.params import Forecasting

    updates = updates or Forecasting().updates
    targets, unread = [], []
    for place in (root / "train", scenes or root / "val"):
        activity.doing(f"reading {place}")
        found, left_out = features.features_of(find_scenarios(place), on_scene=activity.show)
        targets.append(found)
        unread += left_out
        _tell_left_out("not used", left_out, activity)
    if not any(target.focal for target in targets[1]):
        raise ScenarioError(f"{place}: no focal track to forecast")
    activity.doing("training")
    if_interrupted("continue with --resume")
    model = network.train(
        targets[0], out / "checkpoint.pt", updates=updates, seed=seed, resume=resume, on_update=activity.show
    )
    activity.doing("forecasting")
    path = write_forecasts(network.forecast(model, targets[1]), out / "predictions.parquet")
    activity.end()
    print(path)
    return bool(unread)
