"""Work for scene processes in tests; imported there by name, see the fixture `faults`.

A file FAULT in a source folder says what its scene does: segfault, hang, deep, wait, slow, killed, exit, raise. "...
once" does it at the first attempt only (a file beside the output remembers it).
"""

import errno
import gc
import importlib
import logging
import os
import signal
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from bridge.batch.batch import Run, SceneFolders, base_row
from bridge.batch.isolation import Failure, attempts
from bridge.batch.manifest import ManifestRow
from bridge.files import explained

FAULT = "FAULT"

#: SUMO 1.28 ends by SIGSEGV on a net without a version that has a connection to an edge it does not know.
BAD_NET = """<net>
    <edge id="a" from="j" to="k" priority="1">
        <lane id="a_0" index="0" speed="13.9" length="10.0" shape="0,0 10,0"/>
    </edge>
    <junction id="j" type="unregulated" x="0" y="0" incLanes="" intLanes="" shape="0,0"/>
    <junction id="k" type="unregulated" x="10" y="0" incLanes="a_0" intLanes="" shape="10,0"/>
    <connection from="a" to="missing" fromLane="0" toLane="0" dir="s" state="M"/>
</net>
"""


def number(shared: str, item: object) -> tuple[str, object, int]:
    """An item with the process id; a text names a fault."""
    if isinstance(item, str):
        fail(item, Path())
    return shared, item, os.getpid()


def numbers(shared: str, items: Sequence[object]) -> Iterator[tuple[str, object, int]]:
    """Yield each item with the process id; a text names a fault."""
    return (number(shared, item) for item in items)


def left_out() -> Iterator[int]:
    """Yield how many objects the collector does not look at, and leave some behind."""
    kept = [[number] for number in range(1000)]
    yield gc.get_freeze_count()
    globals()["_kept"] = kept


def leaves_files(shared: str, items: Sequence[object]) -> Iterator[str]:
    """Write a temporary file that only the end of the process could remove, then fail."""
    for item in items:
        Path(tempfile.mkdtemp(prefix="hid2-"), "net.xml").write_text("<net/>")
        fail(str(item), Path())
        yield str(item)


def copies(place: SceneFolders, runs: Sequence[Run]) -> Iterator[ManifestRow | Failure]:
    """Write each scene with nothing added: quick, and independent of the simulation."""
    from written import made_up_sidecar  # slow to import, as the next two: other work here starts without

    from bridge.config import new_scenario_id
    from bridge.recordings.export import with_generated, write_recording
    from bridge.recordings.scenario import read_scenario

    def copied(run: Run) -> ManifestRow:
        meet_fault(place, run)
        scenario = read_scenario(place.folder)
        sidecar = made_up_sidecar(scenario, run.config, variant=run.variant)
        new_id = new_scenario_id(scenario.scenario_id, run.config, run.config.request.seed, run.variant)
        made = with_generated(scenario, [], sidecar, new_id=new_id, focal_track_id=scenario.focal_track_id)
        folder = write_recording(made, place.out)
        time.sleep(float(os.environ.get("FAULTS_SLEEP_S", "0")))
        return base_row(place, run, folder)

    return attempts(copied, runs)


def other_version(place: SceneFolders, runs: Sequence[Run]) -> Iterator[ManifestRow]:
    """What a worker with another version of the package returns."""
    for run in runs:
        yield base_row(place, run)._replace(version="0.0.1")


def meet_fault(place: SceneFolders, run: Run) -> None:
    """Do what the source folder's FAULT says."""
    file = place.folder / FAULT
    if not file.exists():
        return
    fault, _, once = file.read_text().strip().partition(" ")
    done = place.out / f"{place.folder.name}-{run.variant}.fault"
    if once and done.exists():
        return
    done.touch()
    fail(fault, place.out)


def wait_below(calls: int) -> None:
    """Hang that many calls below, in a file with a long path: the stacks have 20 kB."""
    wait_below(calls - 1) if calls else time.sleep(600)


wait_below.__code__ = wait_below.__code__.replace(co_filename="long/" * 40 + "faults.py")


def fail(fault: str, scratch: Path) -> None:
    """Fail in the way that is named."""
    if fault == "segfault":
        signal.raise_signal(signal.SIGSEGV)  # in this thread: one to the process may come to another
    elif fault == "sumo":
        import libsumo

        net = scratch / f"bad-{os.getpid()}.net.xml"
        net.write_text(BAD_NET)
        libsumo.start(["sumo", "-n", str(net), "--no-step-log"])
    elif fault == "signal":
        os.kill(os.getpid(), signal.SIGRTMIN + 6)
    elif fault == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    elif fault == "memory":
        bytearray(10**13)
    elif fault == "full":
        with explained(scratch / "scenario.parquet"):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))  # as `write` says it: of no file
    elif fault == "exit":
        os._exit(3)
    elif fault == "hang":
        while True:
            pass
    elif fault == "deep":
        wait_below(90)
    elif fault == "wait":  # a hang that takes no processor from the other tests
        time.sleep(600)
    elif fault == "slow":
        time.sleep(1)
    raise RuntimeError(f"fault {fault}")


def talkative(shared: str, items: tuple[object, ...]) -> Iterator[object]:
    """Yields the items; says each to the debug log."""
    for item in items:
        logging.getLogger("hid2.insertion.filling").debug("%s: %s", shared, item)
        yield item


def compiles(shared: str, items: Sequence[object]) -> Iterator[object]:
    """Work in a process for which no kernels have been compiled: what it would say, without compiling any."""
    importlib.import_module("hid2.kernels.compiled")
    compile_room = importlib.import_module("hid2.kernels.compile")
    compile_room.make_ready = lambda say: say("compiling 42 functions, which takes a minute")
    return iter(items)
