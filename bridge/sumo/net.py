"""A scene's map as files for SUMO: what `hid2 net` does."""

from collections.abc import Mapping
from pathlib import Path

from bridge.files import unwritten
from bridge.interruption import hidden_folder
from bridge.recordings.folders import MAP_PATTERN, only_file
from bridge.recordings.map_rules import read_source_map
from bridge.recordings.scenario import STEP_S
from netconvert.cells import SAVED_WITHIN_M, build_cell_grid
from netconvert.errors import MapError, NetError, NoSceneError
from netconvert.fidelity import FidelityReport, measure_fidelity
from netconvert.gui_files import gui_files
from netconvert.net_xml import net_bytes


def convert(scene: Path, out_dir: Path, *, cell_m: float = 4.0) -> FidelityReport:
    """Write <id>.net.xml, .sumocfg, .poly.xml, .view.xml and .cells.csv of a scene's map into out_dir.

    scene: a folder with one log_map_archive_<id>.json, or that file; the recorded tracks are not needed. Files of an
    earlier run are replaced, all of them or, after an error, none. Errors: MapError, NetError.
    """
    path = _map_file(scene)
    name = path.stem.removeprefix("log_map_archive_")
    grid = build_cell_grid(read_source_map(path), cell_m=cell_m, saved_within_m=SAVED_WITHIN_M)
    net = net_bytes(grid)
    report = measure_fidelity(grid, net)
    write_all(out_dir, {f"{name}.net.xml": net, **gui_files(grid, name, step_s=STEP_S)})
    return report


def _map_file(scene: Path) -> Path:
    if scene.is_file():
        return scene
    if not scene.is_dir():
        raise NoSceneError(f"{scene}: no such folder, expected a scenario folder")
    return only_file(scene, MAP_PATTERN, MapError)


def write_all(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write every file to a hidden folder beside its place, then move all of them there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with hidden_folder(folder) as beside:
            for name, content in files.items():
                (beside / name).write_bytes(content)
            for name in files:
                (beside / name).replace(folder / name)
    except OSError as error:
        raise NetError(f"{folder}: the net {unwritten(error)}") from error
