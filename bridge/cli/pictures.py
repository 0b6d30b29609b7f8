"""`hid2 render`, `plot` and `gui`: scenes to look at."""

from pathlib import Path
from typing import Annotated

import typer

from bridge.cli.app import command
from bridge.cli.options import MapChoice, Quiet, Scene, Verbose, Window, output_option
from bridge.cli.places import check_one_scene, check_out_file
from bridge.cli.session import one_scene, set_up
from bridge.console import Activity, say

Step = Annotated[
    int | None,
    typer.Option(min=0, metavar="N", help="Timestep of a picture.", show_default="the last observed one"),
]


@command()
def render(
    scene: Scene,
    out: Annotated[
        Path,
        output_option(
            "-o", "--out", metavar="FILE", help="Picture (.png, .jpg, .pdf, .svg) or film (.gif, .mp4) to write."
        ),
    ],
    *,
    source: Annotated[
        Path | None,
        typer.Option(
            metavar="SCENE", help="The source scene: shown as before, and its labelled sizes are used in both halves."
        ),
    ] = None,
    agent: Annotated[
        str | None, typer.Option(metavar="ID", help="Highlight this track and show its surroundings.")
    ] = None,
    cells: Annotated[bool, typer.Option("--cells", metavar="", help="Show the cells of the lanes.")] = False,
    step: Step = None,
    map_path: MapChoice = None,
    window: Window = 0,
    verbose: Verbose = 0,
    quiet: Quiet = False,
) -> None:
    """Draw a scene from above, before and after: a picture or a film."""
    set_up(verbose=verbose, quiet=quiet)
    check_one_scene(scene)
    if source is not None:
        check_one_scene(source)
    check_out_file(out)
    with Activity(quiet=quiet) as activity:
        from bridge.pictures.render import render_scene

        activity.doing("drawing")
        found = one_scene(scene, map_path, window)
        before = None if source is None else one_scene(source, map_path, window)
        written = render_scene(found, out, source=before, agent=agent, cells=cells, step=step, on_frame=activity.show)
    if not quiet:
        print(written)


@command()
def plot(
    scene: Scene,
    out: Annotated[
        Path,
        output_option("-o", "--out", metavar="FILE", help="Picture to write: .png, .jpg, .pdf or .svg."),
    ],
    agent: Annotated[str, typer.Option(metavar="ID", help="The track, for example gen_0.")],
    *,
    map_path: MapChoice = None,
    window: Window = 0,
    verbose: Verbose = 0,
    quiet: Quiet = False,
) -> None:
    """Draw one track over time: speed, acceleration, jerk, lateral offset and cells, with its manoeuvres marked."""
    set_up(verbose=verbose, quiet=quiet)
    check_one_scene(scene)
    check_out_file(out)
    with Activity("drawing", quiet=quiet):
        from bridge.pictures.plot import plot_agent

        written = plot_agent(one_scene(scene, map_path, window), agent, out)
    if not quiet:
        print(written)


@command()
def gui(
    scene: Scene,
    *,
    speed: Annotated[
        float, typer.Option(min=0.01, max=100, metavar="X", help="Speed of playing; 1 is real time.")
    ] = 1.0,
    screenshot: Annotated[
        Path | None,
        output_option(metavar="FILE.png", help="Take a picture, then close the window."),
    ] = None,
    step: Step = None,
    map_path: MapChoice = None,
    window: Window = 0,
    verbose: Verbose = 0,
    quiet: Quiet = False,
) -> None:
    """Play a scene in sumo-gui at its exact positions, paused at first (needs the extra `gui` and a screen)."""
    set_up(verbose=verbose, quiet=quiet)
    check_one_scene(scene)
    if screenshot is not None:
        check_out_file(screenshot)
    with Activity("starting sumo-gui", quiet=quiet) as activity:
        from bridge.sumo.gui import play_scene

        found = one_scene(scene, map_path, window)

        def shown() -> None:
            activity.end()
            if screenshot is None and not quiet:
                say("sumo-gui waits at the first step: play with Ctrl+A, stop with Ctrl+S, close the window to end")

        picture = play_scene(found, speed=speed, screenshot=screenshot, step=step, on_shown=shown)
    if picture is not None and not quiet:
        print(picture)
