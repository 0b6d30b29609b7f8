"""A scene's map as files for SUMO: what `hid2 net` does."""

from collections.abc import Mapping
from pathlib import Path

from bridge.interruption import hidden_folder
from bridge.recordings.folders import MAP_PATTERN, PARQUET_PATTERN, Address, Source, only_file
from bridge.recordings.map_rules import read_source_map
from bridge.recordings.scenario import STEP_S
from bridge.recordings.sources import read_recording
from netconvert.cells import SAVED_WITHIN_M, build_cell_grid
from netconvert.errors import MapError, NetError, NoSceneError
from netconvert.fidelity import FidelityReport, measure_fidelity
from netconvert.geo import CITY_ORIGINS
from netconvert.gui_files import gui_files
from netconvert.lane_graph import LaneGraph
from netconvert.net_xml import net_bytes


def convert(scene: Address, out_dir: Path, *, cell_m: float = 4.0) -> FidelityReport:
    """Write <id>.net.xml, .sumocfg, .poly.xml, .view.xml and .cells.csv of a scene's map into out_dir.

    scene: a recording, which gives the net a place on the globe; or a folder with one log_map_archive_<id>.json, or
    that file. Files of an earlier run are replaced, all of them or, after an error, none.
    Errors: ScenarioError, MapError, NetError.
    """
    name, graph, city = _map_of(scene)
    grid = build_cell_grid(graph, cell_m=cell_m, saved_within_m=SAVED_WITHIN_M)
    net = net_bytes(grid, origin=CITY_ORIGINS.get(city))
    report = measure_fidelity(grid, net)
    write_all(out_dir, {f"{name}.net.xml": net, **gui_files(grid, name, step_s=STEP_S)})
    return report


def _map_of(scene: Address) -> tuple[str, LaneGraph, str]:
    """Id, lane graph and city, which a map alone does not tell."""
    if isinstance(scene, Source) or any(scene.glob(PARQUET_PATTERN)):
        recording = read_recording(scene)
        return recording.scenario_id, recording.graph, recording.city
    if not scene.exists():
        raise NoSceneError(f"{scene}: no such folder, expected a scenario folder")
    path = scene if scene.is_file() else only_file(scene, MAP_PATTERN, MapError)
    return path.stem.removeprefix("log_map_archive_"), read_source_map(path), ""


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
        raise NetError(f"{folder}: cannot be written: {error.strerror}") from error
