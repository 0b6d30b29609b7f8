"""`hid2 evaluate`, `study` and `paper`: from scenes to figures and tables."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

import typer

from bridge.cli.app import command
from bridge.cli.options import (
    ALL_DONE,
    INTERRUPTED,
    SOME_FAILED,
    ExperimentName,
    Jobs,
    MapChoice,
    Out,
    Quiet,
    ReadingName,
    Scheduler,
    Stride,
    Timeout,
    Verbose,
    Window,
    output_option,
    prediction_option,
)
from bridge.cli.places import check_out, check_scenes
from bridge.cli.session import set_up, unread_text
from bridge.console import Activity, counted, print_json, print_table, say
from netconvert.errors import ConfigError


@command()
def evaluate(  # noqa: PLR0913  # one for each option
    out: Annotated[
        Path,
        typer.Argument(
            metavar="SCENES",
            help="Scenes to measure, generated or recorded: a scenario folder, a split folder or a root.",
            show_default=False,
        ),
    ],
    report: Annotated[
        Path,
        output_option("-o", "--out", metavar="REPORT", help="Folder for metrics.json, the tables and report.html."),
    ],
    *,
    source: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="The source scenes: before is those of the scenes measured."),
    ] = None,
    control: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Scenes of the same sources with drivers that the critics must tell, as data/configs has them.",
        ),
    ] = None,
    predictions: Annotated[
        list[str],
        typer.Option(
            metavar="[NAME=]FILE|constant-velocity|constant-turn-rate",
            help="Score forecasts instead: a file in av2's submission format, or a baseline; given again: compare the "
            "files, further ones of a NAME being other seeds of it.",
            show_default=False,
        ),
    ] = [],  # noqa: B006  # typer copies it
    bands: Annotated[
        str, typer.Option(metavar="N,N,...", help="With --predictions: bands of scenes with more agents than each N.")
    ] = "50,70,90",
    map_path: MapChoice = None,
    window: Window = 0,
    stride: Stride = None,
    jobs: Jobs = 1,
    as_json: Annotated[
        bool,
        output_option("--json", metavar="", help="With --predictions: print the table as JSON."),
    ] = False,
    verbose: Verbose = 0,
    quiet: Quiet = False,
) -> None:
    """Measure density, diversity, safety, kinematics and realism of any number of scenes, or score forecasts."""
    set_up(verbose=verbose, quiet=quiet)
    check_scenes([out, *(folder for folder in (source, control) if folder)])
    check_out(report)
    if as_json and not predictions:
        raise ConfigError("--json without --predictions: the tables of scenes are files; expected the two together")
    if predictions:
        score = _score if len(predictions) == 1 else _compare
        raise typer.Exit(score(out, predictions, bands, report, jobs=jobs, as_json=as_json, quiet=quiet))
    with Activity(quiet=quiet) as activity:
        from bridge.evaluation.evaluate import evaluate_folder
        from bridge.recordings.folders import Choices

        activity.doing("measuring scenes")

        def show(done: int, total: int) -> None:
            activity.show(done, total)
            if done == total:
                activity.doing("writing the report")

        evaluation = evaluate_folder(
            out,
            report_dir=report,
            source=source,
            choices=Choices(map_path, window, stride),
            control=control,
            jobs=jobs,
            on_scene=show,
        )
        for folder, reason in evaluation.failures:
            activity.message(unread_text(folder, reason))
    if not quiet:
        counts = evaluation.metrics["scenes"]
        made, left_out = counts["generated_vehicles"], len(evaluation.failures)
        say(
            f"{out}: {counted(counts['scenes'], 'scene')} made from {counts['sources']} recorded, with "
            f"{counted(made, 'generated vehicle')}" + (f"; {left_out} not readable, left out" if left_out else "")
        )
        print(report / "report.html")
    raise typer.Exit(SOME_FAILED if evaluation.failures else ALL_DONE)


@command()
def calibrate(
    root: Annotated[
        Path,
        typer.Argument(
            metavar="ROOT", help="Recorded scenes: a scenario folder, a split folder or a root.", show_default=False
        ),
    ],
    out: Annotated[
        Path,
        output_option(
            "-o", "--out", metavar="DRIVERS.toml", help="File to write; tables and a page go beside it."),
    ] = Path("drivers.toml"),
    *,
    without: Annotated[
        list[str],
        typer.Option(
            metavar="ID", help="Leave a scene out, such as one to generate from; repeatable.", show_default=False
        ),
    ] = [],  # noqa: B006
    jobs: Jobs = 1,
    verbose: Verbose = 0,
    quiet: Quiet = False,
) -> None:  # fmt: skip
    """Measure how people drive in recorded scenes, for `hid2 generate --drivers`."""
    set_up(verbose=verbose, quiet=quiet)
    check_scenes([root])
    if out.is_dir():
        raise ConfigError(f"{out}: is a folder, expected a file to write, such as {out / 'drivers.toml'}")
    check_out(out.parent)
    with Activity(quiet=quiet) as activity:
        from bridge.evaluation.calibrate import calibrate_folder

        activity.doing("measuring how people drive")
        found = calibrate_folder(root, out, without=without, jobs=jobs, on_scene=activity.show)
        for folder, reason in found.failures:
            activity.message(unread_text(folder, reason))
    if not quiet:
        print(out)
        print(out.with_name(f"{out.stem}.html"))
    raise typer.Exit(SOME_FAILED if found.failures else ALL_DONE)


@command()
def study(
    file: Annotated[
        Path, typer.Argument(metavar="STUDY.toml", help="The study, as those in data/studies.", show_default=False)
    ],
    out: Out,
    *,
    scenes: Annotated[
        list[Path],
        typer.Option(metavar="SCENE", help="Scenes instead of those in the file; repeatable.", show_default=False),
    ] = [],  # noqa: B006
    jobs: Jobs = 1,
    scheduler: Scheduler = None,
    scene_timeout: Timeout = 300.0,
    verbose: Verbose = 0,
    quiet: Quiet = False,
) -> None:
    """Run a parameter study. Called again, it continues: completed runs are skipped."""
    set_up(verbose=verbose, quiet=quiet)
    if file.is_dir():
        raise ConfigError(f"{file}: is a folder, expected a study in TOML, as those in data/studies")
    check_scenes(scenes)
    check_out(out)
    with Activity(quiet=quiet) as activity:
        from bridge.batch.batch import Options
        from bridge.cli.batch_display import BatchNotes
        from bridge.studies.run import run_study
        from bridge.studies.study import read_study

        options = Options(jobs=jobs, scheduler=scheduler, timeout_s=scene_timeout, resume=True)
        activity.doing("reading the study and its scenes")
        found = read_study(file, scenes=scenes)
        notes = BatchNotes(activity, out, verbose=verbose > 0)
        activity.doing("generating")
        activity.show(0, sum(len(job.runs) for job in found.jobs))
        try:
            report = run_study(found, out, options, on_row=notes.note)
        except KeyboardInterrupt:
            activity.message("interrupted; the same command continues")
            raise typer.Exit(INTERRUPTED) from None
    if not quiet:
        for path in report.files:
            print(path)
    raise typer.Exit(SOME_FAILED if report.failed else ALL_DONE)


@command()
def make(
    what: Annotated[Literal["corridor"], typer.Argument(metavar="WHAT", help="corridor: a straight one-way road.")],
    out: Out,
    *,
    length: Annotated[float, typer.Option(metavar="M", help="Length of the road, m.")] = 600.0,
    lanes: Annotated[int, typer.Option(metavar="N", help="Lanes.")] = 2,
    seconds: Annotated[float, typer.Option(metavar="S", help="Duration of the recording, s.")] = 180.0,
) -> None:
    """Make a synthetic scene for studies; it is no scene of Argoverse, and its id says so."""
    from bridge.recordings.corridor import write_corridor

    assert what == "corridor"
    print(write_corridor(out, length_m=length, lanes=lanes, seconds=seconds))


@command()
def paper(  # noqa: PLR0913  # one for each option
    experiment: Annotated[
        ExperimentName,
        typer.Argument(metavar="EXPERIMENT", help="One of table1, ablation, density, diversity, prediction."),
    ],
    out: Out,
    *,
    scenes: Annotated[
        list[Path],
        typer.Option(
            metavar="DIR",
            help="Recordings; diversity needs real ones of over 40 agents for the paper's part; repeatable.",
        ),
    ] = [Path("data/av2")],  # noqa: B006
    map_path: MapChoice = None,
    window: Window = 0,
    stride: Stride = None,
    seeds: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="Seeds per scene, or of the training.", show_default="10; prediction: 3"),
    ] = None,
    agents: Annotated[int, typer.Option(min=0, metavar="N", help="Vehicles added, except in density.")] = 10,
    variants: Annotated[
        int | None,
        prediction_option(min=1, metavar="K", help="Scenes made of each recorded one.", show_default="8"),
    ] = None,
    val: Annotated[
        float | None,
        prediction_option(
            min=0.01, max=0.9, metavar="SHARE", help="Share of the scenes for validation.", show_default="0.3"
        ),
    ] = None,
    updates: Annotated[
        int | None,
        prediction_option(min=1, metavar="N", help="Updates of each training.", show_default="300"),
    ] = None,
    focal: Annotated[
        ReadingName,
        prediction_option(help="What is forecast in generated scenes; both: by turns."),
    ] = "both",
    composed: Annotated[
        Path | None,
        prediction_option(metavar="ROOT", help="Data sets that compose made, with the controls, instead of new ones."),
    ] = None,
    predictions: Annotated[
        Path | None,
        prediction_option(
            metavar="DIR",
            help="Forecasts from elsewhere instead of the small forecaster's: SET/SEED/VALIDATION.parquet.",
        ),
    ] = None,
    jobs: Jobs = 1,
    verbose: Verbose = 0,
    quiet: Quiet = False,
) -> None:
    """Run an experiment of the paper, from generation to the table beside the paper's; prediction needs `forecast`."""
    set_up(verbose=verbose, quiet=quiet)
    theirs = {"--variants": variants, "--val": val, "--updates": updates, "--composed": composed}
    _check_fits(experiment, {**theirs, "--predictions": predictions}, {"--map": map_path, "--stride": stride})
    check_scenes([*scenes, *([composed] if composed else [])])
    check_out(out)
    if experiment == "prediction" and predictions is None:
        from bridge.forecasting.torch_extra import check_torch

        check_torch()
    with Activity(quiet=quiet) as activity:
        if experiment == "prediction":
            from bridge.forecasting.experiment import Plan, run_prediction
            from hid2.params import Forecasting

            given = {"variants": variants, "val_share": val, "updates": updates}
            params = Forecasting.model_validate({name: value for name, value in given.items() if value is not None})
            page = run_prediction(
                scenes, out, Plan(seeds=seeds or 3, agents=agents, reading=focal, params=params), jobs=jobs,
                composed=composed, predictions=predictions, on_step=activity.step,
            )  # fmt: skip
        else:
            from bridge.evaluation.paper import run_experiment
            from bridge.recordings.folders import Choices

            activity.doing("generating and measuring")
            page = run_experiment(
                experiment, scenes=scenes, out_dir=out, choices=Choices(map_path, window, stride), seeds=seeds or 10,
                agents=agents, jobs=jobs, on_scene=activity.show,
            )  # fmt: skip
    print(page)


