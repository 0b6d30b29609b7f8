"""What the README shows works as it stands there."""

import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
PYTHON = (ROOT / "bridge" / "PYTHON.md").read_text()


def test_python_example_runs(tmp_path: Path) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert len([line for line in code.splitlines() if line and not line.startswith(("from", "import"))]) <= 12
    said = run(code, tmp_path)
    assert said.startswith("TrafficScene(")
    assert Path(tmp_path, said.splitlines()[-1]).is_dir()
    assert {path.name for path in tmp_path.iterdir()} > {"before_after.png", "gen_0.png", "scene.html"}


def test_page_on_python_runs(tmp_path: Path) -> None:
    said = run("\n".join(re.findall(r"```python\n(.*?)```", PYTHON, re.DOTALL)), tmp_path)
    assert re.search(r"^TrafficScene\(.*: \d+ recorded tracks, 0 inserted\)$", said, re.MULTILINE)
    assert re.search(
        r"^TrafficScene\(.*: \d+ recorded tracks, [1-6] inserted, \d of \d manoeuvres done\)$", said, re.MULTILINE
    )
    assert re.search(r"^standing_share +standing share .* 0\.\d+$", said, re.MULTILINE)
    assert {path.name for path in tmp_path.iterdir()} == {
        "data", "gen_0.png", "out", "scene.gif", "scene.html", "scene.png",
    }  # fmt: skip


def run(code: str, folder: Path) -> str:
    """What code prints, in a folder with the synthetic scenes; warnings are errors."""
    (folder / "data").symlink_to(ROOT / "data")
    command = [sys.executable, "-W", "error", "-c", code]
    environment = os.environ | {"MPLBACKEND": "Agg"}
    result = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300, check=False
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


def test_every_command_is_in_the_table() -> None:
    from bridge.cli.commands import application

    named = {
        command.name or command.callback.__name__ for command in application().registered_commands if command.callback
    }
    assert {name for name in named if f"`hid2 {name}" not in README} == set()
