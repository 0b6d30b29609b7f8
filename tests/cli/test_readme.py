"""What the README shows works as it stands there."""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()


def test_python_example_runs(tmp_path: Path) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert len([line for line in code.splitlines() if line and not line.startswith(("from", "import"))]) <= 12
    (tmp_path / "data").symlink_to(ROOT / "data")
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False
    )
    assert result.returncode == 0, result.stderr
    assert "vehicles;" in result.stdout
    assert Path(tmp_path, result.stdout.splitlines()[-1]).is_dir()


def test_every_command_is_in_the_table() -> None:
    from bridge.cli.commands import application

    named = {
        command.name or command.callback.__name__ for command in application().registered_commands if command.callback
    }
    assert {name for name in named if f"`hid2 {name}" not in README} == set()
