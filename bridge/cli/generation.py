"""`hid2 generate`, and what is said of a batch: a message for every scene that failed."""

from collections.abc import Sequence
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from bridge.batch.manifest import DONE, MANIFEST_NAME, ManifestRow
from bridge.cli import options
from bridge.cli.places import check_scenes, recordings, select_scenes
from bridge.console import Activity, fail, print_json, print_table, say, warn
from bridge.interruption import if_interrupted
from bridge.recordings.folders import Address, Choices, Source, split_of
from netconvert.errors import ConfigError

if TYPE_CHECKING:
    from bridge.batch.batch import OnRow, Progress
    from hid2.params import Config, Request

#: What --repro and --from make use of.
_WITH_REPRO = frozenset({"--repro", "--out", "--function", "--verbose", "--quiet"})
_WITH_FROM = _WITH_REPRO - {"--repro"} | {"--from", "--source", "--map"}
#: Most runs of a batch that are listed; more are summed up: those that failed were told one by one.
_LISTED_RUNS = 24
#: Reasons shown in a row of the table; manifest.csv has them all.
_REASONS = 3
_HELP = "(see hid2 generate --help)"


class Asked(NamedTuple):
    """What is asked for: what a configuration is made of."""

    request: dict[str, Any] = options.FieldOptions("request", options.request)  # type: ignore[assignment]
    behaviours: str | None = options.request(
        f"Shares of {options.BEHAVIOURS}; those not named get none.",
        None,
        "NAME=SHARE,...",
        show_default="straight=0.73,left_turn=0.035,right_turn=0.035,lane_change=0.15,overtake=0.05",
    )
    trigger_time: str | None = options.request(
        "When manoeuvres are triggered, in seconds: a time, a range to draw from, or a list to draw from.",
        None,
        "S|A:B|S,S,...",
        show_default="0.5 to 36 % of the scene, 4 s at most",
    )
    without: list[options.ComponentName] = options.request("Ablation: leave a component out; repeatable.", [])
    event: list[options.EventName] = options.event(
        "An event with a recorded vehicle, searched until it comes about; repeatable, with the same options.", []
    )
    events: dict[str, Any] = options.FieldOptions("event", options.event)  # type: ignore[assignment]
    criticality: list[str] = options.event(
        "Only events within this band of TTC or PET in seconds, or DRAC in m/s2; repeatable.",
        [],
        "ttc=A:B|pet=A:B|drac=A:B",
    )
    others: dict[str, Any] = options.FieldOptions("others", options.parameter)  # type: ignore[assignment]
    drivers: Path | None = options.parameter("Drivers as `hid2 calibrate` measured them.", None, "DRIVERS.toml")
    config: Path | None = options.CONFIG
    settings: list[str] = options.SETTINGS

    def resolved(self) -> "Config":
        """The configuration. Errors: ConfigError."""
        from bridge.config import load_config, parse_behaviours, parse_events, parse_trigger_time, read_drivers
        from bridge.toml import parse_value

        flags: dict[str, Any] = {key: one for key, one in (self.request | self.others).items() if one is not None}
        if "request.agents" in flags:
            flags["request.agents"] = parse_value(flags["request.agents"])
        flags |= {"without": self.without} if self.without else {}
        flags |= read_drivers(self.drivers) if self.drivers is not None else {}
        flags |= parse_behaviours(self.behaviours) if self.behaviours is not None else {}
        flags |= parse_trigger_time(self.trigger_time) if self.trigger_time is not None else {}
        flags |= parse_events(self.event, self.events, self.criticality)
        return load_config(self.config, self.settings, flags)


class Written(NamedTuple):
    """Where scenes are written to, and what besides them."""

    out: Path | None = options.output("Folder to write to (required).", None, "OUT", "-o")
    formats: list[Literal["argoverse1"]] = options.output(
        "A format to write beside Argoverse 2's: sequences in OUT/argoverse1. Repeatable.", [], None, "--format"
    )
    record: list[Literal["gaps"]] = options.output(
        "Write more beside each scene; gaps: every look at a gap, gaps_<id>.csv.gz.", []
    )
    as_json: bool = options.AS_JSON


