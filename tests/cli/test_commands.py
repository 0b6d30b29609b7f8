"""The other commands, each once, and what all of them share."""

import csv
import re
import resource
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Run = Callable[..., Any]
COMMANDS = (
    "generate", "net", "validate", "evaluate", "calibrate", "view", "render", "plot", "config", "scan", "study", "make",
    "paper", "resimulate", "gui", "compose", "forecast",
)  # fmt: skip


def last_message(result: Any) -> str:
    """The only message on stderr; progress, which a slow machine shows, is none."""
    (line,) = [line for line in result.stderr.splitlines() if re.match("hid2: (error|warning): ", line)]
    return str(line)


@pytest.fixture(scope="module")
def generated(hid2: Run, data_scenes: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A generated scene folder."""
    out = tmp_path_factory.mktemp("generated")
    assert hid2("generate", data_scenes["arterial"], "-o", out, "--agents", 4, "-q").returncode == 0
    return next(out.rglob("scenario_*.parquet")).parent


def test_help_lists_every_command_and_is_quick(hid2: Run) -> None:
    """Quick by processor time, which other processes of the machine do not add to."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    result = hid2("--help")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert after.ru_utime - before.ru_utime < 3.0
    assert result.returncode == 0
    for command in COMMANDS:
        assert command in result.stdout


@pytest.mark.parametrize("command", COMMANDS)
def test_each_command_has_help(hid2: Run, command: str) -> None:
    assert hid2(command, "--help").returncode == 0


def test_help_imports_neither_sumo_nor_pandas() -> None:
    heavy = ("libsumo", "pandas", "pyarrow", "distributed", "numpy", "rich", "matplotlib")
    code = f"import sys, bridge.cli.commands; sys.exit(any(name in sys.modules for name in {heavy}))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_view_writes_one_page_of_several_folders(hid2: Run, generated: Path, data_root: Path, tmp_path: Path) -> None:
    result = hid2("view", generated, data_root, "-o", tmp_path / "page.html")
    assert (result.returncode, result.stdout) == (0, f"{tmp_path / 'page.html'}\n")
    assert (tmp_path / "page.html").read_text().count('class="packed"') == 4
    few = hid2("view", data_root, "--city", "austin", "--sample", 1, "-o", tmp_path / "one.html", "-q")
    assert (few.returncode, few.stdout, few.stderr) == (0, "", "")
    assert (tmp_path / "one.html").read_text().count('class="packed"') == 1


def test_net_writes_its_files_and_reports(hid2: Run, data_scenes: dict[str, Path], tmp_path: Path) -> None:
    result = hid2("net", data_scenes["intersection"], "-o", tmp_path)
    assert result.returncode == 0
    assert "largest distance from the centreline" in result.stdout
    names = {f"{data_scenes['intersection'].name}{ending}" for ending in (".net.xml", ".sumocfg", ".cells.csv")}
    assert names <= {path.name for path in tmp_path.iterdir()}


def test_net_of_whole_lanes_is_one_file(hid2: Run, data_scenes: dict[str, Path], tmp_path: Path) -> None:
    scene = data_scenes["curve"]
    result = hid2("net", scene, "-o", tmp_path / "out", "--lanes", "whole")
    assert result.returncode == 0, result.stderr
    assert [str(path) for path in (tmp_path / "out").iterdir()] == [result.stdout.strip()]
    wrong = hid2("net", scene, "-o", tmp_path / "none", "--signals")
    assert wrong.returncode == 2
    assert last_message(wrong).endswith("--signals: expected --lanes whole with it, a net of cells has no signals")
    assert not (tmp_path / "none").exists()


def test_export_writes_all_scenes_side_by_side(hid2: Run, data_scenes: dict[str, Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    root = shutil.copytree(data_scenes["curve"].parents[1], tmp_path / "av2")
    result = hid2("export", root, "--to", "openscenario", "-o", out)
    assert result.returncode == 0, result.stderr
    names = {f"{folder.name}.{ending}" for folder in data_scenes.values() for ending in ("xosc", "xodr")}
    assert {path.name for path in out.iterdir()} == names
    assert set(result.stdout.split()) == {str(out / name) for name in names}
    wrong = hid2("export", data_scenes["curve"], "--to", "vissim", "-o", out)
    assert wrong.returncode == 2
    assert "'openscenario', 'opendrive', 'commonroad', 'trj', 'sumo', 'fcd'" in last_message(wrong)
    next(root.rglob(f"scenario_{data_scenes['curve'].name}.parquet")).write_bytes(b"PAR1")
    next(root.rglob(f"log_map_archive_{data_scenes['arterial'].name}.json")).unlink()
    some = hid2("export", root, "--to", "trj", "-o", tmp_path / "some")
    assert some.returncode == 1
    assert some.stdout.split() == [str(tmp_path / "some" / f"{data_scenes['intersection'].name}.trj")]
    assert {*re.findall("not a parquet|no log_map", some.stderr)} == {"not a parquet", "no log_map"}


def test_validate_names_file_and_rule(hid2: Run, data_scenes: dict[str, Path], tmp_path: Path) -> None:
    assert hid2("generate", data_scenes["curve"], "-o", tmp_path, "--agents", 1, "-q").returncode == 0
    sidecar = next(tmp_path.rglob("hid2_*.json"))
    sidecar.unlink()
    result = hid2("validate", tmp_path)
    assert result.returncode == 1
    assert str(sidecar) in result.stdout


def test_evaluate_writes_a_report(hid2: Run, generated: Path, tmp_path: Path) -> None:
    result = hid2("evaluate", generated, "-o", tmp_path / "report")
    assert result.returncode == 0
    assert result.stdout.strip() == str(tmp_path / "report" / "report.html")
    assert {"metrics.json", "scenes.csv", "report.html"} <= {path.name for path in (tmp_path / "report").iterdir()}


def test_evaluate_scores_a_baseline(hid2: Run, generated: Path, tmp_path: Path) -> None:
    result = hid2("evaluate", generated, "-o", tmp_path, "--predictions", "constant-velocity")
    assert result.returncode == 0, result.stderr
    assert "minADE, m" in result.stdout
    assert hid2("evaluate", generated, "-o", tmp_path, "--predictions", tmp_path / "none.parquet").returncode == 2
    wrong = hid2("evaluate", generated, "-o", tmp_path, "--predictions", "constant-velocity", "--bands", "x")
    assert wrong.returncode == 2


@pytest.mark.slow
def test_paper_makes_a_table(hid2: Run, data_scenes: dict[str, Path], tmp_path: Path) -> None:
    arterial = data_scenes["arterial"]
    result = hid2("paper", "table1", "--scenes", arterial, "--seeds", 1, "--agents", 3, "-o", tmp_path)
    assert result.returncode == 0, result.stderr
    assert Path(result.stdout.strip()).is_file()
    assert hid2("paper", "table9", "-o", tmp_path).returncode == 2


def test_render_and_plot_write_pictures(hid2: Run, generated: Path, tmp_path: Path) -> None:
    assert hid2("render", generated, "-o", tmp_path / "scene.png", "--cells").returncode == 0
    assert hid2("plot", generated, "--agent", "gen_0", "-o", tmp_path / "agent.png").returncode == 0
    assert all((tmp_path / name).read_bytes()[:4] == b"\x89PNG" for name in ("scene.png", "agent.png"))
    assert hid2("plot", generated, "--agent", "gen_99", "-o", tmp_path / "x.png").returncode == 2


def test_config_lists_every_parameter(hid2: Run) -> None:
    result = hid2("config")
    assert result.returncode == 0
    assert "lane_change.time_gap_front_s" in result.stdout
    assert "nuPlan" in result.stdout


def test_config_as_toml_can_be_read_back(hid2: Run, data_scenes: dict[str, Path], tmp_path: Path) -> None:
    file = tmp_path / "all.toml"
    file.write_text(hid2("config", "--toml", "--set", "request.agents=1").stdout)
    result = hid2("generate", data_scenes["curve"], "-o", tmp_path / "out", "--config", file)
    assert result.returncode == 0
    assert "1 of 1 scenes done; vehicles placed: 1 of 1" in result.stdout


def test_scan_tabulates_scenes(hid2: Run, data_root: Path, tmp_path: Path) -> None:
    assert "3 of 3 scenes" in hid2("scan", data_root).stdout
    assert hid2("scan", data_root, "-o", tmp_path / "facts.csv", "--can", "overtake").returncode == 0
    with (tmp_path / "facts.csv").open() as file:
        facts = list(csv.DictReader(file))
    assert facts
    assert all(float(fact["overtake_m"]) > 0 for fact in facts)
    assert hid2("scan", tmp_path / "nowhere").returncode == 2


def test_study_writes_page_tables_and_a_figure(hid2: Run, data_scenes: dict[str, Path], tmp_path: Path) -> None:
    file = tmp_path / "small.toml"
    file.write_text(
        f'scenes = ["{data_scenes["arterial"]}"]\nseeds = 2\n[vary]\ntrigger_s = [1.0, 3.0]\n'
        "[config.request]\nagents = 3\nlane_change = 1.0\nstraight = 0.0\n"
    )
    result = hid2("study", file, "-o", tmp_path / "out")
    assert result.returncode == 0
    names = [Path(line).name for line in result.stdout.splitlines()]
    assert names[:4] == ["study.md", "small_trigger_after_s.png", "columns.csv", "runs.csv"]
    assert all((tmp_path / "out" / name).is_file() for name in names)
    with (tmp_path / "out" / "runs.csv").open() as table:
        assert len(list(csv.DictReader(table))) == 4


@pytest.mark.parametrize(
    "arguments",
    [
        ("generate", "nowhere", "-o", "out"), ("validate", "nowhere"), ("evaluate", "nowhere", "-o", "out"),
        ("evaluate", "nowhere", "-o", "out", "--predictions", "constant-velocity"), ("scan", "nowhere"),
        ("render", "nowhere", "-o", "a.png"), ("plot", "nowhere", "-o", "a.png", "--agent", "gen_0"),
        ("net", "nowhere", "-o", "out"), ("gui", "nowhere"), ("paper", "table1", "--scenes", "nowhere", "-o", "out"),
    ],
    ids=" ".join,
)  # fmt: skip
def test_folder_that_is_not_there_is_a_mistake_of_usage(
    hid2: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    result = hid2(*arguments)
    assert result.returncode == 2
    line = last_message(result)
    assert line.startswith("hid2: error: nowhere: no such folder, ")
    assert list(tmp_path.iterdir()) == []


def test_corridor_is_made_and_its_range_is_said(hid2: Run, tmp_path: Path) -> None:
    result = hid2("make", "corridor", "-o", tmp_path, "--length", "300", "--lanes", "3", "--seconds", "20")
    assert result.returncode == 0
    assert Path(result.stdout.strip()).name == "corridor-300m-3lanes-20s"
    wrong = hid2("make", "corridor", "-o", tmp_path, "--lanes", "1")
    assert wrong.returncode == 2
    assert wrong.stderr.splitlines()[-1] == "hid2: error: --lanes 1: expected 2 to 8"  # after a warning on its place
    its_own = hid2("make", "arterial", "-o", tmp_path, "--lanes", "3")
    assert its_own.returncode == 2
    assert "--lanes 3: arterial.toml has its own" in its_own.stderr
    signals = hid2("make", "arterial", "-o", tmp_path)
    assert Path(signals.stdout.strip(), "road.toml").read_text().count("[[signal]]") == 3


def test_study_without_scenes_says_so(hid2: Run, tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text("[vary]\ntrigger_s = [1.0]\n")
    result = hid2("study", tmp_path / "study.toml", "-o", tmp_path / "out")
    assert result.returncode == 2
    assert last_message(result).startswith(f"hid2: error: {tmp_path / 'study.toml'}: no key 'scenes', expected folders")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("evaluate", ".", "-o", "r", "--json"), "--json without --predictions"),
        (("evaluate", ".", "-o", "r", "--bands", "50,70,90"), "--bands without --predictions"),
        (("paper", "table1", "-o", "p", "--val", "0.5"), "--val does nothing in table1, expected it with prediction"),
        (("paper", "prediction", "-o", "p", "--map", "m"), "--map does nothing in prediction, expected it with the"),
    ],
    ids=["evaluate", "bands", "paper", "prediction"],
)
def test_options_that_would_do_nothing_are_refused(
    hid2: Run, tmp_path: Path, arguments: tuple[str, ...], said: str
) -> None:
    result = hid2(*arguments, cwd=tmp_path)
    assert result.returncode == 2
    assert said in last_message(result)
    assert not list(tmp_path.iterdir())
