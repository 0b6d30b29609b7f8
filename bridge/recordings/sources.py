"""Recordings of every format: what lies at a path, and reading it. What reads files is imported when it reads."""

import fnmatch
import logging
import re
import uuid
from collections import Counter
from collections.abc import Iterator, Sequence
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from bridge.files import one_line
from bridge.recordings import folders
from bridge.recordings.folders import DEPTH, MAP_PATTERN, Address, Choices, Reader, Source, log_maps, only_file
from netconvert.errors import ConfigError, NoSceneError

if TYPE_CHECKING:
    from bridge.recordings.recording import Recording

_LOG = logging.getLogger(__name__)
#: What an output folder has beside generated Argoverse 1 sequences.
_MANIFEST = "manifest.csv"
_SCENE_FILES = (folders.PARQUET_PATTERN, MAP_PATTERN, folders.SIDECAR_PATTERN, folders.SIZES_FILE)
_SEQUENCE = re.compile(r"(\d{1,15})\.csv")
#: Split by the name of a folder above a sequence.
_SPLITS = {"train": "train", "val": "val", "test_obs": "test", "test": "test"}
MAP_FILES, _VECTOR_MAPS = "map_files", "pruned_argoverse_*_vector_map.xml"
#: Folders above a sequence that are looked at for its split and its map files: ROOT/val/data/1.csv.
_ABOVE = 4
#: Names of files and folders by which other data is recognised.
_OTHERS = {
    "a nuScenes data set": r"sample_annotation\.json|sample\.json",
    "Waymo data": r".+\.tfrecords?(-\d+-of-\d+)?(\.gz)?",
    "nuPlan data": r".+\.db",
    "a KITTI data set": r"calib_cam_to_cam\.txt|velodyne_points|label_02|oxts|tracklet_labels\.xml",
    "an OpenDRIVE map": r".+\.xodr",
    "a SUMO net or its traffic": r".+\.(net|rou|fcd)\.xml(\.gz)?|.+\.sumocfg",
    "a table, such as of forecasts": r"(?!manifest\.).+\.csv(\.gz)?",
}


def _find_windows(path: Path, _: frozenset[str], choices: Choices) -> list[Address]:
    """The window that was chosen, and with a stride all from there on that fit."""
    starts = [choices.window]
    if choices.stride is not None:
        from bridge.recordings.sensor_log import last_start

        starts = list(range(choices.window, max(last_start(path), choices.window) + 1, choices.stride))
    maps, split = log_maps(path), folders.split_of(path)
    named = folders.LOG_MAP_NAME.fullmatch(maps[0].stem) if len(maps) == 1 else None
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


def _find_sequences(path: Path, names: frozenset[str], choices: Choices) -> list[Address]:
    """By number. Errors: NoSceneError where there are no map files for them."""
    numbers = {name: int(named[1]) for name in names if (named := _SEQUENCE.fullmatch(name))}
    if others := sorted(name for name in names - numbers.keys() if numbers and name.endswith(".csv")):
        _LOG.warning("%s: %d .csv passed over, expected a number as name: %s", path, len(others), others[0])
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


def _above(folder: Path) -> Iterator[Path]:
    real = folder.absolute()
    yield from (real, *real.parents[: _ABOVE - 1])


def _city_maps(folder: Path) -> Path:
    """The folder of map files that is nearest to a folder of sequences. Errors: NoSceneError."""
    for place in _above(folder):
        for maps in (place, place / MAP_FILES):
            if any(maps.glob(_VECTOR_MAPS)):
                return maps
    root = list(_above(folder))[:3][-1]  # fewer near the root of the disk
    raise NoSceneError(
        f"{folder}: this is Argoverse 1: its map files are missing, expected "
        f"pruned_argoverse_<CITY>_<n>_vector_map.xml and the rasters of the drivable area in {root / MAP_FILES}; "
        "or give --map (Python: Choices.map_path), an Argoverse 2 map of the place"
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
    many="windows of Argoverse 2 sensor logs",
    sniff=lambda _, names: folders.POSES in names or bool(fnmatch.filter(names, folders.ANNOTATIONS)),
    find=_find_windows,
    files=lambda log: [*sorted(log.path.glob(folders.ANNOTATIONS))[:1], log.path / folders.POSES, *log_maps(log.path)],
    lacks="Sensor logs have no focal and scored tracks and no centrelines of lanes: the longest path of a vehicle that "
    "is seen throughout is focal, centrelines run midway between the boundaries; people labelled the boxes, and "
    "export.noise adds nothing",
    takes=("window", "stride"),
)
#: Folders with parquet and map, which `bridge.recordings.scenario` reads. Those that hid2 writes are in this format.
ARGOVERSE2 = Reader(
    name="argoverse2",
    many="Argoverse 2 scenes",
    sniff=lambda _, names: any(fnmatch.filter(names, pattern) for pattern in (folders.PARQUET_PATTERN, MAP_PATTERN)),
    find=lambda path, _, choices: [path],
    files=lambda folder: [path for pattern in _SCENE_FILES for path in folder.glob(pattern)],
)
#: CSV files named by a number. Their maps are files of the whole city, or one chosen by the user.
ARGOVERSE1 = Reader(
    name="argoverse1",
    many="Argoverse 1 sequences",
    sniff=lambda path, names: any(map(_SEQUENCE.fullmatch, [path.name] if path.is_file() else names)),
    find=_find_sequences,
    files=_sequence_files,
    lacks="Argoverse 1 tells no types, sizes and headings: every track is taken for a vehicle of 4.5 x 1.9 m, headings "
    "and velocities come from smoothed positions, a standing vehicle keeps its heading or has that of the lane; its "
    "own maps, where --map gives no other, tell no lane boundaries: lanes are 3.8 m wide",
    is_folder=False,
    takes=("map_path",),
)
#: The formats; the first one that recognises a path has it.
READERS: tuple[Reader, ...] = (SENSOR_LOG, ARGOVERSE2, ARGOVERSE1)


def find_scenarios(path: Path | str, depth: int = DEPTH) -> list[Path]:
    """Scenario folders at a path: itself, or those up to `depth` folders below, sorted. Errors: NoSceneError."""
    found = [one for one in _walk(Path(path), Choices(), depth, (ARGOVERSE2,)) if isinstance(one, Path)]
    if not found:
        what = "no scenario" if Path(path).is_dir() else "no such folder"
        raise NoSceneError(f"{path}: {what}; expected scenario_<id>.parquet in it or one to three folders below")
    return sorted(found)


def find_recordings(paths: Sequence[Path], choices: Choices | None = None, *, generated: bool = True) -> list[Address]:
    """Recordings and generated scenes at all paths, each once, in the order of the paths.

    A path is a recording, a folder of them, or up to three folders above, of one format or of several. generated:
    False passes over the scenes that hid2 wrote, which is logged. Errors: NoSceneError where a path holds none.
    """
    found: dict[tuple[Path, str, int], Address] = {}  # by where it really is
    again: list[Address] = []
    for path in paths:
        try:
            there = list(_walk(path, choices or Choices(), DEPTH, READERS))
        except OSError as error:  # a name that the system refuses, or a folder that may not be read
            raise NoSceneError(f"{one_line(str(path), most=200)}: cannot be looked into ({error.strerror})") from error
        if not there:
            raise nothing_at(path)
        wanted_there = [one for one in there if generated or isinstance(one, Source) or not folders.is_generated(one)]
        if not wanted_there:
            raise NoSceneError(f"{path}: holds generated scenes only (with hid2_<id>.json); give recorded ones")
        if passed_over := len(there) - len(wanted_there):
            _LOG.warning("%s: %d of %d scenes passed over, which hid2 wrote", path, passed_over, len(there))
        for address in wanted_there:
            kind, start = (address.format, address.start) if isinstance(address, Source) else ("", 0)
            if found.setdefault((address.resolve(), kind, start), address) is not address:
                again.append(address)
    if again:
        more = f" (and {len(again) - 1} more)" if len(again) > 1 else ""
        _LOG.warning("%s%s: given more than once, done once", again[0], more)
    return list(found.values())


def find_sources(paths: Sequence[Path], choices: Choices | None = None) -> list[Address]:
    """As `find_recordings`, without the scenes that hid2 wrote. Errors: NoSceneError where a path holds none."""
    return find_recordings(paths, choices, generated=False)


