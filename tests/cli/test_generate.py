"""`hid2 generate`: what it writes, what it says, and its exit codes."""

import csv
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bridge.recordings.scenario import read_scenario
from bridge.recordings.sidecar import Sidecar, read_sidecar

Run = Callable[..., Any]


def rows_of(out: Path) -> list[dict[str, str]]:
    with (out / "manifest.csv").open() as file:
        return list(csv.DictReader(file))


def sidecar_of(out: Path, row: dict[str, str]) -> Sidecar:
    return read_sidecar(next((out / row["folder"]).glob("hid2_*.json")))


def test_quick_start_ends_with_what_was_written_and_a_table(
    hid2: Run, new_hid2: Run, data_root: Path, tmp_path: Path
) -> None:
    """With the counts of the sidecars in the manifest."""
    result = new_hid2("generate", data_root, "--agents", 10, "-o", tmp_path / "out")
    assert result.returncode == 0
    lines = result.stdout.splitlines()
    assert lines[-1] == str(tmp_path / "out" / "manifest.csv")
    assert "3 of 3 scenes done" in result.stdout
    assert result.stdout.count("10 of 10") == 3
    rows = rows_of(tmp_path / "out")
    for row in rows:
        assert str(tmp_path / "out" / row["folder"]) in lines
        sidecar = sidecar_of(tmp_path / "out", row)
        maneuvers = [maneuver for _, maneuver in sidecar.asked]
        assert int(row["placed"]) == sidecar.placed.agents == len(sidecar.agents)
        assert int(row["maneuvers_requested"]) == len(maneuvers)
        assert int(row["lane_change"]) == sum(m.kind == "lane_change" and m.status == "done" for m in maneuvers)
        assert row["config_sha256"] == sidecar.config_sha256
    assert sum(int(row["lane_change"]) for row in rows) > 0
    checked = hid2("validate", tmp_path / "out", "--source", data_root)
    assert (checked.returncode, checked.stdout) == (0, "")


