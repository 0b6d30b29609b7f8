"""Runs of a study: the same vehicles whatever varies, flows at the map's edge, everything an outcome."""

import re
import sys
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bridge.batch.batch import Options
from bridge.generation.generate import generate, prepare
from bridge.recordings.road import write_corridor
from bridge.recordings.scenario import read_scenario
from bridge.studies.columns import DICTIONARY, OUTCOMES
from bridge.studies.page import page_text
from bridge.studies.paired import draw, drawing_config, paired_run
from bridge.studies.run import plan_text, run_study
from bridge.studies.statistics import seeds_needed
from bridge.studies.study import Study, read_study
from hid2.agents import Policy
from hid2.insertion.flow import arrivals, edge_lanes
from hid2.insertion.routes import Routes
from hid2.params import Config, Drivers, Flow, LaneChange, Request, Spawn
from hid2.scene import build_scene
from netconvert.errors import ConfigError

ROOT = Path(__file__).parents[4]
CHANGES = Request(agents=6, straight=0.0, left_turn=0.0, right_turn=0.0, lane_change=1.0, overtake=0.0)


def _corridor_config(**changes: object) -> Config:
    request = CHANGES.model_copy(
        update={"agents": 0, "straight": 0.5, "lane_change": 0.5, "trigger_min_s": 3.0, "trigger_max_s": 3.0}
    )
    return Config(
        request=request, spawn=Spawn(prior_speed_mps=12.0), flow=Flow(veh_per_h_lane=1500.0, warm_up_s=5.0),
        lane_change=LaneChange(**changes),  # type: ignore[arg-type]
    )  # fmt: skip


@pytest.fixture(scope="module")
def corridor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_corridor(tmp_path_factory.mktemp("roads"), length_m=250.0, lanes=2, seconds=40.0)


def test_starts_are_the_same_for_every_value_and_triggers_are_those_asked_for(data_scenes: dict[str, Path]) -> None:
    """What decides does not choose the vehicles; the trigger is 2 s in one run and 4 s in the other, and again."""
    scenario = read_scenario(data_scenes["arterial"])
    runs = []
    for trigger_s, gap_s in ((2.0, 0.4), (4.0, 2.0)):
        request = CHANGES.model_copy(update={"trigger_min_s": trigger_s, "trigger_max_s": trigger_s})
        config = Config(request=request, lane_change=LaneChange(time_gap_rear_s=gap_s))
        prepared = prepare(scenario, config)
        drawn = draw(prepared, drawing_config(config))
        runs.append((drawn, paired_run(prepared, drawn, config), trigger_s))
    first, second = ([(s.vehicle_id, s.start_m, s.start_mps, s.driver) for s in drawn.starts] for drawn, _, _ in runs)
    assert first == second != []
    for drawn, run, trigger_s in runs:
        assert len(run.requests) == 6  # nobody is replaced and nobody left out
        assert {row["trigger_s"] for row in run.requests} == {trigger_s}
        assert len(run.driven) == len(drawn.starts)
    again = paired_run(prepared, drawn, config)
    assert again.requests == run.requests
    assert [vehicle.s for vehicle in again.driven] == [vehicle.s for vehicle in run.driven]


def test_request_is_observed_until_the_scene_has_no_time_left_for_a_change(data_scenes: dict[str, Path]) -> None:
    """Asked after 5.5 s of 11 s, of which a change takes 3.7: at risk up to 7.2 s are all, whatever they wait for."""
    request = CHANGES.model_copy(update={"trigger_min_s": 5.5, "trigger_max_s": 5.5, "seed": 2})
    change = LaneChange(time_gap_front_s=0.0, time_gap_rear_s=0.0, min_gap_m=0.0, safety="rule")
    config = Config(request=request, lane_change=change)
    prepared = prepare(read_scenario(data_scenes["arterial"]), config)
    run = paired_run(prepared, draw(prepared, drawing_config(config)), config)
    waiting = [row for row in run.requests if row["status"] != "not_placed" and not row["accepted"]]
    assert waiting
    assert [row["observed_to_s"] for row in waiting] == pytest.approx([7.2] * len(waiting))


def test_turns_beside_have_their_outcome(data_scenes: dict[str, Path]) -> None:
    config = Config(request=CHANGES.model_copy(update={"left_turn": 1.0, "lane_change": 0.0}))
    prepared = prepare(read_scenario(data_scenes["intersection"]), config)
    run = paired_run(prepared, draw(prepared, drawing_config(config)), config)
    assert any(row["start_s"] for row in run.requests), "one turns, at least"


