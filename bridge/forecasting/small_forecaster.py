"""The small forecaster of data/examples, which needs the extra `forecast`: whether it is there."""

import sys
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType

from bridge.files import data_folder
from netconvert.errors import ConfigError

_SCRIPT = data_folder() / "examples" / "small_forecaster.py"


def check_forecaster() -> None:
    """Errors: ConfigError where torch is not there, with what to do; it is not imported."""
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
