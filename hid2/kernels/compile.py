"""Compiles every kernel beforehand, so that no scene's time contains it: `python -m hid2.kernels.compile`."""

import importlib
import pkgutil
import sys
from collections.abc import Callable
from typing import Any

from numba.core.sigutils import normalize_signature

import hid2.kernels
from hid2.kernels.compiled import KERNELS, stamp


def _say(message: str) -> None:
    print(f"hid2: {message}", file=sys.stderr, flush=True)


def compile_kernels(say: Callable[[str], None] = _say) -> int:
    """Compile what has not been compiled of these sources, and say so; returns the number of functions."""
    for module in pkgutil.iter_modules(hid2.kernels.__path__):
        if module.name != "compile":
            importlib.import_module(f"hid2.kernels.{module.name}")
    missing = [
        (dispatcher, types)
        for dispatcher, signatures in KERNELS
        for types in (_types(signature) for signature in signatures)
        if dispatcher._cache.load_overload(types, dispatcher.targetctx) is None
    ]
    if missing:
        say(f"compiling {len(missing)} functions, which takes a minute")
    for dispatcher, types in missing:
        dispatcher.compile(types)
    return len(missing)


def make_ready(say: Callable[[str], None] = _say) -> None:
    """Compile the kernels unless that has been done for these sources; quick where it has."""
    done = stamp()
    if done is not None and not done.exists():
        compile_kernels(say)
        done.parent.mkdir(parents=True, exist_ok=True)
        done.touch()


def _types(signature: str) -> Any:  # noqa: ANN401  # numba's types of the arguments
    parse: Any = normalize_signature
    return parse(signature)[0]


if __name__ == "__main__":
    make_ready()
