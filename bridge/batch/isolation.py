"""A process of its own for work that may crash: whatever happens there, the caller lives and knows what happened.

libsumo is native code and allows one simulation per process. A process is started once, serves many calls and is
replaced when its memory has grown, which is bounded (`memory_mb`); its temporary files go with it. Caller and process
talk over a pair of Unix sockets without a name: nothing listens, no other process can connect.
"""

import contextlib
import faulthandler
import gc
import logging
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pkgutil import resolve_name
from typing import Any, Literal, TypeVar

from bridge.files import disk_error
from netconvert.errors import Hid2Error

#: Seconds for a new process to import what the work needs, and to compile kernels that set-up has not compiled.
START_TIMEOUT_S = 600.0
#: Seconds that a process which ran out of time has to end itself before it is killed.
GRACE_S = 3.0
#: Memory of a process at the end of a call, MB, above which it is replaced before the next one.
MAX_RSS_MB = 600.0

_MB = 1_000_000
#: Bytes that are read of what a process wrote last, to tell why it ended: the stacks of a hang are a line a call.
_TAIL_BYTES = 100_000
#: Packages with messages that an isolated process passes on to its caller.
_PACKAGES = ("netconvert", "hid2", "bridge")
_LOG = logging.getLogger(__name__)
#: What faulthandler writes before it ends a process that ran out of time.
_RAN_OUT = re.compile(r"^Timeout \(\d+:\d\d:\d\d[.\d]*\)!$", re.MULTILINE)

_SERVE = "from bridge.batch.isolation import serve; serve()"
_ONE = "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "PYDANTIC_DISABLE_PLUGINS"

_Item = TypeVar("_Item")
_Value = TypeVar("_Value")

FailureKind = Literal["error", "exception", "crashed", "killed", "timeout", "memory", "disk"]


@dataclass(frozen=True, slots=True)
class Failure:
    """Why a piece of work has no result.

    kind: error (explained, `Hid2Error`), exception (unexpected), crashed (a signal of its own making or an exit),
    killed (SIGKILL from outside), timeout, memory (more than a process may take), disk (nothing can be written).
    details: traceback or the end of what the process wrote to stderr.
    """

    kind: FailureKind
    message: str
    details: str = ""


@dataclass(frozen=True, slots=True)
class Settings:
    """How items are run. timeout_s: for each; memory_mb: what its process may allocate (RLIMIT_DATA)."""

    timeout_s: float = 300.0
    retries: int = 1
    memory_mb: int = 4000


class StartFailedError(Exception):
    """The work did not begin: no process can be started, or the function cannot be imported there."""

    def __init__(self, failure: Failure) -> None:
        super().__init__(failure.message)
        self.failure = failure


