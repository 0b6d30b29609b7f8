"""The decorators of compiled functions: with types that a checker sees, and one list of what set-up compiles."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit

F = TypeVar("F", bound=Callable[..., Any])

#: What set-up compiles: every kernel with the signatures that it is called with from Python.
KERNELS: list[tuple[Any, tuple[str, ...]]] = []


def kernel(*signatures: str) -> Callable[[F], F]:
    """Compile a function that Python calls, and keep what is compiled for the next process.

    signatures: numba's notation, of the calls that set-up prepares; a call with other types compiles when it comes.
    """

    def compile_lazily(function: F) -> F:
        dispatcher = njit(cache=True)(function)
        KERNELS.append((dispatcher, signatures))
        return cast(F, dispatcher)

    return compile_lazily


def inner(function: F) -> F:
    """Compile a function that other kernels call. It is kept as a part of these, not by itself."""
    return cast(F, njit(function))