class Running(NamedTuple):
    """How the batch runs and goes on, or which scene is made again in its place. given: all on the command line."""

    batch: options.Batch
    given: options.Given
    scene_memory: int = options.running("Memory beyond which a scene is ended and quarantined.", 4000, "MB", min=500)
    resume: bool = options.running("Skip scenes that are complete and unchanged.", False)
    append: bool = options.running("Add to the scenes of another request that OUT holds.", False)
    again: Path | None = options.running(
        "Make the scene of a hid2_<id>.json again, bit for bit; needs --source.", None, "SIDECAR", "--from"
    )
    source: Path | None = options.running("With --from: where its recorded scene lies.", None, "ROOT")
    repro: Path | None = options.running("Run a quarantined scene again, from its bundle.", None, "BUNDLE")
    function: list[str] = options.running(
        "With --repro or --from: a function of yours that the file may ask for; repeatable.", [], "MODULE:NAME"
    )


@options.command(
    folders=("out",),
    shown=(
        "scenes", "out", "agents", "near", "focal", "seed", "variants", "behaviours", "trigger_time", "event", "target",
        "at", "drivers", "config", "settings", "jobs", "resume", "again", "source", "repro", "help",
    ),
)  # fmt: skip
def generate(
    *,
    scenes: list[Path] | None = options.argument("SCENE", "Scenario folders, split folders or data-set roots.", None),
    written: Written,
    asked: Asked,
    which: options.Which,
    choices: Choices,
    running: Running,
    activity: Activity,
) -> bool:
    """Write denser scenes: insert vehicles with the behaviours asked for among the recorded ones.

    The first time: hid2 generate av2/val -o out --agents 20 --jobs 4

    Interrupted, or with more scenes: the same with --resume, which skips what is complete

    One scene once more: hid2 generate --from out/val/ID/hid2_ID.json --source av2/val -o again

    A failure once more: hid2 generate --repro out/quarantine/val/NAME.zip

    Exit code 1: a scene could not be done, or something asked for came about in no scene. 2: no scene can meet it.
    """
    out, jobs = written.out, running.batch.jobs
    if running.repro is not None:
        running.given.check(_WITH_REPRO, "--repro, which runs the request of the bundle")
        return _reproduce(running.repro, out, running.function, activity)
    if running.again is not None:
        running.given.check(_WITH_FROM, "--from, which makes the request of the sidecar again")
        return _make_again(running.again, running, out, choices.map_path, activity)
    if running.source is not None or running.function:
        alone = "--function without --repro or --from" if running.source is None else "--source without --from"
        raise ConfigError(f"{alone}, expected the two together {_HELP}")
    if not scenes or out is None:
        missing = [name for name, value in (("SCENE", scenes), ("-o/--out", out)) if not value]
        raise ConfigError(f"missing {' and '.join(missing)} {_HELP}")
    check_scenes(scenes)
    from bridge.batch import requested
    from bridge.batch.batch import own_files, plan, run_batch
    from bridge.config import functions_of

    resolved = asked.resolved()
    own_files([resolved], functions_of(resolved))  # before any scene is looked for
    named = requested.named_behaviours(resolved.request, by_option=asked.behaviours is not None)
    selects = any(which) or requested.may_be_impossible(resolved, named)
    beside = {"argoverse1": bool(written.formats), "gaps": bool(written.record), "functions": functions_of(resolved)}
    how = running.batch.options(selects=selects, resume=running.resume, memory_mb=running.scene_memory, **beside)
    activity.doing("looking for scenes")
    folders = recordings(scenes, choices, activity, generated=False)
    if written.formats:
        _check_sequences(folders, resolved)
    folders = select_scenes(folders, which, resolved.request.seed, activity, jobs=jobs)
    if loose := sum(split_of(folder) is None for folder in folders):
        activity.note(f"{loose} of {len(folders)} scenes in no folder train, val or test: no split in {out} has them")
    jobs_wanted = plan(folders, resolved)
    if not running.append:
        requested.check_same_request(out, jobs_wanted[0].runs[0].config)
    activity.doing("looking at the first scenes")
    requested.check_request(folders, resolved, named, jobs=jobs)
    activity.doing("generating")
    activity.show(0, sum(len(job.runs) for job in jobs_wanted))
    rows = run_batch(jobs_wanted, out, how, on_row=notes_of(activity, out, go_on="continue with --resume"))
    activity.end()
    if written.as_json:
        print_json(rows[0]._fields, rows)
    elif not activity.quiet:
        print_batch(rows, resolved.request)
        paths = [out / row.folder for row in rows if row.folder] if len(rows) <= _LISTED_RUNS else []
        activity.result(*paths, out / MANIFEST_NAME)
    if nowhere := requested.came_about_nowhere(rows, resolved, named):
        fail(f"{', '.join(nowhere)}: asked for, and came about in no scene; {out / MANIFEST_NAME} has the reasons")
    return bool(nowhere) or any(row.status != DONE for row in rows)


