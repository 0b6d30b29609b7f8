"""What a process spares itself when it starts: libraries that other libraries load, and nothing here needs.

Together they take a third as long as everything that is needed.
"""

import gc
import sys
from functools import cache
from importlib import import_module
from typing import Any

#: Optional library -> the module that asks for it, and does without where it is not installed. pyarrow asks for pandas
#: with its first array, in compiled code, of which no frame tells.
_DONE_WITHOUT = {"pandas": __name__, "pyproj": "sumolib.net", "scipy": "numba", "yaml": "numba.core.config"}

#: Objects made between two collections of the young ones, and young ones between two of the older (gc.set_threshold).
#: Modules and types are made by the thousand as a process starts, and none of them is ever free.
COLLECT = (5_000, 20, 20)


def spare_the_collector() -> None:
    """Keep the garbage collector from looking through what stays for good: modules, types, compiled functions.

    For a process that has imported its work. One scene leaves little behind that only the collector can free, so it
    also need not come as often.
    """
    gc.freeze()
    gc.set_threshold(*COLLECT)
    gc.enable()


def spare_imports() -> None:
    """Leave out what pyarrow, SUMO's tools and numba would load beside what they are used for.

    For a process that does nothing but its work: all other code, such as a function of the user's, finds them.
    """
    finder: Any = _DoneWithout()
    sys.meta_path.insert(0, finder)
    import pyarrow as pa

    pa.array([0])  # it asks once, and remembers


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
        if name in _DONE_WITHOUT:
            asks = sys._getframe(1)
            while asks.f_back is not None and asks.f_globals.get("__name__") == "importlib._bootstrap":
                asks = asks.f_back
            if asks.f_globals.get("__name__") == _DONE_WITHOUT[name]:
                raise ImportError(name)
