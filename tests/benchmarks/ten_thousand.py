"""Ten thousand scenes in one go, with kills, a full disk and resumes in between: memory, files, rate.

    python tests/benchmarks/ten_thousand.py --scenes 10000 --jobs 2
    python tests/benchmarks/ten_thousand.py --scenes 200 --jobs 2 --root data/av2       # a try

`hid2 generate` makes variants of the scenes, as a user calls it, into a folder, and is disturbed while it runs, by
turns: SIGINT, a process of a scene killed, SIGKILL of all (what a power cut leaves), a full disk. Each time the same
command goes on with --resume. For the full disk OUT is a file system of its own that is too small (a tmpfs, which needs
root) and is made larger when it is full. In the end every scene is there once and valid, some are compared byte for
byte with those of an undisturbed run, nothing else lies in OUT or among the temporary files, and no process is left.
Prints what it finds, with an extrapolation to 55,000 scenes; exit code 1 where anything is not as it should be.
"""

import argparse
import csv
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import psutil
from shared_data import SHARED_DATA

from bridge.batch.batch import Options, SceneJob, plan, run_batch
from bridge.config import load_config
from bridge.recordings.folders import find_scenarios
from bridge.recordings.validate import Against, validate_scene

HID2 = Path(sys.executable).parent / "hid2"
#: Scenes of a whole data set that the figures are extrapolated to.
WHOLE = 55_000
#: Seconds between two looks at the processes, and scenes that are compared with those of an undisturbed run.
_EVERY_S, _COMPARED = 1.0, 40


_WORKER_KILLED = "a scene's process killed"


class Plan(NamedTuple):
    """What is to happen to the batch when so many scenes are done."""

    scenes: float
    act: Callable[[psutil.Process], str]


@dataclass(slots=True)
class Seen:
    """What was seen of the processes. main_mb, worker_mb: for each run (seconds, value) at each look."""

    main_mb: list[list[tuple[float, float]]] = field(default_factory=list)
    worker_mb: list[list[tuple[float, float]]] = field(default_factory=list)
    running_s: float = 0.0
    ends: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)


def finished(out: Path) -> int:
    """Rows of the manifest that are done, as far as it is written."""
    try:
        with (out / "manifest.csv").open(encoding="utf-8", newline="") as file:
            return sum(row.get("status") == "done" for row in csv.DictReader(file))
    except OSError:
        return 0


def look(process: psutil.Process, seen: Seen) -> None:
    """Take note of the memory of a batch and its processes."""
    try:
        workers = process.children(recursive=True)
        sizes = [worker.memory_info().rss / 1e6 for worker in workers]
        seen.main_mb[-1].append((seen.running_s, process.memory_info().rss / 1e6))
        seen.worker_mb[-1].append((seen.running_s, max(sizes, default=0.0)))
    except psutil.Error:
        return


def run(command: list[str], seen: Seen, scratch: Path, out: Path, plans: list[Plan]) -> tuple[int, str]:
    """Run the batch until it ends, disturbed as planned; returns exit code and what was said last.

    plans: those that are due are taken out; what follows one that ends the batch waits for the next run.
    """
    for samples in (seen.main_mb, seen.worker_mb):
        samples.append([])
    before = seen.running_s
    began = time.monotonic()
    with tempfile.TemporaryFile("w+") as said:
        batch = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=said, env=os.environ | {"TMPDIR": str(scratch)}
        )
        process = psutil.Process(batch.pid)
        did: list[str] = []
        while batch.poll() is None:
            time.sleep(_EVERY_S)
            seen.running_s = before + time.monotonic() - began
            look(process, seen)
            ended = did and did[-1] != _WORKER_KILLED
            if plans and not ended and batch.poll() is None and finished(out) >= plans[0].scenes:
                did.append(plans.pop(0).act(process))
        said.seek(0)
        lines = [line for line in said.read().splitlines() if line.startswith(("hid2: ", "interrupted"))]
    seen.running_s = before + time.monotonic() - began
    what = ", ".join(did) or "ended by itself"
    seen.ends.append(f"{what}: exit {batch.returncode}; {lines[-1] if lines else 'nothing said'}")
    print(f"{seen.running_s:8.0f} s  {seen.ends[-1]}", flush=True)
    return batch.returncode, lines[-1] if lines else ""


