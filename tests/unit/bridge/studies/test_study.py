"""Designs of studies and their tables."""

import gzip
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from bridge.batch.manifest import DONE, ManifestRow
from bridge.config import config_sha256, load_config
from bridge.generation.gaps import gaps_bytes
from bridge.generation.generate import generate
from bridge.recordings.road import write_corridor
from bridge.recordings.scenario import read_scenario
from bridge.studies.page import write_results
from bridge.studies.study import LOOKS_FILE, RUN_FILE, RUN_TABLES, read_study, tables, write_run
from netconvert.errors import BatchError, ConfigError

ROOT = Path(__file__).parents[4]
HALF = b'{"requests": [{"kind": "lane_change"}], "flow": [], "lane_changes": [], "conflicts": []}'


def study_file(tmp_path: Path, text: str, scenes: Path) -> Path:
    path = tmp_path / "s.toml"
    path.write_text(f'scenes = ["{scenes}"]\n{text}')
    return path


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (gzip.compress(bytes(40_000_000), mtime=0), "holds more than 32 MB"),
        (b"no gzip", "gzip"),
        (gzip.compress(b'{"requests": [], "flow": []}', mtime=0)[:-9], "gzip"),
        (gzip.compress(b"[" * 5_000, mtime=0), "run of a study"),
        (gzip.compress(HALF, mtime=0), "KeyError\\('accepted'\\)"),
        (gzip.compress(b"[]", mtime=0), "run of a study"),
        (gzip.compress(b'{"requests": []}', mtime=0), "without conflicts, flow, lane_changes"),
    ],
)
def test_run_in_a_folder_that_is_continued_is_read_up_to_its_limits(
    tmp_path: Path, data_root: Path, content: bytes, said: str
) -> None:
    study = read_study(study_file(tmp_path, "seeds = [0]\n[vary]\ntrigger_s = [1.0]\n", data_root))
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / RUN_FILE).write_bytes(content)
    row = ManifestRow("a", "val", 0, 0, DONE, folder="run", config_sha256=config_sha256(study.configs[0][0]))
    with pytest.raises(BatchError, match=said):
        tables(study, [row], tmp_path)


def test_the_same_vehicles_count_at_every_point_at_which_any_does(tmp_path: Path, data_root: Path) -> None:
    """v0 is due at 1 and 2 s, v1 at 1 s alone, none at 9 s: v0 counts, twice."""
    study = read_study(study_file(tmp_path, "seeds = [0]\n[vary]\ntrigger_s = [1.0, 2.0, 9.0]\n", data_root))
    rows = []
    for (config,), waited in zip(study.configs, ((3.0, 2.0), (1.0, None), (None, None)), strict=True):
        asked = {"kind": "lane_change", "accepted": False, "trigger_s": config.request.trigger_min_s}
        told: dict[str, list[Any]] = {name: [] for name in RUN_TABLES}
        told["requests"] = [asked | {"vehicle": f"v{k}", "waited_s": one} for k, one in enumerate(waited)]
        source = read_scenario(study.folders[0])
        folder = write_run(tmp_path, source, config, told, {LOOKS_FILE: gaps_bytes([], {}, step_s=0.1)})
        rows.append(ManifestRow("a", "val", 0, 0, DONE, folder=str(folder), config_sha256=config_sha256(config)))
    requests = tables(study, rows, tmp_path)["requests"]
    assert requests.loc[requests["counted"], ["vehicle", "waited_s"]].to_numpy().tolist() == [["v0", 3.0], ["v0", 1.0]]


def test_tables_of_an_earlier_configuration_do_not_stay(tmp_path: Path, data_root: Path) -> None:
    study = read_study(study_file(tmp_path, "[vary]\ntrigger_s = [1.0, 2.0]\n", data_root))
    (tmp_path / "critical_gaps.csv").write_text("mean_s\n1.0\n")
    files = write_results(study, {name: pd.DataFrame() for name in ("runs", "looks", *RUN_TABLES)}, tmp_path)
    assert tmp_path / "critical_gaps.csv" in files
    assert (tmp_path / "critical_gaps.csv").read_text().startswith("parameter,value,side,mean_s,")
    assert pd.read_csv(tmp_path / "gaps.csv").empty


def test_grid_is_every_combination_with_every_seed(tmp_path: Path, data_root: Path) -> None:
    text = 'seeds = [3, 5]\n[vary]\ntrigger_s = [1.0, 2.0]\n"lane_change.give_up_s" = [5.0, 10.0, 15.0]\n'
    text += "[config.request]\ntrigger_list_s = [4.0]\n"
    study = read_study(study_file(tmp_path, text, data_root))
    assert len(study.folders) == 3
    assert [tuple(point.values()) for point in study.points] == [(s, g) for s in (1.0, 2.0) for g in (5.0, 10.0, 15.0)]
    config = study.configs[4][1]
    assert (config.request.trigger_min_s, config.request.trigger_max_s, config.request.trigger_list_s) == (2.0, 2.0, ())
    assert (config.lane_change.give_up_s, config.request.seed) == (10.0, 5)
    assert study.paired
    assert [len(job.runs) for job in study.jobs] == [6] * 3 * 2
    assert all(len({run.config.request.seed for run in job.runs}) == 1 for job in study.jobs)
    assert not read_study(study_file(tmp_path, '[vary]\n"flow.veh_per_h_lane" = [500.0, 1500.0]\n', data_root)).paired
    room = read_study(study_file(tmp_path, 'can = ["left_turn"]\n[vary]\ntrigger_s = [1.0]\n', data_root))
    assert [folder.name for folder in room.folders] == ["bf8c5e9d-76de-5c6f-a44b-69cc2c9a318a"]


