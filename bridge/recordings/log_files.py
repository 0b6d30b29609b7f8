"""Names of the files of an Argoverse 2 sensor log: quick to import, for what finds logs and what reads them."""

import re
from pathlib import Path

from bridge.recordings.folders import MAP_PATTERN

ANNOTATIONS, POSES = "annotations*.feather", "city_SE3_egovehicle.feather"
#: Log, city and number in the name of a log's map.
MAP_NAME = re.compile(r"log_map_archive_(.+)____([A-Z]{3})_city_(\d{1,18})")


def maps_of(log: Path) -> list[Path]:
    """Map files of a log, in its folder map or in its own."""
    return sorted(log.glob(f"map/{MAP_PATTERN}")) or sorted(log.glob(MAP_PATTERN))