def interrupt(process: psutil.Process) -> str:
    """Ctrl-C."""
    process.send_signal(signal.SIGINT)
    return "SIGINT"


def kill_worker(process: psutil.Process) -> str:
    """One process of a scene dies; the batch goes on, so that this ends nothing."""
    workers = process.children()
    if workers:
        workers[0].kill()
    return _WORKER_KILLED


def kill_all(process: psutil.Process) -> str:
    """What a power cut does: nobody can clean up."""
    everybody = [*process.children(recursive=True), process]
    for one in everybody:
        one.kill()
    return "SIGKILL of all"


def mount(out: Path, megabytes: int) -> bool:
    """A file system of that size at `out`; whether there is one now."""
    out.mkdir(parents=True, exist_ok=True)
    result = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={megabytes}m", "tmpfs", str(out)], capture_output=True
    )
    return result.returncode == 0


def extrapolated(runs: list[list[tuple[float, float]]], seconds: float) -> str:
    """Largest value, and the value after so many seconds if it grows as in the second half of the longest run."""
    samples = max(runs, key=len)
    half = samples[len(samples) // 2 :]
    (begin_s, begin), (end_s, end) = half[0], half[-1]
    slope = (end - begin) / max(end_s - begin_s, 1.0)
    largest = max(value for each in runs for _, value in each)
    whole = max(largest, end + slope * max(0.0, seconds - (end_s - samples[0][0])))
    return f"at most {largest:.0f}; {whole:.0f} at {WHOLE:,} scenes"


def files_of(folder: Path) -> dict[str, bytes]:
    """Names and contents of the files of a scene."""
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def check(out: Path, scratch: Path, wanted: int, jobs: list[SceneJob], seen: Seen) -> None:
    """What has to hold at the end; says what does not."""
    with (out / "manifest.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    kinds = Counter(row["status"] for row in rows)
    names = [(row["scenario"], row["variant"]) for row in rows]
    print(f"manifest: {len(rows)} rows, {dict(kinds)}, {len(set(names))} different runs")
    if kinds != Counter(done=wanted) or len(set(names)) != wanted:
        seen.wrong.append(f"manifest: {dict(kinds)} and {len(set(names))} runs, expected {wanted} done")
    made = find_scenarios(out)
    if {str(folder.relative_to(out)) for folder in made} != {row["folder"] for row in rows if row["folder"]}:
        seen.wrong.append("the folders in OUT are not those of the manifest")
    extra = [p for p in out.rglob("*") if p.is_file() and p.parent not in set(made) and p != out / "manifest.csv"]
    extra = [path for path in extra if path.parent != out or not path.name.startswith((".", "manifest"))]
    if extra or list(scratch.iterdir()):
        seen.wrong.append(f"left over: {[str(path) for path in extra[:5]]}, {[p.name for p in scratch.iterdir()][:5]}")
    step = max(1, len(made) // 200)
    findings = [str(one) for folder in made[::step] for one in validate_scene(Against(), folder) if not one.is_note]
    print(f"validate: {len(made[::step])} scenes, {len(findings)} findings")
    seen.wrong += findings[:5]
    again = scratch.parent / "undisturbed"
    few = max(1, _COMPARED // len(jobs))
    run_batch([SceneJob(job.folder, job.runs[:few]) for job in jobs], again, Options())
    known = {folder.name: folder for folder in made}
    compared = find_scenarios(again)
    unlike = [folder.name for folder in compared if files_of(folder) != files_of(known.get(folder.name, folder))]
    absent = [folder.name for folder in compared if folder.name not in known]
    print(f"bytes: {len(compared)} scenes compared with an undisturbed run, {len(unlike)} differ, {len(absent)} absent")
    seen.wrong += [f"{name}: other bytes, or absent" for name in [*unlike, *absent]]


def main() -> int:
    """Run, disturb, resume, check, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    shared = SHARED_DATA / "av2"
    parser.add_argument("--root", type=Path, default=shared, help="recorded scenes (default: the real ones)")
    parser.add_argument("--scenes", type=int, default=10_000)
    parser.add_argument("--agents", type=int, default=10)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument(
        "--small-mb", type=int, default=None, help="size of OUT until it is full (default: by the scenes)"
    )
    parser.add_argument("--work", type=Path, default=None, help="folder to work in (default: a temporary one)")
    arguments = parser.parse_args()
    # a shell that starts this in the background has the signal ignored, and so would the batch
    signal.signal(signal.SIGINT, signal.default_int_handler)
    folders = find_scenarios(arguments.root)
    variants = arguments.scenes // len(folders)
    wanted = variants * len(folders)
    work = arguments.work or Path(tempfile.mkdtemp(prefix="ten-thousand-"))
    out, scratch = work / "out", work / "scratch"
    scratch.mkdir(parents=True)
    largest_mb = max(sum(path.stat().st_size for path in folder.iterdir()) for folder in folders) / 1e6
    whole_mb = int(wanted * (largest_mb + 0.1) * 1.5) + 200
    small_mb = arguments.small_mb or max(2, int(wanted * largest_mb * 0.4))
    mounted = mount(out, small_mb)
    seen = Seen()
    asked = {"request.agents": arguments.agents, "request.variants": variants}
    jobs = plan(folders, load_config(flags=asked))
    command = [str(HID2), "generate", str(arguments.root), "-o", str(out), "--agents", str(arguments.agents)]
    command += ["--variants", str(variants), "--jobs", str(arguments.jobs), "--resume"]
    print(f"{wanted} scenes: {variants} variants of {len(folders)}; OUT of {small_mb if mounted else 'no bounded'} MB")

    full_disk = 0
    try:
        acts = [(0.1, interrupt), (0.2, kill_worker), (0.25, kill_all), (0.5, interrupt), (0.7, kill_all)]
        plans = [Plan(share * wanted, act) for share, act in [*acts, (0.8, kill_worker)]]
        code = -1
        while code != 0 and len(seen.ends) < 15:
            code, said = run(command, seen, scratch, out, plans)
            if "SIGKILL" in seen.ends[-1]:  # nobody could tidy up; a reboot empties the folder
                print(f"          left in the folder of temporary files: {len(list(scratch.iterdir()))}, removed")
                shutil.rmtree(scratch)
                scratch.mkdir()
            if "No space left" in said:
                full_disk += 1
                print(f"          OUT is full with {finished(out)} scenes done: made larger", flush=True)
                subprocess.run(["mount", "-o", f"remount,size={whole_mb}m", str(out)], check=True)
        if code:
            seen.wrong.append(f"the batch does not end: {seen.ends[-1]}")
        if mounted and not full_disk:
            seen.wrong.append("the disk was never full: choose a smaller --small-mb")
        usage = shutil.disk_usage(out)
        check(out, scratch, wanted, jobs, seen)
        left = [
            p.info for p in psutil.process_iter(["pid", "cmdline"]) if str(out) in " ".join(p.info["cmdline"] or [])
        ]
        seen.wrong += [f"process left: {one}" for one in left if one["pid"] != os.getpid()]
        rate = wanted / seen.running_s
        whole_s = WHOLE / rate
        print(f"ended {len(seen.ends) - 1} times, {full_disk} times by a full disk; every time continued with --resume")
        print(f"running {seen.running_s / 60:.1f} min, {rate:.2f} scenes/s; {WHOLE:,} scenes: {whole_s / 3600:.1f} h")
        print(f"main process, MB: {extrapolated(seen.main_mb, whole_s)}")
        print(f"largest process of a scene, MB: {extrapolated(seen.worker_mb, whole_s)}")
        if mounted:
            print(f"OUT: {usage.used / 1e6:.0f} MB, {usage.used / 1e3 / wanted:.0f} kB a scene")
    finally:
        if mounted:
            subprocess.run(["umount", "-l", str(out)], check=False)
        if arguments.work is None:
            shutil.rmtree(work, ignore_errors=True)
    print("\n".join(["as it should be"] if not seen.wrong else seen.wrong))
    return 1 if seen.wrong else 0


if __name__ == "__main__":
    sys.exit(main())
