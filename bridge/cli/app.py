"""The application that is made of the commands, its own options, and how its help looks."""

import re
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from importlib import import_module
from typing import Annotated, Any, TypeVar

import typer
from typer.core import TyperCommand, TyperOption

from bridge.cli.options import flattened
from bridge.cli.places import check_given
from netconvert.errors import ConfigError

#: Commands in the order of the help, that of the work, and the module that registers each as it is imported.
COMMANDS = {
    "generate": "generation",
    **dict.fromkeys(("validate", "scan", "net", "export"), "scenes"),
    **dict.fromkeys(("evaluate", "calibrate", "resimulate", "study", "public", "make", "paper"), "measuring"),
    **dict.fromkeys(("compose", "forecast"), "forecasting"),
    **dict.fromkeys(("view", "render", "plot", "gui"), "pictures"),
    **dict.fromkeys(("example", "config"), "scenes"),
}

_Function = TypeVar("_Function", bound=Callable[..., Any])


#: By command of the modules that are imported: its function, the options that `--help` shows where not all are, and
#: the check of its paths before it runs.
_FUNCTIONS: dict[str, tuple[Callable[..., Any], frozenset[str], Callable[[Mapping[str, Any]], None]]] = {}


class _Command(TyperCommand):
    """A command with a help that lists options in groups, and wraps values between words instead of cutting them.

    shown: parameters that are listed, all where there are none; --help-all lists all.
    """

    shown: frozenset[str] = frozenset()

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """As the parser does, which would take the last value of an option that holds one, and drop the others."""
        for option in self.params:
            given = sum(word.split("=")[0] in option.opts for word in args)
            holds_one = isinstance(option, TyperOption) and not (option.multiple or option.count or option.is_flag)
            if given > 1 and holds_one:
                raise ConfigError(f"{option.opts[-1]} given {given} times, expected once: it holds one value")
        return super().parse_args(ctx, args)

    def format_options(self, ctx: Any, formatter: Any) -> None:
        groups: dict[str, list[tuple[str, str]]] = {}
        every = self.get_params(ctx)
        listed = [one for one in every if not self.shown or one.name in self.shown]
        for parameter in listed:
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
        if len(listed) < len(every):
            formatter.write_text(
                f"{len(every) - len(listed)} more with --help-all; every parameter: hid2 config, --set."
            )


def command(
    name: str | None = None, *, reads: Iterable[str] = (), folders: Iterable[str] = (), files: Iterable[str] = (),
    shown: Iterable[str] = (),
) -> Callable[[_Function], _Function]:  # fmt: skip
    """A function, which returns the exit code, is a command.

    reads: its parameters that are scenes to read; folders, files: those that are written; each is checked before the
    function is called. shown: parameters that `--help` lists, if not all.
    """

    def register(function: _Function) -> _Function:
        check = partial(check_given, reads=reads, folders=folders, files=files)
        _FUNCTIONS[name or function.__name__] = function, frozenset(shown), check
        return function

    return register


def application(named: str = "", *, every_option: bool = True) -> typer.Typer:
    """The application with the command that is named and those of its module, which start sooner; else with all.

    Commands of which only the first sentence is asked for have no options. every_option: in the help, else the usual.
    """
    modules = [COMMANDS[named]] if named in COMMANDS else dict.fromkeys(COMMANDS.values())
    for module in [] if named == "--version" else modules:
        import_module(f"bridge.cli.{module}")
    app = typer.Typer(
        name="hid2",
        help="Dense traffic and rare manoeuvres for Argoverse 2 scenes, driven by SUMO (HiD2).",
        epilog="Exit codes: 0 all done, 1 some scene could not be done, 2 usage or configuration, "
        "130 or 143 interrupted.",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    )
    app.callback()(hid2)
    for name in (name for name in COMMANDS if name in _FUNCTIONS):
        function, shown, check = _FUNCTIONS[name]
        made = (lambda: None) if named in {"-h", "--help"} else flattened(function, check)
        kind = type("_Command", (_Command,), {"shown": frozenset() if every_option else shown})
        whole = str(function.__doc__)
        app.command(name, cls=kind, help=whole, short_help=whole.split("\n\n")[0])(made)
    return app


def _version(wanted: bool) -> None:  # noqa: FBT001  # typer calls it so
    if wanted:
        from importlib.metadata import version

        print(f"hid2 {version('hid2-sumo')}")
        raise typer.Exit


def hid2(
    *,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Dense traffic and rare manoeuvres for Argoverse 2 scenes, driven by SUMO (HiD2)."""
