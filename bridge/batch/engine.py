"""Runs tasks, each in an isolated process: one after the other, or on the workers of Dask's distributed scheduler.

A task is the work on one source scene. Every worker runs it in a process of its own (`isolation`), so that a
segfault, a kill or a hang ends that process, costs the item at hand one retry, and leaves worker and scheduler alone.
The death of a Dask worker itself is no scene's fault: the scheduler gives its task to another worker.
"""

import contextlib
import itertools
import pickle
import queue
import threading
import time
from collections.abc import Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from dataclasses import dataclass
from typing import Any

from bridge.batch.isolation import RECYCLE_AFTER, Failure, IsolatedProcess, WorkFailedError, resolve

#: Kinds of failure after which an item is tried again: the others would only repeat themselves.
_RETRIED = frozenset({"crashed", "killed", "timeout"})


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
class Outcome:
    """What became of one item: a value or a failure. seconds: the time of its last attempt."""

    item: Any
    value: Any
    failure: Failure | None
    attempts: int
    seconds: float


@dataclass(frozen=True, slots=True)
class Result:
    """What became of a task."""

    task: Task
    outcomes: tuple[Outcome, ...]


@dataclass(frozen=True, slots=True)
class Settings:
    """How items are run. timeout_s: for each item, a process that takes longer is ended; recycle_after: calls."""

    timeout_s: float = 300.0
    retries: int = 1
    recycle_after: int = RECYCLE_AFTER


def execute_here(
    tasks: Iterable[Task], *, jobs: int = 1, settings: Settings | None = None
) -> Generator[Result, None, None]:
    """As `execution.execute` on this machine, without Dask: for work that is over before its workers would start."""
    settings = settings or Settings()
    if jobs == 1:
        with contextlib.closing(new_process(settings)) as process:
            for task in tasks:
                yield run_task(task, process, settings)
        return
    stop = threading.Event()
    idle: queue.SimpleQueue[IsolatedProcess] = queue.SimpleQueue()
    processes = [new_process(settings) for _ in range(jobs)]

    def close() -> None:
        for process in processes:
            process.close()

    def run(task: Task) -> Result:
        mine = idle.get()
        try:
            return run_task(task, mine, settings, stop=stop)
        finally:
            idle.put(mine)

    for process in processes:
        idle.put(process)
    waiting = iter(tasks)
    with contextlib.ExitStack() as stack:
        stack.callback(close)
        pool = stack.enter_context(ThreadPoolExecutor(jobs))
        running = {pool.submit(run, task) for task in itertools.islice(waiting, 2 * jobs)}
        try:
            while running:
                done, running = wait(running, return_when=FIRST_COMPLETED)
                running |= {pool.submit(run, task) for task in itertools.islice(waiting, len(done))}
                for future in done:
                    yield future.result()
        finally:
            stop.set()
            for future in running:
                future.cancel()
            close()  # ends what the threads wait for


def new_process(settings: Settings) -> IsolatedProcess:
    """Return a process for run_task; it starts with its first task."""
    return IsolatedProcess(timeout_s=settings.timeout_s, recycle_after=settings.recycle_after)


def run_task(
    task: Task, process: IsolatedProcess, settings: Settings, *, stop: threading.Event | None = None
) -> Result:
    """Run the items of a task; one whose process fails is tried again in a fresh one, then given up.

    stop: when it is set, a process that ends is not replaced: the rest of the task has no outcomes.
    """
    outcomes: list[Outcome] = []
    attempts, began = 1, time.monotonic()
    while len(outcomes) < len(task.items):
        remaining = task.items[len(outcomes) :]
        try:
            for value in process.stream(task.function, task.shared, remaining):
                outcomes.append(_outcome(task, outcomes, value, None, attempts, began))
                attempts, began = 1, time.monotonic()
            failure = Failure("exception", f"{task.function} yielded nothing for {len(remaining)} items")
        except WorkFailedError as error:
            failure = error.failure
        if len(outcomes) == len(task.items) or (stop is not None and stop.is_set()):
            break
        if failure.kind in _RETRIED and attempts <= settings.retries:
            attempts += 1
        else:
            outcomes.append(_outcome(task, outcomes, None, failure, attempts, began))
            attempts = 1
        began = time.monotonic()
    return Result(task, tuple(outcomes))


def _outcome(
    task: Task, done: list[Outcome], value: object, failure: Failure | None, attempts: int, began: float
) -> Outcome:
    return Outcome(task.items[len(done)], value, failure, attempts, time.monotonic() - began)


def run_packed(shared: tuple[str, bytes], items: Sequence[bytes]) -> Iterator[bytes]:
    """The work of an isolated process under a caller that passes bytes on: unpack, run, pack what comes."""
    function, packed = shared
    values = resolve(function)(pickle.loads(packed), tuple(map(pickle.loads, items)))  # noqa: S301  # our own caller
    return map(pickle.dumps, values)