def find_one(path: Path, choices: Choices | None = None) -> Address:
    """The one recording or generated scene at a path. Errors: ConfigError for several; NoSceneError for none."""
    found = list(islice(_walk(path, choices or Choices(), DEPTH, READERS), 2))
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
        said = other_data(path, depth=DEPTH)
        said = said or f"no scenario; expected {files} in it or one to three folders below"
    return NoSceneError(f"{path}: {said}")


def other_data(path: Path, *, depth: int = 0) -> str:
    """What a file, or a folder with so many levels below, is of what hid2 does not read; "" where no name tells."""
    files = [path, *(file for level in range(depth + 1) for file in sorted(path.glob("*/" * level + "*")))]
    for what, pattern in _OTHERS.items():
        found = next((file for file in files if re.fullmatch(pattern, file.name)), None)
        if found is not None:
            where = "" if found == path else f" (it has {found.relative_to(path).as_posix()[:100]!r})"
            reads = f"{' or '.join(one.many for one in READERS)} (columns: bridge/recordings/README.md)"
            return f"this is {what}{where}, which hid2 does not read; expected {reads}: convert it to one of them"
    return ""


def read_recording(address: Address | str) -> "Recording":
    """Read a recording, or a generated scene; a path is that of one.

    Errors: ScenarioError, MapError; ConfigError for what is neither a path nor a `Source`.
    """
    if isinstance(address, str | Path):
        from bridge.recordings.scenario import read_scenario

        return read_scenario(Path(address))
    if not isinstance(address, Source):
        raise ConfigError(f"{address!r:.200}: expected the path of a scene")
    recording: Recording = import_module(f"bridge.recordings.{_reader(address).name}").read(address)
    return recording


def source_files(address: Address) -> list[Path]:
    """The regular files that a generated scene depends on."""
    return [path for path in _reader(address).files(address) if path.is_file()]


def _reader(address: Address) -> Reader:
    return next(one for one in READERS if one.name == (address.format if isinstance(address, Source) else "argoverse2"))


def fitting(found: list[Address], choices: Choices | None) -> list[Address]:
    """What was found. Errors: ConfigError for a choice of a user's that none of these formats looks at."""
    taken = {name for address in found for name in _reader(address).takes}
    for name in dict.fromkeys(name for one in READERS for name in one.takes if name not in taken):
        if (value := getattr(choices or Choices(), name)) != getattr(Choices(), name):
            option, many = name.removesuffix("_path"), " or ".join(one.many for one in READERS if name in one.takes)
            raise ConfigError(f"--{option} {value} does nothing here, expected {many} among the scenes")
    return found


def described(found: Sequence[Address]) -> list[str]:
    """What was found that is no Argoverse 2 scene, and what these formats lack: lines for the user."""
    counts = Counter(address.format for address in found if isinstance(address, Source))
    readers = [reader for reader in READERS if reader.name in counts]
    lines = [f"{reader.many[0].upper()}{reader.many[1:]}: {counts[reader.name]} found" for reader in readers]
    return lines + [reader.lacks for reader in readers if reader.lacks]


def names_in(folder: Path) -> frozenset[str]:
    """Names in a folder; none in a file. One that may not be read, as at the root of a disk, is logged: no scenes."""
    if not folder.is_dir():
        return frozenset()
    try:
        return frozenset(entry.name for entry in folder.iterdir())
    except OSError as error:
        _LOG.warning("%s: cannot be read (%s)", folder, error.strerror or error)
        return frozenset()


def _walk(path: Path, choices: Choices, depth: int, readers: tuple[Reader, ...]) -> Iterator[Address]:
    """Recordings at a path and below; neither folders of a recording nor hidden ones are looked into."""
    names = names_in(path)
    for reader in readers:
        if reader.sniff(path, names):
            yield from reader.find(path, names, choices)
            if reader.is_folder:
                return
    for folder in (path / name for name in sorted(names) if depth and not name.startswith(".")):
        of_hid2 = folder.name == folders.SEQUENCES and _MANIFEST in names  # what it wrote for loaders of Argoverse 1
        if folder.is_dir() and not of_hid2:
            yield from _walk(folder, choices, depth - 1, readers)
