"""The engine's tasks on Dask's distributed scheduler: a local cluster of worker processes, or one that is running."""

# mypy: allow-untyped-calls

import contextlib
import itertools
import logging
import multiprocessing
import pickle
import queue
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any, cast

import dask
from distributed import Client, KilledWorker, LocalCluster, Worker, get_worker
from distributed.comm.addressing import parse_address, parse_host_port
from distributed.comm.registry import get_backend
from distributed.diagnostics.plugin import WorkerPlugin

from bridge.batch.engine import Outcome, Result, Settings, Task, new_process, run_task
from bridge.batch.isolation import Failure, IsolatedProcess
from netconvert.errors import BatchError, ConfigError

_PLUGIN = "hid2-scene-processes"
#: Tasks handed to the scheduler per worker: one that runs and one that is ready when it ends.
_AHEAD = 2
#: Seconds after which the number of workers is looked up again.
_LOOK_UP_S = 2.0
#: Seconds to reach a scheduler.
_CONNECT_S = 10
#: Seconds for which a scheduler may have no workers at all.
_WORKERS_S = 300.0
_NO_WORKERS = (
    "scheduler {where}: no workers for {seconds:g} s, expected some on each host: dask worker {where} --nthreads 1 "
    "(then go on with --resume)"
)
#: Of a local cluster: nobody looks at Dask's profiles and monitors, which wake up every process many times a second.
_OWN_CLUSTER = {
    "logging.distributed": "critical",
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.tick.cycle": "10s",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.scheduler.active-memory-manager.start": False,
    "distributed.client.scheduler-info-interval": "60s",
}
#: Tries to start a local cluster: a worker that is killed as it starts takes the cluster with it.
_STARTS = 3

_LOG = logging.getLogger(__name__)


def execute_on_dask(tasks: Iterable[Task], *, jobs: int, scheduler: str | None, settings: Settings) -> Iterator[Result]:
    """Yield results as they come; never more than a few tasks a worker are with the scheduler.

    Errors: BatchError when the scheduler cannot be reached or is lost.
    """
    waiting = iter(tasks)
    number = itertools.count()
    with _client(jobs, scheduler) as client:
        client.register_plugin(SceneProcesses(settings, own_cluster=scheduler is None), name=_PLUGIN)
        completed: queue.SimpleQueue[Any] = queue.SimpleQueue()
        running: dict[object, Task] = {}
        room, looked_up, staffed = 0, -_LOOK_UP_S, time.monotonic()
        where = scheduler or "of this machine"
        while True:
            now = time.monotonic()
            if now - looked_up >= _LOOK_UP_S:
                threads = sum(client.nthreads().values())
                if not threads and now - staffed >= _WORKERS_S:
                    raise BatchError(_NO_WORKERS.format(where=where, seconds=_WORKERS_S))
                if not threads and room == 0:
                    _LOG.warning("scheduler %s has no workers yet: waiting for %g s", where, _WORKERS_S)
                staffed = now if threads else staffed
                room, looked_up = _AHEAD * max(1, threads), now
            while len(running) < room and (task := next(waiting, None)) is not None:
                future = client.submit(_run_on_worker, _packed(task), key=f"{task.key}-{next(number)}-{time.time_ns()}")
                running[future.key] = task
                future.add_done_callback(completed.put)
            if not running:
                return
            with contextlib.suppress(queue.Empty):
                future = completed.get(timeout=_LOOK_UP_S)
                yield _result(future, running.pop(future.key), where)
                future.release()


def _result(future: Any, task: Task, where: str) -> Result:  # noqa: ANN401  # a Future, generic or not by release
    error = future.exception() if future.status == "error" else None
    if future.status == "finished":
        packed: Result = future.result()
        return Result(task, tuple(map(_unpacked, task.items, packed.outcomes)))
    if isinstance(error, KilledWorker):
        failure = Failure("killed", "its Dask worker died again and again", str(error))
        return Result(task, tuple(Outcome(item, None, failure, 1, 0.0) for item in task.items))
    reason = f"{type(error).__name__}: {error}" if error else f"task {future.status}"
    raise BatchError(f"scheduler {where}: {reason}") from error


