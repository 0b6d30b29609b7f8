"""The contracts of the imports fail where an import is planted that they forbid."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
#: Contract -> file and a line that breaks it.
PLANTED = {
    "bridge -> hid2 -> netconvert": ("netconvert/errors.py", "import hid2.params"),
    "the map side and the paper know neither files of scenes nor SUMO": ("hid2/agents.py", "import pyarrow"),
    "the rooms of hid2, from top to bottom": ("hid2/measures/arrays.py", "import hid2.policy.decision"),
    "the rooms of bridge, from top to bottom": ("bridge/recordings/folders.py", "import bridge.batch.manifest"),
    "no cycle within a room": ("hid2/insertion/requests.py", "def later():\n    import hid2.insertion.filling"),
}


def broken(folder: Path) -> set[str]:
    """Names of the contracts that do not hold."""
    tool = shutil.which("lint-imports", path=str(Path(sys.executable).parent))
    assert tool, "lint-imports is not installed: sh setup.sh tests"
    done = subprocess.run([tool, "--no-cache"], cwd=folder, capture_output=True, text=True, check=False)
    found = {line.split(" BROKEN")[0].strip() for line in done.stdout.splitlines() if " BROKEN" in line}
    assert done.returncode == bool(found), done.stdout + done.stderr
    return found


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    for name in ("netconvert", "hid2", "bridge"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


def test_each_contract_fails_where_it_is_broken(copy: Path) -> None:
    assert broken(copy) == set()
    for file, line in PLANTED.values():
        with (copy / file).open("a") as stream:
            stream.write(f"\n{line}\n")
    assert broken(copy) == set(PLANTED)


def test_no_contract_is_without_a_planted_violation() -> None:
    text = (ROOT / "pyproject.toml").read_text()
    sections = text.split("[[tool.importlinter.contracts]]")[1:]
    assert {section.split('"')[1] for section in sections} == set(PLANTED)
