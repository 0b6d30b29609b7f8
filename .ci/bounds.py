"""How large the house is, beside what it is to be: `python .ci/bounds.py [--calls]`, which fails where it has grown.

Each line: what is counted, how many there are, how many there may be now, how many there are to be in the end.
--calls: also which functions of `hid2/insertion` a candidate and a driven vehicle pass through, by driving a scene.
"""

import ast
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

from bridge import find_scenarios, generate, read_scene
from bridge.config import config_from_dict, parameter_fields
from hid2.insertion import filling, starts
from hid2.insertion.finalise import ExportedVehicle
from hid2.vehicle import Start

ROOT = Path(__file__).resolve().parent.parent
PACKAGES, KINDS = ("netconvert", "hid2", "bridge", "data"), (".py", ".js", ".j2")
PRODUCT = (*PACKAGES, ".ci")
#: What is counted: how many there may be now, and how many there are to be in the end. What shrinks is lowered.
BOUNDS = {
    "lines": (38_463, 28_500),
    "statements": (24_395, 15_000),
    "lines of hid2": (15_943, 8_500),
    "lines of hid2/insertion": (4_446, 2_200),
    "lines of hid2/kernels": (2_343, 1_900),
    "lines of netconvert": (2_131, 1_500),
    "lines of bridge/cli": (1_643, 1_000),
    "lines of bridge/recordings": (3_141, 2_500),
    "lines of bridge/sumo": (1_904, 1_700),
    "lines of bridge/batch": (2_034, 1_500),
    "lines of bridge/pictures": (784, 850),
    "lines of bridge/studies, evaluation, forecasting, pages": (7_122, 4_600),
    "lines of tests": (30_502, 19_000),
    "parameters": (109, 110),
    "fmt: skip and fmt: off": (201, 40),
    "functions above 80 lines": (0, 0),
    "functions with more than 8 arguments, outside of kernels": (0, 0),
    "class names that are used twice": (0, 0),
    "persons: who, whom, whose, somebody, nobody, anybody": (13, 40),
    "words of README.md": (900, 900),
    "words of hid2/HOW_IT_WORKS.md": (900, 900),
    "words of pages that are not generated": (14_000, 14_000),
}
_PERSONS = re.compile(r"\b(?:who|whom|whose|somebody|nobody|anybody|everybody)\b", re.IGNORECASE)
_GENERATED = {"bridge/COMMANDS.md", "hid2/REASONS.md", "data/EVENTS.md", "CHANGELOG.md"}


def _files(*patterns: str) -> list[Path]:
    listed = subprocess.run(["git", "ls-files", "-z", *patterns], cwd=ROOT, capture_output=True, check=True, text=True)
    return [ROOT / name for name in listed.stdout.split("\0") if name]


@cache
def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def _texts(*roots: str) -> list[str]:
    """Our own code below some folders."""
    return [_text(path) for path in _files(*roots) if path.suffix in KINDS]


def _lines(*roots: str) -> int:
    return sum(text.count("\n") for text in _texts(*roots))


def _nodes() -> Iterator[tuple[Path, ast.AST]]:
    for path in _files(*PRODUCT):
        if path.suffix == ".py":
            yield from ((path, node) for node in ast.walk(ast.parse(_text(path))))


def _arguments(node: ast.FunctionDef) -> int:
    """All but self and cls."""
    return sum(one.arg not in ("self", "cls") for one in node.args.posonlyargs + node.args.args + node.args.kwonlyargs)


