"""Designs of studies and their tables."""

import json
from pathlib import Path

import pytest

from bridge.batch.manifest import DONE, ManifestRow
from bridge.config import load_config
from bridge.generation.generate import generate
from bridge.recordings.scenario import read_scenario
from bridge.studies.study import read_study, tables
from hid2.reasons import Reason
from netconvert.errors import ConfigError

ROOT = Path(__file__).parents[4]


def study_file(tmp_path: Path, text: str, scenes: Path) -> Path:
    path = tmp_path / "s.toml"
    path.write_text(f'scenes = ["{scenes}"]\n{text}')
    return path


def test_grid_is_every_combination_with_every_seed(tmp_path: Path, data_root: Path) -> None:
    text = 'seeds = [3, 5]\n[vary]\ntrigger_s = [1.0, 2.0]\n"request.agents" = [5, 10, 15]\n'
    study = read_study(study_file(tmp_path, text, data_root))
    assert len(study.folders) == 3
    assert [tuple(point.values()) for point in study.points] == [
        (1.0, 5), (1.0, 10), (1.0, 15), (2.0, 5), (2.0, 10), (2.0, 15),
    ]  # fmt: skip
    config = study.configs[4][1]
    assert (config.request.trigger_min_s, config.request.trigger_max_s) == (2.0, 2.0)
    assert (config.request.agents, config.request.seed) == (10, 5)
    assert sum(len(job.runs) for job in study.jobs) == 3 * 6 * 2


def test_latin_hypercube_has_one_point_in_each_slice(tmp_path: Path, data_root: Path) -> None:
    """Ten points over [0, 10]: each interval of length 1 holds exactly one."""
    text = 'design = "latin_hypercube"\nsamples = 10\n[vary]\ntrigger_s = [0.0, 10.0]\n"request.agents" = [1, 10]\n'
    study = read_study(study_file(tmp_path, text, data_root))
    assert sorted(int(point["trigger_s"]) for point in study.points) == list(range(10))
    assert sorted(point["request.agents"] for point in study.points) == list(range(1, 11))
    assert study.points == read_study(study_file(tmp_path, text, data_root)).points


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[vary]\nnothing = [1]\n", "vary.nothing: expected trigger_s or a key"),
        ('[vary]\n"lane_change.gap" = [1]\n', "unknown key 'lane_change.gap'"),
        ('[vary]\n"request.agents" = [-1]\n', "request.agents = -1"),
        ("seeds = 0\n[vary]\ntrigger_s = [1.0]\n", "seeds"),
        ("[vary]\n", "vary"),
        ("colour = 1\n[vary]\ntrigger_s = [1.0]\n", "colour"),
        ('design = "latin_hypercube"\n[vary]\ntrigger_s = [1.0, 2.0]\n', "samples = 0"),
        ('design = "latin_hypercube"\nsamples = 3\n[vary]\ntrigger_s = [2.0, 1.0]\n', "low < high"),
        ("[vary\n", "not TOML"),
    ],
)
def test_wrong_study_is_named(tmp_path: Path, data_root: Path, text: str, words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        read_study(study_file(tmp_path, text, data_root))
    assert words in str(caught.value)
    assert "s.toml" in str(caught.value)


def test_missing_scenes_are_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"s\.toml: scenes: .*nowhere: no such folder"):
        read_study(study_file(tmp_path, "[vary]\ntrigger_s = [1.0]\n", tmp_path / "nowhere"))


@pytest.mark.parametrize("name", ["lane_change_timing", "lane_change_gaps"])
def test_example_studies_can_be_read(name: str) -> None:
    assert read_study(ROOT / "data" / "studies" / f"{name}.toml").points


def test_example_on_real_scenes_has_at_least_200_runs(real_scenes: list[Path]) -> None:
    study = read_study(ROOT / "data" / "studies" / "lane_change_timing_real.toml", scenes=real_scenes)
    assert len(study.folders) * len(study.points) * len(study.seeds) >= 200


