"""Every recorded state of whole scenes goes through SUMO and comes back as it was."""

from pathlib import Path

from bridge.generation.generate import prepare
from bridge.recordings.scenario import read_scenario
from bridge.sumo.replay import Replay, ReplayErrors
from bridge.sumo.simulation import Simulation
from hid2.occupancy.traffic import traffic_of
from hid2.params import Config


def _replay(folder: Path, tmp_path: Path) -> tuple[ReplayErrors, int]:
    scenario = read_scenario(folder)
    net = tmp_path / "scene.net.xml"
    net.write_bytes(prepare(scenario, Config()).net(Config()))
    traffic = traffic_of(scenario.tracks, scenario.num_steps, step_s=scenario.step_s)
    with Simulation(net.read_bytes(), seed=0, step_s=scenario.step_s) as simulation:
        replay = Replay(simulation, traffic, step_s=scenario.step_s)
        for step in range(scenario.num_steps):
            replay.place(step, {})
            simulation.step()
            replay.check(step)
    return replay.errors, sum(track.timesteps.size for track in scenario.tracks)


def test_synthetic_scene_is_replayed_exactly(data_scene: Path, tmp_path: Path) -> None:
    """No gaps in the synthetic tracks: as many replayed states as rows."""
    errors, states = _replay(data_scene, tmp_path)
    assert (errors.states, errors.lost) == (states, 0)
    assert max(errors.max_position_error_m, errors.max_heading_error_rad) <= 0.001


def test_real_scene_is_replayed_exactly(real_scene: Path, tmp_path: Path) -> None:
    """Gaps inside a track are replayed too."""
    errors, states = _replay(real_scene, tmp_path)
    assert errors.states >= states
    assert errors.lost == 0
    assert max(errors.max_position_error_m, errors.max_heading_error_rad) <= 0.001
