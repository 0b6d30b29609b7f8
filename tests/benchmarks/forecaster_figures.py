"""What inserted vehicles without and with `export.noise` teach the small forecaster, on recorded tracks. A script:

python tests/benchmarks/forecaster_figures.py [ROOT ...] --variants 6 --updates 300 --seeds 0 1 2 3 4    # needs torch

Trained on recorded scenes alone; with as many variants of each in which inserted tracks are scored ones and have no
noise; the same with a tracker's. Each forecasts the scored and focal tracks of the recorded scenes of a part that it
was not trained on, without inserted ones. Differences are of the same tracks, intervals by drawing scenes again. A
table follows each seed.
"""

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from shared_data import ROOTS, scenes_below

from bridge.forecasting.experiment import small_forecaster
from bridge.generation.generate import generate, prepare
from bridge.recordings.scenario import MAX_STEPS
from hid2.agents import FloatArray
from hid2.measures.arrays import BoolArray
from hid2.params import Config, Export, Request
from hid2.resampling import ratio

SETS = ("recorded", "and inserted", "and inserted, noise")
NOISE = {"and inserted": "none", "and inserted, noise": "tracker"}
METRICS = ("minADE m", "minFDE m", "missed")


def errors(futures: FloatArray, truth: FloatArray) -> FloatArray:
    """(N, 3) METRICS of futures (N, K, 60, 2) m, of the mode that ends nearest."""
    apart = np.hypot(*np.moveaxis(futures - truth[:, None], -1, 0))
    best = apart[np.arange(len(apart)), apart[..., -1].argmin(axis=1)]
    return np.column_stack([best.mean(axis=1), best[:, -1], best[:, -1] > 2.0])


def told(values: FloatArray, scene: FloatArray) -> str:
    """The mean of values (N,) with its interval by drawing scenes again."""
    sums, counts = np.bincount(scene, values), np.bincount(scene)
    found = ratio(sums[counts > 0], counts[counts > 0].astype(float))
    return f"{found.value:7.3f} [{found.low:6.3f}, {found.high:6.3f}]"


def table(scores: dict[str, list[FloatArray]], kinds: dict[str, BoolArray], scene: FloatArray) -> Iterator[str]:
    """Lines of the means over the seeds so far, and of differences of the same tracks."""
    pairs = [(SETS[1], SETS[0]), (SETS[2], SETS[0]), (SETS[2], SETS[1])]
    for kind, rows in kinds.items():
        found = {name: np.array(each)[:, rows] for name, each in scores.items()}
        yield f"{kind}: {rows.sum()} recorded tracks, {len(scores[SETS[0]])} seeds"
        for k, metric in enumerate(METRICS):
            for name in SETS:
                yield f"  {metric:9s} {name:42s} {told(found[name][..., k].mean(axis=0), scene[rows])}"
            for one, other in pairs:
                apart = found[one][..., k] - found[other][..., k]
                seeds = " ".join(f"{value:.2f}" for value in apart.mean(axis=1))
                name = f"{one} minus {other}"
                yield f"  {metric:9s} {name:42s} {told(apart.mean(axis=0), scene[rows])}, by seed {seeds}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("roots", nargs="*", type=Path, default=ROOTS)
    parser.add_argument("--variants", type=int, default=6)
    parser.add_argument("--updates", type=int, default=300)
    parser.add_argument("--parts", type=int, default=4)
    parser.add_argument("--seeds", nargs="*", type=int, default=[0, 1, 2, 3, 4])
    asked = parser.parse_args()
    scenes_of, network = small_forecaster()
    import torch

    scenes = [one for one in scenes_below(asked.roots) if one.num_steps == MAX_STEPS]
    targets: dict[str, list[list]] = {name: [] for name in SETS}
    for scene in scenes:
        known = [one for one in scenes_of.targets_of(scene) if one.seen.future is not None]
        targets["recorded"].append(known)
        for name, noise in NOISE.items():
            config = Config(request=Request(generated_category=2), export=Export(noise=noise))
            prepared, found = prepare(scene, config), list(known)
            for variant in range(asked.variants):
                found += scenes_of.targets_of(generate(prepared, config, variant=variant).recording)
            targets[name].append(found)
    for name, each in targets.items():
        print(f"{name}: {len(scenes)} scenes, {sum(map(len, each))} targets", flush=True)
    judged = [(number, one) for number, found in enumerate(targets["recorded"]) for one in found]
    scene_of, focal = np.array([number for number, _ in judged]), np.array([one.focal for _, one in judged])
    moves = np.array(
        [np.hypot(*np.diff(one.seen.future, axis=0).T).sum() * scenes_of.UNIT_M > 5.0 for _, one in judged]
    )
    scores: dict[str, list[FloatArray]] = {name: [] for name in SETS}
    with tempfile.TemporaryDirectory() as place:
        for seed in asked.seeds:
            for name in SETS:
                found = np.zeros((len(judged), len(METRICS)))
                for part in range(asked.parts):
                    training = [t for k, each in enumerate(targets[name]) if k % asked.parts != part for t in each]
                    model = network.train(training, Path(place) / "checkpoint.pt", updates=asked.updates, seed=seed)
                    model.eval()
                    rows = np.flatnonzero(scene_of % asked.parts == part)
                    seen = [judged[row][1] for row in rows]
                    with torch.no_grad():
                        futures, _ = model(network._batch(seen))  # forecast() has focal ones alone
                    truth = np.stack([one.seen.future for one in seen]) * scenes_of.UNIT_M
                    found[rows] = errors(futures.cpu().numpy() * scenes_of.UNIT_M, truth)
                scores[name].append(found)
                print(f"seed {seed} {name:20s}", found.mean(axis=0).round(3), flush=True)
            kinds = {"all": np.ones(len(judged), bool), "moving": moves, "focal": focal}
            print("\n".join(table(scores, kinds, scene_of)), flush=True)


if __name__ == "__main__":
    main()
