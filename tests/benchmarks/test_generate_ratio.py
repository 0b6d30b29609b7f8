"""How long a scene takes, as a multiple of the bare libsumo floor, on the six real scenes.

Not part of the default run: `pytest -m benchmark -s`, or as a script with a choice of counts and scenes:

    python tests/benchmarks/test_generate_ratio.py --agents 5 10 20 40 60 --rounds 5

Both sides are measured in one warm process, in turns (scene, floor, scene, floor, ...), each turn with another seed.
The median of the turns' ratios counts: a machine that others use changes its pace between turns, not within one.

    floor   load the ready-made net, replay the recorded agents with moveToXY, 110 steps with as many unsteered
            vehicles as were placed, on the routes and from the places of a generated result, close
    scene   read, build grid and net, find sites, drive, smooth, check, write: all of `hid2 generate` for one scene

Times on the wall are what the ratio is defined on; the ratio of processor times stands beside it, because it hardly
changes when others use the machine.
"""

import argparse
import os
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from bridge.batch.start_up import spare_the_collector
from bridge.generation.generate import GeneratedScene, PreparedScene, generate, prepare, write
from bridge.recordings.scenario import find_scenarios, read_scenario
from bridge.sumo.poses import front_arc_m, sumo_poses
from bridge.sumo.routes import edges_along
from bridge.sumo.simulation import Simulation
from hid2.agents import FloatArray
from hid2.occupancy.traffic import Traffic
from hid2.params import Config, Request
from hid2.scene import Scene, build_scene

import libsumo  # after bridge.sumo.simulation, which silences a remark of its import on stdout  # isort: skip

#: Largest ratio in the median over the scenes, and in the worst, by the number of vehicles asked for.
MEDIAN_MOST = {10: 3.0, 20: 4.0}
WORST_MOST = {10: 4.0, 20: 8.0}
ROUNDS = 5


@dataclass(frozen=True, eq=False, slots=True)
class Start:
    """One unsteered vehicle: SUMO edges, lane index and position of the front bumper on the first, speed."""

    edges: tuple[str, ...]
    lane_index: int
    front_m: float
    speed_mps: float


@dataclass(frozen=True, slots=True)
class Timing:
    """Medians of the turns of one scene at one count, s on the wall, and of the ratios in each turn."""

    name: str
    agents: int
    placed: int
    floor_s: float
    scene_s: float
    ratio: float
    cpu_ratio: float


def starts_of(made: GeneratedScene, scene: Scene) -> list[Start]:
    """Where the vehicles of a generated result began, as SUMO takes it."""
    starts = []
    for vehicle in made.vehicles:
        begun = vehicle.driven.start
        front = front_arc_m(begun.start_s, begun.size.length_m)
        segment = begun.path.segment_at(front)
        lane_s = segment.lane_s(front)
        cell = scene.grid.cell_at(segment.lane_id, lane_s)
        edges = edges_along(scene, begun.path, cell)
        assert edges is not None
        begin = float(scene.grid.edges_s(cell.lane_id)[cell.index])
        starts.append(Start(edges, scene.grid.lane_index(cell), max(0.0, lane_s - begin), begun.start_mps))
    return starts


def run_floor(net: Path, traffic: Traffic, front: FloatArray, angle: FloatArray, starts: Sequence[Start]) -> None:
    """The bare floor: nothing but what SUMO itself needs. front (A, T, 2) m, angle (A, T) degrees."""
    libsumo.start([
        "sumo", "--net-file", str(net), "--step-length", "0.1", "--seed", "0", "--collision.action", "none",
        "--time-to-teleport", "-1", "--no-step-log", "true", "--no-warnings", "true", "--duration-log.disable", "true",
    ])  # fmt: skip
    vehicle = libsumo.vehicle
    libsumo.vehicletype.copy("DEFAULT_VEHTYPE", "recorded")
    libsumo.vehicletype.setVehicleClass("recorded", "ignoring")
    libsumo.route.add("replay", [libsumo.edge.getIDList()[0]])
    inside: set[int] = set()
    for step in range(traffic.num_steps):
        here = set(np.flatnonzero(traffic.present[:, step]).tolist())
        for row in inside - here:
            vehicle.remove(f"r{row}")
        for row in here - inside:
            vehicle.add(f"r{row}", "replay", typeID="recorded", depart="now")
        for row in here:
            x, y = front[row, step].tolist()
            vehicle.moveToXY(f"r{row}", "", -1, x, y, float(angle[row, step]), keepRoute=6, matchThreshold=3.0)
        inside = here
        if step == 0:
            for row, start in enumerate(starts):
                libsumo.route.add(f"way{row}", list(start.edges))
                vehicle.add(
                    f"v{row}", f"way{row}", depart="now", departLane=str(start.lane_index),
                    departPos=f"{start.front_m:.3f}", departSpeed=f"{start.speed_mps:.3f}",
                )  # fmt: skip
        libsumo.simulationStep()
    libsumo.close()


