"""The list of mutants is whole: each text is once in its file, what is there instead is Python, its tests exist."""

import ast
import runpy
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
SCRIPT = runpy.run_path(str(ROOT / "tests/benchmarks/mutants.py"))
MUTANTS: dict[str, Any] = SCRIPT["MUTANTS"]


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


def test_draw_is_that_of_its_seed_and_each_mutant_changes_its_file() -> None:
    drawn = SCRIPT["drawn"]("hid2/policy", 12, 0)
    assert len(drawn) == 12
    assert drawn == SCRIPT["drawn"]("hid2/policy", 12, 0)
    assert drawn.keys() != SCRIPT["drawn"]("hid2/policy", 12, 1).keys()
    for mutant in drawn.values():
        assert (ROOT / mutant.file).read_text(encoding="utf-8") == mutant.text
        assert ast.dump(ast.parse(mutant.instead)) != ast.dump(ast.parse(mutant.text))
