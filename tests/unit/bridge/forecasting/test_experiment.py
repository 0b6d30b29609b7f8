"""Tables 2 and 3 from forecasts that are brought along; with the small forecaster the whole way (slow, needs torch)."""

import ast
import csv
import json
import runpy
import shutil
import sys
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from written import write_fake

from bridge.batch.manifest import DONE
from bridge.cli.commands import run
from bridge.cli.measuring import forecast
from bridge.console import Activity
from bridge.forecasting import experiment
from bridge.forecasting.compose import compose
from bridge.forecasting.composition import Composition
from bridge.forecasting.experiment import SETS, TrainingPlan, run_prediction, small_forecaster
from bridge.forecasting.predictions import Difference, baseline, write_forecasts
from bridge.pages.parts import macros
from bridge.recordings.scenario import read_rows, read_scenario
from bridge.recordings.sidecar import sidecar_in
from bridge.recordings.sources import find_recordings, find_scenarios, read_recording
from bridge.toml import model_of
from hid2.params import Forecasting
from netconvert.errors import ConfigError, ScenarioError

ROOT = Path(__file__).parents[4]
EXAMPLES = ROOT / "data" / "examples"
FEW_DRAWS = Forecasting(resamples=100)
#: What is told only of trainings, and of data sets, that are made here.
OF_TRAININGS = "small forecaster", "same number of updates"
OF_DATA_SETS = "Forecast in generated scenes", "neither ground nor source"
features = runpy.run_path(str(EXAMPLES / "scene_features.py"))
targets_of = features["targets_of"]


@pytest.fixture(scope="module")
def composed(tmp_path_factory, data_root):
    """The controls of the three synthetic scenes and two scenes made of each, the second for no-interaction."""
    out = tmp_path_factory.mktemp("composed")
    for folder in find_scenarios(data_root):
        scenario = read_scenario(folder)
        for name, count in (("hid2", 2), ("plain", 3)):
            write_fake(scenario, out / name, count=count)
    sources = {"recorded": data_root, "hid2": out / "hid2", "plain": out / "plain"}
    values = {
        "sources": {name: (str(place),) for name, place in sources.items()},
        "split": {"val": 0.5},
        "controls": {"recorded": "recorded", "generated": "hid2", "without_interaction": "plain"},
        "validation": {"recorded": {"take": {"recorded": "all"}}, "hid2": {"take": {"hid2": "all"}}},
    }
    return compose(model_of(Composition, values, "test"), out / "root").root


@pytest.fixture(scope="module")
def brought(composed, tmp_path_factory):
    """Forecasts of every set with two seeds: constant velocity, its modes shifted by half a metre more a set."""
    out = tmp_path_factory.mktemp("brought")
    for shift, name in enumerate(SETS):
        for seed in range(2):
            for validation in ("recorded", "hid2"):
                forecasts = {}
                for folder in find_scenarios(composed / "validation" / validation / "val"):
                    rows, *_ = read_rows(folder)
                    probabilities, by_track = baseline(rows, "constant-velocity")
                    moved = {track: modes + 0.5 * shift + 0.01 * seed for track, modes in by_track.items()}
                    forecasts[rows.scenario_id] = (probabilities, moved)
                write_forecasts(forecasts, out / name / str(seed) / f"{validation}.parquet")
    return out


