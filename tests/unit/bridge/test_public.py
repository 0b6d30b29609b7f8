"""The public interface: one list, loaded when used, with types that a user's checker sees."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import bridge

SOURCE = Path(bridge.__file__)


@pytest.mark.parametrize("name", bridge.__all__)
def test_public_name_is_there_with_a_docstring(name: str) -> None:
    assert getattr(bridge, name).__doc__


def test_type_checkers_are_told_the_same_names_and_homes_and_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = bridge.nothing  # type: ignore[attr-defined]
    block = next(node for node in ast.parse(SOURCE.read_text()).body if isinstance(node, ast.If))
    told = {
        alias.asname: node.module for node in block.body if isinstance(node, ast.ImportFrom) for alias in node.names
    }
    assert told == bridge._HOMES


@pytest.mark.slow
def test_types_are_seen_outside_the_checkout(tmp_path: Path) -> None:
    """A type checker follows the editable install: it reveals the type of a position and finds a mistake."""
    (tmp_path / "use.py").write_text(
        "from pathlib import Path\nfrom bridge import load_config, read_scene\n"
        "reveal_type(read_scene(Path()).recording.tracks[0].position)\nload_config().request.seed + 'a'\n"
    )
    command = [Path(sys.executable).parent / "mypy", "--config-file=", "--strict", "--cache-dir", "cache", "use.py"]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=500, check=False)
    assert 'use.py:3: note: Revealed type is "numpy.ndarray[' in result.stdout, result.stdout
    assert "use.py:4: error: Unsupported operand types" in result.stdout
