"""The decorators of compiled functions: typed, and kept on disk for the next process.

numba keeps a function until its own file changes, and does not look at those of the functions that it calls. So what
is compiled of one state of this room has a folder of its own.
"""

import contextlib
import hashlib
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import config, njit

F = TypeVar("F", bound=Callable[..., Any])

#: Every kernel, with the signatures that set-up compiles it for.
KERNELS: list[tuple[Any, tuple[str, ...]]] = []

_ROOM = Path(__file__).parent


def digest(sources: Iterable[Path]) -> str:
    """Of the contents of files."""
    return hashlib.sha256(b"\0".join(source.read_bytes() for source in sources)).hexdigest()


def _folder() -> Path | None:
    """Where to keep what is compiled: NUMBA_CACHE_DIR, beside the sources, the user's cache; None: nowhere."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    user = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    name = f"kernels-{digest(sorted(_ROOM.glob('*.py')))[:16]}"
    for base in [Path(chosen)] if chosen else [_ROOM / "__pycache__", user / "hid2-sumo"]:
        with contextlib.suppress(OSError):
            (base / name).mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=base / name):
                return base / name
    return None


#: Folder of what is compiled of this state of the room; None where nothing can be written.
FOLDER = _folder()


@contextlib.contextmanager
def _kept_in(folder: Path) -> Iterator[None]:
    """What is decorated meanwhile is kept in a folder; where others keep theirs stays as it is."""
    settings: Any = config  # what is set when it is imported has no types
    before, settings.CACHE_DIR = settings.CACHE_DIR, str(folder)
    try:
        yield
    finally:
        settings.CACHE_DIR = before


def kernel(*signatures: str) -> Callable[[F], F]:
    """Compile a function that Python calls, when it is called, and keep it; where nothing can be written, not.

    signatures: numba's notation, of the calls that set-up prepares; a call with other types compiles when it comes.
    """

    def compile_lazily(function: F) -> F:
        if FOLDER is None:
            dispatcher = njit(function)
        else:
            with _kept_in(FOLDER):
                dispatcher = njit(cache=True)(function)
        KERNELS.append((dispatcher, signatures))
        return cast(F, dispatcher)

    return compile_lazily


def inner(function: F) -> F:
    """Compile a function that kernels call. It is kept as a part of them, not by itself."""
    return cast(F, njit(function))
