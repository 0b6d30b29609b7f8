"""Processor time of the command `hid2 generate` on one scene, as a multiple of bare imports: what starting costs.

Not part of the default run: `pytest -m benchmark -s`, or as a script: python tests/benchmarks/test_start_up.py. Both
sides are whole processes with their children, warm, in turns; the median of the turns' ratios counts.
"""

import os
import resource
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import pytest
from shared_data import SHARED_DATA

#: Largest ratio of processor times.
MOST = 2.4
ROUNDS = 7
SCENE = "0a1e6f0a"
IMPORTS = "import numpy, pyarrow, shapely, libsumo, numba"


def processor_s(command: Sequence[str]) -> float:
    """User and system time of a command and of what it starts, s."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        command, check=True, stdout=subprocess.DEVNULL, env=kept
    )  # who keeps byte code imports in half the time
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def ratios(folder: Path, *, rounds: int) -> list[float]:
    """Scene over imports, turn by turn, printed."""
    found = []
    with tempfile.TemporaryDirectory() as out:
        hid2 = [sys.executable, "-m", "bridge.cli", "generate", str(folder), "--agents", "10", "-o", out, "-q"]
        for turn in range(rounds + 1):
            bare, scene = processor_s([sys.executable, "-c", IMPORTS]), processor_s(hid2)
            if turn > 0:  # the first one warms
                found.append(scene / bare)
                print(f"imports {bare:.2f} s, hid2 generate {scene:.2f} s: {scene / bare:.2f}", flush=True)
    print(f"median {statistics.median(found):.2f}")
    return found


@pytest.mark.benchmark
def test_starting_costs_little_more_than_the_libraries(real_scenes: list[Path]) -> None:
    (folder,) = (folder for folder in real_scenes if folder.name.startswith(SCENE))
    print()
    assert statistics.median(ratios(folder, rounds=ROUNDS)) <= MOST


if __name__ == "__main__":
    ratios(next((SHARED_DATA / "av2").glob(f"*/{SCENE}*")), rounds=ROUNDS)
