"""`hid2 compose` and `forecast`: data sets for forecasters, and a small forecaster to try them with."""

from pathlib import Path

from bridge.cli import options
from bridge.cli.app import command
from bridge.cli.places import check_scenes
from bridge.console import Activity, print_json, say
from bridge.interruption import if_interrupted
from netconvert.errors import ConfigError

#: Lines on what was left out that are shown without -v.
_SHOWN = 10


@command(folders=("out",))
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
) -> int:
    """Make data-set roots of recorded and generated scenes for training and validation, without leaks.

    With SOURCEs one root is made, split by place, a tenth for validation. A composition can make several, the control
    experiments among them, with other splits, densities, layouts and seeds.
    """
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
    shown = len(made.left_out) if activity.verbose else _SHOWN
    for line in made.left_out[:shown]:
        say(f"warning: left out: {line}")
    if len(made.left_out) > shown:
        say(f"warning: left out: {len(made.left_out) - shown} more (-v lists them)")
    activity.table(f"{out}: scenes", ("data set", "train", "val", "test"), made.rows(), as_json=as_json)
    return options.ALL_DONE


def _check(roots: list[Path], activity: Activity, *, jobs: int, as_json: bool) -> int:
    """Look for leaks; returns the exit code."""
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
    return options.SOME_FAILED if leaks else options.ALL_DONE


@command(reads=("root", "scenes"), folders=("out",))
def forecast(
    root: Path = options.argument("ROOT", "A data-set root with train/ and val/, as compose makes."),
    out: Path = options.output("Folder for checkpoint.pt and predictions.parquet.", ..., "MODEL", "-o"),
    *,
    scenes: Path | None = options.option("Scenes to forecast.", None, "DIR", show_default="ROOT/val"),
    updates: int | None = options.option("Updates of the training.", None, "N", min=1, show_default="300"),
    seed: int = options.option("Seed of weights and batches.", 0, "N", min=0),
    resume: bool = options.running("Go on from MODEL/checkpoint.pt.", False),
    activity: Activity,
) -> None:
    """Train a small forecaster and write its forecasts of the focal tracks (needs the extra `forecast`).

    VectorNet with six futures: an instrument to compare data sets with, no state of the art.
    """
    from bridge.forecasting.small_forecaster import small_forecaster

    features, network = small_forecaster()
    from bridge.evaluation.predictions import write_forecasts
    from bridge.recordings.folders import find_scenarios
    from hid2.params import Forecasting

    updates = updates or Forecasting().updates
    targets = []
    for place in (root / "train", scenes or root / "val"):
        activity.doing(f"reading {place}")
        found, left_out = features.features_of(find_scenarios(place), on_scene=activity.show)
        targets.append(found)
        for line in left_out:
            say(f"warning: not used: {line}")
    activity.doing("training")
    if_interrupted("continue with --resume")
    model = network.train(
        targets[0], out / "checkpoint.pt", updates=updates, seed=seed, resume=resume, on_update=activity.show
    )
    activity.doing("forecasting")
    path = write_forecasts(network.forecast(model, targets[1]), out / "predictions.parquet")
    activity.end()
    print(path)
