"""A scene in sumo-gui at its exact positions: recorded agents grey, generated vehicles coloured by policy."""

import io
import itertools
import os
import sys
import tempfile
from collections.abc import Callable
from contextlib import redirect_stdout, suppress
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np

from bridge.files import make_folder
from bridge.pictures.figures import check_ending, check_step
from bridge.recordings.folders import Address
from bridge.recordings.scenario import Scenario
from bridge.recordings.sources import read_recording
from bridge.sumo.net import INSTALL_SUMO, sumo_program
from bridge.sumo.playback import GUI_SHAPES, ID_KEY, moving_ground, paints, scene_view_files, shows_id
from bridge.sumo.poses import sumo_poses
from hid2.agents import Track
from netconvert.cells import build_cell_grid
from netconvert.errors import ExportError, SimulationError
from netconvert.gui_files import REAL_TIME_MS
from netconvert.net_xml import net_bytes

#: As for replayed vehicles in libsumo: exact positions, on and off lanes. No tunables: they change no picture.
_KEEP_ROUTE = 6
_MATCH_M = 3.0
#: So often can a scene be seen again without a new start.
_ROUNDS = 50
_NEVER = 1e6
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

    It waits at the first step, and at the last one, until the user presses play there; then it begins again. speed: 1
    is real time. on_shown is called when the window is there. screenshot: a .png file, written at timestep `step`
    (default: the last observed one); the window then closes at once and the file is returned.
    Errors: ScenarioError, MapError; ConfigError for a step that there is none of; SimulationError without sumo-gui,
    traci or a display; ExportError where the picture cannot be written.
    """
    if screenshot is not None:
        check_ending(screenshot, [".png"])
    traci, binary = _traci(), _binary()
    scenario = read_recording(folder)
    pictured = check_step(scenario, step)
    with tempfile.TemporaryDirectory(prefix="hid2-gui-") as place:
        grid = build_cell_grid(scenario.graph)
        files = {"scene.net.xml": net_bytes(grid), **scene_view_files(scenario, grid, "scene")}
        for name, content in files.items():
            (Path(place) / name).write_bytes(content)
        command = [binary, "-c", str(Path(place) / "scene.sumocfg"), "--no-warnings", "true", "--quit-on-end"]
        command += ["--window-size", _WINDOW]  # else what the user's last window had, or a small one
        command += ["--collision.action", "none", "--time-to-teleport", "-1"]
        # where a list is expected an empty one is refused, so a time that never comes
        halts = [_NEVER] if screenshot is not None else _halts(scenario.num_steps * scenario.step_s, scenario.step_s)
        command += ["--breakpoints", ",".join(f"{halt:.2f}" for halt in halts)]
        command += ["--delay", "0" if screenshot is not None else f"{REAL_TIME_MS / speed:.0f}"]
        try:
            with redirect_stdout(io.StringIO()):  # traci prints that it retries
                traci.start(command, stdout=sys.stderr)
        except (traci.exceptions.TraCIException, traci.exceptions.FatalTraCIError, OSError) as error:
            raise SimulationError(f"sumo-gui does not start: {error}") from error
        try:
            _prepare(traci, scenario)
            if on_shown is not None:
                on_shown()
            if screenshot is not None:
                _play(traci, scenario, pictured)
                _photograph(traci, screenshot)
            else:
                for _ in range(_ROUNDS):
                    _play(traci, scenario, scenario.num_steps - 1)
                    for name in traci.vehicle.getIDList():
                        traci.vehicle.remove(name)
        except traci.exceptions.FatalTraCIError as error:  # the window was closed
            if screenshot is not None:
                raise SimulationError(f"sumo-gui ended before the picture was taken: {error}") from error
        finally:
            with suppress(traci.exceptions.FatalTraCIError, OSError):  # the window may be closed already
                traci.close(wait=False)
    return screenshot


def _halts(lasts_s: float, step_s: float) -> list[float]:
    """Seconds at which sumo-gui waits for its user: after the first step and at the end of every round."""
    return [step_s, *(lasts_s * number for number in range(1, _ROUNDS + 1))]


def _traci() -> ModuleType:
    # bridge.sumo.simulation sets this for libsumo's sake; traci would then be libsumo, which has no window
    setting = os.environ.pop("LIBSUMO_AS_TRACI", None)
    try:
        return import_module("traci")
    except ModuleNotFoundError:
        raise SimulationError(f"traci is not installed; {INSTALL_SUMO}") from None
    finally:
        if setting is not None:
            os.environ["LIBSUMO_AS_TRACI"] = setting


def _binary() -> str:
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise SimulationError("no display for sumo-gui: set DISPLAY, or run it under xvfb-run")
    binary = sumo_program("sumo-gui")
    if binary is None:
        raise SimulationError(f"sumo-gui is not installed; {INSTALL_SUMO}")
    return binary


def _prepare(traci: ModuleType, scenario: Scenario) -> None:
    low, high = moving_ground(scenario)
    view = traci.gui.getIDList()[0]
    traci.gui.setBoundary(view, float(low[0]), float(low[1]), float(high[0]), float(high[1]))
    traci.route.add("anywhere", [_any_edge(traci)])


def _play(traci: ModuleType, scenario: Scenario, last: int) -> None:
    """Show the steps from 0 to `last`, in as many steps of SUMO."""
    colors = paints(scenario)
    poses = {
        track.track_id: sumo_poses(track.position, track.heading, np.full(len(track.timesteps), track.size.length_m))
        for track in scenario.tracks
    }
    rows = {track.track_id: dict(zip(track.timesteps.tolist(), itertools.count())) for track in scenario.tracks}
    inside: set[str] = set()
    for step in range(last + 1):
        here = {track.track_id: track for track in scenario.tracks if step in rows[track.track_id]}
        for name in inside - here.keys():
            traci.vehicle.remove(name)
        for name, track in here.items():
            if name not in inside:
                _add(traci, track, colors[name].rgba)
            (x, y), angle = (part[rows[name][step]].tolist() for part in poses[name])
            _move(traci, name, x, y, angle)
        inside = set(here)
        traci.simulationStep()


def _move(traci: ModuleType, name: str, x: float, y: float, angle: float) -> None:
    traci.vehicle.moveToXY(name, "", -1, x, y, angle, keepRoute=_KEEP_ROUTE, matchThreshold=_MATCH_M)


def _any_edge(traci: ModuleType) -> str:
    """An edge that cars may use: where vehicles enter before they are moved to their places; not a bicycle lane."""
    lanes = (lane for lane in traci.lane.getIDList() if not lane.startswith(":"))
    lane = next(lane for lane in lanes if not (allowed := traci.lane.getAllowed(lane)) or "passenger" in allowed)
    return str(traci.lane.getEdgeID(lane))


def _add(traci: ModuleType, track: Track, rgba: tuple[int, int, int, int]) -> None:
    name = track.track_id
    traci.vehicle.add(name, "anywhere", depart="now")
    traci.vehicle.setLength(name, track.size.length_m)
    traci.vehicle.setWidth(name, track.size.width_m)
    traci.vehicle.setColor(name, rgba)
    if shows_id(track):
        traci.vehicle.setParameter(name, ID_KEY, name)
    if track.object_type in GUI_SHAPES:
        traci.vehicle.setShapeClass(name, GUI_SHAPES[track.object_type])


def _photograph(traci: ModuleType, path: Path) -> None:
    """Write the window's content; sumo-gui does so at its next step, in which vehicles stay where they are."""
    make_folder(path.parent)
    traci.gui.screenshot(traci.gui.getIDList()[0], str(path.resolve()))
    for name in traci.vehicle.getIDList():
        x, y = traci.vehicle.getPosition(name)
        _move(traci, name, x, y, traci.vehicle.getAngle(name))
    traci.simulationStep()
    if not path.is_file():
        raise ExportError(f"{path}: sumo-gui wrote no picture; is the folder writable?")