def _check_fits(experiment: str, prediction: Mapping[str, object], others: Mapping[str, object]) -> None:
    """Errors: ConfigError for an option of another experiment."""
    wrong = others if experiment == "prediction" else prediction
    given = [name for name, value in wrong.items() if value is not None]
    if given:
        which = "the others" if experiment == "prediction" else "prediction"
        raise ConfigError(f"{given[0]} does nothing in {experiment}, expected it with {which} only")


def _bounds(bands: str) -> list[int]:
    """Errors: ConfigError."""
    try:
        return [int(band) for band in bands.split(",")]
    except ValueError:
        raise ConfigError(f"--bands {bands!r}: expected numbers of agents, joined by commas") from None


def _compare(
    out: Path, predictions: list[str], bands: str, report: Path, *, jobs: int, as_json: bool, quiet: bool
) -> int:
    """Compare files of predictions; returns the exit code."""
    bounds = _bounds(bands)
    with Activity(quiet=quiet) as activity:
        from bridge.forecasting.comparison import HEAD, compare_predictions, parse_models, rows_of

        models = parse_models(predictions)
        activity.doing("scoring forecasts")
        found, left_out = compare_predictions(out, models, report, bounds=bounds, jobs=jobs, on_scene=activity.show)
        for reason in left_out:
            activity.message(f"hid2: warning: not scored: {reason}")
    if as_json:
        print_json(HEAD, rows_of(found))
    elif not quiet:
        print_table(f"{len(models)} models", HEAD, rows_of(found))
        print(report / "comparison.html")
    return SOME_FAILED if left_out else ALL_DONE


def _score(out: Path, files: list[str], bands: str, report: Path, *, jobs: int, as_json: bool, quiet: bool) -> int:
    """Score forecasts; returns the exit code."""
    bounds, (predictions,) = _bounds(bands), files
    with Activity(quiet=quiet) as activity:
        from bridge.evaluation.predictions import BASELINES, TABLE_HEAD, score_predictions

        baseline = next((name for name in BASELINES if name == predictions), None)
        if baseline is None and not Path(predictions).is_file():
            raise ConfigError(
                f"--predictions {predictions}: no such file; expected a forecast file or one of {', '.join(BASELINES)}"
            )
        activity.doing("scoring forecasts")
        scored = score_predictions(
            out,
            predictions=baseline or Path(predictions),
            report_dir=report,
            bounds=bounds,
            jobs=jobs,
            on_scene=activity.show,
        )
        for reason in scored.left_out:
            activity.message(f"hid2: warning: not scored: {reason}")
    if as_json:
        print_json(TABLE_HEAD, scored.rows())
    elif not quiet:
        print_table(f"{len(scored.scores)} scores", TABLE_HEAD, scored.rows())
        print(report / "predictions.html")
    return SOME_FAILED if scored.left_out else ALL_DONE
