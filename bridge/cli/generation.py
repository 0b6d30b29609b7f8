"""`hid2 generate`."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bridge.cli import options
from bridge.cli.app import command
from bridge.cli.places import check_out, check_scenes
from bridge.cli.session import select_scenes
from bridge.console import Activity, fail, print_json, warn
from netconvert.errors import ConfigError

if TYPE_CHECKING:
    from bridge.batch.manifest import ManifestRow
    from bridge.recordings.folders import Address
    from hid2.params import Config

_HELP = "(see hid2 generate --help)"
_TRIGGER_TIME = "When manoeuvres are triggered, in seconds: a time, a range to draw from, or a list to draw from."


@command(
    shown=(
        "scenes", "out", "agents", "near", "focal", "seed", "variants", "behaviours", "trigger_time", "event", "target",
        "at", "drivers", "config", "settings", "jobs", "resume", "again", "source", "repro", "help",
    ),
)  # fmt: skip
def generate(  # noqa: PLR0913  # one for each option
    *,
    scenes: list[Path] | None = options.argument("SCENE", "Scenario folders, split folders or data-set roots.", None),
    out: Path | None = options.output("Folder to write to (required).", None, "OUT", "-o"),
    request: dict[str, Any] = options.FieldOptions("Request", options.request),  # type: ignore[assignment]
    behaviours: str | None = options.request(
        f"Shares of {', '.join(options.BEHAVIOURS)}; those not named get none.",
        None,
        "NAME=SHARE,...",
        show_default="straight=0.73,left_turn=0.035,right_turn=0.035,lane_change=0.15,overtake=0.05",
    ),
    trigger_time: str | None = options.request(
        _TRIGGER_TIME, None, "S|A:B|S,S,...", show_default="0.5 to 36 % of the scene, 4 s at most"
    ),
    without: list[str] = options.request(
        "Ablation: leave a component out; repeatable.", [], choices=options.COMPONENTS
    ),
    event: list[str] = options.event(
        "An event with a recorded vehicle, searched until it comes about; repeatable, with the same options.",
        [],
        choices=options.EVENTS,
    ),
    events: dict[str, Any] = options.FieldOptions("Event", options.event),  # type: ignore[assignment]
    criticality: list[str] = options.event(
        "Only events within this band of TTC or PET in seconds, or DRAC in m/s2; repeatable.",
        [],
        "ttc=A:B|pet=A:B|drac=A:B",
    ),
    others: dict[str, Any] = options.FieldOptions("Config", options.parameter),  # type: ignore[assignment]
    drivers: Path | None = options.parameter("Drivers as `hid2 calibrate` measured them.", None, "DRIVERS.toml"),
    config: Path | None = options.CONFIG,
    settings: list[str] = options.SETTINGS,
    which: options.Which,
    windows: options.Windows,
    formats: list[str] = options.output(
        "A format to write beside Argoverse 2's: sequences in OUT/argoverse1. Repeatable.",
        [],
        None,
        "--format",
        choices=("argoverse1",),
    ),
    record: list[str] = options.output(
        "Write more beside each scene; gaps: every look at a gap, gaps_<id>.csv.gz.", [], choices=("gaps",)
    ),
    batch: options.Batch,
    scene_memory: int = options.running("Memory beyond which a scene is ended and quarantined.", 4000, "MB", min=500),
    resume: bool = options.running("Skip scenes that are complete and unchanged.", False),
    append: bool = options.running("Add to the scenes of another request that OUT holds.", False),
    again: Path | None = options.running(
        "Make the scene of a hid2_<id>.json again, bit for bit; needs --source.", None, "SIDECAR", "--from"
    ),
    source: Path | None = options.running("With --from: where its recorded scene lies.", None, "ROOT"),
    repro: Path | None = options.running("Run a quarantined scene again, from its bundle.", None, "BUNDLE"),
    function: list[str] = options.running(
        "With --repro or --from: a function of yours that the file may ask for; repeatable.", [], "MODULE:NAME"
    ),
    as_json: bool = options.AS_JSON,
    activity: Activity,
) -> int:
    """Write denser scenes: insert vehicles with the behaviours asked for among the recorded ones.

    The first time: hid2 generate av2/val -o out --agents 20 --jobs 4

    Interrupted, or with more scenes: the same with --resume, which skips what is complete

    One scene once more: hid2 generate --from out/val/ID/hid2_ID.json --source av2/val -o again

    A failure once more: hid2 generate --repro out/quarantine/val/NAME.zip

    Exit code 1: a scene could not be done, or something asked for came about in no scene. 2: no scene can meet it.
    """
    if repro is not None:
        return _reproduce(repro, out, function, activity)
    if again is not None:
        given = bool(scenes or config or settings)
        return _make_again(again, source, out, windows.map_path, function, activity, given=given)
    if source is not None or function:
        alone = "--function without --repro or --from" if source is None else "--source without --from"
        raise ConfigError(f"{alone}, expected the two together {_HELP}")
    if not scenes or out is None:
        missing = [name for name, value in (("SCENE", scenes), ("-o/--out", out)) if not value]
        raise ConfigError(f"missing {' and '.join(missing)} {_HELP}")
    check_scenes(scenes)
    check_out(out)
    from bridge import load_config, parse_behaviours
    from bridge.config import functions_of, parse_events, parse_trigger_time, read_drivers
    from bridge.recordings.folders import split_of
    from bridge.recordings.sources import described, find_sources
    from bridge.toml import parse_value

    flags: dict[str, Any] = {f"request.{key}": value for key, value in request.items() if value is not None}
    if "request.agents" in flags:
        flags["request.agents"] = parse_value(flags["request.agents"])
    flags |= {key: value for key, value in others.items() if value is not None}
    flags |= {"without": without} if without else {}
    flags |= read_drivers(drivers) if drivers is not None else {}
    flags |= parse_behaviours(behaviours) if behaviours is not None else {}
    flags |= parse_trigger_time(trigger_time) if trigger_time is not None else {}
    flags |= parse_events(event, events, criticality)
    resolved = load_config(config, settings, flags)
    activity.doing("looking for scenes")
    folders = find_sources(scenes, windows.choices())
    activity.note(*described(folders))
    if formats:
        _check_sequences(folders, resolved)
    if any(which):  # else nothing need be imported that reads scenes
        from bridge.batch.scan import Selection

        folders = select_scenes(folders, Selection(*which, resolved.request.seed), activity, jobs=batch.jobs)

    if loose := sum(split_of(folder) is None for folder in folders):
        activity.note(f"{loose} of {len(folders)} scenes in no folder train, val or test: no split in {out} has them")
    from bridge.batch.batch import Options, plan, run_batch
    from bridge.batch.requested import came_about_nowhere, check_request, check_same_request, named_behaviours
    from bridge.cli.batch_display import LISTED_RUNS, notes_of, print_batch

    jobs_wanted = plan(folders, resolved)
    if not append:
        check_same_request(out, jobs_wanted[0].runs[0].config)
    activity.doing("looking at the first scenes")
    named = named_behaviours(resolved.request, by_option=behaviours is not None)
    check_request(folders, resolved, named, jobs=batch.jobs)
    how = Options(
        jobs=batch.jobs, scheduler=batch.scheduler, timeout_s=batch.scene_timeout, resume=resume,
        memory_mb=scene_memory, argoverse1=bool(formats),
        gaps=bool(record), functions=functions_of(resolved),
    )  # fmt: skip
    activity.doing("generating")
    activity.show(0, sum(len(job.runs) for job in jobs_wanted))
    rows = run_batch(jobs_wanted, out, how, on_row=notes_of(activity, out, go_on="continue with --resume"))
    activity.end()
    if as_json:
        print_json(rows[0]._fields, rows)
    elif not activity.quiet:
        print_batch(rows, resolved.request)
        paths = [out / row.folder for row in rows if row.folder] if len(rows) <= LISTED_RUNS else []
        activity.result(*paths, out / "manifest.csv")
    return _ended(rows, came_about_nowhere(rows, resolved, named), out)


def _check_sequences(folders: Sequence["Address"], config: "Config") -> None:
    """Errors: ConfigError for what cannot be written as sequences of Argoverse 1."""
    from bridge.recordings.folders import Source

    others = [folder for folder in folders if not (isinstance(folder, Source) and folder.format == "argoverse1")]
    wrong = {
        f": {others[0] if others else ''} is no Argoverse 1 sequence, expected these alone": bool(others),
        " with --focal generated: its AGENT is recorded, expected one of the two": config.request.focal == "generated",
        " with driving.replay = 'reactive': no scene of Argoverse, expected one": config.driving.replay == "reactive",
    }
    for said in (said for said, is_so in wrong.items() if is_so):
        raise ConfigError(f"--format argoverse1{said}")


def _ended(rows: Sequence["ManifestRow"], nowhere: Sequence[str], out: Path) -> int:
    """The exit code: 1 where a scene could not be done, or where something asked for came about in no scene at all."""
    from bridge.batch.manifest import DONE

    if nowhere:
        fail(f"{', '.join(nowhere)}: asked for, and came about in no scene; {out / 'manifest.csv'} has the reasons")
    return options.SOME_FAILED if nowhere or any(row.status != DONE for row in rows) else options.ALL_DONE


def _make_again(
    sidecar: Path, source: Path | None, out: Path | None, map_path: Path | None, functions: Sequence[str],
    activity: Activity, *, given: bool
) -> int:  # fmt: skip
    """Make the scene of a sidecar again, and compare it with what lies beside the sidecar. Returns the exit code."""
    if not (sidecar.is_file() and sidecar.match("hid2_*.json")):
        wrong = "is no sidecar" if sidecar.exists() else "no such file"
        raise ConfigError(f"--from {sidecar}: {wrong}, expected that of a generated scene, hid2_<id>.json")
    if out is None or source is None or given:
        raise ConfigError(f"--from SIDECAR takes --source ROOT and -o OUT, no SCENE, --config or --set {_HELP}")
    check_scenes([source])
    check_out(out)
    activity.doing("making the scene again")
    from bridge.batch.provenance import make_again

    made = make_again(sidecar, source, out, map_path=map_path, functions=functions)
    for line in made.differences:
        warn(line)
    activity.result(made.folder)
    if made.compared and not made.differences:
        apart = f", but for what the sidecar says of the program: {made.program}" if made.program else ""
        activity.note(f"the same, bit for bit, as {sidecar.parent}{apart}")
    return options.SOME_FAILED if made.differences else options.ALL_DONE


def _reproduce(bundle_path: Path, out: Path | None, functions: Sequence[str], activity: Activity) -> int:
    """Run a bundle; without an output folder nothing is kept. Returns the exit code."""
    from zipfile import is_zipfile

    if not bundle_path.is_file() or not is_zipfile(bundle_path):
        wrong = "is no ZIP file" if bundle_path.is_file() else "no such file"
        raise ConfigError(f"{bundle_path}: {wrong}, expected a bundle, OUT/quarantine/.../NAME.zip")
    if out is not None:
        check_out(out)
    activity.doing("running the scene of the bundle")
    from bridge.batch.batch import reproduce
    from bridge.batch.manifest import DONE

    bundle, row = reproduce(bundle_path, out, functions=functions)
    activity.end()
    print(f"{bundle.folder.name} variant {bundle.variant}, made by hid2-sumo {bundle.version}")
    print(f"then: {bundle.failure.kind}: {bundle.failure.message}")
    print(f"now:  {'done' if row.status == DONE else f'{row.failure}: {row.reason}'}")
    if bundle.failure.details:
        print(bundle.failure.details)
    return options.ALL_DONE if row.status == DONE else options.SOME_FAILED
