"""`hid2 evaluate`, `study`, `public` and `paper`: from scenes to figures and tables."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

from bridge.cli import options
from bridge.cli.app import command
from bridge.cli.places import check_out, check_out_file, check_scenes
from bridge.cli.session import tell_unread
from bridge.console import Activity, counted, print_json, print_table, say
from netconvert.errors import ConfigError


@command()
def evaluate(  # one for each option
    out: Path = options.argument(
        "SCENES", "Scenes to measure, generated or recorded: a scenario folder, a split folder or a root."
    ),
    report: Path = options.output("Folder for metrics.json, the tables and report.html.", ..., "REPORT", "-o", "--out"),
    *,
    source: Path | None = options.option("The source scenes: before is those of the scenes measured.", None, "DIR"),
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
    tell: options.Tell,
) -> int:
    """Measure density, diversity, safety, kinematics and realism of any number of scenes, or score forecasts."""
    check_scenes([out, *(folder for folder in (source, control) if folder)])
    check_out(report)
    if as_json and not predictions:
        raise ConfigError("--json without --predictions: the tables of scenes are files; expected the two together")
    if predictions:
        return _score(out, predictions, bands, report, jobs=jobs, as_json=as_json, quiet=tell.quiet)
    with Activity(quiet=tell.quiet) as activity:
        from bridge.evaluation.evaluate import evaluate_folder

        activity.doing("measuring scenes")

        def show(done: int, total: int) -> None:
            activity.show(done, total)
            if done == total:
                activity.doing("writing the report")

        evaluation = evaluate_folder(
            out,
            report_dir=report,
            source=source,
            choices=windows.choices(),
            control=control,
            jobs=jobs,
            on_scene=show,
        )
        tell_unread(evaluation.failures)
    if not tell.quiet:
        counts = evaluation.metrics["scenes"]
        made, left_out = counts["generated_vehicles"], len(evaluation.failures)
        say(
            f"{out}: {counted(counts['scenes'], 'scene')} made from {counts['sources']} recorded, with "
            f"{counted(made, 'generated vehicle')}" + (f"; {left_out} not readable, left out" if left_out else "")
        )
        print(report / "report.html")
    return options.SOME_FAILED if evaluation.failures else options.ALL_DONE


@command()
def calibrate(
    root: Path = options.argument("ROOT", "Recorded scenes: a scenario folder, a split folder or a root."),
    out: Path = options.output(
        "File to write; tables and a page go beside it.", Path("drivers.toml"), "DRIVERS.toml", "-o"
    ),
    *,
    without: list[str] = options.option("Leave a scene out, such as one to generate from; repeatable.", [], "ID"),
    jobs: int = options.JOBS,
    tell: options.Tell,
) -> int:
    """Measure how people drive in recorded scenes, for `hid2 generate --drivers`."""
    check_scenes([root])
    check_out_file(out)
    with Activity(quiet=tell.quiet) as activity:
        from bridge.evaluation.calibrate import calibrate_folder

        activity.doing("measuring how people drive")
        found = calibrate_folder(root, out, without=without, jobs=jobs, on_scene=activity.show)
        tell_unread(found.failures)
    if not tell.quiet:
        print(out)
        print(out.with_name(f"{out.stem}.html"))
    return options.SOME_FAILED if found.failures else options.ALL_DONE


@command()
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
    tell: options.Tell,
) -> int:
    """Run a parameter study. Called again, it continues: completed runs are skipped."""
    check_scenes(scenes)
    check_out(out)
    with Activity(quiet=tell.quiet) as activity:
        from bridge.batch.batch import Options
        from bridge.cli.batch_display import BatchNotes
        from bridge.studies.run import run_study
        from bridge.studies.study import read_study

        how = Options(jobs=batch.jobs, scheduler=batch.scheduler, timeout_s=batch.scene_timeout, resume=True)
        activity.doing("reading the study and its scenes")
        found = read_study(file, scenes=scenes)
        if plan is not None:
            from bridge.studies.plan import plan_text

            activity.doing("drawing the first run")
            for line in plan_text(found, out, plan):
                print(line)
            return options.ALL_DONE
        notes = BatchNotes(activity, out, go_on="the same command continues", verbose=tell.verbose > 0)
        activity.doing("generating")
        activity.show(0, sum(len(job.runs) for job in found.jobs))
        report = run_study(found, out, how, trj=trj, on_row=notes.note)
    if not tell.quiet:
        for path in report.files:
            print(path)
    return options.SOME_FAILED if report.failed else options.ALL_DONE


@command()
def public(
    file: Path = options.argument("PAGE.toml", "Roads, published counts and rules, as data/public/ngsim.toml."),
    out: Path = options.OUT,
    *,
    batch: options.Batch,
    tell: options.Tell,
) -> int:
    """Lane changes on public roads, published beside simulated, for rules untuned and tuned. Can be continued."""
    check_out(out)
    with Activity(quiet=tell.quiet) as activity:
        from bridge.batch.batch import Options
        from bridge.cli.batch_display import BatchNotes
        from bridge.studies.public_roads import read_public, run_public

        how = Options(jobs=batch.jobs, scheduler=batch.scheduler, timeout_s=batch.scene_timeout)
        page = read_public(file)
        activity.doing("driving roads")
        notes = BatchNotes(activity, out, go_on="the same command continues", verbose=tell.verbose > 0)
        report = run_public(page, out, how, on_row=notes.note)
    if not tell.quiet:
        say(f"{counted(report.runs, 'run')} that took {report.seconds:.0f} s in all, {report.failed or 'none'} failed")
        for path in report.files:
            print(path)
    return options.SOME_FAILED if report.failed else options.ALL_DONE


@command()
def make(
    what: Literal["corridor"] = options.argument("WHAT", "corridor: a straight one-way road."),
    out: Path = options.OUT,
    *,
    road: Path | None = options.option(
        "A road with ramps and traffic of its own instead, as those in data/public.", None, "ROAD.toml"
    ),
    length: float = options.option("Length of the road, m.", 600.0, "M"),
    lanes: int = options.option("Lanes.", 2, "N"),
    seconds: float = options.option("Duration of the recording, s.", 180.0, "S"),
) -> None:
    """Make a synthetic scene for studies; it is no scene of Argoverse, and its id says so."""
    check_out(out)
    from bridge.recordings.corridor import write_corridor, write_road

    assert what == "corridor"
    print(write_road(out, road) if road else write_corridor(out, length_m=length, lanes=lanes, seconds=seconds))


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
    tell: options.Tell,
) -> None:
    """Run an experiment of the paper, from generation to the table beside the paper's; prediction needs `forecast`."""
    theirs = {"--variants": variants, "--val": val, "--updates": updates, "--composed": composed}
    others = {"--map": windows.map_path, "--stride": windows.stride}
    _check_fits(experiment, {**theirs, "--predictions": predictions}, others)
    check_scenes([*scenes, *([composed] if composed else [])])
    check_out(out)
    if experiment == "prediction" and predictions is None:
        from bridge.forecasting.small_forecaster import check_forecaster

        check_forecaster()
    with Activity(quiet=tell.quiet) as activity:
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
    print(page)


