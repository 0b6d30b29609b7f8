"""What a process spares itself when it starts: libraries that other libraries load, and nothing here needs.

Together they take a third as long as everything that is needed.
"""

import sys
from functools import cache
from importlib import import_module
from typing import Any

#: Optional library -> the module that loads it where it is installed, and does without where it is not.
_DONE_WITHOUT = {"pyproj": "sumolib.net", "scipy": "numba", "yaml": "numba.core.config"}


def spare_imports() -> None:
    """Leave out what pyarrow, SUMO's tools and numba would load beside what they are used for.

    For a process that does nothing but its work: everybody else, such as a function of the user's, finds them all.
    """
    _leave_pandas_out()
    finder: Any = _DoneWithout()
    sys.meta_path.insert(0, finder)


@cache  # once
def spare_modules_of_kernels() -> None:
    """Load compiled functions without numba's modules that their parts were written in, 150 with scipy's and numpy's.

    numba keeps the name of such a module for code that asks Python for a global of it, which no kernel does: none is
    compiled in that mode (`njit`). Modules that are there already, such as those of the kernels, are still used.
    """
    environment: Any = import_module("numba.core.environment")
    rebuild = environment._rebuild_env

    def rebuilt(module: str, constants: list[object], name: str) -> object:
        if module in sys.modules or not module.startswith("numba."):
            return rebuild(module, constants, name)
        found = environment.lookup_environment(name)
        if found is None:
            found = environment.Environment({"__name__": module})
            found.consts[:] = constants
            found.env_name = name
            environment.Environment._memo[name] = found
        return found

    environment._rebuild_env = rebuilt


class _DoneWithout:
    """Finds that an optional library is not there, where that module asks."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> None:
        """Errors: ImportError for an optional library."""
        del path, target
        if name in _DONE_WITHOUT and _asks() == _DONE_WITHOUT[name]:
            raise ImportError(name)


def _asks() -> str:
    """Name of the module whose import statement is being carried out."""
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__") in (__name__, "importlib._bootstrap"):
        frame = frame.f_back
    return str(frame.f_globals.get("__name__"))


class _NoPandas:
    """Finds that there is no pandas."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> None:
        """Errors: ImportError for pandas."""
        del path, target
        if name == "pandas":
            raise ImportError(name)


def _leave_pandas_out() -> None:
    """Let pyarrow believe that there is no pandas, which it would import with its first array.

    It asks once and remembers. It is compiled: no frame tells that it asks.
    """
    import pyarrow as pa

    finder: Any = _NoPandas()
    sys.meta_path.insert(0, finder)
    pa.array([0])
    sys.meta_path.remove(finder)
