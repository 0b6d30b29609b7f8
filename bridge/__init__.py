"""The file side: Argoverse in and out, SUMO, batches, evaluation, pictures, the command line.

The public interface, for `from bridge import ...`, is `__all__` here, with `Config` and the errors; it follows semantic
versioning from 1.0 on: until then a minor version may change it, and CHANGELOG.md says so. All other names may change
with any version. Names are loaded when they are first used, so that nothing slow is imported for what is not.
"""

from functools import cache
from importlib import import_module
from pathlib import Path
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
    from bridge.pictures.conflicts import draw_conflicts as draw_conflicts
    from bridge.recordings.folders import find_scenarios as find_scenarios
    from bridge.studies.run import run_study as run_study
    from bridge.studies.study import read_study as read_study
    from hid2.measures.conflicts import TrafficConflict as TrafficConflict
    from hid2.params import Config as Config
    from hid2.reasons import Reason as Reason
    from netconvert.errors import Hid2Error as Hid2Error


@cache
def _homes() -> dict[str, str]:
    """The module of each public name, by the imports above, which are the one list of them."""
    import ast

    found = ast.walk(ast.parse(Path(__file__).read_text(encoding="utf-8")))
    imports = [node for node in found if isinstance(node, ast.ImportFrom)]
    return {one.asname: str(node.module) for node in imports for one in node.names if one.asname}


def __getattr__(name: str) -> object:
    """A public name, from where it is."""
    if name == "__all__":
        return sorted(_homes())
    if name not in _homes():
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_homes()[name]), name)


def __dir__() -> list[str]:
    """Public names, before they are loaded too."""
    return sorted({*globals(), *_homes(), "__all__"})
