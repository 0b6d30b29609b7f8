"""Configuration: defaults < TOML file < the command's own options < --set; every error names key, value and range."""

import hashlib
import json
import re
import sys
import uuid
from collections.abc import Collection, Mapping, Sequence
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import ValidationError

from bridge.files import one_line, printable
from bridge.toml import parse_value, read_toml
from hid2.params import GROUPS, Config
from hid2.policies import Policy
from netconvert.errors import ConfigError

#: Prefix of ids of synthetic corridors, which are no scenes of Argoverse and may be longer.
CORRIDOR_PREFIX = "corridor-"
#: Prefix of ids of scenes in which recorded vehicles react: no scenes of Argoverse either, as they were not driven so.
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
    toml_path: Path | str | None = None, overrides: Sequence[str] = (), flags: Mapping[str, object] | None = None
) -> Config:
    """Resolve a configuration.

    toml_path: sections as tables; flags: values by "section.key"; overrides: texts "section.key=value", which come
    last. A function of your own as lane_change.rule is tried at once. Errors: ConfigError with key, value and range.
    """
    data = read_toml(Path(toml_path), "a configuration") if toml_path is not None else {}
    config, functions = config_from_dict(data, source=str(toml_path or "configuration")), False
    for key, value in (flags or {}).items():
        if callable(value) and key == "lane_change.rule":
            from hid2.policy.rules import name_of_rule

            value, functions = name_of_rule(value), True
        _put(data, key, value)
    for text in overrides:
        key, value = _parse_override(text)
        _put(data, key, value)
    config = config_from_dict(data) if flags or overrides else config
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
    config_from_dict(data, source=str(path))
    return {f"drivers.{name}": value for name, value in data["drivers"].items()}


def parse_behaviours(text: str) -> dict[str, float | str]:
    """Shares "straight=.5,lane_change=.5" as flags; a behaviour that is not named gets 0. Errors: ConfigError."""
    names = [policy.value for policy in Policy]
    shares, own = dict[str, float](), dict[str, str]()
    for part in text.split(","):
        name, separator, value = (piece.strip() for piece in part.partition("="))
        if not separator or (name not in names and ":" not in name):
            alike = get_close_matches(name, names, 1)
            hint = f"; did you mean {alike[0]}?" if alike and name not in names else ""
            wanted = f"name=share of {', '.join(names)}, or module:name=share of your own"
            raise ConfigError(f"behaviours: {part.strip()!r}, expected {wanted}{hint}")
        if name in {*shares, *own}:
            raise ConfigError(f"behaviours: {name!r} is given twice; give each once")
        if name in names:
            shares[name] = _number(value, f"behaviours: {name}", "a share from 0 to 1")
        else:
            own[name] = f"{name}={value}"
    return {f"request.{name}": shares.get(name, 0.0) for name in names} | {"request.own": ", ".join(own.values())}


def parse_trigger_time(text: str) -> dict[str, Any]:
    """Trigger time "S", "A:B" or "S,S,...", seconds, as flags. Errors: ConfigError."""
    wanted = "S, A:B or S,S,... in seconds"
    if "," in text:
        return {"request.trigger_list_s": [_number(part.strip(), "trigger-time", wanted) for part in text.split(",")]}
    low, high = _ends(text, "trigger-time", wanted)
    return {"request.trigger_min_s": low, "request.trigger_max_s": high, "request.trigger_list_s": []}


def option_name(key: str) -> str:
    """The option of a field, without its dashes: the field's name without its unit."""
    return re.sub(r"_(s|m|mps|mps2)$", "", key).replace("_", "-")


def parse_events(kinds: Sequence[str], values: Mapping[str, Any], criticality: Sequence[str]) -> dict[str, Any]:
    """Events of the command line as flags, all of them with the same values and criticality.

    values: by fields of `Event`, None for those not given; bands are texts. Errors: ConfigError.
    """
    given = {key: value for key, value in values.items() if value is not None}
    names = [f"--{option_name(key)}" for key in given] + ["--criticality"] * bool(criticality)
    for key in _BANDS & given.keys():
        given[key] = _ends(given[key], f"--{option_name(key)}", "A or A:B" if key == "at_s" else "A:B")
    for text in criticality:
        measure, separator, band = text.partition("=")
        if measure not in _CRITICALITY or not separator:
            raise ConfigError(f"--criticality {text!r}: expected ttc=A:B, pet=A:B (s) or drac=A:B (m/s2)")
        if _CRITICALITY[measure] in given:
            raise ConfigError(f"--criticality {text!r}: {measure} is asked for twice, expected one band of it")
        given[_CRITICALITY[measure]] = _ends(band, f"--criticality {measure}", "A:B")
    if given and not kinds:
        raise ConfigError(f"{', '.join(names)} without --event; say which event is meant, such as --event cut_in")
    return {"event": [{"kind": kind, **given} for kind in kinds]} if kinds else {}


