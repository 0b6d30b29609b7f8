"""Configuration: defaults < TOML file < the command's own options < --set; every error names key, value and range."""

import hashlib
import json
import re
import tomllib
import uuid
from collections.abc import Collection, Mapping, Sequence
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from bridge.files import one_line, read_regular
from hid2.params import GROUPS, Config, Event
from hid2.policies import Policy
from netconvert.errors import ConfigError

#: Ids of synthetic corridors, which are no scenes of Argoverse and may be longer.
CORRIDOR_PREFIX = "corridor-"
#: A TOML file: its size, MB, how deep values are nested, and a dotted key of so many parts that the parser takes long.
#: Real: below 0.02, 4 deep, 3 parts.
_MAX_TOML_MB, _MAX_DEPTH = 1, 20
_MANY_DOTS = re.compile(r"(?:[^\s.,]{1,50}[ \t]*\.[ \t]*){20}")
#: Ids of scenes in which recorded vehicles react: these are no scenes of Argoverse either: they were not driven so.
REACTIVE_PREFIX = "reactive-"


class ParameterRow(NamedTuple):
    """One line of `hid2 config`; group: its use, as `params.GROUPS` has it."""

    group: str
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
    "section.key=value", which come last. A function of your own as lane_change.rule is tried at once.
    Errors: ConfigError with key, value and range.
    """
    data = read_toml(toml_path, "a configuration") if toml_path is not None else {}
    source = str(toml_path) if toml_path is not None else "configuration"
    config, functions = _validated(data, source), False
    for key, value in (flags or {}).items():
        if callable(value) and key == "lane_change.rule":
            from hid2.policy.rules import name_of_rule

            value, functions = name_of_rule(value), True
        _put(data, key, value)
    for text in overrides:
        key, value = _parse_override(text)
        _put(data, key, value)
    config = _validated(data, "configuration") if flags or overrides else config
    if functions:
        from hid2.policy.rules import try_rule

        try_rule(config.lane_change)
    return config


def read_drivers(path: Path) -> dict[str, object]:
    """The section [drivers] of a file that `hid2 calibrate` wrote, as flags.

    Errors: ConfigError for another section, and for a key, a value or a range that no driver has.
    """
    data = read_toml(path, "a configuration")
    others = sorted(data.keys() - {"drivers"})
    if others or not isinstance(data.get("drivers"), dict):
        wrong = f"section or key {', '.join(others)}" if others else "no section [drivers]"
        raise ConfigError(f"{path}: {wrong}, expected [drivers] alone, as hid2 calibrate writes; else use --config")
    _validated(data, str(path))
    return {f"drivers.{name}": value for name, value in data["drivers"].items()}


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
    low, high = _ends(text, "trigger-time", wanted)
    if high < low:
        raise ConfigError(f"trigger-time: {text!r}, expected the earlier time first")
    return {"request.trigger_min_s": low, "request.trigger_max_s": high, "request.trigger_list_s": []}


def option_name(key: str) -> str:
    """The option of a field, without its dashes: the field's name without its unit."""
    return re.sub(r"_(s|m|mps|mps2)$", "", key).replace("_", "-")


def parse_events(kinds: Sequence[str], values: Mapping[str, Any], criticality: Sequence[str]) -> dict[str, Any]:
    """Events of the command line as flags, all of them with the same values and criticality.

    values: by fields of `Event`, None for those not given; bands are texts. Errors: ConfigError, also where there are
    values and no event.
    """
    given = {key: value for key, value in values.items() if value is not None}
    names = [f"--{option_name(key)}" for key in given] + ["--criticality"] * bool(criticality)
    for key in _BANDS & given.keys():
        given[key] = _band(given[key], option_name(key))
    for text in criticality:
        measure, separator, band = text.partition("=")
        if measure not in _CRITICALITY or not separator:
            raise ConfigError(f"--criticality {text!r}: expected ttc=A:B, pet=A:B (s) or drac=A:B (m/s2)")
        if _CRITICALITY[measure] in given:
            raise ConfigError(
                f"--criticality {text!r}: {measure} is asked for twice, expected one band of each measure"
            )
        given[_CRITICALITY[measure]] = _band(band, f"criticality {measure}")
    if given and not kinds:
        raise ConfigError(f"{', '.join(names)} without --event; say which event is meant, such as --event cut_in")
    return {"event": [{"kind": kind, **given} for kind in kinds]} if kinds else {}


