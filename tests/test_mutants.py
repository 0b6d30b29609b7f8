"""The list of mutants is whole: each text is once in its file, what is there instead is Python, its tests exist.

Mutants that are drawn change one thing each, and only where numbers decide.
"""

import ast
import random
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


#: What a mutant may change, and what it may not.
SOURCE = '''"""Text of 1 line."""
#: Near, m. Not a
#: parameter.
_NEAR_M = 11.0
_SPARE_M: Annotated[float, 7] = 10.0
def over(s: float) -> bool:
    if s == -2:
        raise ValueError(f"{s + 1:.0f}", 3)
    return 0.0 <= s - 1 < _SPARE_M
'''


def test_what_is_drawn_from_are_comparisons_signs_and_numbers() -> None:
    """No text, annotation, error, or what is no parameter. 10 less or more 3, 2 and 1 less or more 1, 0 is 1."""
    found = {}
    for node in SCRIPT["below"](ast.parse(SOURCE), SOURCE.splitlines()):
        for kind, attribute, instead in SCRIPT["changes"](node, random.Random(0)):
            was, before = ast.unparse(node), getattr(node, attribute)
            setattr(node, attribute, instead)
            found.setdefault((kind, was), []).append(ast.unparse(node))
            setattr(node, attribute, before)
    numbers = {was: instead for (kind, was), instead in found.items() if kind == "number"}
    assert {was: instead for (_, was), instead in found.items() if was not in numbers} == {
        "s == -2": ["s != -2"], "-2": ["+2"], "s - 1": ["s + 1"],
        "0.0 <= s - 1 < _SPARE_M": ["0.0 < s - 1 < _SPARE_M", "0.0 <= s - 1 <= _SPARE_M"],
    }  # fmt: skip
    assert numbers.keys() == {"10.0", "2", "0.0", "1"}
    assert numbers["0.0"] == ["1.0"]
    assert all(numbers[was][0] in instead for was, instead in (("10.0", "7.0 13.0"), ("2", "1 3"), ("1", "0 2")))


def test_draw_is_that_of_its_seed_and_each_mutant_changes_its_file() -> None:
    drawn = SCRIPT["drawn"]("hid2/policy", 12, 0)
    assert len(drawn) == 12
    assert drawn == SCRIPT["drawn"]("hid2/policy", 12, 0)
    assert drawn.keys() != SCRIPT["drawn"]("hid2/policy", 12, 1).keys()
    for mutant in drawn.values():
        assert (ROOT / mutant.file).read_text(encoding="utf-8") == mutant.text
        assert ast.dump(ast.parse(mutant.instead)) != ast.dump(ast.parse(mutant.text))
