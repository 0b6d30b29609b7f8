"""What becomes of inserted vehicles on real scenes: counts, manoeuvres, limits. A script, no test:

python tests/benchmarks/driving_figures.py --agents 10 --seeds 10 [ROOT]
"""

import argparse
import time
from collections import Counter
from pathlib import Path

import numpy as np
from shared_data import SHARED_DATA

from bridge.generation.generate import generate, prepare
from bridge.generation.scene import TrafficScene
from bridge.recordings.scenario import read_scenario
from bridge.recordings.sources import find_scenarios
from hid2.params import Config, Request


class Figures:
    """Sums over scenes."""

    def __init__(self) -> None:
        self.manoeuvres: Counter[tuple[str, str]] = Counter()
        self.reasons: Counter[tuple[str, str]] = Counter()
        self.replaced: Counter[str] = Counter()
        self.limited: Counter[str] = Counter()
        self.off_m: list[float] = []
        self.steps = 0

    def add(self, scene: TrafficScene) -> None:
        for record in scene.sidecar.replaced:
            self.replaced[record.reason if record.detail is None else f"{record.reason}:{record.detail}"] += 1
        for _, record in scene.sidecar.asked:
            if str(record.reason).startswith("map_offers"):
                continue
            self.manoeuvres[record.kind, record.status] += 1
            if record.status != "done":
                self.reasons[record.kind, str(record.reason)] += 1
        for vehicle in scene.vehicles:
            self.steps += len(vehicle.driven.s) - 1
            self.limited.update(vehicle.driven.limited)
            self.off_m.append(float(np.abs(vehicle.simulated_off_m).max()))

    def lines(self) -> list[str]:
        limited = {cause: round(count / self.steps, 3) for cause, count in sorted(self.limited.items())}
        median, most, worst = np.percentile(self.off_m, [50, 95, 100])
        besides = sum(share for cause, share in limited.items() if cause != "turn")
        return [
            f"manoeuvres that the map offers: {dict(self.manoeuvres)}",
            f"reasons: {self.reasons.most_common(12)}",
            f"replaced: {self.replaced.most_common(12)}",
            f"share of steps limited: {limited}, besides turns {besides:.3f}",
            f"exported minus SUMO's own s, m: median {median:.2f}, 95 % {most:.2f}, worst {worst:.2f}",
        ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--agents", type=int, default=10)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("root", type=Path, nargs="?", help="data-set root, by default the shared real scenes")
    options = parser.parse_args()
    figures, placed = Figures(), []
    for folder in find_scenarios(options.root or SHARED_DATA / "av2"):
        prepared, began = prepare(read_scenario(folder), Config()), time.process_time()
        for seed in range(options.seeds):
            request = Request(agents=options.agents, seed=seed)
            scene = generate(prepared, Config(request=request))
            placed.append(len(scene.generated))
            figures.add(scene)
        seconds = (time.process_time() - began) / options.seeds
        print(
            f"{folder.name[:8]} placed {placed[-options.seeds :]}, {seconds:.2f} s of processor time each", flush=True
        )
    print(f"scenes with the count asked for: {np.mean([n == options.agents for n in placed]):.3f}")
    print("\n".join(figures.lines()))


if __name__ == "__main__":
    main()
