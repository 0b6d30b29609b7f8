"""The command, run as a user runs it."""

import subprocess
import sys
from collections.abc import Callable
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
