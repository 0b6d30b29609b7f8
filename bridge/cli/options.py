"""Options: what each says, groups that several commands share, and how a command's are made of its signature.

A parameter of a command has an `option` or an `argument` as its default. One with a group as its type (a NamedTuple
of options and groups) stands for all of that group, and one with `FieldOptions` as its default for parameters of the
method.
"""

import io
import logging
import os
import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import ExitStack
from copy import copy
from enum import StrEnum
from functools import partial, wraps
from inspect import Parameter, signature
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

import typer
from typer.models import OptionInfo

from bridge.console import Activity, say
from bridge.recordings import folders, sources
from hid2.policies import Policy
from netconvert.errors import ConfigError

if TYPE_CHECKING:
    from bridge.batch.batch import Options

# Choices, written out because what they mirror is slow to import; tests/cli/test_options.py compares them.
EventName = Literal["cut_in", "overtake", "lead", "follow", "merge", "cross"]
ComponentName = Literal["topology", "collision", "smoothing"]
SplitName = Literal["train", "val", "test"]
ExperimentName = Literal["table1", "ablation", "density", "diversity", "prediction"]
LanesName = Literal["cells", "whole"]
FormatName = Literal["openscenario", "opendrive", "commonroad", "trj", "sumo", "fcd"]
ReadingName = Literal["recorded", "generated", "both"]
BEHAVIOURS = ", ".join(policy.value for policy in Policy)


def option(says: str, default: Any = ..., metavar: str | None = None, *names: str, **more: Any) -> Any:
    """An option, required where it has no default. names: beside --parameter-name, or instead of it."""
    shown = {"help": says, "metavar": metavar, "show_default": not isinstance(default, list)}
    return typer.Option(default, *names, **shown | more)


request = partial(option, rich_help_panel="What to generate")
event = partial(option, rich_help_panel="Events")
selection = partial(option, rich_help_panel="Which scenes")
parameter = partial(option, rich_help_panel="Parameters")
running = partial(option, rich_help_panel="Running")
output = partial(option, rich_help_panel="Output")
prediction = partial(option, rich_help_panel="With prediction")


def argument(metavar: str, says: str, default: Any = ...) -> Any:
    """An argument by its place, required where it has no default."""
    return typer.Argument(default, metavar=metavar, help=says, show_default=False)


class Given(frozenset[str]):
    """The options, and the arguments by their metavars, that are on the command line."""

    def check(self, used: Collection[str], way: str) -> None:
        """Errors: ConfigError for one that a way of the command makes no use of."""
        if unused := ", ".join(sorted(self.difference(used))):
            also = ", ".join(sorted(used))
            raise ConfigError(f"{unused}: does nothing with {way}; leave it out, expected nothing but {also}")


class FieldOptions(NamedTuple):
    """An option for each field that names a metavar, of the request, of an event, or of all other sections.

    Values by section.field, of an event by field; None for those not given.
    """

    section: Literal["request", "event", "others"]
    make: Callable[..., Any]

    def parameters(self) -> dict[str, Parameter]:
        """Parameters of the command by the keys of the fields."""
        from bridge.config import event_fields, parameter_fields

        every = event_fields() if self.section == "event" else parameter_fields()
        return {
            key: self._parameter(key.rpartition(".")[2], field)
            for key, field in every.items()
            if "metavar" in field and key.startswith("request.") is (self.section == "request")
        }

    def _parameter(self, key: str, said: Mapping[str, Any]) -> Parameter:
        from bridge.config import option_name

        name, names = option_name(key), tuple[str, ...]()
        kind: Any = {"integer": int, "number": float, "boolean": bool}.get(said.get("type", ""), str)
        if "enum" in said:
            kind = Literal[tuple(said["enum"])]
        more = {"show_default": said["shown"] or False, "min": said.get("minimum"), "max": said.get("maximum")}
        if kind is bool:
            names, more["show_default"] = (f"--{name}/--no-{name}",), name if said["default"] else f"no-{name}"
        made = self.make(f"{said['source']}.", None, said["metavar"] or None, *names, **more)
        return _parameter(name.replace("-", "_"), kind, made)


