"""Processor time of a scene over its limit, on the fourteen real scenes.

Not part of the default run: `pytest -m benchmark -s`, or as a script with a choice of scenes, counts and seeds:

    export PYTHONPATH=tests/support
    python tests/benchmarks/test_time_over_limit.py --agents 10 20 40 max --seeds 0 1 [--only 00a 3b3]

All in one warm process and in processor time, which hardly changes when others use the machine:

    scene   read, grid and net, sites, drive, smooth, check, write: all of `hid2 generate` for one scene
    limit   read, grid and net, write, and one simulation of all steps in which all recorded agents are replayed and as
            many vehicles as were placed, at their places and on their routes, are driven by SUMO unsteered
    over    scene over limit, by scenario and seed

`ms/kept` is the scene's time over the vehicles that are in it, `driven/kept` the vehicles that were driven over those.
`done` counts manoeuvres of the sidecar, `offered` those that were asked for and that the map offers.
"""

import argparse
import gc
import os
import statistics
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest
from shared_data import ROOTS
from unsteered import simulate_unsteered, unsteered_start

from bridge.generation.generate import PreparedScene, generate, prepare
from bridge.generation.scene import TrafficScene
from bridge.recordings.scenario import read_scenario
from bridge.recordings.sources import find_scenarios
from bridge.sumo.poses import sumo_poses
from bridge.sumo.simulation import Simulation
from hid2.params import Config, Request

#: Time over the limit, at most, in the median over the scenes and in the worst; driven for one kept in the median.
MOST = {10: (5.5, 12.0, 1.4), 20: (8.5, 18.0, 1.6)}


@dataclass(frozen=True, slots=True)
class Timing:
    """One scene with one seed, timed: processor time in s, counts of vehicles, rounds and manoeuvres."""

    name: str
    agents: str
    placed: int
    driven: int
    rounds: int
    done: int
    offered: int
    limit_s: float
    scene_s: float

    @property
    def over(self) -> float:
        """Time over the limit."""
        return self.scene_s / self.limit_s

    @property
    def kept_ms(self) -> float:
        """Time for each vehicle kept."""
        return 1000.0 * self.scene_s / max(1, self.placed)

    @property
    def driven_for_kept(self) -> float:
        """Vehicles driven for one kept."""
        return self.driven / max(1, self.placed)


def _limit_s(folder: Path, made: TrafficScene, config: Config, beside: Path) -> float:
    """Processor time of what every way of making a scene would need, s."""
    prepared: PreparedScene = prepare(read_scenario(folder), config)
    recorded = prepared.surroundings(config).scene
    traffic = recorded.traffic.span(slice(recorded.num_steps))
    starts = [unsteered_start(recorded, vehicle.driven.start) for vehicle in made.vehicles]
    front, angle = sumo_poses(traffic.position, traffic.heading, traffic.length_m[:, None])
    began = time.process_time()
    net = beside / "scene.net.xml"
    net.write_bytes(prepare(read_scenario(folder), config).net(config))
    simulate_unsteered(net, traffic, front, angle, starts)
    made.write(beside / "limit")
    return time.process_time() - began


def measure(folder: Path, agents: str, seed: int) -> Timing:
    """One scene and its limit. agents: a number or `max`."""
    config = Config(request=Request(agents="max" if agents == "max" else int(agents), seed=seed))
    with tempfile.TemporaryDirectory() as beside:
        began = time.process_time()
        made = generate(read_scenario(folder), config)
        made.write(Path(beside) / "out")
        scene_s = time.process_time() - began
        limit_s = _limit_s(folder, made, config, Path(beside))
    asked = [record for _, record in made.sidecar.asked]
    offered = [record for record in asked if not str(record.reason).startswith("map_offers")]
    return Timing(
        folder.name[:8], agents, len(made.generated), len(made.driven), 1 + max((n for n, _ in made.driven), default=0),
        sum(record.status == "done" for record in offered), len(offered), limit_s, scene_s,
    )  # fmt: skip


def warm_up(folder: Path) -> None:
    """Load what a process loads once, and then run as a worker does."""
    measure(folder, "10", 0)
    gc.set_threshold(5_000, 20, 20)
    gc.freeze()


_HEAD = "scene     asked placed driven rounds done offered  limit s  scene s    over ms/kept driven/kept"


def _row(one: Timing) -> str:
    return (
        f"{one.name:9} {one.agents:>5} {one.placed:6} {one.driven:6} {one.rounds:6} {one.done:4} {one.offered:7} "
        f"{one.limit_s:8.3f} {one.scene_s:8.3f} {one.over:7.2f} {one.kept_ms:7.1f} {one.driven_for_kept:11.2f}"
    )


def summary(timings: Sequence[Timing]) -> str:
    """Sums, median and worst of each count; with more than one seed, over the scenes of all seeds."""
    lines = []
    for agents in dict.fromkeys(one.agents for one in timings):
        some = [one for one in timings if one.agents == agents]
        placed, driven, rounds, done, offered = (
            sum(getattr(one, name) for one in some) for name in ("placed", "driven", "rounds", "done", "offered")
        )
        lines.append(
            f"{'sum':9} {agents:>5} {placed:6} {driven:6} {rounds:6} {done:4} {offered:7} "
            f"{sum(one.limit_s for one in some):8.3f} {sum(one.scene_s for one in some):8.3f} {'':15} "
            f"{driven / max(1, placed):11.2f}"
        )
        for label, pick in (("median", statistics.median), ("worst", max)):
            limit_s, scene_s, over, kept_ms, each = (
                pick([getattr(one, name) for one in some])
                for name in ("limit_s", "scene_s", "over", "kept_ms", "driven_for_kept")
            )
            lines.append(
                f"{label:9} {agents:>5} {'':33} {limit_s:8.3f} {scene_s:8.3f} {over:7.2f} {kept_ms:7.1f} {each:11.2f}"
            )
    return "\n".join(lines)


@pytest.mark.benchmark
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("agents", sorted(MOST))
def test_scene_takes_few_times_its_limit(agents: int, shared_data: Path) -> None:
    folders = [folder for name in ("av2", "wide") for folder in find_scenarios(shared_data / name)]
    assert len(folders) == 14
    warm_up(folders[0])
    timings = [measure(folder, str(agents), 0) for folder in folders]
    print("\n" + "\n".join([_HEAD, *map(_row, timings), summary(timings)]))
    median, worst, driven = MOST[agents]
    assert statistics.median(one.over for one in timings) <= median
    assert max(one.over for one in timings) <= worst
    assert statistics.median(one.driven_for_kept for one in timings) <= driven


def main() -> None:
    """Print the table for counts, seeds and scenes of one's choice."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--agents", nargs="+", default=["10", "20"], help="numbers, or max")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--only", nargs="+", default=[""], help="scenes whose id begins with one of these")
    parser.add_argument("--roots", type=Path, nargs="+", help="data-set roots, by default the shared real scenes")
    options = parser.parse_args()
    folders = [
        folder
        for root in options.roots or ROOTS
        for folder in find_scenarios(root)
        if folder.name.startswith(tuple(options.only))
    ]
    warm_up(folders[0])
    timings = []
    print(_HEAD)
    for agents in options.agents:
        for folder in folders:
            for seed in options.seeds:
                timings.append(measure(folder, agents, seed))
                print(_row(timings[-1]), flush=True)
    print(summary(timings))


if __name__ == "__main__":
    print(f"SUMO {Simulation.version()}, {os.cpu_count()} cores")
    main()
