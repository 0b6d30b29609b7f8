"""The small forecaster of data/examples, which needs a checkout and the extra `forecast`: whether it is there."""

import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

from netconvert.errors import ConfigError

_SCRIPT = Path(__file__).parents[2] / "data" / "examples" / "small_forecaster.py"


def check_forecaster() -> None:
    """Errors: ConfigError where it or torch is not there, with what to do; torch is not imported."""
    if not _SCRIPT.is_file():
        raise ConfigError(f"{_SCRIPT}: no such file, expected the small forecaster of a checkout: run hid2 from one")
    if find_spec("torch") is None:
        raise ConfigError(
            "the small forecaster needs the extra `forecast` (torch): run `sh setup.sh forecast` in the checkout, "
            "or install torch into this environment"
        )


def small_forecaster() -> tuple[ModuleType, ModuleType]:
    """Its modules: what it sees of scenes, and its network, which imports torch. Errors: ConfigError."""
    check_forecaster()
    if str(_SCRIPT.parent) not in sys.path:
        sys.path.append(str(_SCRIPT.parent))
    return import_module("scene_features"), import_module(_SCRIPT.stem)