def _check_fits(experiment: str, prediction: Mapping[str, object], others: Mapping[str, object]) -> None:
    """Errors: ConfigError for an option of another experiment."""
    wrong = others if experiment == "prediction" else prediction
    given = [name for name, value in wrong.items() if value is not None]
    if given:
        which = "the others" if experiment == "prediction" else "prediction"
        raise ConfigError(f"{given[0]} does nothing in {experiment}, expected it with {which} only")


def _score(out: Path, files: list[str], bands: str, report: Path, *, jobs: int, as_json: bool, quiet: bool) -> int:
    """Score forecasts, or compare those of several files; returns the exit code."""
    try:
        bounds = [int(band) for band in bands.split(",")]
    except ValueError:
        raise ConfigError(f"--bands {bands!r}: expected numbers of agents, joined by commas") from None
    head: Sequence[str]
    left_out: Sequence[str]
    with Activity(quiet=quiet) as activity:
        from bridge.evaluation.predictions import BASELINES, TABLE_HEAD, score_predictions

        if len(files) > 1:
            from bridge.forecasting.comparison import HEAD, compare_predictions, parse_models, rows_of

            models = parse_models(files)
            activity.doing("scoring forecasts")
            found, left_out = compare_predictions(out, models, report, bounds=bounds, jobs=jobs, on_scene=activity.show)
            title, head, rows, page = f"{len(models)} models", HEAD, rows_of(found), "comparison.html"
        else:
            (file,) = files
            baseline = next((name for name in BASELINES if name == file), None)
            if baseline is None and not Path(file).is_file():
                raise ConfigError(
                    f"--predictions {file}: no such file; expected a forecast file or one of {', '.join(BASELINES)}"
                )
            activity.doing("scoring forecasts")
            scored = score_predictions(
                out, predictions=baseline or Path(file), report_dir=report, bounds=bounds, jobs=jobs,
                on_scene=activity.show,
            )  # fmt: skip
            left_out, title, head = scored.left_out, f"{len(scored.scores)} scores", TABLE_HEAD
            rows, page = scored.rows(), "predictions.html"
        for reason in left_out:
            say(f"warning: not scored: {reason}")
    if as_json:
        print_json(head, rows)
    elif not quiet:
        print_table(title, head, rows)
        print(report / page)
    return options.SOME_FAILED if left_out else options.ALL_DONE