class IsolatedProcess:
    """One child process that runs generator functions "module:function"; any thread may `stop` it, one the rest."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._lock = threading.RLock()  # `stop` may interrupt a thread that holds it
        self.stopped = False  # there will be no other process
        self._process: subprocess.Popen[bytes] | None = None
        self._open = contextlib.ExitStack()  # as long as there is a process
        self._sent: tuple[object, ...] = ()

    def stream(self, function: str, *arguments: object) -> Iterator[Any]:
        """Yield what `function(*arguments)` yields in the child; each value has `timeout_s` of its own.

        The last one is a `Failure` where the process dies or runs out of time, or the function raises. Debug messages
        are passed on. An argument that is the very object of the call before, as a table of all sources, is not sent
        again, so that functions change none of theirs. Errors: StartFailedError where the work does not begin.
        """
        if self._process is None or self._process.poll() is not None:
            self._start()
        sent = [None if new is old else (new,) for new, old in zip_longest(arguments, self._sent)][: len(arguments)]
        with contextlib.suppress(OSError):  # it has ended, as is found next
            self._connection.send((function, sent, self._settings.timeout_s, _LOG.isEnabledFor(logging.DEBUG)))
        self._sent = arguments
        kind, value = self._receive(START_TIMEOUT_S)
        if kind == "failed":
            raise StartFailedError(value)
        while kind in ("started", "value"):  # imported: the clock of the work starts here
            kind, value = self._receive(self._settings.timeout_s)
            if kind != "end":
                yield value
            elif value > MAX_RSS_MB:
                self.close()

    def stop(self) -> None:
        """End the process for good, whatever another thread waits for."""
        with self._lock:
            self.stopped = True
            if self._process is not None:
                self._process.kill()

    def close(self) -> None:
        """End the process and remove its temporary files; safe to call twice."""
        with self._lock:
            process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.wait()
        self._open.close()

    def _start(self) -> None:
        self.close()
        self._sent = ()
        here, there = Pipe(duplex=True)
        self._connection: Connection[Any, Any] = self._open.enter_context(here)
        try:
            with self._lock:
                if self.stopped:
                    raise StartFailedError(Failure("killed", "the process was closed"))
                scratch = self._open.enter_context(
                    tempfile.TemporaryDirectory(prefix="hid2-scene-", ignore_cleanup_errors=True)
                )
                self._stderr = self._open.enter_context(tempfile.TemporaryFile(dir=scratch))  # noqa: SIM115
                own = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "TMPDIR": scratch}
                command = [sys.executable, "-P", "-X", "faulthandler", "-c", _SERVE]
                self._process = subprocess.Popen(
                    [*command, str(there.fileno()), str(self._settings.memory_mb)],
                    stdin=subprocess.DEVNULL,
                    stdout=self._stderr,
                    stderr=self._stderr,
                    pass_fds=[there.fileno()],
                    env=os.environ | dict.fromkeys(_ONE, "1") | own,
                    start_new_session=True,  # Ctrl-C is for the caller, which then closes this process
                )
        except OSError as error:
            raise StartFailedError(
                Failure("exception", f"{error.filename or 'the system'}: {error.strerror}")
            ) from error
        finally:
            there.close()

    def _receive(self, timeout_s: float) -> tuple[str, Any]:
        """The next word of the process with its value, messages passed on; that it failed, and why, where it ends."""
        try:
            while self._connection.poll(timeout_s + GRACE_S):
                kind, value = self._connection.recv()
                if kind != "log":
                    return kind, value
                logging.getLogger(value[0]).log(value[1], "%s", value[2])
        except (EOFError, OSError):
            return "failed", self._end(None)
        return "failed", self._end(timeout_s)

    def _end(self, ran_out_of_s: float | None) -> Failure:
        """End what is left of the process and say how it ended; ran_out_of_s: the time that it had, if it took it."""
        process = self._process
        assert process is not None
        if ran_out_of_s is None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(timeout=GRACE_S)
        process.kill()
        code, written = process.wait(), os.fstat(self._stderr.fileno()).st_size
        details = os.pread(self._stderr.fileno(), _TAIL_BYTES, max(0, written - _TAIL_BYTES)).decode(errors="replace")
        self.close()
        if code == 1 and _RAN_OUT.search(details):
            ran_out_of_s = self._settings.timeout_s
        if ran_out_of_s is not None:
            return Failure("timeout", f"no result after {ran_out_of_s:g} s: the process was ended", details)
        if code == -signal.SIGKILL:
            return Failure("killed", "the process was killed (SIGKILL; out of memory, or from outside)", details)
        if code == -signal.SIGABRT and "bad_alloc" in details:  # native code that got no more memory
            return Failure("memory", _too_much(self._settings.memory_mb), details)
        if code < 0:
            named = {one.value: one.name for one in signal.Signals}  # not all are: cluster managers send others
            return Failure("crashed", f"the process crashed ({named.get(-code, f'signal {-code}')})", details)
        return Failure("crashed", f"the process exited with status {code}", details)


class _ToCaller(logging.Handler):
    """Passes messages on to the caller."""

    def __init__(self, connection: "Connection[Any, Any]") -> None:
        super().__init__()
        self._connection = connection

    def emit(self, record: logging.LogRecord) -> None:
        """One message."""
        self._connection.send(("log", (record.name, record.levelno, record.getMessage())))


def _log_to(connection: "Connection[Any, Any]", *, debug: bool) -> None:
    """Pass the packages' messages on, where the caller wants debug messages; else they go to stderr, as warnings do."""
    for package in _PACKAGES:
        logger = logging.getLogger(package)
        logger.handlers = [_ToCaller(connection)] if debug else []
        logger.propagate = not debug
        logger.setLevel(logging.DEBUG if debug else logging.NOTSET)


