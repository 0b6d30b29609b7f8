"""A command of `hid2` that is interrupted, and what may be wrong with what it leaves."""

import gzip
import json
import os
import signal
import subprocess
import sys
import time
import uuid
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

import imageio_ffmpeg
import numpy as np
import psutil
import pyarrow.parquet as pq
from PIL import Image
from processes import still_running

HID2 = str(Path(sys.executable).parent / "hid2")
_MARK = "HID2_TEST_MARK"


class Left(NamedTuple):
    """How a command ended."""

    code: int
    stderr: str
    processes: list[psutil.Process]
    temporary: list[str]


class Command:
    """A command in a session of its own, with its own folder for temporary files."""

    def __init__(self, arguments: Sequence[object], work: Path, environment: dict[str, str] | None = None) -> None:
        self.scratch, self._mark = work / "tmp", uuid.uuid4().hex
        self.scratch.mkdir(parents=True, exist_ok=True)
        self._stderr = (work / "stderr").open("w+", encoding="utf-8", errors="replace")
        if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in the background of a script, which is inherited
            signal.signal(signal.SIGINT, signal.default_int_handler)
        self.process = subprocess.Popen(
            [HID2, *map(str, arguments)], cwd=work, stdout=subprocess.DEVNULL, stderr=self._stderr,
            env=os.environ | {"TMPDIR": str(self.scratch), _MARK: self._mark} | (environment or {}),
            start_new_session=True,
        )  # fmt: skip

    def wait_for(self, event: Callable[[], bool], *, timeout_s: float = 60.0) -> None:
        """Wait for an event. Errors: AssertionError where the command ends before it, or it does not come about."""
        end = time.monotonic() + timeout_s
        while not event():
            assert self.process.poll() is None, f"it ended with {self.process.returncode}: {self.said()}"
            assert time.monotonic() < end, f"nothing came about: {self.said()}"
            time.sleep(0.002)

    def said(self) -> str:
        """What it has said on stderr so far."""
        return Path(self._stderr.name).read_text(encoding="utf-8", errors="replace")

    def send(self, number: signal.Signals, *, to_group: bool) -> None:
        """Send a signal to it alone, or as a terminal does to all in its group."""
        (os.killpg if to_group else os.kill)(self.process.pid, number)

    def left(self, *, timeout_s: float = 60.0) -> Left:
        """Wait for its end, and say what is left of it."""
        code = self.process.wait(timeout=timeout_s)
        family = [process for process in psutil.process_iter() if self._is_of_it(process)]
        running = still_running(family, timeout_s=10.0)
        for process in running:
            process.kill()
        self._stderr.close()
        return Left(code, self.said(), running, sorted(path.name for path in self.scratch.iterdir()))

    def _is_of_it(self, process: psutil.Process) -> bool:
        try:
            return process.environ().get(_MARK) == self._mark
        except psutil.Error:
            return False


def faults(left: Left, number: signal.Signals, *folders: Path) -> list[str]:
    """What is wrong with a command that a signal has interrupted while it wrote to folders."""
    found = [] if left.code == 128 + number else [f"exit code {left.code}"]
    lines = [line for line in left.stderr.splitlines() if line.startswith("hid2: interrupted; ")]
    found += [] if len(lines) == 1 else [f"{len(lines)} lines on the interruption: {left.stderr!r}"]
    if "Traceback" in left.stderr or "Exception" in left.stderr:
        found.append(left.stderr)
    return found + leftovers(left) + [fault for folder in folders for fault in damaged(folder)]


def leftovers(left: Left) -> list[str]:
    """Processes and temporary files that are left."""
    return [f"still running: {process}" for process in left.processes] + [f"in TMPDIR: {n}" for n in left.temporary]


def damaged(folder: Path) -> list[str]:
    """Files below a folder that are hidden, or that cannot be read to their end."""
    found = []
    for path in sorted(folder.rglob("*")):
        if path.name.startswith(".") and path.name != ".hid2.lock":
            found.append(f"hidden: {path}")
        elif path.is_file():
            try:
                _read(path)
            except Exception as error:  # noqa: BLE001  # listed with the file
                found.append(f"{path}: {type(error).__name__}: {error}")
    return found


def _read(path: Path) -> None:
    """Errors: whatever the reader of such a file raises where it is cut off."""
    if path.suffix == ".parquet":
        pq.read_table(path)
    elif path.suffix == ".json":
        json.loads(path.read_bytes())
    elif path.suffix in (".png", ".jpg", ".gif"):
        with Image.open(path) as image:
            for frame in range(getattr(image, "n_frames", 1)):
                image.seek(frame)
                image.load()
    elif path.suffix == ".mp4":
        imageio_ffmpeg.count_frames_and_secs(path)
    elif path.suffix == ".npz":
        np.load(path)
    elif path.suffix == ".gz":
        gzip.decompress(path.read_bytes())
    elif path.suffix == ".zip":
        assert zipfile.ZipFile(path).testzip() is None
    elif path.suffix in (".xml", ".svg", ".sumocfg"):
        ET.parse(path)
    elif path.suffix in (".csv", ".toml", ".md"):
        text = path.read_text()
        assert not text or text.endswith("\n"), "it is cut off"
    elif path.suffix == ".html":
        assert path.read_text().rstrip().endswith("</html>"), "it is cut off"
