"""Progress, messages and tables: something is said every few seconds, and nothing when quiet."""

import re
import time
from collections.abc import Sequence

import pytest

from bridge import console
from bridge.config import ParameterRow, describe_config
from bridge.console import Activity, duration, fail, print_table, say, table_lines, warn


class Clock:
    """Seconds that pass when a test says so."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


def looked_at(activity: Activity, clock: Clock, seconds: float) -> None:
    """So many seconds, with a look at each tenth."""
    end_s = clock.now_s + seconds
    while clock.now_s < end_s - 1e-6:
        clock.now_s += 0.1
        activity.look()


def test_in_a_pipe_a_first_line_comes_soon_and_then_one_every_half_minute(capsys: pytest.CaptureFixture[str]) -> None:
    """Two minutes of work: lines after 2, 32, 62 and 92 s; the command needs up to 2 s before it has a clock."""
    clock = Clock()
    activity = Activity(quiet=False, clock=clock)
    activity.doing("reading scenes")
    looked_at(activity, clock, 120.0)
    said = capsys.readouterr().err.splitlines()
    assert said == [f"hid2: reading scenes, {text} so far" for text in ("2 s", "32 s", "1 min 02 s", "1 min 32 s")]
    assert console.FIRST_S + 2.0 + 0.2 < 5.0


@pytest.mark.parametrize(("done", "left"), [(3, ", 18 s left"), (0, "")])
def test_counted_work_says_how_much_is_done_and_left(capsys: pytest.CaptureFixture[str], done: int, left: str) -> None:
    """3 of 12 in 6 s, half a scene a second: 18 s left; nothing done yet tells no time."""
    clock = Clock()
    activity = Activity(quiet=False, clock=clock)
    activity.doing("generating")
    clock.now_s += 6.0
    activity.show(done, 12, " (1 quarantined)")
    looked_at(activity, clock, 30.0)
    assert capsys.readouterr().err == f"hid2: generating: {done} of 12 (1 quarantined){left}\n"


def test_terminal_has_one_line_that_is_written_anew_and_cleared_for_messages_and_in_the_end(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """On a terminal of 20 columns, cut to 19; a message stands above it."""
    monkeypatch.setattr(console.sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "20")
    with Activity(quiet=False) as activity:
        activity.doing("generating")
        activity.show(1, 2, " (3 complete before)")
        time.sleep(0.5)
        say("a message")
    *lines, end = capsys.readouterr().err.split("\r\x1b[K")
    assert set(lines) == {"", "generating: 1 of 2 ", "hid2: a message\n"}
    assert end == ""


def test_quiet_says_messages_only_and_short_work_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with Activity(quiet=False) as short:
        short.show(1, 1)
    with Activity(quiet=True) as activity:
        activity.show(1, 2)
        activity.note("not needed")
        say("needed")
        time.sleep(0.3)
    assert capsys.readouterr().err == "hid2: needed\n"


@pytest.mark.parametrize("tell", [fail, warn])
def test_message_is_one_bounded_line_whatever_a_file_says(tell, capsys: pytest.CaptureFixture[str]) -> None:
    """No terminal obeys it, and no log is filled by it."""
    tell("x.toml: unknown key 'a\nb\x1b[2J\u202e" + "9" * 5000)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.isprintable()
    assert "x.toml: unknown key 'a b\\x1b[2J\\u202e999" in line
    assert len(line) <= 2000


@pytest.mark.parametrize(("seconds", "text"), [(59.4, "59 s"), (61, "1 min 01 s"), (3660, "1 h 01 min")])
def test_durations(seconds: float, text: str) -> None:
    assert duration(seconds) == text


# Tables: whatever the width, every value is there whole ---------------------------------------------------------------

WIDTHS = (60, 120, None)
BATCH = (
    "scene", "variant", "placed", "left_turn", "right_turn", "lane_change", "overtake", "manoeuvres", "s",
    "remarks",
)  # fmt: skip
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


def test_table_on_a_terminal_is_as_wide_as_that(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(console.sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "60")
    print_table("runs", BATCH, RUNS)
    assert capsys.readouterr().out.splitlines()[1:] == table_lines(BATCH, RUNS, width=60)


def test_numbers_are_aligned_right_and_words_left_and_a_pipe_gets_one_line_a_row() -> None:
    """Head, rule, two rows: the numbers 5 and 125 end at the same place."""
    lines = table_lines(BATCH, RUNS, width=None)
    assert len(lines) == 2 + len(RUNS)
    assert lines[2].endswith(str(RUNS[0][-1]))
    assert table_lines(("name", "n"), [("a", 5), ("long", 125)], width=80) == [
        "name    n", "---------", "a       5",
        "long  125",
    ]  # fmt: skip


def test_rows_are_stacked_where_columns_do_not_fit_and_floats_keep_their_digits() -> None:
    """-4.05 and 0.65 once came out as -4. and 0.6, and 123456.7 as 123457."""
    lines = table_lines(("a", "b", "c"), [(-4.05, 0.65, 123456.7)], width=25)
    assert words(lines).endswith("-4.05 0.65 123456.7")
    lines = table_lines(("scene", "first_long_name", "second_long_name"), [("x" * 20, 1, 2.5)], width=36)
    assert lines == ["x" * 20, "    first_long_name: 1", "    second_long_name: 2.5"]
