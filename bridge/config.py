"""Configuration: defaults < TOML file < the command's own options < --set; every error names key, value and range."""

import hashlib
import json
import tomllib
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NamedTuple, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from hid2.params import Config
from hid2.policies import Policy
from netconvert.errors import ConfigError


class ParameterRow(NamedTuple):
    """One line of `hid2 config`."""

    key: str
    default: str
    unit: str
    range: str
    source: str


def load_config(
    toml_path: Path | None = None,
    overrides: Sequence[str] = (),
    flags: Mapping[str, object] | None = None,
) -> Config:
    """Resolve a configuration.

    toml_path: sections as tables; flags: values of the command's options by "section.key"; overrides: texts
    "section.key=value", which come last.
    Errors: ConfigError with key, value and range.
    """
    data = _read_toml(toml_path) if toml_path is not None else {}
    source = str(toml_path) if toml_path is not None else "configuration"
    config = _validated(data, source)
    for key, value in (flags or {}).items():
        _put(data, key, value)
    for text in overrides:
        key, value = _parse_override(text)
        _put(data, key, value)
    return _validated(data, "configuration") if flags or overrides else config


def parse_behaviours(text: str) -> dict[str, float]:
    """Shares "straight=.5,lane_change=.5" as flags; a behaviour that is not named gets 0.

    Errors: ConfigError.
    """
    names = [policy.value for policy in Policy]
    shares = {f"request.{name}": 0.0 for name in names}
    given: set[str] = set()
    for part in text.split(","):
        name, separator, value = (piece.strip() for piece in part.partition("="))
        if name not in names or not separator:
            alike = get_close_matches(name, names, 1)
            hint = f"; did you mean {alike[0]}?" if alike and name not in names else ""
            raise ConfigError(f"behaviours: {part.strip()!r}, expected name=share of {', '.join(names)}{hint}")
        if name in given:
            raise ConfigError(f"behaviours: {name!r} is given twice; give each once")
        given.add(name)
        shares[f"request.{name}"] = _number(value, f"behaviours: {name}", "a share from 0 to 1")
    return shares


def parse_trigger_time(text: str) -> dict[str, Any]:
    """Trigger time "S", "A:B" or "S,S,...", seconds, as flags. Errors: ConfigError."""
    wanted = "S, A:B or S,S,... in seconds"
    if "," in text:
        return {"request.trigger_list_s": [_number(part.strip(), "trigger-time", wanted) for part in text.split(",")]}
    first, separator, second = text.partition(":")
    low = _number(first.strip(), "trigger-time", wanted)
    high = _number(second.strip(), "trigger-time", wanted) if separator else low
    return {"request.trigger_min_s": low, "request.trigger_max_s": high, "request.trigger_list_s": []}


def config_to_dict(config: Config) -> dict[str, Any]:
    """The configuration as JSON values, in a fixed order."""
    values = config.model_dump(mode="json")
    values["without"] = sorted(values["without"])
    return values


def config_from_dict(values: Mapping[str, Any], *, source: str = "configuration") -> Config:
    """The way back from config_to_dict. Errors: ConfigError."""
    return _validated(dict(values), source)


def config_sha256(config: Config) -> str:
    """Digest that names a configuration."""
    return hashlib.sha256(json.dumps(config_to_dict(config), sort_keys=True).encode()).hexdigest()


def config_to_toml(config: Config) -> str:
    """The configuration as a TOML file that load_config reads back."""
    values = config_to_dict(config)
    lines = [f"{key} = {json.dumps(value)}" for key, value in values.items() if not isinstance(value, dict)]
    for section, entries in values.items():
        if isinstance(entries, dict):
            lines += ["", f"[{section}]", *(f"{key} = {json.dumps(value)}" for key, value in entries.items())]
    return "\n".join(lines).lstrip("\n") + "\n"


def describe_config() -> list[ParameterRow]:
    """Every parameter with default, unit, range and source, in the order of the tree."""
    rows = []
    for section, field in Config.model_fields.items():
        for key, inner in _leaves(section, field):
            extra = inner.json_schema_extra if isinstance(inner.json_schema_extra, dict) else {}
            default = inner.get_default(call_default_factory=True)
            values = sorted(default) if isinstance(default, frozenset) else default
            text = ",".join(map(str, values)) or "none" if isinstance(values, list | tuple) else str(default)
            rows.append(
                ParameterRow(key, text, str(extra.get("unit", "-")), _range(inner), str(extra.get("source", "")))
            )
    return rows


def _leaves(section: str, field: FieldInfo) -> list[tuple[str, FieldInfo]]:
    model = field.annotation
    if isinstance(model, type) and issubclass(model, BaseModel):
        return [(f"{section}.{key}", inner) for key, inner in model.model_fields.items()]
    return [(section, field)]


