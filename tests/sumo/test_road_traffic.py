"""Traffic on a road of a file: what enters, who changes lanes, what is counted."""

from pathlib import Path
from typing import Any

import pytest

from bridge.config import config_from_dict
from bridge.recordings.corridor import write_road
from bridge.recordings.road import read_road
from bridge.recordings.sources import read_recording
from bridge.studies.road_traffic import RoadTraffic, arrivals

RAMPS = "\n[beside]\nfrom_m = 100.0\nto_m = 250.0\non_ramp = true\noff_ramp = true\n"
HEAD = "length_m = 400.0\nlanes = 2\nwarm_up_s = 30.0\n"
LIGHT = "\n[[inflow]]\nuntil_s = 180.0\nveh_per_h = [300.0, 300.0]\non_ramp = 300.0\n"


def driven(tmp_path: Path, text: str, rule: str, **lane_change: Any) -> RoadTraffic:
    path = tmp_path / "road.toml"
    path.write_text(text)
    own = {"rule": rule, "min_speed_mps": 0.0, "mobil_bias_mps2": 0.0, "safety": "rule", **lane_change}
    config = config_from_dict({"lane_change": own, "spawn": {"prior_speed_mps": 15.0}})
    traffic = RoadTraffic(read_recording(write_road(tmp_path / "roads", path)), read_road(path), config)
    traffic.run()
    return traffic


@pytest.mark.parametrize("rule", ["LC2013", "MOBIL", "paper"])
def test_vehicles_of_the_ramp_change_whatever_the_rule_and_reach_the_road(tmp_path: Path, rule: str) -> None:
    told = driven(tmp_path, HEAD + RAMPS + LIGHT, rule).told()
    assert told["vehicles"][2] > 5
    assert told["changes"][2] >= told["vehicles"][2] - told["start_to_end"][2][2]
    assert sum(told["start_to_end"][2][:2]) == told["vehicles"][2]  # none takes the exit
    assert told["not_left"] == 0


@pytest.mark.parametrize("rule", ["LC2013", "MOBIL"])
def test_vehicles_that_leave_come_to_the_off_ramp(tmp_path: Path, rule: str) -> None:
    told = driven(tmp_path, "leaving = [0.0, 1.0]\n" + HEAD + RAMPS + LIGHT, rule).told()
    assert told["vehicles"][1] > 5
    assert told["start_to_end"][1][2] + told["missed_exits"] == told["vehicles"][1]
    assert told["missed_exits"] <= 1


def test_paper_rule_without_enough_to_gain_changes_nothing_but_what_it_must(tmp_path: Path) -> None:
    told = driven(tmp_path, HEAD + RAMPS + LIGHT, "paper", rule_with="incentive=99").told()
    assert told["changes"][:2] == [0, 0]
    assert told["changes"][2] == told["vehicles"][2]  # from the lane beside to lane 2, once


def test_lane_that_ends_is_left_and_the_end_speed_slows_the_road(tmp_path: Path) -> None:
    drop = HEAD.replace("lanes = 2", "lanes = 3") + "drop_m = 250.0\n"
    drop += "\n[[inflow]]\nuntil_s = 180.0\nveh_per_h = [200.0, 200.0, 200.0]\n"
    free = driven(tmp_path, drop, "MOBIL").told()
    assert free["start_to_end"][2][2] == 0
    assert sum(free["start_to_end"][2]) > 3
    slow = driven(tmp_path, drop + "\n[[end_speed]]\nuntil_s = 180.0\nmps = [0.5, 0.5, 0.5]\n", "MOBIL").told()
    assert slow["speed_mps"] < 0.8 * free["speed_mps"]


def test_same_seed_tells_the_same_and_arrivals_are_those_of_any_rule(tmp_path: Path) -> None:
    text = HEAD + RAMPS + LIGHT
    one, other = (driven(tmp_path, text, "MOBIL").told() for _ in range(2))
    assert one == other
    road = read_road(tmp_path / "road.toml")
    names = [
        [(vehicle.name, vehicle.due_s, vehicle.driver) for vehicle in arrivals(road, config_from_dict(values))]
        for values in ({"lane_change": {"rule": "LC2013"}}, {"lane_change": {"rule": "paper"}})
    ]
    assert names[0] == names[1]
    assert len(names[0]) == pytest.approx(45, abs=15)  # 900 veh/h for 180 s
