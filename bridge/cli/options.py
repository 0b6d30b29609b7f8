"""Options: what each says, groups that several commands share, and how a command's are made of its signature.

A parameter of a command has an `option` or an `argument` as its default. One with a group as its type (a NamedTuple
of options) stands for all of that group, and one with `FieldOptions` as its default for fields of the parameters of the
method, from which name, type, range, default and sentence come.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from enum import StrEnum
from functools import partial, wraps
from inspect import Parameter, signature
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_origin, get_type_hints

import typer

from bridge.cli.session import set_up
from bridge.console import Activity
from bridge.recordings.folders import SPLITS, Choices
from hid2.policies import Policy
from netconvert.errors import ConfigError

ALL_DONE, SOME_FAILED, USAGE = 0, 1, 2

# Choices, written out because what they mirror is slow to import; tests/cli/test_options.py compares them.
EVENTS = ("cut_in", "overtake", "lead", "follow", "merge", "cross")
BEHAVIOURS = tuple(policy.value for policy in Policy)
COMPONENTS = ("topology", "collision", "smoothing")
ExperimentName = Literal["table1", "ablation", "density", "diversity", "prediction"]
LanesName = Literal["cells", "whole"]
FormatName = Literal["openscenario", "opendrive", "commonroad", "trj", "sumo", "fcd"]
ReadingName = Literal["recorded", "generated", "both"]


class _Option(NamedTuple):
    """An option before its parameter's name and type are known."""

    says: str
    default: Any
    metavar: str | None
    names: tuple[str, ...]
    choices: Sequence[str]
    more: Mapping[str, Any]


def option(
    says: str, default: Any = ..., metavar: str | None = None, *names: str, choices: Sequence[str] = (), **more: Any
) -> Any:  # it stands for a value of any type
    """An option, required where it has no default.

    names: beside --parameter-name, or instead of it; choices: of an option that may be repeated; others: `Literal`.
    """
    return _Option(says, default, metavar, names, choices, more)


request = partial(option, rich_help_panel="What to generate")
event = partial(option, rich_help_panel="Events")
selection = partial(option, rich_help_panel="Which scenes")
parameter = partial(option, rich_help_panel="Parameters")
running = partial(option, rich_help_panel="Running")
output = partial(option, rich_help_panel="Output")
prediction = partial(option, rich_help_panel="With prediction")


def argument(metavar: str, says: str, default: Any = ...) -> Any:  # it stands for a value of any type
    """An argument by its place, required where it has no default."""
    return typer.Argument(default, metavar=metavar, help=says, show_default=False)


class FieldOptions(NamedTuple):
    """An option for each field of a section of parameters that names a metavar: values by field, of those given.

    Of "Config" that is of all its sections but the request's: values by section.field.
    """

    section: str
    make: Callable[..., Any]

    def parameters(self) -> dict[str, Parameter]:
        """Parameters of the command by the names of the fields."""
        from pydantic import BaseModel

        from hid2 import params

        section = getattr(params, self.section)
        if section is params.Config:
            parts = {name: type(one).__name__ for name, one in section() if isinstance(one, BaseModel)}
            every = {
                name: FieldOptions(part, self.make).parameters() for name, part in parts.items() if part != "Request"
            }
            return {f"{name}.{key}": one for name, found in every.items() for key, one in found.items()}
        said = section.model_json_schema()["properties"].items()
        return {
            key: self._parameter(key, section.model_fields[key].annotation, of) for key, of in said if "metavar" in of
        }

    def _parameter(self, key: str, kind: Any, said: Mapping[str, Any]) -> Parameter:
        from bridge.config import option_name

        name, names = option_name(key), tuple[str, ...]()
        more = {"show_default": said["shown"] or False, "min": said.get("minimum"), "max": said.get("maximum")}
        if kind is bool:
            names, more["show_default"] = (f"--{name}/--no-{name}",), name if said["default"] else f"no-{name}"
        made = self.make(f"{said['source']}.", None, said["metavar"] or None, *names, **more)
        known = kind in (int, float, bool) or get_origin(kind) is Literal
        return _parameter(name.replace("-", "_"), kind if known else str, made)


def _parameter(name: str, kind: Any, default: Any) -> Parameter:  # any type and value
    """A parameter as typer takes it."""
    if isinstance(default, _Option):
        says, value, metavar, names, choices, more = default
        many = isinstance(value, list)
        if choices:  # of lists typer takes enumerations alone, of texts
            kind = list[StrEnum("Choice", {choice: choice for choice in choices})]  # type: ignore[misc]
        if kind is bool or "count" in more:
            metavar = ""
        if not any(part.startswith("--") for part in names):
            names = (*names, f"--{name.replace('_', '-')}")
        default = typer.Option(value, *names, **{"help": says, "metavar": metavar, "show_default": not many, **more})
        kind = kind | None if value is None else kind
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=kind)