def _fields() -> dict[str, FieldInfo]:
    return {key: inner for section, field in Config.model_fields.items() for key, inner in _leaves(section, field)}


def _range(field: FieldInfo) -> str:
    """Bounds or choices of a field, in words."""
    leaves, inner = _flatten(field.annotation)
    choices = ", ".join(str(leaf) for leaf in leaves if not isinstance(leaf, type))
    if isinstance(field.get_default(call_default_factory=True), frozenset):
        return f"any of {choices}"
    if bool in leaves:
        return "true, false"
    if get_origin(field.annotation) is tuple:
        least = " and not empty" if any(getattr(entry, "min_length", 0) for entry in field.metadata) else ""
        return f"list of numbers {_bounds(inner)}{least}"
    if int not in leaves and float not in leaves:
        return choices
    words = f"{'integer' if int in leaves else 'number'} {_bounds([*field.metadata, *inner])}".strip()
    return f"{words}, or {choices}" if choices else words


def _flatten(annotation: object) -> tuple[list[object], list[object]]:
    """The types and literal values inside an annotation, and the constraints that annotate them."""
    parts: tuple[object, ...] = get_args(annotation)
    if not parts:
        return [annotation], []
    metadata: tuple[object, ...] = getattr(annotation, "__metadata__", ())
    leaves: list[object] = []
    inner: list[object] = [item for entry in metadata for item in getattr(entry, "metadata", [entry])]
    for part in parts[:1] if metadata else parts:
        more_leaves, more_inner = _flatten(part)
        leaves += more_leaves
        inner += more_inner
    return leaves, inner


def _bounds(metadata: Sequence[object]) -> str:
    signs = {"gt": "> {}", "ge": ">= {}", "lt": "< {}", "le": "<= {}"}
    return ", ".join(
        sign.format(getattr(entry, name))
        for entry in metadata
        for name, sign in signs.items()
        if getattr(entry, name, None) is not None
    )


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file, expected a configuration in TOML") from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"{path}: not TOML ({error})") from error


def _parse_override(text: str) -> tuple[str, object]:
    key, separator, value = text.partition("=")
    if not separator:
        raise ConfigError(f"--set {text!r}: expected section.key=value")
    key, value = key.strip(), value.strip()
    if key == "without":
        return key, [part.strip() for part in value.strip("[]").replace('"', "").split(",") if part.strip()]
    try:
        return key, tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return key, value


def _put(data: dict[str, Any], key: str, value: object) -> None:
    """Set a dotted key in place; ConfigError for a key that no parameter has."""
    if key not in _fields():
        raise ConfigError(_unknown(key, value))
    section, separator, name = key.partition(".")
    if separator:
        data[section] = {**data.get(section, {}), name: value}
    else:
        data[section] = value


def _validated(data: Mapping[str, Any], source: str) -> Config:
    values = {key: _with_tuples(value) if isinstance(value, Mapping) else value for key, value in data.items()}
    if isinstance(values.get("without"), list | tuple):
        values["without"] = frozenset(str(name) for name in values["without"])
    try:
        return Config.model_validate(values, strict=True)
    except ValidationError as error:
        raise ConfigError(f"{source}: {_explain(error)}") from error


def _with_tuples(section: Mapping[str, Any]) -> dict[str, Any]:
    """The values of a section; lists, which is what JSON and TOML have, are tuples here."""
    return {key: tuple(value) if isinstance(value, list) else value for key, value in section.items()}


def _explain(error: ValidationError) -> str:
    first = error.errors(include_url=False)[0]
    location = [str(part) for part in first["loc"]]
    fields = _fields()
    key = location[0] if location and location[0] in fields else ".".join(location[:2])
    if first["type"] == "extra_forbidden":
        return _unknown(key, first["input"])
    if key in fields:
        value = sorted(first["input"]) if isinstance(first["input"], frozenset) else first["input"]
        return f"{key} = {value!r}, expected {_range(fields[key])}"
    if first["type"] == "value_error":  # a check across fields
        return f"{key}: {first['msg'].removeprefix('Value error, ')}"
    return f"{key} = {first['input']!r}, expected a table of parameters"


def _unknown(key: str, value: object) -> str:
    section = key.partition(".")[0]
    alike = get_close_matches(key, _fields(), 2, 0.8)
    known = [name for name in _fields() if name.startswith(f"{section}.")]
    names = known or sorted({name.partition(".")[0] for name in _fields()})
    meant = f"did you mean {' or '.join(alike)}? There are" if alike else "expected one of"
    return f"unknown key {key!r} (= {value!r}), {meant} {', '.join(names)}"


def _number(text: str, name: str, wanted: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ConfigError(f"{name}: {text!r}, expected {wanted}") from None