def print_batch(rows: Sequence[ManifestRow], request: "Request") -> None:
    """Print what happened, run by run when there are few, and the sums."""
    if len(rows) <= _LISTED_RUNS:
        with_events = any(row.events_requested for row in rows)
        head = ("scene", "variant", "placed", "left turns", "right turns", "lane changes", "overtakes", "manoeuvres")
        listed = (*head, *(("events",) if with_events else ()), "run time, s", "remarks")
        print_table("Generated scenes", listed, [_line(row, request, with_events=with_events) for row in rows])
    done = [row for row in rows if row.status == DONE]
    asked = "" if any(row.asked == "max" for row in done) else f" of {sum(int(row.asked) for row in done)}"
    target = f"{request.near} at the last observed step" if request.is_near_agents else "traffic"
    print(
        f"{len(done)} of {len(rows)} scenes done; vehicles placed: {sum(row.placed for row in done)}{asked}, "
        f"{sum(row.near for row in done)} of them within {request.within_m:g} m of {target}; "
        f"manoeuvres done: {sum(row.maneuvers_done for row in done)} of {sum(row.maneuvers_requested for row in done)}"
    )
    if events := sum(row.events_requested for row in done):
        print(f"events done: {sum(row.events_done for row in done)} of {events}")
    if request.entering:
        print(f"entered: {sum(row.entered for row in done)} of {sum(row.straight for row in done)} that go straight")
    if request.focal == "generated":
        does = sum(row.focal not in ("", "straight") for row in done)
        print(f"focal tracks that do a manoeuvre: {does} of {len(done)}")


def _line(row: ManifestRow, request: "Request", *, with_events: bool) -> tuple[object, ...]:
    if row.status != DONE:
        blank = ("-",) * (7 if with_events else 6)
        return (row.scenario, row.variant, *blank, row.seconds, f"{row.failure}: {row.reason}")
    said = {"events": row.events, "not done": row.not_done}
    placed, met = f"{row.placed} of {row.asked}", row.placed
    if request.is_near_agents:
        placed, met = f"{placed}, {row.near} near", row.near
    placed += f", {row.entered} entered" if request.entering else ""
    if row.asked == "max" or met < int(row.asked) or row.entered < round(request.entering * row.straight):
        said["candidates rejected"] = row.rejected
    remarks = "; ".join(f"{what}: {_first(reasons)}" for what, reasons in said.items() if reasons)
    by_kind = row.left_turn, row.right_turn, row.lane_change, row.overtake
    done = [f"{row.maneuvers_done} of {row.maneuvers_requested}"]
    done += [f"{row.events_done} of {row.events_requested}"] if with_events else []
    return (row.scenario, row.variant, placed, *by_kind, *done, round(row.seconds, 2), remarks or "-")