def _parameter(name: str, kind: Any, default: Any) -> Parameter:
    """A parameter as typer takes it."""
    if isinstance(default, OptionInfo):
        default = copy(default)
        if get_origin(kind) is list and get_origin(one := get_args(kind)[0]) is Literal:
            kind = list[StrEnum("Choice", {name: name for name in get_args(one)})]  # type: ignore[misc]  # as typer has it
        if kind is bool or default.count:
            default.metavar = ""
        if not any(part.startswith("--") for part in default.param_decls or ()):
            default.param_decls = (*(default.param_decls or ()), f"--{name.replace('_', '-')}")
        kind = kind | None if default.default is None else kind
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=kind)


class _Handler(logging.Handler):
    """Messages of the packages look as those of the command, and appear beside a bar, not in it."""

    def emit(self, record: logging.LogRecord) -> None:
        say(f"{record.levelname.lower()}: {record.getMessage()}")


def _set_up(*, verbose: int = 0, quiet: bool = False) -> None:
    """Logging as asked for; no figure opens a window, and names of any bytes can be printed."""
    level = (logging.ERROR if quiet else logging.WARNING, logging.INFO, logging.DEBUG)[min(verbose, 2)]
    logging.basicConfig(level=logging.WARNING, handlers=[_Handler()])
    for package in ("bridge", "hid2", "netconvert"):
        logging.getLogger(package).setLevel(level)
    os.environ.setdefault("MPLBACKEND", "Agg")
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


class Command(NamedTuple):
    """A function that is a command; it returns whether some scene could not be done.

    reads: its parameters that are scenes to read; folders, files: those that are written; each is checked before the
    function is called. shown: parameters that `--help` lists, if not all.
    """

    function: Callable[..., Any]
    reads: Sequence[str] = ()
    folders: Sequence[str] = ()
    files: Sequence[str] = ()
    shown: Sequence[str] = ()


def command(**about: Sequence[str]) -> Callable[[Callable[..., Any]], Command]:
    """A function is a command; about: as `Command` has it."""
    return lambda function: Command(function, **about)


def flattened(function: Callable[..., Any], check: Callable[[Mapping[str, Any]], None]) -> Callable[..., Any]:
    """The function of a command as typer takes it, with a parameter for each option.

    Before it is called logging is set up and its values are checked; an `Activity` that it takes is begun.
    """
    hints = get_type_hints(function)
    each = {name: _taken(name, hints[name], own.default) for name, own in signature(function).parameters.items()}
    parameters = [one for found, _ in each.values() for one in found]

    @wraps(function)
    def called(**values: Any) -> object:
        _set_up(verbose=values.get("verbose", 0), quiet=values.get("quiet", False))
        for text in values.get("settings") or ():  # before what is behind it is taken for a scene
            if "=" not in text:
                raise ConfigError(f"--set {text!r}: expected section.key=value")
        check(values)
        made = {name: value_of(values) for name, (_, value_of) in each.items()}
        with ExitStack() as stack:
            for activity in (one for one in made.values() if isinstance(one, Activity)):
                stack.enter_context(activity)
            return function(**made)

    called.__signature__ = signature(function).replace(parameters=parameters)  # type: ignore[attr-defined]
    called.__annotations__ = {one.name: one.annotation for one in parameters}
    return called


def _taken(name: str, kind: Any, default: Any) -> tuple[list[Parameter], Callable[[Mapping[str, Any]], Any]]:
    """The parameters that one of a command's, or of a group's, stands for, and how its value is made of theirs."""
    if isinstance(default, FieldOptions):
        found = default.parameters()
        return [*found.values()], lambda values: {key: values[one.name] for key, one in found.items()}
    if kind is Given:
        context = Parameter("context", Parameter.KEYWORD_ONLY, annotation=typer.Context)
        return [context], lambda values: _given(values["context"])
    group = {Activity: Tell, folders.Choices: Windows}.get(kind, kind)
    if hasattr(group, "_fields"):
        hints, defaults = get_type_hints(group), group._field_defaults
        each = {key: _taken(key, hints[key], defaults.get(key)) for key in group._fields}
        parameters = [one for taken, _ in each.values() for one in taken]
        return parameters, lambda values: kind(**{key: value_of(values) for key, (_, value_of) in each.items()})
    return [_parameter(name, kind, default)], lambda values: values[name]


