"""Where lane changes of inserted vehicles are, how many enter, are near a target or repeat another variant. A script:

python tests/benchmarks/encounters_figures.py --variants 20 --seed 0 [--near focal --within 50] [--set ...] [ROOT]

What they meet beside recorded ones is in the report of `hid2 evaluate`.
"""

import argparse
import itertools
from pathlib import Path

import numpy as np
from shared_data import SHARED_DATA

from bridge.config import load_config
from bridge.generation.generate import generate, prepare
from bridge.generation.scene import TrafficScene
from bridge.recordings.scenario import read_scenario
from bridge.recordings.sources import find_scenarios

#: Vehicles of two variants are twins where they start and are 5 s later this near to each other, m.
TWIN_START_M, TWIN_LATER_M, LATER_S = 3.0, 5.0, 5.0
#: So near to the focal track or the recording vehicle a lane change is an encounter, m.
FOCAL_M = 50.0


def changes_near(scene: TrafficScene) -> list[float]:
    """Of each lane change that was done, m from the focal track or the recording vehicle as it crosses."""
    tracks = {track.track_id: track for track in scene.recording.tracks}
    found, done = [], scene.maneuvers.query("kind == 'lane_change' and status == 'done'")
    for track_id, crossing_s in zip(done["track_id"], done["crossing_s"], strict=True):
        step = round(crossing_s / scene.recording.step_s)
        own, *others = (
            tracks[one].position[tracks[one].timesteps == step]
            for one in (track_id, scene.recording.focal_track_id, "AV")
        )
        apart = [float(np.hypot(*(other - own)[0])) for other in others if len(other) and len(own)]
        found.append(min(apart, default=np.inf))
    return found


def twins(one: np.ndarray, other: np.ndarray) -> float:
    """Share of the vehicles of a variant, starts and later places (N, 2, 2), that have a twin in another one."""
    if not len(one) or not len(other):
        return 0.0
    apart = np.linalg.norm(one[:, None] - other[None], axis=-1)
    return float(((apart[..., 0] < TWIN_START_M) & (apart[..., 1] < TWIN_LATER_M)).any(axis=1).mean())


def near(scene: TrafficScene, target: str, within_m: float) -> int:
    """Inserted vehicles within a distance of a target at the last observed step."""
    step, tracks = scene.source.last_observed, {track.track_id: track for track in scene.recording.tracks}
    place = tracks[target].position[tracks[target].timesteps == step]
    own = [one.position[one.timesteps == step] for one in scene.generated]
    return sum(bool(len(one) and np.hypot(*(one - place)[0]) <= within_m) for one in own)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--variants", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--near", default="traffic")
    parser.add_argument("--within", type=float, default=30.0)
    parser.add_argument("--set", dest="settings", action="append", default=[])
    parser.add_argument("root", type=Path, nargs="?", help="data-set root, by default the shared real scenes")
    options = parser.parse_args()
    asked = {"request.seed": options.seed, "request.near": options.near, "request.within_m": options.within}
    config = load_config(None, options.settings, asked)
    changes: list[float] = []
    enters: list[bool] = []
    for folder in find_scenarios(options.root or SHARED_DATA / "av2"):
        recording = read_scenario(folder)
        prepared, starts, count = prepare(recording, config), [], []
        later = min(round(LATER_S / recording.step_s), recording.num_steps - 1)  # some scenes last for 5 s
        target = {"av": "AV", "focal": recording.focal_track_id}.get(options.near)
        for variant in range(options.variants):
            scene = generate(prepared, config, variant=variant)
            changes += changes_near(scene)
            enters += [bool(track.timesteps[0] > 0) for track in scene.generated]
            ends = [(t.position[0], t.position[later]) for t in scene.generated if len(t.timesteps) > later]
            starts.append(np.array(ends).reshape(-1, 2, 2))
            count += [near(scene, target, options.within)] if target is not None else []
        pairs = [twins(one, other) for one, other in itertools.permutations(starts, 2)]
        said = f"; near {np.median(count):g} (median), {min(count)} .. {max(count)}" if count else ""
        print(f"{folder.name[:8]} twins {np.mean(pairs) if pairs else float('nan'):.3f}{said}", flush=True)
    within = np.array(changes) <= FOCAL_M
    print(f"{within.size} lane changes done, {within.sum()} within {FOCAL_M:g} m of the focal track or the AV")
    print(f"{np.mean(enters):.3f} of the inserted enter during the scene")


if __name__ == "__main__":
    main()