def test_request_ends_up_in_the_sidecar(hid2: Run, data_scenes: dict[str, Path], tmp_path: Path) -> None:
    file = tmp_path / "c.toml"
    file.write_text("[lane_change]\nmin_gap_m = 3.0\n[request]\nagents = 9\n")
    result = hid2(
        "generate", data_scenes["arterial"], "-o", tmp_path / "out", "--config", file, "--agents", 4,
        "--behaviours", "lane_change=0.5,straight=0.5", "--trigger-time", "1:2", "--seed", 7, "--variants", 2,
        "--focal", "generated", "--set", "overtake.d_obs_m=50", "--no-spawn-leaders", "--without", "smoothing",
        "--entering", 0.3, "--check-replay",
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    rows = rows_of(tmp_path / "out")
    assert [row["variant"] for row in rows] == ["0", "1"]
    for row in rows:
        config = sidecar_of(tmp_path / "out", row).config
        request = config["request"]
        assert (request["agents"], request["seed"], request["focal"]) == (4, 7, "generated")
        assert request["entering"] == 0.3
        assert (request["straight"], request["lane_change"], request["overtake"]) == (0.5, 0.5, 0.0)
        assert (request["trigger_min_s"], request["trigger_max_s"], request["spawn_leaders"]) == (1.0, 2.0, False)
        assert config["lane_change"]["min_gap_m"] == 3.0
        assert config["overtake"]["d_obs_m"] == 50
        assert config["without"] == ["smoothing"]
        assert config["driving"]["check_replay"] is True


def test_drivers_are_drawn_as_their_file_says(hid2: Run, data_scenes: dict[str, Path], tmp_path: Path) -> None:
    path = tmp_path / "drivers.toml"
    path.write_text("[drivers]\ntau_mean_s = 1.7\ntau_sd_s = 0.0\n")
    out = tmp_path / "out"
    result = hid2("generate", data_scenes["arterial"], "-o", out, "--agents", 3, "--drivers", path, "-q")
    assert (result.returncode, result.stdout, result.stderr) == (0, "", ""), "-q says nothing when all is well"
    sidecar = sidecar_of(out, rows_of(out)[0])
    assert sidecar.config["drivers"]["tau_mean_s"] == 1.7
    assert {round(agent.driver.parameters["tau_s"], 9) for agent in sidecar.agents if agent.driver} == {1.7}


def test_event_that_comes_about_in_no_scene_is_in_the_table_with_its_reason_and_exit_code_1(
    hid2: Run, data_scenes: dict[str, Path], tmp_path: Path
) -> None:
    """No lane of the curve is 500 m long."""
    out = tmp_path / "out"
    result = hid2("generate", data_scenes["curve"], "-o", out, "--agents", 0, "--event", "cut_in", "--gap", "500:600")
    assert result.returncode == 1
    (row,) = rows_of(out)
    assert (row["events_requested"], row["events_done"]) == ("1", "0")
    assert re.fullmatch(r"cut_in with av: event_[\w:]+ \(1\)", row["not_done"])
    assert row["not_done"] in result.stdout
    assert result.stdout.splitlines()[1].split()[-5:] == ["events", "run", "time,", "s", "remarks"]
    assert "\nevents done: 0 of 1\n" in result.stdout
    wanted = f"hid2: error: cut_in with av: asked for, and came about in no scene; {out}/manifest.csv has the reasons"
    assert wanted in result.stderr.splitlines()


def test_what_only_some_scenes_can_meet_is_a_reason_in_the_others(
    hid2: Run, data_scenes: dict[str, Path], tmp_path: Path
) -> None:
    """A track of the arterial is not in the other scene, which is written all the same."""
    track = next(t.track_id for t in read_scenario(data_scenes["arterial"]).tracks if t.track_id != "AV")
    scenes = (data_scenes["arterial"], data_scenes["curve"])
    result = hid2("generate", *scenes, "-o", tmp_path / "out", "--agents", 2, "--near", track)
    assert result.returncode == 0, result.stderr
    rows = {row["scenario"]: row for row in rows_of(tmp_path / "out")}
    assert {row["status"] for row in rows.values()} == {"done"}
    row, lacking = (rows[scene.name] for scene in scenes)
    assert (lacking["placed"], lacking["rejected"][:15]) == ("0", "near_no_track (")
    assert {entry.reason for entry in sidecar_of(tmp_path / "out", lacking).rejected} == {"near_no_track"}
    assert "near_no_track" in result.stdout
    assert int(row["placed"]) > 0
    assert f"{row['placed']} of 2, {row['near']} near" in result.stdout


def test_scene_that_fails_costs_exit_code_1_and_not_the_others(
    hid2: Run, data_scenes: dict[str, Path], copy_scene: Callable[..., Path], tmp_path: Path
) -> None:
    broken = copy_scene("curve")
    next(broken.glob("log_map_archive_*.json")).write_text("{")
    result = hid2("generate", data_scenes["arterial"], broken, "-o", tmp_path / "my out", "--agents", 2)
    assert (result.returncode, "1 of 2 scenes done" in result.stdout) == (1, True), result.stdout
    assert "not JSON" in result.stderr
    (bad,) = [row for row in rows_of(tmp_path / "my out") if row["status"] == "quarantined"]
    assert f"hid2 generate --repro '{tmp_path / 'my out' / bad['bundle']}'" in result.stderr
    again = hid2("generate", "--repro", tmp_path / "my out" / bad["bundle"])
    assert (again.returncode, "now:  error:" in again.stdout) == (1, True), again.stdout


def test_scene_goes_into_the_split_of_its_source_and_it_is_said_where_there_is_none(
    hid2: Run, data_scenes: dict[str, Path], tmp_path: Path
) -> None:
    source = data_scenes["arterial"]
    shutil.copytree(source, tmp_path / "mine" / source.name)
    loose = hid2("generate", tmp_path / "mine", "-o", tmp_path / "out", "--agents", 0)
    assert f"1 of 1 scenes in no folder train, val or test: no split in {tmp_path}/out has them" in loose.stderr
    assert "in no folder" not in hid2("generate", source, "-o", tmp_path / "again", "--agents", 0).stderr
    folders = [rows_of(tmp_path / out)[0]["folder"] for out in ("out", "again")]
    assert [Path(folder).parent.name for folder in folders] == ["", source.parent.name]


def test_debug_log_tells_the_story_of_every_vehicle(hid2: Run, data_scenes: dict[str, Path], tmp_path: Path) -> None:
    """As many lines as vehicles that are in the scene or in its record of replaced ones; without -vv none of them."""
    asked = ("generate", data_scenes["arterial"], "--agents", 4)
    told = hid2(*asked, "-o", tmp_path / "told", "-vv")
    assert told.returncode == 0, told.stderr
    sidecar = sidecar_of(tmp_path / "told", rows_of(tmp_path / "told")[0])
    lines = [line for line in told.stderr.splitlines() if ": vehicle v" in line]
    kept = [line for line in lines if ": kept" in line]
    assert len(kept) == sidecar.placed.agents > 0
    assert len(lines) == len(kept) + len(sidecar.replaced)
    for one in sidecar.replaced:
        place = f"lane {one.lane_segment_id} cell {one.cell}, last step {one.last_step}: {one.reason}"
        assert sum(f"vehicle {one.vehicle}, {one.policy}, {place}" in line for line in lines) == 1
    silent = hid2(*asked[:2], "--agents", 1, "-o", tmp_path / "silent", "-v")
    assert "vehicle v" not in silent.stderr
    assert "placed" in silent.stderr
