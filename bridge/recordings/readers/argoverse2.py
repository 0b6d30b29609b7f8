"""Argoverse 2 motion-forecasting scenes: a folder with parquet and map. Those that hid2 writes are in this format."""

from bridge.recordings.folders import MAP_PATTERN, PARQUET_PATTERN, SIDECAR_PATTERN, SIZES_FILE, Reader, has_scenario

_FILES = (PARQUET_PATTERN, MAP_PATTERN, SIDECAR_PATTERN, SIZES_FILE)

#: `bridge.recordings.scenario` reads them, by their folder.
ARGOVERSE2 = Reader(
    name="argoverse2",
    many="Argoverse 2 scenes",
    sniff=lambda _, names: has_scenario(names),
    find=lambda path, _, choices: [path],
    files=lambda folder: [path for pattern in _FILES for path in folder.glob(pattern)],
)
