"""Commands that show, check and pass on: `hid2 validate`, `scan`, `net`, `export`, `view`, `render`, `plot`, ..."""

from pathlib import Path
from shlex import quote
from shutil import copytree, ignore_patterns

from bridge.cli import options
from bridge.cli.places import check_out, one_scene, recordings, select_scenes, tell_unread
from bridge.console import Activity, counted, print_json, print_table, say
from bridge.files import data_folder, explained
from bridge.recordings.folders import Address
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
    from bridge.recordings.folders import find_scenarios
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


@options.command(reads=("scenes",), files=("out",))
def scan(
    scenes: list[Path] = options.SCENES,
    *,
    out: Path | None = options.output("Write a CSV file instead of a table.", None, "FILE.csv", "-o"),
    which: options.Which,
    events: bool = options.selection("Look for all events with av and focal, up to a minute a scene.", False),
    seed: int = options.selection("Seed of --sample.", 0, "N", min=0),
    windows: options.Windows,
    jobs: int = options.JOBS,
    as_json: bool = options.AS_JSON,
    activity: Activity,
) -> bool:
    """Tabulate a data set: agents, density, lanes, neighbours, and room for each manoeuvre.

    What each column is: bridge/generation/README.md, Which scenes.
    """
    from bridge.batch.scan import EVENTS, SceneFacts, Selection, facts_of, select
    from bridge.files import make_folder, write_rows

    folders = recordings(scenes, windows, activity)
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


@options.command()
def net(
    scene: Path = options.argument("SCENE", "Scenario folder, or a map."),
    out: Path = options.OUT,
    *,
    lanes: options.LanesName = options.option("cells: lanes cut into cells of 4 m; whole: a SUMO lane each.", "cells"),
    signals: bool = options.option("With --lanes whole: the signals that are inferred from the traffic.", False),
    window: options.OneWindow,
    as_json: bool = options.AS_JSON,
    activity: Activity,
) -> None:
    """Write the lane graph as a SUMO net: of 4 m cells with files for sumo-gui and a report, or of whole lanes.

    Cells are what vehicles are inserted on; whole lanes are for demand, routing and simulations of SUMO's own, and need
    the extra `gui`. netconvert and netedit can save both. The scene on the net: hid2 export --to sumo.
    """
    if signals and lanes == "cells":
        raise ConfigError("--signals: expected --lanes whole with it, a net of cells has no signals")
    found = scene if scene.is_file() and scene.suffix == ".json" else one_scene(scene, window)
    check_out(out)
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
    windows: options.Windows,
    activity: Activity,
) -> bool:
    """Write scenes in the formats of others: OpenSCENARIO, OpenDRIVE, CommonRoad, SSAM's trajectories, SUMO's.

    Files have the scenes' ids as names and lie side by side; OpenSCENARIO brings the OpenDRIVE map that it
    refers to, FCD output the net.
    """
    activity.doing("writing scenes")
    from bridge.exports.export import export_scene

    found = recordings(scenes, windows, activity)
    written, failures = list[Path](), list[tuple[Address, str]]()
    for count, address in enumerate(found, start=1):
        try:
            written += export_scene(address, to, out)
        except (ScenarioError, MapError, NetError) as error:  # any other is not of this scene alone
            failures.append((address, str(error)))
        activity.show(count, len(found))
    tell_unread(failures)
    activity.result(*written)
    return bool(failures)


STEP = options.option("Timestep of a picture.", None, "N", min=0, show_default="the last observed one")


@options.command(reads=("scenes",), files=("out",))
def view(
    scenes: list[Path] = options.argument("SCENE", "Scenes, recorded or generated: folders of them, splits, roots."),
    out: Path = options.output("Page to write: .html.", ..., "FILE", "-o"),
    *,
    which: options.Which,
    seed: int = options.selection("Seed of --sample.", 0, "N", min=0),
    windows: options.Windows,
    activity: Activity,
) -> None:
    """Write scenes as one HTML file that a browser plays, without a network: what each vehicle did, and why."""
    activity.doing("looking for scenes")
    from bridge.pages.viewer import view_scenes
    from bridge.pictures.figures import check_ending

    check_ending(out, (".html",))
    found = select_scenes(recordings(scenes, windows, activity), which, seed, activity, jobs=1)
    activity.doing("packing scenes")
    activity.result(view_scenes(found, out, on_scene=activity.show))


@options.command(reads=("scene",), files=("out",))
def render(
    scene: Path = options.SCENE,
    out: Path = options.output("Picture (.png, .jpg, .pdf, .svg) or film (.gif, .mp4) to write.", ..., "FILE", "-o"),
    *,
    agent: str | None = options.option("Highlight this track and show its surroundings.", None, "ID"),
    cells: bool = options.option("Show the cells of the lanes.", False),
    step: int | None = STEP,
    window: options.OneWindow,
    activity: Activity,
) -> None:
    """Draw a scene from above, before and after: a picture or a film."""
    found = one_scene(scene, window)
    from bridge.pictures.render import render_scene
    from bridge.recordings.sources import read_recording

    activity.doing("drawing")
    recording = read_recording(found)
    activity.result(render_scene(recording, out, agent=agent, cells=cells, step=step, on_frame=activity.show))


@options.command(reads=("scene",), files=("out",))
def plot(
    scene: Path = options.SCENE,
    out: Path = options.output("Picture to write: .png, .jpg, .pdf or .svg.", ..., "FILE", "-o"),
    agent: str = options.option("The track, for example gen_0.", ..., "ID"),
    *,
    window: options.OneWindow,
    activity: Activity,
) -> None:
    """Draw one track over time: speed, acceleration, jerk, lateral offset and cells, with its manoeuvres marked."""
    found = one_scene(scene, window)
    activity.doing("drawing")
    from bridge.pictures.figures import check_ending, save
    from bridge.pictures.plot import agent_figure
    from bridge.recordings.sources import read_recording

    check_ending(out)
    save(agent_figure(read_recording(found), agent), out)
    activity.result(out)


@options.command(reads=("scene",), files=("screenshot",))
def gui(
    scene: Path = options.SCENE,
    *,
    speed: float = options.option("Speed of playing; 1 is real time.", 1.0, "X", min=0.01, max=100),
    screenshot: Path | None = options.output("Take a picture, then close the window.", None, "FILE.png"),
    step: int | None = STEP,
    window: options.OneWindow,
    activity: Activity,
) -> None:
    """Play a scene in sumo-gui, paused at the first step (needs the extra `gui` and a screen)."""
    found = one_scene(scene, window)
    activity.doing("starting sumo-gui")
    from bridge.sumo.exchange import play_scene

    def shown() -> None:
        activity.end()
        if screenshot is None and not activity.quiet:
            say("sumo-gui waits at the first step: play with Ctrl+A, stop with Ctrl+S, start again with Ctrl+R")

    picture = play_scene(found, speed=speed, screenshot=screenshot, step=step, on_shown=shown)
    activity.result(*(() if picture is None else (picture,)))


#: What `example` writes, and the commands that it prints.
EXAMPLES = ("av2", "configs", "studies", "public", "examples")
TRY = (
    "hid2 generate {0}/av2 -o {0}/out --agents 10",
    "hid2 validate {0}/out --source {0}/av2",
    "hid2 view {0}/out -o {0}/scenes.html",
    "hid2 generate {0}/av2 -o {0}/events --agents 0 --event cut_in --target any --at 1.5:6",
    "hid2 study {0}/studies/lane_change_timing_real.toml --scenes {0}/av2 -o {0}/timing --plan 0.1",
)


@options.command(folders=("out",))
def example(out: Path = options.OUT, *, activity: Activity) -> None:
    """Write synthetic scenes with configurations, studies and notebooks to try, and print commands that do."""
    for name in EXAMPLES:
        if (out / name).exists():
            raise ConfigError(f"{out / name}: is there already, expected a folder without it: choose another one")
    for name in EXAMPLES:
        with explained(out / name):
            copytree(data_folder() / name, out / name, ignore=ignore_patterns("__pycache__", ".*", "*.png"))
    activity.result(*(line.format(quote(str(out))) for line in TRY))


@options.command()
def config(
    *,
    config: Path | None = options.CONFIG,
    settings: list[str] = options.SETTINGS,
    toml: bool = options.output("Print the resolved configuration as a TOML file; so do --config and --set.", False),
    as_json: bool = options.AS_JSON,
) -> None:
    """List every parameter with default, unit, range and source, by its use: request, paper, ..., expert."""
    from bridge.config import ParameterRow, config_to_toml, describe_config, load_config

    if toml or config is not None or settings:
        print(config_to_toml(load_config(config, settings)), end="")
    elif as_json:
        print_json(ParameterRow._fields, describe_config())
    else:
        print_table("Parameters", ParameterRow._fields, describe_config())
