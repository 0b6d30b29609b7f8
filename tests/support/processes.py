"""Processes that tests started and that ought to leave."""

import os
import time
from collections.abc import Iterable
from pathlib import Path

import psutil

_TESTS = Path(__file__).parents[1]
#: PYTHONPATH of a process that imports tests/batch/faults.py.
PATH_OF_FAULTS = os.pathsep.join(str(_TESTS / name) for name in ("batch", "support"))


def still_running(processes: Iterable[psutil.Process], *, timeout_s: float) -> list[psutil.Process]:
    """Wait until the processes have ended, `timeout_s` at most; returns those that have not.

    One that nobody reaps has ended too: where the first process of a container is no init, orphans stay as zombies.
    """
    end = time.monotonic() + timeout_s
    left = list(processes)
    while left and time.monotonic() < end:
        left = [process for process in left if _runs(process)]
        time.sleep(0.05)
    return left


def _runs(process: psutil.Process) -> bool:
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False
