"""Writes the tables of bridge/PYTHON.md from the docstrings of the public names: python .ci/public_names.py."""

import inspect
import re
from pathlib import Path

import bridge

PAGE = Path(__file__).parents[1] / "bridge" / "PYTHON.md"
#: The generated part begins here; what is above is written by hand.
_MARK = "## All names\n"


def page() -> str:
    """The text of the page: each name with its arguments and the first sentence of its docstring."""
    members = [
        f"| `.{name}{_arguments(found)}` | {_sentence(found)} |"
        for name, found in vars(bridge.TrafficScene).items()
        if not name.startswith("_") and (isinstance(found, property) or inspect.isfunction(found))
    ]
    names = [
        f"| `{_call(name)}` | {_sentence(getattr(bridge, name))} |" for name in sorted(bridge.__all__, key=str.lower)
    ]
    table = [
        "| name | what it is |",
        "|---|---|",
        *names,
        "",
        "| of a `TrafficScene` | what it is |",
        "|---|---|",
        *members,
    ]
    return "\n".join([PAGE.read_text(encoding="utf-8").partition(_MARK)[0] + _MARK, *table, ""])


def _call(name: str) -> str:
    found = getattr(bridge, name)
    return name if inspect.isclass(found) else f"{name}({', '.join(inspect.signature(found).parameters)})"


def _arguments(found: object) -> str:
    names = list(inspect.signature(found).parameters)[1:] if callable(found) else []
    return f"({', '.join(names)})" if callable(found) else ""


def _sentence(found: object) -> str:
    text = " ".join((inspect.getdoc(found) or "").split("\n\n")[0].split())
    return (re.match(r".*?[.](?=\s|$)", text) or re.match(".*", text))[0].replace("|", "\\|")  # type: ignore[index]


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
