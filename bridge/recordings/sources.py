"""Recordings of every format: what lies at a path, and reading it."""

import logging
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from bridge.files import one_line
from bridge.recordings.folders import (
    DEPTH,
    SEQUENCES,
    Address,
    Choices,
    Reader,
    Source,
    is_generated,
    names_in,
    other_data,
    subfolders,
)
from bridge.recordings.readers import ARGOVERSE2, READERS
from netconvert.errors import ConfigError, NoSceneError

if TYPE_CHECKING:
    from bridge.recordings.recording import Recording

_LOG = logging.getLogger(__name__)
#: What an output folder has beside generated Argoverse 1 sequences.
_MANIFEST = "manifest.csv"


def find_recordings(paths: Sequence[Path], choices: Choices | None = None) -> list[Address]:
    """Recordings and generated scenes at all paths, each once, in the order of the paths.

    A path is a recording, a folder of them, or up to three folders above, of one format or of several. What is found
    of which format is logged. Errors: NoSceneError where a path holds none.
    """
    return _find(paths, choices or Choices(), lambda address: True)


def find_sources(paths: Sequence[Path], choices: Choices | None = None) -> list[Address]:
    """As `find_recordings`, without the scenes that hid2 wrote: these are passed over, which is logged.

    Errors: NoSceneError where a path holds none.
    """
    return _find(paths, choices or Choices(), lambda address: isinstance(address, Source) or not is_generated(address))


def find_one(path: Path, choices: Choices | None = None) -> Address:
    """The one recording or generated scene at a path. Errors: ConfigError for several; NoSceneError for none."""
    found = list(islice(_walk(path, choices or Choices(), DEPTH), 2))
    if len(found) > 1:
        raise ConfigError(f"{path}: holds several scenes, expected one of them, such as {found[0]}")
    if not found:
        raise nothing_at(path)
    return found[0]


def nothing_at(path: Path) -> NoSceneError:
    """The error that a path is not there or holds no recording: what it is instead, or what is expected."""
    if not path.exists():
        said = "no such folder, expected a scenario folder, a split folder or a data-set root"
    else:
        files = "scenario_<id>.parquet (Argoverse 2), <number>.csv (Argoverse 1) or annotations.feather (sensor log)"
        said = other_data(path, depth=DEPTH) or f"no scenario; expected {files} in it or one to three folders below"
    return NoSceneError(f"{path}: {said}")


def read_recording(address: Address) -> "Recording":
    """Read a recording, or a generated scene; a path is that of one. Errors: ScenarioError, MapError."""
    if isinstance(address, Path):
        from bridge.recordings.scenario import read_scenario

        return read_scenario(address)
    recording: Recording = import_module(f"bridge.recordings.{_reader(address).name}").read(address)
    return recording


def source_files(address: Address) -> list[Path]:
    """The regular files that a generated scene depends on."""
    return [path for path in _reader(address).files(address) if path.is_file()]


def _reader(address: Address) -> Reader:
    name = address.format if isinstance(address, Source) else ARGOVERSE2.name
    return next(reader for reader in READERS if reader.name == name)


def described(found: Sequence[Address]) -> list[str]:
    """What was found that is no Argoverse 2 scene, and what these formats lack: lines for the user."""
    counts = Counter(address.format for address in found if isinstance(address, Source))
    readers = [reader for reader in READERS if reader.name in counts]
    lines = [f"{reader.many}: {counts[reader.name]} found" for reader in readers]
    return lines + [reader.lacks for reader in readers if reader.lacks]


def _find(paths: Sequence[Path], choices: Choices, is_wanted: Callable[[Address], bool]) -> list[Address]:
    found: dict[tuple[Path, str, int], Address] = {}  # by where it really is
    again: list[Address] = []
    for path in paths:
        try:
            there = list(_walk(path, choices, DEPTH))
        except OSError as error:  # a name that the system refuses, or a folder that may not be read
            raise NoSceneError(f"{one_line(str(path), most=200)}: cannot be looked into ({error.strerror})") from error
        if not there:
            raise nothing_at(path)
        wanted_there = [address for address in there if is_wanted(address)]
        if not wanted_there:
            raise NoSceneError(f"{path}: holds generated scenes only (with hid2_<id>.json); give recorded ones")
        if len(wanted_there) < len(there):
            passed_over = len(there) - len(wanted_there)
            _LOG.warning("%s: %d of %d scenes passed over, which hid2 wrote", path, passed_over, len(there))
        for address in wanted_there:
            kind, start = (address.format, address.start) if isinstance(address, Source) else ("", 0)
            if found.setdefault((address.resolve(), kind, start), address) is not address:
                again.append(address)
    if again:
        more = f" (and {len(again) - 1} more)" if len(again) > 1 else ""
        _LOG.warning("%s%s: given more than once, done once", again[0], more)
    return list(found.values())


def _walk(path: Path, choices: Choices, depth: int) -> Iterator[Address]:
    """Recordings at a path and below; folders of a recording are not looked into."""
    names = frozenset(names_in(path)) if path.is_dir() else frozenset()
    for reader in READERS:
        if reader.sniff(path, names):
            yield from reader.find(path, names, choices)
            if reader.is_folder:
                return
    for folder in subfolders(path, names) if depth else []:
        if not (folder.name == SEQUENCES and _MANIFEST in names):  # what hid2 wrote for loaders of Argoverse 1
            yield from _walk(folder, choices, depth - 1)
