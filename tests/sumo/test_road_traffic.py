"""Traffic on a road of a file: what enters, who changes lanes, what is counted."""

from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pandas as pd
import pytest

from bridge.config import config_from_dict
from bridge.recordings.road import read_road, write_road
from bridge.recordings.sources import read_recording
from bridge.studies.gap_acceptance import gaps_of
from bridge.studies.road_traffic import RoadTraffic, RoadVehicle, arrivals
from bridge.sumo.net import convert_whole
from hid2.agents import BoxSize

ARTERIAL = Path(__file__).parents[2] / "data" / "public" / "arterial.toml"

RAMPS = "\n[beside]\nfrom_m = 100.0\nto_m = 250.0\non_ramp = true\noff_ramp = true\n"
DRIVERS = {"desired_mean": 1.0, "min_gap_mean_m": 2.2, "min_gap_sd_m": 0.4, "decel_mean_mps2": 2.2}  # as in data/public
HEAD = "length_m = 400.0\nlanes = 2\nwarm_up_s = 30.0\n"
LIGHT = "\n[[period]]\nuntil_s = 180.0\nveh_per_h = [300.0, 300.0, 300.0]\n"


def driven(tmp_path: Path, text: str, rule: str, **lane_change: Any) -> RoadTraffic:
    path = tmp_path / "road.toml"
    path.write_text(text)
    own = {"rule": rule, "min_speed_mps": 0.0, "safety": "rule", **lane_change}
    config = config_from_dict({"lane_change": own, "spawn": {"prior_speed_mps": 15.0}, "drivers": DRIVERS})
    traffic = RoadTraffic(read_recording(write_road(tmp_path / "roads", path)), read_road(path), config)
    traffic.run()
    return traffic


@pytest.mark.parametrize("rule", ["LC2013", "MOBIL", "paper"])
def test_vehicles_of_the_ramp_change_whatever_the_rule_and_reach_the_road(tmp_path: Path, rule: str) -> None:
    told = driven(tmp_path, HEAD + RAMPS + LIGHT, rule).told()
    changes, vehicles = told["ratios"]["from_ramp"]
    assert vehicles > 5
    assert changes >= vehicles - told["start_to_end"][2][2]
    assert sum(told["start_to_end"][2][:2]) == vehicles  # none takes the exit
    assert told["ratios"]["not_left"] == (0, 1)
    assert len(told["lag"]) <= vehicles
    assert bool(told["lag"]) is (rule != "LC2013")  # which SUMO asks


@pytest.mark.parametrize("rule", ["LC2013", "MOBIL"])
def test_vehicles_that_leave_come_to_the_off_ramp(tmp_path: Path, rule: str) -> None:
    told = driven(tmp_path, "leaving = [0.0, 1.0, 0.0]\n" + HEAD + RAMPS + LIGHT, rule).told()
    vehicles, missed = told["ratios"]["from_lane_2"][1], told["ratios"]["missed_exits"][0]
    assert vehicles > 5
    assert told["start_to_end"][1][2] + missed == vehicles
    assert missed <= 1


def test_paper_rule_without_enough_to_gain_changes_nothing_but_what_it_must(tmp_path: Path) -> None:
    told = driven(tmp_path, HEAD + RAMPS + LIGHT, "paper", rule_with="incentive=99").told()
    assert [told["ratios"][f"from_lane_{number}"][0] for number in (1, 2)] == [0, 0]
    assert told["ratios"]["from_ramp"][0] == told["ratios"]["from_ramp"][1]  # from the lane beside to lane 2, once


@pytest.mark.parametrize("rule", ["LC2013", "MOBIL"])
def test_cells_hold_what_was_driven_and_every_change_between_lanes(tmp_path: Path, rule: str) -> None:
    """Of two lanes each is origin in half of the rows: distances of cells add up to those of vehicles."""
    text = "length_m = 400.0\nlanes = 2\nwarm_up_s = 60.0\n"
    text += "\n[[period]]\nuntil_s = 240.0\nveh_per_h = [1200.0, 500.0]\n"
    told = driven(tmp_path, text, rule, rule_with="incentive=0.1" if rule == "paper" else "").told()
    driven_m, driven_s = told["ratios"]["speed_mps"]
    assert sum(km for *_, km in told["cells"]) == pytest.approx(driven_m / 1000.0)
    assert told["ratios"]["changes_per_veh_km"][0] == sum(changes for _, _, changes, _ in told["cells"]) > 0
    mean = sum(own for own, *_ in told["cells"]) / len(told["cells"])
    assert mean == pytest.approx(driven_s / 180.0 / 0.4 / 2, rel=0.15)  # veh/km of a lane


