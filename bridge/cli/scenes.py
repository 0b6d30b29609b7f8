"""`hid2 validate`, `scan` and `net`: what scenes and maps hold."""

from pathlib import Path
from typing import Annotated

import typer

from bridge.cli.app import command
from bridge.cli.options import (
    ALL_DONE,
    SOME_FAILED,
    AsJson,
    Can,
    City,
    Jobs,
    MapChoice,
    MinAgents,
    Out,
    Quiet,
    Sample,
    Scene,
    Scenes,
    Split,
    Stride,
    Verbose,
    Window,
    output_option,
    selection_option,
)
from bridge.cli.places import check_one_scene, check_out, check_out_file, check_scenes
from bridge.cli.session import one_scene, set_up, tell_formats, unread_text, with_cities_of
from bridge.console import Activity, counted, print_json, print_table, say


@command()
def validate(
    out: Annotated[
        Path,
        typer.Argument(
            metavar="OUT", help="Generated scenes: a scenario folder, a split folder or a root.", show_default=False
        ),
    ],
    *,
    source: Annotated[
        Path | None, typer.Option(metavar="DIR", help="The source scenes, to compare recorded tracks with.")
    ] = None,
    map_path: MapChoice = None,
    as_json: AsJson = False,
    verbose: Verbose = 0,
    quiet: Quiet = False,
) -> None:
    """Check that scenes are valid Argoverse 2 scenes; findings go to stdout."""
    set_up(verbose=verbose, quiet=quiet)
    check_scenes([out, *([source] if source else [])])
    with Activity("checking scenes", quiet=quiet):
        from bridge.recordings.folders import find_scenarios
        from bridge.recordings.validate import validate_folder

        scenes = len(find_scenarios(out))
        findings = validate_folder(out, source=source, map_path=map_path)
    if as_json:
        print_json(("file", "rule", "message"), findings)
    else:
        for finding in findings:
            print(f"{finding.file}: {finding.rule}: {finding.message}")
    wrong = sum(not finding.is_note for finding in findings)
    if not quiet:
        noted = len(findings) - wrong
        notes = f", {counted(noted, 'note')} on recorded tracks" if noted else ""
        say(f"{out}: {counted(scenes, 'scene')}, {counted(wrong, 'finding')}{notes}")
    raise typer.Exit(SOME_FAILED if wrong else ALL_DONE)


@command()
def scan(  # noqa: PLR0913  # one for each option
    scenes: Scenes,
    *,
    out: Annotated[
        Path | None,
        output_option("-o", "--out", metavar="FILE.csv", help="Write a CSV file instead of a table."),
    ] = None,
    min_agents: MinAgents = 0,
    city: City = [],  # noqa: B006
    split: Split = [],  # noqa: B006
    can: Can = [],  # noqa: B006
    sample: Sample = None,
    seed: Annotated[int, selection_option(min=0, metavar="N", help="Seed of --sample.")] = 0,
    map_path: MapChoice = None,
    window: Window = 0,
    stride: Stride = None,
    jobs: Jobs = 1,
    as_json: AsJson = False,
    verbose: Verbose = 0,
    quiet: Quiet = False,
) -> None:
    """Tabulate a data set: agents, density, lanes, neighbours, and room for each manoeuvre."""
    set_up(verbose=verbose, quiet=quiet)
    check_scenes(scenes)
    if out is not None:
        check_out_file(out)
    with Activity(quiet=quiet) as activity:
        from bridge.batch.scan import SceneFacts, Selection, facts_of, select, write_facts
        from bridge.files import make_folder
        from bridge.recordings.folders import Choices
        from bridge.recordings.sources import find_recordings

        folders = find_recordings(scenes, Choices(map_path, window, stride))
        tell_formats(folders, activity)
        if out is not None:
            make_folder(out.parent)
        activity.doing("reading scenes")
        facts, failures = facts_of(folders, jobs=jobs, on_scene=activity.show)
        for folder, reason in failures:
            activity.message(unread_text(folder, reason))
        selection = Selection(min_agents, tuple(city), tuple(map(str, split)), tuple(map(str, can)), sample, seed)
        chosen = select(facts, with_cities_of(facts, selection))
    if out is not None:
        write_facts(out, chosen)
        print(out)
    elif as_json:
        print_json(SceneFacts._fields, chosen)
    else:
        print_table(f"{len(chosen)} of {len(folders)} scenes", SceneFacts.columns(), [fact.values() for fact in chosen])
    raise typer.Exit(SOME_FAILED if failures else ALL_DONE)


@command()
def net(
    scene: Scene,
    out: Out,
    *,
    map_path: MapChoice = None,
    window: Window = 0,
    as_json: AsJson = False,
    verbose: Verbose = 0,
    quiet: Quiet = False,
) -> None:
    """Write the lane graph as a SUMO net of 4 m cells, with the scene in SUMO's formats, and a report.

    The net is for simulating and looking at, not for editing: every cell ends in a junction, which netedit draws large.
    """
    set_up(verbose=verbose, quiet=quiet)
    check_one_scene(scene, map_file=True)
    check_out(out)
    with Activity("converting the map", quiet=quiet):
        found, playable = one_scene(scene, map_path, window), None
        if isinstance(found, Path) and not any(found.glob("scenario_*.parquet")):
            from bridge.sumo.net import convert

            report = convert(found, out)
        else:
            from bridge.sumo.exchange import write_sumo

            report, playable = write_sumo(found, out)
    head = ("what", "value")
    if as_json:
        print_json(head, report.rows())
    elif not quiet:
        print_table(f"{scene.name}: fidelity of the net", head, report.rows())
        if playable is not None:
            print(f"to play it: sumo-gui -c {playable}")
