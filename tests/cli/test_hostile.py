"""What others put in the way of the command: one line that says what is wrong, nothing lost, nothing outside OUT."""

import re
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

Run = Callable[..., subprocess.CompletedProcess[str]]
#: What a command that takes longer says of its progress every few seconds.
PROGRESS = re.compile(r"hid2: [a-z ]+(, \d+ s so far|: \d+ of \d+.*)")


def tree(folder: Path) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*"))


def one_line(result: subprocess.CompletedProcess[str]) -> str:
    assert result.returncode == 1, result.stderr
    (line,) = (said for said in result.stderr.splitlines() if not PROGRESS.fullmatch(said))
    assert line.startswith("hid2: ")
    return line


def test_full_disk_is_one_line_and_the_batch_goes_on_when_there_is_room(
    hid2: Run, data_scenes: dict[str, Path], tmp_path: Path
) -> None:
    """No file may grow beyond 8 kB: the system says so as it does on a full disk."""
    arguments = ["generate", str(data_scenes["curve"]), "-o", str(tmp_path / "out"), "--agents", "1"]
    result = subprocess.run(
        [str(Path(sys.executable).parent / "hid2"), *arguments],
        capture_output=True, text=True, timeout=300,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (8_000, 8_000)),
    )  # fmt: skip
    line = one_line(result)
    assert "cannot be written (File too large); finished scenes are in" in line
    assert line.endswith("make room and continue with --resume")
    assert [path for path in tree(tmp_path / "out") if "quarantine" in path or ".json" in path] == []
    assert hid2(*arguments, "--resume", "-q").returncode == 0


def test_name_that_the_system_refuses_is_one_line(hid2: Run, data_scenes: dict[str, Path], tmp_path: Path) -> None:
    """Longer than a file name may be, as the only scene, below one, and as the folder to write to."""
    long, scene = "9" * 5000, data_scenes["curve"]
    for command in (["scan", long], ["generate", scene / long, "-o", "out"], ["generate", scene, "-o", long]):
        assert "File name too long" in one_line(hid2(*command, cwd=tmp_path))
    assert tree(tmp_path) == []