def test_gaps_are_those_that_the_rule_of_a_merging_vehicle_was_asked_about(tmp_path: Path) -> None:
    """Front of the merging vehicle M (4 m, 10 m/s) at 120 m, then at 150 m beside another gap. Lag gaps, by C's side:

    lane 2:  [A 90] ... [B 130] ... [C 170, 4 m]       B drives 5 m/s, A 10 m/s, C 10 m/s
    120 m: lag 120 - 4 - 90 = 26 m, 2.6 s; lead 130 - 4 - 120 = 6 m, .6 s: the lead gap alone is refused
    150 m: lag 150 - 4 - 130 = 16 m, 3.2 s; lead 170 - 4 - 150 = 16 m, 1.6 s: taken
    """
    (tmp_path / "road.toml").write_text(HEAD + RAMPS + LIGHT)
    road = read_road(tmp_path / "road.toml")
    recording = read_recording(write_road(tmp_path / "roads", tmp_path / "road.toml"))
    change = {"time_gap_front_s": 1.0, "time_gap_rear_s": 1.0, "min_speed_mps": 0.0, "min_remaining_m": 0.0}
    traffic = RoadTraffic(recording, road, config_from_dict({"lane_change": change}))
    size, lanes = BoxSize(4.0, 2.0), {one.lane_id: one for one in road.stretches()}
    template = traffic.vehicles[0]

    def vehicle(name: str, start: int, lane: int, x: float, v: float) -> RoadVehicle:
        return RoadVehicle(name, start, 0.0, False, template.driver, size, 0, lane=lanes[200 + lane], x=x, v=v)

    others = [vehicle("A", 2, 2, 90.0, 10.0), vehicle("B", 2, 2, 130.0, 5.0), vehicle("C", 2, 2, 170.0, 10.0)]
    one, told = vehicle("M", 3, 3, 120.0, 10.0), Mock()
    traffic._on_lane = {2: others, 3: [one]}
    for one.x in (120.0, 150.0):
        traffic._ask(told, one, one.x)
    told.change_lane.assert_called_once()
    (refused, taken), columns = gaps_of(pd.DataFrame(traffic._looks), []).to_dict("records"), ("lag", "lead")
    assert [refused[f"{side}_refused_s"] for side in columns] == pytest.approx([np.nan, 0.6], nan_ok=True)
    assert [taken[f"{side}_time_gap_s"] for side in columns] == pytest.approx([3.2, 1.6])
    traffic._stops = [100.0, 155.0]  # a closed stop line before C is what a rule sees
    front, rear = traffic._around(one, 2)
    assert (front.distance_m, front.speed_mps, rear.track_id) == (5.0, 0.0, "B")
    # 5 s on 250 m in the last half minute of 150 s: 5 s / (30 s 250 m)
    seen = pd.DataFrame({"now_s": np.arange(150.0, 155.0, 0.5), "lane": 2, "x": 100.0, "v": 10.0, "origin": np.nan})
    assert list(traffic._rates(seen)) == [pytest.approx((0.667, 0.0, 0, 0.05))]


def test_threshold_of_a_rule_is_the_critical_gap_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A rule that takes any lag gap from one second on, in dense traffic: no driver has refused more, or taken less."""
    dense = "\n[[period]]\nuntil_s = 180.0\nveh_per_h = [600.0, 1400.0, 600.0]\n"
    (tmp_path / "fixed_gap.py").write_text((ARTERIAL.parents[1] / "studies" / "two_sided.py").read_text())
    monkeypatch.syspath_prepend(str(tmp_path))
    told = driven(tmp_path, HEAD + RAMPS + dense, "fixed_gap:accept", rule_with="lead=0.2,b=1").told()
    rejected, taken = np.array([(r, np.inf if a is None else a) for r, a in told["lag"]]).T
    assert (told["ratios"]["inconsistent_lag"][0], len(taken) > 10, (rejected > 0.0).sum() > 4) == (0, True, True)
    assert rejected.max() < 1.0 <= taken.min()


def test_vehicles_stop_at_red_and_go_on_at_green(tmp_path: Path) -> None:
    """Green from 10 to 40 s of every 63, yellow for 3 s: the stop line at 200 m is passed at no other time."""
    text = "length_m = 400.0\nlanes = 2\nwarm_up_s = 0.0\nstep_s = 0.5\n"
    text += "\n[[period]]\nuntil_s = 180.0\nveh_per_h = [600.0, 600.0]\n"
    signal = "\n[[signal]]\nat_m = 200.0\ngreen_s = 30.0\nred_s = 30.0\noffset_s = 10.0\n"
    passed: list[float] = []

    class Watched(RoadTraffic):
        def _read(self, simulation: Any, now_s: float) -> Any:
            before = {one.name: one.x for one in self.vehicles if one.lane.number}
            here = super()._read(simulation, now_s)
            passed.extend(now_s for one in here if before.get(one.name, 999.0) < 200.0 <= one.x)
            return here

    free = driven(tmp_path, text, "MOBIL").told()
    path = tmp_path / "road.toml"
    path.write_text(text + signal)
    config = config_from_dict({"lane_change": {"rule": "MOBIL", "min_speed_mps": 0.0, "safety": "rule"}})
    traffic = Watched(read_recording(write_road(tmp_path / "roads", path)), read_road(path), config)
    traffic.run()
    assert len(passed) > 20
    assert all((now_s - 10.0) % 63.0 <= 34.0 for now_s in passed)  # a step after it began to be yellow for 3 s
    told = traffic.told()["ratios"]
    assert (
        told["speed_mps"][0] / told["speed_mps"][1]
        < 0.8 * free["ratios"]["speed_mps"][0] / free["ratios"]["speed_mps"][1]
    )


def test_signals_of_a_road_are_in_its_net_of_whole_lanes(tmp_path: Path) -> None:
    net = convert_whole(write_road(tmp_path / "roads", ARTERIAL), tmp_path, signals=True).read_text()
    assert net.count("<tlLogic") == 3
    assert 'type="traffic_light"' in net


def test_lane_that_ends_is_left_and_the_end_speed_slows_the_road(tmp_path: Path) -> None:
    drop = HEAD.replace("lanes = 2", "lanes = 3") + "drop_m = 250.0\n"
    drop += "\n[[period]]\nuntil_s = 180.0\nveh_per_h = [200.0, 200.0, 200.0]\n"
    free = driven(tmp_path, drop, "MOBIL").told()
    assert free["start_to_end"][2][2] == 0
    assert sum(free["start_to_end"][2]) > 3
    slow = driven(tmp_path, drop + "end_mps = [0.5, 0.5, 0.5]\n", "MOBIL").told()
    speeds = [one["ratios"]["speed_mps"][0] / one["ratios"]["speed_mps"][1] for one in (slow, free)]
    assert speeds[0] < 0.8 * speeds[1]


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
