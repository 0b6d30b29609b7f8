"""Argoverse 1 forecasting sequences: where sequences and maps are; `bridge.recordings.argoverse1` reads them."""

import re
from collections.abc import Iterator
from pathlib import Path

from bridge.recordings.folders import MAP_PATTERN, Address, Choices, Reader, Source, only_file
from netconvert.errors import NoSceneError

_SEQUENCE = re.compile(r"(\d{1,15})\.csv")
#: Split by the name of a folder above a sequence.
_SPLITS = {"train": "train", "val": "val", "test_obs": "test", "test": "test"}
MAP_FILES = "map_files"
_VECTOR_MAPS = "pruned_argoverse_*_vector_map.xml"
#: Folders above a sequence that are looked at for its split and its map files: ROOT/val/data/1.csv.
_ABOVE = 4


def _find(path: Path, names: frozenset[str], choices: Choices) -> list[Address]:
    """By number. Errors: NoSceneError where there are no map files for them."""
    numbers = {name: int(named[1]) for name in names if (named := _SEQUENCE.fullmatch(name))}
    folder = path if numbers else path.parent
    split = next((_SPLITS[place.name] for place in _above(folder) if place.name in _SPLITS), None)
    map_path = _chosen_map(choices.map_path) if choices.map_path is not None else _city_maps(folder)
    places = [folder / name for name in sorted(numbers, key=lambda name: (numbers[name], name)) or [path.name]]
    name = ARGOVERSE1.name
    return [Source(place, name, _scenario_id(place, split, map_path), split, 0, map_path) for place in places]


def _files(source: Source) -> list[Path]:
    """Sequence and map; all maps of a folder, as the sequence tells its city."""
    maps = source.map_path
    assert maps is not None
    return [source.path, *([maps] if maps.is_file() else sorted(maps.iterdir()))]


def _is_sequence(path: Path) -> bool:
    return _SEQUENCE.fullmatch(path.name) is not None and path.is_file()


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


def _scenario_id(path: Path, split: str | None, map_path: Path) -> str:
    """Numbers come again in every split; on another map a sequence is another scene."""
    parts = ["argoverse1", *([split] if split else []), path.stem]
    if map_path.is_file():
        parts += ["on", map_path.stem.removeprefix(MAP_PATTERN.split("*")[0])]
    return "-".join(parts)


#: CSV files named by a number. Their maps are files of the whole city, or one chosen by the user.
ARGOVERSE1 = Reader(
    name="argoverse1",
    many="Argoverse 1 sequences",
    sniff=lambda path, names: _is_sequence(path) or any(_SEQUENCE.fullmatch(name) for name in names),
    find=_find,
    files=_files,
    lacks="Argoverse 1 tells no types, sizes and headings: every track is taken for a vehicle of 4.5 x 1.9 m, headings "
    "and velocities come from smoothed positions, a standing vehicle keeps its heading or has that of the lane; its "
    "maps tell no lane boundaries: lanes are 3.8 m wide",
    is_folder=False,
)
