"""What a process of a study does: drive each run and write what was measured."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from bridge.batch.batch import Place, Run, base_row
from bridge.batch.isolation import Failure, describe_error
from bridge.batch.manifest import ManifestRow, files_sha256, output_files
from bridge.config import config_sha256
from bridge.generation.gaps import gaps_bytes
from bridge.generation.generate import PreparedScene, prepare
from bridge.recordings.recording import Recording
from bridge.recordings.sources import read_recording
from bridge.recordings.ssam import trj_bytes
from bridge.studies.paired import Drawn, PairedRun, draw, drawing_config, paired_run
from bridge.studies.study import LOOKS_FILE, RUN_TABLES, write_run
from hid2.params import Config


def measure_runs_for_ssam(place: Place, runs: Sequence[Run]) -> Iterator[ManifestRow | Failure]:
    """The same with the trajectories of each run for SSAM beside what was measured."""
    return measure_runs(place, runs, trj=True)


def measure_runs(place: Place, runs: Sequence[Run], *, trj: bool = False) -> Iterator[ManifestRow | Failure]:
    """Drive and measure each run; what the runs share is made once."""
    prepared: PreparedScene | None = None
    drawn: dict[str, Drawn] = {}
    for run in runs:
        try:
            if prepared is None:
                prepared = prepare(read_recording(place.folder), run.config)
            drawing = drawing_config(run.config)
            key = config_sha256(drawing)
            if key not in drawn:
                drawn = {key: draw(prepared, drawing)}  # the last one is enough: runs come seed by seed
            found = paired_run(prepared, drawn[key], run.config)
            folder = _write(place.out, prepared.scenario, run.config, found, trj=trj)
            requests = [row for row in found.requests if row["status"] != "not_placed"]
            yield base_row(place, run)._replace(
                city=prepared.scenario.city,
                recorded=len(prepared.scenario.tracks),
                placed=len(found.driven),
                maneuvers_requested=len(found.requests),
                maneuvers_done=sum(row["status"] == "done" for row in requests),
                folder=folder.relative_to(place.out).as_posix(),
                output_sha256=files_sha256(output_files(folder)),
            )
        except Exception as error:  # noqa: BLE001  # quarantined with its traceback
            yield describe_error(error)


def _write(out_dir: Path, source: Recording, config: Config, found: PairedRun, *, trj: bool) -> Path:
    told = {name: getattr(found, name) for name in RUN_TABLES}
    files = {LOOKS_FILE: gaps_bytes([(0, vehicle) for vehicle in found.driven], {}, step_s=source.step_s)}
    if trj:
        files["trajectories.trj"] = trj_bytes(found.states.arrays, found.states.matches)
    return write_run(out_dir, source, config, told, files)