def test_durations_are_within_the_bounds_of_the_run_and_no_others(data_scenes: dict[str, Path]) -> None:
    config = Config(
        request=CHANGES, lane_change=LaneChange(max_duration_s=12.0), drivers=Drivers(lane_change_mean_s=8.0)
    )
    prepared = prepare(read_scenario(data_scenes["arterial"]), config)
    run = paired_run(prepared, draw(prepared, drawing_config(config)), config)
    assert max(one.start.driver.lane_change_s for one in run.driven) > 6.5


def test_corridor_can_be_read_and_is_what_was_asked_for_unless_it_is_out_of_range(
    corridor: Path, tmp_path: Path
) -> None:
    scenario = read_scenario(corridor)
    assert (scenario.scenario_id, scenario.num_steps) == ("corridor-250m-2lanes-40s", 400)
    assert [lane.length_m for lane in scenario.graph.lanes.values()] == pytest.approx([250.0, 250.0])
    assert [scenario.graph.may_change(1, side) for side in ("left", "right")] == [True, False]
    assert all(track.path_m == 0.0 for track in scenario.tracks)
    with pytest.raises(ConfigError, match="--seconds 2"):
        write_corridor(tmp_path, length_m=300.0, lanes=2, seconds=2.0)
    assert not list(tmp_path.iterdir())


def test_speeds_above_the_usual_limit_of_lanes_are_driven_where_they_are_desired(corridor: Path) -> None:
    """30 m/s (108 km/h) are desired, on lanes of 20 m/s unless asked for more: each vehicle comes near its own speed.

    An EIDM driver keeps to 95 % of it and more on a free road; the first ones have nothing ahead.
    """
    spawn = Spawn(prior_speed_mps=30.0, max_speed_mps=45.0)
    config = _corridor_config().model_copy(update={"spawn": spawn, "flow": Flow(veh_per_h_lane=400.0, warm_up_s=0.0)})
    prepared = prepare(read_scenario(corridor), config)
    driven = paired_run(prepared, draw(prepared, drawing_config(config)), config).driven
    shares = [max(vehicle.v) / vehicle.start.driver.desired_mps for vehicle in driven if len(vehicle.v) > 50]
    assert len(shares) > 4
    assert np.median(shares) > 0.95
    assert prepared.net(Config()) == prepare(read_scenario(corridor), Config()).net(Config())  # nets are kept apart


def test_no_vehicle_enters_into_the_box_of_one_that_is_leaving_the_lane(tmp_path: Path) -> None:
    """Vehicles change lanes from 0.5 to 2 s after they entered at 7 m/s, which takes 5 s: SUMO has them on the new
    lane from the first moment on, so that room on its lanes alone lets the next ones in where boxes meet.

        lane 2   ---[ SUMO ]------          the next one waits until the box is 10 m ahead
        lane 1   [next][ box ]----
    """
    scenario = read_scenario(write_corridor(tmp_path, length_m=120.0, lanes=2, seconds=40.0))
    rows, entered = [], 0
    for seed in range(2):
        config = _corridor_config(time_gap_front_s=0.2, time_gap_rear_s=0.2, min_gap_m=1.0)
        asked = {"straight": 0.3, "lane_change": 0.7, "trigger_min_s": 0.5, "trigger_max_s": 2.0, "seed": seed}
        more = {"spawn": Spawn(prior_speed_mps=7.0), "flow": Flow(veh_per_h_lane=1700.0, warm_up_s=0.0)}
        config = config.model_copy(update={"request": config.request.model_copy(update=asked), **more})
        prepared = prepare(scenario, config)
        run = paired_run(prepared, draw(prepared, drawing_config(config)), config)
        rows += [row for row in run.requests if row["start_s"] is not None]
        entered += len(run.driven)
    assert len(rows) >= 5
    assert not [row["vehicle"] for row in rows if row["overlaps"]]
    assert entered > 45  # 1,010 veh/h a lane: they wait no longer than they have to


