"""Scenes in sumo-gui: from files alone, and steered through TraCI, on a virtual screen."""

import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import psutil
import pytest
import sumolib
from lxml import etree

from bridge.exports.export import export_scene
from bridge.recordings.scenario import read_scenario
from bridge.sumo.playback import POLICIES, RECORDED, STANDS_M, paints
from bridge.sumo.poses import sumo_poses
from netconvert.errors import ConfigError, SimulationError

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


def played(config, out):
    """Front bumper and angle by agent and step, as sumo plays the files."""
    result = sumo(config, "--fcd-output", out, "--precision", "4")
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    found = {}
    for step in etree.parse(out).getroot():
        for vehicle in step:
            place = float(vehicle.get("x")), float(vehicle.get("y")), float(vehicle.get("angle"))
            found[vehicle.get("id"), round(float(step.get("time")) * 10)] = place
    return found


def check(folder, found):
    """Every state is played, half of them within 0.25 m and 95 % within 1 m of where they are."""
    apart = []
    total = 0
    for track in read_scenario(folder).tracks:
        front, _ = sumo_poses(track.position, track.heading, np.full(len(track.timesteps), track.size.length_m))
        total += len(front)
        for step, place in zip(track.timesteps, front, strict=True):
            if (track.track_id, int(step)) in found:
                apart.append(np.hypot(*(place - found[track.track_id, int(step)][:2])))
    assert len(apart) > 0.99 * total
    assert np.median(apart) < 0.25
    assert np.percentile(apart, 95) < 1.0


def test_sumo_plays_a_generated_scene_from_files_without_a_warning(playable, made_scene, tmp_path):
    check(made_scene, played(playable, tmp_path / "fcd.xml"))


def test_sumo_plays_real_scenes_from_files(real_scene, tmp_path):
    config = exported(real_scene, tmp_path / "play")
    check(real_scene, played(config, tmp_path / "fcd.xml"))


def test_generated_vehicles_are_played_where_they_are(playable, made_scene, tmp_path):
    """Their motion is smooth, so they stay near all the time: SUMO is late where speeds change within a stretch."""
    found = played(playable, tmp_path / "fcd.xml")
    for track in read_scenario(made_scene).tracks:
        if not track.track_id.startswith("gen_") or np.ptp(track.position, axis=0).max() < STANDS_M:
            continue
        front, _ = sumo_poses(track.position, track.heading, np.full(len(track.timesteps), track.size.length_m))
        places = np.array([found[track.track_id, int(step)][:2] for step in track.timesteps[:-1]])
        apart = np.hypot(*(places - front[:-1]).T)
        assert np.median(apart) < 0.5, track.track_id
        assert apart.max() < 1.0, track.track_id


def test_vehicles_carry_the_colour_of_their_policy(playable, made_scene):
    colors = paints(read_scenario(made_scene))
    routes = etree.parse(str(playable).replace(".sumocfg", ".rou.xml"))
    assert {v.get("id"): v.get("color") for v in routes.iter("vehicle")} == {k: p.xml for k, p in colors.items()}
    assert any(paint in POLICIES.values() for paint in colors.values())
    assert RECORDED in colors.values()


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


def test_same_scene_gives_the_same_files(playable, made_scene, tmp_path):
    again = exported(made_scene, tmp_path)
    for path in again.parent.iterdir():
        assert path.read_bytes() == (playable.parent / path.name).read_bytes()


def colored(path, rgb):
    picture = iio.imread(path)[..., :3].astype(int)
    return int((np.abs(picture - np.array(rgb)).max(axis=-1) < 20).sum())


OPEN = """
import sys, traci
traci.start([sys.argv[3], "-c", sys.argv[1], "--quit-on-end", "--delay", "0", "--breakpoints", "1000"])
for _ in range(50):
    traci.simulationStep()
traci.gui.screenshot(traci.gui.getIDList()[0], sys.argv[2])
traci.simulationStep()
traci.close()
"""
LANE_GREY, CELL_LINE = (96, 99, 104), (150, 154, 160)


def assert_shows_the_scene(picture, folder):
    """Road, recorded and generated vehicles are there in their colours."""
    assert colored(picture, LANE_GREY) > 2000
    assert colored(picture, CELL_LINE) > 200
    assert colored(picture, RECORDED.rgba[:3]) > 20
    policies = {paint for paint in paints(read_scenario(folder)).values() if paint in POLICIES.values()}
    assert sum(colored(picture, paint.rgba[:3]) for paint in policies) > 20 * len(policies)


