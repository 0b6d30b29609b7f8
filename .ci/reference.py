"""Pages that are made of the code: `python .ci/reference.py` writes them, a test compares them.

bridge/COMMANDS.md is what `--help` says, the table in hid2/REASONS.md what hid2/reasons.py has.
"""

from pathlib import Path
from typing import Any

import typer
from typer.main import get_command

from bridge.cli.commands import application
from hid2.reasons import Reason

ROOT = Path(__file__).parents[1]
PAGE, REASONS = ROOT / "bridge" / "COMMANDS.md", ROOT / "hid2" / "REASONS.md"
#: Columns that the help is laid out for.
_WIDTH = 100
_INTRODUCTION = """\
# Commands

What `hid2 COMMAND --help` says; `python .ci/reference.py` writes this page, and a test compares it.

Results go to stdout, messages to stderr. Exit codes: 0 all done, 1 some scene could not be done,
2 usage or configuration, 130 or 143 interrupted. `hid2 --install-completion` adds completion to your shell.
"""


def reference() -> str:
    """The text of the page."""
    group: Any = get_command(application())
    context = typer.Context(group, info_name="hid2", terminal_width=_WIDTH, max_content_width=_WIDTH)
    names = group.list_commands(context)
    contents = "\n".join(f"- [`hid2 {name}`](#hid2-{name})" for name in names)
    parts = [f"{_INTRODUCTION}\n{contents}\n"]
    for name in names:
        command = group.get_command(context, name)
        with typer.Context(command, info_name=name, parent=context, terminal_width=_WIDTH) as inner:
            parts.append(f"## hid2 {name}\n\n```text\n{command.get_help(inner).rstrip()}\n```\n")
    return "\n".join(parts)


def with_reasons(page: str) -> str:
    """The page of reasons with its table, which ends it, made anew."""
    head = "| reason | what it says |\n|---|---|\n"
    return page.split(head)[0] + head + "".join(f"| `{reason.value}` | {reason.text} |\n" for reason in Reason)


if __name__ == "__main__":
    PAGE.write_text(reference(), encoding="utf-8")
    REASONS.write_text(with_reasons(REASONS.read_text(encoding="utf-8")), encoding="utf-8")
