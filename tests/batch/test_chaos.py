"""A night in which everything goes wrong, with real generation; and a cluster that others have started."""

import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from bridge.batch.batch import Options, plan, run_batch
from bridge.batch.manifest import DONE, files_sha256, output_files
from bridge.config import load_config
from bridge.recordings.validate import validate_folder

MakeDataSet = Callable[..., list[Path]]
BIN = Path(sys.executable).parent
CONFIG = load_config(flags={"request.agents": 5})


def contents(out: Path) -> dict[str, str]:
    folders = {path.parent for path in out.rglob("scenario_*.parquet")}
    return {folder.relative_to(out).as_posix(): files_sha256(output_files(folder)) for folder in folders}


class Killer:
    """Sends SIGKILL to workers at random: scene processes, each scene at most once, and Dask workers."""

    def __init__(self, started: Path, *, kills: int, seed: int) -> None:
        self.started, self.kills, self.random = started, kills, random.Random(seed)
        self.hit: list[str] = []
        self.stop = threading.Event()
        self.thread = threading.Thread(target=self._run)

    def __enter__(self) -> "Killer":
        self.thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop.set()
        self.thread.join()

    def _run(self) -> None:
        while len(self.hit) < self.kills and not self.stop.wait(self.random.uniform(0.3, 1.2)):
            target = self._choose()
            if target is not None:
                with contextlib.suppress(psutil.NoSuchProcess, OSError):
                    self._kill(*target)

    def _kill(self, process: psutil.Process, kind: str) -> None:
        """Held while it is looked at: a scene takes less time than that, and none is to lose its only retry.

        A worker that is not seen at a scene may have been given one, perhaps the retry of another: it is left alone.
        """
        at_work = [process, *process.children(recursive=True)]
        for one in at_work:
            one.suspend()
        names = [path.read_text() for one in at_work if (path := self.started / str(one.pid)).is_file()]
        if not names or any(name in self.hit for name in names):
            for one in at_work:
                one.resume()
            return
        self.hit += [*names, *([kind] if kind == "dask worker" else [])]
        for one in reversed(at_work):
            one.kill()

    def _choose(self) -> tuple[psutil.Process, str] | None:
        workers = []
        for process in psutil.Process().children(recursive=True):
            with contextlib.suppress(psutil.Error, OSError):
                command = " ".join(process.cmdline())
                if "bridge.batch.isolation" in command:
                    scene = (self.started / str(process.pid)).read_text()
                    if scene not in self.hit:
                        workers.append((process, scene))
                elif "spawn_main" in command and self.hit.count("dask worker") < 2:
                    workers.append((process, "dask worker"))
        return self.random.choice(workers) if workers else None


def test_chaos(make_data_set: MakeDataSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Workers are killed, one net makes libsumo segfault, one scene hangs, one is cut off, one raises.

    Every other scene is complete, valid and the same as on a quiet day; the bad ones leave bundles; nothing is left.
    """
    started = tmp_path / "started"
    started.mkdir()
    monkeypatch.setenv("FAULTS_STARTED", str(started))
    bad = {1: ("sumo", "crashed"), 4: ("hang", "timeout"), 7: ("corrupt", "error"), 10: ("raise", "exception")}
    folders = make_data_set(15, {number: fault for number, (fault, _) in bad.items()})
    quiet, out = tmp_path / "quiet", tmp_path / "out"
    good = [folder for number, folder in enumerate(folders) if number not in bad]
    assert {row.status for row in run_batch(plan(good, CONFIG), quiet, Options(function="faults:generated"))} == {DONE}

    options = Options(jobs=2, timeout_s=15, function="faults:generated")
    with Killer(started, kills=6, seed=int(os.environ.get("CHAOS_SEED", "0"))) as killer:
        rows = run_batch(plan(folders, CONFIG), out, options)
    assert len(killer.hit) >= 3, f"the killer hit only {killer.hit}"

    assert {row.scenario: row.failure for row in rows if row.status != DONE} == {
        folders[number].name: kind for number, (_, kind) in bad.items()
    }, f"killed: {killer.hit}"
    assert contents(out) == contents(quiet)
    findings = validate_folder(out / "val", source=folders[0].parent)
    # the planner looks at nothing beyond the last step; the new driving removes this filter
    assert [finding for finding in findings if finding.rule != "scene-end"] == []
    assert all((out / row.bundle).is_file() for row in rows if row.status != DONE)
    time.sleep(0.5)
    assert [path for path in out.rglob(".*") if path.name != ".hid2.lock"] == [], "nothing is half-written"


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """A scheduler and two workers as a user starts them, each by its own command line."""
    file = tmp_path / "scheduler.json"
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parent)}
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": environment}
    scheduler = ["scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(file)]
    worker = ["worker", "--scheduler-file", str(file), "--nthreads", "1", "--no-dashboard", "--host", "127.0.0.1"]
    worker += ["--local-directory", str(tmp_path)]
    processes = [subprocess.Popen([str(BIN / "dask"), *scheduler], **quiet)]
    try:
        while not file.exists():
            assert processes[0].poll() is None
            time.sleep(0.1)
        processes += [subprocess.Popen([str(BIN / "dask"), *worker], **quiet) for _ in range(2)]
        yield json.loads(file.read_text())["address"], processes
    finally:
        for process in reversed(processes):
            process.send_signal(signal.SIGINT)
        for process in processes:
            try:
                process.wait(timeout=60)
            except subprocess.TimeoutExpired:
                process.kill()


def test_cluster_that_others_started(
    make_data_set: MakeDataSet, tmp_path: Path, cluster: tuple[str, list[subprocess.Popen[bytes]]]
) -> None:
    """`hid2 generate --scheduler` uses its workers, also when one is killed on the way; the bytes are the same."""
    address, processes = cluster
    folders = make_data_set(9)
    run_batch(plan(folders, CONFIG), tmp_path / "here", Options())
    command = [str(BIN / "hid2"), "generate", str(folders[0].parent), "-o", str(tmp_path / "there"), "--agents", "5"]
    generating = subprocess.Popen([*command, "--scheduler", address], stdout=subprocess.PIPE, text=True)
    while not (tmp_path / "there" / "val").exists():
        assert generating.poll() is None
        time.sleep(0.1)
    killed = processes.pop()
    killed.kill()  # the nanny: its worker goes with it
    killed.wait()
    output, _ = generating.communicate(timeout=300)
    assert generating.returncode == 0
    assert "9 of 9 scenes done" in output
    assert contents(tmp_path / "there") == contents(tmp_path / "here")


def test_scheduler_that_is_not_there_is_explained(make_data_set: MakeDataSet, tmp_path: Path) -> None:
    command = [str(BIN / "hid2"), "generate", str(make_data_set(1)[0]), "-o", str(tmp_path / "out")]
    result = subprocess.run([*command, "--scheduler", "tcp://127.0.0.1:9"], capture_output=True, text=True, timeout=300)
    assert result.returncode == 1
    assert "Traceback" not in result.stderr
    assert result.stderr.startswith("hid2: scheduler tcp://127.0.0.1:9: cannot be reached")
