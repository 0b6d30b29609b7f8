"""The rollout against SUMO itself: the same vehicles alone, without noise, by the law that is the default.

The default run takes two scenes; `pytest -m slow tests/real/test_rollout.py` takes all fourteen.
"""

import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from bridge.generation.generate import prepare, sumo_seed
from bridge.recordings.scenario import read_scenario
from bridge.sumo.drivers import model_parameters
from bridge.sumo.driving import FleetSimulation
from bridge.sumo.fleet import Fleet
from bridge.sumo.simulation import Simulation
from hid2.agents import FloatArray
from hid2.conflicts.guard import Guard
from hid2.insertion.filling import Filling
from hid2.insertion.finalise import traffic_of_exported
from hid2.insertion.rollout import World
from hid2.params import Config, Drivers, Request

#: Requests of a scene, of which some find no start; SUMO's errors of perception, which have no field of their own.
ASKED, NO_NOISE = 80, {"sigmaleader": 0.0, "sigmagap": 0.0}
#: Least number of vehicles in so many scenes; how far apart after so many steps, m, in the median and at 95 %.
#: Asked for is .5 1.5, 1 4; found .000 .24, .006 .94. SUMO driving by IDM .22 1.7, .29 2.8; Krauss .7 4, 1 6.
ENOUGH = {2: 100, 14: 500}
TARGETS_M = {50: (0.02, 0.6), 100: (0.05, 1.5)}


def apart(folder: Path) -> list[FloatArray]:
    """Distance along the path, m, at each step from the start on, of each vehicle as long as both have it on it."""
    config = Config(
        request=Request(sites="any", straight=0.6, left_turn=0.2, right_turn=0.2, lane_change=0.0, overtake=0.0),
        drivers=Drivers(error=0.0),
    )
    prepared = prepare(read_scenario(folder), config)
    seed = [0, 0, zlib.crc32(folder.name.encode())]
    here = prepared.surroundings(config)
    scene, nobody = here.scene, traffic_of_exported([], here.scene)
    world = World(scene, here.roads, Guard(scene, nobody, here.stop_lines))
    found = []
    with Simulation(
        prepared.net(config), seed=sumo_seed(seed), step_s=scene.step_s, model=config.car_following.model,
        parameters=model_parameters(config) | NO_NOISE,
    ) as simulation:  # fmt: skip
        for start in Filling(here, seed).first_starts(ASKED):
            fleet = Fleet(scene, [start], nobody, here.roads, here.stop_lines)
            driven = FleetSimulation(fleet, simulation, checked=False).run()[0]
            rolled = world.roll(start)
            count = min(len(driven.s), rolled.s.size)
            if driven.rerouted_at is not None:  # on another path
                count = min(count, driven.rerouted_at - start.step + 1)
            found.append(np.abs(rolled.s[:count] - np.array(driven.s[:count])))
    return found


def check(folders: Sequence[Path]) -> None:
    """Hold distances to the targets."""
    every = [distance for folder in folders for distance in apart(folder)]
    assert len(every) >= ENOUGH[len(folders)]
    for step, (median_m, most_m) in TARGETS_M.items():
        at = np.array([distance[step] for distance in every if distance.size > step])
        assert np.median(at) <= median_m, f"step {step}: median {np.median(at):.3f} m"
        assert np.quantile(at, 0.95) <= most_m, f"step {step}: 95 % {np.quantile(at, 0.95):.2f} m"


def test_rollouts_are_where_sumo_drives_without_its_noise(real_scenes: list[Path]) -> None:
    check(real_scenes[1:3])


@pytest.mark.slow
def test_rollouts_are_where_sumo_drives_without_its_noise_in_fourteen_scenes(fourteen_scenes: list[Path]) -> None:
    check(fourteen_scenes)
