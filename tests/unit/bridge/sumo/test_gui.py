"""Scenes in sumo-gui, on a virtual screen, and what SUMO makes of the files alone."""

import math
import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pandas as pd
import psutil
import pytest
import sumolib
from lxml import etree

from bridge.exports.export import export_scene
from bridge.pictures.figures import kinds_in
from bridge.recordings.scenario import read_scenario
from bridge.sumo.exchange import play_scene, rgb
from hid2.agents import Policy
from netconvert.errors import ConfigError, ExportError, SimulationError

BIN = Path(sys.executable).parent


def sumo(config, *options):
    return subprocess.run(
        [BIN / "sumo", "-c", config, "--no-step-log", "true", *options], capture_output=True, text=True, timeout=300
    )


@pytest.fixture(scope="module")
def playable(made_scene, tmp_path_factory):
    return exported(made_scene, tmp_path_factory.mktemp("play"))


def exported(scene, out):
    return next(path for path in export_scene(scene, "sumo", out) if path.name.endswith("_scene.sumocfg"))


def poses(path):
    """Front bumper and angle by agent and time, of an FCD file."""
    steps = etree.parse(path).getroot()
    return {
        (vehicle.get("id"), float(step.get("time"))): [float(vehicle.get(name)) for name in ("x", "y", "angle")]
        for step in steps
        for vehicle in step
    }


def check(config, out, *, has_gaps):
    """SUMO plays what the FCD file beside says, state by state, without a word: to .1 m and 3 degrees.

    Nothing is there that is not in the file, but for agents that nobody saw for a while.
    """
    result = sumo(config, "--fcd-output", out, "--precision", "4")
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    beside = poses(str(config).replace("_scene.sumocfg", ".fcd.xml"))
    found = poses(out)
    assert found.keys() == beside.keys() or (has_gaps and found.keys() > beside.keys())
    apart = np.array([found[state] for state in beside]) - np.array(list(beside.values()))
    assert np.hypot(apart[:, 0], apart[:, 1]).max() < 0.1
    assert np.abs((apart[:, 2] + 180.0) % 360.0 - 180.0).max() < 3.0


def test_sumo_plays_a_generated_scene_from_files_as_the_fcd_file_beside_says(playable, tmp_path):
    check(playable, tmp_path / "fcd.xml", has_gaps=False)


@pytest.mark.parametrize("real_scene", ["0a1e6f0a-1817-4a98-b02e-db8c9327d151"], indirect=True)
def test_sumo_plays_a_real_scene_from_files_as_the_fcd_file_beside_says(real_scene, tmp_path):
    """Cars cannot enter on the first edge of this map's net, in the order of its names: a bicycle lane.

    Nor does a lane of a trace join junctions in one place: netedit saves no such net at once.
    """
    config = exported(real_scene, tmp_path / "play")
    check(config, tmp_path / "fcd.xml", has_gaps=True)
    net = etree.parse(config.with_suffix(".net.xml")).getroot()
    place = {each.get("id"): (float(each.get("x")), float(each.get("y"))) for each in net.iterfind("junction")}
    assert min(math.dist(place[edge.get("from")], place[edge.get("to")]) for edge in net.iterfind("edge")) >= 0.049


def test_a_gap_in_a_track_is_driven_through_evenly(copy_scene, tmp_path):
    """Half of the rows of the middle 2 s are gone: the vehicle is there at each of these steps all the same."""
    folder = copy_scene("curve")
    path = next(folder.glob("scenario_*.parquet"))
    rows = pd.read_parquet(path)
    name = rows.groupby("track_id")["timestep"].count().loc[lambda count: count == 110].index[0]
    gone = (rows["track_id"] == name) & rows["timestep"].between(60, 79)
    rows[~gone].to_parquet(path, index=False)
    config = exported(folder, tmp_path / "play")
    assert sumo(config, "--fcd-output", tmp_path / "fcd.xml").returncode == 0
    found = poses(tmp_path / "fcd.xml")
    assert [k for k in range(110) if (name, round(k * 0.1, 2)) in found] == list(range(110))
    check(config, tmp_path / "again.xml", has_gaps=True)


def test_vehicles_carry_the_colour_of_their_policy_and_inserted_and_focal_ones_their_ids(playable, made_scene):
    scenario = read_scenario(made_scene)
    kinds = kinds_in(scenario)
    routes = etree.parse(str(playable).replace(".sumocfg", ".rou.xml"))
    assert {v.get("id"): v.get("color") for v in routes.iter("vehicle")} == {k: rgb(kind) for k, kind in kinds.items()}
    assert {policy.value for policy in Policy} & {*kinds.values()}
    assert "recorded" in kinds.values()
    shown = {param.get("value") for param in routes.iter("param")}
    assert shown == {t.track_id for t in scenario.tracks if t.track_id.startswith("gen_") or t.category == 3}


