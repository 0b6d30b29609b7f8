"""Every command interrupted at random moments: how it ends and what it leaves. A script, no test:

python tests/benchmarks/interruptions.py --count 200 --seed 0 [--real SCENE] [--only render,generate]

Each command runs once undisturbed, which says how long it takes. Then, by turns, SIGINT or SIGTERM goes to it alone or
to its process group, at a moment drawn uniformly from its first line of hid2 to its end. With --killed N that many runs
get SIGKILL instead, and the same command once more: the second run must leave nothing of the first.
"""

import argparse
import contextlib
import importlib.util
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))
from interrupted import Command, damaged, faults, leftovers

DATA = Path(__file__).parents[2] / "data" / "av2"
COMPOSITION = """\
split.by = "folder"
[sources]
made = "made"
data = "{data}"
[sets.all.take]
made = "all"
data = "all"
[validation.all.take]
made = "all"
data = "all"
"""
STUDY = """\
scenes = ["{scene}"]
seeds = 1
kind = "lane_change"
[vary]
"lane_change.time_gap_rear_s" = [0.4, 1.2]
[config.request]
agents = 1
"""


def commands(base: Path, scene: Path) -> dict[str, list[object]]:
    """All commands by name, which write to the folder `out` of the folder they run in; scene: a recorded one."""
    made = base / "made"
    generated = next((made / "val").iterdir())
    study = base / "study.toml"
    study.write_text(STUDY.format(scene=next((DATA / "val").iterdir())))
    recorded = next((DATA / "train").iterdir())
    found: dict[str, list[object]] = {
        "generate": ["generate", DATA, scene, "-o", "out", "--agents", "3"],
        "generate -j 2": ["generate", DATA, scene, "-o", "out", "--agents", "3", "-j", "2"],
        "validate": ["validate", made],
        "scan": ["scan", DATA, scene, "-o", "out/facts.csv"],
        "net": ["net", scene, "-o", "out"],
        "export": ["export", scene, "--to", "openscenario", "-o", "out"],
        "evaluate": ["evaluate", made, "-o", "out", "--source", DATA],
        "calibrate": ["calibrate", recorded, "-o", "out/drivers.toml"],
        "study": ["study", study, "-o", "out"],
        "make corridor": ["make", "corridor", "-o", "out"],
        "compose": ["compose", base / "composition.toml", "-o", "out/root"],
        "paper": ["paper", "table1", "--scenes", scene, "-o", "out", "--seeds", "1", "--agents", "1"],
        "render png": ["render", generated, "-o", "out/a.png"],
        "render mp4": ["render", recorded, "-o", "out/a.mp4"],
        "render gif": ["render", recorded, "-o", "out/a.gif"],
        "view": ["view", made, "-o", "out/a.html"],
        "plot": ["plot", generated, "-o", "out/a.png", "--agent", "gen_0"],
        "config": ["config"],
    }
    if os.environ.get("DISPLAY"):
        found["gui --screenshot"] = ["gui", generated, "--screenshot", "out/a.png"]
        found["gui"] = ["gui", generated]
    else:
        print("gui is left out: no Xvfb, and no DISPLAY")
    if importlib.util.find_spec("torch"):
        found["forecast"] = ["forecast", base / "composed", "-o", "out", "--updates", "20"]
    else:
        print("forecast is left out: torch is not installed")
    return found


#: `gui` ends with its window, which stays: it is interrupted within so many seconds.
GUI_S = 6.0