def _packed(task: Task) -> Task:
    """The task as bytes: a Dask worker passes it on and need not import what is in it, which halves its memory."""
    items = tuple(pickle.dumps(item) for item in task.items)
    return Task(task.key, "bridge.batch.engine:run_packed", (task.function, pickle.dumps(task.shared)), items)


def _unpacked(item: Any, outcome: Outcome) -> Outcome:  # noqa: ANN401  # whatever the task's items are
    value = pickle.loads(outcome.value) if outcome.value is not None else None  # noqa: S301  # our own worker
    return replace(outcome, item=item, value=value)


def _run_on_worker(task: Task) -> Result:
    processes = cast(SceneProcesses, get_worker().plugins[_PLUGIN])
    return processes.run(task)


class SceneProcesses(WorkerPlugin):
    """Keeps the isolated processes of a Dask worker, one for each of its threads that is at work.

    own_cluster: the worker was started by this program and leaves Ctrl-C to it.
    """

    def __init__(self, settings: Settings, *, own_cluster: bool) -> None:
        self._settings = settings
        self._own_cluster = own_cluster
        self._idle: queue.SimpleQueue[IsolatedProcess] = queue.SimpleQueue()
        self._all: list[IsolatedProcess] = []

    def __reduce__(self) -> tuple[Callable[..., "SceneProcesses"], tuple[()]]:
        return partial(SceneProcesses, self._settings, own_cluster=self._own_cluster), ()

    def setup(self, worker: Worker) -> None:
        """Leave Ctrl-C, which a terminal sends to every process, to the program that started the cluster."""
        if self._own_cluster and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, signal.SIG_IGN)

    def teardown(self, worker: Worker) -> None:
        """End the processes with the worker."""
        for process in self._all:
            process.close()

    def run(self, task: Task) -> Result:
        """Run a task in an idle process, or in a new one."""
        try:
            process = self._idle.get_nowait()
        except queue.Empty:
            process = new_process(self._settings)
            self._all.append(process)
        try:
            return run_task(task, process, self._settings)
        finally:
            self._idle.put(process)


@contextlib.contextmanager
def _client(jobs: int, scheduler: str | None) -> Iterator[Client]:
    """Connect to the scheduler at an address, or to a cluster of `jobs` single-threaded processes started here."""
    for name in ("distributed", "tornado", "asyncio"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with contextlib.ExitStack() as stack:
        address: LocalCluster | str
        if scheduler is None:
            stack.enter_context(dask.config.set(_OWN_CLUSTER))
            address = stack.enter_context(_local_cluster(jobs))
        else:
            address = _checked(scheduler)
        try:
            client = stack.enter_context(Client(address, timeout=_CONNECT_S, set_as_default=False))
        except (OSError, ValueError) as error:
            raise BatchError(f"scheduler {scheduler}: cannot be reached ({error})") from error
        yield client


def _checked(scheduler: str) -> str:
    """The address. Errors: ConfigError for what Dask would fail to read as one, half way through."""
    try:
        protocol, location = parse_address(scheduler)
        get_backend(protocol)
        parse_host_port(location)
    except ValueError as error:
        raise ConfigError(f"scheduler {scheduler!r}: {error}, expected tcp://HOST:PORT") from error
    return scheduler


def _local_cluster(jobs: int) -> LocalCluster:
    _check_semaphores(jobs)
    for attempt in range(1, _STARTS + 1):
        try:
            return LocalCluster(
                n_workers=jobs,
                threads_per_worker=1,
                processes=True,
                memory_limit=0,
                dashboard_address=":0",
                silence_logs=logging.CRITICAL,
            )
        except RuntimeError as error:
            if attempt == _STARTS:
                raise BatchError(f"{jobs} Dask workers cannot be started on this machine ({error})") from error
    raise AssertionError


def _check_semaphores(jobs: int) -> None:
    """Dask's processes share semaphores, which Linux keeps in /dev/shm; its own message does not say so."""
    try:
        multiprocessing.get_context("spawn").Lock()
    except OSError as error:
        raise BatchError(
            f"{jobs} Dask workers cannot be started on this machine: no semaphores ({error.strerror or error}), expected a "
            "writable /dev/shm, or --jobs 1, which works without"
        ) from error
