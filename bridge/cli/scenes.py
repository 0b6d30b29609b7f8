"""Commands that check and pass on scenes: `hid2 validate`, `scan`, `net`, `export`."""

from collections import Counter
from pathlib import Path
from typing import NamedTuple

from bridge.cli import options
from bridge.cli.places import one_scene, recordings, tell_unread
from bridge.console import Activity, counted, print_json, print_table
from bridge.recordings.folders import Address, Choices
from netconvert.errors import ConfigError, MapError, NetError, ScenarioError


@options.command(reads=("out", "source"), files=("csv",))
def validate(
    out: Path = options.argument("OUT", "Generated scenes: a scenario folder, a split folder or a root."),
    *,
    source: list[Path] = options.option("The source scenes, to compare recorded tracks with; repeatable.", [], "DIR"),
    inserted: list[str] = options.option(
        "Judge this track as if it were inserted, instead of those that hid2 inserted; repeatable.", [], "ID"
    ),
    csv: Path | None = options.option("Write the findings as a table as well.", None, "FILE.csv"),
    map_path: Path | None = options.MAP,
    jobs: int = options.JOBS,
    as_json: bool = options.AS_JSON,
    activity: Activity,
) -> bool:
    """Check that scenes are valid Argoverse 2 scenes, safe, driveable, and true to their claims; findings go to stdout.

    Ends with 1 where something is wrong; notes are told and are no faults.
    """
    activity.doing("checking scenes")
    from bridge.batch.validation import validate_folder
    from bridge.files import write_rows
    from bridge.recordings.sources import find_scenarios
    from bridge.recordings.validate import FileBreach

    findings = validate_folder(
        out, source=source, map_path=map_path, inserted=inserted, jobs=jobs, on_scene=activity.show
    )
    if csv is not None:
        write_rows(csv, FileBreach._fields, findings)
    activity.end()
    if as_json:
        print_json(FileBreach._fields, findings)
    else:
        for finding in findings:
            print(finding.line())
    wrong = sum(not finding.is_note for finding in findings)
    notes = f", {counted(len(findings) - wrong, 'note')}" if wrong < len(findings) else ""
    activity.note(f"{out}: {counted(len(find_scenarios(out)), 'scene')}, {counted(wrong, 'finding')}{notes}")
    return bool(wrong)


class Printed(NamedTuple):
    """Where a table goes."""

    out: Path | None = options.output("Write a CSV file instead of a table.", None, "FILE.csv", "-o")
    as_json: bool = options.AS_JSON


@options.command(reads=("scenes",), files=("out",))
def scan(
    scenes: list[Path] = options.SCENES,
    *,
    printed: Printed,
    which: options.Which,
    events: bool = options.selection("Look for all events with av and focal, up to a minute a scene.", False),
    seed: int = options.selection("Seed of --sample.", 0, "N", min=0),
    choices: Choices,
    jobs: int = options.JOBS,
    activity: Activity,
) -> bool:
    """Tabulate a data set: agents, density, lanes, neighbours, and room for each manoeuvre.

    What each column is: bridge/generation/README.md, Which scenes.
    """
    from bridge.batch.scan import EVENTS, SceneFacts, Selection, facts_of, select
    from bridge.files import make_folder, write_rows

    folders, (out, as_json) = recordings(scenes, choices, activity), printed
    if out is not None and as_json:
        raise ConfigError("--json does nothing here, as -o names a CSV file; give one of the two")
    if out is not None:
        make_folder(out.parent)
    activity.doing("reading scenes")
    facts, failures = facts_of(folders, (*which.can, *(EVENTS if events else ())), jobs=jobs, on_scene=activity.show)
    tell_unread(failures)
    chosen = select(facts, Selection(*which, seed))
    activity.end()
    if out is not None:
        write_rows(out, SceneFacts._fields, chosen)
        print(out)
    elif as_json:
        print_json(SceneFacts._fields, chosen)
    else:
        print_table(f"{len(chosen)} of {len(folders)} scenes", SceneFacts._fields[1:], [fact[1:] for fact in chosen])
    return bool(failures)


@options.command(folders=("out",))
def net(
    scene: Path = options.argument("SCENE", "Scenario folder, or a map."),
    out: Path = options.OUT,
    *,
    lanes: options.LanesName = options.option("cells: lanes cut into cells of 4 m; whole: a SUMO lane each.", "cells"),
    signals: bool = options.option("With --lanes whole: inferred signals, repeated; red throughout stays red.", False),
    window: options.OneWindow,
    as_json: bool = options.AS_JSON,
    given: options.Given,
    activity: Activity,
) -> None:
    """Write the lane graph as a SUMO net: of 4 m cells with files for sumo-gui and a report, or of whole lanes.

    Cells are what vehicles are inserted on; whole lanes are for demand, routing and simulations of SUMO's own, and need
    the extra `gui`. netconvert and netedit can save both. The scene on the net: hid2 export --to sumo.
    """
    if signals and lanes == "cells":
        raise ConfigError("--signals: expected --lanes whole with it, a net of cells has no signals")
    is_map = scene.suffix == ".json" and not scene.is_dir()
    more = (set() if is_map else {"--map", "--window"}) | (set() if lanes == "whole" else {"--json"})
    given.check(
        {"SCENE", "--out", "--lanes", "--signals", "--verbose", "--quiet", *more},
        f"--lanes {lanes} of {'a map' if is_map else 'a scene'}",
    )
    found = scene if is_map else one_scene(scene, window)
    activity.doing("converting the map")
    from bridge.sumo.net import convert, convert_whole

    if lanes == "whole":
        activity.result(convert_whole(found, out, signals=signals))
    else:
        rows = convert(found, out).rows()
        activity.table(f"{scene.name}: fidelity of the net", ("what", "value"), rows, as_json=as_json)


@options.command(reads=("scenes",), folders=("out",))
def export(
    scenes: list[Path] = options.argument("SCENE", "Scenes, recorded or generated: folders of them, splits, roots."),
    out: Path = options.OUT,
    *,
    to: options.FormatName = options.output("Format to write.", ..., None, "--to"),
    choices: Choices,
    activity: Activity,
) -> bool:
    """Write scenes in the formats of others: OpenSCENARIO, OpenDRIVE, CommonRoad, SSAM's trajectories, SUMO's.

    Files have the scenes' ids as names and lie side by side; OpenSCENARIO brings the OpenDRIVE map that it
    refers to, FCD output the net.
    """
    activity.doing("writing scenes")
    from bridge.exports.export import export_scene

    found = recordings(scenes, choices, activity)
    written, failures = list[Path](), list[tuple[Address, str]]()
    for count, address in enumerate(found, start=1):
        try:
            written += export_scene(address, to, out)
        except (ScenarioError, MapError, NetError) as error:  # any other is not of this scene alone
            failures.append((address, str(error)))
        activity.show(count, len(found))
    said = "{} scenes have this id, expected one: the file is the last one's; export them to folders apart"
    failures += [(path, said.format(times)) for path, times in Counter(written).items() if times > 1]
    tell_unread(failures)
    activity.result(*dict.fromkeys(written))
    return bool(failures)
