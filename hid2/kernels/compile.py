"""Compiles every kernel beforehand, so that no scene's time contains it: `python -m hid2.kernels.compile`."""

import importlib
import pkgutil
import sys
from collections.abc import Callable
from typing import Any

from numba.core.sigutils import normalize_signature

import hid2.kernels
from hid2.kernels.compiled import FOLDER, KERNELS


def _say(message: str) -> None:
    print(f"hid2: {message}", file=sys.stderr, flush=True)


def compile_kernels() -> None:
    """Compile what has not been compiled of these sources."""
    for module in pkgutil.iter_modules(hid2.kernels.__path__):
        if module.name != "compile":
            importlib.import_module(f"hid2.kernels.{module.name}")
    for dispatcher, signatures in KERNELS:
        for signature in signatures:
            dispatcher.compile(_types(signature))


def make_ready(say: Callable[[str], None] = _say) -> None:
    """Compile the kernels unless that has been done for these sources; quick where it has."""
    if FOLDER is None or (FOLDER / "all").exists():
        return
    say("compiling inner loops, which takes a minute")
    compile_kernels()
    (FOLDER / "all").touch()


def _types(signature: str) -> Any:  # noqa: ANN401  # numba's types of the arguments
    """The types of a signature: what is compiled for its text is not found by a call."""
    parse: Any = normalize_signature
    return parse(signature)[0]


if __name__ == "__main__":
    make_ready()
