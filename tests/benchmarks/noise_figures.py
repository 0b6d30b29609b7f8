"""How well a critic tells inserted tracks by the noise of their columns, without and with `export.noise`. A script:

python tests/benchmarks/noise_figures.py [ROOT ...] --seeds 0 1 2 [--labelled]

Windows of 4 s of moving vehicles; a critic (gradient-boosted trees) judges a scene that it was not trained on. It sees
what smooth motion leaves over: of headings and velocities, of positions, or of all. Inserted and recorded windows weigh
the same in each scene. AUC .5: not told apart; beside it the recorded ones against themselves, halved by track.
"""

import argparse
from pathlib import Path

import numpy as np
from scipy.signal import savgol_filter
from shared_data import ROOTS, scenes_below, scores_of_trees
from sklearn.metrics import roc_auc_score

from bridge.generation.generate import generate, prepare
from hid2.agents import VEHICLE_TYPES, Track
from hid2.params import Config, Export, Request
from netconvert.geometry import wrap_angle

STEPS, EVERY, MOVES_MPS = 41, 20, 2.0
COLUMNS, PLACES = slice(0, 9), slice(9, 11)
NAMES = (
    "speed error", "its steps", "its jerks", "heading", "its steps", "its jerks", "slip", "off positions",
    "correlation", "along", "across",
)  # fmt: skip


def rms(values: np.ndarray) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))


def windows(track: Track, *, step_s: float) -> list[list[float]]:
    """Features of each window of a track: nine of headings and velocities, two of positions."""
    if track.timesteps.size < STEPS or (np.diff(track.timesteps) != 1).any():
        return []
    smooth = savgol_filter(track.position, 31, 4, axis=0)
    velocity = savgol_filter(track.position, 31, 4, deriv=1, delta=step_s, axis=0)
    speed, course = np.hypot(*velocity.T), np.arctan2(*velocity.T[::-1])
    stated, raw = np.hypot(*track.velocity.T), np.hypot(*np.gradient(track.position, step_s, axis=0).T)
    heading = np.unwrap(track.heading)
    off = wrap_angle(track.heading - course)
    slip = wrap_angle(np.arctan2(*track.velocity.T[::-1]) - track.heading)
    along = ((track.position - smooth) * velocity).sum(axis=1) / np.maximum(speed, 0.1)
    across = np.hypot(*(track.position - smooth).T)
    found = []
    for first in range(0, track.timesteps.size - STEPS + 1, EVERY):
        w = slice(first, first + STEPS)
        if speed[w].min() < MOVES_MPS:
            continue
        error, beside = stated[w] - speed[w], raw[w] - speed[w]
        found.append([
            rms(error), rms(np.diff(stated[w])), rms(np.diff(stated[w], 2)), rms(off[w]), rms(np.diff(heading[w])),
            rms(np.diff(heading[w], 2)), rms(slip[w]), rms(stated[w] - raw[w]),
            float((error * beside).mean() / (rms(error) * rms(beside) + 1e-9)), rms(along[w]), rms(across[w]),
        ])  # fmt: skip
    return found


def told_apart(features: np.ndarray, inserted: np.ndarray, scene: np.ndarray) -> float:
    """AUC over scenes, each judged by a critic of the others."""
    weight = np.zeros(len(inserted))
    for number in np.unique(scene):
        for kind in (False, True):
            rows = (scene == number) & (inserted == kind)
            weight[rows] = 1.0 / max(rows.sum(), 1)
    score = scores_of_trees(features, inserted, weight, scene, max_iter=100)
    return float(roc_auc_score(inserted, score, sample_weight=weight))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("roots", nargs="*", type=Path, default=ROOTS)
    parser.add_argument("--seeds", nargs="*", type=int, default=[0, 1, 2])
    parser.add_argument("--labelled", action="store_true", help="scenes that people labelled, not a tracker's")
    asked = parser.parse_args()
    provenance = "human" if asked.labelled else "tracker"
    scenes = [one for one in scenes_below(asked.roots) if one.provenance == provenance]
    recorded: list[tuple[int, int, list[float]]] = []
    for number, scene in enumerate(scenes):
        for row, track in enumerate(scene.tracks):
            if track.object_type in VEHICLE_TYPES and track.category > 0 and track.track_id != "AV":
                recorded += [(number, row, one) for one in windows(track, step_s=scene.step_s)]
    print(f"{len(scenes)} scenes, {len(recorded)} recorded windows")
    views = {"headings and velocities": COLUMNS, "positions": PLACES, "all": slice(0, 11)}
    for noise in ("none", "tracker"):
        made: list[tuple[int, list[float]]] = []
        for number, scene in enumerate(scenes):
            for seed in asked.seeds:
                config = Config(request=Request(seed=seed), export=Export(noise=noise))
                for track in generate(prepare(scene, config), config).generated:
                    made += [(number, one) for one in windows(track, step_s=scene.step_s)]
        features = np.array([*(one for _, _, one in recorded), *(one for _, one in made)])
        inserted = np.repeat([False, True], [len(recorded), len(made)])
        scene_of = np.array([*(number for number, _, _ in recorded), *(number for number, _ in made)])
        both = sorted({number for number, _, _ in recorded} & {number for number, _ in made})
        told = {name: told_apart(features[:, view], inserted, scene_of) for name, view in views.items()}
        print(f"{noise:8s} {len(made)} windows", {name: round(auc, 3) for name, auc in told.items()}, flush=True)
        medians = [
            np.mean([np.median(features[(inserted == kind) & (scene_of == number)], axis=0) for number in both], axis=0)
            for kind in (False, True)
        ]
        for row, name in enumerate(NAMES):
            auc = told_apart(features[:, [row]], inserted, scene_of)
            print(f"    {name:14s} recorded {medians[0][row]:.4f} inserted {medians[1][row]:.4f} alone {auc:.2f}")
    features = np.array([one for _, _, one in recorded])
    half = np.array([row % 2 == 1 for _, row, _ in recorded])
    scene_of = np.array([number for number, _, _ in recorded])
    print("control", {name: round(told_apart(features[:, view], half, scene_of), 3) for name, view in views.items()})


if __name__ == "__main__":
    main()
