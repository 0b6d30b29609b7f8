"""A process of its own for work that may crash: whatever happens there, the caller lives and knows what happened.

libsumo is native code and allows one simulation per process, so scenes run in such processes: a segfault, a kill or
a hang costs the process and nothing else. The process is started once, serves many calls and is replaced after
`recycle_after` of them, or when its memory has grown.
"""

import contextlib
import faulthandler
import gc
import importlib
import itertools
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import IO, Any, Literal

from netconvert.errors import Hid2Error

#: Seconds for a new process to import what the work needs, and to compile kernels that set-up has not compiled.
START_TIMEOUT_S = 600.0
#: Seconds that a process which ran out of time has to end itself before it is killed.
GRACE_S = 3.0
#: Calls after which a process is replaced.
RECYCLE_AFTER = 1000
#: A process larger than this is replaced before its next call.
MAX_RSS_MB = 600.0
#: Objects made between two collections of the young ones, and young ones between two of the older (gc.set_threshold).
_COLLECT = (5_000, 20, 20)

_SERVE = "from bridge.batch.isolation import serve; serve()"
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
#: pydantic would ask every installed distribution whether it has a plugin.
_NO_PLUGINS = {"PYDANTIC_DISABLE_PLUGINS": "1"}

FailureKind = Literal["error", "exception", "crashed", "killed", "timeout"]


@dataclass(frozen=True, slots=True)
class Failure:
    """Why a piece of work has no result.

    kind: error (explained, `Hid2Error`), exception (unexpected), crashed (a signal of its own making or an exit),
    killed (SIGKILL from outside), timeout. details: traceback or the end of what the process wrote to stderr.
    """

    kind: FailureKind
    message: str
    details: str = ""


class WorkFailedError(Exception):
    """The work has no result: it raised an exception, or its process ended before it answered."""

    def __init__(self, failure: Failure) -> None:
        super().__init__(failure.message)
        self.failure = failure


class IsolatedProcess:
    """One child process that runs generator functions named "module:function" and passes on what they yield."""

    def __init__(self, *, timeout_s: float, recycle_after: int = RECYCLE_AFTER) -> None:
        self._timeout_s = timeout_s
        self._recycle_after = recycle_after
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: Connection[Any, Any] | None = None
        self._stderr: IO[bytes] | None = None
        self._calls = 0
        self._rss_mb = 0.0

    @property
    def pid(self) -> int | None:
        """Process id, None while there is no process."""
        return self._process.pid if self._process else None

    @property
    def rss_mb(self) -> float:
        """Resident memory of the process after its last call, MB."""
        return self._rss_mb

    def stream(self, function: str, *arguments: object) -> Iterator[Any]:
        """Yield what `function(*arguments)` yields in the child; each value has `timeout_s` of its own.

        Raises WorkFailedError when the process dies or runs out of time, or the function raises.
        """
        if self._calls >= self._recycle_after or self._rss_mb > MAX_RSS_MB:
            self.close()
        if self._process is None or self._process.poll() is not None:
            self._start()
        assert self._connection is not None
        self._calls += 1
        try:
            self._connection.send_bytes(pickle.dumps((function, arguments, self._timeout_s)))
        except OSError as error:
            raise WorkFailedError(self._end(timed_out=False)) from error
        self._receive(START_TIMEOUT_S)  # imported: the clock of the work starts here
        while True:
            kind, value, self._rss_mb = self._receive(self._timeout_s)
            if kind == "end":
                return
            if kind == "raised":
                raise WorkFailedError(value)
            yield value

    def close(self) -> None:
        """End the process; safe to call twice."""
        process, self._process = self._process, None
        if process is not None:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            process.wait()
        if self._connection is not None:
            self._connection.close()
            self._connection = None
        if self._stderr is not None:
            self._stderr.close()
            self._stderr = None

    def _start(self) -> None:
        self.close()
        here, there = Pipe(duplex=True)
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115  # closed in close()
        environment = os.environ | _ONE_THREAD | _NO_PLUGINS | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        command = [sys.executable, "-P", "-X", "faulthandler", "-c", _SERVE, str(there.fileno())]
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=self._stderr,
            stderr=self._stderr,
            pass_fds=[there.fileno()],
            env=environment,
            start_new_session=True,  # Ctrl-C is for the caller, who then closes this process
        )
        there.close()
        self._connection = here
        self._calls = 0
        self._receive(START_TIMEOUT_S)

    def _receive(self, timeout_s: float) -> tuple[str, Any, float]:
        assert self._connection is not None
        began = time.monotonic()
        try:
            if self._connection.poll(timeout_s + GRACE_S):
                kind, value, rss_mb = pickle.loads(self._connection.recv_bytes())  # noqa: S301  # our own child
                return str(kind), value, float(rss_mb)
        except (EOFError, OSError):
            pass
        raise WorkFailedError(self._end(timed_out=time.monotonic() - began >= timeout_s))

    def _end(self, *, timed_out: bool) -> Failure:
        """End what is left of the process and say how it ended."""
        if self._process is None:  # closed by another thread: the caller is being shut down
            return Failure("killed", "the process was closed")
        if not timed_out:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(timeout=GRACE_S)
        with contextlib.suppress(ProcessLookupError):
            self._process.kill()
        code = self._process.wait()
        details = self._log_tail()
        self.close()
        if timed_out:
            return Failure("timeout", f"no result after {self._timeout_s:g} s: the process was ended", details)
        if code == -signal.SIGKILL:
            return Failure("killed", "the process was killed (SIGKILL; out of memory, or from outside)", details)
        if code < 0:
            return Failure("crashed", f"the process crashed ({signal.Signals(-code).name})", details)
        return Failure("crashed", f"the process exited with status {code}", details)

    def _log_tail(self, size: int = 8000) -> str:
        assert self._stderr is not None
        length = os.fstat(self._stderr.fileno()).st_size
        return os.pread(self._stderr.fileno(), size, max(0, length - size)).decode(errors="replace")