def test_arrivals_keep_their_headways_and_their_rate(corridor: Path) -> None:
    """1,500 veh/h: 2.4 s in the mean, never below 1.2 s; over two lanes and 20 seeds of 40 s some 660 headways."""
    scenario = read_scenario(corridor)
    config = drawing_config(_corridor_config())
    scene = build_scene(
        prepare(scenario, config).grid, scenario.tracks, config=config, num_steps=400, last_observed_step=49, step_s=0.1
    )
    routes = Routes(scene)
    assert edge_lanes(scene, routes) == [1, 2]
    headways = []
    for seed in range(20):
        found = arrivals(scene, routes, (seed, 0, 0))
        for lane in (1, 2):
            headways += np.diff([0.0, *(one.due_s for one in found if one.lane_id == lane)]).tolist()
    assert min(headways) >= 1.2
    assert np.mean(headways) == pytest.approx(2.4, abs=0.2)


def test_flow_enters_one_after_the_other_and_looks_at_gaps(corridor: Path) -> None:
    """40 s at 1,500 veh/h on two lanes: some 30 vehicles; nobody overlaps, and lane changes come about."""
    config = _corridor_config()
    prepared = prepare(read_scenario(corridor), config)
    drawn = draw(prepared, drawing_config(config))
    run = paired_run(prepared, drawn, config)
    assert len(run.driven) > 15
    due = {one.vehicle_id: one.due_s for one in drawn.arrivals}
    entered = [row for row in run.requests if row["entered_s"] is not None]  # those due at last may not
    assert all(row in entered for row in run.requests if due[row["vehicle"]] < 36.0)
    assert all(row["entered_s"] >= due[row["vehicle"]] - 0.11 for row in entered)
    accepted = [row for row in run.requests if row["accepted"]]
    assert accepted
    for row in entered:
        assert row["source"] == "flow"
        assert row["trigger_s"] == pytest.approx(row["entered_s"] + 3.0)
    for row in accepted:
        assert row["waited_s"] == pytest.approx(row["accepted_s"] - row["trigger_s"])
        assert row["min_ttc_s"] is None or row["min_ttc_s"] > 0.5
    assert run.flow
    for interval in run.flow:
        product = interval["density_veh_per_km_lane"] * interval["speed_kmph"]
        assert interval["flow_veh_per_h_lane"] == pytest.approx(product, rel=1e-3)
    full = config.model_copy(update={"flow": Flow(veh_per_h_lane=3000.0)})
    drawn = draw(prepared, drawing_config(full))
    rows = {row["vehicle"]: row["reason"] for row in paired_run(prepared, drawn, full).requests}
    assert rows.keys() == {one.vehicle_id for one in drawn.arrivals if one.start.request.policy is Policy.LANE_CHANGE}
    assert "no_room_at_edge" in rows.values()  # held to the end


def test_flow_enters_beside_recorded_traffic(data_scenes: dict[str, Path]) -> None:
    """A recorded scene of 11 s: traffic at its edges, starts inside, and nothing recorded is moved or met.

    Where scenes are written it is refused.
    """
    config = _corridor_config().model_copy(
        update={"request": CHANGES, "flow": Flow(veh_per_h_lane=900.0, warm_up_s=0.0)}
    )
    prepared = prepare(read_scenario(data_scenes["arterial"]), config)
    drawn = draw(prepared, drawing_config(config))
    run = paired_run(prepared, drawn, config)
    assert {row["source"] for row in run.requests} == {"start", "flow"}
    assert len(run.driven) > len(drawn.starts)
    assert len(run.flow) == len({row["lane"] for row in run.flow}) > 1  # one interval, of the whole scene, by lane
    assert {(row["from_s"], row["to_s"]) for row in run.flow} == {(0.0, 11.0)}
    assert all(row["min_ttc_s"] is None or row["min_ttc_s"] > 0.0 for row in run.requests)
    with pytest.raises(ConfigError, match=r"flow\.veh_per_h_lane = 900: traffic enters in studies only"):
        generate(prepared.scenario, config)


def test_rule_of_the_page_decides(
    corridor: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    """The rule in README.md, at most 15 lines, is used as a reader would use it: patience wears out while it waits."""
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "bridge/studies/README.md").read_text(), re.DOTALL)
    assert len(code.strip().splitlines()) <= 15
    (tmp_path / "impatient.py").write_text(code)
    monkeypatch.syspath_prepend(str(tmp_path))
    request.addfinalizer(lambda: sys.modules.pop("impatient", None) and None)
    config = _corridor_config(rule="impatient:accept")
    prepared = prepare(read_scenario(corridor), config)
    run = paired_run(prepared, draw(prepared, drawing_config(config)), config)
    assert {look.rule for vehicle in run.driven for look in vehicle.gaps} == {None, "rule_refuses"}
    assert any(row["accepted"] for row in run.requests)