#: Fields of events that are bands, and criticality by its measure.
_CRITICALITY = {"ttc": "ttc_s", "pet": "pet_s", "drac": "drac_mps2"}
_BANDS = {"at_s", "gap_m", "speed_difference_mps", *_CRITICALITY.values()}


def _ends(text: str, name: str, wanted: str) -> list[float]:
    """A and B of "A:B", twice A of "A". Errors: ConfigError."""
    first, separator, second = text.partition(":")
    return [_number(part.strip(), name, wanted) for part in (first, second if separator else first)]


def config_to_dict(config: Config) -> dict[str, Any]:
    """The configuration as JSON values, in a fixed order."""
    return config.model_dump(mode="json")


def config_from_dict(data: Mapping[str, Any], *, source: str = "configuration") -> Config:
    """The way back from config_to_dict; keys of earlier versions may be there. Errors: ConfigError."""
    values = dict(data)
    for section in values.keys() & _removed().keys():
        if isinstance(values[section], Mapping):
            values[section] = {n: one for n, one in values[section].items() if not _is_fixed(section, n, one)}
            if not values[section] and section not in Config.model_fields:  # a section of which nothing is left
                del values[section]
    try:  # as JSON, in which lists are taken for tuples and sets, and no other type for another
        # values of numpy's as those of Python's; text of anything else, which no parameter takes
        text = json.dumps(values, default=lambda value: value.tolist() if hasattr(value, "tolist") else str(value))
        return Config.model_validate_json(text, strict=True)
    except ValidationError as error:
        raise ConfigError(f"{source}: {_explain(error)}") from error


def config_sha256(config: Config) -> str:
    """Digest that names a configuration."""
    return hashlib.sha256(json.dumps(config_to_dict(config), sort_keys=True).encode()).hexdigest()


def new_scenario_id(source_id: str, config: Config, seed: int, variant: int) -> str:
    """UUID (version 5) of a request, behind what says that it is of a corridor, or that recorded vehicles react."""
    space = uuid.uuid5(uuid.NAMESPACE_DNS, "hid2-sumo")
    new_id = uuid.uuid5(space, "\n".join([printable(source_id), config_sha256(config), str(seed), str(variant)]))
    says = REACTIVE_PREFIX if config.driving.replay == "reactive" else ""
    return f"{says}{CORRIDOR_PREFIX if is_corridor(source_id) else ''}{new_id}"


def copy_id(scenario_id: str, number: int) -> str:
    """UUID (version 5) of a further copy of a scene in a composed data set; number: 1 for the first."""
    return str(uuid.uuid5(uuid.uuid5(uuid.NAMESPACE_DNS, "hid2-sumo compose"), f"{scenario_id}\n{number}"))


def is_corridor(scenario_id: str) -> bool:
    """Whether a scene is a synthetic corridor, or was made of one."""
    return scenario_id.removeprefix(REACTIVE_PREFIX).startswith(CORRIDOR_PREFIX)


def asked_for(agents: int | str | None, events: int) -> int | str | None:
    """Vehicles asked for, or `max`, with those of events: these count among them, and may be more."""
    return max(agents, events) if isinstance(agents, int) else agents


def word_for_recorded(scenario_id: str) -> str:
    """What the tracks of a scene are called that are no generated ones: recorded, unless they react."""
    return "reacting" if scenario_id.startswith(REACTIVE_PREFIX) else "recorded"


def functions_of(config: Config) -> dict[str, str]:
    """What of a user's own a configuration names, each "module:name" with its key: a lane-change rule, behaviours."""
    found = {config.lane_change.rule: "lane_change.rule"} if ":" in config.lane_change.rule else {}
    return found | dict.fromkeys(config.request.own_behaviours, "request.own")


def find_in_working_folder() -> None:
    """Modules of a user's own are looked for in the working folder, last; processes of a batch get it from here."""
    if str(Path.cwd()) not in sys.path:
        sys.path.append(str(Path.cwd()))


def check_function(name: str, named: Collection[str], *, where: str) -> None:
    """Raise ConfigError for a function "module:function" that is none of `named`: received files import nothing.

    where: what asks for the function. A name without colon is that of a built-in rule.
    """
    if ":" in name and name not in named:
        raise ConfigError(
            f"{where}: asks for the function {one_line(name, most=200)!r}, which is none of hid2's: if you trust it, "
            f"add --function {one_line(name, most=200)} (in Python: Options(functions=...))"
        )


def check_exportable(config: Config) -> None:
    """Raise ConfigError for what no scene can be made with: what is for studies alone, events where others react."""
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
    for key, field in parameter_fields().items():
        default = field["default"]
        text = ",".join(map(str, default)) if isinstance(default, list) else str(default)
        group = group_of.get(key) or group_of[key.partition(".")[0]]
        rows.append(ParameterRow(group, key, text or "none", field["unit"], _range(field), field["source"]))
    return sorted(rows, key=lambda row: list(GROUPS).index(row.group))