def _given(context: typer.Context) -> Given:
    """What is on the command line of a command."""
    there = (one for one in context.command.params if one.name is not None)
    of_user = (one for one in there if getattr(context.get_parameter_source(one.name), "name", "") == "COMMANDLINE")
    return Given(str(one.metavar) if one.param_type_name == "argument" else max(one.opts, key=len) for one in of_user)


MAP = selection(
    "An Argoverse 2 map, or a scene's folder with one, for "
    f"{' or '.join(one.many for one in sources.READERS if 'map_path' in one.takes)} without a map.",
    None,
    "MAP",
    "--map",
)
SCENE = argument("SCENE", "Scenario folder.")
SCENES = argument("SCENE", "Scenario folders, split folders or data-set roots.")
OUT = output("Folder to write to.", ..., "OUT", "-o")
JOBS = running("Worker processes on this machine.", 1, "N", "--jobs", "-j", min=1)
AS_JSON = output("Print the table as JSON.", False, None, "--json")
CONFIG = parameter("Parameters, as `hid2 config` lists them.", None, "FILE.toml")
SETTINGS = parameter("One parameter, section.key=value; repeatable.", [], "KEY=VALUE", "--set")


class Tell(NamedTuple):
    """`Activity`: how much is said."""

    verbose: int = output(
        "Say more; -vv: everything, in generate the story of every vehicle that was tried.", 0, None, "-v", count=True,
        show_default=False
    )  # fmt: skip
    quiet: bool = output("Print errors only.", False, None, "-q")


class OneWindow(NamedTuple):
    """Which part of a recording is read, and with which map."""

    map_path: Path | None = MAP
    window: int = selection("First sweep of a sensor log that is taken.", 0, "N", min=0)


class Windows(NamedTuple):
    """`Choices`: which parts of recordings are read, and with which map."""

    map_path: Path | None = MAP
    window: int = selection("First sweep of a sensor log that is taken.", 0, "N", min=0)
    stride: int | None = selection("More windows of a sensor log, N sweeps from one to the next.", None, "N", min=1)


class Which(NamedTuple):
    """Which scenes of a data set are wanted: a `Selection`, but for its seed."""

    min_agents: int = selection("Only scenes with at least N recorded tracks.", 0, "N", min=0)
    city: list[str] = selection("Only scenes of this city; repeatable.", [], "CITY")
    split: list[SplitName] = selection("Only scenes of this split; repeatable.", [])
    can: list[str] = selection(
        f"Only scenes with room for this: {BEHAVIOURS}, an event as cut_in:av or lead:focal, or a behaviour "
        "of your own as MODULE:NAME; repeatable.",
        [],
        "WHAT",
    )
    sample: int | None = selection("N of the selected scenes, drawn with the seed.", None, "N", min=1)


class Batch(NamedTuple):
    """How a batch of scenes runs."""

    jobs: int = JOBS
    scheduler: str | None = running("A running Dask scheduler, tcp://HOST:PORT.", None, "ADDRESS")
    scene_timeout: float = running("Seconds after which a scene is ended and quarantined.", 300.0, "S", min=1)

    def options(self, *, selects: bool = False, **more: Any) -> "Options":
        """As `run_batch` takes it, with more of its options. selects: scenes are read here too. Errors: ConfigError."""
        from bridge.batch.batch import Options

        if self.scheduler is not None and self.jobs > 1 and not selects:
            raise ConfigError(f"--jobs {self.jobs} does nothing with --scheduler, which has its workers; leave it out")
        return Options(jobs=self.jobs, scheduler=self.scheduler, timeout_s=self.scene_timeout, **more)
