"""Scenes per second by the number of workers, on the real scenes; memory over many scenes is in ten_thousand.py.

Not part of the default run: `pytest -m benchmark -s`, or as a script:

    python tests/benchmarks/test_batch_speed.py --agents 10 20 40 --scenes 240

Speed counts from the first scene that is done to the last, so that starting processes and compiling is left out; it
wants idle cores, but for the rate per second of processor time.
"""

import argparse
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import psutil
import pytest
from shared_data import SHARED_DATA

from bridge.batch.batch import Options, Progress, Run, SceneJob, run_batch
from bridge.batch.manifest import ManifestRow
from bridge.recordings.sources import find_scenarios
from hid2.params import Config, Request

LEAST_SPEED_UP = 1.8


def jobs_for(folders: Sequence[Path], *, scenes: int, agents: int) -> list[SceneJob]:
    """Single runs on the folders in turn, each with a seed of its own."""
    return [
        SceneJob(folders[k % len(folders)], (Run(Config(request=Request(agents=agents, seed=k // len(folders)))),))
        for k in range(scenes)
    ]


class Rate(NamedTuple):
    """Scenes per second on the wall, and per second of processor time of all processes together."""

    wall: float
    processor: float


def scenes_per_second(folders: Sequence[Path], *, scenes: int, agents: int, workers: int) -> Rate:
    """Rate of a batch, without its start: every worker is warm when a quarter of the scenes are done."""
    times: list[tuple[float, float]] = []

    def sample(row: ManifestRow, progress: Progress) -> None:
        everybody = [psutil.Process(), *psutil.Process().children(recursive=True)]
        spent = sum(sum(process.cpu_times()[:2]) for process in everybody)
        times.append((time.monotonic(), spent))

    with tempfile.TemporaryDirectory(prefix="hid2-speed-") as out:
        rows = run_batch(
            jobs_for(folders, scenes=scenes, agents=agents), Path(out), Options(jobs=workers), on_row=sample
        )
    assert {row.status for row in rows} == {"done"}
    skipped = max(len(folders), scenes // 4)
    (began, spent_before), (ended, spent) = times[skipped], times[-1]
    return Rate(*((scenes - 1 - skipped) / seconds for seconds in (ended - began, spent - spent_before)))


@pytest.mark.benchmark
@pytest.mark.timeout(3000)
def test_two_workers_are_nearly_twice_as_fast(real_scenes: list[Path]) -> None:
    one = scenes_per_second(real_scenes, scenes=60, agents=10, workers=1)
    two = scenes_per_second(real_scenes, scenes=120, agents=10, workers=2)
    print(f"\nscenes/s: {one.wall:.2f} with one worker, {two.wall:.2f} with two, ratio {two.wall / one.wall:.2f}")
    assert two.wall / one.wall >= LEAST_SPEED_UP


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--root", type=Path, default=None, help="data set (default: the real scenes)")
    parser.add_argument("--scenes", type=int, default=120)
    parser.add_argument("--agents", type=int, nargs="+", default=[10])
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    arguments = parser.parse_args()
    folders = find_scenarios(arguments.root or SHARED_DATA / "av2")
    for agents in arguments.agents:
        rates = [
            scenes_per_second(folders, scenes=arguments.scenes, agents=agents, workers=workers)
            for workers in arguments.workers
        ]
        words = ", ".join(
            f"{rate.wall:.2f}/s ({rate.processor:.2f} per processor second) with {n}"
            for n, rate in zip(arguments.workers, rates, strict=True)
        )
        print(f"{agents} vehicles: {words}; ratio {rates[-1].wall / rates[0].wall:.2f}", flush=True)


if __name__ == "__main__":
    main()