def _study(tmp_path: Path, scenes: Path) -> Study:
    path = tmp_path / "small.toml"
    path.write_text(
        'scenes = ["x"]\nseeds = 3\nkind = "lane_change"\n[vary]\n"lane_change.time_gap_rear_s" = [0.4, 2.0]\n'
        "[config.request]\nagents = 0\nstraight = 0.5\nleft_turn = 0.0\nright_turn = 0.0\nlane_change = 0.5\n"
        "overtake = 0.0\ntrigger_min_s = 2.0\ntrigger_max_s = 2.0\n[config.flow]\nveh_per_h_lane = 1200.0\n"
        "warm_up_s = 3.0\n[config.spawn]\nprior_speed_mps = 12.0\n"
    )
    return read_study(path, scenes=[scenes])


def _check_references(text: str, out: Path) -> None:
    """Every claim is followed by where it is read from: columns of the dictionary, in tables that were written."""
    references = [one for brackets in re.findall(r"\[([^\]]+)\]", text) for one in brackets.split(", ")]
    assert len(references) > 10
    for reference in references:
        column, _, outcome = reference.partition(" of ")
        table, _, name = column.partition(".")
        assert name in {one.strip() for known in DICTIONARY[table] for one in known.split(",")}, reference
        assert name in pd.read_csv(out / f"{table}.csv").columns, reference
        assert not outcome or outcome in {known.name for known in OUTCOMES}, reference
    for line in text.splitlines():
        if re.search(r"\b[0-9]", line) and not line.startswith("#"):
            assert "[" in line, line


@pytest.mark.usefixtures("few_draws")
def test_study_is_resumed_and_writes_what_its_dictionary_says(tmp_path: Path) -> None:
    """Six runs of 20 s: tables, figures and page; a second call drives nothing again and writes the same bytes."""
    study = _study(tmp_path, write_corridor(tmp_path / "roads", length_m=200.0, lanes=2, seconds=20.0))
    out = tmp_path / "out"
    seen = []
    report = run_study(study, out, Options(resume=True), on_row=lambda row, progress: seen.append(progress.skipped))
    assert (report.runs, report.failed) == (6, 0)
    first = {path.name: path.read_bytes() for path in report.files}
    again = run_study(study, out, Options(resume=True), on_row=lambda row, progress: seen.append(progress.skipped))
    assert seen[-1] == 6
    with pytest.raises(ConfigError, match=r"contents\.txt: 'study small: .*', expected 'study other: "):
        run_study(replace(study, name="other"), out, Options(resume=True))
    (out / "contents.txt").unlink()
    with pytest.raises(ConfigError, match=r"contents\.txt: no such file, but runs beside it, expected 'study small"):
        run_study(study, out, Options(resume=True))
    assert {path.name: path.read_bytes() for path in again.files} == first
    for table in ("runs", "requests", "looks", "gaps", "flow", "dose_response", "lane_changes"):
        frame = pd.read_csv(out / f"{table}.csv")
        said = {name.strip() for column in DICTIONARY[table] for name in column.split(",")}
        assert set(frame.columns) - said <= {"lane_change.time_gap_rear_s", "waiting_to_enter_s"}
    requests = pd.read_csv(out / "requests.csv")
    assert {requests[name].dtype for name in ("accepted", "counted")} == {np.dtype(bool)}
    assert {type(one) for one in requests["overlaps"].dropna()} == {bool}
    assert all(requests[name].dtype == np.float64 for name in requests if name.endswith(("_s", "_m", "_mps")))
    text = (out / "study.md").read_text()
    assert "## lane_change.time_gap_rear_s" in text
    _check_references(text, out)
    assert "cut off, or of vehicles that do not count at every point [requests.counted]" in text
    assert "- Trends and differences as sure as their intervals look: 3 clusters are fewer than the " in text
    assert re.search(r"Seeds needed at power \.8, by a paired t test, .*: \d+ for 0\.02, \d+ for 0\.05", text)