def serve() -> None:
    """Run in the child: answer calls until the caller goes away."""
    gc.set_threshold(5_000, 20, 20)  # a scene leaves little behind that only the collector can free
    connection: Connection[Any, Any] = Connection(int(sys.argv[1]))
    threading.Thread(target=_leave_with_parent, args=(os.getppid(),), daemon=True).start()
    _bound_memory(int(sys.argv[2]))
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    arguments = list[Any]()
    while True:
        try:
            function, sent, timeout_s, debug = connection.recv()
        except (EOFError, OSError):  # the caller is gone, and cannot remove this process's folder any more
            _remove_scratch()
            return
        arguments = [old if new is None else new[0] for new, old in zip_longest(sent, arguments)][: len(sent)]
        os.ftruncate(sys.stderr.fileno(), 0)
        os.lseek(sys.stderr.fileno(), 0, os.SEEK_SET)
        _log_to(connection, debug=debug)
        _answer(connection, function, arguments, timeout_s=timeout_s)


def _answer(connection: "Connection[Any, Any]", function: str, arguments: Sequence[Any], *, timeout_s: float) -> None:
    import psutil  # not for the caller

    # A C thread of faulthandler's own ends a hang even where native code holds the GIL, and shows where it hung.
    try:
        values = resolve_name(function)(*arguments)
        _make_kernels_ready(connection)
        if not gc.get_freeze_count():  # once: what a call leaves behind is to be found by the collector
            gc.freeze()  # what is imported by now is never free
        connection.send(("started", None))
        faulthandler.dump_traceback_later(timeout_s, exit=True)
        for value in values:
            faulthandler.cancel_dump_traceback_later()
            connection.send(("value", value))
            faulthandler.dump_traceback_later(timeout_s, exit=True)
        last: tuple[str, Any] = "end", psutil.Process().memory_info().rss / _MB
    except Exception as error:  # noqa: BLE001  # passed on to the caller, which decides
        last = "failed", describe_error(error)
    faulthandler.cancel_dump_traceback_later()
    connection.send(last)


def _make_kernels_ready(connection: "Connection[Any, Any]") -> None:
    """Compile what set-up has not, for work that has imported kernels: its clock has not started."""
    if "hid2.kernels.compiled" in sys.modules:
        from hid2.kernels.compile import make_ready

        make_ready(lambda said: connection.send(("log", (_LOG.name, logging.WARNING, said))))


def attempts(work: Callable[[_Item], _Value], items: Iterable[_Item]) -> Iterator[_Value | Failure]:
    """Yield what a function makes of each item, or its failure: one does not end the others."""
    for item in items:
        try:
            yield work(item)
        except Exception as error:  # noqa: BLE001  # told with its reason by the caller
            yield describe_error(error)


def describe_error(error: Exception) -> Failure:
    """Return an exception as a failure: a `Hid2Error` explains itself, anything else shows where it came from."""
    details = "".join(traceback.format_exception(error))
    if (full := disk_error(error)) is not None:
        said = f"{full.filename or 'the scene'}: cannot be written ({full.strerror})"
        return Failure("disk", str(error) if isinstance(error, Hid2Error) else said, details)
    if isinstance(error, MemoryError):
        bound = resource.getrlimit(resource.RLIMIT_DATA)[0]
        return Failure("memory", _too_much(bound // _MB if bound != resource.RLIM_INFINITY else None), details)
    if isinstance(error, Hid2Error):
        return Failure("error", str(error))
    return Failure("exception", f"{type(error).__name__}: {error}", details)


def _bound_memory(memory_mb: int) -> None:
    """Let an allocation beyond the bound fail (Linux; elsewhere the system may not go by it)."""
    hard, wanted = resource.getrlimit(resource.RLIMIT_DATA)[1], memory_mb * _MB
    resource.setrlimit(resource.RLIMIT_DATA, (wanted if hard == resource.RLIM_INFINITY else min(wanted, hard), hard))


def _too_much(memory_mb: int | None) -> str:
    bound = "there is" if memory_mb is None else f"the {memory_mb} MB a scene may take (hid2 generate --scene-memory)"
    return f"more memory than {bound}"


def _leave_with_parent(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(0.2)
    _remove_scratch()
    os._exit(1)


def _remove_scratch() -> None:
    """Remove this process's own folder, see IsolatedProcess; `tempfile` takes another one where it is gone already."""
    shutil.rmtree(os.environ["TMPDIR"], ignore_errors=True)
