"""The application that the commands are registered with, its own options, and how its help looks."""

import re
from collections.abc import Callable
from typing import Annotated, Any, TypeVar

import typer
from typer.core import TyperCommand, TyperGroup

#: Order of the commands in the help: that of the work.
ORDER = (
    "generate",
    "validate",
    "scan",
    "net",
    "evaluate",
    "calibrate",
    "compose",
    "forecast",
    "study",
    "make",
    "paper",
    "render",
    "plot",
    "gui",
    "config",
)


_Function = TypeVar("_Function", bound=Callable[..., Any])


class _Group(TyperGroup):
    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ANN401
        return sorted(super().list_commands(ctx), key=ORDER.index)

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401
        """Each command with its whole first sentence."""
        found = [(name, self.get_command(ctx, name)) for name in self.list_commands(ctx)]
        with formatter.section("Commands"):
            formatter.write_dl([(name, str(known.help).split("\n\n")[0]) for name, known in found if known])


class _Command(TyperCommand):
    """A command whose help lists options in groups, and wraps values between words instead of cutting them."""

    def format_options(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401
        groups: dict[str, list[tuple[str, str]]] = {}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is None:
                continue
            name, text = record
            argument = parameter.param_type_name == "argument"
            group = "Arguments" if argument else getattr(parameter, "rich_help_panel", None) or "Options"
            name = str(parameter.metavar) if argument else re.sub(r"<list\[(.*)\]>", r"<\1>", name.strip())
            groups.setdefault(group, []).append((name, re.sub(r"default: \((.*?)\)(?=[];])", r"default: \1", text)))
        own = groups.pop("Options", [])
        for group, records in {**groups, "Options": own}.items():
            with formatter.section(group):
                formatter.write_dl(records, col_max=28)


app = typer.Typer(
    name="hid2",
    cls=_Group,
    help="Dense traffic and rare manoeuvres for Argoverse 2 scenes, driven by SUMO (HiD2).",
    epilog="Exit codes: 0 all done, 1 some scene could not be done, 2 usage or configuration, 130 interrupted.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)


def command(name: str | None = None) -> Callable[[_Function], _Function]:
    """Register a function as a command of the application."""
    return app.command(name, cls=_Command)


def _version(wanted: bool) -> None:  # noqa: FBT001  # typer calls it so
    if wanted:
        from importlib.metadata import version

        print(f"hid2 {version('hid2-sumo')}")
        raise typer.Exit


@app.callback()
def hid2(
    *,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Dense traffic and rare manoeuvres for Argoverse 2 scenes, driven by SUMO (HiD2)."""