def counts() -> dict[str, int]:
    """What `BOUNDS` names."""
    nodes = list(_nodes())
    functions = [(path, one) for path, one in nodes if isinstance(one, ast.FunctionDef)]
    classes = Counter(one.name for _, one in nodes if isinstance(one, ast.ClassDef))
    pages = [path for path in _files("*.md", ":!.ci") if str(path.relative_to(ROOT)) not in _GENERATED]
    product = _texts(*PACKAGES)  # this script names what it counts
    words = {path: len(_text(path).split()) for path in pages}
    rooms = {
        name: name.removeprefix("lines of ") for name in BOUNDS if name.startswith("lines of ") and "," not in name
    }
    pages_of = [f"bridge/{room}" for room in ("studies", "evaluation", "forecasting", "pages")]
    return {
        "lines": _lines(*PRODUCT),
        "statements": sum(isinstance(one, ast.stmt) for _, one in nodes),
        **{name: _lines(room) for name, room in rooms.items()},
        "lines of bridge/studies, evaluation, forecasting, pages": _lines(*pages_of),
        "parameters": len(parameter_fields()),
        "fmt: skip and fmt: off": sum(len(re.findall(r"# fmt: (?:skip|off)$", text, re.MULTILINE)) for text in product),
        "functions above 80 lines": sum((one.end_lineno or 0) - one.lineno >= 80 for _, one in functions),
        "functions with more than 8 arguments, outside of kernels": sum(
            "kernels" not in path.parts and _arguments(one) > 8 for path, one in functions
        ),
        "class names that are used twice": sum(count > 1 for count in classes.values()),
        "persons: who, whom, whose, somebody, nobody, anybody": sum(
            len(_PERSONS.findall(text)) for text in (*product, *map(_text, pages))
        ),
        "words of README.md": words[ROOT / "README.md"],
        "words of hid2/HOW_IT_WORKS.md": words[ROOT / "hid2/HOW_IT_WORKS.md"],
        "words of pages that are not generated": sum(words.values()),
    }


def _traced(call: Callable[..., Any], ends: type, into: list[list[tuple[str, str]]]) -> Callable[..., Any]:
    """The same function; of calls with a result of a type it keeps what of `hid2/insertion` they passed through."""
    room = str(ROOT / "hid2/insertion")

    def traced(*args: Any, **named: Any) -> Any:  # noqa: ANN401  # whatever it takes and gives
        passed: list[tuple[str, str]] = []

        def seen(frame: Any, event: str, _: object) -> None:  # noqa: ANN401  # a frame
            code = frame.f_code
            if event == "call" and code.co_filename.startswith(room) and "<locals>" not in code.co_qualname:
                passed.append((Path(code.co_filename).name, code.co_qualname))

        sys.setprofile(seen)
        try:
            found = call(*args, **named)
        finally:
            sys.setprofile(None)
        if isinstance(found, ends):
            into.append(passed)
        return found

    return traced


def calls() -> Iterator[str]:
    """Functions that a candidate that is taken, and a vehicle that is exported, pass through at least."""
    made: list[list[tuple[str, str]]] = []
    ended: list[list[tuple[str, str]]] = []
    starts.Starts.make = _traced(starts.Starts.make, Start, made)  # type: ignore[method-assign]
    filling.finalise = _traced(filling.finalise, ExportedVehicle, ended)
    generate(read_scene(find_scenarios(ROOT / "data/av2")[0]), config_from_dict({"request": {"agents": 10}}))
    for name, each in (("a candidate", made), ("a driven vehicle", ended)):
        passed = min(each, key=lambda one: len(set(one)))
        files = [file for file, _ in passed]
        left = [file for before, file in pairwise(files) if file != before]
        back = sum(file in [files[0], *left[:row]] for row, file in enumerate(left))
        yield f"{name}: {len(set(passed))} functions, {back} returns to a file already left"
        yield from (f"    {file} {function}" for file, function in dict.fromkeys(passed))


def main() -> int:
    """The table; 1 where something has grown."""
    found = counts()
    for name, (now, end) in BOUNDS.items():
        print(f"{name:60s} {found[name]:7,d} {now:7,d} {end:7,d}{'   grown' * (found[name] > now)}")
    if "--calls" in sys.argv[1:]:
        print(*calls(), sep="\n")
    return int(any(found[name] > now for name, (now, _) in BOUNDS.items()))


if __name__ == "__main__":
    sys.exit(main())
