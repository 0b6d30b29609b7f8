"""Argoverse 2 motion-forecasting scenes: a folder with parquet and map. Those that hid2 writes are in this format."""

from pathlib import Path
from typing import TYPE_CHECKING

from bridge.recordings.folders import Address, Choices, Reader, Source, has_scenario

if TYPE_CHECKING:
    from bridge.recordings.recording import Recording


class Argoverse2(Reader):
    """`bridge.recordings.scenario` reads them, by their folder."""

    name = "argoverse2"
    one, many = "Argoverse 2 scene", "Argoverse 2 scenes"
    lacks = ""
    is_folder = True

    def sniff(self, path: Path, names: frozenset[str]) -> bool:
        """By the names of either of its two files."""
        return has_scenario(names)

    def find(self, path: Path, names: frozenset[str], choices: Choices) -> list[Address]:
        """The folder itself."""
        return [path]

    def files(self, source: Source) -> list[Path]:
        """None: its recordings are folders."""
        return []

    def read(self, source: Source) -> "Recording":
        """Errors: ScenarioError, MapError."""
        from bridge.recordings.scenario import read_scenario

        return read_scenario(source.path)