#: Fields of events that are bands, and criticality by its measure.
_CRITICALITY = {"ttc": "ttc_s", "pet": "pet_s", "drac": "drac_mps2"}
_BANDS = {"at_s", "gap_m", "speed_difference_mps", *_CRITICALITY.values()}


def _band(text: str, name: str) -> list[float]:
    """Least and largest value of "A:B"; twice the same of "A", which only a moment may be."""
    wanted = "A or A:B" if name == "at" else "A:B"
    if ":" not in text and name != "at":
        raise ConfigError(f"--{name} {text!r}: expected {wanted}")
    return _ends(text, f"--{name}", wanted)


def _ends(text: str, name: str, wanted: str) -> list[float]:
    """A and B of "A:B", twice A of "A". Errors: ConfigError."""
    first, separator, second = text.partition(":")
    return [_number(part.strip(), name, wanted) for part in (first, second if separator else first)]


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


def new_scenario_id(source_id: str, config: Config, seed: int, variant: int) -> str:
    """UUID (version 5) of a request: the same request names the same scenario.

    What comes of a corridor says so, and so does a scene in which recorded vehicles react.
    """
    space = uuid.uuid5(uuid.NAMESPACE_DNS, "hid2-sumo")
    new_id = uuid.uuid5(space, "\n".join([source_id, config_sha256(config), str(seed), str(variant)]))
    says = REACTIVE_PREFIX if config.driving.replay == "reactive" else ""
    return f"{says}{CORRIDOR_PREFIX if is_corridor(source_id) else ''}{new_id}"


def is_corridor(scenario_id: str) -> bool:
    """Whether a scene is a synthetic corridor, or was made of one."""
    return scenario_id.removeprefix(REACTIVE_PREFIX).startswith(CORRIDOR_PREFIX)


def word_for_recorded(scenario_id: str) -> str:
    """What the tracks of a scene are called that are no generated ones: recorded, unless they react."""
    return "reacting" if scenario_id.startswith(REACTIVE_PREFIX) else "recorded"


def check_function(name: str, named: Collection[str], *, where: str) -> None:
    """Raise ConfigError for a function "module:function" that is none of `named`: received files import nothing.

    named: hid2's own, and those that the command line, or a configuration or study file on it, names; where: what asks
    for the function. A name without colon is that of a built-in rule.
    """
    if ":" in name and name not in named:
        raise ConfigError(
            f"{where}: asks for the function {one_line(name, most=200)!r}, which is none of hid2's: if you trust it, "
            f"add --function {one_line(name, most=200)}"
        )


def check_exportable(config: Config) -> None:
    """Raise ConfigError for what studies alone may ask for: traffic that enters, lane changes that nothing guards."""
    if config.lane_change.safety == "rule":
        raise ConfigError(
            "lane_change.safety = 'rule': nothing would guard a lane change of a data set, studies alone "
            "(hid2 study) may ask for it; expected sumo, guard"
        )
    if config.flow.veh_per_h_lane > 0.0:
        raise ConfigError(
            f"flow.veh_per_h_lane = {config.flow.veh_per_h_lane:g}: traffic enters in studies only (hid2 study), "
            "expected 0 here"
        )


def check_reactive(config: Config) -> None:
    """Raise ConfigError where recorded vehicles are to react and an event is asked for with them as recorded."""
    if config.driving.replay == "reactive" and config.event:
        raise ConfigError(
            f"event {config.event[0].kind} with driving.replay = 'reactive': an event is made with vehicles "
            "as recorded; expected no event, or driving.replay = 'fixed'"
        )


def config_to_toml(config: Config) -> str:
    """The configuration as a TOML file that load_config reads back."""
    values = config_to_dict(config)
    tables = [entries for entries in values.pop("event") if entries]
    lines = [f"{key} = {json.dumps(value)}" for key, value in values.items() if not isinstance(value, dict)]
    sections = [(f"[{key}]", value) for key, value in values.items() if isinstance(value, dict)]
    for head, entries in (*sections, *(("[[event]]", table) for table in tables)):
        lines += ["", head, *(f"{key} = {json.dumps(value)}" for key, value in entries.items() if value is not None)]
    return "\n".join(lines).lstrip("\n") + "\n"


