"""All commands. Each is a thin shell round functions of the package; imports wait until one is called.

Exit codes: 0 all done, 1 some scene could not be done, 2 usage or configuration, 130 or 143 interrupted. Results go
to stdout, messages to stderr.
"""

import os
import re
import sys
from itertools import pairwise

from bridge.cli.app import COMMANDS, application
from bridge.cli.options import SOME_FAILED, USAGE
from bridge.console import fail
from netconvert.errors import ConfigError, Hid2Error

__all__ = ["application", "run"]


def run() -> int:
    """Run the command, return its exit code; an explained error is a line on stderr, never a traceback."""
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "1")  # else every installed distribution is asked for one
    from typer.exceptions import TyperException

    try:
        every_option = "--help-all" in sys.argv
        arguments = ["--help" if one == "--help-all" else one for one in sys.argv[1:]]
        code = application(*arguments[:1], every_option=every_option)(arguments, standalone_mode=False)
    except Hid2Error as error:
        code = _failed(str(error), USAGE if isinstance(error, ConfigError) else SOME_FAILED)
    except TyperException as error:  # a mistake in the command line
        code = _mistake(error)
    except BrokenPipeError:  # the reader of stdout, as `head`, has had enough
        sys.stderr.close()
        code = SOME_FAILED
    except OSError as error:  # a name that the system refuses, or a folder that may not be read
        code = _failed(f"{error.strerror}: {error.filename or 'the system'}", SOME_FAILED)
    return code or 0


#: What the parser of options says, and what is said instead.
_PHRASES = {
    "Value error, ": "",
    "Input should be greater than or equal to": "expected at least",
    "Input should be less than or equal to": "expected at most",
    "Input should be a valid (\\w+)(, unable to parse .*)?": r"expected \1",
    "path '(.*)' is not readable": r"\1 cannot be read (permission denied), expected one that you may read",
}


def _failed(message: str, code: int) -> int:
    fail(message)
    return code


def _mistake(error: Exception) -> int:
    context = getattr(error, "ctx", None)
    if type(error).__name__ == "NoArgsIsHelpError":  # `hid2` alone
        print(error.format_message(), file=sys.stderr)  # type: ignore[attr-defined]
        return USAGE
    named = [one for one in sys.argv[1:2] if one in COMMANDS]
    command = context.command_path if context is not None else " ".join(["hid2", *named])
    message = error.format_message()  # type: ignore[attr-defined]
    for name in getattr(getattr(error, "param", None), "opts", ()):  # the parser says the option, not what was given
        given = [b for a, b in pairwise(sys.argv) if a == name] + [
            one for one in sys.argv if one.startswith(f"{name}=")
        ]
        if given and given[0] not in message:
            message = message.replace("Invalid value for ", f"Invalid value {given[0]!r} for ", 1)
    behind = next((one for one in sys.argv[1:] if one in COMMANDS), None)
    if type(error).__name__ == "NoSuchOption" and behind and not named:
        command, message = f"hid2 {behind}", f"{message.rstrip('.')}; an option of {behind} goes behind its name"
    if type(error).__name__ == "NoSuchOption" and named == ["compose"]:  # as --val, --split-by of earlier versions
        message = f"{message.rstrip('.')}; splits, densities, layout and seed stand in a COMPOSITION.toml"
    for theirs, ours in _PHRASES.items():
        message = re.sub(theirs, ours, message)
    return _failed(f"{message[:1].lower()}{message[1:].rstrip('.')} (see {command} --help)", USAGE)