def test_forecasts_from_elsewhere_make_both_tables(composed, brought, tmp_path):
    page = run_prediction([], tmp_path / "out", TrainingPlan(params=FEW_DRAWS), composed=composed, predictions=brought)
    content = json.loads((tmp_path / "out" / "prediction.json").read_text())
    for table, paper in (("table2", experiment.PAPER_TABLE2), ("table3", experiment.PAPER_TABLE3)):
        for line, (label, values) in zip(content[table], paper.items(), strict=False):
            assert (line.pop("row"), [cell["value"] for cell in line.values()]) == (label, list(values))
    ours = {line["row"]: line for line in content["table2"][4:]}
    assert list(ours) == ["ours: recorded", "ours: HiD2"]
    with (tmp_path / "out" / "prediction_scores.csv").open(newline="") as stream:
        rows = [row for row in csv.DictReader(stream) if (row["trained_on"], row["validation"]) == ("recorded", "hid2")]
    mean = np.mean([float(row["min_fde_m"]) for row in rows if row["k"] == "6"])
    assert ours["ours: recorded"]["hid2_min_fde_m"]["value"] == pytest.approx(mean)
    assert [line["row"] for line in content["table3"][4:7]] == [
        "ours: recorded scenes only",
        "ours: recorded, and as many as hid2 adds, drawn again",
        "ours: recorded, and as many of the densest (copies where no others are left)",
    ]
    assert content["seeds"] == dict.fromkeys(SETS, 2)
    pairs = {(one["model"], one["minus"]) for one in content["differences"]}
    assert {("hid2", "recorded"), ("hid2", "recorded-dense"), ("hid2-only", "recorded")} <= pairs
    text = page.read_text()
    for words in ("nothing about the claim", "1.573", "1.219", "0.023"):
        assert words in text
    assert [words for words in (*OF_TRAININGS, *OF_DATA_SETS) if words in text] == []


def test_seeds_of_an_earlier_call_stay_aside(composed, brought, tmp_path, monkeypatch):
    """Two seeds were trained; asked for one, of other updates perhaps, the tables are of one."""
    shutil.copytree(brought, tmp_path / "out" / "models")
    monkeypatch.setattr(experiment, "check_forecaster", lambda: None)
    monkeypatch.setattr(experiment, "_train", lambda *_, **__: None)
    page = run_prediction([], tmp_path / "out", TrainingPlan(seeds=1, params=FEW_DRAWS), composed=composed)
    text = page.read_text()
    assert [words in text for words in (*OF_TRAININGS, *OF_DATA_SETS)] == [True] * 2 + [False] * 2
    assert json.loads((tmp_path / "out" / "prediction.json").read_text())["seeds"] == dict.fromkeys(SETS, 1)


def test_scenes_of_an_earlier_request_stay_aside(copy_scene, tmp_path, monkeypatch):
    """First two vehicles a scene, made up, then one, and another share for validation: none has two."""
    root, _ = (copy_scene(name).parents[1] for name in ("curve", "intersection"))

    def generated(agents, val):
        plan = TrainingPlan(agents=agents, reading="recorded", params=Forecasting(variants=1, val_share=val))
        made = experiment._composed([root], tmp_path / "out", plan, jobs=1, tell=lambda *_: None)
        found = find_scenarios(made / "hid2-only" / "train")
        return {len(sidecar_in(folder).agents) for folder in found}

    def made_up(work, place, *_, **__):
        for job in work:
            config = job.runs[0].config
            write_fake(read_scenario(job.folder), place, count=config.request.agents + len(config.without))
        return [SimpleNamespace(status=DONE)]

    with monkeypatch.context() as patched:
        patched.setattr(experiment, "run_batch", made_up)
        assert generated(2, 0.4) == {2}
    assert generated(1, 0.5) == {1}


def test_what_is_missing_is_named(composed, brought, tmp_path):
    brought = shutil.copytree(brought, tmp_path / "brought")
    with pytest.raises(ConfigError, match="no validation/recorded/val"):
        run_prediction([], tmp_path / "out", TrainingPlan(), predictions=brought, composed=tmp_path)
    (brought / "hid2" / "1" / "hid2.parquet").unlink()
    with pytest.raises(ConfigError, match=r"hid2/1/hid2\.parquet: no such file; expected DIR/SET/SEED"):
        run_prediction([], tmp_path / "out", TrainingPlan(), predictions=brought, composed=composed)
    shutil.rmtree(brought / "recorded")
    with pytest.raises(ConfigError, match=r"recorded/0/recorded\.parquet: no such file"):
        run_prediction([], tmp_path / "out", TrainingPlan(), predictions=brought, composed=composed)


@pytest.mark.parametrize("command", ["forecast", "paper prediction"])
def test_without_the_extra_one_line_says_what_to_install(data_root, tmp_path, monkeypatch, capsys, command):
    monkeypatch.setattr(experiment, "find_spec", lambda name: None)
    monkeypatch.chdir(tmp_path)
    given = ["--scenes", str(data_root)] if command != "forecast" else [str(data_root)]
    monkeypatch.setattr(sys, "argv", ["hid2", *command.split(), "-o", "out", *given])
    assert run() == 2
    aside = ("so far", "lies inside the data set")  # other tests keep scenes beside this one's folder
    said = [line for line in capsys.readouterr().err.splitlines() if not any(words in line for words in aside)]
    assert len(said) == 1
    assert "sh setup.sh forecast" in said[0]
    assert list(tmp_path.iterdir()) == []


