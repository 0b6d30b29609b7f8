"""`hid2 evaluate`, `study`, `public` and `paper`: from scenes to figures and tables."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

from bridge.cli import options
from bridge.cli.app import command
from bridge.cli.places import check_out, check_scenes
from bridge.cli.session import tell_unread
from bridge.console import Activity, counted, say
from bridge.files import data_folder
from netconvert.errors import ConfigError


@command(reads=("out", "source", "control"), folders=("report",))
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
    predictions: list[str] = options.option(
        "Score forecasts instead: a file in av2's submission format, or a baseline; given again: compare the "
        "files, further ones of a NAME being other seeds of it.",
        [],
        "[NAME=]FILE|constant-velocity|constant-turn-rate",
    ),
    bands: str = options.option(
        "With --predictions: bands of scenes with more agents than each N.", "50,70,90", "N,N,..."
    ),
    windows: options.Windows,
    jobs: int = options.JOBS,
    as_json: bool = options.output("With --predictions: print the table as JSON.", False, None, "--json"),
    activity: Activity,
) -> int:
    """Measure density, diversity, safety, kinematics and realism of any number of scenes, or score forecasts."""
    if as_json and not predictions:
        raise ConfigError("--json without --predictions: the tables of scenes are files; expected the two together")
    if predictions:
        return _score(out, predictions, bands, report, activity, jobs=jobs, as_json=as_json)
    from bridge.evaluation.evaluate import evaluate_folder

    activity.doing("measuring scenes")

    def show(done: int, total: int) -> None:
        activity.show(done, total)
        if done == total:
            activity.doing("writing the report")

    evaluation = evaluate_folder(
        out, report_dir=report, source=source, choices=windows.choices(), control=control, jobs=jobs, on_scene=show
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
    return options.SOME_FAILED if evaluation.failures else options.ALL_DONE


@command(reads=("scenes",), files=("out",))
def calibrate(
    scenes: list[Path] = options.argument("SCENE...", "Recorded scenes: scenario folders, splits or roots."),
    out: Path = options.output(
        "File to write; tables and a page go beside it.", Path("drivers.toml"), "DRIVERS.toml", "-o"
    ),
    *,
    without: list[str] = options.option("Leave a scene out, such as one to generate from; repeatable.", [], "ID"),
    jobs: int = options.JOBS,
    activity: Activity,
) -> int:
    """Measure how people drive in recorded scenes, for `hid2 generate --drivers`."""
    from bridge.evaluation.calibrate import calibrate_folder

    activity.doing("measuring how people drive")
    failures = calibrate_folder(scenes, out, without=without, jobs=jobs, on_scene=activity.show)
    tell_unread(failures)
    activity.result(out, out.with_name(f"{out.stem}.html"))
    return options.SOME_FAILED if failures else options.ALL_DONE


@command(reads=("scenes",), folders=("out",))
def resimulate(
    scenes: list[Path] = options.argument(
        "SCENE...", "Recorded scenes, two at least: scenario folders, splits or roots."
    ),
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
) -> int:
    """Take recorded vehicles out, drive them by SUMO, and score that as simulated agents are ("WOSAC-like")."""
    from bridge.evaluation.resimulate import Plan, resimulate_folders

    activity.doing("calibrating and driving")
    plan = Plan(seeds, take_out, min(write, seeds), seed)
    failures = resimulate_folders(scenes, out, plan, jobs=jobs, on_scene=activity.show)
    tell_unread(failures)
    activity.result(out / "resimulation.html")
    return options.SOME_FAILED if failures else options.ALL_DONE


@command(reads=("scenes",), folders=("out",))
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
) -> int:
    """Run a parameter study. Called again, it continues: completed runs are skipped."""
    from bridge.batch.batch import Options
    from bridge.cli.batch_display import notes_of
    from bridge.studies.run import run_study
    from bridge.studies.study import read_study

    how = Options(jobs=batch.jobs, scheduler=batch.scheduler, timeout_s=batch.scene_timeout, resume=True)
    activity.doing("reading the study and its scenes")
    found = read_study(file, scenes=scenes)
    if plan is not None:
        from bridge.studies.plan import plan_text

        activity.doing("drawing the first run")
        lines = list(plan_text(found, out, plan))
        activity.end()
        print(*lines, sep="\n")
        return options.ALL_DONE
    activity.doing("driving")
    activity.show(0, sum(len(job.runs) for job in found.jobs))
    report = run_study(found, out, how, trj=trj, on_row=notes_of(activity, out, go_on="the same command continues"))
    activity.result(*report.files)
    return options.SOME_FAILED if report.failed else options.ALL_DONE


@command(folders=("out",))
def public(
    file: Path = options.argument("PAGE.toml", "Roads, published counts and rules, as data/public/ngsim.toml."),
    out: Path = options.OUT,
    *,
    batch: options.Batch,
    activity: Activity,
) -> int:
    """Lane changes on public roads, published beside simulated, for rules untuned and tuned. Can be continued."""
    from bridge.batch.batch import Options
    from bridge.cli.batch_display import notes_of
    from bridge.studies.public_roads import read_public, run_public

    how = Options(jobs=batch.jobs, scheduler=batch.scheduler, timeout_s=batch.scene_timeout)
    page = read_public(file)
    activity.doing("driving roads")
    report = run_public(page, out, how, on_row=notes_of(activity, out, go_on="the same command continues"))
    activity.note(
        f"{counted(report.runs, 'run')} that took {report.seconds:.0f} s in all, {report.failed or 'none'} failed"
    )
    activity.result(*report.files)
    return options.SOME_FAILED if report.failed else options.ALL_DONE


@command(folders=("out",))
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
        raise ConfigError(
            f"{option} {value:g}: {road.name} has its own; leave {option} out, or edit a copy of the file"
        )
    print(write_road(out, road))


@command()
def paper(  # noqa: PLR0913  # one for each option
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
    windows: options.Windows,
    seeds: int | None = options.option(
        "Seeds per scene, or of the training.", None, "N", min=1, show_default="10; prediction: 3"
    ),
    agents: int = options.option("Vehicles added, except in density.", 10, "N", min=0),
    variants: int | None = options.prediction("Scenes made of each recorded one.", None, "K", min=1, show_default="8"),
    val: float | None = options.prediction(
        "Share of the scenes for validation.", None, "SHARE", min=0.01, max=0.9, show_default="0.3"
    ),
    updates: int | None = options.prediction("Updates of each training.", None, "N", min=1, show_default="300"),
    focal: options.ReadingName = options.prediction("What is forecast in generated scenes; both: by turns.", "both"),
    composed: Path | None = options.prediction(
        "Data sets that compose made, with the controls, instead of new ones.", None, "ROOT"
    ),
    predictions: Path | None = options.prediction(
        "Forecasts from elsewhere instead of the small forecaster's: SET/SEED/VALIDATION.parquet.", None, "DIR"
    ),
    jobs: int = options.JOBS,
    activity: Activity,
) -> None:
    """Run an experiment of the paper, from generation to the table beside the paper's; prediction needs `forecast`."""
    theirs = {"--variants": variants, "--val": val, "--updates": updates, "--composed": composed}
    others = {"--map": windows.map_path, "--stride": windows.stride}
    _check_fits(experiment, {**theirs, "--predictions": predictions}, others)
    check_scenes([*scenes, *([composed] if composed else [])])
    check_out(out)
    if experiment == "prediction":
        from bridge.forecasting.experiment import Plan, run_prediction
        from hid2.params import Forecasting

        given = {"variants": variants, "val_share": val, "updates": updates}
        params = Forecasting.model_validate({name: value for name, value in given.items() if value is not None})
        page = run_prediction(
            scenes, out, Plan(seeds=seeds or 3, agents=agents, reading=focal, params=params), jobs=jobs,
            composed=composed, predictions=predictions, on_step=activity.step
        )  # fmt: skip
    else:
        from bridge.evaluation.paper import run_experiment

        activity.doing("generating and measuring")
        page = run_experiment(
            experiment, scenes=scenes, out_dir=out, choices=windows.choices(), seeds=seeds or 10,
            agents=agents, jobs=jobs, on_scene=activity.show
        )  # fmt: skip
    activity.end()
    print(page)