def test_latin_hypercube_has_one_point_in_each_slice(tmp_path: Path, data_root: Path) -> None:
    """Ten points over [0, 10]: each interval of length 1 holds exactly one."""
    text = (
        'design = "latin_hypercube"\nsamples = 10\n[vary]\ntrigger_s = [0.0, 10.0]\n"lane_change.give_up_s" = [1, 10]\n'
    )
    study = read_study(study_file(tmp_path, text, data_root))
    assert sorted(int(point["trigger_s"]) for point in study.points) == list(range(10))
    assert sorted(point["lane_change.give_up_s"] for point in study.points) == list(range(1, 11))
    assert study.points == read_study(study_file(tmp_path, text, data_root)).points


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[vary]\nnothing = [1]\n", "vary.nothing: expected trigger_s or a key"),
        ('[vary]\n"lane_change.gap" = [1]\n', "unknown key 'lane_change.gap'"),
        ('[vary]\n"lane_change.give_up_s" = [-1.0]\n', "lane_change.give_up_s = -1"),
        ('[vary]\n"request.agents" = [5, 10]\n', "vary.request.agents: would choose other vehicles or sites"),
        ('[vary]\n"spawn.min_speed_mps" = [0.1]\n', "vary.spawn.min_speed_mps: would choose other vehicles or sites"),
        ('[vary]\ntrigger_s = [1.0]\n[config.request]\nagents = "max"\n', "expected a number of vehicles"),
        ("[vary]\ntrigger_s = [1.0]\n[config.request]\nentering = 0.5\n", "in studies vehicles enter by flow"),
        ("seeds = 0\n[vary]\ntrigger_s = [1.0]\n", "seeds = 0, expected "),
        ('[vary]\n"rule.b" = [nan, 1.0]\n', "vary.rule.b"),
        ('design = "latin_hypercube"\n[vary]\ntrigger_s = [1.0, 2.0]\n', "samples = 0"),
        ('design = "latin_hypercube"\nsamples = 3\n[vary]\ntrigger_s = [2.0, 1.0]\n', "low < high"),
        ("seeds = [0, 1, 0]\n[vary]\ntrigger_s = [1.0]\n", "[0, 1, 0]: 0 is there 2 times, expected each value once"),
        ("[vary]\ntrigger_s = [1, 1.0]\n", "vary.trigger_s = [1, 1.0]: 1 is there 2 times"),
        ('design = "latin_hypercube"\nsamples = 9\n[vary]\n"lane_change.give_up_s"=[1,2]\n', "expected fewer samples"),
        ('[vary]\n"rule.b" = [0.5, 3.0]\n', "rule_with = 'b=0.5': rule paper reads incentive of it"),
        ('[vary]\n"lane_change.mobil_bias_mps2" = [1, 2]\n', "expected config.lane_change.rule = 'MOBIL', or another"),
        ('[vary]\n"lane_change.min_gap_m"=[1]\n[config.lane_change]\nrule = "MOBIL"\n', "rule = 'paper', or another"),
        ('[vary]\n"lane_change.lc_speed_gain" = [1]\n"lane_change.rule" = ["paper", "MOBIL"]\n', "rule = 'LC2013', or"),
        ("samples = 4\n[vary]\ntrigger_s = [1.0]\n", "samples = 4 with design = 'grid', "),
        ("[vary]\nlane_change.give_up_s = [1.0]\n", 'has to be in quotes, as "lane_change.give_up_s" = [...]'),
        ("[vary]\ntrigger_s = []\n", "vary.trigger_s = [], expected at least 1 value"),
        ("seeds = []\n[vary]\ntrigger_s = [1.0]\n", "seeds = [], expected at least 1 value"),
        ('kind = "left_turn"\n[vary]\ntrigger_s = [1.0]\n', "'left_turn', expected 'lane_change' or 'overtake'"),
    ],
)
def test_wrong_study_is_named(tmp_path: Path, data_root: Path, text: str, words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        read_study(study_file(tmp_path, text, data_root))
    assert words in str(caught.value)
    assert "s.toml" in str(caught.value)


def test_scenes_may_be_given_beside_the_file(tmp_path: Path, data_root: Path) -> None:
    (tmp_path / "s.toml").write_text("[vary]\ntrigger_s = [1.0]\n")
    assert len(read_study(tmp_path / "s.toml", scenes=[str(data_root)]).folders) == 3


@pytest.mark.parametrize("name", ["corridor_lag_gap", "corridor_mobil", "corridor_lc2013"])
def test_studies_on_the_corridor_can_be_read(tmp_path: Path, name: str) -> None:
    write_corridor(tmp_path, length_m=500.0, lanes=2, seconds=140.0)
    study = read_study(ROOT / "data" / "studies" / f"{name}.toml", scenes=[tmp_path])
    assert len(study.points) == 5
    assert study.configs[0][0].flow.veh_per_h_lane == 1500.0


def test_a_request_has_one_record_though_its_vehicle_is_driven_again(data_scenes: dict[str, Path]) -> None:
    """Four lane changes are asked for; one vehicle has braked for another that goes, and is driven once more."""
    settings = ["spawn.reseed_rounds=1", "request.trigger_min_s=1", "request.trigger_max_s=1", "request.agents=8"]
    settings += ["request.straight=0.5", "request.left_turn=0", "request.right_turn=0", "request.overtake=0"]
    scene = generate(
        read_scenario(data_scenes["arterial"]),
        load_config(None, [*settings, "request.lane_change=0.5", "request.seed=1"]),
    )
    assert sum(len(agent.maneuvers) for agent in scene.sidecar.agents) == 4
