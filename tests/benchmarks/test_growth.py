"""How time grows with the vehicles inserted and with the length of the map; prints tables.

Not part of the default run: `pytest -m benchmark -s`, or as a script:

    python tests/benchmarks/test_growth.py

Seconds of processor time of grid, net, sites, driving, smoothing and checking; reading and writing are left out. By
vehicles: the real scenes, those with room for 60 vehicles and those without. By length: straight roads of three lanes
with nobody recorded on them, so that nothing but the map grows.
"""

import argparse
import statistics
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from shared_data import SHARED_DATA

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))

from hand_drawn import draw_lane

from bridge.generation.generate import generate
from bridge.recordings.folders import find_scenarios
from bridge.recordings.recording import Recording
from bridge.recordings.scenario import read_scenario
from hid2.params import Config, Request
from netconvert.lane_graph import LaneGraph

VEHICLES = (5, 10, 20, 40, 60)
LENGTHS_KM = (1.5, 3.0, 6.0, 12.0, 24.0)
SEEDS = 3
PIECE_M, LANES = 50.0, 3
#: Growth allowed, as a multiple of proportional growth: with 60 vehicles each meets more of the others than with 5, and
#: a road that is nearly full takes more rounds (measured: 1.5).
_MORE = 2.0


class Point(NamedTuple):
    """What was varied; mean seconds over the seeds; vehicles asked for, and the fewest placed."""

    what: float
    seconds: float
    asked: int
    placed: int


def measure(scenario: Recording, agents: int, what: float, *, seeds: int) -> Point:
    """One scene, warm, over some seeds."""
    seconds, placed = [], []
    for seed in range(seeds):
        config = Config(request=Request(agents=agents, seed=seed))
        start = time.process_time()
        scene = generate(scenario, config)
        seconds.append(time.process_time() - start)
        placed.append(len(scene.generated))
    return Point(what, statistics.mean(seconds), agents, min(placed))


def straight_road(scenario: Recording, length_km: float) -> Recording:
    """The scene without its agents on a straight road of so many km of lanes, three side by side."""
    pieces = round(1000 * length_km / LANES / PIECE_M)
    lanes = {}
    for piece in range(pieces):
        for row in range(LANES):
            one = LANES * piece + row + 1
            lanes[one] = draw_lane(
                one,
                [(PIECE_M * piece, 3.5 * row), (PIECE_M * (piece + 1), 3.5 * row)],
                successors=(one + LANES,) if piece + 1 < pieces else (),
                left=one + 1 if row + 1 < LANES else None,
                right=one - 1 if row else None,
            )
    end, top = PIECE_M * pieces, 3.5 * LANES
    ring = np.array([(-9.0, -1.75), (end + 9.0, -1.75), (end + 9.0, top), (-9.0, top), (-9.0, -1.75)])
    return replace(scenario, tracks=(), graph=LaneGraph(lanes, drivable_areas=(ring,)))


def by_vehicles(folder: Path, counts: Sequence[int], *, seeds: int) -> list[Point]:
    """Time against vehicles on one scene."""
    scenario = read_scenario(folder)
    generate(scenario, Config(request=Request(agents=counts[0])))
    return [measure(scenario, count, count, seeds=seeds) for count in counts]


def by_length(folder: Path, lengths_km: Sequence[float], *, seeds: int) -> list[Point]:
    """Time against km of lanes, ten vehicles, on roads made for the scene."""
    roads = [straight_road(read_scenario(folder), length) for length in lengths_km]
    generate(roads[0], Config())
    return [measure(road, 10, length, seeds=seeds) for road, length in zip(roads, lengths_km, strict=True)]


def growth(points: Sequence[Point]) -> float:
    """Time of the last over that of the first, as a share of what proportional growth would give."""
    return points[-1].seconds / points[0].seconds / (points[-1].what / points[0].what)


def table(name: str, points: Sequence[Point]) -> str:
    """One line: seconds, and in brackets what was placed where that is less than was asked for."""
    cells = [f"{p.seconds:.2f}" + (f" ({p.placed})" if p.placed < p.asked else "") for p in points]
    return f"{name:10} " + " ".join(f"{cell:>10}" for cell in cells)


@pytest.mark.benchmark
@pytest.mark.timeout(900)
def test_time_grows_at_most_twice_as_fast_as_the_vehicles_asked_for(real_scenes: list[Path]) -> None:
    """From 5 to 60, also where the road is full before that and is packed."""
    shares = {}
    for folder in real_scenes:
        points = by_vehicles(folder, VEHICLES, seeds=SEEDS)
        print(table(folder.name[:8], points))
        shares[folder.name] = growth(points)
    assert max(shares.values()) <= _MORE, shares


@pytest.mark.benchmark
@pytest.mark.timeout(900)
def test_time_grows_no_faster_than_the_map(real_scenes: list[Path]) -> None:
    points = by_length(real_scenes[0], LENGTHS_KM, seeds=1)
    print(table("road", points))
    assert growth(points) <= _MORE


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("root", type=Path, nargs="?", help="data-set root, by default the shared real scenes")
    options = parser.parse_args()
    folders = find_scenarios(options.root or SHARED_DATA / "av2")
    print(f"{'scene':10} " + " ".join(f"{count:>10}" for count in VEHICLES) + "   vehicles")
    for folder in folders:
        print(table(folder.name[:8], by_vehicles(folder, VEHICLES, seeds=options.seeds)), flush=True)
    roads = by_length(folders[0], LENGTHS_KM, seeds=options.seeds)
    print(f"\n{'':10} " + " ".join(f"{length:>10g}" for length in LENGTHS_KM) + "   km of lanes")
    print(table("road", roads))


if __name__ == "__main__":
    main()
