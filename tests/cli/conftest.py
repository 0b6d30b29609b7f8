"""The command, run as a user runs it."""

import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

Result = subprocess.CompletedProcess[str]


@pytest.fixture(scope="session")
def hid2() -> Callable[..., Result]:
    """hid2("generate", ..., cwd=None): run the installed command; a traceback fails the test."""

    def run(*arguments: object, cwd: Path | None = None) -> Result:
        command = [str(Path(sys.executable).parent / "hid2"), *map(str, arguments)]
        result = subprocess.run(command, capture_output=True, text=True, cwd=cwd, timeout=300, check=False)
        assert "Traceback" not in result.stderr, result.stderr
        return result

    return run


_EACH = """
import contextlib, io, json, os, sys
from bridge.cli import main
for folder, *arguments in json.load(sys.stdin):
    os.chdir(folder)
    out, err = io.StringIO(), io.StringIO()
    sys.argv = ["hid2", *arguments]
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main()
        except SystemExit as ended:
            code = ended.code
    print(json.dumps([code, out.getvalue(), err.getvalue()]))
"""


@pytest.fixture(scope="session")
def hid2_each() -> Callable[..., list[tuple[int, str, str]]]:
    """hid2_each(commands, folders, prefix=()): run commands in one process; exit code, stdout and stderr of each.

    folders: the one in which all of them run, or each its own; prefix: the command that starts the process.
    """

    def run(
        commands: Sequence[Sequence[str]], folders: Path | Sequence[Path], prefix: Sequence[str] = ()
    ) -> list[tuple[int, str, str]]:
        each = [folders] * len(commands) if isinstance(folders, Path) else folders
        told = json.dumps([(str(folder), *command) for folder, command in zip(each, commands, strict=True)])
        done = subprocess.run(
            [*prefix, sys.executable, "-P", "-c", _EACH], input=told, capture_output=True, text=True, cwd=each[0],
            timeout=600, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return [tuple(json.loads(line)) for line in done.stdout.splitlines()]

    return run