def test_plan_says_how_many_runs_a_difference_needs_before_and_after_a_pilot(tmp_path: Path) -> None:
    """By chance alone the SD of a difference is sqrt(.5 / n) for n requests a run; then by that of three pilot runs."""
    study = _study(tmp_path, write_corridor(tmp_path / "roads", length_m=200.0, lanes=2, seconds=20.0))
    runs, each, _, by_chance = plan_text(study, tmp_path / "out", 0.1)
    assert runs == "6 runs: points 2, seeds 3, scenes 1"
    count = int(each.split()[0])
    assert 0 < count < 15
    assert int(by_chance.split()[0]) == seeds_needed((0.5 / count) ** 0.5, 0.1)
    pilot = pd.DataFrame(
        [("a", seed, gap, True, k < taken) for seed, taken in enumerate((2, 4, 6)) for gap in (0.4, 2.0)
         for k in range(10)],
        columns=["scene", "seed", "lane_change.time_gap_rear_s", "counted", "accepted"],
    )  # fmt: skip
    pilot.loc[pilot["lane_change.time_gap_rear_s"] == 0.4, "accepted"] = True
    (tmp_path / "out").mkdir()
    pilot.to_csv(tmp_path / "out" / "requests.csv")
    *_, by_pilot = plan_text(study, tmp_path / "out", 0.1)  # differences -.8, -.6, -.4: SD .2
    assert f"{seeds_needed(0.2, 0.1)} by the 3 runs" in by_pilot
    pilot[pilot["seed"] < 2].to_csv(tmp_path / "out" / "requests.csv")
    assert list(plan_text(study, tmp_path / "out", 0.1))[-1].endswith("no spread to go by")
    with pytest.raises(ConfigError, match="--plan 5: expected a difference of shares between 0 and 1"):
        list(plan_text(study, tmp_path / "out", 5.0))
    change = LaneChange(rule="nowhere_at_all:accept")
    wrong = tuple(tuple(one.model_copy(update={"lane_change": change}) for one in configs) for configs in study.configs)
    with pytest.raises(ConfigError, match="nowhere_at_all"):
        list(plan_text(replace(study, configs=wrong), tmp_path / "out", 0.1))
    (tmp_path / "out" / "requests.csv").write_bytes(b"\xff\xfe a,b\n1")
    with pytest.raises(ConfigError, match=r"requests\.csv: UnicodeDecodeError: .*, expected the requests of a study"):
        list(plan_text(study, tmp_path / "out", 0.1))


@pytest.mark.usefixtures("few_draws", "here")
def test_replay_is_varied_like_any_other_parameter_and_said_everywhere(
    tmp_path: Path, data_scenes: dict[str, Path]
) -> None:
    """Fixed and reactive, the same vehicles: a column in every table, folders called reactive-, a line on the page.

    Of longest waits of 6 s and 1 s means are up to the shorter one.
    """
    path = tmp_path / "replay.toml"
    path.write_text(
        'scenes = ["x"]\nseeds = 1\n[vary]\n"driving.replay" = ["fixed", "reactive"]\n'
        '"lane_change.give_up_s" = [6.0, 1.0]\n[config.request]\nagents = 6\n'
        "straight = 0.0\nleft_turn = 0.0\nright_turn = 0.0\nlane_change = 1.0\novertake = 0.0\n"
        "trigger_min_s = 1.0\ntrigger_max_s = 1.0\n[config.lane_change]\ntime_gap_rear_s = 0.4\n"
    )
    study = read_study(path, scenes=[data_scenes["arterial"]])
    assert study.paired
    out = tmp_path / "out"
    report = run_study(study, out, Options(resume=True))
    assert (report.runs, report.failed) == (4, 0)
    assert sum(folder.name.startswith("reactive-") for folder in (out / "runs").iterdir()) == 2
    for table in ("runs", "requests", "looks", "gaps"):
        frame = pd.read_csv(out / f"{table}.csv")
        assert (frame["replay"] == frame["driving.replay"]).all()
        assert set(frame["replay"]) == {"fixed", "reactive"}
    requests = pd.read_csv(out / "requests.csv")
    by_mode = requests.groupby("replay")
    first, second = (by_mode.get_group(mode).reset_index(drop=True) for mode in ("fixed", "reactive"))
    assert first["vehicle"].tolist() == second["vehicle"].tolist()
    assert pd.read_csv(out / "dose_response.csv")["within_s"].dropna().unique().tolist() == [1.0]
    text = (out / "study.md").read_text()
    assert "recorded vehicles drive as recorded" in text
    assert "which was not recorded [requests.replay]" in text
    assert "What one parameter does alone" not in text
    half = replace(study, points=study.points[1:3], configs=study.configs[1:3])
    named = defaultdict(pd.DataFrame, {path.stem: pd.read_csv(path) for path in out.glob("*.csv")})
    named["requests"] = pd.concat([named["requests"], named["requests"].assign(scene="b", counted=False)])
    told = page_text(half, named, [])
    assert "What one parameter does alone" in told
    assert "1 scene has requests that count" in told
