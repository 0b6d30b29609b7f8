"""The house rules that a program can check: format, lint, types, the direction of the imports, how large it is."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

#: Writing a cache takes mypy a fifth of its time, and is of use only where one is kept.
CACHE = [] if (ROOT / ".mypy_cache").is_dir() else ["--cache-dir=/dev/null"]
CHECKS = {
    "format": ["ruff", "format", "--check", "."],
    "lint": ["ruff", "check", "."],
    "types": ["mypy", *CACHE],
    "layers": ["lint-imports"],
    "bounds": [sys.executable, ".ci/bounds.py"],
}


@pytest.mark.parametrize("name", CHECKS)
def test_house_rule_holds(name: str) -> None:
    """Each tool exits 0 on the whole tree; its own output says what to mend."""
    tool, *arguments = CHECKS[name]
    path = shutil.which(tool, path=str(Path(sys.executable).parent)) or shutil.which(tool)
    assert path, f"{tool} is not installed: sh setup.sh tests"
    result = subprocess.run([path, *arguments], cwd=ROOT, capture_output=True, text=True)
    assert result.returncode == 0, f"{tool}:\n{result.stdout}\n{result.stderr}"
