"""Argoverse 2 motion-forecasting scenes: a folder with parquet and map. Those that hid2 writes are in this format."""

from bridge.recordings.folders import Reader, has_scenario

#: `bridge.recordings.scenario` reads them, by their folder.
ARGOVERSE2 = Reader(
    name="argoverse2",
    one="Argoverse 2 scene",
    many="Argoverse 2 scenes",
    sniff=lambda _, names: has_scenario(names),
    find=lambda path, _, choices: [path],
    files=lambda _: [],
)
