"""The list of mutants is whole: each text is once in its file, what is there instead is Python, its tests exist."""

import ast
import runpy
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
MUTANTS: dict[str, Any] = runpy.run_path(str(ROOT / "tests/benchmarks/mutants.py"))["MUTANTS"]


@pytest.mark.parametrize("name", MUTANTS)
def test_mutant_can_still_be_made(name: str) -> None:
    mutant = MUTANTS[name]
    source = (ROOT / mutant.file).read_text(encoding="utf-8")
    assert source.count(mutant.text) == 1
    mutated = ast.parse(source.replace(mutant.text, mutant.instead))
    assert ast.dump(mutated) != ast.dump(ast.parse(source))
    for test in mutant.tests:
        file, *names = test.split("::")
        assert all(name in (ROOT / file).read_text(encoding="utf-8") for name in names)
