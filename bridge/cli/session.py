"""What every command does alike: logging, telling of scenes that cannot be read, choosing scenes."""

import io
import logging
import os
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from bridge.console import Activity, say

if TYPE_CHECKING:
    from bridge.batch.scan import Selection
    from bridge.recordings.folders import Address


class _Handler(logging.Handler):
    """Messages of the packages look as those of the command, and appear beside a bar, not in it."""

    def emit(self, record: logging.LogRecord) -> None:
        say(f"{record.levelname.lower()}: {record.getMessage()}")


def set_up(*, verbose: int = 0, quiet: bool = False) -> None:
    """Logging as asked for; no figure opens a window.

    verbose: 0, 1 for more messages, 2 for debug messages. Names of any bytes can be printed.
    """
    wanted = logging.ERROR if quiet else logging.WARNING
    level = (wanted, logging.INFO, logging.DEBUG)[min(verbose, 2)]
    logging.basicConfig(level=logging.WARNING, handlers=[_Handler()])
    for package in ("bridge", "hid2", "netconvert"):
        logging.getLogger(package).setLevel(level)
    os.environ.setdefault("MPLBACKEND", "Agg")
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def tell_unread(failures: Sequence[tuple["Address", str]]) -> None:
    """Warn of scenes that cannot be read; most reasons name the file themselves."""
    for folder, reason in failures:
        said = reason if reason.startswith(str(folder)) else f"{folder}: {reason}"
        say(f"warning: {said}")


def select_scenes(
    folders: Sequence["Address"], selection: "Selection", activity: Activity, *, jobs: int
) -> list["Address"]:
    """The scenes that the selection wants; it warns of those that cannot be read. Errors: ConfigError for none."""
    from bridge.batch.scan import wanted

    activity.doing("reading scenes for the selection")
    chosen, unread = wanted(folders, selection, jobs=jobs, on_scene=activity.show)
    tell_unread(unread)
    activity.note(f"{len(chosen)} of {len(folders)} scenes selected")
    return chosen
