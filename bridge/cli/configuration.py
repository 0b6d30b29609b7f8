"""`hid2 config`."""

from typing import Annotated

from bridge.cli.app import command
from bridge.cli.options import AsJson, ConfigFile, Settings, output_option
from bridge.cli.session import set_up
from bridge.console import print_json, print_table


@command("config")
def show_config(
    *,
    config: ConfigFile = None,
    settings: Settings = [],  # noqa: B006
    toml: Annotated[
        bool,
        output_option(
            "--toml", metavar="", help="Print the resolved configuration as a TOML file; so do --config and --set."
        ),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """List every parameter with default, unit, range and source."""
    set_up()
    from bridge.config import ParameterRow, config_to_toml, describe_config, load_config

    if toml or config is not None or settings:
        print(config_to_toml(load_config(config, settings)), end="")
    elif as_json:
        print_json(ParameterRow._fields, describe_config())
    else:
        print_table("Parameters", ParameterRow._fields, describe_config())
