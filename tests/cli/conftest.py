"""The command, run as a user runs it, or again and again in one process."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from served import Result, Served


@pytest.fixture(scope="session")
def hid2() -> Iterator[Callable[..., Result]]:
    """hid2("generate", ..., cwd=None): run a command in a process that all tests share; a traceback fails the test."""
    served = Served()
    yield served
    served.close()


@pytest.fixture(scope="session")
def new_hid2() -> Callable[..., Result]:
    """As `hid2`, the installed command in a process of its own."""

    def run(*arguments: object, cwd: Path | None = None) -> Result:
        command = [str(Path(sys.executable).parent / "hid2"), *map(str, arguments)]
        result = subprocess.run(command, capture_output=True, text=True, cwd=cwd, timeout=300, check=False)
        assert "Traceback" not in result.stderr, result.stderr
        return result

    return run
