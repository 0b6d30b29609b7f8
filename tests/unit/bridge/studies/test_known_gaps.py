"""What is put into a study comes out of it: shares by hand, and critical gaps of drivers that are known."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from bridge.generation.gaps import gap_rows
from bridge.generation.generate import prepare
from bridge.recordings.road import write_corridor
from bridge.recordings.scenario import read_scenario
from bridge.studies.gap_acceptance import critical_gap, gaps_of
from bridge.studies.paired import Drawn, PairedRun, draw, drawing_config, paired_run
from hid2.agents import Policy
from hid2.insertion.flow import trigger_after_s
from hid2.params import CarFollowing, Config, Drivers, Flow, LaneChange, Request, Spawn

MPS = 14.0
#: Both lanes begin with a vehicle at once: after so long, s, they are apart.
APART_S = 90.0
#: Drivers that differ in nothing, and drive as fast as they may.
ALIKE = Drivers(
    desired_mean=1.0,
    desired_sd=0.0,
    wander_sd_mps=0.0,
    tau_sd_s=0.0,
    tau_mean_s=1.0,
    accel_sd_mps2=0.0,
    decel_sd_mps2=0.0,
)
RULE = '''
import math
from statistics import NormalDist
from hashlib import sha256


def two_sided(view, lead=0.5, b=1.0):
    front, rear = view.front, view.rear
    return {"lead": front.distance_m >= lead * view.speed_mps, "lag": rear.distance_m >= b * rear.speed_mps}


def lognormal(view, mean=1.0, sd=0.25):
    """Each driver has a critical lag gap of its own."""
    variance = math.log(1.0 + (sd / mean) ** 2)
    share = (int(sha256(view.vehicle_id.encode()).hexdigest()[:8], 16) + 0.5) / 2**32
    b = math.exp(NormalDist(math.log(mean) - variance / 2, math.sqrt(variance)).inv_cdf(share))
    return two_sided(view, b=b)
'''


@pytest.fixture(scope="module")
def corridor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_corridor(tmp_path_factory.mktemp("roads"), length_m=300.0, lanes=2, seconds=240.0)


@pytest.fixture
def rules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    (tmp_path / "known_gaps.py").write_text(RULE)
    monkeypatch.syspath_prepend(str(tmp_path))
    return "known_gaps"


def _config(
    seed: int, *, changing: float, flow: Flow, change: LaneChange, trigger_s: tuple[float, float], drivers: Drivers
) -> Config:
    request = Request(
        agents=0, straight=1.0 - changing, left_turn=0.0, right_turn=0.0, lane_change=changing, overtake=0.0,
        trigger_min_s=trigger_s[0], trigger_max_s=trigger_s[1], bus_share=0.0, truck_share=0.0, seed=seed,
    )  # fmt: skip
    return Config(
        request=request, spawn=Spawn(prior_speed_mps=MPS), flow=flow, drivers=drivers, lane_change=change,
        car_following=CarFollowing(model="Krauss"),
    )  # fmt: skip


def _run(corridor: Path, config: Config) -> tuple[Drawn, PairedRun]:
    prepared = prepare(read_scenario(corridor), config)
    drawn = draw(prepared, drawing_config(config))
    return drawn, paired_run(prepared, drawn, config)


def _entered_s(drawn: Drawn, run: PairedRun, config: Config) -> dict[str, float]:
    """When each vehicle passes the map's edge: its trigger counts from the step at which it is first there."""
    starts = {vehicle.vehicle_id: vehicle.start for vehicle in run.driven}
    after_s = {
        one.vehicle_id: trigger_after_s(one, config.request, drawn.seed, drawn.scene.last_s) for one in drawn.arrivals
    }
    return {name: one.request.trigger_s - after_s[name] - one.start_m / MPS for name, one in starts.items()}


def _by_hand(drawn: Drawn, entered_s: dict[str, float], lead_s: float, lag_s: float) -> dict[str, bool]:
    """Whether each vehicle that is to change has its gaps if all drive at one speed: by when they enter alone."""
    found = {}
    for one in drawn.arrivals:
        if one.start.request.policy is not Policy.LANE_CHANGE or one.vehicle_id not in entered_s:
            continue
        others = [other for other in drawn.arrivals if other.lane_id != one.lane_id and other.vehicle_id in entered_s]
        ahead_m = [MPS * (entered_s[one.vehicle_id] - entered_s[other.vehicle_id]) for other in others]
        room_m = [
            abs(ahead) - 0.5 * (one.start.box.length_m + other.start.box.length_m)
            for ahead, other in zip(ahead_m, others, strict=True)
        ]
        least_m = [(lead_s if ahead > 0.0 else lag_s) * MPS for ahead in ahead_m]
        found[one.vehicle_id] = all(room >= least for room, least in zip(room_m, least_m, strict=True))
    return found


@pytest.mark.parametrize("lag_s", [1.0, *(pytest.param(lag_s, marks=pytest.mark.slow) for lag_s in (0.5, 1.5, 2.0))])
def test_even_flow_by_hand(corridor: Path, rules: str, lag_s: float) -> None:
    """Headways of 2.7 s and .3 s more in the mean, a rule that looks once: the share is that of the arrivals."""
    change = LaneChange(
        rule=f"{rules}:two_sided", rule_with=f"lead=0.5, b={lag_s}", give_up_s=0.0, safety="rule", min_remaining_m=0.0
    )
    flow = Flow(veh_per_h_lane=1200.0, min_headway_s=2.7, warm_up_s=0.0)
    config = _config(0, changing=0.3, flow=flow, change=change, trigger_s=(5.0, 6.0), drivers=ALIKE)
    drawn, run = _run(corridor, config)
    by_hand = _by_hand(drawn, _entered_s(drawn, run, config), 0.5, lag_s)
    rows = {row["vehicle"]: row for row in run.requests if row["looks"] and row["trigger_s"] > APART_S}
    assert len(rows) > 25
    assert all(row["looks"] == 1 for row in rows.values())
    expected = np.mean([by_hand[name] for name in rows])
    assert np.mean([row["accepted"] for row in rows.values()]) == pytest.approx(expected, abs=0.05)
    assert 0.02 < expected < 0.6


@pytest.mark.slow
def test_lognormal_critical_gaps_are_found_again(corridor: Path, rules: str) -> None:
    """Of drivers that differ, in random traffic."""
    change = LaneChange(
        rule=f"{rules}:lognormal", rule_with="mean=1.0, sd=0.25", give_up_s=18.0, safety="rule", min_remaining_m=0.0
    )
    looks: list[dict[str, Any]] = []
    for seed in range(8):
        config = _config(
            seed, changing=0.5, flow=Flow(veh_per_h_lane=1100.0, min_headway_s=1.2, warm_up_s=0.0), change=change,
            trigger_s=(2.0, 2.0), drivers=Drivers(),
        )  # fmt: skip
        _, run = _run(corridor, config)
        same = {"scene": "a", "city": "x", "point": 0, "seed": seed, "replay": "fixed"}
        looks += [same | row for row in gap_rows([(0, vehicle) for vehicle in run.driven], {}, step_s=0.1)]
    found = critical_gap(gaps_of(pd.DataFrame(looks), []), "lag")
    assert found is not None
    assert found["drivers"] >= 200
    assert found["mean_s"] == pytest.approx(1.0, rel=0.05)
    assert found["sd_s"] == pytest.approx(0.25, rel=0.2)
