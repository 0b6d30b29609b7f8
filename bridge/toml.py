"""TOML files that a user writes: read within bounds, as values or as a model; every error names file, key and value."""

import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from bridge.files import one_line, read_regular
from netconvert.errors import ConfigError

#: A TOML file: its size, MB, how deep values are nested, and a dotted key of so many parts that the parser takes long.
#: Real: below 0.02, 4 deep, 3 parts.
_MAX_TOML_MB, _MAX_DEPTH = 1, 20
_MANY_DOTS = re.compile(r"(?:[^\s.,]{1,50}[ \t]*\.[ \t]*){20}")
_Model = TypeVar("_Model", bound=BaseModel)


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """The values of a TOML file of bounded size and depth; what: what is expected there. Errors: ConfigError."""
    try:
        return _parse_toml(read_regular(path, most_mb=_MAX_TOML_MB).decode())
    except OSError as error:
        said = "is a folder" if path.is_dir() else error.strerror if path.exists() else "no such file"
        raise ConfigError(f"{path}: {said}, expected {what} in TOML") from error
    except ValueError as error:
        raise ConfigError(f"{path}: not TOML ({one_line(str(error), most=300)}), expected {what}") from error


def read_toml_as(kind: type[_Model], path: Path, what: str) -> _Model:
    """A TOML file as a model; its validators find the file's folder in their context. Errors: as of `model_of`."""
    return model_of(kind, read_toml(path, what), str(path), folder=path.parent)


def model_of(kind: type[_Model], values: Mapping[str, Any], source: str, *, folder: Path | None = None) -> _Model:
    """Values as a model. Errors: ConfigError with the source and, of the first thing that is wrong, key and value."""
    try:
        return kind.model_validate(values, context=folder)
    except ValidationError as error:
        every = error.errors(include_url=False)
        # of a number or a list, an empty list is a list
        first = next(
            (one for one in every if one["type"] == "too_short" and one["input"] is every[0]["input"]), every[0]
        )
        types = ("constrained-", "int", "float", "str", "bool", "list[")  # of which type of several
        key = f"{'.'.join(part for part in map(str, first['loc']) if not part.startswith(types))!r:.200}"
        said = first["msg"].removeprefix("Input should be ").removeprefix("Value error, ")
        said = said.replace("greater than or equal to", "at least")
        if first["type"] == "too_short":
            said = f"at least {first['ctx']['min_length']} value{'s' * (first['ctx']['min_length'] > 1)}"
        if first["type"] == "list_type" and isinstance(first["input"], Mapping):
            inner = ".".join([*map(str, first["loc"][-1:]), *first["input"]][:2])
            said = f'{key[1:-1]}: a table, expected a list; a key with a dot has to be in quotes, as "{inner}" = [...]'
        elif first["type"] in ("missing", "extra_forbidden"):
            there = "no key" if first["type"] == "missing" else "unknown key"
            said = f"{there} {key}; expected {', '.join(_model_at(kind, first['loc'][:-1]).model_fields)}"
        elif first["type"] == "value_error" and isinstance(first["input"], Mapping):
            said = f"{key[1:-1]}: {said}" if first["loc"] else said
        elif first["loc"]:
            said = f"{key[1:-1]} = {first['input']!r:.60}, expected {said}"
        raise ConfigError(f"{source}: {said}") from error


def _model_at(kind: type[BaseModel], location: Sequence[int | str]) -> type[BaseModel]:
    """The model of the table at a place of the values."""
    for name in location:
        if field := kind.model_fields.get(str(name)):
            kind = next(_models_in(field.annotation), kind)
    return kind


def _models_in(annotation: object) -> Iterator[type[BaseModel]]:
    """The models that a type is made of."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _models_in(part)


def _parse_toml(text: str) -> dict[str, Any]:
    """Errors: ValueError, also for what the parser or a message about a value would not come to an end with."""
    if _MANY_DOTS.search(text):
        raise ValueError("a key of more than 20 parts")
    try:
        values = tomllib.loads(text)
    except RecursionError:
        raise ValueError("tables or lists nested too deeply") from None
    _check_values(values, 1)
    return values


def _check_values(value: object, depth: int) -> None:
    if depth > _MAX_DEPTH:
        raise ValueError(f"tables or lists nested more than {_MAX_DEPTH} deep")
    if isinstance(value, int) and value.bit_length() > 64:
        raise ValueError("an integer of more than 64 bit")
    for inner in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        _check_values(inner, depth + 1)


def parse_value(text: str) -> Any:  # noqa: ANN401  # whatever TOML holds
    """The value of a text: as TOML has it, which wants a digit before a point, or the text itself."""
    try:
        return _parse_toml(f"value = {'0' * text.startswith('.')}{text}")["value"]
    except ValueError:
        return text
