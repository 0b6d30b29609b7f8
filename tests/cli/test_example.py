"""`hid2 example`: what it writes can be tried by the commands that it prints."""

import shlex
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.mark.slow
def test_the_commands_that_it_prints_run_one_after_the_other(hid2: Run, tmp_path: Path) -> None:
    """In a folder with a space in its name, which the commands quote."""
    written = hid2("example", "-o", "to try", cwd=tmp_path)
    assert written.returncode == 0, written.stderr
    for line in written.stdout.splitlines():
        command, *arguments = shlex.split(line)
        assert command == "hid2"
        done = hid2(*arguments, cwd=tmp_path)
        assert done.returncode == 0, f"{line}: {done.stderr}"
    assert (tmp_path / "to try" / "scenes.html").is_file()
    assert not list((tmp_path / "to try" / "studies").glob("*.png"))


def test_what_is_there_already_is_left_alone(hid2: Run, tmp_path: Path) -> None:
    (tmp_path / "studies").mkdir()
    refused = hid2("example", "-o", str(tmp_path), cwd=tmp_path)
    assert refused.returncode == 2
    assert refused.stderr.splitlines()[-1].endswith(
        "studies: is there already, expected a folder without it: choose another one"
    )
    assert [path.name for path in tmp_path.iterdir()] == ["studies"]
