"""Processor time of a road on which vehicles change lanes by their own wish, as a multiple of bare SUMO.

Not part of the default run: `pytest -m benchmark -s`, or as a script: python tests/benchmarks/test_road_cost.py. Bare
is the same net, vehicles, drivers and speed downstream, stepped and nothing read, SUMO's own lane changes as they are.
Each in a process of its own, in turns; the median of the turns counts.
"""

import multiprocessing
import statistics
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest

from bridge.config import config_from_dict
from bridge.recordings.road import read_road, write_road
from bridge.recordings.sources import read_recording
from bridge.studies.road_traffic import RoadTraffic

ROAD = Path(__file__).parents[2] / "data" / "public" / "us101_0805.toml"
#: Largest ratio of processor times at 2,000 vehicles.
MOST = 6.0
ROUNDS = 3
RULES = ("LC2013", "MOBIL", "paper")


class Bare(RoadTraffic):
    """The same simulation, which nobody reads."""

    def _read(self, *_: Any) -> list[Any]:
        return []


def processor_s(rule: str, *, bare: bool, until_s: float) -> tuple[float, int]:
    """Processor time of one simulation, s, without what is imported; and how many vehicles took part."""
    with TemporaryDirectory() as folder:
        road = Path(folder, "road.toml")
        text = ROAD.read_text(encoding="utf-8")
        road.write_text(text, encoding="utf-8")
        recording = read_recording(write_road(Path(folder, "roads"), road))
        law = read_road(road)
        law = law.model_copy(update={"period": [one for one in law.period if one.until_s <= until_s]})
        change = {"rule": rule, "min_speed_mps": 0.0, "mobil_bias_mps2": 0.0, "safety": "rule"}
        config = config_from_dict({"lane_change": change, "drivers": {"tau_mean_s": 1.45}})
        traffic = (Bare if bare else RoadTraffic)(recording, law, config)
        before = time.process_time()
        traffic.run()
        return time.process_time() - before, len(traffic.vehicles)


def _apart(*arguments: Any, **named: Any) -> tuple[float, int]:
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(processor_s, arguments, named)


def ratios(*, rounds: int) -> dict[str, float]:
    """By rule its time over bare SUMO's, printed; and how time grows with vehicles and minutes."""
    found: dict[str, list[float]] = {rule: [] for rule in RULES}
    for _ in range(rounds):
        bare, count = _apart("LC2013", bare=True, until_s=1080.0)
        for rule in RULES:
            own, _ = _apart(rule, bare=False, until_s=1080.0)
            found[rule].append(own / bare)
            print(f"{rule}: {own:.1f} s over {bare:.1f} s, {count} vehicles")
    return {rule: statistics.median(values) for rule, values in found.items()}


@pytest.mark.benchmark
def test_road_costs_a_few_times_bare_sumo_and_grows_as_its_vehicles() -> None:
    for rule, ratio in ratios(rounds=ROUNDS).items():
        assert ratio <= MOST, rule
    half_s, half = _apart("MOBIL", bare=False, until_s=480.0)
    whole_s, whole = _apart("MOBIL", bare=False, until_s=1080.0)
    print(f"{half_s / half * 1000:.1f} ms a vehicle of {half}, {whole_s / whole * 1000:.1f} ms of {whole}")
    assert whole_s / whole <= 1.5 * half_s / half


if __name__ == "__main__":
    print(ratios(rounds=1))
