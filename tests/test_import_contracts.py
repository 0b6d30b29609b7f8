"""The import contracts fail where they are broken: violations are planted in a copy of the tree."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PLANTS = {
    "a room of hid2 imports a higher one": (
        "hid2/measures/following.py",
        "from hid2.evaluation.safety import overlaps",
    ),
    "a room of bridge imports a higher one, inside a function": (
        "bridge/recordings/rules.py",
        "def late() -> None:\n    import bridge.batch.manifest",
    ),
    "the paper imports what touches files": ("hid2/agents.py", "import bridge.files"),
    "the paper imports a library of files": ("hid2/params.py", "import pandas"),
    "a cycle within a room, inside a function": (
        "bridge/batch/engine.py",
        "def late() -> None:\n    import bridge.batch.cluster",
    ),
    "a room that has no place": ("hid2/attic.py", "ATTIC = 1"),
}


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The three packages and their contracts, to be spoiled."""
    folder = tmp_path_factory.mktemp("tree")
    for package in ("bridge", "hid2", "netconvert"):
        shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", folder)
    return folder


def lint_imports(tree: Path) -> subprocess.CompletedProcess[str]:
    path = shutil.which("lint-imports", path=str(Path(sys.executable).parent))
    assert path, "lint-imports is not installed: sh setup.sh tests"
    return subprocess.run([path, "--no-cache"], cwd=tree, capture_output=True, text=True)


def test_an_unspoiled_copy_keeps_every_contract(tree: Path) -> None:
    result = lint_imports(tree)
    assert result.returncode == 0, result.stdout


@pytest.mark.parametrize("plant", PLANTS)
def test_a_planted_violation_is_found(tree: Path, plant: str) -> None:
    file, line = PLANTS[plant]
    path = tree / file
    before = path.read_text() if path.exists() else None
    path.write_text(f"{before or ''}\n\n{line}\n")
    result = lint_imports(tree)
    if before is None:
        path.unlink()
    else:
        path.write_text(before)
    assert result.returncode == 1, result.stdout
    assert "BROKEN" in result.stdout or "attic" in result.stdout + result.stderr