@contextlib.contextmanager
def display() -> Iterator[None]:
    """A screen for sumo-gui, where Xvfb is installed."""
    if os.environ.get("DISPLAY") or not shutil.which("Xvfb"):
        yield
        return
    command = ["Xvfb", "-displayfd", "1", "-screen", "0", "1280x1024x24"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as screen:
        assert screen.stdout is not None
        os.environ["DISPLAY"] = f":{screen.stdout.readline().strip()}"
        try:
            yield
        finally:
            screen.terminate()


def measured(name: str, arguments: list[object], work: Path) -> float:
    """Seconds that a command takes from its first line of hid2 to its end. Errors: AssertionError where it fails."""
    if name == "gui":
        return GUI_S
    command = Command(arguments, work)
    command.wait_for(command.is_ours)
    began = time.monotonic()
    left = command.left(timeout_s=600)
    assert left.code == 0, f"{name}: {left.stderr}"
    wrong = [*leftovers(left), *damaged(work / "out")]
    assert not wrong, f"{name}: {wrong}"
    return time.monotonic() - began


def trial(arguments: list[object], work: Path, after_s: float, number: signal.Signals, *, to_group: bool) -> str | None:
    """Run a command, interrupt it; returns what is wrong, "" for nothing, None where it ended before."""
    command = Command(arguments, work)
    command.wait_for(command.is_ours)
    with contextlib.suppress(subprocess.TimeoutExpired):
        command.process.wait(timeout=after_s)
    done = command.process.poll() is not None
    if not done:
        command.send(number, to_group=to_group)
    left = command.left()
    if done or (left.code == 0 and "interrupted" not in left.stderr):  # the signal met a command that was done
        return None
    if number == signal.SIGKILL:
        again = Command([*arguments, *(["--resume"] if arguments[0] == "generate" else [])], work)
        left = again.left(timeout_s=600)
        wrong = [*leftovers(left), *damaged(work / "out"), *(hidden for hidden in damaged(work) if "hidden:" in hidden)]
        return "; ".join([*([] if left.code == 0 else [f"the next run: {left.code} {left.stderr}"]), *wrong])
    wrong = faults(left, number, work / "out")
    wrong += [f"hidden: {path}" for path in work.glob(".*")]
    wrong += [f"it took {left.seconds:.1f} s"] if left.seconds > 5.0 else []
    return "; ".join(wrong)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--killed", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--real", type=Path, help="a recorded scene; else one of data/av2")
    parser.add_argument("--only", help="names of commands as they begin, joined by commas")
    chosen = parser.parse_args()
    draw = random.Random(chosen.seed)
    wrong: list[str] = []
    ended: Counter[str] = Counter()
    with display(), tempfile.TemporaryDirectory(prefix="interruptions-") as place:
        base = Path(place)
        prepare = [["generate", DATA, "-o", "made", "--agents", "3"]]
        for arguments in prepare:
            assert Command(arguments, base).left(timeout_s=600).code == 0
        (base / "composition.toml").write_text(COMPOSITION.format(data=DATA))
        if importlib.util.find_spec("torch"):
            assert Command(["compose", "composition.toml", "-o", "composed"], base).left(timeout_s=600).code == 0
        scene = chosen.real.resolve() if chosen.real else next((DATA / "val").iterdir())
        wanted = tuple((chosen.only or "").split(","))
        found = {name: args for name, args in commands(base, scene).items() if name.startswith(wanted)}
        takes = {name: measured(name, args, base / name / "whole") for name, args in found.items()}
        print(*(f"{name}: {seconds:.1f} s" for name, seconds in takes.items()), sep="\n", flush=True)
        kinds = [signal.SIGKILL] * chosen.killed + [signal.SIGINT, signal.SIGTERM] * ((chosen.count + 1) // 2)
        names = sorted(found)
        tried = 0
        for row in range(chosen.killed + chosen.count):
            outcome = None
            while outcome is None:
                name = names[row % len(names)]
                if kinds[row] == signal.SIGKILL and name == "gui":
                    name = "config"
                after_s, to_group = draw.uniform(0.0, takes[name]), draw.random() < 0.5
                work = base / name / str(tried)
                outcome = trial(found[name], work, after_s, kinds[row], to_group=to_group)
                tried += 1
                shutil.rmtree(work, ignore_errors=True)
                ended[name] += outcome is None
            if outcome:
                said = f"{name}: {kinds[row].name} after {after_s:.3f} s{' to all' if to_group else ''}: {outcome}"
                wrong.append(said)
                print(said, flush=True)
    print(f"{len(kinds[: chosen.killed + chosen.count]) - len(wrong)} of {chosen.killed + chosen.count} left nothing")
    print(f"drawn again, as the command was done: {dict(ended)}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