def test_nothing_but_the_example_imports_torch():
    importing = []
    for path in (*(ROOT / "bridge").rglob("*.py"), *(ROOT / "data").rglob("*.py")):
        nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
        names = [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
        names += [str(node.module) for node in nodes if isinstance(node, ast.ImportFrom)]
        importing += [path.relative_to(ROOT).as_posix()] if "torch" in names else []
    assert importing == ["data/examples/small_forecaster.py"]


@pytest.mark.parametrize("path", ["data/examples/small_forecaster.py", "tests/benchmarks/forecaster_figures.py"])
def test_what_needs_torch_imports_names_that_are_there(path, monkeypatch):
    """Told from its text, so that it is found where torch is not installed."""
    monkeypatch.syspath_prepend(EXAMPLES)
    nodes = ast.walk(ast.parse((ROOT / path).read_text(encoding="utf-8")))
    taken = [node for node in nodes if isinstance(node, ast.ImportFrom) and node.module != "torch"]
    lacking = [
        f"{node.module}.{alias.name}"
        for node in taken
        for alias in node.names
        if not hasattr(import_module(node.module), alias.name)
    ]
    assert taken
    assert lacking == []


def test_features_are_in_the_targets_own_frame(data_scenes):
    """The target is at the origin at the last observed step and looks along x; its future comes back to the city."""
    scenario = read_scenario(data_scenes["arterial"])
    targets = targets_of(scenario)
    assert [target.track_id for target in targets if target.focal] == [scenario.focal_track_id]
    for target in targets:
        track = scenario.track(target.track_id)
        np.testing.assert_allclose(target.seen.agents[0, -1, :4], [0, 0, 1, 0], atol=1e-6)
        assert target.seen.agent_kinds[0, 4] == 1
        assert target.seen.agent_kinds[1:, 4].sum() == 0
        assert target.seen.future is not None
        np.testing.assert_allclose(target.to_city(target.seen.future), track.position[track.timesteps > 49], atol=1e-3)
        apart = np.hypot(*target.seen.agents[:, -1, :2].T)[target.seen.agent_kinds.sum(axis=1) > 0]
        assert (np.diff(apart) >= -1e-6).all()
    focal = next(
        target.seen for target in targets if target.focal
    )  # it drives on a lane: one is below it, and so directed
    points = focal.lanes[focal.lane_kinds.sum(axis=1) > 0].reshape(-1, 4)
    assert points[np.abs(points[:, 1]) < 0.2, 2].max() > 0.9


def test_checksum_tells_every_part_that_is_learned_from(data_scenes):
    """A scene made anew may differ after the observation's end alone: a checkpoint of the other future is not its."""
    targets, checksum = targets_of(read_scenario(data_scenes["arterial"])), features["checksum"]
    assert checksum(targets) == checksum(targets_of(read_scenario(data_scenes["arterial"])))
    for part in range(5):
        seen = list(targets[0].seen)
        seen[part] = seen[part] + 1
        changed = [targets[0]._replace(seen=type(targets[0].seen)(*seen)), *targets[1:]]
        assert checksum(changed) != checksum(targets), part


def test_nothing_to_forecast_is_said_before_the_training(data_root, tmp_path, monkeypatch):
    """Of folders with a map alone, as of a sensor log, no scene can be read: no file without forecasts is written."""
    monkeypatch.setattr(experiment, "small_forecaster", lambda: (SimpleNamespace(**features), None))
    (tmp_path / "log").mkdir()
    shutil.copy(next(data_root.glob("val/*/log_map_archive_*.json")), tmp_path / "log")
    with pytest.raises(ScenarioError, match="log: no focal track to forecast"):
        forecast.function(
            data_root, tmp_path / "out", scenes=tmp_path / "log", updates=None, activity=Activity(quiet=True)
        )


def test_recordings_of_other_formats_are_refused(argoverse1, tmp_path, monkeypatch):
    """20 steps of Argoverse 1 are observed: nothing that has learned from 50 can forecast from them."""
    (address,) = find_recordings([argoverse1 / "train" / "data" / "1.csv"])
    with pytest.raises(ScenarioError, match=r"1\.csv: 20 observed steps, expected 50, Argoverse 2's"):
        targets_of(read_recording(address))
    monkeypatch.setattr(experiment, "check_forecaster", lambda: None)
    with pytest.raises(ConfigError, match=r"1\.csv: argoverse1, expected Argoverse 2 scenes alone"):
        run_prediction([argoverse1 / "train"], tmp_path / "out", TrainingPlan())


@pytest.mark.parametrize(("sources", "few"), [(999, True), (5000, False)])
def test_few_scenes_show_nothing_about_the_claim(sources, few):
    """A difference of -0.5 m, -0.9 to -0.1 m."""
    figures = -0.5, -0.9, -0.1, 0.2, sources, sources, 0.57
    one = Difference("hid2", "recorded", "all scenes", "min_fde_m", *figures, (3, 3))
    text = " ".join(macros("prediction.html.j2", gain_m=experiment.PAPER_GAIN_M).power(one).split())
    assert (
        f"{sources} tracks of {sources} recorded scenes are forecast, with 3 seeds. The paper’s smallest gain" in text
    )
    assert "found four times in five if it were 0.57 m or more." in text
    assert ("nothing about the claim" in text) is few


# With torch


@pytest.mark.slow
def test_the_small_forecaster_is_deterministic_and_resumes(data_root, tmp_path, monkeypatch):
    torch = pytest.importorskip("torch", reason="the extra `forecast`: sh setup.sh forecast")
    scenes, network = small_forecaster()
    monkeypatch.setattr(network, "CHECKPOINT_EVERY", 10)
    train, updates = network.train, 20
    targets, left_out = scenes.features_of(find_scenarios(data_root))
    assert left_out == []

    class Stopped(Exception):  # noqa: N818
        pass

    def stop(done, total):
        if done == 12:
            raise Stopped

    straight = train(targets, tmp_path / "a.pt", updates=updates, seed=1)
    with pytest.raises(Stopped):
        train(targets, tmp_path / "b.pt", updates=updates, seed=1, on_update=stop)
    resumed = train(targets, tmp_path / "b.pt", updates=updates, seed=1, resume=True)
    other = train(targets, tmp_path / "c.pt", updates=updates, seed=2)
    assert sum(values.numel() for values in straight.parameters()) < 1_000_000
    for one, two in zip(straight.state_dict().values(), resumed.state_dict().values(), strict=True):
        assert torch.equal(one, two)
    first, again, another = (network.forecast(model, targets) for model in (straight, resumed, other))
    for name, (shares, by_track) in first.items():
        np.testing.assert_array_equal(shares, again[name][0])
        for track, modes in by_track.items():
            np.testing.assert_array_equal(modes, again[name][1][track])
            assert np.abs(modes - another[name][1][track]).max() > 0
    with pytest.raises(ConfigError, match="of another training"):
        train(targets, tmp_path / "b.pt", updates=updates, seed=5, resume=True)
    monkeypatch.setattr(network, "MODES", 3)
    with pytest.raises(ConfigError, match="no checkpoint of hid2"):
        train(targets, tmp_path / "b.pt", updates=updates, seed=1, resume=True)


@pytest.mark.slow
def test_one_command_goes_from_sources_to_both_tables(data_root, tmp_path):
    pytest.importorskip("torch", reason="the extra `forecast`: sh setup.sh forecast")
    params = Forecasting(variants=2, updates=10, val_share=0.4)
    page = run_prediction([data_root], tmp_path / "out", TrainingPlan(seeds=2, agents=3, params=params), jobs=2)
    assert "nothing about the claim" in page.read_text()
    first = {path: path.read_bytes() for path in (tmp_path / "out" / "models").rglob("*.parquet")}
    assert len(first) == len(SETS) * 2 * 2
    run_prediction([data_root], tmp_path / "out", TrainingPlan(seeds=2, agents=3, params=params), jobs=1)
    assert {path: path.read_bytes() for path in first} == first