def run_scene(folder: Path, config: Config, out: Path) -> GeneratedScene:
    """All of `hid2 generate` for one scene, its folder written anew."""
    scene = generate(read_scenario(folder), config)
    write(scene, out)
    return scene


def _clocked(work: Callable[[], object]) -> tuple[float, float]:
    wall, cpu = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - wall, time.process_time() - cpu


def measure(folder: Path, agents: int, *, rounds: int) -> Timing:
    """Floor and scene in turns."""
    configs = [Config(request=Request(agents=agents, seed=seed)) for seed in range(rounds)]
    config = configs[0]
    scenario = read_scenario(folder)
    prepared: PreparedScene = prepare(scenario, config)
    recorded = build_scene(
        prepared.grid,
        scenario.tracks,
        config=config,
        num_steps=scenario.num_steps,
        last_observed_step=49,
        step_s=0.1,
    )
    traffic = recorded.traffic
    front, angle = sumo_poses(traffic.position, traffic.heading, traffic.length_m[:, None])
    with tempfile.TemporaryDirectory() as beside:
        net = Path(beside) / "scene.net.xml"
        net.write_bytes(prepared.net)
        run_scene(folder, config, Path(beside) / "warm")
        run_floor(net, traffic, front, angle, [])
        spare_the_collector()  # both sides run as in a worker process
        floor, scene, placed = [], [], []
        for turn, config in enumerate(configs):
            made: list[GeneratedScene] = []
            out = Path(beside) / f"out{turn}"
            scene.append(_clocked(lambda: made.append(run_scene(folder, config, out))))  # noqa: B023  # called at once
            starts = starts_of(made[0], recorded)
            floor.append(_clocked(lambda: run_floor(net, traffic, front, angle, starts)))  # noqa: B023
            placed.append(len(made[0].generated))
    floor_s, scene_s = (statistics.median(wall for wall, _ in side) for side in (floor, scene))
    ratio, cpu_ratio = (
        statistics.median(of_scene[clock] / of_floor[clock] for of_scene, of_floor in zip(scene, floor, strict=True))
        for clock in (0, 1)
    )
    return Timing(folder.name[:8], agents, min(placed), floor_s, scene_s, ratio, cpu_ratio)


def table(timings: Sequence[Timing]) -> str:
    """Rows by scene, then the median and the worst of each count."""
    lines = ["scene     asked placed  floor s  scene s   ratio  ratio (cpu)"]
    lines += [
        f"{t.name:9} {t.agents:5} {t.placed:6} {t.floor_s:8.3f} {t.scene_s:8.3f} {t.ratio:7.2f} {t.cpu_ratio:12.2f}"
        for t in timings
    ]
    for agents in sorted({t.agents for t in timings}):
        for label, pick in (("median", statistics.median), ("worst", max)):
            wall, cpu = (
                pick([getattr(t, name) for t in timings if t.agents == agents]) for name in ("ratio", "cpu_ratio")
            )
            lines.append(f"{label:9} {agents:5} {'':24} {wall:7.2f} {cpu:12.2f}")
    return "\n".join(lines)


@pytest.mark.benchmark
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("agents", sorted(MEDIAN_MOST))
def test_scene_costs_few_floors(agents: int, real_scenes: list[Path]) -> None:
    """The six real scenes: at most 3 floors in the median and 4 in the worst with 10, 4 in the median with 20."""
    timings = [measure(folder, agents, rounds=ROUNDS) for folder in real_scenes]
    print(f"\n{table(timings)}")
    ratios = [timing.ratio for timing in timings]
    assert statistics.median(ratios) <= MEDIAN_MOST[agents]
    assert max(ratios) <= WORST_MOST[agents]


def main() -> None:
    """Print the table for counts and scenes of one's choice; with several counts, time against vehicles inserted."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--agents", type=int, nargs="+", default=[10, 20])
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--only", default="", help="scenes whose id begins with this")
    parser.add_argument("root", type=Path, nargs="?", help="data-set root, by default the shared real scenes")
    options = parser.parse_args()
    shared = Path(os.environ.get("HID2_SHARED_DATA", Path(__file__).parents[3] / "shared" / "data"))
    folders = [f for f in find_scenarios(options.root or shared / "av2") if f.name.startswith(options.only)]
    timings = []
    for agents in options.agents:
        for folder in folders:
            timings.append(measure(folder, agents, rounds=options.rounds))
            print(table(timings[-1:]).splitlines()[1], flush=True)
    print(table(timings))
    if len(options.agents) > 1:
        print("mean seconds a scene by vehicles placed:")
        for agents in options.agents:
            rows = [t for t in timings if t.agents == agents]
            print(f"{statistics.mean(t.placed for t in rows):7.1f} {statistics.mean(t.scene_s for t in rows):8.3f}")


if __name__ == "__main__":
    print(f"SUMO {Simulation.version()}, {os.cpu_count()} cores")
    main()
