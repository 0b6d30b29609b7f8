"""What a process of a page of public roads does: drive a road with each configuration, and keep what was counted."""

from collections.abc import Iterator, Sequence

from bridge.batch.batch import Place, Run, base_row
from bridge.batch.isolation import Failure, describe_error
from bridge.batch.manifest import ManifestRow, files_sha256, output_files
from bridge.recordings.road import ROAD_FILE, read_road
from bridge.recordings.sources import read_recording
from bridge.studies.road_traffic import RoadTraffic
from bridge.studies.study import write_run


def measure_roads(place: Place, runs: Sequence[Run]) -> Iterator[ManifestRow | Failure]:
    """Drive and count each run on a corridor that was made of a road's file."""
    for run in runs:
        try:
            recording = read_recording(place.folder)
            traffic = RoadTraffic(recording, read_road(recording.folder / ROAD_FILE), run.config)
            traffic.run()
            told = traffic.told()
            folder = write_run(place.out, recording, run.config, told)
            yield base_row(place, run)._replace(
                city=recording.city,
                placed=sum(told["vehicles"]),
                folder=folder.relative_to(place.out).as_posix(),
                output_sha256=files_sha256(output_files(folder)),
            )
        except Exception as error:  # noqa: BLE001  # quarantined with its traceback
            yield describe_error(error)
