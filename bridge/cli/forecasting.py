"""`hid2 compose` and `forecast`: data sets for forecasters, and a small forecaster to try them with."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from bridge.cli.app import command
from bridge.cli.options import (
    ALL_DONE,
    SOME_FAILED,
    AsJson,
    Jobs,
    Quiet,
    Verbose,
    output_option,
    running_option,
    selection_option,
)
from bridge.cli.places import check_among_sources, check_out, check_scenes
from bridge.cli.session import set_up
from bridge.console import Activity, print_json, print_table, say
from netconvert.errors import ConfigError

Layout = StrEnum("Layout", ["AV2", "QCNET"])
SplitBy = StrEnum("SplitBy", ["PLACE", "FOLDER"])
CountIn = StrEnum("CountIn", ["ALL", "OBSERVED"])
#: Lines on what was left out that are shown without -v.
_SHOWN = 10


@command()
def compose(  # noqa: PLR0913  # one for each option
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="COMPOSITION.toml|SOURCE[:N]",
            help="A composition, or sources of scenes and how many of each: a number, a share (0.5) or all.",
            show_default=False,
        ),
    ],
    *,
    out: Annotated[
        Path | None,
        output_option("-o", "--out", metavar="ROOT", help="Data-set root to make (required)."),
    ] = None,
    check: Annotated[
        bool,
        output_option("--check", metavar="", help="Make nothing: check composed roots for leaks."),
    ] = False,
    layout: Annotated[
        Layout | None,
        output_option(help="<split>/<id> or <split>/raw/<id>.", show_default="av2, or that of the file"),
    ] = None,
    split_by: Annotated[
        SplitBy,
        selection_option(help="Split SOURCEs by place, or by the folders they lie in."),
    ] = SplitBy.PLACE,
    val: Annotated[float, selection_option(min=0, max=0.9, metavar="SHARE", help="Share for validation.")] = 0.1,
    test: Annotated[float, selection_option(min=0, max=0.9, metavar="SHARE", help="Share for test.")] = 0.0,
    min_agents: Annotated[int, selection_option(min=0, metavar="N", help="Only scenes with at least N tracks.")] = 0,
    min_agents_in: Annotated[
        CountIn,
        selection_option(help="Tracks in all, or those at the observation's end."),
    ] = CountIn.ALL,
    seed: Annotated[
        int | None,
        selection_option(min=0, metavar="N", help="Seed of the draw.", show_default="0, or that of the file"),
    ] = None,
    jobs: Jobs = 1,
    as_json: AsJson = False,
    verbose: Verbose = 0,
    quiet: Quiet = False,
) -> None:
    """Make data-set roots of recorded and generated scenes for training and validation, without leaks.

    With SOURCEs one root is made; a composition can make several, the control experiments among them.
    """
    set_up(verbose=verbose, quiet=quiet)
    if check:
        raise typer.Exit(_check([Path(text) for text in sources], jobs=jobs, as_json=as_json, quiet=quiet))
    if out is None:
        raise ConfigError("missing -o/--out (see hid2 compose --help)")
    check_among_sources(out)
    with Activity(quiet=quiet) as activity:
        from bridge.forecasting.compose import compose as make
        from bridge.forecasting.composition import Split, composition_of, composition_of_sources, read_composition

        if len(sources) == 1 and sources[0].endswith(".toml"):
            found = read_composition(Path(sources[0]))
            changes: dict[str, object] = {"seed": seed, "layout": str(layout) if layout else None}
            found = found.model_copy(update={key: value for key, value in changes.items() if value is not None})
        else:
            checked = composition_of(
                {"sources": {"a": ("b",)}, "sets": {"c": {}}, "split": {"val": val, "test": test}}, "split"
            )
            found = composition_of_sources(
                sources,
                split=Split(by=split_by.value, val=checked.split.val, test=checked.split.test),  # type: ignore[arg-type]
                seed=seed or 0,
                layout=(layout or Layout.AV2).value,  # type: ignore[arg-type]
                min_agents=min_agents,
                min_agents_in=min_agents_in.value,  # type: ignore[arg-type]
            )
        check_scenes([Path(place) for places in found.sources.values() for place in places])

        made = make(found, out, jobs=jobs, on_scene=activity.step)
        for line in made.left_out[: None if verbose else _SHOWN]:
            activity.message(f"hid2: warning: left out: {line}")
        if len(made.left_out) > _SHOWN and not verbose:
            activity.message(f"hid2: warning: left out: {len(made.left_out) - _SHOWN} more (-v lists them)")
    head = ("data set", "train", "val", "test")
    if as_json:
        print_json(head, made.rows())
    elif not quiet:
        print_table(f"{out}: scenes", head, made.rows())
    raise typer.Exit(ALL_DONE)


def _check(roots: list[Path], *, jobs: int, as_json: bool, quiet: bool) -> int:
    """Look for leaks; returns the exit code."""
    check_scenes(roots)
    leaks = []
    with Activity("looking for leaks", quiet=quiet) as activity:
        from bridge.forecasting.compose import check_leaks

        for root in roots:
            leaks += check_leaks(root, jobs=jobs, on_scene=activity.show)
    if as_json:
        print_json(("folder", "other", "why"), leaks)
    else:
        for leak in leaks:
            print(leak.text())
    if not quiet:
        say(f"{', '.join(map(str, roots))}: {len(leaks) or 'no'} leak{'' if len(leaks) == 1 else 's'}")
    return SOME_FAILED if leaks else ALL_DONE


@command()
def forecast(
    root: Annotated[
        Path,
        typer.Argument(
            metavar="ROOT", help="A data-set root with train/ and val/, as compose makes.", show_default=False
        ),
    ],
    out: Annotated[
        Path,
        output_option("-o", "--out", metavar="MODEL", help="Folder for checkpoint.pt and predictions.parquet."),
    ],
    *,
    scenes: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Scenes to forecast.", show_default="ROOT/val"),
    ] = None,
    updates: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Updates of the training.", show_default="300")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Seed of weights and batches.")] = 0,
    resume: Annotated[
        bool,
        running_option("--resume", metavar="", help="Go on from MODEL/checkpoint.pt."),
    ] = False,
    verbose: Verbose = 0,
    quiet: Quiet = False,
) -> None:
    """Train a small forecaster and write its forecasts of the focal tracks (needs the extra `forecast`).

    VectorNet with six futures: an instrument to compare data sets with, no state of the art.
    """
    set_up(verbose=verbose, quiet=quiet)
    check_scenes([root, *([scenes] if scenes else [])])
    check_out(out)
    from bridge.forecasting.torch_extra import check_torch

    check_torch()
    with Activity(quiet=quiet) as activity:
        from bridge.evaluation.predictions import write_forecasts
        from bridge.forecasting.features import features_of
        from bridge.forecasting.training import be_deterministic, train
        from bridge.forecasting.training import forecast as predict
        from bridge.recordings.folders import find_scenarios
        from hid2.params import Forecasting

        params = Forecasting() if updates is None else Forecasting(updates=updates)
        targets = []
        for place in (root / "train", scenes or root / "val"):
            activity.doing(f"reading {place}")
            found, left_out = features_of(find_scenarios(place), params, on_scene=activity.show)
            targets.append(found)
            for line in left_out:
                activity.message(f"hid2: warning: not used: {line}")
        activity.doing("training")
        be_deterministic(1)
        model = train(targets[0], out / "checkpoint.pt", params, seed=seed, resume=resume, on_update=activity.show)
        activity.doing("forecasting")
        path = write_forecasts(predict(model, targets[1], params), out / "predictions.parquet")
    print(path)