def resolve(function: str) -> Callable[..., Iterator[Any]]:
    """Return the function that "module:name" names."""
    module, _, name = function.partition(":")
    found: Callable[..., Iterator[Any]] = getattr(importlib.import_module(module), name)
    return found


class _NoPandas:
    """Finds that there is no pandas."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> None:
        """Errors: ImportError for pandas."""
        del path, target
        if name == "pandas":
            raise ImportError(name)


def leave_pandas_out() -> None:
    """Let pyarrow believe that there is no pandas: with its first array it would import it, which nothing here needs.

    Half a second of every process. pyarrow asks once and remembers.
    """
    import pyarrow as pa

    finder: Any = _NoPandas()
    sys.meta_path.insert(0, finder)
    pa.array([0])
    sys.meta_path.remove(finder)


def serve() -> None:
    """Run in the child: answer calls until the caller goes away."""
    leave_pandas_out()
    connection: Connection[Any, Any] = Connection(int(sys.argv[1]))
    threading.Thread(target=_leave_with_parent, args=(os.getppid(),), daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _reply(connection, "ready", None)
    for call in itertools.count():
        if call == 1:
            spare_the_collector()
        try:
            function, arguments, timeout_s = pickle.loads(connection.recv_bytes())  # noqa: S301  # our own caller
        except (EOFError, OSError):
            return
        os.ftruncate(sys.stderr.fileno(), 0)
        os.lseek(sys.stderr.fileno(), 0, os.SEEK_SET)
        _answer(connection, function, arguments, timeout_s=timeout_s)


def spare_the_collector() -> None:
    """Keep the garbage collector from looking through what stays for good: modules, types, compiled functions.

    For a process that has done its first piece of work, and thereby imported everything. One scene leaves little
    behind that only the collector can free, so it also need not come as often.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(*_COLLECT)


def _answer(connection: "Connection[Any, Any]", function: str, arguments: Sequence[Any], *, timeout_s: float) -> None:
    # A C thread of faulthandler's own ends a hang even where native code holds the GIL, and shows where it hung.
    try:
        values = resolve(function)(*arguments)
        _make_kernels_ready()
        _reply(connection, "started", None)
        faulthandler.dump_traceback_later(timeout_s, exit=True)
        for value in values:
            faulthandler.cancel_dump_traceback_later()
            _reply(connection, "value", value)
            faulthandler.dump_traceback_later(timeout_s, exit=True)
    except Exception as error:  # noqa: BLE001  # passed on to the caller, who decides
        faulthandler.cancel_dump_traceback_later()
        _reply(connection, "raised", describe_error(error))
        return
    faulthandler.cancel_dump_traceback_later()
    _reply(connection, "end", None)


def _make_kernels_ready() -> None:
    """Compile what set-up has not, for work that has imported kernels: its clock has not started."""
    if "hid2.kernels.compiled" in sys.modules:
        from hid2.kernels.compile import make_ready

        make_ready()


def describe_error(error: Exception) -> Failure:
    """Return an exception as a failure: a `Hid2Error` explains itself, anything else shows where it came from."""
    if isinstance(error, Hid2Error):
        return Failure("error", str(error))
    return Failure("exception", f"{type(error).__name__}: {error}", "".join(traceback.format_exception(error)))


def _reply(connection: "Connection[Any, Any]", kind: str, value: object) -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[1]) if Path("/proc/self/statm").exists() else 0
    connection.send_bytes(pickle.dumps((kind, value, pages * os.sysconf("SC_PAGE_SIZE") / 1e6)))


def _leave_with_parent(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(0.2)
    os._exit(1)
