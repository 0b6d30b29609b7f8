"""The file side: Argoverse in and out, SUMO, batches, evaluation, pictures, the command line.

The public interface is `__all__` here; until 1.0 a minor version may change it, and CHANGELOG.md says so. Other names
may change with any version. Names are loaded when they are first used, so that nothing slow is imported for nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bridge.batch.batch import Options as Options
    from bridge.batch.batch import plan as plan
    from bridge.batch.batch import run_batch as run_batch
    from bridge.batch.validation import validate_folder as validate_folder
    from bridge.config import load_config as load_config
    from bridge.config import parse_behaviours as parse_behaviours
    from bridge.evaluation.evaluate import evaluate_folder as evaluate_folder
    from bridge.evaluation.scene_metrics import evaluate_scene as evaluate_scene
    from bridge.exports.export import export_scene as export_scene
    from bridge.generation.generate import generate as generate
    from bridge.generation.generate import prepare as prepare
    from bridge.generation.scene import TrafficScene as TrafficScene
    from bridge.generation.scene import read_scene as read_scene
    from bridge.pictures.render import draw_conflicts as draw_conflicts
    from bridge.recordings.sources import find_scenarios as find_scenarios
    from bridge.studies.run import run_study as run_study
    from bridge.studies.study import read_study as read_study
    from hid2.measures.conflicts import TrafficConflict as TrafficConflict
    from hid2.params import Config as Config
    from hid2.reasons import Reason as Reason
    from netconvert.errors import Hid2Error as Hid2Error

#: The public names of each module.
_NAMES = {
    "bridge.batch.batch": "Options plan run_batch",
    "bridge.config": "load_config parse_behaviours",
    "bridge.evaluation.evaluate": "evaluate_folder",
    "bridge.evaluation.scene_metrics": "evaluate_scene",
    "bridge.generation.scene": "TrafficScene read_scene",
    "bridge.generation.generate": "generate prepare",
    "bridge.pictures.render": "draw_conflicts",
    "bridge.exports.export": "export_scene",
    "bridge.recordings.sources": "find_scenarios",
    "bridge.batch.validation": "validate_folder",
    "bridge.studies.run": "run_study",
    "bridge.studies.study": "read_study",
    "hid2.measures.conflicts": "TrafficConflict",
    "hid2.params": "Config",
    "hid2.reasons": "Reason",
    "netconvert.errors": "Hid2Error",
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names.split()}
__all__ = sorted(_HOMES)  # noqa: PLE0605  # one list


def __getattr__(name: str) -> object:
    """A public name, from where it is."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    """Public names, before they are loaded too."""
    return sorted({*globals(), *_HOMES})