def test_sumo_gui_opens_the_files_and_shows_net_and_vehicles(playable, made_scene, tmp_path, screen):
    picture = tmp_path / "files.png"
    command = [sys.executable, "-c", OPEN, playable, picture, BIN / "sumo-gui"]
    environment = {key: value for key, value in screen.items() if key != "LIBSUMO_AS_TRACI"}
    result = subprocess.run(command, capture_output=True, text=True, timeout=300, env=environment)
    assert result.returncode == 0, result.stderr
    assert_shows_the_scene(picture, made_scene)


def test_gui_plays_the_scene_at_exact_positions_and_takes_a_picture(made_scene, tmp_path, screen):
    picture = tmp_path / "deep" / "gui.png"
    code = "import sys; from pathlib import Path; from bridge.sumo.gui import play_scene; "
    code += "print(play_scene(Path(sys.argv[1]), screenshot=Path(sys.argv[2])))"
    result = subprocess.run(
        [sys.executable, "-c", code, made_scene, picture], capture_output=True, text=True, timeout=300, env=screen
    )
    assert result.returncode == 0, result.stderr
    assert result.stdout.strip() == str(picture)
    assert "Retrying" not in result.stderr  # how traci waits for the window is nobody's business
    assert_shows_the_scene(picture, made_scene)


def test_without_a_display_the_reason_is_said(made_scene, monkeypatch):
    from bridge.sumo.gui import play_scene

    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(SimulationError, match="no display"):
        play_scene(made_scene)


@pytest.mark.parametrize("real_scene", ["0a1e6f0a-1817-4a98-b02e-db8c9327d151"], indirect=True)
def test_a_map_that_begins_with_a_bicycle_lane_is_played_too(real_scene, tmp_path, screen):
    """Cars cannot enter on the first edge of this map's net, in the order of its names."""
    picture = tmp_path / "gui.png"
    code = "import sys; from pathlib import Path; from bridge.sumo.gui import play_scene; "
    code += "play_scene(Path(sys.argv[1]), screenshot=Path(sys.argv[2]))"
    result = subprocess.run(
        [sys.executable, "-c", code, real_scene, picture], capture_output=True, text=True, timeout=300, env=screen
    )
    assert result.returncode == 0, result.stderr
    assert colored(picture, LANE_GREY) > 2000


STEPS = """
import sys, time, traci
traci.start([sys.argv[2], "-c", sys.argv[1]])
while True:
    traci.simulationStep()
    print(traci.simulation.getTime(), flush=True)
"""


def test_sumo_gui_shows_the_first_step_and_waits(playable, screen):
    """The second step begins when the user presses play, so that four seconds see one."""
    environment = {key: value for key, value in screen.items() if key != "LIBSUMO_AS_TRACI"}
    command = [sys.executable, "-c", STEPS, playable, BIN / "sumo-gui"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment, start_new_session=True
    ) as it:
        try:
            lines = iter(it.stdout.readline, "")
            first = next(line for line in lines if line[0].isdigit())
            with pytest.raises(subprocess.TimeoutExpired):
                it.wait(4)
        finally:
            os.killpg(it.pid, signal.SIGKILL)  # sumo-gui too, which holds the pipe
        assert [float(first), *(float(line) for line in lines)] == [0.1]


def test_files_play_in_real_time_and_say_what_the_colours_mean(playable, made_scene):
    configuration = etree.parse(playable)
    assert configuration.find("gui_only/delay").get("value") == "1000"  # milliseconds for a simulated second
    assert [configuration.find(f"gui_only/{key}").get("value") for key in ("start", "breakpoints")] == ["true", "0.1"]
    shapes = etree.parse(str(playable).replace(".sumocfg", ".poly.xml"))
    told = {shape.get("color") for shape in shapes.iterfind("poly") if shape.get("type") == "legend"}
    assert told == {paint.xml for paint in paints(read_scenario(made_scene)).values()}


def test_inserted_and_focal_vehicles_show_their_ids(playable, made_scene):
    routes = etree.parse(str(playable).replace(".sumocfg", ".rou.xml"))
    shown = {param.get("value") for param in routes.iter("param")}
    tracks = read_scenario(made_scene).tracks
    assert shown == {t.track_id for t in tracks if t.track_id.startswith("gen_") or t.category == 3}


def test_step_that_the_scene_does_not_have_is_named(made_scene, monkeypatch):
    from bridge.sumo.gui import play_scene

    monkeypatch.setenv("DISPLAY", ":0")  # nothing is shown yet
    with pytest.raises(ConfigError, match=r"timestep 500 is out of range \(0-109\)"):
        play_scene(made_scene, step=500)


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
