"""Simulated agents on the thirteen real scenes of 110 steps: scores over those of the reference, and what they cost.

Not part of the default run: `pytest -m benchmark -s`.

    scene   reading, grid and net, and all rollouts with calibrated drivers, with their features; processor time
    limit   reading, grid, net, writing, and one simulation in which all others are replayed and the vehicles are driven
            by SUMO unsteered (test_time_over_limit.py)
    over    scene over limit, for each seed
"""

import csv
import statistics
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from unsteered import simulate_unsteered, unsteered_start

from bridge.evaluation.resimulate import MODELS, Resimulation, ResimulationPlan, resimulate_folders
from bridge.recordings.scenario import read_scenario
from bridge.recordings.sources import find_scenarios
from bridge.sumo.poses import sumo_poses
from hid2.evaluation.likelihood import LAST, NOW, beyond_edge, features
from hid2.evaluation.resimulated import begin, own_path
from hid2.params import Config
from hid2.policy.roads import Roads
from hid2.scene import build_scene
from netconvert.cells import build_cell_grid
from netconvert.net_xml import net_bytes

#: Scores over the reference's, at least, and over constant velocity's; time over the limit for each seed, at most.
KINEMATICS, NEAREST, OVER = 0.97, 0.97, 1.0


def scenes_of(shared: Path) -> list[Path]:
    """The scenes that are long enough."""
    found = [folder for name in ("av2", "wide") for folder in find_scenarios(shared / name)]
    return [one for one in found if read_scenario(one).num_steps > LAST]


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
        begun = begin(scene, Roads(scene), one, own_path(scene, one), np.random.default_rng(0), number=0, usual_mps=8.0)
        starts.append(replace(unsteered_start(scene, begun), front_m=0.1))
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
