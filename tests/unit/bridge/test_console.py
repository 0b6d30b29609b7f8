"""Progress and messages: something is said every few seconds, and nothing when quiet."""

import time

import pytest

from bridge import console
from bridge.console import Activity, duration, fail, print_json, say, warn


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(console, "_FIRST_S", 0.3)
    monkeypatch.setattr(console, "_PLAIN_EVERY_S", 0.3)


def test_long_work_says_what_it_does_before_anything_is_counted(
    impatient: None, capsys: pytest.CaptureFixture[str]
) -> None:
    with Activity("starting", quiet=False) as activity:
        activity.doing("reading scenes")
        time.sleep(1.2)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) >= 2
    assert all(line.startswith("reading scenes, ") and line.endswith(" s so far") for line in lines)


def test_whoever_waits_hears_something_within_five_seconds() -> None:
    """Two lines lie 0.2 s further apart than asked for at most; starting the command takes up to 2 s before them."""
    assert console._FIRST_S + 2.0 + 0.2 < 5.0
    assert console._PLAIN_EVERY_S + 0.2 < 5.0


def test_counted_work_says_how_much_is_done_and_left(impatient: None, capsys: pytest.CaptureFixture[str]) -> None:
    """3 of 12 at half a scene a second: 18 s left."""
    with Activity(quiet=False) as activity:
        activity.doing("generating")
        activity.show(3, 12, 0.5, " (1 quarantined)")
        time.sleep(0.7)
    assert capsys.readouterr().err.splitlines()[0] == "generating: 3 of 12 (1 quarantined), 30.0/min, 18 s left"


def test_terminal_has_one_line_that_is_written_anew_and_cleared_for_messages_and_in_the_end(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """On a terminal of 20 columns, cut to 19; a message stands above it."""
    monkeypatch.setattr(console.sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "20")
    with Activity("generating", quiet=False) as activity:
        activity.show(1, 2, 0.0, " (3 complete before)")
        time.sleep(0.5)
        say("a message")
    *lines, end = capsys.readouterr().err.split("\r\x1b[K")
    assert set(lines) == {"", "generating: 1 of 2 ", "a message\n"}
    assert end == ""


def test_nothing_done_yet_has_no_rate(impatient: None, capsys: pytest.CaptureFixture[str]) -> None:
    with Activity("generating", quiet=False) as activity:
        activity.show(0, 3)
        time.sleep(0.7)
    assert capsys.readouterr().err.splitlines()[0] == "generating: 0 of 3"


def test_warnings_wrap_between_words_on_a_terminal_and_commands_to_copy_stay_whole(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    text = f"hid2: warning: {'word ' * 12}--no-break\n  to see it again: {'x ' * 20}"
    assert console.fitted(text) == text  # no terminal here
    monkeypatch.setattr(console.sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "40")
    first, second, third, command = console.fitted(text).split("\n")
    assert [len(line) <= 40 for line in (first, second, third)] == [True] * 3
    assert [line[:2] for line in (second, third)] == ["  ", "  "]
    assert "--no-break" in third
    assert command == f"  to see it again: {'x ' * 20}"


def test_quiet_says_messages_only(impatient: None, capsys: pytest.CaptureFixture[str]) -> None:
    with Activity("starting", quiet=True) as activity:
        activity.show(1, 2)
        activity.note("not needed")
        say("needed")
        time.sleep(0.7)
    assert capsys.readouterr().err == "needed\n"


@pytest.mark.parametrize("tell", [fail, warn])
def test_message_is_one_bounded_line_whatever_a_file_says(tell, capsys: pytest.CaptureFixture[str]) -> None:
    """No terminal obeys it, and no log is filled by it."""
    tell("x.toml: unknown key 'a\nb\x1b[2J\u202e" + "9" * 5000)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.isprintable()
    assert "x.toml: unknown key 'a b\\x1b[2J\\u202e999" in line
    assert len(line) <= 2000


def test_short_work_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with Activity("starting", quiet=False) as activity:
        activity.show(1, 1)
    assert capsys.readouterr().err == ""


def test_json_has_an_object_a_row(capsys: pytest.CaptureFixture[str]) -> None:
    print_json(("name", "n"), [("a", 1)])
    assert capsys.readouterr().out == '[\n {\n  "name": "a",\n  "n": 1\n }\n]\n'


@pytest.mark.parametrize(("seconds", "text"), [(59.4, "59 s"), (61, "1 min 01 s"), (3660, "1 h 01 min")])
def test_durations(seconds: float, text: str) -> None:
    assert duration(seconds) == text
