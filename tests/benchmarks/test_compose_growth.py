"""Time and memory of `hid2 compose` by the number of scenes: stand-ins with ids and places of their own.

.venv/bin/pytest -m benchmark -s tests/benchmarks/test_compose_growth.py
"""

import json
import resource
import sys
import time
import uuid
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from bridge.recordings.scenario import read_scenario

#: Scenes of the smaller and the larger composition; the larger is the paper's.
FEW, MANY = 5_500, 55_000
#: What the larger one may take: processor seconds for each scene, and memory beside the smaller one's.
CPU_S, MORE_MB = 0.01, 250


def stand_ins(template: Path, root: Path, number: int) -> None:
    """Scenes of five tracks whose ids and places differ: the bytes of one with its id and its lane replaced."""
    scenario = read_scenario(template)
    keep = {scenario.focal_track_id, "AV", *(track.track_id for track in scenario.tracks[:3])}
    table = scenario.table.filter(pa.compute.is_in(scenario.table.column("track_id"), pa.array(sorted(keep))))
    sink = pa.BufferOutputStream()
    pq.write_table(table.drop_columns(["slice_id"]), sink, compression="none")
    rows, old = sink.getvalue().to_pybytes(), scenario.scenario_id.encode()
    for index in range(number):
        new = str(uuid.UUID(int=index + 1))
        folder = root / "train" / new
        folder.mkdir(parents=True)
        (folder / f"scenario_{new}.parquet").write_bytes(rows.replace(old, new.encode()))
        x, y = 300.0 * (index % 250), 300.0 * (index // 250)
        line = [{"x": x + 10 * step, "y": y, "z": 0.0} for step in range(10)]
        lane = {"centerline": line, "left_lane_boundary": line, "right_lane_boundary": line}
        (folder / f"log_map_archive_{new}.json").write_text(json.dumps({"lane_segments": {"1": lane}}))


CODE = """
import resource, sys
from bridge.cli import main
try:
    main()
finally:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    cpu = sum(one.ru_utime + one.ru_stime for one in used)
    print("used", cpu, max(one.ru_maxrss for one in used) / 1024, file=sys.stderr)
"""


def measured(root: Path, out: Path, *, jobs: int) -> tuple[float, float, float]:
    """Seconds on the clock and of processors, and MB at most of one process."""
    import subprocess

    began = time.monotonic()
    command = [sys.executable, "-c", CODE, "compose", str(root), "-o", str(out), "-j", str(jobs), "-q"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    _, cpu, memory = done.stderr.split()[-3:]
    return time.monotonic() - began, float(cpu), float(memory)


@pytest.mark.benchmark
@pytest.mark.timeout(7200)
def test_a_root_of_55000_scenes_takes_minutes_and_flat_memory(data_scenes, tmp_path):
    found = {}
    for number in (FEW, MANY):
        stand_ins(data_scenes["arterial"], tmp_path / f"source{number}", number)
        found[number] = measured(tmp_path / f"source{number}", tmp_path / f"root{number}", jobs=2)
        seconds, cpu, memory = found[number]
        print(f"{number} scenes: {seconds:.0f} s, {cpu:.0f} s of processors, {memory:.0f} MB")
    made = sum(1 for split in ("train", "val") for _ in (tmp_path / f"root{MANY}" / split).iterdir())
    print(f"{made} of {MANY} scenes in the root; the others lie beside one held out")
    print(f"own peak: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")
    assert made > 0.8 * MANY
    assert found[MANY][1] < CPU_S * MANY
    assert found[MANY][2] < found[FEW][2] + MORE_MB
