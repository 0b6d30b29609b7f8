"""Compiled functions are kept beside the sources; kept ones must not outlive the sources that they were made from."""

import contextlib
import time
from collections.abc import Iterable
from pathlib import Path

#: Whose functions call each other.
PACKAGES = tuple(Path(__file__).parents[1] / name for name in ("bridge", "hid2", "netconvert"))


def forget_outdated(packages: Iterable[Path] = PACKAGES) -> list[Path]:
    """Delete what numba keeps of functions compiled before the newest source of the packages; returns the files.

    numba looks at the file of a function, not at those of the functions that it calls: after an update of the sources
    in place it would go on with the old ones of those.
    """
    folders = list(packages)
    newest = max((file.stat().st_mtime for folder in folders for file in folder.rglob("*.py")), default=0.0)
    if newest > time.time():  # no clock to go by: everything would be compiled anew at every start
        return []
    outdated = []
    for index in (index for folder in folders for index in folder.rglob("__pycache__/*.nbi")):
        # another process was faster; or nothing can be written here, then numba keeps nothing here either
        with contextlib.suppress(OSError):
            if index.stat().st_mtime < newest:
                index.unlink()
                outdated.append(index)
    return outdated
