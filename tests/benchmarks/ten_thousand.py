"""Ten thousand scenes in one go, with kills, a full disk and resumes in between: memory, files, rate.

    python tests/benchmarks/ten_thousand.py --scenes 10000 --jobs 2
    python tests/benchmarks/ten_thousand.py --scenes 200 --jobs 2 --root data/av2       # a try

`hid2 generate` makes variants of the scenes, as a user calls it, into a folder, and is disturbed while it runs, by
turns: SIGINT, a process of a scene killed, SIGKILL of all (what a power cut leaves), a full disk. Each time the same
command goes on with --resume. For the full disk OUT is a file system of its own that is too small (a tmpfs, which needs
root) and is made larger when it is full. In the end every scene is there once and valid, some are compared byte for
byte with those of an undisturbed run, nothing else lies in OUT or among the temporary files, and no process is left.
Prints what it finds; exit code 1 where anything is not as it should be.
"""

import argparse
import contextlib
import csv
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import psutil
from shared_data import SHARED_DATA

from bridge.batch.batch import Options, SceneJob, plan, run_batch
from bridge.config import load_config
from bridge.recordings.sources import find_scenarios
from bridge.recordings.validate import Against, validate_scene

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))

from interrupted import Command

#: Seconds between two looks at the processes, and scenes that are compared with those of an undisturbed run.
_EVERY_S, _COMPARED = 1.0, 40
INTERRUPT, WORKER_KILLED, ALL_KILLED = "SIGINT", "a scene's process killed", "SIGKILL of all"
#: What is done to the batch when such a share of the scenes is done.
DISTURBANCES = [
    (0.1, INTERRUPT), (0.2, WORKER_KILLED), (0.25, ALL_KILLED), (0.5, INTERRUPT), (0.7, ALL_KILLED),
    (0.8, WORKER_KILLED),
]  # fmt: skip


def rows_of(out: Path) -> list[dict[str, str]]:
    """The manifest, as far as it is written."""
    try:
        with (out / "manifest.csv").open(encoding="utf-8", newline="") as file:
            return list(csv.DictReader(file))
    except OSError:
        return []


def disturb(batch: Command, act: str) -> str:
    """Do one of the DISTURBANCES: of these a killed worker ends nothing."""
    family = psutil.Process(batch.process.pid).children(recursive=act == ALL_KILLED)
    if act == INTERRUPT:
        batch.send(signal.SIGINT, to_group=False)
    for one in {INTERRUPT: [], WORKER_KILLED: family[:1], ALL_KILLED: family}[act]:
        one.kill()
    if act == ALL_KILLED:
        batch.process.kill()
    return act


class Watched:
    """Runs of one command, one after the other. memory_mb: of each run at each look (main process, largest other)."""

    def __init__(self, arguments: list[object], work: Path, wanted: int) -> None:
        self.arguments, self.work, self.out = arguments, work, work / "out"
        self.left_to_do = [(share * wanted, act) for share, act in DISTURBANCES]
        self.memory_mb: list[list[tuple[float, float]]] = []
        self.ends: list[str] = []
        self.running_s = 0.0

    def run(self) -> tuple[int, str]:
        """Run it until it ends, disturbed when that is due; returns its exit code and what it said last."""
        began, did, sizes = time.monotonic(), [""], []
        batch = Command(self.arguments, self.work)
        process = psutil.Process(batch.process.pid)
        while batch.process.poll() is None:
            time.sleep(_EVERY_S)
            with contextlib.suppress(psutil.Error):
                workers = [one.memory_info().rss / 1e6 for one in process.children(recursive=True)]
                sizes.append((process.memory_info().rss / 1e6, max(workers, default=0.0)))
            done = sum(row.get("status") == "done" for row in rows_of(self.out))
            is_due = self.left_to_do and did[-1] in ("", WORKER_KILLED) and done >= self.left_to_do[0][0]
            if is_due and batch.process.poll() is None:
                did.append(disturb(batch, self.left_to_do.pop(0)[1]))
        left = batch.left()
        self.running_s += time.monotonic() - began
        self.memory_mb.append(sizes)
        said = [line for line in left.stderr.splitlines() if line.startswith(("hid2: ", "interrupted"))] or [""]
        self.ends.append(f"{', '.join(did[1:]) or 'ended by itself'}: exit {left.code}; {said[-1]}")
        print(f"{self.running_s:8.0f} s  {self.ends[-1]}", flush=True)
        for one in left.processes:
            self.ends[-1] += f", process left: {one}"
        if ALL_KILLED in did:  # nothing could tidy up; a reboot empties the folder
            print(f"          left in the folder of temporary files: {len(left.temporary)}, removed")
            shutil.rmtree(batch.scratch)
        return left.code, said[-1]

    def memory(self) -> Iterator[str]:
        """The most of all, and in the halves of the longest run."""
        longest = max(self.memory_mb, key=len)
        half = len(longest) // 2
        for k, name in enumerate(("main process", "largest process of a scene")):
            whole, first, second = (
                max((sizes[k] for sizes in some), default=0.0)
                for some in ([one for sizes in self.memory_mb for one in sizes], longest[:half], longest[half:])
            )
            yield f"{name}, MB: at most {whole:.0f}; in the halves of the longest run {first:.0f}, {second:.0f}"


