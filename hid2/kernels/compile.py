"""Compiles every kernel beforehand, so that no scene's time contains it: `python -m hid2.kernels.compile`."""

import importlib
import os
import pkgutil
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from multiprocessing import get_context
from typing import Any

from numba.core.sigutils import normalize_signature

import hid2.kernels
from hid2.kernels.compiled import FOLDER, KERNELS

#: Processes that compile at once, at most: each takes some 200 MB. Not a parameter: set-up, once.
_AT_ONCE = 4


def _say(message: str) -> None:
    print(f"hid2: {message}", file=sys.stderr, flush=True)


def make_ready(say: Callable[[str], None] = _say, *, at_once: int = 1) -> None:
    """Compile the kernels unless that has been done for these sources; quick where it has.

    at_once: processes that share the work, forks of this one; more than one only where no other thread runs.
    """
    if FOLDER is None or (FOLDER / "all").exists():
        return
    say("compiling inner loops, which takes a minute")
    for module in pkgutil.iter_modules(hid2.kernels.__path__):
        importlib.import_module(f"hid2.kernels.{module.name}")
    wanted = [(row, signature) for row, (_, signatures) in enumerate(KERNELS) for signature in signatures]
    with ProcessPoolExecutor(at_once, mp_context=get_context("fork")) if at_once > 1 else nullcontext() as pool:
        list((pool.map if pool else map)(_compile, wanted))
    (FOLDER / "all").touch()


def _compile(wanted: tuple[int, str]) -> None:
    """One kernel, by its row in KERNELS, for one signature."""
    row, signature = wanted
    KERNELS[row][0].compile(_types(signature))


def _types(signature: str) -> Any:  # noqa: ANN401  # numba's types of the arguments
    """The types of a signature: what is compiled for its text is not found by a call."""
    parse: Any = normalize_signature
    return parse(signature)[0]


if __name__ == "__main__":
    make_ready(at_once=min(_AT_ONCE, os.cpu_count() or 1))
