"""What the options say is what the package has, though it is written twice for the sake of a quick start."""

import re
import runpy
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any, get_args

from typer.main import get_command

from bridge.cli import options
from bridge.cli.commands import application
from bridge.config import config_to_dict, describe_config, load_config, parse_behaviours
from bridge.evaluation.paper import Experiment
from bridge.exports.export import WRITERS
from bridge.forecasting.experiment import Reading
from bridge.recordings.folders import SPLITS
from hid2.insertion import requests
from hid2.params import Config, Event, Forecasting, Request

Run = Callable[..., Any]
ROOT = Path(__file__).parents[2]


def option(name: str, command: str = "generate") -> Any:
    commands = get_command(application()).commands  # type: ignore[attr-defined]
    (found,) = [parameter for parameter in commands[command].params if name in parameter.opts]
    return found


def test_choices_are_those_of_the_package() -> None:
    assert get_args(Event.model_fields["kind"].annotation) == get_args(options.EventName)
    assert get_args(options.ExperimentName) == (*get_args(Experiment), "prediction")
    assert get_args(options.FormatName) == tuple(WRITERS)
    assert get_args(options.ReadingName) == get_args(Reading)
    components = {row.key: row.range for row in describe_config()}["without"]
    assert components == f"any of {', '.join(get_args(options.ComponentName))}"
    assert get_args(options.SplitName) == SPLITS


def test_defaults_in_the_help_are_those_of_the_configuration() -> None:
    shown = {name: option(f"--{name}").show_default for name in ("agents", "variants", "focal", "seed")}
    request = config_to_dict(Config())["request"]
    assert shown == {name: str(request[name]) for name in shown}
    assert load_config(None, [], parse_behaviours(option("--behaviours").show_default)) == Config()
    assert option("--trigger-time").show_default == f"{request['trigger_min_s']:g} to 36 % of the scene, 4 s at most"
    assert (Request().trigger_max_s, requests._LATEST_SHARE, requests._LATEST_S) == (None, 0.36, 4.0)
    assert Request().spawn_leaders is True
    params = Forecasting()
    for name, value in (("updates", params.updates), ("variants", params.variants), ("val", params.val_share)):
        assert option(f"--{name}", "paper").show_default == str(value)
    assert option("--updates", "forecast").show_default == str(params.updates)


def test_the_help_of_generate_shows_the_usual_options_and_help_all_every_one(hid2: Run) -> None:
    """Twenty of them; each way to begin, repeat and go on has its example."""
    texts = [hid2("generate", asked).stdout for asked in ("--help", "--help-all")]
    for words in ("-o out --agents 20", "--resume, which", "--from out/val", "--repro out/q"):
        assert all(words in text for text in texts)
    usual, every = (len(re.findall(r"^  (?:-\w, )?--\w", text, re.MULTILINE)) for text in texts)
    assert usual <= 20
    assert every > 40
    assert f"{every - usual} more with --help-all" in texts[0]


def test_command_alone_says_how_it_is_used_and_its_version_is_that_of_the_distribution(hid2: Run) -> None:
    result = hid2()
    assert (result.returncode, "usage: hid2" in result.stderr.lower()) == (2, True)
    result = hid2("--version")
    assert (result.returncode, result.stdout) == (0, f"hid2 {version('hid2-sumo')}\n")


def test_page_of_the_commands_says_what_the_help_says() -> None:
    text = (ROOT / "bridge" / "COMMANDS.md").read_text(encoding="utf-8")
    made = runpy.run_path(str(ROOT / ".ci" / "reference.py"))["reference"]()
    assert text == made, "write it anew: .venv/bin/python .ci/reference.py"
    for name, command in get_command(application()).commands.items():  # type: ignore[attr-defined]
        section = text.split(f"## hid2 {name}\n")[1].split("\n## ")[0]
        names = [option for parameter in command.params for option in parameter.opts if option.startswith("-")]
        assert [option for option in names if option not in section] == []
