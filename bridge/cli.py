"""The command `hid2`. Every command is a thin shell round a function of the package; imports wait until one is called.

Exit codes: 0 all done, 1 some scene could not be done, 2 usage or configuration, 130 interrupted. Results go to stdout,
messages to stderr.
"""

import io
import logging
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from netconvert.errors import ConfigError, Hid2Error

if TYPE_CHECKING:
    from bridge.batch.scan import Selection

ALL_DONE, SOME_FAILED, USAGE, INTERRUPTED = 0, 1, 2, 130

app = typer.Typer(
    name="hid2",
    help="Dense traffic and rare manoeuvres for Argoverse 2 scenes, driven by SUMO (HiD2).",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

Scenes = Annotated[
    list[Path], typer.Argument(help="Scenario folder, split folder or data-set root; several may be given.")
]
Scene = Annotated[Path, typer.Argument(help="Scenario folder.")]
Out = Annotated[Path, typer.Option("-o", "--out", help="Folder to write to.")]
Jobs = Annotated[int, typer.Option("--jobs", "-j", min=1, help="Worker processes on this machine.")]
Scheduler = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="Use a running Dask scheduler, tcp://HOST:PORT.")
]
ConfigFile = Annotated[
    Path | None, typer.Option("--config", metavar="FILE.toml", help="Parameters, as `hid2 config` lists them.")
]
Settings = Annotated[
    list[str], typer.Option("--set", metavar="KEY=VALUE", help="One parameter, section.key=value; repeatable.")
]
Timeout = Annotated[
    float, typer.Option("--scene-timeout", min=1, metavar="S", help="Seconds a scene may take before it is ended.")
]
Memory = Annotated[
    int, typer.Option("--scene-memory", min=500, metavar="MB", help="Memory a scene may take before it is given up.")
]
Resume = Annotated[bool, typer.Option("--resume", help="Skip what is complete and unchanged.")]
Verbose = Annotated[bool, typer.Option("-v", "--verbose", help="Say more.")]
Quiet = Annotated[bool, typer.Option("-q", "--quiet", help="Say only what went wrong.")]
MinAgents = Annotated[int, typer.Option(min=0, help="Only scenes with at least this many recorded tracks.")]
City = Annotated[list[str], typer.Option(help="Only scenes of this city; repeatable.")]
Split = Annotated[list[str], typer.Option(help="Only scenes of this split (train, val, test); repeatable.")]
Can = Annotated[list[str], typer.Option(help="Only maps with room for this manoeuvre (lane_change, ...); repeatable.")]
Sample = Annotated[int | None, typer.Option(min=1, metavar="N", help="N of the selected scenes, drawn with the seed.")]


