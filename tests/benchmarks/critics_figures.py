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
from bridge.evaluation.calibrate import observe_scene, pooled
from bridge.generation.generate import generate, prepare
from bridge.recordings.folders import find_scenarios
from bridge.recordings.scenario import read_scenario
from hid2.evaluation.calibration import calibrate, drivers_of
from hid2.evaluation.critics import (
    JUDGED,
    WIDTH,
    Packed,
    betrayals,
    constant_on_the_middle,
    halves_apart,
    judge,
    pack,
)
from hid2.evaluation.realism import RealismCounts, count_scene, half_number, scene_values
from hid2.evaluation.safety import safety
from hid2.evaluation.windows import windows
from hid2.measures.arrays import stack
from hid2.measures.lane_matching import flatten_lanes
from hid2.measures.manoeuvres import ManeuverKind, detect
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
        self.rows, self.generated, self.scene = [np.zeros((0, WIDTH))], [np.zeros(0, bool)], [np.zeros(0, int)]
        self.realism = RealismCounts()
        self.offsets: list[tuple[bool, float]] = []
        self.durations: list[float] = []
        self.accelerations: dict[bool, list[np.ndarray]] = {False: [], True: []}

    def add(self, number: int, name: str, tracks, *, graph, num_steps: int, labelled: bool, first: bool) -> None:
        """Take the recorded tracks of a source in (first), or the generated ones of a scene made from it."""
        arrays = stack(tracks, num_steps=num_steps, step_s=0.1)
        lanes = flatten_lanes(graph)
        safe = safety(arrays, lanes)
        members = arrays.vehicle & arrays.moving & ~(arrays.fragment & ~arrays.generated)
        found = windows(arrays, safe, members)
        halves = np.array([half_number(name, arrays.track_ids[a]) for a in found.agent], dtype=np.int64)
        generated = arrays.generated[found.agent]
        kept = generated | first
        packed = pack(found, halves, labelled=labelled)
        self.rows.append(packed[kept])
        self.generated.append(generated[kept])
        self.scene.append(np.full(int(kept.sum()), number))
        seen = [m for m in detect(arrays, safe.lanes, safe.matches) if m.kind is ManeuverKind.LANE_CHANGE]
        durations = {m.track_id: [m.duration_s] for m in seen if m.complete}
        self.durations += [m.duration_s for m in seen if m.complete and m.track_id.startswith("gen_")]
        values = scene_values(arrays, safe, found, durations)
        kinds = {"generated": arrays.generated & members, "recorded": ~arrays.generated & members}
        self.realism.add(count_scene(name, arrays, values, **kinds), generated=not first, recorded=first)
        for agent in np.flatnonzero(members & (arrays.generated | first)):
            self.accelerations[bool(arrays.generated[agent])].append(
                accelerations(arrays.position[arrays.agent == agent])
            )
        for agent in np.unique(found.agent):
            own = found.rows(found.agent == agent)
            if arrays.generated[agent] or first:
                self.offsets.append((bool(arrays.generated[agent]), float(np.mean(own.d_parabola[:, 0]))))

    def report(self, *, controls: bool, most: int = 4000) -> None:
        found = Packed(np.concatenate(self.rows), np.concatenate(self.generated), np.concatenate(self.scene))
        drawn = np.random.default_rng(0).permutation(np.flatnonzero(found.generated))[most:]
        kept = np.ones(len(found.rows), dtype=bool)
        kept[drawn] = False
        found = found.of(kept)
        kinds = [("all scenes", found)]
        kinds += [(name, found.of(found.labelled == k)) for name, k in (("labelled", 1.0), ("tracker", 0.0))]
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
        for name, mask in (("generated", found.generated), ("recorded", ~found.generated)):
            rows = found.rows[mask]
            a, j = 2 * rows[:, 1], 6 * rows[:, 2]
            led = rows[:, 19] > 0
            const = (np.abs(a - 2 * j) < 0.05) & (np.abs(a + 2 * j) < 0.05) & (np.abs(j) < 0.05)
            offsets = [d for generated, d in self.offsets if generated == (name == "generated")]
            low, high = np.percentile(a, [5, 95])
            print(f"{name:10s} {len(rows)} constant {const.mean():.3f} accel 5/95 {low:.2f} {high:.2f} "
                  f"sd a {a.std():.2f} sd j {j.std():.2f} median |d| {np.median(np.abs(rows[:, 7])):.2f} "
                  f"sd between {np.std(offsets):.2f} drift sd {rows[:, 8].std():.3f} bend sd {rows[:, 9].std():.3f} "
                  f"corr a, closing {np.corrcoef(a[led], -rows[led, 17])[0, 1]:.2f} led {led.mean():.2f}")  # fmt: skip
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
            found = calibrate(*pooled([*seen[:number], *seen[number + 1 :]]), prior=Drivers())
            flags |= {f"drivers.{name}": value for name, value in drivers_of(found).items()}
        config = load_config(options.config, options.settings, flags)
        prepared = prepare(read_scenario(folder), config)
        recorded = prepared.scenario
        common = {"graph": recorded.graph, "num_steps": recorded.num_steps, "labelled": recorded.provenance == "human"}
        figures.add(number, recorded.scenario_id, recorded.tracks, first=True, **common)
        for variant in range(options.variants):
            scene = generate(prepared, config, variant=variant)
            placed.append(len(scene.generated))
            figures.add(number, recorded.scenario_id, [*recorded.tracks, *scene.generated], first=False, **common)
    print(f"placed {sum(placed)} in {len(placed)} scenes")
    figures.report(controls=options.controls)


if __name__ == "__main__":
    main()
