"""Compiled functions are kept for the next start; kept ones must not outlive the sources that they were made from."""

import atexit
import contextlib
import hashlib
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

#: Whose functions call each other.
PACKAGES = tuple(Path(__file__).parents[2] / name for name in ("bridge", "hid2", "netconvert"))
#: numba keeps what it compiles here, where it is set; beside the sources else.
_VARIABLE = "NUMBA_CACHE_DIR"


def keep_compiled(packages: Iterable[Path] = PACKAGES) -> Path | None:
    """Give numba a place to keep what it compiles, without anything from older sources; None for beside the sources.

    numba looks at the file of a function, not at those of the functions that it calls: after an update of the sources
    it would go on with the old ones of those. And where no place can be written it does not work at all. Other places
    than beside the sources get a folder for the very sources: below NUMBA_CACHE_DIR, or, where the sources cannot be
    written, in the user's cache; if need be a temporary one, for this process and those that it starts.
    """
    sources, given = sources_of(packages), os.environ.get(_VARIABLE)
    chosen = Path(given) if given and _can_write(Path(given)) else None
    if chosen is None and all(_can_write(folder) for folder in _beside(sources)):
        forget_outdated(sources)
        return None
    digest = _digest(sources)
    if chosen is not None and chosen.name == digest:  # by who started this process
        return chosen
    place = next((base / digest for base in _bases(chosen) if _can_write(base / digest)), None)
    if place is None:
        temporary = tempfile.mkdtemp(prefix="hid2-compiled-")
        atexit.register(_remove, temporary, os.getpid())
        place = Path(temporary) / digest
    os.environ[_VARIABLE] = str(place)
    if "numba" in sys.modules:  # which has read the variable
        sys.modules["numba"].config.CACHE_DIR = str(place)
    return place


def sources_of(packages: Iterable[Path]) -> list[Path]:
    """Every source of the packages, sorted."""
    return sorted(file for package in packages for file in package.rglob("*.py"))


def forget_outdated(sources: Sequence[Path]) -> list[Path]:
    """Delete what numba keeps beside sources of functions compiled before the newest of these; returns the files."""
    newest = max((source.stat().st_mtime for source in sources), default=0.0)
    if newest > time.time():  # no clock to go by: everything would be compiled anew at every start
        return []
    outdated = []
    for index in (index for folder in _beside(sources) for index in folder.glob("*.nbi")):
        with contextlib.suppress(OSError):  # another process was faster
            if index.stat().st_mtime < newest:
                index.unlink()
                outdated.append(index)
    return outdated


def _digest(sources: Iterable[Path]) -> str:
    """Tells these sources, where they are, from others and from what they were before."""
    found = hashlib.sha256()
    for source in sources:
        known = source.stat()
        found.update(f"{source}\0{known.st_mtime_ns}\0{known.st_size}\0".encode())
    return f"hid2-{found.hexdigest()[:16]}"


def _beside(sources: Iterable[Path]) -> set[Path]:
    return {source.parent / "__pycache__" for source in sources}


def _bases(chosen: Path | None) -> Iterator[Path]:
    if chosen is not None:
        yield chosen.parent if chosen.name.startswith("hid2-") else chosen  # set so by another version
    with contextlib.suppress(RuntimeError):  # no home
        yield Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()) / "hid2-sumo"


def _can_write(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _remove(folder: str, owner: int) -> None:
    if os.getpid() == owner:  # not a process that was forked off
        shutil.rmtree(folder, ignore_errors=True)
