"""The house rules that a program can check: format, lint, types, and the direction of the imports."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

CHECKS = {
    "format": ["ruff", "format", "--check", "."],
    "lint": ["ruff", "check", "."],
    "types": ["mypy"],
    "layers": ["lint-imports"],
}


@pytest.mark.parametrize("name", CHECKS)
def test_house_rule_holds(name: str) -> None:
    """Each tool exits 0 on the whole tree; its own output says what to mend."""
    tool, *arguments = CHECKS[name]
    path = shutil.which(tool, path=str(Path(sys.executable).parent)) or shutil.which(tool)
    assert path, f"{tool} is not installed: use the dev group (uv run --group dev pytest)"
    result = subprocess.run([path, *arguments], cwd=ROOT, capture_output=True, text=True)
    assert result.returncode == 0, f"{tool}:\n{result.stdout}\n{result.stderr}"


def test_every_module_is_listed_for_packaging() -> None:
    """pyproject.toml lists the packages by hand: a new folder with code must be in it."""
    import tomllib

    listed = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"])
    found = {
        str(init.parent.relative_to(ROOT)).replace("/", ".")
        for package in ("netconvert", "hid2", "bridge")
        for init in (ROOT / package).rglob("__init__.py")
    }
    assert found == listed
