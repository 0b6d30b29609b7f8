"""What a process of a study, or of a page of public roads, does: drive each run and write what was measured."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from bridge.batch.batch import Run, SceneFolders, base_row
from bridge.batch.isolation import Failure, attempts
from bridge.batch.manifest import ManifestRow
from bridge.config import config_sha256
from bridge.generation.gaps import gaps_bytes
from bridge.generation.generate import PreparedScene, prepare
from bridge.recordings.road import ROAD_FILE, read_road
from bridge.recordings.sources import read_recording
from bridge.recordings.ssam import trj_bytes
from bridge.studies.paired import Drawn, draw, drawing_config, paired_run
from bridge.studies.road_traffic import RoadTraffic
from bridge.studies.study import LOOKS_FILE, RUN_TABLES, write_run
from hid2.params import Config


def measure_runs(place: SceneFolders, runs: Sequence[Run], *, trj: bool = False) -> Iterator[ManifestRow | Failure]:
    """Drive and measure each run; what the runs share is made once. trj: write its trajectories for SSAM, too."""
    prepared: PreparedScene | None = None
    drawn: dict[str, Drawn] = {}

    def measured(config: Config) -> tuple[Path, dict[str, Any]]:
        nonlocal prepared, drawn
        if prepared is None:
            prepared = prepare(read_recording(place.folder), config)
        drawing = drawing_config(config)
        key = config_sha256(drawing)
        if key not in drawn:
            drawn = {key: draw(prepared, drawing)}  # the last one is enough: runs come seed by seed
        found, source = paired_run(prepared, drawn[key], config), prepared.scenario
        files = {LOOKS_FILE: gaps_bytes([(0, vehicle) for vehicle in found.driven], {}, step_s=source.step_s)}
        if trj:
            files["trajectories.trj"] = trj_bytes(found.states.arrays, found.states.matches)
        folder = write_run(place.out, source, config, {name: getattr(found, name) for name in RUN_TABLES}, files)
        return folder, {
            "city": source.city, "recorded": len(source.tracks), "placed": len(found.driven),
            "maneuvers_requested": len(found.requests),
            "maneuvers_done": sum(row["status"] == "done" for row in found.requests),
        }  # fmt: skip

    return _rows(place, runs, measured)


#: The same with trajectories.
measure_runs_for_ssam = partial(measure_runs, trj=True)


def measure_roads(place: SceneFolders, runs: Sequence[Run]) -> Iterator[ManifestRow | Failure]:
    """Drive and count each run on a corridor that was made of a road's file, as in a study where none enters by it."""
    recording = read_recording(place.folder)
    road = read_road(recording.folder / ROAD_FILE)

    def measured(config: Config) -> tuple[Path, dict[str, Any]]:
        traffic = RoadTraffic(recording, road, config)
        traffic.run()
        told = traffic.told()
        folder = write_run(place.out, recording, config, told)
        return folder, {"city": recording.city, "placed": told["ratios"]["changes_per_vehicle"][1]}

    return measure_runs(place, runs) if road.asked else _rows(place, runs, measured)


def _rows(
    place: SceneFolders, runs: Sequence[Run], measured: Callable[[Config], tuple[Path, dict[str, Any]]]
) -> Iterator[ManifestRow | Failure]:
    """The manifest's row of each run. measured: drives one, and returns its folder and what the row has of it."""

    def row(run: Run) -> ManifestRow:
        folder, told = measured(run.config)
        return base_row(place, run, folder)._replace(**told)

    return attempts(row, runs)
