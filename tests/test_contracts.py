"""The contracts of the imports fail where an import is planted that they forbid."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LATE = "def late() -> None:\n    import "
#: Contract, and a file and a line that break it.
PLANTED = (
    ("bridge -> hid2 -> netconvert", "netconvert/errors.py", "import hid2.params"),
    ("bridge -> hid2 -> netconvert", "hid2/agents.py", "import bridge.files"),
    ("the map side and the paper know neither files of scenes nor SUMO", "hid2/params.py", "import pandas"),
    ("the rooms of hid2, from top to bottom", "hid2/measures/arrays.py", "import hid2.policy.decision"),
    ("the rooms of hid2, from top to bottom", "hid2/attic.py", "ATTIC = 1"),  # a room that has no place
    ("the rooms of bridge, from top to bottom", "bridge/recordings/rules.py", f"{LATE}bridge.batch.manifest"),
    ("no cycle within a room", "bridge/batch/engine.py", f"{LATE}bridge.batch.cluster"),
)


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The three packages and their contracts, to be spoiled."""
    folder = tmp_path_factory.mktemp("tree")
    for package in ("bridge", "hid2", "netconvert"):
        shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", folder)
    return folder


def said(tree: Path) -> tuple[int, str]:
    tool = shutil.which("lint-imports", path=str(Path(sys.executable).parent))
    assert tool, "lint-imports is not installed: sh setup.sh tests"
    done = subprocess.run([tool, "--no-cache"], cwd=tree, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr


def test_an_unspoiled_copy_keeps_every_contract_and_each_has_a_planted_violation(tree: Path) -> None:
    code, told = said(tree)
    assert code == 0, told
    sections = (tree / "pyproject.toml").read_text().split("[[tool.importlinter.contracts]]")[1:]
    assert {section.split('"')[1] for section in sections} == {contract for contract, *_ in PLANTED}


@pytest.mark.parametrize(("contract", "file", "line"), PLANTED)
def test_a_planted_violation_breaks_its_contract(tree: Path, contract: str, file: str, line: str) -> None:
    path = tree / file
    before = path.read_text() if path.exists() else ""
    path.write_text(f"{before}\n\n{line}\n")
    code, told = said(tree)
    path.write_text(before) if before else path.unlink()
    assert code == 1, told
    assert f"{contract} BROKEN" in told or (not before and path.stem in told), told
