"""How a command ends before it is done: at once, wherever it is, with one line and with nothing left behind.

A signal does not become an exception, which could be raised amid the tidying, or lost. The handler itself ends all
child processes, tidies what is registered with `tidied`, and leaves. What a process that was killed has left the next
one removes: all that is being written has a name of one form, and is locked as long as its process lives.
"""

import atexit
import contextlib
import fcntl
import os
import re
import shutil
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

SIGNALS = frozenset({signal.SIGINT, signal.SIGTERM, signal.SIGHUP})
#: Seconds that a piece of tidying has before the next begins: it may wait for a lock that the interrupted code holds.
_STUCK_S = 10.0
#: Seconds for which what is empty is left alone: a process has just made it there, and is about to lock it.
_NEW_S = 0.2
_HIDDEN = re.compile(r"\.hid2-[0-9a-f]{16}(\.[^.]*)?")

#: What is to be tidied, the latest last. Signals are the process's, and so is this.
_TIDY: list[Callable[[], object]] = []
_SAID = {"next": "nothing half-written is left"}


def end_when_interrupted() -> None:
    """From now on a signal, unless ignored from the start, ends the command, and its folder of temporary files goes.

    For the process of a command, with signals blocked until here.
    """
    for number in SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _interrupted)
    place, scratch = Path(tempfile.gettempdir()), contextlib.ExitStack()
    with contextlib.suppress(OSError):  # what needs the folder says so
        tempfile.tempdir = os.environ["TMPDIR"] = str(scratch.enter_context(hidden_folder(place)))
    atexit.register(scratch.close)
    _TIDY.append(_end_children)  # again, before the folder goes: a thread may have started another one
    told, tell = os.pipe()
    os.set_blocking(tell, False)
    signal.set_wakeup_fd(tell, warn_on_full_buffer=False)
    signal.signal(signal.SIGURG, lambda *_: None)
    threading.Thread(target=_nudge, args=(told, threading.get_ident()), daemon=True).start()
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
    remove_abandoned(place)


def if_interrupted(said: str) -> None:
    """What a command that is interrupted from now on says: what is done, and how to go on."""
    _SAID["next"] = said


@contextlib.contextmanager
def tidied(tidy: Callable[[], object]) -> Iterator[None]:
    """Call `tidy` at the end of a block, or where the command is interrupted in it, there perhaps a second time."""
    _TIDY.append(tidy)
    try:
        yield
    finally:
        tidy()
        with contextlib.suppress(ValueError):  # the command is being interrupted
            _TIDY.remove(tidy)


@contextlib.contextmanager
def hidden_file(folder: Path, suffix: str) -> Iterator[Path]:
    """A new empty file in a folder, gone at the end if it still has this name. Errors: OSError."""
    path = _hidden_in(folder, suffix)
    with tidied(partial(_remove, path)), locked(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL):
        yield path


@contextlib.contextmanager
def hidden_folder(parent: Path) -> Iterator[Path]:
    """A new folder in another one, gone at the end with what is in it. Errors: OSError."""
    path = _hidden_in(parent)
    with tidied(partial(_remove, path)):
        path.mkdir(mode=0o700)
        with locked(path, os.O_RDONLY):
            yield path


def remove_abandoned(folder: Path, *below: str) -> None:
    """Remove what processes that are gone were writing in a folder, and in those below that match a pattern."""
    for pattern in (".hid2-*", *(f"{name}/.hid2-*" for name in below)):
        for path in folder.glob(pattern):
            with contextlib.suppress(OSError), contextlib.ExitStack() as stack:  # O_NONBLOCK: nothing waits for a pipe
                is_left = _HIDDEN.fullmatch(path.name) and path.lstat().st_uid == os.geteuid() and not _is_new(path)
                if is_left and stack.enter_context(locked(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)):
                    _remove(path)


def _is_new(path: Path) -> bool:
    """Whether it is empty and so new that its process may not have locked it yet."""
    return time.time() - path.stat().st_mtime < _NEW_S and not (
        any(path.iterdir()) if path.is_dir() else path.stat().st_size
    )


def _hidden_in(folder: Path, suffix: str = "") -> Path:
    return folder / f".hid2-{os.urandom(8).hex()}{suffix}"


@contextlib.contextmanager
def locked(path: Path, flags: int) -> Iterator[bool]:
    """Whether it is locked now: not where another process has done so, or the file system knows no locks."""
    descriptor, is_mine = os.open(path, flags, 0o666), False
    try:
        with contextlib.suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            is_mine = True
        yield is_mine
    finally:
        os.close(descriptor)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def _nudge(told: int, main: int) -> None:
    """Wake the main thread, which does not see a signal that came just before it began to wait for something."""
    os.read(told, 1)
    while True:
        time.sleep(0.1)
        signal.pthread_kill(main, signal.SIGURG)


def _interrupted(number: int, _frame: object) -> None:
    """End the command; a second time, at once."""
    code = 128 + number
    for one in SIGNALS:
        signal.signal(one, lambda *_: os._exit(code))
    signal.signal(signal.SIGALRM, lambda *_: _leave(code))
    _TIDY.append(_end_children)
    _leave(code)


def _leave(code: int) -> None:
    while _TIDY:
        signal.setitimer(signal.ITIMER_REAL, _STUCK_S)
        with contextlib.suppress(Exception):
            _TIDY.pop()()
    with contextlib.suppress(OSError):  # past the streams of Python, which may be in the midst of writing
        os.write(2, f"hid2: interrupted; {_SAID['next']}\n".encode(errors="backslashreplace"))
    os._exit(code)


def _end_children() -> None:
    """Kill the processes that this one has started, also those that libraries started, and wait for them."""
    import psutil  # takes as long as much of a command

    while children := psutil.Process().children():
        for child in children:
            with contextlib.suppress(psutil.Error):  # it has ended
                child.kill()
                child.wait()
