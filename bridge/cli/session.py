"""What every command does alike: logging, telling of scenes that cannot be read, choosing scenes."""

import io
import logging
import os
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from bridge.console import Activity, say

if TYPE_CHECKING:
    from bridge.batch.scan import SceneFacts, Selection
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


def read_facts(
    folders: Sequence["Address"], activity: Activity, events: Sequence[str], *, jobs: int
) -> tuple[list["SceneFacts"], list[tuple["Address", str]]]:
    """Facts of scenes, and those that cannot be read with the reason, of which it warns; events: to look for."""
    from bridge.batch.scan import facts_of

    facts, failures = facts_of(folders, events, jobs=jobs, on_scene=activity.show)
    tell_unread(failures)
    return facts, failures


def select_scenes(
    folders: Sequence["Address"], selection: "Selection", activity: Activity, *, jobs: int
) -> list["Address"]:
    """The scenes that the selection wants. Errors: ConfigError where there is none."""
    from bridge.batch.scan import wanted

    activity.doing("reading scenes for the selection")
    facts, failures = read_facts(folders, activity, selection.can, jobs=jobs)
    chosen = wanted(folders, facts, failures, selection)
    activity.note(f"{len(chosen)} of {len(folders)} scenes selected")
    return chosen
