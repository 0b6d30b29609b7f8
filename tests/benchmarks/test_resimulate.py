"""Simulated agents on the thirteen real scenes of 110 steps: scores over those of the reference, and what they cost.

Not part of the default run: `pytest -m benchmark -s`, or as a script with a number of seeds and a choice of scenes:

    PYTHONPATH=tests/support python tests/benchmarks/test_resimulate.py --seeds 32 [--only 00a 3b3]

    scene   reading, grid and net, and all rollouts with calibrated drivers, with their features; processor time
    limit   reading, grid, net, writing, and one simulation in which all others are replayed and the vehicles are driven
            by SUMO unsteered (test_time_over_limit.py)
    over    scene over limit, for each seed
"""

import argparse
import csv
import statistics
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest
from shared_data import SHARED_DATA
from unsteered import Start, simulate_unsteered

from bridge.evaluation.resimulate import MODELS, Resimulation, ResimulationPlan, resimulate_folders
from bridge.recordings.folders import find_scenarios
from bridge.recordings.scenario import read_scenario
from bridge.sumo.poses import front_arc_m, sumo_poses
from bridge.sumo.steering import edges_along
from hid2.evaluation.likelihood import LAST, NOW, beyond_edge, features
from hid2.evaluation.resimulated import begin, own_path
from hid2.params import Config
from hid2.policy.roads import Roads
from hid2.scene import build_scene
from netconvert.cells import build_cell_grid
from netconvert.net_xml import net_bytes

#: Scores over the reference's, at least, and over constant velocity's; time over the limit for each seed, at most.
KINEMATICS, NEAREST, OVER = 0.97, 0.97, 1.0


def scenes_of(shared: Path, only: tuple[str, ...] = ("",)) -> list[Path]:
    """The scenes that are long enough."""
    found = [folder for name in ("av2", "wide") for folder in find_scenarios(shared / name)]
    return [one for one in found if one.name.startswith(only) and read_scenario(one).num_steps > LAST]


def cost(folder: Path, seeds: int) -> tuple[float, float]:
    """Processor time of the rollouts of a scene, and of its limit, s."""
    began = time.process_time()
    made, config = Resimulation(read_scenario(folder)), Config()
    rows, beyond = np.array([one.row for one in made.vehicles]), beyond_edge(made.recording.graph)
    rollout = made.logged
    for rollout in made.rollouts(config, seeds, model="calibrated", vehicles=made.vehicles):
        features(rollout, rows, beyond, step_s=0.1)
    scene_s = time.process_time() - began
    scene = build_scene(
        build_cell_grid(made.recording.graph), [], config=config, num_steps=100, step_s=0.1, last_observed_step=39
    )
    starts = []
    for one in made.vehicles:
        start = begin(scene, Roads(scene), one, own_path(scene, one), np.random.default_rng(0), number=0, usual_mps=8.0)
        front = front_arc_m(start.start_s, start.size.length_m)
        segment = start.path.segment_at(front)
        cell = scene.grid.cell_at(segment.lane_id, segment.lane_s(front))
        edges = edges_along(scene, start.path, cell)
        assert edges is not None
        starts.append(Start(edges, scene.grid.lane_index(cell), 0.1, start.start_mps))
    others = made.logged.rows([row for row in range(len(made.logged.ids)) if row not in rows]).span(slice(NOW, None))
    front, angle = sumo_poses(others.position, others.heading, others.length_m[:, None])
    with tempfile.TemporaryDirectory() as beside:
        began = time.process_time()
        net = Path(beside) / "scene.net.xml"
        net.write_bytes(net_bytes(build_cell_grid(read_scenario(folder).graph)))
        simulate_unsteered(net, others, front, angle, starts)
        made.write(rollout, config, 0, Path(beside))
        return scene_s, time.process_time() - began


def scores(folders: list[Path], seeds: int, out: Path) -> dict[str, dict[str, float]]:
    """Mean scores over scenes by model and feature, cross-fitted."""
    assert resimulate_folders(folders, out, ResimulationPlan(seeds)) == []
    with (out / "scores.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    names = [name for name in rows[0] if name not in {"scene", "model"}]
    return {
        model: {name: statistics.mean(float(row[name]) for row in rows if row["model"] == model) for name in names}
        for model in MODELS
    }


@pytest.mark.benchmark
@pytest.mark.timeout(3600)
def test_scores_beside_the_reference_and_the_cost(shared_data: Path, tmp_path: Path) -> None:
    folders = scenes_of(shared_data)
    assert len(folders) == 13
    found = scores(folders, 32, tmp_path / "out")
    ours, reference = found["calibrated"], found["reference"]
    assert ours["all of kinematics"] >= KINEMATICS * reference["all of kinematics"]
    nearest = next(name for name in ours if name.startswith("distance to the nearest"))
    assert ours[nearest] >= NEAREST * reference[nearest]
    assert ours["sum"] > found["constant velocity"]["sum"]
    assert ours["sum"] > found["default"]["sum"]
    cost(folders[0], 1)
    timed = [cost(folder, 32) for folder in folders]
    assert sum(scene for scene, _ in timed) <= 32 * OVER * sum(limit for _, limit in timed)


def main() -> None:
    """Print scores and cost."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--seeds", type=int, default=32)
    parser.add_argument("--only", nargs="+", default=[""], help="scenes whose id begins with one of these")
    parser.add_argument("--cost", action="store_true", help="the cost alone")
    options = parser.parse_args()
    folders = scenes_of(SHARED_DATA, tuple(options.only))
    cost(folders[0], 1)
    timed = [cost(folder, options.seeds) for folder in folders]
    for folder, (scene_s, limit_s) in zip(folders, timed, strict=True):
        over = scene_s / limit_s / options.seeds
        print(f"{folder.name[:8]} scene {scene_s:7.2f} s  limit {limit_s:6.3f} s  over {over:5.2f}")
    every, limits = (sum(column) for column in zip(*timed, strict=True))
    print(f"all      scene {every:7.2f} s  limit {limits:6.3f} s  over {every / limits / options.seeds:5.2f}")
    if options.cost:
        return
    with tempfile.TemporaryDirectory() as out:
        for model, by_name in scores(folders, options.seeds, Path(out)).items():
            print(f"{model:18}", "  ".join(f"{name.split(',')[0]} {value:.3f}" for name, value in by_name.items()))


if __name__ == "__main__":
    main()