def flattened(function: Callable[..., Any], check: Callable[[Mapping[str, Any]], None]) -> Callable[..., Any]:
    """The function of a command as typer takes it, with a parameter for each option.

    Before it is called logging is set up and its values are checked; an `Activity` that it takes is begun.
    """
    parameters: list[Parameter] = []
    groups: dict[str, tuple[Callable[..., Any], dict[str, str]]] = {}
    hints = get_type_hints(function)
    for name, own in signature(function).parameters.items():
        kind = hints[name]
        if isinstance(own.default, FieldOptions):
            found = own.default.parameters()
            groups[name] = dict, {key: one.name for key, one in found.items()}
            parameters += found.values()
        elif kind is Activity or hasattr(kind, "_fields"):
            options = Tell if kind is Activity else kind
            groups[name] = kind, {key: key for key in options._fields}
            each = get_type_hints(options)
            parameters += [_parameter(key, each[key], options._field_defaults[key]) for key in options._fields]
        else:
            parameters.append(_parameter(name, kind, own.default))

    @wraps(function)
    def called(**values: Any) -> object:
        set_up(verbose=values.get("verbose", 0), quiet=values.get("quiet", False))
        for text in values.get("settings") or ():  # before what is behind it is taken for a scene
            if "=" not in text:
                raise ConfigError(f"--set {text!r}: expected section.key=value")
        made = {
            name: kind(**{key: values.pop(one) for key, one in keys.items()}) for name, (kind, keys) in groups.items()
        }
        check(values)
        with ExitStack() as stack:
            for activity in (one for one in made.values() if isinstance(one, Activity)):
                stack.enter_context(activity)
            return function(**made, **values)

    called.__signature__ = signature(function).replace(parameters=parameters)  # type: ignore[attr-defined]
    called.__annotations__ = {one.name: one.annotation for one in parameters}
    return called


MAP = selection(
    "An Argoverse 2 map, or a scene's folder with one, for Argoverse 1 sequences without their city's map.",
    None, "MAP", "--map"
)  # fmt: skip
STRIDE = selection("More windows of a sensor log, N sweeps from one to the next.", None, "N", min=1)
SCENE = argument("SCENE", "Scenario folder.")
SCENES = argument("SCENE", "Scenario folders, split folders or data-set roots.")
OUT = output("Folder to write to.", ..., "OUT", "-o")
JOBS = running("Worker processes on this machine.", 1, "N", "--jobs", "-j", min=1)
AS_JSON = output("Print the table as JSON.", False, None, "--json")
CONFIG = parameter("Parameters, as `hid2 config` lists them.", None, "FILE.toml")
SETTINGS = parameter("One parameter, section.key=value; repeatable.", [], "KEY=VALUE", "--set")


class Tell(NamedTuple):
    """How much is said."""

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
    """Which parts of recordings are read, and with which map."""

    map_path: Path | None = MAP
    window: int = selection("First sweep of a sensor log that is taken.", 0, "N", min=0)
    stride: int | None = STRIDE

    def choices(self) -> Choices:
        """As readers take it."""
        return Choices(*self)


class Which(NamedTuple):
    """Which scenes of a data set are wanted: a `Selection`, but for its seed."""

    min_agents: int = selection("Only scenes with at least N recorded tracks.", 0, "N", min=0)
    city: list[str] = selection("Only scenes of this city; repeatable.", [], "CITY")
    split: list[str] = selection("Only scenes of this split; repeatable.", [], choices=SPLITS)
    can: list[str] = selection(
        f"Only scenes with room for this: {', '.join(BEHAVIOURS)}, an event as cut_in:av or lead:focal, or a behaviour "
        "of your own as MODULE:NAME; repeatable.", [], "WHAT",
    )  # fmt: skip
    sample: int | None = selection("N of the selected scenes, drawn with the seed.", None, "N", min=1)


class Batch(NamedTuple):
    """How a batch of scenes runs."""

    jobs: int = JOBS
    scheduler: str | None = running("A running Dask scheduler, tcp://HOST:PORT.", None, "ADDRESS")
    scene_timeout: float = running("Seconds after which a scene is ended and quarantined.", 300.0, "S", min=1)
