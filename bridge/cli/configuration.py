"""`hid2 config`."""

from pathlib import Path

from bridge.cli import options
from bridge.cli.app import command
from bridge.console import print_json, print_table


@command("config")
def show_config(
    *,
    config: Path | None = options.CONFIG,
    settings: list[str] = options.SETTINGS,
    toml: bool = options.output("Print the resolved configuration as a TOML file; so do --config and --set.", False),
    as_json: bool = options.AS_JSON,
) -> None:
    """List every parameter with default, unit, range and source."""
    from bridge.config import ParameterRow, config_to_toml, describe_config, load_config

    if toml or config is not None or settings:
        print(config_to_toml(load_config(config, settings)), end="")
    elif as_json:
        print_json(ParameterRow._fields, describe_config())
    else:
        print_table("Parameters", ParameterRow._fields, describe_config())