def test_tables_are_tidy(tmp_path: Path, data_scenes: dict[str, Path]) -> None:
    """Two manoeuvres: one waits from 1.0 to 1.5 s, one is never done; the overtake is not this study's kind."""
    text = "[vary]\ntrigger_s = [1.0]\n"
    study = read_study(study_file(tmp_path, text, data_scenes["arterial"]))
    from bridge.config import config_sha256

    base = {"track_id": "gen_0", "trigger_s": 1.0, "pet_s": None}
    records = [
        {**base, "kind": "lane_change", "status": "done", "start_s": 1.5, "window_ttc_s": 2.5, "reason": None},
        {
            **base,
            "trigger_s": None,
            "kind": "lane_change",
            "status": "not_feasible",
            "start_s": None,
            "window_ttc_s": None,
            "reason": "gap",
        },
        {**base, "kind": "overtake", "status": "done", "start_s": 2.0, "window_ttc_s": 0.5, "reason": None},
    ]
    (tmp_path / "runs" / "x").mkdir(parents=True)
    (tmp_path / "runs" / "x" / "run.json").write_text(json.dumps(records))
    row = ManifestRow("scene", "val", 0, 0, DONE, folder="runs/x", config_sha256=config_sha256(study.configs[0][0]))
    (run,), maneuvers = tables(study, [row], tmp_path)
    assert (run["lane_change_requested"], run["lane_change_done"], run["min_ttc_s"]) == (2, 1, 2.5)
    assert [maneuver["wait_s"] for maneuver in maneuvers] == [0.5, None, 1.0]
    assert all(maneuver["scene"] == "scene" and maneuver["point"] == 0 for maneuver in maneuvers)
    assert [maneuver["trigger_s"] for maneuver in maneuvers] == [1.0, 1.0, 1.0]
    assert [maneuver["triggered_s"] for maneuver in maneuvers] == [1.0, None, 1.0]


def test_study_may_ask_for_maps_with_room(tmp_path: Path, data_root: Path) -> None:
    study = read_study(study_file(tmp_path, 'can = ["left_turn"]\n[vary]\ntrigger_s = [1.0]\n', data_root))
    assert [folder.name for folder in study.folders] == ["bf8c5e9d-76de-5c6f-a44b-69cc2c9a318a"]


def test_without_reseeding_each_request_is_tried_once(data_scenes: dict[str, Path]) -> None:
    """As the studies in data/studies ask for: manoeuvres are begun, and what failed is not tried elsewhere."""
    settings = ["spawn.reseed_rounds=0", "request.agents=6", "request.straight=0", "request.left_turn=0"]
    settings += ["request.right_turn=0", "request.overtake=0", "request.lane_change=1"]
    scene = generate(read_scenario(data_scenes["arterial"]), load_config(None, settings))
    records = [record for agent in scene.sidecar.agents for record in agent.maneuvers]
    assert len(records) == 6
    assert sum(record.status == "done" for record in records) >= 3
    assert not any(vehicle.reason == Reason.DID_NOT_DO_IT for vehicle in scene.sidecar.replaced)


def test_a_request_has_one_record_though_its_vehicle_is_driven_again(data_scenes: dict[str, Path]) -> None:
    """Four lane changes are asked for; one vehicle has braked for another that goes, and is driven once more."""
    settings = ["spawn.reseed_rounds=1", "request.trigger_min_s=1", "request.trigger_max_s=1", "request.agents=8"]
    settings += ["request.straight=0.5", "request.left_turn=0", "request.right_turn=0", "request.overtake=0"]
    scene = generate(
        read_scenario(data_scenes["arterial"]),
        load_config(None, [*settings, "request.lane_change=0.5", "request.seed=1"]),
    )
    assert sum(len(agent.maneuvers) for agent in scene.sidecar.agents) == 4
