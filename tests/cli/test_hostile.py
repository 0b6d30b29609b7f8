"""What others put in the way of the command: one line that says what is wrong, nothing lost, nothing outside OUT."""

import csv
import json
import os
import re
import resource
import signal
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil
import pytest
from processes import still_running

from bridge.config import config_to_dict
from hid2.params import Config

Run = Callable[..., subprocess.CompletedProcess[str]]
#: What a command that takes longer says of its progress every few seconds.
PROGRESS = re.compile(r"hid2: [a-z ]+(, \d+ s so far|: \d+ of \d+.*)")


def tree(folder: Path) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*"))


def one_line(result: subprocess.CompletedProcess[str], *, code: int) -> str:
    assert result.returncode == code, result.stderr
    (line,) = (said for said in result.stderr.splitlines() if not PROGRESS.fullmatch(said))
    assert line.startswith("hid2: ")
    return line


def craft(path: Path, **changes: Any) -> None:
    request = {"format": 1, "version": "1", "python": "3", "platform": "x", "scenario": "scene", "split": "val"}
    request |= {"variant": 0, "timeout_s": 5.0, "function": "bridge.batch.scene_work:generate_runs", "left_out": []}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("request.json", json.dumps(request | {"config": config_to_dict(Config())} | changes))
        archive.writestr("failure.json", json.dumps({"kind": "error", "message": "m"}))
        archive.writestr("details.txt", "")
        archive.writestr("scene/owned.py", "")


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"split": "../../outside"}, "split: Input should be 'train', 'val' or 'test'"),
        ({"function": "owned:work"}, "which is none of hid2's: if you trust it, add --function owned:work"),
        ({"config": []}, "config: Input should be"),
        ({"timeout_s": float("nan")}, "timeout_s: "),
    ],
    ids=["split", "function", "config", "timeout"],
)
def test_crafted_bundle(hid2: Run, tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    (tmp_path / "owned.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w')")
    craft(tmp_path / "b.zip", **changes)
    result = hid2("generate", "--repro", "b.zip", "-o", tmp_path / "out", cwd=tmp_path)
    assert said in one_line(result, code=1)
    assert tree(tmp_path) == ["b.zip", "owned.py"]


def test_scenes_that_cannot_be_used_are_quarantined_with_their_reason(
    hid2: Run, data_scenes: dict[str, Path], copy_scene: Callable[..., Path], edit_json: Callable[..., None],
    edit_rows: Callable[..., None], tmp_path: Path,
) -> None:  # fmt: skip
    """Large maps, no drivable area, a pipe, another id than the file's: at once, and the batch goes on to its end."""
    made = {name: tmp_path / "scenes" / name for name in ("large", "no road", "pipe", "id", "steps")}
    (tmp_path / "scenes").mkdir()
    for folder in made.values():
        copy_scene("curve").rename(folder)
    map_of = {name: next(folder.glob("log_map_archive_*.json")) for name, folder in made.items()}
    new_ids = {name: f"{k:08d}-0000-4000-8000-000000000000" for k, name in enumerate(made)}

    def enlarge(document: dict[str, Any]) -> None:
        for lane in document["lane_segments"].values():
            for point in (*lane["left_lane_boundary"], *lane["right_lane_boundary"], *lane["centerline"]):
                point.update(x=point["x"] * 1e4, y=point["y"] * 1e4)

    edit_json(map_of["large"], enlarge)
    edit_json(map_of["no road"], lambda document: document["drivable_areas"].clear())
    map_of["pipe"].unlink()
    os.mkfifo(map_of["pipe"])
    edit_rows(made["steps"], lambda rows: rows.assign(num_timestamps=-1))
    for name, folder in made.items():  # so that each is a scene of its own
        if name != "id":
            edit_rows(folder, lambda rows, new_id=new_ids[name]: rows.assign(scenario_id=new_id))
        for path in folder.iterdir():
            path.rename(path.with_name(path.name.replace(data_scenes["curve"].name, new_ids[name])))
    began = time.monotonic()
    result = hid2("generate", *made.values(), "-o", tmp_path / "out", "--jobs", 2)
    assert time.monotonic() - began < 120
    assert result.returncode == 1
    with (tmp_path / "out" / "manifest.csv").open() as file:
        reasons = {row["scenario"]: row["reason"] for row in csv.DictReader(file)}
    said = {
        "large": "expected at most", "no road": "no drivable area, expected at least one", "pipe": "not a regular file",
        "id": "expected the id in the file's name", "steps": "num_timestamps -1, expected 110",
    }  # fmt: skip
    assert {name: words for name, words in said.items() if words not in reasons[name]} == {}, reasons


def test_two_sources_with_one_id_are_refused(
    hid2: Run, data_scenes: dict[str, Path], copy_scene: Callable[..., Path], tmp_path: Path
) -> None:
    copy = copy_scene("curve")
    other = copy.rename(copy.parent / "other")  # in the same split
    result = hid2("generate", data_scenes["curve"], other, "-o", tmp_path / "out")
    assert "are both scene" in one_line(result, code=2)
    assert not (tmp_path / "out").exists()


def test_full_disk_is_one_line_and_the_batch_goes_on_when_there_is_room(
    hid2: Run, data_scenes: dict[str, Path], tmp_path: Path
) -> None:
    """No file may grow beyond 8 kB: the system says so as it does on a full disk."""
    arguments = ["generate", str(data_scenes["curve"]), "-o", str(tmp_path / "out"), "--agents", "1"]
    result = subprocess.run(
        [str(Path(sys.executable).parent / "hid2"), *arguments],
        capture_output=True, text=True, timeout=300,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (8_000, 8_000)),
    )  # fmt: skip
    line = one_line(result, code=1)
    assert "cannot be written (File too large); finished scenes are in" in line
    assert line.endswith("make room and continue with --resume")
    assert [path for path in tree(tmp_path / "out") if "quarantine" in path or ".json" in path] == []
    assert hid2(*arguments, "--resume", "-q").returncode == 0