@cache
def _schema() -> dict[str, Any]:
    return Config.model_json_schema()


def event_fields() -> dict[str, dict[str, Any]]:
    """Every field of an event, as JSON schema has it."""
    return _columns(parameter_fields()["event"]["items"])


def _columns(field: Mapping[str, Any]) -> dict[str, Any]:
    """What is said of each field of a table, by its key; empty where a field is none."""
    named: dict[str, Any] = _schema()["$defs"].get(field.get("$ref", "").rpartition("/")[2], {})
    return named.get("properties", {})  # type: ignore[no-any-return]


def parameter_fields() -> dict[str, dict[str, Any]]:
    """Every parameter by its dotted key, in the order of the tree, as JSON schema has it."""
    found: dict[str, dict[str, Any]] = {}
    for name, field in _schema()["properties"].items():
        columns = _columns(field)
        found |= {f"{name}.{key}": inner for key, inner in columns.items()} if columns else {name: field}
    return found


_SIGNS = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}


def _range(field: Mapping[str, Any]) -> str:
    """Bounds or choices of a field, in words."""
    if "anyOf" in field:
        return ", or ".join(_range(one) for one in field["anyOf"] if one.get("type") != "null")
    choices, kind = field.get("enum", [field["const"]] if "const" in field else []), field.get("type")
    if choices:
        return ", ".join(map(str, choices))
    if kind == "array":
        inner = field.get("items", {})
        if table := _columns(inner):
            return f"tables of {', '.join(table)}"
        least = " and not empty" if "minItems" in field else ""
        if "uniqueItems" in field:
            return f"any of {_range(inner)}"
        return f"list of {_range(inner).replace('number', 'numbers')}{least}"
    if kind == "string":
        return str(field.get("examples", ["text"])[0])
    bounds = ", ".join(f"{sign} {field[name]:.10g}" for name, sign in _SIGNS.items() if name in field)
    return "true, false" if kind == "boolean" else f"{kind} {bounds}".strip()


def _parse_override(text: str) -> tuple[str, object]:
    key, separator, value = text.partition("=")
    if not separator:
        raise ConfigError(f"--set {text!r}: expected section.key=value")
    key, value = key.strip(), value.strip()
    if key == "without":
        return key, [part.strip() for part in value.strip("[]").replace('"', "").split(",") if part.strip()]
    return key, parse_value(value)


def _put(data: dict[str, Any], key: str, value: object) -> None:
    """Set a dotted key in place; ConfigError for a key that no parameter has."""
    section, separator, name = key.partition(".")
    if key not in parameter_fields():
        if _is_fixed(section, name, value):
            return
        raise ConfigError(_unknown(key, value, parameter_fields()))
    data[section] = {**data.get(section, {}), name: value} if separator else value


def _explain(error: ValidationError) -> str:
    """What is wrong first: which key, or of which event, its value and what is expected."""
    first = error.errors(include_url=False)[0]
    keys, value, fields, where = [*map(str, first["loc"])], first["input"], parameter_fields(), ""
    if keys[0] == "event" and len(keys) > 1:
        fields, where, keys = event_fields(), f"event {int(keys[1]) + 1}: ", keys[2:]
    key = keys[0] if keys and keys[0] in fields else ".".join(keys[:2])
    if first["type"] == "extra_forbidden":
        return where + _unknown(key, value, fields)
    if where and not key and first["type"] != "value_error":
        return f"{where}{value!r:.100}, expected a table with {', '.join(fields)}"
    if key in fields:
        wanted = "[least, largest]" if where and key in _BANDS else _range(fields[key])
        return f"{where}{key} = {value!r}, expected {wanted}"
    if first["type"] == "value_error":  # a check across fields
        return f"{where or f'{key}: '}{first['msg'].removeprefix('Value error, ')}"
    return f"{where}{key} = {value!r}, expected a table of {', '.join(fields) if where else 'parameters'}"


@cache
def _removed() -> dict[str, Any]:
    """What the method has in place of keys of earlier versions, by section; `instead`: what says the same now."""
    return read_toml(Path(__file__).with_name("removed.toml"), "keys of earlier versions")


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


def _unknown(key: str, value: object, fields: Collection[str]) -> str:
    section, alike = key.partition(".")[0], get_close_matches(key, fields, 2, 0.8)
    known = [name for name in fields if name.startswith(f"{section}.")]
    names = known or sorted({name.partition(".")[0] for name in fields})
    meant = f"did you mean {' or '.join(alike)}? There are" if alike else "expected one of"
    return f"unknown key {key!r} (= {value!r}), {meant} {', '.join(names)}"


def _number(text: str, name: str, wanted: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ConfigError(f"{name}: {text!r}, expected {wanted}") from None
