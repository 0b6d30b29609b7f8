"""An isolated process survives nothing and endangers nobody."""

import contextlib
import logging
import os
import signal
import subprocess
import sys
from collections.abc import Iterator

import psutil
import pytest
from processes import PATH_OF_FAULTS, still_running

from bridge.batch.isolation import IsolatedProcess, Settings


@pytest.fixture(scope="module")
def process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[IsolatedProcess]:
    """One for all tests, which starts again where one has ended it; it works in a folder of its own."""
    with (
        contextlib.chdir(tmp_path_factory.mktemp("isolated")),
        contextlib.closing(IsolatedProcess(Settings(timeout_s=5.0))) as made,
    ):
        yield made


def pid_of(process: IsolatedProcess) -> int:
    assert process._process is not None
    return process._process.pid


def test_collector_leaves_out_what_is_imported_and_nothing_that_calls_leave(process: IsolatedProcess) -> None:
    """Else what a scene leaves behind in cycles would stay for good."""
    first, second, third = (count for _ in range(3) for count in process.stream("faults:left_out"))
    assert first >= second >= third > 0  # some of it is freed all the same


@pytest.mark.parametrize(("fault", "kind", "words"), [
    ("segfault", "crashed", "SIGSEGV"), ("sumo", "crashed", "SIGSEGV"), ("killed", "killed", "SIGKILL"),
    ("exit", "crashed", "status 3"), ("hang", "timeout", "5 s"), ("deep", "timeout", "5 s"),
    ("signal", "crashed", "(signal 40)"), ("raise", "exception", "RuntimeError: fault raise"),
    ("memory", "memory", "more memory than the 4000 MB a scene may take (hid2 generate --scene-memory)"),
    ("full", "disk", "scenario.parquet: cannot be written (No space left on device)"),
])  # fmt: skip
def test_failure_says_how_the_process_ended(process: IsolatedProcess, fault: str, kind: str, words: str) -> None:
    first, failure = process.stream("faults:numbers", "", (1, fault, 2))
    assert first[1] == 1
    assert failure.kind == kind
    assert words in failure.message
    if fault not in ("killed", "exit", "signal"):
        assert "faults.py" in failure.details, "the traceback of the child is kept"
    assert [one for _, one, _ in process.stream("faults:numbers", "", (4,))] == [4], "the next call has a process again"


def test_what_is_done_before_the_work_begins_is_told(
    process: IsolatedProcess, caplog: pytest.LogCaptureFixture
) -> None:
    """The first run of a wheel compiles kernels for a minute: it says so, and it does not count as the work's time."""
    assert list(process.stream("faults:compiles", "", (1, 2))) == [1, 2]
    assert caplog.messages == ["compiling 42 functions, which takes a minute"]


def test_process_that_ended_itself_in_time_ran_out_of_it_whatever_the_callers_clock_says(
    process: IsolatedProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a busy machine the caller begins to wait after the process has begun to work: it is no crash all the same."""
    list(process.stream("faults:numbers", "", (1,)))
    monkeypatch.setattr("bridge.batch.isolation.time.monotonic", lambda: 0.0)
    (failure,) = process.stream("faults:numbers", "", ("hang",))
    assert failure.kind == "timeout"


def test_stopped_process_is_killed_after_its_time(process: IsolatedProcess) -> None:
    """SIGSTOP freezes the child's own watchdog too: the caller's ends it."""
    list(process.stream("faults:numbers", "", (1,)))
    stream = process.stream("faults:numbers", "", (1, "hang"))
    next(stream)
    os.kill(pid_of(process), signal.SIGSTOP)
    assert next(stream).kind == "timeout"


def test_child_leaves_when_its_caller_is_killed(tmp_path) -> None:
    script = (
        "import time\n"
        "from bridge.batch.isolation import IsolatedProcess, Settings\n"
        "p = IsolatedProcess(Settings(timeout_s=60))\n"
        "list(p.stream('faults:numbers', '', (1,)))\n"
        "print(p._process.pid, flush=True)\n"
        "time.sleep(60)\n"
    )
    environment = os.environ | {"TMPDIR": str(tmp_path), "PYTHONPATH": PATH_OF_FAULTS}
    caller = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True, env=environment)
    assert caller.stdout is not None
    child = psutil.Process(int(caller.stdout.readline()))
    caller.kill()
    caller.communicate()
    assert still_running([child], timeout_s=30) == []
    assert list(tmp_path.iterdir()) == [], "it takes its temporary files along"


def test_debug_messages_of_the_child_are_the_callers_where_it_wants_them(
    process: IsolatedProcess, caplog: pytest.LogCaptureFixture
) -> None:
    for level in (logging.DEBUG, logging.INFO):
        with caplog.at_level(level, logger="bridge"), caplog.at_level(logging.DEBUG, logger="hid2"):
            assert list(process.stream("faults:talkative", "scene", (1, 2))) == [1, 2]
        heard = [record.getMessage() for record in caplog.records if record.name == "hid2.insertion.filling"]
        assert heard == ["scene: 1", "scene: 2"], "nothing at the second level"


class Table:
    """Reads as (7,) in another process, and counts how often it is sent."""

    sent = 0

    def __reduce__(self) -> tuple[type[tuple[int]], tuple[tuple[int]]]:
        """As pickle has it."""
        Table.sent += 1
        return tuple, ((7,),)


def test_argument_of_the_call_before_is_sent_again_to_a_new_process_alone(process: IsolatedProcess) -> None:
    table = Table()
    assert [list(process.stream("itertools:chain", table, (n,))) for n in (1, 2)] == [[7, 1], [7, 2]]
    assert Table.sent == 1
    process.close()
    assert list(process.stream("itertools:chain", table)) == [7]
    assert list(process.stream("itertools:chain", (8,), table)) == [8, 7]
    assert list(process.stream("itertools:chain", (9,))) == [9]
    assert Table.sent == 3
    for unsent in [(n for n in ())] * 2:
        with pytest.raises(TypeError, match="cannot pickle"):
            list(process.stream("itertools:chain", unsent))
