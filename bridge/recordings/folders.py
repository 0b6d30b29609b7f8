"""Where scenes are: folders of scenarios, their splits and ids, by the names of files alone. Quick to import."""

import fnmatch
import logging
from collections.abc import Sequence
from pathlib import Path

from netconvert.errors import NoSceneError

_LOG = logging.getLogger(__name__)
#: Names of the two files of a scenario folder.
PARQUET_PATTERN, MAP_PATTERN = "scenario_*.parquet", "log_map_archive_*.json"
#: Name of the file that hid2 writes beside them.
SIDECAR_PATTERN = "hid2_*.json"

#: Names of the folders of a data-set root.
SPLITS = ("train", "val", "test")
#: Folder between a split and its scenes, as QCNet lays data sets out.
RAW = "raw"


def find_scenarios(path: Path) -> list[Path]:
    """Scenario folders at path, sorted: a scenario folder itself, those of a split folder, or of a data-set root.

    The scenes of a split may lie in <split>/raw/. Errors: NoSceneError where there is none.
    """
    if not path.is_dir():
        raise NoSceneError(f"{path}: no such folder, expected a scenario folder, a split folder or a data-set root")
    if _is_scenario_folder(path):
        return [path]
    children = _subfolders(path)
    found = [child for child in children if _is_scenario_folder(child)]
    for split in (child for child in children if not _is_scenario_folder(child)):
        below = _subfolders(split)
        if RAW in (folder.name for folder in below):
            below = [folder for folder in below if folder.name != RAW] + _subfolders(split / RAW)
        found += [folder for folder in below if _is_scenario_folder(folder)]
    if not found:
        raise NoSceneError(f"{path}: no scenario; expected scenario_<id>.parquet in it or one or two folders below")
    return sorted(found)


def find_sources(paths: Sequence[Path]) -> list[Path]:
    """Folders of recorded scenes at all paths, each once. Those that hid2 wrote are passed over, which is logged.

    Errors: NoSceneError where a path holds none.
    """
    found: dict[Path, Path] = {}  # by where it really is
    for path in paths:
        folders = find_scenarios(path)
        recorded = [folder for folder in folders if not is_generated(folder)]
        if not recorded:
            raise NoSceneError(f"{path}: holds generated scenes only (with hid2_<id>.json); give recorded ones")
        if len(recorded) < len(folders):
            passed_over = len(folders) - len(recorded)
            _LOG.warning("%s: %d of %d scenes passed over, which hid2 wrote", path, passed_over, len(folders))
        for folder in recorded:
            found.setdefault(folder.resolve(), folder)
    return list(found.values())


def source_id(folder: Path) -> str:
    """Scenario id by the names of a folder's files; the folder's own name where none tells it."""
    ids = [path.stem.removeprefix("scenario_") for path in folder.glob(PARQUET_PATTERN)]
    return ids[0] if len(ids) == 1 else folder.name


def split_of(folder: Path) -> str | None:
    """Split that a scene is in: the name of the folder above, as it is named here or, behind links, as it really is.

    Above <split>/raw/ it is that of the split.
    """
    parents = folder.absolute().parent, folder.resolve().parent
    names = (parent.parent.name if parent.name == RAW else parent.name for parent in parents)
    return next((name for name in names if name in SPLITS), None)


def _names(folder: Path) -> list[str]:
    """Names in a folder. One that may not be read, as at the root of a disk, is logged: it holds no scenes."""
    try:
        return [entry.name for entry in folder.iterdir()]
    except OSError as error:
        _LOG.warning("%s: cannot be read (%s)", folder, error.strerror or error)
        return []


def _is_scenario_folder(folder: Path) -> bool:
    names = _names(folder)
    return any(fnmatch.filter(names, pattern) for pattern in (PARQUET_PATTERN, MAP_PATTERN))


def is_generated(folder: Path) -> bool:
    """Whether hid2 wrote a scene: it has a sidecar."""
    return any(folder.glob(SIDECAR_PATTERN))


def _subfolders(path: Path) -> list[Path]:
    return sorted(path / name for name in _names(path) if not name.startswith(".") and (path / name).is_dir())
