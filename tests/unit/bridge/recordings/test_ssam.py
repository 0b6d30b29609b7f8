"""`.trj` files, read back field by field with struct as SSAM's own reader does."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bridge.recordings.scenario import read_scenario
from bridge.recordings.ssam import trj_files


def _read(content: bytes) -> tuple[tuple[Any, ...], dict[float, list[tuple[Any, ...]]]]:
    """Header, and vehicle records by time: id, link, lane, front x y, rear x y, length, width, speed, acceleration."""
    assert content[:2] == b"\0L"
    (version,), (kind, units, scale) = struct.unpack_from("<f", content, 2), struct.unpack_from("<BBf", content, 6)
    assert kind == 1
    head, at = (version, units, scale, *struct.unpack_from("<4i", content, 12)), 28
    steps: dict[float, list[tuple[Any, ...]]] = {}
    time_s = -1.0
    while at < len(content):
        if content[at] == 2:
            (time_s,) = struct.unpack_from("<f", content, at + 1)
            steps[time_s], at = [], at + 5
        else:
            assert content[at] == 3
            steps[time_s].append(struct.unpack_from("<iiB8f", content, at + 1))
            at += 42
    return head, steps


def test_trj_has_every_vehicle_at_every_step(data_scenes: dict[str, Path]) -> None:
    scenario = read_scenario(data_scenes["arterial"])
    vehicles = [track for track in scenario.tracks if track.object_type in ("vehicle", "bus")]
    ((name, content),) = trj_files(scenario).items()
    (version, units, scale, *bounds), steps = _read(content)
    assert name == f"{scenario.scenario_id}.trj"
    assert (version, units, scale) == (pytest.approx(1.04), 1, 1.0)
    assert len(steps) == scenario.num_steps
    assert sum(map(len, steps.values())) == sum(len(track.timesteps) for track in vehicles)
    assert list(steps) == pytest.approx(np.arange(scenario.num_steps) * 0.1, abs=1e-5)
    ordered = {number + 1: track for number, track in enumerate(scenario.tracks)}
    for time_s, rows in steps.items():
        for vehicle, link, lane, *told in rows:
            track = ordered[vehicle]
            at = int(np.searchsorted(track.timesteps, round(time_s * 10)))
            front, rear = np.array(told[:2]), np.array(told[2:4])
            assert (front + rear) / 2 == pytest.approx(track.position[at], abs=0.01)
            assert np.arctan2(*(front - rear)[::-1]) == pytest.approx(track.heading[at], abs=0.01)
            assert told[4:6] == pytest.approx((track.size.length_m, track.size.width_m))
            assert told[6] == pytest.approx(np.hypot(*track.velocity[at]), abs=1e-3)
            assert bounds[0] <= min(front[0], rear[0]) <= max(front[0], rear[0]) <= bounds[2]
            assert bounds[1] <= min(front[1], rear[1]) <= max(front[1], rear[1]) <= bounds[3]
            assert lane == 1
            assert 0 <= link <= len(scenario.graph.lanes)
