"""Writes bridge/PYTHON.md from the docstrings of the public names: python .ci/public_names.py. A test compares them."""

import inspect
import re
from pathlib import Path

import bridge

PAGE = Path(__file__).parents[1] / "bridge" / "PYTHON.md"
INTRODUCTION = """\
# From Python

The public interface, `from bridge import ...`. `python .ci/public_names.py` makes this page of the docstrings, and a
test compares them; `help(name)` has shapes, units and errors. It follows semantic versioning from 1.0 on: until then a
minor version may change it, and [CHANGELOG.md](../CHANGELOG.md) says so. All other names may change with any version.
The packages carry types, which mypy and editors follow in an editable install too.

Lengths are in metres, times in seconds, headings in radians counter-clockwise from east; positions are box centres in
city coordinates. One process runs one simulation at a time: to use several cores, use `run_batch`.

| name | what it is |
|---|---|
"""


def page() -> str:
    """The text of the page: each name with its arguments and the first sentence of its docstring."""
    return INTRODUCTION + "".join(
        f"| `{_call(name)}` | {_sentence(name)} |\n" for name in sorted(bridge.__all__, key=str.lower)
    )


def _call(name: str) -> str:
    found = getattr(bridge, name)
    return name if inspect.isclass(found) else f"{name}({', '.join(inspect.signature(found).parameters)})"


def _sentence(name: str) -> str:
    text = " ".join((inspect.getdoc(getattr(bridge, name)) or "").split("\n\n")[0].split())
    return (re.match(r".*?[.](?=\s|$)", text) or re.match(".*", text))[0].replace("|", "\\|")  # type: ignore[index]


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
