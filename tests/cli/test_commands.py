"""The other commands, each once, and what all of them share."""

import csv
import json
import re
import resource
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from baseline_file import write_baseline

from bridge.cli.commands import COMMANDS

Run = Callable[..., Any]


@pytest.fixture(scope="module")
def generated(hid2: Run, data_scenes: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A generated scene folder."""
    out = tmp_path_factory.mktemp("generated")
    assert hid2("generate", data_scenes["curve"], "-o", out, "--agents", 2, "-q").returncode == 0
    return next(out.rglob("scenario_*.parquet")).parent


def test_help_lists_every_command_and_is_quick(new_hid2: Run) -> None:
    """Quick by processor time, which other processes of the machine do not add to."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    result = new_hid2("--help")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert after.ru_utime - before.ru_utime < 3.0
    assert result.returncode == 0
    assert [command for command in COMMANDS if command not in result.stdout] == []


def test_view_writes_one_page_of_several_folders(
    hid2: Run, generated: Path, data_root: Path, tmp_path: Path, copy_scene: Callable[..., Path]
) -> None:
    """Of a scene without its map it tells, and shows the others; alone it is an error, and there is no page."""
    broken = copy_scene("curve")
    next(broken.glob("log_map_archive_*.json")).unlink()
    result = hid2("view", generated, broken, data_root, "-o", tmp_path / "page.html")
    assert (result.returncode, result.stdout) == (1, f"{tmp_path / 'page.html'}\n")
    assert f"no log_map_archive_<id>.json in {broken}; expected exactly one: add" in result.stderr
    assert hid2("view", broken, "-o", tmp_path / "none.html").returncode == 1
    assert not (tmp_path / "none.html").exists()
    assert (tmp_path / "page.html").read_text().count('class="packed"') == 4
    few = hid2("view", data_root, "--city", "austin", "--sample", 1, "-o", tmp_path / "one.html", "-q")
    assert (few.returncode, few.stdout, few.stderr) == (0, "", "")
    assert (tmp_path / "one.html").read_text().count('class="packed"') == 1


def test_net_writes_its_files_and_reports(hid2: Run, data_scenes: dict[str, Path], tmp_path: Path) -> None:
    """Of whole lanes it is one file."""
    result = hid2("net", data_scenes["intersection"], "-o", tmp_path)
    assert result.returncode == 0
    assert "largest distance from the centreline" in result.stdout
    names = {f"{data_scenes['intersection'].name}{ending}" for ending in (".net.xml", ".sumocfg", ".cells.csv")}
    assert names <= {path.name for path in tmp_path.iterdir()}
    result = hid2("net", data_scenes["curve"], "-o", tmp_path / "out", "--lanes", "whole")
    assert result.returncode == 0, result.stderr
    assert [str(path) for path in (tmp_path / "out").iterdir()] == [result.stdout.strip()]


def test_export_writes_all_scenes_side_by_side(hid2: Run, data_scenes: dict[str, Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    root = shutil.copytree(data_scenes["curve"].parents[1], tmp_path / "av2")
    result = hid2("export", root, "--to", "openscenario", "-o", out)
    assert result.returncode == 0, result.stderr
    names = {f"{folder.name}.{ending}" for folder in data_scenes.values() for ending in ("xosc", "xodr")}
    assert {path.name for path in out.iterdir()} == names
    assert set(result.stdout.split()) == {str(out / name) for name in names}
    next(root.rglob(f"scenario_{data_scenes['curve'].name}.parquet")).write_bytes(b"PAR1")
    next(root.rglob(f"log_map_archive_{data_scenes['arterial'].name}.json")).unlink()
    some = hid2("export", root, "--to", "trj", "-o", tmp_path / "some")
    assert some.returncode == 1
    assert some.stdout.split() == [str(tmp_path / "some" / f"{data_scenes['intersection'].name}.trj")]
    assert {*re.findall("not a parquet|no log_map", some.stderr)} == {"not a parquet", "no log_map"}
    twice = hid2(
        "export", data_scenes["curve"], shutil.copytree(data_scenes["curve"], tmp_path / "b"), "--to", "trj", "-o", out
    )
    file = str(out / f"{data_scenes['curve'].name}.trj")
    assert (twice.returncode, twice.stdout.split()) == (1, [file])
    assert f"{file}: 2 scenes have this id" in twice.stderr


def test_validate_names_file_and_rule(hid2: Run, generated: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(generated, tmp_path / generated.name)
    (sidecar,) = copy.glob("hid2_*.json")
    assert hid2("validate", copy).returncode == 0
    sidecar.unlink()
    result = hid2("validate", copy)
    assert result.returncode == 1
    assert str(sidecar) in result.stdout


def test_evaluate_writes_a_report_scores_a_baseline_and_compares_files(
    hid2: Run, generated: Path, data_root: Path, tmp_path: Path
) -> None:
    result = hid2("evaluate", generated, "-o", tmp_path / "scene")
    assert result.returncode == 0
    assert result.stdout.strip() == str(tmp_path / "scene" / "report.html")
    assert {"metrics.json", "scenes.csv", "report.html"} <= {path.name for path in (tmp_path / "scene").iterdir()}
    result = hid2("evaluate", generated, "-o", tmp_path, "--predictions", "constant-velocity")
    assert result.returncode == 0, result.stderr
    assert "minADE, m" in result.stdout
    files = (
        write_baseline(data_root, tmp_path / "a.parquet", kind="constant-velocity"),
        write_baseline(data_root, tmp_path / "b.parquet", kind="constant-turn-rate"),
    )
    given = [part for name, file in zip("ab", files, strict=True) for part in ("--predictions", f"{name}={file}")]
    result = hid2("evaluate", data_root, "-o", tmp_path / "report", *given, "--json", "-q")
    assert result.returncode == 0, result.stderr
    assert {(row["model"], row["minus"]) for row in json.loads(result.stdout)} == {("b", "a")}
    assert (tmp_path / "report" / "comparison.html").is_file()


@pytest.mark.slow
def test_paper_makes_a_table(hid2: Run, data_scenes: dict[str, Path], tmp_path: Path) -> None:
    arterial = data_scenes["arterial"]
    result = hid2("paper", "table1", "--scenes", arterial, "--seeds", 1, "--agents", 3, "-o", tmp_path)
    assert result.returncode == 0, result.stderr
    assert Path(result.stdout.strip()).is_file()


def test_config_lists_every_parameter_and_reads_its_toml_back(hid2: Run, tmp_path: Path) -> None:
    result = hid2("config")
    assert result.returncode == 0
    assert "lane_change.time_gap_front_s" in result.stdout
    assert "nuPlan" in result.stdout
    text = hid2("config", "--toml", "--set", "request.agents=1").stdout
    assert text != hid2("config", "--toml").stdout
    (tmp_path / "all.toml").write_text(text)
    assert hid2("config", "--toml", "--config", tmp_path / "all.toml").stdout == text


def test_scan_tabulates_scenes(hid2: Run, data_root: Path, tmp_path: Path) -> None:
    assert "3 of 3 scenes" in hid2("scan", data_root).stdout
    assert hid2("scan", data_root, "-o", tmp_path / "facts.csv", "--can", "overtake").returncode == 0
    with (tmp_path / "facts.csv").open() as file:
        facts = list(csv.DictReader(file))
    assert facts
    assert all(float(fact["overtake_m"]) > 0 for fact in facts)


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


def test_corridor_and_a_road_with_signals_are_made(hid2: Run, tmp_path: Path) -> None:
    result = hid2("make", "corridor", "-o", tmp_path, "--length", "300", "--lanes", "3", "--seconds", "20")
    assert result.returncode == 0
    assert Path(result.stdout.strip()).name == "corridor-300m-3lanes-20s"
    signals = hid2("make", "arterial", "-o", tmp_path)
    assert Path(signals.stdout.strip(), "road.toml").read_text().count("[[signal]]") == 3


def test_a_root_is_composed_and_checked(hid2: Run, data_root: Path, tmp_path: Path) -> None:
    root = tmp_path / "root"
    result = hid2("compose", data_root, "-o", root, "--json", "-q")
    assert result.returncode == 0, result.stderr
    assert json.loads(result.stdout) == [{"data set": ".", "train": 2, "val": 1, "test": 0}]
    (held_out,) = (root / "val").iterdir()
    shutil.copytree(held_out, root / "train" / held_out.name)
    result = hid2("compose", "--check", root)
    assert result.returncode == 1
    assert result.stdout == f"{root}/train/{held_out.name}: the same scene as {held_out}\n"


@pytest.mark.slow
def test_the_commands_that_example_prints_run_one_after_the_other(new_hid2: Run, tmp_path: Path) -> None:
    """In a folder with a space in its name, which the commands quote."""
    written = new_hid2("example", "-o", "to try", cwd=tmp_path)
    assert written.returncode == 0, written.stderr
    for line in written.stdout.splitlines():
        command, *arguments = shlex.split(line)
        assert command == "hid2"
        done = new_hid2(*arguments, cwd=tmp_path)
        assert done.returncode == 0, f"{line}: {done.stderr}"
    assert (tmp_path / "to try" / "scenes.html").is_file()
    assert not list((tmp_path / "to try" / "studies").glob("*.png"))