def _first(reasons: str) -> str:
    """The most frequent reasons, and how many kinds more there are."""
    each = reasons.split("; ")
    more = f", {len(each) - _REASONS} more in manifest.csv" if len(each) > _REASONS else ""
    return ", ".join(each[:_REASONS]) + more


def _check_sequences(folders: Sequence[Address], config: "Config") -> None:
    """Errors: ConfigError for what cannot be written as sequences of Argoverse 1."""
    for folder in folders:
        if not (isinstance(folder, Source) and folder.format == "argoverse1"):
            raise ConfigError(f"--format argoverse1: {folder} is no Argoverse 1 sequence, expected these alone")
    if config.request.focal == "generated":
        raise ConfigError("--format argoverse1 with --focal generated: its AGENT is recorded, expected one of the two")
    if config.driving.replay == "reactive":
        raise ConfigError("--format argoverse1 with driving.replay = 'reactive': no scene of Argoverse, expected one")


def _make_again(sidecar: Path, running: Running, out: Path | None, map_path: Path | None, activity: Activity) -> bool:
    """Make the scene of a sidecar again, and compare it with what lies beside the sidecar."""
    if not (sidecar.is_file() and sidecar.match("hid2_*.json")):
        wrong = "is no sidecar" if sidecar.exists() else "no such file"
        raise ConfigError(f"--from {sidecar}: {wrong}, expected that of a generated scene, hid2_<id>.json")
    if out is None or running.source is None:
        raise ConfigError(f"--from SIDECAR takes --source ROOT and -o OUT {_HELP}")
    check_scenes([running.source])
    activity.doing("making the scene again")
    from bridge.batch.provenance import make_again

    made = make_again(sidecar, running.source, out, map_path=map_path, functions=running.function)
    for line in made.differences:
        warn(line)
    activity.result(made.folder)
    if made.compared and not made.differences:
        apart = f", but for what the sidecar says of the program: {made.program}" if made.program else ""
        activity.note(f"the same, bit for bit, as {sidecar.parent}{apart}")
    return bool(made.differences)


def _reproduce(bundle_path: Path, out: Path | None, functions: Sequence[str], activity: Activity) -> bool:
    """Run a bundle; without an output folder nothing is kept."""
    from zipfile import is_zipfile

    if not is_zipfile(bundle_path):  # nor is one that is not there
        wrong = "is no ZIP file" if bundle_path.is_file() else "no such file"
        raise ConfigError(f"{bundle_path}: {wrong}, expected a bundle, OUT/quarantine/.../NAME.zip")
    activity.doing("running the scene of the bundle")
    from bridge.batch.batch import reproduce

    bundle, row = reproduce(bundle_path, out, functions=functions)
    activity.end()
    print(f"{bundle.folder.name} variant {bundle.variant}, made by hid2-sumo {bundle.version}")
    print(f"then: {bundle.failure.kind}: {bundle.failure.message}")
    print(f"now:  {'done' if row.status == DONE else f'{row.failure}: {row.reason}'}")
    if bundle.failure.details:
        print(bundle.failure.details)
    return row.status != DONE


def notes_of(activity: Activity, out: Path, *, go_on: str) -> "OnRow":
    """Tells an activity what becomes of a batch's runs; when it is verbose, of those that succeed too."""

    def note(row: ManifestRow, progress: "Progress") -> None:
        if_interrupted(f"finished scenes are in {out / MANIFEST_NAME}; {go_on}")
        if row.status != DONE:
            say(
                f"warning: {row.scenario} variant {row.variant}: {row.failure}: {row.reason}\n"
                f"  to see it again: hid2 generate --repro {quote(str(out / row.bundle))}"
            )
        elif activity.verbose:
            say(f"{row.scenario} variant {row.variant}: {row.placed} of {row.asked} placed, {row.seconds:.1f} s")
        details = f" ({progress.skipped} complete before, {progress.quarantined} quarantined)"
        activity.show(progress.done + progress.quarantined, progress.total - progress.skipped, details)

    return note
