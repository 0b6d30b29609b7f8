"""One `Reader` for each format: where its recordings are. What reads their files is imported when it reads."""

import fnmatch
import re
import uuid
from collections.abc import Iterator
from pathlib import Path

from bridge.recordings.folders import (
    ANNOTATIONS,
    LOG_MAP_NAME,
    MAP_PATTERN,
    PARQUET_PATTERN,
    POSES,
    SIDECAR_PATTERN,
    SIZES_FILE,
    Address,
    Choices,
    Reader,
    Source,
    has_scenario,
    log_maps,
    only_file,
    split_of,
)
from netconvert.errors import NoSceneError

_SCENE_FILES = (PARQUET_PATTERN, MAP_PATTERN, SIDECAR_PATTERN, SIZES_FILE)
_SEQUENCE = re.compile(r"(\d{1,15})\.csv")
#: Split by the name of a folder above a sequence.
_SPLITS = {"train": "train", "val": "val", "test_obs": "test", "test": "test"}
MAP_FILES, _VECTOR_MAPS = "map_files", "pruned_argoverse_*_vector_map.xml"
#: Folders above a sequence that are looked at for its split and its map files: ROOT/val/data/1.csv.
_ABOVE = 4


def _find_windows(path: Path, _: frozenset[str], choices: Choices) -> list[Address]:
    """The window that was chosen, and with a stride all from there on that fit."""
    starts = [choices.window]
    if choices.stride is not None:
        from bridge.recordings.sensor_log import last_start

        starts = list(range(choices.window, max(last_start(path), choices.window) + 1, choices.stride))
    maps, split = log_maps(path), split_of(path)
    named = LOG_MAP_NAME.fullmatch(maps[0].stem) if len(maps) == 1 else None
    log_id = path.absolute().name if named is None else named[1]
    return [Source(path, SENSOR_LOG.name, window_id(log_id, start), split, start) for start in starts]


def window_id(log_id: str, start: int) -> str:
    """Scenario id of the window of a log that begins at a sweep: the log's own id for the first."""
    if start == 0:
        return log_id
    try:
        space = uuid.UUID(log_id)
    except ValueError:
        space = uuid.uuid5(uuid.NAMESPACE_DNS, log_id)
    return str(uuid.uuid5(space, str(start)))


def _log_files(source: Source) -> list[Path]:
    return [*sorted(source.path.glob(ANNOTATIONS))[:1], source.path / POSES, *log_maps(source.path)]


def _find_sequences(path: Path, names: frozenset[str], choices: Choices) -> list[Address]:
    """By number. Errors: NoSceneError where there are no map files for them."""
    numbers = {name: int(named[1]) for name in names if (named := _SEQUENCE.fullmatch(name))}
    folder = path if numbers else path.parent
    split = next((_SPLITS[place.name] for place in _above(folder) if place.name in _SPLITS), None)
    maps = _city_maps(folder) if choices.map_path is None else _chosen_map(choices.map_path)
    found: list[Address] = []
    for name in sorted(numbers, key=lambda name: (numbers[name], name)) or [path.name]:
        # Numbers come again in every split; on another map a sequence is another scene.
        parts = ["argoverse1", *([split] if split else []), Path(name).stem]
        parts += ["on", maps.stem.removeprefix(MAP_PATTERN.split("*")[0])] if maps.is_file() else []
        found.append(Source(folder / name, ARGOVERSE1.name, "-".join(parts), split, 0, maps))
    return found


def _sequence_files(source: Source) -> list[Path]:
    """Sequence and map; all maps of a folder, as the sequence tells its city."""
    maps = source.map_path
    assert maps is not None
    return [source.path, *([maps] if maps.is_file() else sorted(maps.iterdir()))]


def _holds_sequences(path: Path, names: frozenset[str]) -> bool:
    return any(map(_SEQUENCE.fullmatch, [path.name] if path.is_file() else names))


def _above(folder: Path) -> Iterator[Path]:
    real = folder.absolute()
    yield from (real, *real.parents[: _ABOVE - 1])


def _city_maps(folder: Path) -> Path:
    """The folder of map files that is nearest to a folder of sequences. Errors: NoSceneError."""
    for place in _above(folder):
        for maps in (place, place / MAP_FILES):
            if any(maps.glob(_VECTOR_MAPS)):
                return maps
    root = list(_above(folder))[min(2, _ABOVE - 1)]
    raise NoSceneError(
        f"{folder}: this is Argoverse 1: its map files are missing, expected "
        f"pruned_argoverse_<CITY>_<n>_vector_map.xml and the rasters of the drivable area in {root / MAP_FILES}; "
        "or give --map, an Argoverse 2 map of the place"
    )


def _chosen_map(path: Path) -> Path:
    """The Argoverse 2 map that a user chose, by itself or by its folder, or a folder of cities' maps.

    Errors: NoSceneError.
    """
    if not path.exists():
        raise NoSceneError(f"--map {path}: no such file or folder, expected one Argoverse 2 map, or the folder of one")
    whole = (path.is_file() and path.suffix == ".json") or any(path.glob(_VECTOR_MAPS))
    return path if whole else only_file(path, MAP_PATTERN, NoSceneError)


#: Windows of logs. An id is the log's for the first window, of log and first sweep for any other.
SENSOR_LOG = Reader(
    name="sensor_log",
    many="Windows of Argoverse 2 sensor logs",
    sniff=lambda _, names: POSES in names or bool(fnmatch.filter(names, ANNOTATIONS)),
    find=_find_windows,
    files=_log_files,
    lacks="Sensor logs have no focal and scored tracks and no centrelines of lanes: the longest path of a vehicle that "
    "is seen throughout is focal, centrelines run midway between the boundaries",
)
#: Folders with parquet and map, which `bridge.recordings.scenario` reads. Those that hid2 writes are in this format.
ARGOVERSE2 = Reader(
    name="argoverse2",
    many="Argoverse 2 scenes",
    sniff=lambda _, names: has_scenario(names),
    find=lambda path, _, choices: [path],
    files=lambda folder: [path for pattern in _SCENE_FILES for path in folder.glob(pattern)],
)
#: CSV files named by a number. Their maps are files of the whole city, or one chosen by the user.
ARGOVERSE1 = Reader(
    name="argoverse1",
    many="Argoverse 1 sequences",
    sniff=_holds_sequences,
    find=_find_sequences,
    files=_sequence_files,
    lacks="Argoverse 1 tells no types, sizes and headings: every track is taken for a vehicle of 4.5 x 1.9 m, headings "
    "and velocities come from smoothed positions, a standing vehicle keeps its heading or has that of the lane; its "
    "maps tell no lane boundaries: lanes are 3.8 m wide",
    is_folder=False,
)
#: The formats; the first one that recognises a path has it.
READERS: tuple[Reader, ...] = (SENSOR_LOG, ARGOVERSE2, ARGOVERSE1)
