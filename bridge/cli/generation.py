"""`hid2 generate`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bridge.cli.app import command
from bridge.cli.options import (
    ALL_DONE,
    INTERRUPTED,
    SOME_FAILED,
    AsJson,
    Can,
    City,
    ComponentName,
    ConfigFile,
    EventName,
    FocalName,
    FormatName,
    Jobs,
    MapChoice,
    Memory,
    MinAgents,
    Quiet,
    RecordName,
    Resume,
    Sample,
    Scheduler,
    Settings,
    Split,
    Stride,
    Timeout,
    Verbose,
    Window,
    event_option,
    output_option,
    parameter_option,
    request_option,
    running_option,
)
from bridge.cli.places import check_out, check_scenes
from bridge.cli.session import select_scenes, set_up, tell_formats
from bridge.console import Activity, print_json, say, warn
from netconvert.errors import ConfigError, Hid2Error

if TYPE_CHECKING:
    from bridge.recordings.folders import Address
    from hid2.params import Config

#: Batches up to this size list every folder that was written.
_SHOWN_PATHS = 24


@command()
def generate(  # noqa: PLR0913  # one for each option
    *,
    scenes: Annotated[
        list[Path] | None,
        typer.Argument(metavar="SCENE", help="Scenario folders, split folders or data-set roots."),
    ] = None,
    out: Annotated[
        Path | None,
        output_option("-o", "--out", metavar="OUT", help="Folder to write to (required)."),
    ] = None,
    agents: Annotated[
        str | None,
        request_option(
            metavar="N|max", help="Vehicles to insert into each scene; max: as many as it holds.", show_default="10"
        ),
    ] = None,
    behaviours: Annotated[
        str | None,
        request_option(
            metavar="NAME=SHARE,...",
            help="Shares of straight, left_turn, right_turn, lane_change, overtake; those not named get none.",
            show_default="straight=0.6,left_turn=0.1,right_turn=0.1,lane_change=0.15,overtake=0.05",
        ),
    ] = None,
    trigger_time: Annotated[
        str | None,
        request_option(
            metavar="S|A:B|S,S,...",
            help="When manoeuvres are triggered, in seconds: a time, a range to draw from, or a list to draw from.",
            show_default="0.5 to 36 % of the scene, 4 s at most",
        ),
    ] = None,
    near: Annotated[
        str | None,
        request_option(
            metavar="av|focal|scored|traffic|anywhere|TRACK_ID",
            help="Where vehicles are inserted: near moving traffic, the recording vehicle, the focal track, scored "
            "tracks, or a track.",
            show_default="traffic",
        ),
    ] = None,
    within: Annotated[
        float | None,
        request_option(metavar="M", help="How near that is, in metres.", show_default="30"),
    ] = None,
    entering: Annotated[
        float | None,
        request_option(
            min=0.0,
            max=1.0,
            metavar="SHARE",
            help="Of the vehicles that go straight: these enter at the map's edge during the observed steps.",
            show_default="0",
        ),
    ] = None,
    event: Annotated[
        list[EventName],
        event_option(
            help="An event with a recorded vehicle, searched until it comes about; repeatable, with the same options.",
            show_default=False,
        ),
    ] = [],  # noqa: B006
    target: Annotated[
        str | None,
        event_option(metavar="av|focal|any|TRACK_ID", help="Whom with.", show_default="av"),
    ] = None,
    at: Annotated[
        str | None,
        event_option(
            metavar="S|S:S",
            help="When, in seconds, half a second more or less: the moment of crossing into the target's lane (of an "
            "overtake, on the way back), of coming onto the common lane, or of passing the conflict point.",
            show_default="2:7, overtake 4:10",
        ),
    ] = None,
    gap: Annotated[
        str | None,
        event_option(
            metavar="A:B", help="Bumper to bumper at that moment, in metres.", show_default="4:30, cross 0:100"
        ),
    ] = None,
    speed_difference: Annotated[
        str | None,
        event_option(
            metavar="A:B", help="Own speed minus the target's at that moment, in m/s.", show_default="-6:6, cross any"
        ),
    ] = None,
    brakes: Annotated[
        float | None,
        event_option(metavar="MPS2", help="A leader brakes so hard from that moment on, in m/s2."),
    ] = None,
    criticality: Annotated[
        list[str],
        event_option(
            metavar="ttc=A:B|pet=A:B|drac=A:B",
            help="Only events within this band of TTC or PET in seconds, or DRAC in m/s2; repeatable.",
            show_default=False,
        ),
    ] = [],  # noqa: B006
    count: Annotated[
        int | None,
        event_option(min=1, metavar="N", help="Events of each kind in a scene.", show_default="1"),
    ] = None,
    variants: Annotated[
        int | None,
        request_option(min=1, metavar="K", help="Scenes to write for each source scene.", show_default="1"),
    ] = None,
    focal: Annotated[
        FocalName | None,
        request_option(help="Which track is the focal one.", show_default="recorded"),
    ] = None,
    seed: Annotated[
        int | None,
        request_option(min=0, metavar="N", help="Seed of every random choice.", show_default="0"),
    ] = None,
    spawn_leaders: Annotated[
        bool | None,
        request_option(
            "--spawn-leaders/--no-spawn-leaders",
            metavar="",
            help="Add a slow lead vehicle when an overtake has none.",
            show_default="spawn-leaders",
        ),
    ] = None,
    without: Annotated[
        list[ComponentName],
        request_option(help="Ablation: leave a component out; repeatable.", show_default=False),
    ] = [],  # noqa: B006  # typer copies it
    drivers: Annotated[
        Path | None,
        parameter_option(metavar="DRIVERS.toml", help="Drivers as `hid2 calibrate` measured them."),
    ] = None,
    config: ConfigFile = None,
    settings: Settings = [],  # noqa: B006
    min_agents: MinAgents = 0,
    city: City = [],  # noqa: B006
    split: Split = [],  # noqa: B006
    can: Can = [],  # noqa: B006
    sample: Sample = None,
    map_path: MapChoice = None,
    window: Window = 0,
    stride: Stride = None,
    formats: Annotated[
        list[FormatName],
        output_option(
            "--format",
            help="A format to write beside Argoverse 2's: sequences in OUT/argoverse1. Repeatable.",
            show_default=False,
        ),
    ] = [],  # noqa: B006
    sumo: Annotated[
        Path | None,
        output_option(metavar="DIR", help="Write files for SUMO as well: net, routes, FCD output."),
    ] = None,
    jobs: Jobs = 1,
    scheduler: Scheduler = None,
    scene_timeout: Timeout = 300.0,
    scene_memory: Memory = 4000,
    resume: Resume = False,
    again: Annotated[
        Path | None,
        running_option(
            "--from", metavar="SIDECAR", help="Make the scene of a hid2_<id>.json again, bit for bit; needs --source."
        ),
    ] = None,
    source: Annotated[
        Path | None,
        running_option(metavar="ROOT", help="With --from: where its recorded scene lies."),
    ] = None,
    record: Annotated[
        list[RecordName],
        output_option(
            help="Write more beside each scene; gaps: every look at a gap, gaps_<id>.csv.gz.", show_default=False
        ),
    ] = [],  # noqa: B006
    repro: Annotated[
        Path | None,
        running_option(metavar="BUNDLE", help="Run a quarantined scene again, from its bundle."),
    ] = None,
    function: Annotated[
        str | None,
        running_option(metavar="MODULE:NAME", help="With --repro: a function of yours that the bundle may ask for."),
    ] = None,
    as_json: AsJson = False,
    verbose: Verbose = 0,
    quiet: Quiet = False,
) -> None:
    """Write denser scenes: insert vehicles with the behaviours asked for among the recorded ones."""
    set_up(verbose=verbose, quiet=quiet)
    if repro is not None:
        raise typer.Exit(_reproduce(repro, out, function, quiet=quiet))
    if again is not None:
        raise typer.Exit(_make_again(again, source, out, map_path, given=bool(scenes), quiet=quiet))
    scenes, out = _given(scenes, out, {"--source without --from": source, "--function without --repro": function})
    check_scenes(scenes)
    check_out(out)
    if sumo is not None:
        check_out(sumo)
    with Activity(quiet=quiet) as activity:
        from bridge.config import (
            check_reactive,
            load_config,
            parse_behaviours,
            parse_events,
            parse_trigger_time,
            read_drivers,
        )
        from bridge.recordings.folders import Choices, Source
        from bridge.recordings.sources import find_sources

        flags: dict[str, object] = {
            "request.agents": None if agents is None else _agents(agents),
            "request.variants": variants,
            "request.near": near,
            "request.within_m": within,
            "request.entering": entering,
            "request.focal": focal,
            "request.seed": seed,
            "request.spawn_leaders": spawn_leaders,
            "without": [str(name) for name in without] or None,
        }
        flags |= read_drivers(drivers) if drivers is not None else {}
        flags |= parse_behaviours(behaviours) if behaviours is not None else {}
        flags |= parse_trigger_time(trigger_time) if trigger_time is not None else {}
        event_values = {
            "target": target, "at": at, "gap": gap, "speed-difference": speed_difference, "brakes": brakes,
            "count": count,
        }  # fmt: skip
        flags |= parse_events([str(kind) for kind in event], event_values, criticality)
        resolved = load_config(config, settings, {key: value for key, value in flags.items() if value is not None})
        check_reactive(resolved)
        activity.doing("looking for scenes")
        folders = find_sources(scenes, Choices(map_path, window, stride))
        tell_formats(folders, activity)
        others = [f for f in folders if not (isinstance(f, Source) and f.format == "argoverse1")]
        if formats and others:
            raise ConfigError(f"--format argoverse1: {others[0]} is no Argoverse 1 sequence, expected these alone")
        if formats and resolved.request.focal == "generated":
            raise ConfigError(
                "--format argoverse1 with --focal generated: its AGENT is recorded, expected one of the two"
            )
        activity.doing("looking at the first scenes")
        _check_trigger(folders, resolved)
        if formats and resolved.driving.replay == "reactive":
            raise ConfigError(
                "--format argoverse1 with driving.replay = 'reactive': no scene of Argoverse, expected one"
            )
        if min_agents or city or split or can or sample:  # else nothing need be imported that reads scenes
            from bridge.batch.scan import Selection

            selection = Selection(
                min_agents, tuple(city), tuple(map(str, split)), tuple(map(str, can)), sample, resolved.request.seed
            )
            folders = select_scenes(folders, selection, activity, jobs=jobs)

        from bridge.batch.batch import GENERATE, GENERATE_WITH_GAPS, Options, plan, run_batch
        from bridge.batch.manifest import DONE
        from bridge.cli.batch_display import BatchNotes, batch_rows, print_batch

        options = Options(
            jobs=jobs, scheduler=scheduler, timeout_s=scene_timeout, resume=resume, memory_mb=scene_memory,
            function=GENERATE_WITH_GAPS if record else GENERATE,
            argoverse1=bool(formats), sumo=sumo.resolve() if sumo is not None else None,
        )  # fmt: skip
        notes = BatchNotes(activity, out, verbose=verbose > 0)
        activity.doing("generating")
        jobs_wanted = plan(folders, resolved)
        activity.show(0, sum(len(job.runs) for job in jobs_wanted))
        try:
            rows = run_batch(jobs_wanted, out, options, on_row=notes.note)
        except KeyboardInterrupt:
            activity.message(f"interrupted; finished scenes are in {out / 'manifest.csv'}, continue with --resume")
            raise typer.Exit(INTERRUPTED) from None
    if as_json:
        print_json(*batch_rows(rows))
    elif not quiet:
        print_batch(rows)
        for row in rows if len(rows) <= _SHOWN_PATHS else []:
            if row.folder:
                print(out / row.folder)
        print(out / "manifest.csv")
    raise typer.Exit(ALL_DONE if all(row.status == DONE for row in rows) else SOME_FAILED)


def _given(scenes: list[Path] | None, out: Path | None, alone: Mapping[str, object]) -> tuple[list[Path], Path]:
    """Errors: ConfigError for what is missing, and for options that go with another one, `alone` by what to say."""
    for said, value in alone.items():
        if value is not None:
            raise ConfigError(f"{said}, expected the two together (see hid2 generate --help)")
    missing = [name for name, value in (("SCENE", scenes), ("-o/--out", out)) if not value]
    if not scenes or out is None:
        raise ConfigError(f"missing {' and '.join(missing)} (see hid2 generate --help)")
    return scenes, out


#: Scenes that are looked at for one that lasts until the first trigger, and how long the shortest usually lasts, s.
_LOOKED_AT, _SHORTEST_S = 20, 4.9


def _check_trigger(folders: Sequence["Address"], config: "Config") -> None:
    """Errors: ConfigError where of the first scenes, which are mostly of one length, none lasts until any trigger."""
    request = config.request
    first_s = min(request.trigger_list_s) if request.trigger_list_s else request.trigger_min_s
    if first_s <= _SHORTEST_S or request.lane_change + request.overtake == 0:
        return
    from bridge.recordings.sources import read_recording

    longest_s = 0.0
    for folder in folders[:_LOOKED_AT]:
        try:
            recording = read_recording(folder)
        except Hid2Error:  # its own row of the manifest says why
            return
        longest_s = max(longest_s, (recording.num_steps - 1) * recording.step_s)
        if longest_s >= first_s:
            return
    looked_at = min(len(folders), _LOOKED_AT)
    raise ConfigError(
        f"--trigger-time: lane changes and overtakes are asked for at {first_s:g} s or later, but the longest of the "
        f"{looked_at} scene{'s' if looked_at > 1 else ''} looked at ends at {longest_s:g} s; expected an earlier time"
    )


def _agents(text: str) -> int | str:
    if text == "max":
        return text
    try:
        return int(text)
    except ValueError:
        raise ConfigError(f"--agents {text!r}: expected a number or max") from None


def _make_again(
    sidecar: Path, source: Path | None, out: Path | None, map_path: Path | None, *, given: bool, quiet: bool
) -> int:
    """Make the scene of a sidecar again, and compare it with what lies beside the sidecar. Returns the exit code."""
    if not (sidecar.is_file() and sidecar.match("hid2_*.json")):
        wrong = "is no sidecar" if sidecar.exists() else "no such file"
        raise ConfigError(f"--from {sidecar}: {wrong}, expected that of a generated scene, hid2_<id>.json")
    if out is None or source is None or given:
        raise ConfigError("--from SIDECAR takes --source ROOT and -o OUT, and no SCENE (see hid2 generate --help)")
    check_scenes([source])
    check_out(out)
    with Activity("making the scene again", quiet=quiet):
        from bridge.batch.provenance import make_again

        made = make_again(sidecar, source, out, map_path=map_path)
    for line in made.differences:
        warn(line)
    if not quiet:
        print(made.folder)
        if made.compared and not made.differences:
            say(f"the same, bit for bit, as {sidecar.parent}")
    return SOME_FAILED if made.differences else ALL_DONE


def _reproduce(bundle_path: Path, out: Path | None, function: str | None, *, quiet: bool) -> int:
    """Run a bundle; without an output folder nothing is kept. Returns the exit code."""
    import tempfile
    from zipfile import is_zipfile

    if not bundle_path.is_file() or not is_zipfile(bundle_path):
        wrong = "is no ZIP file" if bundle_path.is_file() else "no such file"
        raise ConfigError(f"{bundle_path}: {wrong}, expected a bundle, OUT/quarantine/.../NAME.zip")
    if out is not None:
        check_out(out)
    with (
        Activity("running the scene of the bundle", quiet=quiet),
        tempfile.TemporaryDirectory(prefix="hid2-") as scratch,
    ):
        from bridge.batch.batch import reproduce
        from bridge.batch.manifest import DONE

        bundle, row = reproduce(bundle_path, out or Path(scratch), function=function)
    print(f"{bundle.folder.name} variant {bundle.variant}, made by hid2-sumo {bundle.version}")
    print(f"then: {bundle.failure.kind}: {bundle.failure.message}")
    print(f"now:  {'done' if row.status == DONE else f'{row.failure}: {row.reason}'}")
    if bundle.failure.details:
        print(bundle.failure.details)
    return ALL_DONE if row.status == DONE else SOME_FAILED
