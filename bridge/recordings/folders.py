"""Where recordings are and what they are called, by the names of files alone. Quick to import."""

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

from netconvert.errors import MapError, ScenarioError

#: Names of the two files of a scenario folder.
PARQUET_PATTERN, MAP_PATTERN = "scenario_*.parquet", "log_map_archive_*.json"
#: Name of the file that hid2 writes beside them.
SIDECAR_PATTERN = "hid2_*.json"
#: How names of files that hid2 writes of a scene, or of a run of a study, begin.
WRITTEN = ("scenario_", "log_map_archive_", "hid2_", "gaps_", "run.", "looks.", "trajectories.")
#: Sizes beside a scene with boxes that people have labelled.
SIZES_FILE = "agent_sizes.csv"
#: Files of a sensor log; log, city and number in the name of its map.
ANNOTATIONS, POSES = "annotations*.feather", "city_SE3_egovehicle.feather"
LOG_MAP_NAME = re.compile(r"log_map_archive_(.+)____([A-Z]{3})_city_(\d{1,18})")

#: Names of the folders of a data-set root.
SPLITS = ("train", "val", "test")
#: Folders below a path that are looked into: DATA/av2/train/<id>.
DEPTH = 3
#: Folder between a split and its scenes, as QCNet lays data sets out.
RAW = "raw"
#: Folder of generated Argoverse 1 sequences below an output folder.
SEQUENCES = "argoverse1"


@dataclass(frozen=True, slots=True, order=True)
class Source:
    """A recording in another format than Argoverse 2's scenes, with what was chosen for it.

    path: its file or folder; format: the name of its reader; start: the first step of the source that is in it;
    map_path: the map that goes with it, where the format keeps maps elsewhere.
    """

    path: Path
    format: str
    scenario_id: str
    split: str | None = None
    start: int = 0
    map_path: Path | None = None

    @property
    def name(self) -> str:
        """What the recording is called in tables and messages."""
        return self.scenario_id

    def absolute(self) -> "Source":
        """The same with paths that do not depend on the working directory."""
        return replace(self, path=self.path.absolute(), map_path=self.map_path and self.map_path.absolute())

    def resolve(self) -> Path:
        """Where it really is."""
        return self.path.resolve()

    def __str__(self) -> str:
        """The path, with the first step where that is not the source's first."""
        return f"{self.path}" + (f" from step {self.start}" if self.start else "")


#: A recording: the folder of a scene in Argoverse 2's format, or a Source.
Address: TypeAlias = Path | Source


@dataclass(frozen=True, slots=True)
class Choices:
    """What a user may choose where a format leaves it open.

    map_path: a map in Argoverse 2's format instead of the recording's own; window: first step of a long recording that
    is taken; stride: steps from one window to the next, None for one window.
    """

    map_path: Path | None = None
    window: int = 0
    stride: int | None = None


@dataclass(frozen=True, slots=True)
class Reader:
    """A format of recordings.

    name: as in sidecars and in Source.format, and of the module in `bridge.recordings` that can `read` a Source
    (ScenarioError, MapError with file, id, value and what was expected); many: what recordings are called; sniff:
    whether a file, or a folder with these names in it, holds recordings; find: the recordings there, sorted
    (NoSceneError where something that all of them need is missing); files: those that a recording is read from, also
    where they are not there; lacks: what the format does not tell and how it is made up for, a sentence; is_folder:
    whether a recording is a folder, which then holds nothing else; takes: the fields of `Choices` that it looks at.
    """

    name: str
    many: str
    sniff: Callable[[Path, frozenset[str]], bool]
    find: Callable[[Path, frozenset[str], Choices], list[Address]]
    files: Callable[[Any], list[Path]]
    lacks: str = ""
    is_folder: bool = True
    takes: tuple[str, ...] = ()


def source_id(folder: Address) -> str:
    """Scenario id by the names of a folder's files; the folder's own name where none tells it."""
    if isinstance(folder, Source):
        return folder.scenario_id
    ids = [path.stem.removeprefix("scenario_") for path in folder.glob(PARQUET_PATTERN)]
    return ids[0] if len(ids) == 1 else folder.name


def split_of(folder: Address) -> str | None:
    """Split that a scene is in: the name of the folder above, as it is named here or, behind links, as it really is.

    Above <split>/raw/ it is that of the split.
    """
    if isinstance(folder, Source):
        return folder.split
    parents = folder.absolute().parent, folder.resolve().parent
    names = (parent.parent.name if parent.name == RAW else parent.name for parent in parents)
    return next((name for name in names if name in SPLITS), None)


def sequence_path(out_dir: Path, split: str | None, new_id: str) -> Path:
    """Where the Argoverse 1 sequence of a generated scene lies below an output folder."""
    root = out_dir / SEQUENCES
    folder = root / ("test_obs" if split == "test" else split) if split else root
    return folder / "data" / f"{int(new_id.replace('-', '')[:12], 16)}.csv"


def log_maps(log: Path) -> list[Path]:
    """Map files of a sensor log, in its folder map or in its own."""
    return sorted(log.glob(f"map/{MAP_PATTERN}")) or sorted(log.glob(MAP_PATTERN))


def only_file(folder: Path, pattern: str, error: type[ScenarioError | MapError]) -> Path:
    """The one file of a pattern in a folder. Errors: of that type, where there is none or more than one."""
    found = sorted(folder.glob(pattern))
    if len(found) != 1:
        have = f"{len(found)} files" if found else "no"
        raise error(f"{have} {pattern.replace('*', '<id>')} in {folder}; expected exactly one: add or remove files")
    return found[0]


def is_generated(folder: Path) -> bool:
    """Whether hid2 wrote a scene: it has a sidecar."""
    return any(folder.glob(SIDECAR_PATTERN))
