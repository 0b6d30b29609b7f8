"""Figures by which implausible sources are refused, over real scenes, beside their bounds; what planted shifts give.

A script: python tests/benchmarks/plausibility_figures.py [DATA], by default ../shared/data with av2/, wide/, sensor/
and the sequences of av1/ on the map of one of the scenes.
"""

import argparse
import csv
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from shared_data import SHARED_DATA

from bridge.recordings.folders import Address, Choices
from bridge.recordings.plausibility import (
    LEAST_GAINING,
    LEAST_GROUND,
    LEAST_MAPPED,
    LEAST_VEHICLES,
    MOST_GAIN,
    MOST_TURNED,
    STATED,
    figures_of,
    implausible,
)
from bridge.recordings.recording import Recording
from bridge.recordings.sources import find_recordings, read_recording
from hid2.agents import VEHICLE_TYPES

ROOT = Path(__file__).parents[2]
SHIFTS_M = (1.0, 2.0, 3.0, 4.0, 6.0, 10.0, 20.0, 50.0, 100.0, 1000.0)


def addresses(data: Path) -> Iterator[tuple[str, Address]]:
    """Every scene, every window of the logs 5 sweeps apart, every sequence."""
    for name in ("av2", "wide"):
        yield from ((name, address) for address in find_recordings([data / name]))
    yield from (("sensor", address) for address in find_recordings([data / "sensor"], Choices(stride=5)))
    with (data / "av1" / "sequences.csv").open() as file:
        for row in csv.DictReader(file):
            (map_path,) = (data / "av2").glob(f"*/{row['av2_scenario']}*")
            yield from (("av1", address) for address in find_recordings([data / row["file"]], Choices(map_path)))


def shifted(recording: Recording, by_m: float) -> Recording:
    """The tracks shifted across the direction in which most vehicles drive."""
    velocity = np.concatenate([t.velocity for t in recording.tracks if t.object_type in VEHICLE_TYPES])
    fast = velocity[np.hypot(*velocity.T) > 2.0]
    along = np.angle(np.exp(2j * np.arctan2(fast[:, 1], fast[:, 0])).mean()) / 2 if len(fast) else 0.0
    way = by_m * np.array([-np.sin(along), np.cos(along)])
    tracks = tuple(replace(track, position=track.position + way) for track in recording.tracks)
    return replace(recording, tracks=tracks)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, nargs="?", default=SHARED_DATA)
    data = parser.parse_args().data
    print(f"at least {LEAST_VEHICLES} vehicles: mapped >= {LEAST_MAPPED:.0%}, ground >= {LEAST_GROUND:.0%}, ", end="")
    print(f"turned <= {MOST_TURNED:.0%}, stated {STATED}; gain < {MOST_GAIN:.0%}, or < {LEAST_GAINING} vehicles")
    print(f"{'':28}moving mapped ground turned stated_x    stated_y    gain vehicles shift_m  ms  refused")
    found: dict[tuple[str, float], list[bool]] = {}
    for kind, address in addresses(data):
        recording = read_recording(address)
        figures_of(recording)  # what is compiled and prepared once
        began = time.process_time()
        said = implausible(recording)
        took_ms = 1e3 * (time.process_time() - began)
        f = figures_of(recording)
        stated = "  ".join(f"{ratio:5.2f} ({n:2d})" for ratio, n in f.stated)
        name = f"{recording.scenario_id[:18]} {recording.start or ''}"
        print(
            f"{kind:6} {name:21}{f.moving:6d} {f.mapped:6d}  {f.ground:5.2f} {f.turned:6d} {stated}  {f.gain:5.2f} "
            f"{f.gain * f.moving:8.2f} {f.shift_m:7.1f} {took_ms:4.1f}  {said}",
            flush=True,
        )
        if kind == "sensor" and recording.start % 20:
            continue  # windows of one log are much alike
        for by_m in SHIFTS_M:
            for way in (by_m, -by_m):
                found.setdefault((kind, by_m), []).append(bool(implausible(shifted(recording, way))))
    print("tracks shifted across the main direction, either way: refused")
    for kind in dict.fromkeys(kind for kind, _ in found):
        shares = (f"{by_m:g} m {sum(found[kind, by_m])}/{len(found[kind, by_m])}" for by_m in SHIFTS_M)
        print(f"{kind:6}", "  ".join(shares))


if __name__ == "__main__":
    main()
