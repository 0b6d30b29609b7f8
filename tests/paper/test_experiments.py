"""The paper's tables and figures by one command each, on the synthetic scenes with few seeds."""

import csv
import json

import pytest

from bridge.evaluation.paper import PAPER_ABLATION, run_experiment
from bridge.evaluation.report import PAPER_HID2, PAPER_ORIGINAL
from netconvert.errors import ConfigError


def lines(path):
    return {line["row"]: line for line in json.loads(path.read_text())["lines"]}


@pytest.fixture(scope="module")
def table1(data_scenes, tmp_path_factory):
    out = tmp_path_factory.mktemp("table1")
    run_experiment("table1", scenes=data_scenes["arterial"], out_dir=out, seeds=2)
    return out


def test_table1_has_the_papers_figures_beside_ours(table1):
    found = lines(table1 / "table1.json")
    assert {key: found["paper: Argoverse 2"][key]["value"] for key in PAPER_ORIGINAL} == PAPER_ORIGINAL
    assert {key: found["paper: HiD2"][key]["value"] for key in PAPER_HID2} == PAPER_HID2
    assert found["ours: generated vehicles alone"]["scr"]["value"] == 0.0
    assert found["ours: generated vehicles alone"]["footprint_orr"]["value"] == 0.0
    page = (table1 / "table1.html").read_text()
    assert "1.648" in page
    assert "bootstrap" in page


def test_table1_has_one_row_per_scene_and_seed(table1):
    with (table1 / "table1_scenes.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [row["seed_run"] for row in rows] == ["0", "1"]
    assert all(int(row["generated"]) > 0 for row in rows)


def test_the_same_request_gives_the_same_bytes_whatever_the_jobs(table1, data_scenes, tmp_path):
    run_experiment("table1", scenes=data_scenes["arterial"], out_dir=tmp_path, seeds=2, jobs=2)
    for name in ("table1.html", "table1.json", "table1.csv", "table1_scenes.csv"):
        assert (tmp_path / name).read_bytes() == (table1 / name).read_bytes(), name


def test_ablation_switches_one_component_off_at_a_time(data_scenes, tmp_path):
    """Table "ablation": without smoothing, jerk of the generated vehicles is higher than with everything on."""
    run_experiment("ablation", scenes=data_scenes["arterial"], out_dir=tmp_path, seeds=1, agents=6)
    found = lines(tmp_path / "ablation.json")
    for name, figures in PAPER_ABLATION.items():
        what = "everything on" if name == "full" else f"without {name}"
        assert found[f"paper: {what}"]["je"]["value"] == figures["je"]
    smooth = found["ours: everything on, generated alone"]["je"]["value"]
    assert found["ours: without smoothing, generated alone"]["je"]["value"] > smooth


def test_density_begins_with_nothing_added(data_scenes, tmp_path):
    run_experiment("density", scenes=data_scenes["curve"], out_dir=tmp_path, seeds=1)
    found = lines(tmp_path / "density.json")
    assert "0 asked for: generated alone" not in found
    assert [name.split()[0] for name in found if "recorded and" in name] == ["0", "5", "10", "20", "40"]
    assert (tmp_path / "density.png").stat().st_size > 10_000


def test_diversity_uses_scenes_of_more_than_forty_agents(data_scenes, tmp_path):
    with pytest.raises(ConfigError, match="more than 40 agents"):
        run_experiment("diversity", scenes=data_scenes["curve"], out_dir=tmp_path, seeds=1)


def test_unknown_experiment_is_explained(data_scenes, tmp_path):
    with pytest.raises(ConfigError, match="expected one of table1"):
        run_experiment("table9", scenes=data_scenes["curve"], out_dir=tmp_path)
    with pytest.raises(ConfigError, match="seeds 0"):
        run_experiment("table1", scenes=data_scenes["curve"], out_dir=tmp_path, seeds=0)
