"""Lane-change rules at the wheel: what each of them makes of the same road."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hand_drawn import draw_lane
from inserted import DRIVER, nobody, recorded, scene_on, start_on

from bridge.sumo.drivers import model_parameters
from bridge.sumo.driving import FleetSimulation
from bridge.sumo.fleet import Fleet
from bridge.sumo.simulation import Simulation
from hid2.agents import Policy
from hid2.conflicts.stop_lines import StopLines
from hid2.params import Config, LaneChange
from hid2.policy.roads import Roads
from hid2.reasons import Reason
from hid2.vehicle import DrivenVehicle
from netconvert.lane_graph import LaneGraph
from netconvert.net_xml import net_bytes


def _road() -> LaneGraph:
    """Lane 1 at y = 0, lane 2 to its left at y = 3.5, 300 m."""
    ring = np.array([(-20.0, -3.0), (320.0, -3.0), (320.0, 7.0), (-20.0, 7.0), (-20.0, -3.0)])
    lanes = {
        1: draw_lane(1, [(0.0, 0.0), (300.0, 0.0)], left=2),
        2: draw_lane(2, [(0.0, 3.5), (300.0, 3.5)], right=1),
    }
    return LaneGraph(lanes, drivable_areas=(ring,))


@pytest.fixture
def change(tmp_path: Path) -> Callable[..., DrivenVehicle]:
    """change(rule, leader_mps) -> a vehicle at 10 m/s asked for a lane change at 1 s, 30 m behind a leader."""

    def run(rule: str, leader_mps: float | None) -> DrivenVehicle:
        config = Config(lane_change=LaneChange(rule=rule))
        tracks = [] if leader_mps is None else [recorded(74.5, 0.0, leader_mps, name="slow")]
        scene = scene_on(_road(), *tracks, config=config)
        start = start_on(scene, (1,), 40.0, 10.0, policy=Policy.LANE_CHANGE, trigger_s=1.0, driver=DRIVER)
        net = tmp_path / "road.net.xml"
        net.write_bytes(net_bytes(scene.grid))
        parameters = model_parameters(config)
        with Simulation(net.read_bytes(), seed=0, step_s=0.1, model="EIDM", parameters=parameters) as simulation:
            others = nobody(scene.future.num_steps)
            fleet = Fleet(scene, [replace(start)], others, Roads(scene), StopLines(scene))
            (vehicle,) = FleetSimulation(fleet, simulation).run()
        return vehicle

    return run


def test_paper_changes_at_the_trigger_with_and_without_a_leader(change: Callable[..., DrivenVehicle]) -> None:
    assert change("paper", None).shifts[0].requested_step == 10
    assert change("paper", 4.0).shifts[0].requested_step == 10


def test_mobil_takes_the_bias_for_a_reason_and_a_slow_leader_too(change: Callable[..., DrivenVehicle]) -> None:
    assert change("MOBIL", None).shifts[0].requested_step == 10
    assert change("MOBIL", 4.0).shifts[0].requested_step == 10


def test_lc2013_wants_a_motive(change: Callable[..., DrivenVehicle]) -> None:
    """Nobody ahead: nothing to gain, never; behind one at 4 m/s the lane beside is the faster one."""
    alone, behind = change("LC2013", None), change("LC2013", 4.0)
    assert {look.rule for look in alone.gaps} == {Reason.LC2013_NO_MOTIVE}
    assert alone.shifts == []
    assert behind.gaps[0].rule == Reason.LC2013_NO_MOTIVE  # a speed gain is believed in after some seconds
    assert (behind.gaps[-1].rule, behind.gaps[-1].sumo, len(behind.shifts)) == (None, True, 1)


def test_own_function_decides(
    change: Callable[..., DrivenVehicle], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A rule that waits for 2 s: looks at 1.0, 1.1, ... 2.9 s are refused, the change is asked for at 3.0 s."""
    (tmp_path / "waiting_rule.py").write_text("def after_two(view):\n    return view.waited_s > 1.95\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    one = change("waiting_rule:after_two", None)
    assert one.shifts[0].requested_step == 30
    assert [look.rule for look in one.gaps] == [Reason.RULE_REFUSES] * 20 + [None]
