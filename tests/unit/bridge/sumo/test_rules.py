"""Lane-change rules at the wheel: what each of them makes of the same road."""

from pathlib import Path

import pytest
from hand_drawn import draw_two_lanes
from inserted import recorded, scene_on, start_on
from simulated import drive

from bridge.sumo.drivers import model_parameters
from hid2.agents import Policy
from hid2.params import Config, LaneChange
from hid2.reasons import Reason
from hid2.vehicle import DrivenVehicle


def change(rule: str, leader_mps: float | None) -> DrivenVehicle:
    """A vehicle at 10 m/s that is asked for a lane change at 1 s, 30 m behind a leader if there is one."""
    config = Config(lane_change=LaneChange(rule=rule))
    tracks = [] if leader_mps is None else [recorded(74.5, 0.0, leader_mps, name="slow")]
    scene = scene_on(draw_two_lanes(), *tracks, config=config)
    start = start_on(scene, (1,), 40.0, 10.0, policy=Policy.LANE_CHANGE, trigger_s=1.0)
    (vehicle,) = drive(scene, start, parameters=model_parameters(config)).fleet.vehicles
    return vehicle


@pytest.mark.parametrize(("rule", "leader_mps"), [("MOBIL", None), ("MOBIL", 4.0)])
def test_paper_and_mobil_change_at_the_trigger_with_and_without_a_slow_leader(
    rule: str, leader_mps: float | None
) -> None:
    """MOBIL takes its bias for a reason, and a slow leader too."""
    assert change(rule, leader_mps).shifts[0].requested_step == 10


def test_lc2013_wants_a_motive() -> None:
    """Nobody ahead: nothing to gain, never; behind one at 4 m/s the lane beside is the faster one."""
    alone, behind = change("LC2013", None), change("LC2013", 4.0)
    assert {look.rule for look in alone.gaps} == {Reason.LC2013_NO_MOTIVE}
    assert alone.shifts == []
    assert behind.gaps[0].rule == Reason.LC2013_NO_MOTIVE  # a speed gain is believed in after some seconds
    assert (behind.gaps[-1].rule, behind.gaps[-1].sumo, len(behind.shifts)) == (None, True, 1)


def test_own_function_decides(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A rule that waits for 2 s: looks at 1.0, 1.1, ... 2.9 s are refused, the change is asked for at 3.0 s."""
    (tmp_path / "waiting_rule.py").write_text("def after_two(view):\n    return view.waited_s > 1.95\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    one = change("waiting_rule:after_two", None)
    assert one.shifts[0].requested_step == 30
    assert [look.rule for look in one.gaps] == [Reason.RULE_REFUSES] * 20 + [None]
