"""Tables: whatever the width, every value is there whole."""

import re
from collections.abc import Sequence

import pytest

from bridge.config import ParameterRow, describe_config
from bridge.console import table_lines

WIDTHS = (60, 80, 120, 200, None)
BATCH = (
    "scene",
    "variant",
    "placed",
    "left_turn",
    "right_turn",
    "lane_change",
    "overtake",
    "manoeuvres",
    "s",
    "remarks",
)
NOT_DONE = "not done: left_turn: map_offers_no_left_turn (1), right_turn: map_offers_no_right_turn (1)"
RUNS = [
    ("2112b63e-58e4-5604-a86c-b243689827da", 0, "0 of 14", 0, 0, 2, 0, "2 of 4", 65.21, NOT_DONE),
    ("bf8c5e9d-76de-5c6f-a44b-69cc2c9a318a", 10, "10 of 10", 1, 1, 2, 0, "4 of 4", -4.05, "-"),
]


def words(lines: Sequence[str]) -> str:
    return " ".join(" ".join(lines).split())


def shown(lines: Sequence[str], text: str) -> bool:
    """Whether all words of a value are there, unbroken; they may be on several lines."""
    there = re.split(r"\s+", " ".join(lines))
    return all(word in there for word in text.split())


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize(
    ("columns", "rows"), [(BATCH, RUNS), (ParameterRow._fields, describe_config())], ids=["batch", "config"]
)
def test_no_value_is_cropped_and_no_line_is_too_long(
    columns: Sequence[str], rows: Sequence[Sequence[object]], width: int | None
) -> None:
    lines = table_lines(columns, rows, width=width)
    for row in rows:
        for cell in row:
            assert shown(lines, str(cell)), cell
    if width is not None:
        assert max(map(len, lines)) <= width


def test_a_pipe_gets_one_line_a_row() -> None:
    lines = table_lines(BATCH, RUNS, width=None)
    assert len(lines) == 2 + len(RUNS)
    assert lines[2].endswith(str(RUNS[0][-1]))


def test_numbers_are_aligned_right_and_words_left() -> None:
    """Head, rule, two rows: the numbers 5 and 125 end at the same place."""
    assert table_lines(("name", "n"), [("a", 5), ("long", 125)], width=80) == [
        "name    n",
        "---------",
        "a       5",
        "long  125",
    ]


def test_text_wraps_between_words_where_that_is_enough() -> None:
    lines = table_lines(("key", "what it is"), [("a", "one two three four five six")], width=25)
    assert lines == ["key  what it is", "-" * 25, "a    one two three four", "     five six"]


def test_rows_are_stacked_where_columns_do_not_fit() -> None:
    lines = table_lines(("scene", "first_long_name", "second_long_name"), [("x" * 20, 1, 2.5)], width=36)
    assert lines == ["x" * 20, "    first_long_name: 1", "    second_long_name: 2.5"]


def test_floats_keep_their_digits() -> None:
    """-4.05 and 0.65 once came out as -4. and 0.6, and 123456.7 as 123457."""
    lines = table_lines(("a", "b", "c"), [(-4.05, 0.65, 123456.7)], width=25)
    assert words(lines).endswith("-4.05 0.65 123456.7")
