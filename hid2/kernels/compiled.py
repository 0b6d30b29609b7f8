"""The decorators of compiled functions: typed, and kept on disk for the next process.

A kernel is loaded by its first call. It is compiled again when its own file, or any other file of this room, has
changed, and by nothing else.
"""

import contextlib
import hashlib
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar, cast

from llvmlite.binding import get_host_cpu_name, parse_bitcode
from numba import __version__ as numba_version
from numba import njit
from numba.core.caching import FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.runtime.nrt import rtsys

F = TypeVar("F", bound=Callable[..., Any])

#: Every kernel, with the signatures that set-up compiles it for.
KERNELS: list[tuple[Any, tuple[str, ...]]] = []

_ROOM = Path(__file__).parent


def digest(sources: Iterable[Path]) -> str:
    """Of the contents of files."""
    return hashlib.sha256(b"\0".join(source.read_bytes() for source in sources)).hexdigest()


_SOURCES = digest(sorted(_ROOM.glob("*.py")))


def stamp() -> Path | None:
    """File that says that all kernels of these sources have been compiled, for this processor; None: nowhere to keep.

    It is beside what is compiled.
    """
    try:
        folder = Path(_KernelCache(digest).cache_path)
    except RuntimeError:
        return None
    machine = f"{numba_version} {sys.version} {get_host_cpu_name()} {_SOURCES}"
    return folder / f"compiled-{hashlib.sha256(machine.encode()).hexdigest()[:16]}"


_JITCodeLibrary: Any = JITCodeLibrary  # its methods have no types
_FunctionCache: Any = FunctionCache


class _Library(_JITCodeLibrary):  # type: ignore[misc]
    """Code of a function. Kept code is loaded without the bitcode beside it, which would take two thirds of the time.

    The bitcode is read when a function is compiled that calls this one.
    """

    _bitcode: bytes | None = None

    @classmethod
    def _unserialize(cls, codegen: Any, state: tuple[str, str, Any]) -> Any:  # noqa: ANN401
        name, kind, data = state
        if kind != "object":
            return super()._unserialize(codegen, state)
        library = codegen.create_library(name)
        library.enable_object_caching()
        code, library._bitcode = data
        library._set_compiled_object(code)
        library._finalize_final_module()
        return library

    def _get_module_for_linking(self) -> object:
        if self._bitcode is not None:
            self._shared_module, self._bitcode = parse_bitcode(self._bitcode), None
            self._codegen._engine._load_defined_symbols(self._shared_module)
        return super()._get_module_for_linking()

    def get_pointer_to_function(self, name: str) -> object:
        """Address of a function; that kept code has the one asked for need not be looked up in its bitcode."""
        if self._bitcode is None:
            return super().get_pointer_to_function(name)
        return self._codegen._engine.get_function_address(name)


class _KernelCache(_FunctionCache):  # type: ignore[misc]
    """numba's cache of a function, which is in __pycache__, or where NUMBA_CACHE_DIR says, or in the user's cache."""

    def _index_key(self, sig: object, codegen: object) -> tuple[object, ...]:
        """Add the sources: numba looks at the file of a function, not at those of the functions that it calls."""
        return (*super()._index_key(sig, codegen), _SOURCES)

    def load_overload(self, sig: object, target_context: Any) -> object:  # noqa: ANN401  # numba's
        """Load without the compiler's imports, which take half a second; running needs no compiler."""
        rtsys.initialize(target_context)
        target_context.codegen()._library_class = _Library
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)


def kernel(*signatures: str) -> Callable[[F], F]:
    """Compile a function that Python calls, when it is called, and keep it; where nothing can be written, not.

    signatures: numba's notation, of the calls that set-up prepares; a call with other types compiles when it comes.
    """

    def compile_lazily(function: F) -> F:
        dispatcher = njit(function)
        with contextlib.suppress(RuntimeError):  # no place can be written
            dispatcher._cache = _KernelCache(function)  # as its enable_caching does
        KERNELS.append((dispatcher, signatures))
        return cast(F, dispatcher)

    return compile_lazily


def inner(function: F) -> F:
    """Compile a function that kernels call. It is kept as a part of them, not by itself."""
    return cast(F, njit(function))
