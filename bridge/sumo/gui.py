"""A scene in sumo-gui: the files of `bridge.sumo.playback`, opened."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from lxml import etree
from lxml.builder import E

from bridge.files import make_folder
from bridge.pictures.figures import check_ending, check_step
from bridge.recordings.folders import Address
from bridge.recordings.sources import read_recording
from bridge.sumo.net import sumo_program
from bridge.sumo.playback import playable_files
from netconvert.cells import build_cell_grid
from netconvert.errors import ExportError, SimulationError
from netconvert.gui_files import REAL_TIME_MS, xml_bytes

_WINDOW = "1280,900"


def play_scene(
    folder: Address,
    *,
    speed: float = 1.0,
    screenshot: Path | None = None,
    step: int | None = None,
    on_shown: Callable[[], None] | None = None,
) -> Path | None:
    """Play a recorded or generated scene folder in sumo-gui; returns when its window is closed.

    It waits at the first step until the user presses play, and shows the last one until the user reloads. speed: 1 is
    real time. on_shown is called when sumo-gui has been started. screenshot: a .png file, written at timestep `step`
    (default: the last observed one); the window then closes at once and the file is returned.
    Errors: ScenarioError, MapError; ConfigError for a step that there is none of; SimulationError without sumo-gui or
    a display, or where it fails; ExportError where the picture cannot be written.
    """
    if screenshot is not None:
        check_ending(screenshot, [".png"])
    binary = sumo_program("sumo-gui")
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise SimulationError("no display for sumo-gui: set DISPLAY, or run it under xvfb-run")
    scenario = read_recording(folder)
    at_s = check_step(scenario, step) * scenario.step_s
    files = playable_files(scenario, build_cell_grid(scenario.graph))
    name = f"{scenario.scenario_id}_scene"
    options = {"window-size": _WINDOW, "delay": f"{REAL_TIME_MS / speed:.0f}"}  # else what the user's last window had
    if screenshot is not None:
        make_folder(screenshot.parent)
        view = etree.fromstring(files[f"{name}.view.xml"])
        view.append(E.snapshot(file=str(screenshot.resolve()), time=f"{at_s:.2f}"))
        files[f"{name}.view.xml"] = xml_bytes(view)
        # where a list is expected an empty one is refused, so a time that never comes
        end_s = at_s + 2 * scenario.step_s
        options |= {"delay": "0", "breakpoints": "1e6", "end": f"{end_s:.2f}", "quit-on-end": "true"}
    with tempfile.TemporaryDirectory(prefix="hid2-gui-") as place:
        for file, content in files.items():
            (Path(place) / file).write_bytes(content)
        command = [binary, "-c", str(Path(place) / f"{name}.sumocfg"), "--no-warnings", "true"]
        command += [word for key, value in options.items() for word in (f"--{key}", value)]
        with subprocess.Popen(command, stdout=sys.stderr) as window:
            if on_shown is not None:
                on_shown()
            code = window.wait()
    if code > 0:
        raise SimulationError(f"{binary} ended with exit code {code}; what it says stands above")
    if screenshot is not None and not screenshot.is_file():
        raise ExportError(f"{screenshot}: sumo-gui wrote no picture; is the folder writable?")
    return screenshot
