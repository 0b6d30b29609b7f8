"""Runs tasks, each in an isolated process: on this machine, or on the workers of a Dask scheduler that is named.

A task is the work on one source scene. A segfault, a kill or a hang ends its process, costs the item at hand one retry,
and leaves worker and scheduler alone. On this machine a worker is a thread that waits for its process. Where no process
can begin its work, the batch ends: the next scene would fail no less.
"""

import itertools
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from functools import partial
from pkgutil import resolve_name
from typing import Any, TypeVar

from bridge.batch.isolation import Failure, IsolatedProcess, Settings, StartFailedError, attempts
from bridge.files import one_line
from bridge.interruption import tidied
from netconvert.errors import BatchError

_Shared = TypeVar("_Shared")
_Item = TypeVar("_Item")
_Value = TypeVar("_Value")

#: Kinds of failure after which an item is tried again: the others would only repeat themselves.
_RETRIED = frozenset({"crashed", "killed", "timeout"})
#: What is called as items are done: how many are, and how many there are.
OnDone = Callable[[int, int], None] | None
#: Tasks handed out for each worker: one that runs and one that is ready when it ends.
AHEAD = 2


@dataclass(frozen=True, slots=True)
class Task:
    """Items of work that share something dear, such as a scene that has been read.

    function: "module:name" of a generator function that gets (shared, items) and yields one value per item, in order.
    """

    key: str
    function: str
    shared: Any
    items: tuple[Any, ...]


@dataclass(frozen=True, slots=True)
class TaskResult:
    """What became of one item: a value, or a failure: of its process, or yielded as one; seconds: its last attempt."""

    task: Task
    item: Any
    value: Any
    failure: Failure | None
    attempts: int
    seconds: float


def execute_here(
    tasks: Iterable[Task], *, jobs: int = 1, settings: Settings | None = None
) -> Generator[list[TaskResult], None, None]:
    """Yield the outcomes of every task as it is done; `tasks` is consumed as processes become free.

    When the caller goes away, by Ctrl-C or by closing the generator, the processes end with what they are at.
    Errors: BatchError when no process can begin its work.
    """
    settings = settings or Settings()
    processes = [IsolatedProcess(settings) for _ in range(jobs)]
    waiting, threads, idle = iter(tasks), ThreadPoolExecutor(jobs), [*processes]
    running: set[Future[list[TaskResult]]] = set()

    def run(task: Task) -> list[TaskResult]:
        process = idle.pop()  # there are as many as threads
        try:
            return run_task(task, process, settings)
        finally:
            idle.append(process)

    def stop() -> None:
        for process in processes:
            process.stop()

    try:
        with tidied(stop):
            while True:
                running |= {
                    threads.submit(run, task) for task in itertools.islice(waiting, AHEAD * jobs - len(running))
                }
                if not running:
                    return
                done, running = wait(running, return_when=FIRST_COMPLETED)
                for future in done:
                    yield future.result()
    finally:
        threads.shutdown(cancel_futures=True)
        for process in processes:
            process.close()


def work_on_each(
    work: Callable[[_Shared, _Item], _Value],
    items: Sequence[_Item],
    shared: _Shared,
    *,
    jobs: int,
    chunk: int,
    timeout_s: float,
    isolated: bool = True,
    on_item: OnDone = None,
) -> Generator[tuple[_Item, _Value | Failure], None, None]:
    """Yield every item with what a piece of work makes of it, or its failure, in the order of the items.

    work: a function of a module, which gets (shared, item); chunk: most items that a process gets at a time;
    timeout_s: for each item; isolated: False for work that needs no process of its own: one worker works here.
    on_item(done, total) is called when the caller is done with an item.
    """
    size = max(1, min(chunk, len(items) // (4 * jobs))) if isolated else chunk
    chunks = [tuple(items[start : start + size]) for start in range(0, len(items), size)]
    jobs = max(1, min(jobs, len(chunks)))
    named = f"{work.__module__}:{work.__qualname__}", shared
    if jobs <= 1 and not isolated:
        found: Iterable[tuple[_Item, _Value | Failure]] = zip(items, attempt_each(named, items), strict=True)
    else:
        name = f"{__name__}:{attempt_each.__name__}"
        tasks = (Task(str(number), name, named, part) for number, part in enumerate(chunks))
        found = _in_order(execute_here(tasks, jobs=jobs, settings=Settings(timeout_s=timeout_s)))
    for done, (item, value) in enumerate(found, 1):
        yield item, value
        if on_item is not None:
            on_item(done, len(items))


def attempt_each(named: tuple[str, Any], items: Sequence[Any]) -> Iterator[Any]:
    """What a function "module:name", imported first, makes of (shared, item) for each item, or its failure."""
    return attempts(partial(resolve_name(named[0]), named[1]), items)


def _in_order(results: Iterable[list[TaskResult]]) -> Iterator[tuple[Any, Any]]:
    """Items and values or failures of tasks with keys that count from 0."""
    waiting: dict[int, list[TaskResult]] = {}
    following = 0
    for outcomes in results:
        waiting[int(outcomes[0].task.key)] = outcomes
        while following in waiting:
            for outcome in waiting.pop(following):
                yield outcome.item, outcome.failure or outcome.value
            following += 1


def sorted_out(each: Iterable[tuple[_Item, _Value | Failure]]) -> tuple[list[_Value], list[tuple[_Item, str]]]:
    """The values of `work_on_each`, and the items that failed with the reason, each in order."""
    every = list(each)
    values = [value for _, value in every if not isinstance(value, Failure)]
    return values, [(item, value.message) for item, value in every if isinstance(value, Failure)]


def run_task(task: Task, process: IsolatedProcess, settings: Settings) -> list[TaskResult]:
    """Run the items of a task; after a failed process an item is tried again in a fresh one, then given up.

    Where the process was stopped, the rest has no outcomes. Errors: BatchError when no process can begin.
    """
    outcomes: list[TaskResult] = []
    attempts, failed_starts, began = 1, 0, time.monotonic()
    while len(outcomes) < len(task.items) and not process.stopped:
        try:
            for found in process.stream(task.function, task.shared, task.items[len(outcomes) :]):
                failure = found if isinstance(found, Failure) else None
                if failure and failure.kind in _RETRIED and (process.stopped or attempts <= settings.retries):
                    attempts += 1
                else:
                    item, seconds = task.items[len(outcomes)], time.monotonic() - began
                    outcomes.append(TaskResult(task, item, None if failure else found, failure, attempts, seconds))
                    attempts = 1
                failed_starts, began = 0, time.monotonic()
        except StartFailedError as error:
            failed_starts += 1
            may_pass = error.failure.kind in _RETRIED and failed_starts <= settings.retries
            if not (may_pass or process.stopped):
                raise BatchError(_no_start(error.failure)) from error
            began = time.monotonic()
    return outcomes


def _no_start(failure: Failure) -> str:
    """Why no process can begin, on one line: what it said, or the last that it wrote before it ended."""
    said = failure.details.strip().splitlines() if failure.kind in _RETRIED else []
    reason = f"{failure.message}: {said[-1]}" if said else failure.message
    return (
        f"no scene process can begin its work here ({one_line(reason, most=500)}); mend that and continue with --resume"
    )