def describe_config() -> list[ParameterRow]:
    """Every parameter with default, unit, range and source, by group, then in the order of the tree."""
    rows, group_of = [], {name: group for group, names in GROUPS.items() for name in names}
    for key, field in _fields().items():
        extra = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
        default = field.get_default(call_default_factory=True)
        values = sorted(default) if isinstance(default, frozenset) else default
        text = ",".join(map(str, values)) or "none" if isinstance(values, list | tuple) else str(default) or "none"
        group = group_of.get(key) or group_of[key.partition(".")[0]]
        unit, source = str(extra.get("unit", "-")), str(extra.get("source", ""))
        rows.append(ParameterRow(group, key, text, unit, _range(field), source))
    return sorted(rows, key=lambda row: list(GROUPS).index(row.group))


def _fields() -> dict[str, FieldInfo]:
    """Every field by its dotted key, in the order of the tree."""
    found: dict[str, FieldInfo] = {}
    for section, field in Config.model_fields.items():
        model = field.annotation
        if isinstance(model, type) and issubclass(model, BaseModel):
            found |= {f"{section}.{key}": inner for key, inner in model.model_fields.items()}
        else:
            found[section] = field
    return found


def _range(field: FieldInfo) -> str:
    """Bounds or choices of a field, in words."""
    atoms = [*field.metadata, *_atoms(field.annotation)]
    kinds = [atom for atom in atoms if isinstance(atom, type)]
    choices = ", ".join(str(atom) for atom in atoms if isinstance(atom, str | int))
    if isinstance(field.get_default(call_default_factory=True), frozenset):
        return f"any of {choices}"
    if bool in kinds:
        return "true, false"
    if get_origin(field.annotation) is tuple:
        tables = [kind for kind in kinds if issubclass(kind, BaseModel)]
        if tables:
            return f"tables of {', '.join(name for table in tables for name in table.model_fields)}"
        least = " and not empty" if any(getattr(atom, "min_length", 0) for atom in field.metadata) else ""
        return f"list of numbers {_bounds(atoms)}{least}"
    if not {int, float} & {*kinds}:  # where there are choices, a text that is free names a function
        return f"{choices}{', or module:function' if str in kinds else ''}" if choices else "text"
    words = f"{'integer' if int in kinds else 'number'} {_bounds(atoms)}".strip()
    return f"{words}, or {choices}" if choices else words


def _atoms(annotation: object) -> list[object]:
    """The types, literal values and constraints inside an annotation."""
    parts: tuple[object, ...] = get_args(annotation)
    metadata: tuple[object, ...] = getattr(annotation, "__metadata__", ())
    own = [item for entry in metadata for item in getattr(entry, "metadata", [entry])]
    return own + [atom for part in parts[: 1 if metadata else None] for atom in _atoms(part)] if parts else [annotation]


def _bounds(metadata: Sequence[object]) -> str:
    signs = {"gt": "> {}", "ge": ">= {}", "lt": "< {}", "le": "<= {}"}
    found = (
        sign.format(getattr(entry, name))
        for entry in metadata
        for name, sign in signs.items()
        if getattr(entry, name, None) is not None
    )
    return ", ".join(dict.fromkeys(found))  # of a pair once


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """The values of a TOML file of bounded size and depth; what: what is expected there. Errors: ConfigError."""
    try:
        return _parse_toml(read_regular(path, most_mb=_MAX_TOML_MB).decode())
    except OSError as error:
        said = "is a folder" if path.is_dir() else error.strerror if path.exists() else "no such file"
        raise ConfigError(f"{path}: {said}, expected {what} in TOML") from error
    except ValueError as error:
        raise ConfigError(f"{path}: not TOML ({one_line(str(error), most=300)}), expected {what}") from error


_Model = TypeVar("_Model", bound=BaseModel)


def read_toml_as(kind: type[_Model], path: Path, what: str) -> _Model:
    """A TOML file as a model, whose validators find the file's folder in their context. Errors: as of `model_of`."""
    return model_of(kind, read_toml(path, what), str(path), folder=path.parent)


def model_of(kind: type[_Model], values: Mapping[str, Any], source: str, *, folder: Path | None = None) -> _Model:
    """Values as a model. Errors: ConfigError with the source and, of the first thing that is wrong, key and value."""
    try:
        return kind.model_validate(values, context=folder)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        types = ("constrained-", "int", "float", "str", "bool", "list[")  # of which type of several
        key = f"{'.'.join(part for part in map(str, first['loc']) if not part.startswith(types))!r:.200}"
        said = first["msg"].removeprefix("Input should be ").removeprefix("Value error, ")
        said = said.replace("greater than or equal to", "at least")
        if first["type"] in ("missing", "extra_forbidden"):
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
            inner = [
                atom for atom in _atoms(field.annotation) if isinstance(atom, type) and issubclass(atom, BaseModel)
            ]
            kind = inner[0] if inner else kind
    return kind


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


def _parse_override(text: str) -> tuple[str, object]:
    key, separator, value = text.partition("=")
    if not separator:
        raise ConfigError(f"--set {text!r}: expected section.key=value")
    key, value = key.strip(), value.strip()
    if key == "without":
        return key, [part.strip() for part in value.strip("[]").replace('"', "").split(",") if part.strip()]
    return key, parse_value(value)


def parse_value(text: str) -> Any:  # noqa: ANN401  # whatever TOML holds
    """The value of a text: as TOML has it, or the text itself."""
    try:
        return _parse_toml(f"value = {text}")["value"]
    except ValueError:
        return text


def _put(data: dict[str, Any], key: str, value: object) -> None:
    """Set a dotted key in place; ConfigError for a key that no parameter has."""
    section, separator, name = key.partition(".")
    if key not in _fields():
        if _is_fixed(section, name, value):
            return
        raise ConfigError(_unknown(key, value))
    if separator:
        data[section] = {**data.get(section, {}), name: value}
    else:
        data[section] = value


def _validated(data: Mapping[str, Any], source: str) -> Config:
    values = {}
    for key, value in data.items():
        if isinstance(value, Mapping):
            own = {name: one for name, one in value.items() if not _is_fixed(key, name, one)}
            if not own and value and key not in Config.model_fields:  # a section of which nothing is left
                continue
            value = _with_tuples(own)
        values[key] = value
    if isinstance(values.get("event"), list):
        values["event"] = tuple(values["event"])
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
    if location[0] == "event" and len(location) > 1:
        return _explain_event(first["loc"], first["msg"], first["input"])
    key = location[0] if location and location[0] in fields else ".".join(location[:2])
    if first["type"] == "extra_forbidden":
        return _unknown(key, first["input"])
    if key in fields:
        value = sorted(first["input"]) if isinstance(first["input"], frozenset) else first["input"]
        return f"{key} = {value!r}, expected {_range(fields[key])}"
    if first["type"] == "value_error":  # a check across fields
        return f"{key}: {first['msg'].removeprefix('Value error, ')}"
    return f"{key} = {first['input']!r}, expected a table of parameters"


def _explain_event(location: tuple[int | str, ...], message: str, value: object) -> str:
    """What is wrong with one of the events: which, what was given and what is expected."""
    names = ", ".join(Event.model_fields)
    which = f"event {int(location[1]) + 1}"
    if len(location) == 2:  # a check across fields, or no table at all
        text = message.removeprefix("Value error, ")
        return f"{which}: {text}" if isinstance(value, Mapping) else f"{which} = {value!r}, expected a table of {names}"
    key = str(location[2])
    if key not in Event.model_fields:
        return f"{which}: unknown key {key!r} (= {value!r}), expected one of {names}"
    wanted = "[least, largest]" if key in _BANDS else ""
    return f"{which}: {key} = {value!r}, expected {wanted or _range(Event.model_fields[key])}"


@cache
def _removed() -> dict[str, Any]:
    """What the method has in place of keys of earlier versions, by section; `instead`: what says the same now."""
    return tomllib.loads(Path(__file__).with_name("removed.toml").read_text())


def _is_fixed(section: str, name: str, value: object) -> bool:
    """Whether a key is no parameter any more and the value is what the method has. Errors: ConfigError for another."""
    fixed = _removed().get(section, {}).get(name)
    if fixed is None or fixed == (list(value) if isinstance(value, tuple) else value):
        return fixed is not None
    instead = _removed()["instead"].get(f"{section}.{name}")
    hint = f", or set {instead}" if instead else ""
    raise ConfigError(
        f"{section}.{name} = {value!r:.80}: no parameter any more, the method has {fixed}; leave it out{hint}"
    )


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
