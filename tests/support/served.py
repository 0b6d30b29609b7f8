"""`hid2` again and again in one process, as starting takes longer than most commands; it makes scenes itself.

As a script: each line of stdin is a list of the working folder and arguments, each line of stdout one of exit code,
stdout and stderr.
"""

import contextlib
import io
import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import bridge.batch.engine
from bridge.batch.isolation import IsolatedProcess, describe_error

Result = subprocess.CompletedProcess[str]
_ONE_AT_A_TIME = threading.Lock()  # libsumo has one simulation in a process


class Here(IsolatedProcess):
    """In the place of an isolated process: no other one, the caller works itself."""

    def stream(self, function: str, *arguments: object) -> Iterator[Any]:
        with _ONE_AT_A_TIME:
            try:
                yield from resolve_name(function)(*arguments)
            except Exception as error:  # noqa: BLE001  # as the process says it
                yield describe_error(error)


class Served:
    """Called with arguments of `hid2` and cwd=None it runs the command, in a process that is kept until `close`.

    isolated: whether scenes have processes of their own; prefix: the command that starts the process.
    """

    def __init__(self, *, isolated: bool = False, prefix: tuple[str, ...] = ()) -> None:
        self._command = [*prefix, sys.executable, __file__, *(["isolated"] if isolated else [])]
        self._process: subprocess.Popen[str] | None = None

    def __call__(self, *arguments: object, cwd: Path | None = None) -> Result:
        if self._process is None or self._process.poll() is not None:
            self._process = subprocess.Popen(self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        told, answers = self._process.stdin, self._process.stdout
        assert told is not None
        assert answers is not None
        command = [str(one) for one in arguments]
        print(json.dumps([str(cwd or Path.cwd()), *command]), file=told, flush=True)
        try:
            answer = answers.readline()
        except BaseException:  # the test ran out of time: the answer is not that to the next command
            self._process.kill()
            raise
        if not answer:
            self._process.wait()
            raise AssertionError(f"hid2 {command}: an error that it does not explain, on stderr of this test")
        result = Result(command, *json.loads(answer))
        assert "Traceback" not in result.stderr, result.stderr
        return result

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.communicate()


def serve() -> None:
    """Run commands until there are no more."""
    from bridge.cli.commands import run

    told, answers = os.fdopen(os.dup(0)), os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)  # nothing for programs that commands start
    os.dup2(2, 1)  # what SUMO prints
    for line in told:
        folder, *arguments = json.loads(line)
        os.chdir(folder)
        sys.argv = ["hid2", *arguments]
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = run()
        print(json.dumps([code, out.getvalue(), err.getvalue()]), file=answers, flush=True)


if __name__ == "__main__":
    if sys.argv[1:] != ["isolated"]:
        bridge.batch.engine.IsolatedProcess = Here  # type: ignore[attr-defined]
    serve()
