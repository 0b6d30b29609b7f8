"""The engine's tasks on the workers of a Dask scheduler that is running; nothing is started, nothing listens here.

What goes to a scheduler and comes back are pickles: scheduler and workers are trusted (SECURITY.md).
"""

# mypy: allow-untyped-calls

import atexit
import contextlib
import functools
import itertools
import logging
import re
import threading
from collections.abc import Generator, Iterable, Iterator
from concurrent.futures import CancelledError
from dataclasses import fields
from typing import Any

from distributed import Client, KilledWorker, Security, wait

from bridge.batch.engine import AHEAD, Task, TaskResult, run_task
from bridge.batch.isolation import Failure, IsolatedProcess, Settings
from netconvert.errors import BatchError, ConfigError, Hid2Error

#: Seconds to reach a scheduler.
_CONNECT_S = 10
#: Seconds for which a scheduler may have no workers at all.
_WORKERS_S = 300.0
_NO_WORKERS = (
    "scheduler {where}: no workers for {seconds:g} s, expected some on each host: dask worker {where} --nthreads 1 "
    "(then go on with --resume)"
)
_TLS = "expected Dask's settings distributed.comm.tls.ca-file, .client.cert and .client.key (bridge/batch/README.md)"

#: Loggers of messages that errors say instead.
_LOGGERS = ("distributed", "tornado", "asyncio")

_LOG = logging.getLogger(__name__)


def execute_on_dask(
    tasks: Iterable[Task], *, scheduler: str, settings: Settings
) -> Generator[list[TaskResult], None, None]:
    """Yield the outcomes of tasks as they come; never more than a few tasks a worker are with the scheduler.

    Errors: BatchError when the scheduler cannot be reached or is lost.
    """
    waiting = iter(tasks)
    how = Settings(*(getattr(settings, one.name) for one in fields(Settings)))  # what a worker can look up
    with _client(scheduler) as client, _explained(scheduler):
        if not client.nthreads():
            _LOG.warning("scheduler %s has no workers yet: waiting for %g s", scheduler, _WORKERS_S)
        running: dict[Any, Task] = {}
        while True:
            with contextlib.suppress(TimeoutError):
                client.wait_for_workers(1, timeout=_WORKERS_S)
            if not (threads := sum(client.nthreads().values())):
                raise BatchError(_NO_WORKERS.format(where=scheduler, seconds=_WORKERS_S))
            for task in itertools.islice(waiting, max(0, AHEAD * threads - len(running))):
                running[client.submit(_run_on_worker, task, how, pure=False)] = task
            if not running:
                return
            done: Any = ()
            with contextlib.suppress(TimeoutError), client.as_current():
                done = wait(list(running), timeout=_WORKERS_S, return_when="FIRST_COMPLETED").done
            for future in done:
                yield _outcomes(future, running.pop(future))
                future.release()


def _outcomes(future: Any, task: Task) -> list[TaskResult]:  # noqa: ANN401  # a Future, generic or not by release
    try:
        found: list[TaskResult] = future.result()
    except KilledWorker as error:
        failure = Failure("killed", "its Dask worker died again and again", str(error))
        return [TaskResult(task, item, None, failure, 1, 0.0) for item in task.items]
    return found


@contextlib.contextmanager
def _explained(where: str) -> Iterator[None]:
    """What Dask raises, as when its scheduler goes away, as one line. Errors: BatchError, and what a task raises."""
    try:
        yield
    except Hid2Error:
        raise
    except (Exception, CancelledError) as error:
        raise BatchError(f"scheduler {where}: lost ({type(error).__name__}: {error})") from error


@functools.cache
def _process(settings: Settings, _thread: int) -> IsolatedProcess:
    """The isolated process of a thread of this Dask worker, which ends with it."""
    found = IsolatedProcess(settings)
    atexit.register(found.stop)
    return found


def _run_on_worker(task: Task, settings: Settings) -> list[TaskResult]:
    return run_task(task, _process(settings, threading.get_ident()), settings)


@contextlib.contextmanager
def _client(scheduler: str) -> Iterator[Client]:
    """Connect to the scheduler at an address; what Dask would log is said by errors instead.

    Errors: ConfigError for what is no address or has no certificates, BatchError where nothing answers there.
    """
    for name in (*_LOGGERS, *logging.root.manager.loggerDict):  # Dask sets levels of its modules one by one
        if name.partition(".")[0] in _LOGGERS:
            logging.getLogger(name).setLevel(logging.CRITICAL)
    if not re.fullmatch(r"(tls|tcp)://\S+:\d+", scheduler):  # before Dask makes half a client of it
        raise ConfigError(f"scheduler {scheduler!r}: no address, expected tls://HOST:PORT or tcp://HOST:PORT")
    try:
        if scheduler.startswith("tls") and Security().get_connection_args("client").get("ssl_context") is None:
            raise ConfigError(f"scheduler {scheduler!r}: no certificates for it, {_TLS}")
        client = Client(scheduler, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        way_out = f", {_TLS}" if scheduler.startswith("tls") else ""
        raise BatchError(f"scheduler {scheduler}: cannot be reached ({error}){way_out}") from error
    with client:
        yield client
