"""Commands that show: `hid2 view`, `render`, `plot`, `gui`; `example` and `config`."""

from pathlib import Path
from shlex import quote
from shutil import copytree, ignore_patterns

from bridge.cli import options
from bridge.cli.places import one_scene, recordings, select_scenes, tell_unread
from bridge.console import Activity, print_json, print_table, say
from bridge.files import data_folder, explained
from bridge.recordings.folders import Choices
from netconvert.errors import ConfigError

STEP = options.option("Timestep of a picture.", None, "N", min=0, show_default="the last observed one")


@options.command(reads=("scenes",), files=("out",))
def view(
    scenes: list[Path] = options.argument("SCENE", "Scenes, recorded or generated: folders of them, splits, roots."),
    out: Path = options.output("Page to write: .html.", ..., "FILE", "-o"),
    *,
    which: options.Which,
    seed: int = options.selection("Seed of --sample.", 0, "N", min=0),
    choices: Choices,
    activity: Activity,
) -> bool:
    """Write scenes as one HTML file that a browser plays, without a network: what each vehicle did, and why."""
    activity.doing("looking for scenes")
    from bridge.pages.viewer import view_scenes
    from bridge.pictures.figures import check_ending

    check_ending(out, (".html",))
    found = select_scenes(recordings(scenes, choices, activity), which, seed, activity, jobs=1)
    activity.doing("packing scenes")
    page, unread = view_scenes(found, out, on_scene=activity.show)
    tell_unread(unread)
    activity.result(page)
    return bool(unread)


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
        if as_json:
            raise ConfigError("--json does nothing here, where a configuration is printed as TOML; leave it out")
        print(config_to_toml(load_config(config, settings)), end="")
    elif as_json:
        print_json(ParameterRow._fields, describe_config())
    else:
        print_table("Parameters", ParameterRow._fields, describe_config())
