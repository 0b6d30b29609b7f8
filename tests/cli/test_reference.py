"""The command reference cannot go stale."""

from bridge.cli.reference import PAGE, reference


def test_page_says_what_the_help_says() -> None:
    assert PAGE.read_text(encoding="utf-8") == reference(), "write it anew: python -m bridge.cli.reference"


def test_every_option_of_every_command_is_on_the_page() -> None:
    from typer.main import get_command

    from bridge.cli.commands import application

    text = PAGE.read_text(encoding="utf-8")
    for name, command in get_command(application()).commands.items():  # type: ignore[attr-defined]
        section = text.split(f"## hid2 {name}\n")[1].split("\n## ")[0]
        assert [
            option
            for parameter in command.params
            for option in parameter.opts
            if option.startswith("-") and option not in section
        ] == []
