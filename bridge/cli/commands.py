"""The command: its application, how its help looks, and what is said of an error.

Each command is a thin shell round functions of the package, which are imported when it is called; it returns whether
some scene could not be done. Exit codes: 0 all done, 1 some scene could not be done, 2 usage or configuration, 130 or
143 interrupted. Results go to stdout, messages to stderr.
"""

import os
import re
import sys
from functools import partial
from itertools import pairwise
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperOption
from typer.exceptions import TyperException

from bridge.cli import generation, measuring, scenes, showing
from bridge.cli.options import Command, flattened
from bridge.cli.places import check_given
from bridge.console import fail
from netconvert.errors import ConfigError, Hid2Error

SOME_FAILED, USAGE = 1, 2
#: Commands in the order of the help, that of the work: as they stand in their modules.
COMMANDS: dict[str, Command] = {
    name: one
    for module in (generation, scenes, measuring, showing)
    for name, one in vars(module).items()
    if isinstance(one, Command)
}


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
            name, text = parameter.get_help_record(ctx) or ("", "")
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


def application(named: str = "", *, every_option: bool = True) -> typer.Typer:
    """The application with the command that is named, which starts sooner; else with all.

    Commands of which only the first sentence is asked for have no options. every_option: in the help, else the usual.
    """
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
    for name in (named,) if named in COMMANDS else COMMANDS:
        one, whole = COMMANDS[name], str(COMMANDS[name].function.__doc__)
        check = partial(check_given, reads=one.reads, folders=one.folders, files=one.files)
        made = (lambda: None) if named in {"-h", "--help", "--version"} else flattened(one.function, check)
        kind = type("_Command", (_Command,), {"shown": frozenset() if every_option else frozenset(one.shown)})
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


def run() -> int:
    """Run the command, return its exit code; an explained error is a line on stderr, never a traceback."""
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "1")  # else every installed distribution is asked for one
    try:
        every_option = "--help-all" in sys.argv
        arguments = ["--help" if one == "--help-all" else one for one in sys.argv[1:]]
        code = application(*arguments[:1], every_option=every_option)(arguments, standalone_mode=False)
    except Hid2Error as error:
        code = _failed(str(error), USAGE if isinstance(error, ConfigError) else SOME_FAILED)
    except TyperException as error:  # a mistake in the command line
        code = _mistake(error)
    except BrokenPipeError:  # the reader of stdout, as `head`, has had enough
        sys.stderr.close()
        code = SOME_FAILED
    except OSError as error:  # a name that the system refuses, or a folder that may not be read
        code = _failed(f"{error.strerror}: {error.filename or 'the system'}", SOME_FAILED)
    return int(code or 0)


#: What the parser of options says, and what is said instead.
_PHRASES = {
    "Value error, ": "",
    "Input should be greater than or equal to": "expected at least",
    "Input should be less than or equal to": "expected at most",
    "Input should be a valid (\\w+)(, unable to parse .*)?": r"expected \1",
    "path '(.*)' is not readable": r"\1 cannot be read (permission denied), expected one that you may read",
}


def _failed(message: str, code: int) -> int:
    fail(message)
    return code


def _mistake(error: Exception) -> int:
    context = getattr(error, "ctx", None)
    if type(error).__name__ == "NoArgsIsHelpError":  # `hid2` alone
        print(error.format_message(), file=sys.stderr)  # type: ignore[attr-defined]
        return USAGE
    named = [one for one in sys.argv[1:2] if one in COMMANDS]
    command = context.command_path if context is not None else " ".join(["hid2", *named])
    message = error.format_message()  # type: ignore[attr-defined]
    for name in getattr(getattr(error, "param", None), "opts", ()):  # the parser says the option, not what was given
        given = next((b for a, b in pairwise(sys.argv) if a == name or b.startswith(f"{name}=")), "")
        if given not in message:
            message = message.replace("Invalid value for ", f"Invalid value {given!r} for ", 1)
    behind = next((one for one in sys.argv[1:] if one in COMMANDS), None)
    if type(error).__name__ == "NoSuchOption" and behind and not named:
        command, message = f"hid2 {behind}", f"{message.rstrip('.')}; an option of {behind} goes behind its name"
    for theirs, ours in _PHRASES.items():
        message = re.sub(theirs, ours, message)
    return _failed(f"{message[:1].lower()}{message[1:].rstrip('.')} (see {command} --help)", USAGE)