def test_file_in_the_place_of_libsumo_is_named(data_scenes: dict[str, Path], tmp_path: Path) -> None:
    (tmp_path / "libsumo.py").write_text("TraCIException = FatalTraCIError = Exception\n")
    command = [sys.executable, "-m", "bridge.cli", "generate", str(data_scenes["curve"]), "-o", "out"]
    result = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=300)
    assert "libsumo.py: not SUMO's libsumo, rename it or move it away" in one_line(result, code=1)


@pytest.mark.parametrize("jobs", [1, 2])
def test_sigterm_leaves_no_process_and_no_temporary_file(data_root: Path, tmp_path: Path, jobs: int) -> None:
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    command = [str(Path(sys.executable).parent / "hid2"), "generate", str(data_root), "-o", str(tmp_path / "out")]
    command += ["--variants", "50", "--jobs", str(jobs), "-q"]
    process = subprocess.Popen(command, env=os.environ | {"TMPDIR": str(scratch)}, stderr=subprocess.PIPE, text=True)
    while len(list(scratch.glob("*/hid2-scene-*"))) < jobs:
        assert process.poll() is None
        time.sleep(0.05)
    time.sleep(1.0)
    children = psutil.Process(process.pid).children(recursive=True)
    assert len(children) >= jobs
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 143
    assert len(errors.splitlines()) == 1, errors
    assert still_running(children, timeout_s=10) == []
    assert list(scratch.iterdir()) == []


def test_name_that_the_system_refuses_is_one_line(hid2: Run, data_scenes: dict[str, Path], tmp_path: Path) -> None:
    """Longer than a file name may be, as the only scene, below one, and as the folder to write to."""
    long, scene = "9" * 5000, data_scenes["curve"]
    for command in (["scan", long], ["generate", scene / long, "-o", "out"], ["generate", scene, "-o", long]):
        assert "File name too long" in one_line(hid2(*command, cwd=tmp_path), code=1)
    assert tree(tmp_path) == []


def test_time_that_never_comes_is_a_mistake_of_usage(hid2: Run, data_scenes: dict[str, Path], tmp_path: Path) -> None:
    result = hid2("generate", data_scenes["curve"], "-o", tmp_path / "out", "--scene-timeout", "inf")
    assert "scene-timeout inf: expected 1 to 86400 s" in one_line(result, code=2)
