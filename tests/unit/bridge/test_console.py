"""Progress and messages: something is said every few seconds, and nothing when quiet."""

import time

import pytest

from bridge import console
from bridge.console import Activity, duration, fail, print_json, say, warn


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


def test_quiet_says_messages_only(capsys: pytest.CaptureFixture[str]) -> None:
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


def test_short_work_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with Activity(quiet=False) as activity:
        activity.show(1, 1)
    assert capsys.readouterr().err == ""


def test_json_has_an_object_a_row(capsys: pytest.CaptureFixture[str]) -> None:
    print_json(("name", "n"), [("a", 1)])
    assert capsys.readouterr().out == '[\n {\n  "name": "a",\n  "n": 1\n }\n]\n'


@pytest.mark.parametrize(("seconds", "text"), [(59.4, "59 s"), (61, "1 min 01 s"), (3660, "1 h 01 min")])
def test_durations(seconds: float, text: str) -> None:
    assert duration(seconds) == text
