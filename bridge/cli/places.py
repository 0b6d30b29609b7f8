"""Whether the paths of a command line can be what they are given as, before anything slow is loaded."""

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

from bridge.cli.options import SplitName
from bridge.console import warn
from netconvert.errors import ConfigError

_SCENE_FILES = ("scenario_*.parquet", "log_map_archive_*.json", "annotations*.feather", "city_SE3_egovehicle.feather")
_SIDECAR = "hid2_*.json"
_ARCHIVES = (".zip", ".tar", ".gz", ".tgz", ".7z", ".zst")
#: Folders of a split or root that are looked at to tell which of them it is: they are all alike.
_LOOKED_AT = 20


def check_scenes(paths: Sequence[Path]) -> None:
    """Errors: ConfigError for a path that is a file and no recording, with what to give instead."""
    for path in paths:
        if path.is_file() and path.suffix != ".csv":
            raise ConfigError(f"{path}: is a file, expected a folder; {_instead_of_file(path)}")


def check_one_scene(path: Path, *, map_file: bool = False) -> None:
    """Errors: ConfigError where a path is not a single scene. map_file: a map alone will do."""
    if map_file and path.is_file() and path.suffix == ".json":
        return
    check_scenes([path])
    if path.is_file():
        return
    if not path.is_dir():
        raise ConfigError(f"{path}: no such folder, expected a scenario folder")
    if not _is_scene(path):
        inside = next(_scenes_below(path), None)
        if inside is not None:
            raise ConfigError(f"{path}: holds several scenes, this command takes one; for example {inside}")
        what = "scenario_<id>.parquet or log_map_archive_<id>.json" if map_file else "scenario_<id>.parquet"
        raise ConfigError(f"{path}: no {what} in it, expected a scenario folder")


def check_out(out: Path) -> None:
    """What is written must not get among the sources. `out`: a folder to write to, or a file.

    Errors: ConfigError where it lies inside a scenario folder or a split folder of recorded scenes, or where a file is
    in the way. Below the root of a data set it is taken with a warning.
    """
    for place in (out, *out.parents):
        if place.is_file():
            what = "is a file" if place == out else f"cannot be made, {place} is a file"
            raise ConfigError(f"{out}: {what}; choose another output folder")
        if place.exists():
            break
    check_among_sources(out)


def check_out_file(file: Path) -> None:
    """`check_out` for a file that is written. Errors: ConfigError."""
    if file.is_dir():
        raise ConfigError(f"{file}: is a folder, expected a file to write")
    check_out(file.parent)


def check_among_sources(out: Path) -> None:
    """The half of `check_out` about scenes. Errors: ConfigError."""
    for place in _real_parents(out):
        if _is_scene(place):
            raise ConfigError(f"{out}: lies inside the scene {place}; choose an output folder outside it")
        if _has_recorded(place):
            raise ConfigError(f"{out}: lies inside the split folder {place}; choose an output folder outside it")
    for place in _real_parents(out):
        if any(_has_recorded(place / split) for split in SplitName):
            warn(f"{out} lies inside the data set {place}; an output folder outside it keeps them apart")
            return


def _real_parents(out: Path) -> Iterator[Path]:
    real = out.resolve()
    return (place for place in (real, *real.parents) if place.is_dir())


def _instead_of_file(path: Path) -> str:
    if path.suffix in _ARCHIVES:
        also = " (a quarantine bundle is run by hid2 generate --repro)" if path.suffix == ".zip" else ""
        return f"unpack it and give the folder{also}"
    return f"give its folder, {path.parent}" if _is_scene(path.parent) else "give the folder of a scene"


def _is_scene(folder: Path) -> bool:
    return any(any(folder.glob(pattern)) for pattern in _SCENE_FILES)


def _has_recorded(folder: Path) -> bool:
    """Whether scenes that hid2 did not write lie directly in a folder."""
    return any(_is_scene(child) and not any(child.glob(_SIDECAR)) for child in islice(_folders(folder), _LOOKED_AT))


def _folders(folder: Path) -> Iterator[Path]:
    try:
        yield from (entry for entry in folder.iterdir() if not entry.name.startswith(".") and entry.is_dir())
    except OSError:  # a folder on the way that may not be read
        return


def _scenes_below(path: Path) -> Iterator[Path]:
    for child in _folders(path):
        if _is_scene(child):
            yield child
        else:
            yield from (folder for folder in islice(_folders(child), _LOOKED_AT) if _is_scene(folder))