@app.command()
def generate(
    *,
    scenes: Annotated[list[Path] | None, typer.Argument(help="Scenario, split or data-set folders.")] = None,
    out: Annotated[Path | None, typer.Option("-o", "--out", help="Folder to write to.")] = None,
    agents: Annotated[str | None, typer.Option(metavar="N|max", help="Vehicles to insert into each scene.")] = None,
    behaviours: Annotated[
        str | None,
        typer.Option(metavar="NAME=SHARE,...", help="straight, left_turn, right_turn, lane_change, overtake."),
    ] = None,
    trigger_time: Annotated[
        str | None, typer.Option(metavar="S|A:B", help="When manoeuvres are triggered: seconds, or a range.")
    ] = None,
    variants: Annotated[int | None, typer.Option(min=1, metavar="K", help="Scenes written per source scene.")] = None,
    focal: Annotated[
        str | None, typer.Option(metavar="recorded|generated", help="Which track is the focal one.")
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of every random choice.")] = None,
    spawn_leaders: Annotated[
        bool | None, typer.Option(help="May an overtake without a slower leader spawn one?")
    ] = None,
    without: Annotated[
        list[str],
        typer.Option(metavar="topology|collision|smoothing", help="Ablation: leave a component out; repeatable."),
    ] = [],  # noqa: B006  # typer copies it
    config: ConfigFile = None,
    settings: Settings = [],  # noqa: B006
    min_agents: MinAgents = 0,
    city: City = [],  # noqa: B006
    split: Split = [],  # noqa: B006
    can: Can = [],  # noqa: B006
    sample: Sample = None,
    jobs: Jobs = 1,
    scheduler: Scheduler = None,
    scene_timeout: Timeout = 300.0,
    resume: Resume = False,
    scene_memory: Memory = 4000,
    repro: Annotated[Path | None, typer.Option(metavar="BUNDLE", help="Run a quarantined scene again.")] = None,
    function: Annotated[
        str | None,
        typer.Option(metavar="MODULE:NAME", help="With --repro: a function of yours that the bundle may ask for."),
    ] = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Write denser scenes: insert vehicles with the behaviours asked for, beside the recorded ones."""
    _set_up(verbose=verbose, quiet=quiet)
    if repro is not None:
        raise typer.Exit(_reproduce(repro, out, function))
    if not scenes or out is None:
        raise typer.BadParameter("want SCENE... and -o OUT (or --repro BUNDLE)")
    from bridge.batch.scan import Selection
    from bridge.config import load_config, parse_behaviours, parse_trigger_time

    flags: dict[str, object] = {
        "request.agents": None if agents is None else _agents(agents),
        "request.variants": variants,
        "request.focal": focal,
        "request.seed": seed,
        "request.spawn_leaders": spawn_leaders,
        "without": [part for text in without for part in text.split(",")] or None,
    }
    flags |= parse_behaviours(behaviours) if behaviours is not None else {}
    flags |= parse_trigger_time(trigger_time) if trigger_time is not None else {}
    resolved = load_config(config, settings, {key: value for key, value in flags.items() if value is not None})
    selection = Selection(min_agents, tuple(city), tuple(split), tuple(can), sample, resolved.request.seed)
    folders = _select(scenes, selection, jobs=jobs, quiet=quiet)

    from bridge.batch.batch import Options, plan, run_batch
    from bridge.batch.manifest import DONE
    from bridge.console import BatchDisplay, print_batch, say

    options = Options(jobs=jobs, scheduler=scheduler, timeout_s=scene_timeout, resume=resume, memory_mb=scene_memory)
    try:
        with BatchDisplay(quiet=quiet, verbose=verbose) as display:
            rows = run_batch(plan(folders, resolved), out, options, on_row=display.note)
    except KeyboardInterrupt:
        say(f"interrupted; what is done is in {out / 'manifest.csv'}, go on with --resume")
        raise typer.Exit(INTERRUPTED) from None
    if not quiet:
        print_batch(rows)
        for row in rows if len(rows) <= _SHOWN_PATHS else []:
            if row.folder:
                print(out / row.folder)
        print(out / "manifest.csv")
    raise typer.Exit(ALL_DONE if all(row.status == DONE for row in rows) else SOME_FAILED)


#: Batches up to this size list every folder that was written.
_SHOWN_PATHS = 24


@app.command()
def net(scene: Scene, out: Out, *, verbose: Verbose = False, quiet: Quiet = False) -> None:
    """Write the lane graph as a SUMO net of 4 m cells, with files to play the scene in sumo-gui, and a report."""
    _set_up(verbose=verbose, quiet=quiet)
    from bridge.console import print_table
    from bridge.sumo.net import convert
    from bridge.sumo.playback import write_playable

    report = convert(scene, out)
    playable = write_playable(scene, out) if any(scene.glob("scenario_*.parquet")) else None
    if not quiet:
        print_table(f"{scene.name}: fidelity of the net", ("what", "value"), report.rows())
        if playable is not None:
            print(f"to play it: sumo-gui -c {playable}")


@app.command()
def validate(
    out: Annotated[Path, typer.Argument(help="Generated scenes: a scenario folder, a split or a root.")],
    *,
    source: Annotated[
        Path | None, typer.Option(help="Where the source scenes are, to compare recorded tracks.")
    ] = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Check that scenes keep the whole contract with their readers; findings go to stdout."""
    _set_up(verbose=verbose, quiet=quiet)
    from bridge.console import say
    from bridge.recordings.validate import validate_folder

    findings = validate_folder(out, source=source)
    for finding in findings:
        print(f"{finding.file}: {finding.rule}: {finding.message}")
    wrong = sum(not finding.is_note for finding in findings)
    if not quiet:
        noted = len(findings) - wrong
        notes = f", {noted} note{'' if noted == 1 else 's'} on recorded tracks" if noted else ""
        say(f"{out}: {wrong or 'no'} finding{'' if wrong == 1 else 's'}{notes}")
    raise typer.Exit(SOME_FAILED if wrong else ALL_DONE)


@app.command()
def evaluate(
    out: Annotated[Path, typer.Argument(help="Scenes to measure, generated or recorded: a folder, a split or a root.")],
    report: Annotated[Path, typer.Option("-o", "--out", help="Folder for metrics.json, the tables and report.html.")],
    *,
    source: Annotated[Path | None, typer.Option(help="Where the source scenes are, for before and after.")] = None,
    predictions: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|constant-velocity|constant-turn-rate",
            help="Score forecasts instead: a file in av2's submission format, or a baseline.",
        ),
    ] = None,
    bands: Annotated[
        str, typer.Option(metavar="N,N,...", help="With --predictions: scenes of more agents than these.")
    ] = "50,70,90",
    jobs: Jobs = 1,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Measure density, diversity, safety, kinematics and realism of any number of scenes, or score forecasts."""
    _set_up(verbose=verbose, quiet=quiet)
    if predictions is not None:
        raise typer.Exit(_score(out, predictions, bands, report, quiet=quiet))
    from bridge.console import Counter, say
    from bridge.evaluation.evaluate import evaluate_folder

    with Counter("measuring", quiet=quiet) as counter:
        evaluation = evaluate_folder(out, report_dir=report, source=source, jobs=jobs, on_scene=counter.show)
    for folder, reason in evaluation.failures:
        say(_about(folder, reason))
    if not quiet:
        print(report / "report.html")
    raise typer.Exit(SOME_FAILED if evaluation.failures else ALL_DONE)


@app.command()
def render(
    scene: Scene,
    out: Annotated[Path, typer.Option("-o", "--out", help="File to write: .png, .gif or .mp4.")],
    *,
    source: Annotated[Path | None, typer.Option(help="The source scene, shown before the generated one.")] = None,
    agent: Annotated[str | None, typer.Option(metavar="ID", help="Show the surroundings of this track.")] = None,
    cells: Annotated[bool, typer.Option("--cells", help="Show the cells of the lanes.")] = False,
    step: Annotated[
        int | None, typer.Option(min=0, help="Timestep of a picture; the last observed one by default.")
    ] = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Draw a scene from above, before and after: a picture or a film."""
    _set_up(verbose=verbose, quiet=quiet)
    from bridge.pictures.render import render_scene

    print(render_scene(scene, out, source=source, agent=agent, cells=cells, step=step))


@app.command()
def plot(
    scene: Scene,
    out: Annotated[Path, typer.Option("-o", "--out", help="File to write: .png.")],
    agent: Annotated[str, typer.Option(metavar="ID", help="The track, for example gen_0.")],
    *,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Draw one track over time: speed, acceleration, jerk, lateral offset and cells, with its manoeuvres marked."""
    _set_up(verbose=verbose, quiet=quiet)
    from bridge.pictures.plot import plot_agent

    print(plot_agent(scene, agent, out))


@app.command()
def gui(
    scene: Scene,
    *,
    delay: Annotated[int, typer.Option(min=0, metavar="MS", help="Wait between steps of 0.1 s.")] = 100,
    screenshot: Annotated[Path | None, typer.Option(metavar="FILE.png", help="Take a picture and close.")] = None,
    step: Annotated[
        int | None, typer.Option(min=0, help="Timestep of the picture; the last observed one by default.")
    ] = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Play a scene in sumo-gui: recorded vehicles grey, generated ones coloured by policy (needs the extra `gui`)."""
    _set_up(verbose=verbose, quiet=quiet)
    from bridge.sumo.gui import play_scene

    picture = play_scene(scene, delay_ms=delay, screenshot=screenshot, step=step)
    if picture is not None:
        print(picture)


@app.command("config")
def show_config(
    *,
    config: ConfigFile = None,
    settings: Settings = [],  # noqa: B006
    toml: Annotated[bool, typer.Option("--toml", help="Print the resolved configuration as a TOML file.")] = False,
) -> None:
    """List every parameter with default, unit, range and source."""
    from bridge.config import config_to_toml, describe_config, load_config

    if toml or config is not None or settings:
        print(config_to_toml(load_config(config, settings)), end="")
        return
    from bridge.console import print_table

    print_table("Parameters", ("key", "default", "unit", "range", "source"), describe_config())


@app.command()
def scan(
    scenes: Scenes,
    *,
    out: Annotated[Path | None, typer.Option("-o", "--out", help="CSV file; without it a table is printed.")] = None,
    min_agents: MinAgents = 0,
    city: City = [],  # noqa: B006
    split: Split = [],  # noqa: B006
    can: Can = [],  # noqa: B006
    sample: Sample = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of --sample.")] = 0,
    jobs: Jobs = 1,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Tabulate a data set: agents, density, lanes, neighbours, and room for each manoeuvre."""
    _set_up(verbose=verbose, quiet=quiet)
    from bridge.batch.scan import SceneFacts, Selection, facts_of, select, write_facts
    from bridge.console import Counter, print_table, say
    from bridge.files import make_folder
    from bridge.recordings.scenario import find_scenarios

    folders = list(dict.fromkeys(folder for path in scenes for folder in find_scenarios(path)))
    if out is not None:
        make_folder(out.parent)
    with Counter("scanning", quiet=quiet) as counter:
        facts, failures = facts_of(folders, jobs=jobs, on_scene=counter.show)
    for folder, reason in failures:
        say(_about(folder, reason))
    chosen = select(facts, Selection(min_agents, tuple(city), tuple(split), tuple(can), sample, seed))
    if out is not None:
        write_facts(out, chosen)
        print(out)
    else:
        print_table(f"{len(chosen)} of {len(folders)} scenes", SceneFacts.columns(), [fact.values() for fact in chosen])
    raise typer.Exit(SOME_FAILED if failures else ALL_DONE)


@app.command()
def study(
    file: Annotated[Path, typer.Argument(metavar="STUDY.toml", help="The study, see data/studies.")],
    out: Out,
    *,
    scenes: Annotated[list[Path], typer.Option(help="Scenes instead of those in the file; repeatable.")] = [],  # noqa: B006
    jobs: Jobs = 1,
    scheduler: Scheduler = None,
    scene_timeout: Timeout = 300.0,
    keep_scenes: Annotated[bool, typer.Option(help="Keep the generated scenes beside the tables.")] = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Run a parameter study; it goes on from where it was when it is called again."""
    _set_up(verbose=verbose, quiet=quiet)
    from bridge.batch.batch import Options
    from bridge.console import BatchDisplay, say
    from bridge.studies.study import read_study, run_study

    options = Options(jobs=jobs, scheduler=scheduler, timeout_s=scene_timeout, resume=True)
    try:
        with BatchDisplay(quiet=quiet, verbose=verbose) as display:
            report = run_study(
                read_study(file, scenes=scenes), out, options, keep_scenes=keep_scenes, on_row=display.note
            )
    except KeyboardInterrupt:
        say("interrupted; call it again to go on")
        raise typer.Exit(INTERRUPTED) from None
    if not quiet:
        for path in report.files:
            print(path)
    raise typer.Exit(SOME_FAILED if report.failed else ALL_DONE)


@app.command()
def paper(
    experiment: Annotated[str, typer.Argument(metavar="table1|ablation|density|diversity", help="Which experiment.")],
    out: Out,
    *,
    scenes: Annotated[Path, typer.Option(help="Recorded scenes; diversity needs real ones of over 40 agents.")] = Path(
        "data/av2"
    ),
    seeds: Annotated[int, typer.Option(min=1, help="Seeds per scene.")] = 10,
    agents: Annotated[int, typer.Option(min=0, help="Vehicles added, but for density.")] = 10,
    jobs: Jobs = 1,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Run an experiment of the paper that needs no training, from generation to the table beside the paper's."""
    _set_up(verbose=verbose, quiet=quiet)
    from bridge.console import Counter
    from bridge.evaluation.paper import EXPERIMENTS, run_experiment

    named = next((name for name in EXPERIMENTS if name == experiment), None)
    if named is None:
        raise ConfigError(f"experiment {experiment!r}, want one of {', '.join(EXPERIMENTS)}")
    with Counter("generating and measuring", quiet=quiet) as counter:
        page = run_experiment(
            named, scenes=scenes, out_dir=out, seeds=seeds, agents=agents, jobs=jobs, on_scene=counter.show
        )
    print(page)


def main() -> None:
    """Run the command; an explained error is one line on stderr, never a traceback."""
    try:
        app()
    except Hid2Error as error:
        print(f"hid2: {error}", file=sys.stderr)  # names of any bytes are escaped there
        sys.exit(USAGE if isinstance(error, ConfigError) else SOME_FAILED)


def _set_up(*, verbose: bool, quiet: bool) -> None:
    """Logging as asked for; SIGTERM ends the command as Ctrl-C does; names of any bytes can be printed."""
    level = logging.DEBUG if verbose else logging.ERROR if quiet else logging.WARNING
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(name)s: %(message)s", stream=sys.stderr)
    for package in ("bridge", "hid2", "netconvert"):
        logging.getLogger(package).setLevel(level)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def _agents(text: str) -> int | str:
    if text == "max":
        return text
    try:
        return int(text)
    except ValueError:
        raise ConfigError(f"--agents {text!r}: want a number or max") from None


def _about(folder: Path, reason: str) -> str:
    """What is wrong with a scene; most reasons name the file themselves."""
    return reason if reason.startswith(str(folder)) else f"{folder}: {reason}"


def _select(paths: Sequence[Path], selection: "Selection", *, jobs: int, quiet: bool) -> list[Path]:
    """The recorded scenes at `paths` that are wanted. Errors: ConfigError where there is none."""
    from bridge.batch.scan import facts_of, wanted
    from bridge.console import Counter, say
    from bridge.recordings.scenario import find_sources

    folders = find_sources(paths)
    if not selection.needs_facts:
        return folders
    with Counter("scanning", quiet=quiet) as counter:
        facts, failures = facts_of(folders, jobs=jobs, on_scene=counter.show)
    for folder, reason in failures:
        say(_about(folder, reason))
    chosen = wanted(folders, facts, failures, selection)
    if not quiet:
        say(f"{len(chosen)} of {len(folders)} scenes selected")
    return chosen


def _score(out: Path, predictions: str, bands: str, report: Path, *, quiet: bool) -> int:
    """Score forecasts; returns the exit code."""
    from bridge.console import Counter, print_table, say
    from bridge.evaluation.predictions import BASELINES, TABLE_HEAD, score_predictions

    try:
        bounds = [int(band) for band in bands.split(",")]
    except ValueError:
        raise ConfigError(f"--bands {bands!r}: want numbers of agents, joined by commas") from None
    baseline = next((name for name in BASELINES if name == predictions), None)
    with Counter("scoring", quiet=quiet) as counter:
        scored = score_predictions(
            out, predictions=baseline or Path(predictions), report_dir=report, bounds=bounds, on_scene=counter.show
        )
    for reason in scored.left_out:
        say(f"not scored: {reason}")
    if not quiet:
        print_table(f"{len(scored.scores)} scores", TABLE_HEAD, scored.rows())
        print(report / "predictions.html")
    return SOME_FAILED if scored.left_out else ALL_DONE


def _reproduce(bundle_path: Path, out: Path | None, function: str | None) -> int:
    """Run a bundle; without an output folder nothing is kept. Returns the exit code."""
    import tempfile

    from bridge.batch.batch import reproduce
    from bridge.batch.manifest import DONE

    with tempfile.TemporaryDirectory(prefix="hid2-") as scratch:
        bundle, row = reproduce(bundle_path, out or Path(scratch), function=function)
    print(f"{bundle.folder.name} variant {bundle.variant}, made by hid2-sumo {bundle.version}")
    print(f"then: {bundle.failure.kind}: {bundle.failure.message}")
    print(f"now:  {'done' if row.status == DONE else f'{row.failure}: {row.reason}'}")
    if bundle.failure.details:
        print(bundle.failure.details)
    return ALL_DONE if row.status == DONE else SOME_FAILED


if __name__ == "__main__":
    main()
