"""No step count and no sampling rate is a constant outside readers: a recording says what its steps are.

Readers and what is of one format alone (its rules, its writers, a forecaster of its shape) know their own; all others
take `step_s`, `num_steps` and `observed_steps` from the recording, or the scene made of it.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from bridge.recordings.sources import READERS as FORMATS

ROOT = Path(__file__).parents[1]
#: Where steps of a format may be written down as numbers.
READERS = re.compile(rf"bridge/recordings/({'|'.join(one.name for one in FORMATS)}|road|limits|scenario)\.py")
#: What is of Argoverse 2 alone and takes its numbers from the format's reader; it refuses or never meets others.
OF_ARGOVERSE_2 = {
    "bridge/recordings/export.py": "writes its scenes, refuses other steps",
    "bridge/recordings/rules.py": "its rules",
    "bridge/sumo/net.py": "a map of its own, without a recording",
    "bridge/forecasting/predictions.py": "its challenge's submissions",
    "bridge/forecasting/compose.py": "data sets of its shape",
    "bridge/forecasting/places.py": "data sets of its shape",
}
#: Steps that are no time: samples that a derivative needs, steps that SUMO's own code takes, rounds of a display.
COUNTS = {("hid2/evaluation/kinematics.py", "MIN_STEPS"), ("hid2/occupancy/shown.py", "UNSEEN_STEPS")}
FORMAT_NAMES = frozenset({"STEP_S", "OBSERVED_STEPS", "MAX_STEPS", "NUM_STEPS"})
_CONSTANT = re.compile(r"_?(?:[A-Z0-9]+_)*(?:STEPS?|STEP_S|DT|DT_S|HZ|FPS|FRAMES_PER_SECOND|LAST_OBSERVED|RATE_HZ)")
_COUNT = re.compile(r"(?:.*_)?(?:steps?|last_observed)")
_QUANTITY = re.compile(r"(?:.*_)?(?:step_s|steps?|num_steps|observed_steps|last_observed(?:_step)?|dt|fps|hz)")


def breaches(source: str, name: str) -> list[str]:
    """Lines of a module that write down a number of steps, or the seconds of one, each with what it says."""
    return [f"{name}:{_line(node)}: {said}" for node in ast.walk(ast.parse(source)) for said in _of(node, name)]


def _of(node: ast.AST, name: str) -> Iterator[str]:
    if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        for target, value in _pairs(targets[0], node.value):
            if _names(target, _CONSTANT) and _is_number(value) and (name, _name(target)) not in COUNTS:
                yield f"{_name(target)} is a constant"
            if _names(target, _QUANTITY) and _is_number(value, least=2):
                yield f"{_name(target)} has a default"
    elif isinstance(node, ast.arguments):
        named = [*node.posonlyargs, *node.args][len(node.posonlyargs) + len(node.args) - len(node.defaults) :]
        for arg, value in [
            *zip(named, node.defaults, strict=True),
            *zip(node.kwonlyargs, node.kw_defaults, strict=True),
        ]:
            if value is not None and _QUANTITY.fullmatch(arg.arg) and _is_number(value, least=2):
                yield f"{arg.arg} has a default"
    elif (
        isinstance(node, ast.keyword) and node.arg and _QUANTITY.fullmatch(node.arg) and _is_number(node.value, least=2)
    ):
        yield f"{node.arg} is given as a number"
    elif isinstance(node, ast.BinOp) and not isinstance(node.op, ast.Pow):
        if any(
            _names(a, _COUNT) and _is_number(b, least=4) for a, b in ((node.left, node.right), (node.right, node.left))
        ):
            yield f"a number in {ast.unparse(node)}"
    elif isinstance(node, ast.Compare) and len(node.ops) == 1:
        a, b = node.left, node.comparators[0]
        if any(_names(one, _COUNT) and _is_number(other, least=4) for one, other in ((a, b), (b, a))):
            yield f"a number in {ast.unparse(node)}"
    elif isinstance(node, ast.ImportFrom) and name not in OF_ARGOVERSE_2:
        yield from (f"imports {one.name} of a format" for one in node.names if one.name in FORMAT_NAMES)


def _line(node: ast.AST) -> int:
    return min((part.lineno for part in ast.walk(node) if hasattr(part, "lineno")), default=0)


def _pairs(target: ast.expr, value: ast.expr) -> list[tuple[ast.expr, ast.expr]]:
    if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple) and len(target.elts) == len(value.elts):
        return list(zip(target.elts, value.elts, strict=True))
    return [(target, value)]


def _name(node: ast.expr) -> str:
    return node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""


def _names(node: ast.expr, pattern: re.Pattern[str]) -> bool:
    return pattern.fullmatch(_name(node)) is not None


def _is_number(node: ast.expr, *, least: float = 0) -> bool:
    """Whether it is a number written down: a fraction, or an integer of at least `least`."""
    return (
        isinstance(node, ast.Constant)
        and isinstance(node.value, int | float)
        and not isinstance(node.value, bool)
        and (node.value >= least or node.value % 1 > 0)
    )


def test_no_step_is_a_constant_outside_readers() -> None:
    """The whole of the three packages, but for the readers; compiled loops get their steps as arguments."""
    found = []
    for package in ("netconvert", "hid2", "bridge"):
        for path in sorted((ROOT / package).rglob("*.py")):
            name = path.relative_to(ROOT).as_posix()
            if not READERS.fullmatch(name):
                found += breaches(path.read_text(encoding="utf-8"), name)
    assert not found, "take it from the recording:\n" + "\n".join(found)


@pytest.mark.parametrize("source", [
    "DT_S = 0.1", "_STEPS, _STEP_S = 81, 0.1", "FRAMES_PER_SECOND = 10", "LAST_OBSERVED = 49",
    "def f(x, step_s=0.1): ...", "def f(*, step_s: float = 0.1): ...", "class A:\n    observed_steps: int = 50",
    "stack(tracks, step_s=0.1)", "build(num_steps=110)", "a = scene.step * 0.1", "b = min(plan.at_step + 10, n)",
    "c = num_steps == 110", "d = 49 < track.step",
    "from bridge.recordings.scenario import STEP_S",
])  # fmt: skip
def test_a_step_that_is_written_down_is_found(source: str) -> None:
    """What the check above is for; it finds each, and passes neighbours of a step, the first one, and other numbers."""
    assert breaches(source, "hid2/some.py")
    for no_step in (
        "later = step + 1",
        "steps = max(1, steps)",
        "GAP_M = 0.1",
        "a = step * scene.step_s",
        "first_step = 0",
    ):
        assert not breaches(no_step, "hid2/some.py")
