"""A scene's map as files for SUMO: what `hid2 net` does."""

import re
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path

from bridge.config import config_from_dict
from bridge.files import explained, make_folder
from bridge.interruption import hidden_folder
from bridge.recordings.folders import MAP_PATTERN, PARQUET_PATTERN, Address, Source, only_file
from bridge.recordings.judging import recording_states
from bridge.recordings.map_rules import read_source_map
from bridge.recordings.recording import Recording
from bridge.recordings.road import ROAD_FILE, read_road
from bridge.recordings.scenario import STEP_S
from bridge.recordings.sources import read_recording
from hid2.conflicts.signals import InferredSignals
from hid2.params import Config, Signals
from netconvert.cells import SAVED_WITHIN_M, CellGrid, build_cell_grid
from netconvert.errors import ConfigError, ExportError, MapError, NetError, NoSceneError, ScenarioError, SimulationError
from netconvert.fidelity import FidelityReport, measure_fidelity
from netconvert.gui_files import gui_files
from netconvert.lane_graph import LaneGraph
from netconvert.net_xml import CITY_ORIGINS, net_bytes
from netconvert.whole_lanes import Shown, plain_files

#: No turns back where the map has none, and no two vehicles on ways that cross within a junction.
_WHOLE_OPTIONS = ["--no-turnarounds", "true", "--check-lane-foes.all", "true", "--xml-validation", "never"]
_WHOLE_OPTIONS += ["--offset.disable-normalization", "true"]


def config_of(recording: Recording) -> Config:
    """Parameters that a generated scene was made with, else the defaults. Errors: ScenarioError."""
    try:
        return Config() if recording.sidecar is None else config_from_dict(recording.sidecar.config, source="config")
    except ConfigError as error:  # of this scene alone
        raise ScenarioError(f"{recording.folder}: the sidecar's {error}") from error


def scene_net(recording: Recording, grid: CellGrid) -> bytes:
    """The one <id>.net.xml of a scene, with its place on the globe and the speed limit that it was driven with."""
    fastest_mps = config_of(recording).spawn.max_speed_mps
    return net_bytes(grid, origin=CITY_ORIGINS.get(recording.city), fastest_mps=fastest_mps)


def convert(scene: Address, out_dir: Path) -> FidelityReport:
    """Write <id>.net.xml, .sumocfg, .poly.xml, .view.xml and .cells.csv of a scene's map into out_dir.

    scene: a recording, of which `scene_net` is the net; or a folder with one log_map_archive_<id>.json, or that file.
    Files of an earlier run are replaced, all of them or, after an error, none; a .sumocfg with routes is kept.
    Errors: ScenarioError, MapError, NetError, ExportError.
    """
    name, graph, recording = _map_of(scene)
    grid = build_cell_grid(graph, saved_within_m=SAVED_WITHIN_M)
    net = net_bytes(grid) if recording is None else scene_net(recording, grid)
    report = measure_fidelity(grid, net)
    files = {f"{name}.net.xml": net, **gui_files(grid, name, step_s=STEP_S if recording is None else recording.step_s)}
    config = out_dir / f"{name}.sumocfg"
    if config.is_file() and b"<route-files" in config.read_bytes():  # of `hid2 export --to sumo`
        del files[config.name]
    write_all(out_dir, files)
    return report


def convert_whole(scene: Address, out_dir: Path, *, signals: bool = False) -> Path:
    """Write <id>.whole.net.xml into out_dir: one SUMO lane for each lane, by SUMO's netconvert; returns the file.

    signals: with programs of the signals: a road's own, else inferred from the recorded traffic, as long as the scene.
    Errors: ScenarioError, MapError; SimulationError without netconvert, NetError where it makes no net; ConfigError for
    signals of a map alone.
    """
    name, graph, recording = _map_of(scene)
    shown: Shown | None = None
    if signals:
        if recording is None:
            raise ConfigError(f"{scene}: a map alone, expected a scene: signals are inferred from its traffic")
        if (road := recording.folder / ROAD_FILE).is_file():
            shown = {lane_id: one.shown(recording.step_s) for lane_id, one in read_road(road).signals.items()}.get
        else:
            shown = InferredSignals(graph, recording_states(recording), Signals()).shown
    step_s = STEP_S if recording is None else recording.step_s
    origin = None if recording is None else CITY_ORIGINS.get(recording.city)
    with tempfile.TemporaryDirectory(prefix="hid2-net-") as folder:
        net = Path(folder, "net.xml")
        command = [sumo_program("netconvert"), *_WHOLE_OPTIONS, "--output-file", str(net)]
        for option, content in plain_files(graph, origin=origin, shown=shown, step_s=step_s).items():
            Path(folder, option).write_bytes(content)
            command += [f"--{option}", str(Path(folder, option))]
        result = subprocess.run(command, capture_output=True, text=True, check=False)
        if result.returncode != 0 or not net.is_file():
            said = next((line for line in result.stderr.splitlines() if "Error" in line), f"code {result.returncode}")
            raise NetError(f"{name}: netconvert makes no net of the map: {said}")
        # Its comment has date and paths: the same map gives the same bytes.
        content = re.sub(rb"<!--.*?-->\s*", b"", net.read_bytes(), count=1, flags=re.DOTALL)
    write_all(out_dir, {f"{name}.whole.net.xml": content})
    return out_dir / f"{name}.whole.net.xml"


def sumo_program(name: str) -> str:
    """One of SUMO's programs, of the wheel or as it is installed otherwise. Errors: SimulationError without it."""
    try:  # the wheel's program itself: the script that starts it prints a traceback when interrupted
        inside = Path(import_module("sumo").SUMO_HOME) / "bin" / name  # sets what SUMO needs of the environment
    except ModuleNotFoundError:
        inside = Path(name)
    found = str(inside) if inside.is_file() else shutil.which(name)
    if found is None:
        way_out = "sh setup.sh tests, or in your own environment pip install 'eclipse-sumo==1.28.*'"
        raise SimulationError(f"SUMO's {name} is not installed; install it: {way_out}")
    return found


def _map_of(scene: Address) -> tuple[str, LaneGraph, Recording | None]:
    """Id, lane graph and recording, which a map alone is not."""
    if isinstance(scene, Source) or any(scene.glob(PARQUET_PATTERN)):
        recording = read_recording(scene)
        return recording.scenario_id, recording.graph, recording
    if not scene.exists():
        raise NoSceneError(f"{scene}: no such file or folder, expected a scene or log_map_archive_<id>.json")
    path = scene if scene.is_file() else only_file(scene, MAP_PATTERN, MapError)
    return path.stem.removeprefix("log_map_archive_"), read_source_map(path), None


def write_all(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write every file to a hidden folder beside its place, then move all of them there. Errors: ExportError."""
    make_folder(folder)
    for name in files:
        if (folder / name).is_dir():
            raise ExportError(f"{folder / name}: is a folder, expected a file to write; choose another output folder")
    with explained(folder), hidden_folder(folder) as beside:
        for name, content in files.items():
            (beside / name).write_bytes(content)
        for name in files:
            (beside / name).replace(folder / name)
