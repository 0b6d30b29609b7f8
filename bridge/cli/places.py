"""The paths of a command line: whether they can be what they are given as, and the scenes below them."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any

from bridge.batch.manifest import is_output
from bridge.cli.options import Which
from bridge.console import Activity, say, warn
from bridge.files import with_name
from bridge.interruption import remove_abandoned
from bridge.recordings import sources
from bridge.recordings.folders import SPLITS, Address, Choices, is_generated
from netconvert.errors import ConfigError

_ARCHIVES = (".zip", ".tar", ".gz", ".tgz", ".7z", ".zst")


def check_scenes(paths: Sequence[Path]) -> None:
    """Errors: ConfigError for a path that is not there, or a file and no recording, with what to give instead."""
    for path in paths:
        if not path.exists():
            raise sources.nothing_at(path)
        if path.is_file() and path.suffix != ".csv":
            said = sources.other_data(path) or f"is a file, expected a folder; {_instead_of_file(path)}"
            raise ConfigError(f"{path}: {said}")


def check_given(
    values: Mapping[str, Any], reads: Iterable[str], folders: Iterable[str], files: Collection[str]
) -> None:
    """Check values of a command by their names: scenes that it reads, what it writes. Errors: ConfigError."""
    given = {name: one if isinstance(one, list) else [one] for name, one in values.items() if one is not None}
    check_scenes([path for name in reads for path in given.get(name, ())])
    for name in (*folders, *files):
        for path in given.get(name, ()):
            check_out(path, is_file=name in files)


def one_scene(path: Path, window: tuple[Path | None, int]) -> Address:
    """The one recording at a path. window: map and first sweep. Errors: ConfigError, with what to give instead."""
    check_scenes([path])
    return sources.fitting([sources.find_one(path, Choices(*window))], Choices(*window))[0]


def recordings(
    scenes: Sequence[Path], choices: Choices, activity: Activity, *, generated: bool = True
) -> list[Address]:
    """The recordings below paths, generated ones or not, with a note of what they are. Errors: ConfigError."""
    found = sources.fitting(sources.find_recordings(scenes, choices, generated=generated), choices)
    activity.note(*sources.described(found))
    return found


def tell_unread(failures: Sequence[tuple[Address, str]]) -> None:
    """Warn of scenes that cannot be read."""
    for folder, reason in failures:
        say(f"warning: {with_name(folder, reason)}")


def select_scenes(folders: list[Address], which: Which, seed: int, activity: Activity, *, jobs: int) -> list[Address]:
    """The scenes that are wanted, all where nothing is asked; unread ones are told. Errors: ConfigError for none."""
    if not any(which):  # nothing need be imported that reads scenes
        return folders
    from bridge.batch.scan import Selection, wanted

    activity.doing("reading scenes for the selection")
    chosen, unread = wanted(folders, Selection(*which, seed), jobs=jobs, on_scene=activity.show)
    tell_unread(unread)
    activity.note(f"{len(chosen)} of {len(folders)} scenes selected")
    return chosen


def check_out(out: Path, *, is_file: bool = False) -> None:
    """A folder, or a file, that is written must not get among the sources; every command that writes asks here.

    Errors: ConfigError inside a scenario folder or a split folder of recorded scenes, or where a file is in the way,
    or a folder in that of a file. Below the root of a data set, or beside a single scene, it is taken with a warning.
    """
    if is_file and out.is_dir():
        raise ConfigError(f"{out}: is a folder, expected a file to write, such as {out / 'NAME'}")
    folder = out.parent if is_file else out
    there = next((place for place in (folder, *folder.parents) if place.exists()), folder)
    if there.is_file():
        what = "is a file" if there == out else f"cannot be made, {there} is a file"
        raise ConfigError(f"{out}: {what}; choose another output folder")
    _check_among_sources(out)
    remove_abandoned(folder)


def _check_among_sources(out: Path) -> None:
    real = out.resolve()
    parents = [one for one in (real, *real.parents) if one.is_dir() and not is_output(one)]
    for place in filter(_is_scene, parents):
        raise ConfigError(f"{out}: lies inside the scene {place}; choose a place outside it")
    beside = {place: list(islice(_recorded(place), 2)) for place in parents}
    for place, scenes in beside.items():
        if len(scenes) == 2 or (scenes and place.name in (*SPLITS, "raw")):  # by name the first tells
            raise ConfigError(
                f"{out}: lies inside the split folder {place}, beside the scene {scenes[0].name}; "
                "choose a place outside it"
            )
    for place, scenes in beside.items():
        if scenes or any(any(_recorded(place / split)) for split in SPLITS):
            warn(f"{out} {'is' if place == real else 'lies inside'} the data set {place}; one outside it is kept apart")
            return


def _instead_of_file(path: Path) -> str:
    if path.suffix in _ARCHIVES:
        also = " (a quarantine bundle is run by hid2 generate --repro)" if path.suffix == ".zip" else ""
        return f"unpack it and give the folder{also}"
    return f"give its folder, {path.parent}" if _is_scene(path.parent) else "give the folder of a scene"


def _is_scene(folder: Path) -> bool:
    names = sources.names_in(folder)
    return any(reader.is_folder and reader.sniff(folder, names) for reader in sources.READERS)


def _recorded(folder: Path) -> Iterator[Path]:
    """Scenes that hid2 did not write and that lie directly in a folder, of the first 20 there: they are all alike."""
    with suppress(OSError):  # a folder on the way that may not be read
        folders = (entry for entry in folder.iterdir() if not entry.name.startswith(".") and entry.is_dir())
        yield from (one for one in islice(folders, 20) if _is_scene(one) and not is_generated(one))
