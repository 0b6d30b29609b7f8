"""Memory and time of `hid2 evaluate` by the number of scenes, main process and measuring process apart.

Not part of the default run: `pytest -m benchmark -s`.

Few scenes are generated on the real scenes and linked under many names. Growth is taken from the peaks of separate runs
over different numbers of scenes: within a run, sizes move with the map at hand.
"""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import pytest

from bridge.batch.batch import Options, Run, SceneJob, run_batch
from bridge.recordings.scenario import find_scenarios
from hid2.params import Config, Request

#: How much the two processes may grow with each scene: a name takes some 0.4 kB, the rest is for noise.
MOST_KB_PER_SCENE = 2.0
VARIANTS = 10
AGENTS = 5

_MEASURE = """
import json, resource, sys, time
from pathlib import Path
import psutil
from bridge.evaluation.evaluate import evaluate_folder
me, child, main = psutil.Process(), 0, 0
def sample(done, total):
    global child, main
    if done % 20 == 0 or done == total:
        main = max(main, me.memory_info().rss)
        child = max([child, *(process.memory_info().rss for process in me.children(recursive=True))])
began = time.monotonic()
evaluate_folder(Path(sys.argv[1]), report_dir=Path(sys.argv[2]), on_scene=sample)
print(json.dumps([main / 1e6, child / 1e6, time.monotonic() - began]))
"""


class Size(NamedTuple):
    """Largest resident MB of the main process and of a measuring process while scenes are measured, and seconds."""

    main: float
    child: float
    seconds: float


def make_scenes(sources: Sequence[Path], out: Path) -> list[Path]:
    """Generate VARIANTS scenes on each source scene."""
    runs = tuple(Run(Config(request=Request(agents=AGENTS, seed=seed))) for seed in range(VARIANTS))
    rows = run_batch([SceneJob(folder, runs) for folder in sources], out, Options())
    assert {row.status for row in rows} == {"done"}
    return find_scenarios(out)


def measure_many(folders: Sequence[Path], out: Path, *, scenes: int) -> Size:
    """Evaluate `scenes` links to the folders."""
    for number in range(scenes):
        source = folders[number % len(folders)]
        folder = out / "train" / f"{source.name[:24]}{number:012d}"
        folder.mkdir(parents=True)
        for path in source.iterdir():
            os.link(path, folder / path.name)
    command = [sys.executable, "-c", _MEASURE, str(out), str(out.parent / f"report-{scenes}")]
    result = subprocess.run(command, check=True, capture_output=True, text=True)
    return Size(*json.loads(result.stdout.splitlines()[-1]))


def growth_kb(few: Size, many: Size, *, scenes: int) -> tuple[float, float]:
    """Growth for each further scene, kB: main process, measuring process."""
    return (many.main - few.main) / scenes * 1e3, (many.child - few.child) / scenes * 1e3


@pytest.mark.benchmark
@pytest.mark.timeout(3000)
def test_memory_of_an_evaluation_does_not_grow_with_scenes(real_scenes: list[Path], tmp_path: Path) -> None:
    folders = make_scenes(real_scenes, tmp_path / "made")
    few, many = (measure_many(folders, tmp_path / str(n), scenes=n) for n in (200, 1200))
    main, child = growth_kb(few, many, scenes=1000)
    print(f"\n{few} of 200 scenes, {many} of 1200: {main:.2f} and {child:.2f} kB for each further scene")
    assert main <= MOST_KB_PER_SCENE
    assert child <= MOST_KB_PER_SCENE