def test_files_are_valid_and_hold_the_lanes_of_the_map(playable, made_scene):
    schemas = Path(os.environ.get("SUMO_HOME", Path(sumolib.__file__).parents[1] / "sumo")) / "data" / "xsd"
    for name, schema in (
        (".net.xml", "net_file.xsd"),
        (".rou.xml", "routes_file.xsd"),
        (".sumocfg", "sumoConfiguration.xsd"),
    ):
        document = etree.parse(str(playable).replace(".sumocfg", name))
        etree.XMLSchema(etree.parse(str(schemas / schema))).assertValid(document)
    net = sumolib.net.readNet(str(playable).replace(".sumocfg", ".net.xml"))
    lanes = {lane.getParam("av2.lane_segment_id") for edge in net.getEdges() for lane in edge.getLanes()} - {None}
    assert lanes == {str(lane_id) for lane_id in read_scenario(made_scene).graph.lanes}


def test_same_scene_gives_the_same_files_which_play_in_real_time(playable, made_scene, tmp_path):
    only = etree.parse(playable).find("gui_only")
    assert only.find("delay").get("value") == "1000"  # milliseconds for a simulated second
    assert [only.find(key).get("value") for key in ("start", "breakpoints")] == ["true", "0.00,10.90"]
    again = exported(made_scene, tmp_path)
    for path in again.parent.iterdir():
        assert path.read_bytes() == (playable.parent / path.name).read_bytes()


def colored(path, rgb):
    picture = iio.imread(path)[..., :3].astype(int)
    return int((np.abs(picture - np.array(rgb)).max(axis=-1) < 20).sum())


def face(kind):
    return [int(part) for part in rgb(kind).split(",")]


LANE_GREY, CELL_LINE = (96, 99, 104), (150, 154, 160)


def played(scene, picture, screen, step):
    """What a process says that plays a scene and takes a picture of a step."""
    code = "import sys; from pathlib import Path; from bridge.sumo.exchange import play_scene; "
    code += f"print(play_scene(Path(sys.argv[1]), screenshot=Path(sys.argv[2]), step={step}))"
    result = subprocess.run(
        [sys.executable, "-c", code, scene, picture], capture_output=True, text=True, timeout=300, env=screen
    )
    assert result.returncode == 0, result.stderr
    return result.stdout.strip()


def test_gui_plays_the_scene_and_takes_a_picture(made_scene, tmp_path, screen):
    """Of the last step, which stays: every vehicle that is there then is drawn."""
    picture = tmp_path / "deep" / "gui.png"
    assert played(made_scene, picture, screen, 109) == str(picture)
    assert colored(picture, LANE_GREY) > 2000
    assert colored(picture, CELL_LINE) > 200
    assert colored(picture, face("recorded")) > 20
    policies = {policy.value for policy in Policy} & {*kinds_in(read_scenario(made_scene)).values()}
    assert sum(colored(picture, face(kind)) for kind in policies) > 20 * len(policies)


def test_without_a_display_or_the_step_the_reason_is_said(made_scene, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(SimulationError, match="no display"):
        play_scene(made_scene)
    monkeypatch.setenv("DISPLAY", ":0")  # nothing is shown yet
    with pytest.raises(ConfigError, match=r"timestep 500, expected 0 to 109"):
        play_scene(made_scene, step=500)


@pytest.mark.parametrize(
    ("does", "error", "said"),
    [("kill -SEGV $$", SimulationError, "exit code -11"), ("exit 0", ExportError, "drew no picture")],
)
def test_a_sumo_gui_that_dies_or_draws_nothing_is_told_beside_an_older_picture(
    data_scenes, tmp_path, monkeypatch, does, error, said
):
    fake, picture = tmp_path / "sumo-gui", tmp_path / "gui.png"
    fake.write_text(f"#!/bin/sh\n{does}\n")
    fake.chmod(0o755)
    picture.write_bytes(b"older")
    monkeypatch.setattr("bridge.sumo.exchange.sumo_program", lambda name: str(fake))
    monkeypatch.setenv("DISPLAY", ":0")
    with pytest.raises(error, match=said):
        play_scene(data_scenes["curve"], screenshot=picture)
    assert picture.read_bytes() == b"older"


@pytest.mark.parametrize("closes", ["the window", "the command"])
def test_gui_ends_without_a_word_when_its_window_is_closed_or_when_it_is_interrupted(made_scene, screen, closes):
    """Ctrl-C ends the command with the code that its help names; sumo-gui, in its group, may be gone before it."""
    command = [BIN / "hid2", "gui", made_scene]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=screen, start_new_session=True) as it:
        try:
            waits = next(line for line in it.stderr if line.startswith("hid2: sumo-gui waits"))
            if closes == "the command":
                os.killpg(it.pid, signal.SIGINT)
            else:
                (window,) = psutil.Process(it.pid).children()
                window.terminate()
            code = it.wait(60)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(it.pid, signal.SIGKILL)
        rest = it.stderr.read()
    assert "play with Ctrl+A" in waits
    assert "Traceback" not in rest, rest
    assert code == (130 if closes == "the command" else 0)