def _check_fits(experiment: str, prediction: Mapping[str, object], others: Mapping[str, object]) -> None:
    """Errors: ConfigError for an option of another experiment."""
    wrong = others if experiment == "prediction" else prediction
    given = [name for name, value in wrong.items() if value is not None]
    if given:
        which = "the others" if experiment == "prediction" else "prediction"
        raise ConfigError(f"{given[0]} does nothing in {experiment}, expected it with {which} only")


def _score(
    out: Path, files: list[str], bands: str, report: Path, activity: Activity, *, jobs: int, as_json: bool
) -> int:
    """Score forecasts, or compare those of several files; returns the exit code."""
    try:
        bounds = [int(band) for band in bands.split(",")]
    except ValueError:
        raise ConfigError(f"--bands {bands!r}: expected numbers of agents, joined by commas") from None
    from bridge.evaluation.predictions import TABLE_HEAD, score_predictions

    activity.doing("scoring forecasts")
    head: Sequence[str]
    left_out: Sequence[str]
    if len(files) > 1:
        from bridge.forecasting.comparison import HEAD, compare_predictions, parse_models, rows_of

        models = parse_models(files)
        found, left_out = compare_predictions(out, models, report, bounds=bounds, jobs=jobs, on_scene=activity.show)
        title, head, rows, page = f"{len(models)} models", HEAD, rows_of(found), "comparison.html"
    else:
        (file,) = files
        scored = score_predictions(
            out, predictions=file, report_dir=report, bounds=bounds, jobs=jobs, on_scene=activity.show
        )
        left_out, title, head = scored.left_out, f"{len(scored.scores)} scores", TABLE_HEAD
        rows, page = scored.rows(), "predictions.html"
    for reason in left_out:
        say(f"warning: not scored: {reason}")
    activity.table(title, head, rows, as_json=as_json)
    activity.result(*(() if as_json else (report / page,)))
    return options.SOME_FAILED if left_out else options.ALL_DONE
