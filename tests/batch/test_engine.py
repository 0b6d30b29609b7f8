"""Work on this machine: every task once, faults cost their item, and no process is left behind."""

import contextlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from processes import still_running

from bridge.batch.batch import GENERATE
from bridge.batch.engine import Task, execute_here, run_task, work_on_each
from bridge.batch.isolation import Failure, FailureKind, Settings
from netconvert.errors import BatchError

TASKS = [Task(f"t{k}", "faults:numbers", "", (10 * k, 10 * k + 1)) for k in range(6)]


@pytest.mark.parametrize("jobs", [1, 2])
def test_each_item_comes_with_its_value_or_failure_in_its_place_whatever_is_done_first(jobs: int) -> None:
    """Fourteen items, chunks of three for one worker and of one for two: the slow one is done after those behind it."""
    from faults import number

    items = [0, "slow", *range(2, 9), "segfault", *range(10, 14)]
    each = list(work_on_each(number, items, "s", jobs=jobs, chunk=3, timeout_s=30))
    assert [item for item, _ in each] == items
    kinds = [found.kind if isinstance(found, Failure) else found[:2] for _, found in each]
    assert kinds == [{"slow": "exception", "segfault": "crashed"}.get(item, ("s", item)) for item in items]  # type: ignore[call-overload]


@pytest.mark.parametrize(("jobs", "count", "is_here"), [(1, 9, True), (2, 4, True), (2, 9, False)])
def test_work_that_needs_no_process_is_done_here_unless_several_share_it(jobs: int, count: int, is_here: bool) -> None:
    from faults import number

    each = work_on_each(number, range(count), "s", jobs=jobs, chunk=4, timeout_s=30, isolated=False)
    assert {found[2] == os.getpid() for _, found in each if not isinstance(found, Failure)} == {is_here}
    assert list(work_on_each(number, [], "s", jobs=jobs, chunk=4, timeout_s=30)) == []


def test_processes_listen_to_nothing_and_end_when_the_results_are_not_wanted_any_more() -> None:
    """They talk over pairs of sockets that have no name."""
    before = set(psutil.Process().children(recursive=True))  # other tests leave a resource tracker running
    heard = set(psutil.Process().net_connections(kind="inet"))
    tasks = [TASKS[0], *(Task(f"hang{k}", "faults:numbers", "", ("hang", 1)) for k in range(4))]
    with contextlib.closing(execute_here(tasks, jobs=2, settings=Settings(timeout_s=60.0))) as results:
        assert next(results)[0].task.key == "t0"
        children = [child for child in psutil.Process().children(recursive=True) if child not in before]
        assert len(children) == 2
        family = [psutil.Process(), *children]
        assert [c for process in family for c in process.net_connections(kind="inet") if c not in heard] == []
    assert still_running(children, timeout_s=10) == []


@pytest.mark.parametrize(
    ("module", "text", "said"),
    [
        ("nowhere", None, r".*ModuleNotFoundError: No module named 'nowhere'"),
        ("broken", "import os, sys\nprint('no f', file=sys.stderr)\nos._exit(127)", r".*status 127: no f\)"),
        ("libsumo", "TraCIException = FatalTraCIError = Exception", ".*not SUMO's libsumo, rename it or move it away"),
    ],
)
def test_work_that_cannot_be_imported_ends_the_batch_with_its_cause_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str, text: str | None, said: str
) -> None:
    """A module that is not there, one that ends its process as a broken native library does, one in SUMO's place."""
    if text is not None:
        (tmp_path / f"{module}.py").write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    function, began = GENERATE if module == "libsumo" else f"{module}:work", time.monotonic()
    with pytest.raises(BatchError, match=f"no scene process can begin {said}"):
        list(execute_here([Task("t", function, "", (1, 2))], jobs=2))
    assert time.monotonic() - began < 60, "it is no time-out"


@pytest.mark.parametrize(
    ("program", "said"), [("/bin/false", "exited with status 1"), ("/nowhere/python", "No such file")]
)
def test_process_that_does_not_start_ends_the_batch(monkeypatch: pytest.MonkeyPatch, program: str, said: str) -> None:
    monkeypatch.setattr(sys, "executable", program)
    with pytest.raises(BatchError, match=f"no scene process can begin .*{said}"):
        list(execute_here(TASKS))


def test_temporary_files_of_a_process_go_with_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where it ran out of time in the middle, and had no chance to remove them itself."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    ((outcome,),) = execute_here(
        [Task("t", "faults:leaves_files", "", ("hang",))], settings=Settings(timeout_s=1.0, retries=0)
    )
    assert outcome.failure is not None
    assert outcome.failure.kind == "timeout"
    assert list(tmp_path.rglob("*")) == []


class _Failing:
    """A process in which every call ends with one kind of failure."""

    stopped = False

    def __init__(self, kind: FailureKind) -> None:
        self.kind, self.calls = kind, 0

    def stream(self, _function: str, *_arguments: object) -> Iterator[object]:
        self.calls += 1
        yield Failure(self.kind, "said")


@pytest.mark.parametrize(
    ("kind", "calls"),
    [("crashed", 3), ("killed", 3), ("timeout", 3), ("error", 1), ("exception", 1), ("memory", 1), ("disk", 1)],
)
def test_only_failures_that_may_pass_are_tried_again(kind: FailureKind, calls: int) -> None:
    """With two retries: what a machine may do to a process gets them, what the work would do again does not."""
    process = _Failing(kind)
    outcomes = run_task(Task("a", "faults:numbers", "", (1,)), process, Settings(retries=2))  # type: ignore[arg-type]
    assert process.calls == calls
    assert [(one.failure.kind, one.attempts) for one in outcomes if one.failure] == [(kind, calls)]


_GENERATE = """
import json, sys
from bridge.cli import main
sys.argv = ["hid2", "generate", {folder!r}, "--agents", "1", "-o", {out!r}, "-q"]
try:
    main()
finally:
    print(json.dumps([name for name in {heavy!r} if name in sys.modules]))
"""
#: What only scene processes need, and is slow to import.
_HEAVY = ["distributed", "libsumo", "matplotlib", "numba", "numpy", "pandas", "pyarrow", "rich", "scipy", "shapely"]


def test_command_leaves_what_is_slow_to_import_to_the_scene_process(
    data_scenes: dict[str, Path], tmp_path: Path
) -> None:
    script = _GENERATE.format(folder=str(data_scenes["curve"]), out=str(tmp_path / "out"), heavy=_HEAVY)
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == []
