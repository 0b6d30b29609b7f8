"""What critics make of inserted vehicles on real scenes, generated here and not written. A script, no test:

python tests/benchmarks/critics_figures.py --variants 20 --seed 0 [--set drivers.desired_sd=0.2] [ROOT]
python tests/benchmarks/critics_figures.py --config data/configs/sumo_default_drivers.toml    # positive control
python tests/benchmarks/critics_figures.py --leave-one-out    # each scene's drivers are calibrated on the others
"""

import argparse
from pathlib import Path

import numpy as np
from scipy.signal import savgol_filter
from shared_data import SHARED_DATA

from bridge.config import load_config
from bridge.evaluation.calibrate import observe_scene
from bridge.generation.generate import generate, prepare
from bridge.recordings.folders import find_scenarios
from bridge.recordings.scenario import read_scenario
from hid2.evaluation.calibration import calibrate, drivers_of
from hid2.evaluation.critics import (
    JUDGED,
    betrayals,
    constant_on_the_middle,
    halves_apart,
    judge,
)
from hid2.evaluation.realism import RealismCounts, count_scene
from hid2.evaluation.safety import safety
from hid2.evaluation.windows import compared, windows
from hid2.measures.lane_matching import flatten_lanes
from hid2.measures.manoeuvres import detect, whole_lane_changes
from hid2.occupancy.agent_states import agent_states
from hid2.params import Drivers


def accelerations(position: np.ndarray, *, over: int = 11) -> np.ndarray:
    """Accelerations (K,) along the way at the steps of a track in which it moves, without its first and last second.

    position (T, 2); parabolas over so many steps: noise of a tracker does not decide, nor does a fit of seconds.
    """
    if len(position) < 40:
        return np.zeros(0)
    smooth = savgol_filter(position, over, 2, axis=0)
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(smooth, axis=0).T))])
    speed, found = (savgol_filter(s, over, 2, deriv=k, delta=0.1)[10:-10] for k in (1, 2))
    return found[speed > 0.5]


class Figures:
    """Windows, histograms and vehicles of all scenes."""

    def __init__(self) -> None:
        self.windows: list[np.ndarray] = []
        self.realism = RealismCounts()
        self.offsets: list[tuple[bool, float]] = []
        self.durations: list[float] = []
        self.accelerations: dict[bool, list[np.ndarray]] = {False: [], True: []}

    def add(self, name: str, tracks, *, graph, num_steps: int, labelled: bool, first: bool) -> None:
        """Take the recorded tracks of a source in (first), or the generated ones of a scene made from it."""
        states = agent_states(tracks, flatten_lanes(graph), num_steps=num_steps, step_s=0.1)
        arrays = states.arrays
        safe = safety(states.view)
        found = windows(states.view, safe.leaders, scene=name, labelled=labelled)
        self.windows.append(found[found["generated"] | first])
        seen = detect(arrays, states.lanes, states.matches)
        self.durations += [m.duration_s for m in whole_lane_changes(seen) if m.track_id.startswith("gen_")]
        self.realism.add(count_scene(arrays, safe, found, seen, scene=name), generated=not first, recorded=first)
        for agent in np.flatnonzero(compared(arrays) & (arrays.generated | first)):
            self.accelerations[bool(arrays.generated[agent])].append(
                accelerations(arrays.position[arrays.agent == agent])
            )
        for agent in np.unique(found["agent"]):
            if arrays.generated[agent] or first:
                offset_m = float(np.mean(found["offset_m"][found["agent"] == agent]))
                self.offsets.append((bool(arrays.generated[agent]), offset_m))

    def report(self, *, controls: bool, most: int = 4000) -> None:
        found = np.concatenate(self.windows)
        drawn = np.random.default_rng(0).permutation(np.flatnonzero(found["generated"]))[most:]
        found = np.delete(found, drawn)
        kinds = [("all scenes", found)]
        kinds += [(name, found[found["labelled"] == k]) for name, k in (("labelled", True), ("tracker", False))]
        for name, part in kinds:
            for critic, view in JUDGED:
                verdict = judge(part, critic, view)
                if verdict is not None:
                    print(f"{name:12s} {critic:9s} {view:8s} {verdict.auc:.3f} [{verdict.low:.2f}, {verdict.high:.2f}] "
                          f"{verdict.generated} {verdict.recorded} in {verdict.scenes}")  # fmt: skip
        if controls:
            for critic, view in JUDGED:
                constant = judge(constant_on_the_middle(found), critic, view)
                apart = [judge(halves_apart(found, k), critic, view) for k in range(4)]
                known = np.mean([(a.auc, a.low, a.high) for a in apart if a], axis=0)
                print(f"controls     {critic:9s} {view:8s} constant {constant.auc:.3f}, recorded against recorded "
                      f"{known[0]:.3f} [{known[1]:.2f}, {known[2]:.2f}]")  # fmt: skip
        print("betrays:", ", ".join(f"{name} {auc:.2f}" for name, auc in betrayals(found)[:9]))
        for name in ("generated", "recorded"):
            rows = found[found["generated"] == (name == "generated")]
            a, j, d, led = rows["accel_mps2"], rows["jerk_mps3"], rows["offset_m"], rows["led"]
            drift, bend, closing = rows["drift_mps"], rows["bend_mps2"], rows["closing_mps"]
            const = (np.abs(a - 2 * j) < 0.05) & (np.abs(a + 2 * j) < 0.05) & (np.abs(j) < 0.05)
            offsets = [d for generated, d in self.offsets if generated == (name == "generated")]
            low, high = np.percentile(a, [5, 95])
            print(f"{name:10s} {len(rows)} constant {const.mean():.3f} accel 5/95 {low:.2f} {high:.2f} "
                  f"sd a {a.std():.2f} sd j {j.std():.2f} median |d| {np.median(np.abs(d)):.2f} "
                  f"sd between {np.std(offsets):.2f} drift sd {drift.std():.3f} bend sd {bend.std():.3f} "
                  f"corr a, closing {np.corrcoef(a[led], -closing[led])[0, 1]:.2f} led {led.mean():.2f}")  # fmt: skip
        for name, own in (("generated", self.accelerations[True]), ("recorded", self.accelerations[False])):
            low, high = np.percentile(np.concatenate(own), [5, 95])
            print(f"{name:10s} accelerations at every step 5/95 {low:.2f} {high:.2f}")
        for d in self.realism.distances():
            if d.jensen_shannon is not None and d.jensen_shannon_floor:
                ratio, n = d.jensen_shannon / d.jensen_shannon_floor, f"{d.generated_samples} {d.recorded_samples}"
                print(f"JS {d.feature:20s} {d.jensen_shannon:.3f} ratio {ratio:.2f} n {n}")
        print(f"lane changes {len(self.durations)}, median duration {np.median(self.durations):.2f} s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--variants", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--set", dest="settings", action="append", default=[])
    parser.add_argument("--config", type=Path)
    parser.add_argument("--leave-one-out", action="store_true")
    parser.add_argument("--controls", action="store_true")
    parser.add_argument("root", type=Path, nargs="?", help="data-set root, by default the shared real scenes")
    options = parser.parse_args()
    figures = Figures()
    placed = []
    folders = find_scenarios(options.root or SHARED_DATA / "av2")
    seen = [observe_scene(None, folder) for folder in folders] if options.leave_one_out else []
    for number, folder in enumerate(folders):
        flags: dict[str, object] = {"request.seed": options.seed}
        if seen:
            found = calibrate([*seen[:number], *seen[number + 1 :]], prior=Drivers())
            flags |= {f"drivers.{name}": value for name, value in drivers_of(found).items()}
        config = load_config(options.config, options.settings, flags)
        prepared = prepare(read_scenario(folder), config)
        recorded = prepared.scenario
        common = {"graph": recorded.graph, "num_steps": recorded.num_steps, "labelled": recorded.provenance == "human"}
        figures.add(recorded.scenario_id, recorded.tracks, first=True, **common)
        for variant in range(options.variants):
            scene = generate(prepared, config, variant=variant)
            placed.append(len(scene.generated))
            figures.add(recorded.scenario_id, [*recorded.tracks, *scene.generated], first=False, **common)
    print(f"placed {sum(placed)} in {len(placed)} scenes")
    figures.report(controls=options.controls)


if __name__ == "__main__":
    main()
