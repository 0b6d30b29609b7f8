"""Argoverse 2 motion-forecasting scenes: a folder with parquet and map. Those that hid2 writes are in this format."""

from typing import TYPE_CHECKING

from bridge.recordings.folders import Reader, Source, has_scenario

if TYPE_CHECKING:
    from bridge.recordings.recording import Recording


def _read(source: Source) -> "Recording":
    from bridge.recordings.scenario import read_scenario

    return read_scenario(source.path)


#: `bridge.recordings.scenario` reads them, by their folder.
ARGOVERSE2 = Reader(
    name="argoverse2",
    one="Argoverse 2 scene",
    many="Argoverse 2 scenes",
    sniff=lambda _, names: has_scenario(names),
    find=lambda path, _, choices: [path],
    files=lambda _: [],
    read=_read,
)