def mount(out: Path, megabytes: int) -> bool:
    """A file system of that size at `out`; whether there is one now."""
    out.mkdir(parents=True, exist_ok=True)
    command = ["mount", "-t", "tmpfs", "-o", f"size={megabytes}m", "tmpfs", str(out)]
    return subprocess.run(command, capture_output=True).returncode == 0


def files_of(folder: Path) -> dict[str, bytes]:
    """Names and contents of the files of a scene."""
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def wrong(out: Path, work: Path, wanted: int, jobs: list[SceneJob]) -> Iterator[str]:
    """What has to hold at the end and does not."""
    rows, made = rows_of(out), find_scenarios(out)
    kinds, names = Counter(row["status"] for row in rows), {(row["scenario"], row["variant"]) for row in rows}
    print(f"manifest: {len(rows)} rows, {dict(kinds)}, {len(names)} different runs")
    if kinds != Counter(done=wanted) or len(names) != wanted:
        yield f"manifest: {dict(kinds)} and {len(names)} runs, expected {wanted} done"
    if {str(folder.relative_to(out)) for folder in made} != {row["folder"] for row in rows if row["folder"]}:
        yield "the folders in OUT are not those of the manifest"
    files = [path for path in out.rglob("*") if path.is_file() and path.parent not in set(made)]
    files = [path for path in files if path.parent != out or not path.name.startswith((".", "manifest"))]
    yield from (f"left over: {path}" for path in (files + list((work / "tmp").glob("*")))[:5])
    step = max(1, len(made) // 200)
    findings = [str(one) for folder in made[::step] for one in validate_scene(Against(), folder) if not one.is_note]
    print(f"validate: {len(made[::step])} scenes, {len(findings)} findings")
    yield from findings[:5]
    few, known = max(1, _COMPARED // len(jobs)), {folder.name: folder for folder in made}
    run_batch([SceneJob(job.folder, job.runs[:few]) for job in jobs], work / "undisturbed", Options())
    compared = find_scenarios(work / "undisturbed")
    unlike = [one.name for one in compared if one.name not in known or files_of(one) != files_of(known[one.name])]
    print(f"bytes: {len(compared)} scenes compared with an undisturbed run, {len(unlike)} differ or are absent")
    yield from (f"{name}: other bytes, or absent" for name in unlike)


def main() -> int:
    """Run, disturb, resume, check, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--root", type=Path, default=SHARED_DATA / "av2", help="recorded scenes")
    parser.add_argument("--scenes", type=int, default=10_000)
    parser.add_argument("--agents", type=int, default=10)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--small-mb", type=int, help="size of OUT until it is full (default: by the scenes)")
    parser.add_argument("--work", type=Path, help="folder to work in (default: a temporary one)")
    asked = parser.parse_args()
    folders = find_scenarios(asked.root)
    variants = asked.scenes // len(folders)
    wanted = variants * len(folders)
    work = asked.work or Path(tempfile.mkdtemp(prefix="ten-thousand-"))
    out, full_disk, code = work / "out", 0, -1
    largest_mb = max(sum(path.stat().st_size for path in folder.iterdir()) for folder in folders) / 1e6
    small_mb = asked.small_mb or max(2, int(wanted * largest_mb * 0.4))
    mounted = mount(out, small_mb)
    jobs = plan(folders, load_config(flags={"request.agents": asked.agents, "request.variants": variants}))
    arguments = ["generate", asked.root.resolve(), "-o", out, "--agents", asked.agents, "--variants", variants]
    batch = Watched([*arguments, "--jobs", asked.jobs, "--resume"], work, wanted)
    print(f"{wanted} scenes: {variants} variants of {len(folders)}; OUT of {small_mb if mounted else 'no bounded'} MB")
    try:
        while code != 0 and len(batch.ends) < 15:
            code, said = batch.run()
            if "No space left" in said:
                full_disk += 1
                print(f"          OUT is full after {len(find_scenarios(out))} scenes: made larger", flush=True)
                whole_mb = int(wanted * (largest_mb + 0.1) * 1.5) + 200
                subprocess.run(["mount", "-o", f"remount,size={whole_mb}m", str(out)], check=True)
        found = [] if code == 0 else [f"the batch does not end: {batch.ends[-1]}"]
        found += [end for end in batch.ends if "process left" in end]
        if mounted and not full_disk:
            found.append("the disk was never full: choose a smaller --small-mb")
        used = shutil.disk_usage(out).used
        found += wrong(out, work, wanted, jobs)
        print(f"ended {len(batch.ends) - 1} times, {full_disk} times by a full disk; each time continued with --resume")
        print(f"running {batch.running_s / 60:.1f} min, {wanted / batch.running_s:.2f} scenes/s")
        print("\n".join(batch.memory()))
        if mounted:
            print(f"OUT: {used / 1e6:.0f} MB, {used / 1e3 / wanted:.0f} kB a scene")
    finally:
        if mounted:
            subprocess.run(["umount", "-l", str(out)], check=False)
        if asked.work is None:
            shutil.rmtree(work, ignore_errors=True)
    print("\n".join(found or ["as it should be"]))
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
