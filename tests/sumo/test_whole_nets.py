"""Nets of whole lanes in SUMO: traffic of its own drives on them as on a grid that SUMO makes."""

import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import pytest
from lxml import etree

from bridge.recordings.sources import read_recording
from bridge.sumo import net as nets
from bridge.sumo.net import convert, convert_whole, sumo_program
from netconvert.errors import ConfigError, SimulationError
from netconvert.net_xml import CITY_ORIGINS
from netconvert.roads import roads_of


def drive(net: Path) -> tuple[int, int, int]:
    """300 of SUMO's randomTrips, one a second, to the end: vehicles, collisions, warnings (of waits of 300 s)."""
    tool = Path(import_module("sumo").SUMO_HOME) / "tools" / "randomTrips.py"
    net = net.absolute()  # the tool leaves a file in its working directory
    trips, log = net.with_suffix(".trips.xml"), net.with_suffix(".log")
    command = [sys.executable, tool, "-n", net, "-o", trips, "-e", "300", "-p", "1", "--validate", "--seed", "42"]
    made = subprocess.run(list(map(str, command)), cwd=net.parent, capture_output=True, text=True)
    assert made.returncode == 0, made.stderr
    command = [sumo_program("sumo"), "-n", net, "-r", trips, "-e", "1500", "--no-step-log", "--seed", "1"]
    command += ["--collision.action", "warn", "--duration-log.statistics"]
    result = subprocess.run([*map(str, command), "--log", str(log)], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    said = log.read_text()
    warnings = [line for line in said.splitlines() if line.startswith("Warning")]
    return int(re.search(r"Inserted: (\d+)", said)[1]), sum("collision" in one for one in warnings), len(warnings)


def on_a_grid(folder: Path) -> float:
    """Warnings for each vehicle on a grid of netgenerate."""
    net = folder / "grid.net.xml"
    command = [sumo_program("netgenerate"), "--grid", "--grid.number", "4", "-L", "2", "-o", str(net)]
    assert subprocess.run(command, capture_output=True).returncode == 0
    vehicles, _, warnings = drive(net)
    return warnings / vehicles


def check(scene: Path, folder: Path, most: float) -> int:
    net = convert_whole(scene, folder)
    vehicles, collisions, warnings = drive(net)
    assert collisions == 0, scene
    assert warnings <= most * vehicles, scene
    assert vehicles >= 150, scene
    root, roads = etree.parse(net).getroot(), roads_of(read_recording(scene).graph)
    lane_of = {
        (edge.get("id"), lane.get("index")): int(lane.find("param[@key='av2.lane_segment_id']").get("value"))
        for edge in root.iterfind("edge")
        if not edge.get("id").startswith(":")
        for lane in edge.iterfind("lane")
    }
    assert set(lane_of.values()) == set(roads.place)
    links = {
        (lane_of.get((link.get("from"), link.get("fromLane"))), lane_of.get((link.get("to"), link.get("toLane"))))
        for link in root.iterfind("connection")
        if not link.get("from").startswith(":")
    }
    assert links == {(way.source, way.target) for way in roads.ways}
    return vehicles


def test_traffic_drives_on_a_real_map(real_scenes: list[Path], tmp_path: Path) -> None:
    check(real_scenes[0], tmp_path, on_a_grid(tmp_path))


@pytest.mark.slow
def test_traffic_drives_on_fourteen_real_maps(fourteen_scenes: list[Path], tmp_path: Path) -> None:
    """A teleport is two warnings: five from wrong lanes, on three maps; one map jams."""
    most = {scene: 0.5 if scene.name.startswith("7fab2350") else 0.02 for scene in fourteen_scenes}
    print({scene.name[:8]: check(scene, tmp_path, most[scene]) for scene in fourteen_scenes})


def test_the_same_map_gives_the_same_bytes_on_the_globe(data_scenes: dict[str, Path], tmp_path: Path) -> None:
    data_scene = data_scenes["curve"]
    one, other = (convert_whole(data_scene, tmp_path / name) for name in ("one", "other"))
    assert one.read_bytes() == other.read_bytes()
    location = etree.parse(one).find("location")
    origin = CITY_ORIGINS[read_recording(data_scene).city]
    assert location.get("projParameter") == origin.projection
    assert [-float(part) for part in location.get("netOffset").split(",")] == pytest.approx(
        [origin.easting_m, origin.northing_m], abs=0.01
    )


def test_signals_are_in_the_net(real_scenes: list[Path], tmp_path: Path) -> None:
    (scene,) = (scene for scene in real_scenes if scene.name.startswith("0a0af725"))
    net = convert_whole(scene, tmp_path, signals=True)
    assert "yellow" not in subprocess.run([sumo_program("sumo"), "-n", net], capture_output=True, text=True).stderr
    programs = etree.parse(net).findall("tlLogic")
    assert programs
    for program in programs:
        duration = sum(float(phase.get("duration")) for phase in program.iterfind("phase"))
        assert duration == pytest.approx(read_recording(scene).num_steps * 0.1)


def test_what_cannot_be_is_said_in_one_line(
    data_scenes: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (path,) = data_scenes["curve"].glob("log_map_archive_*.json")
    with pytest.raises(ConfigError, match="a map alone, expected a scene: signals"):
        convert_whole(path, tmp_path / "out", signals=True)
    monkeypatch.setattr(nets, "import_module", lambda _: SimpleNamespace(SUMO_HOME=tmp_path))
    monkeypatch.setattr(nets.shutil, "which", lambda _: None)
    with pytest.raises(SimulationError, match=r"SUMO's netconvert is not installed; install it: sh setup\.sh"):
        convert_whole(path, tmp_path / "out")
    assert convert(path, tmp_path / "out").lanes_in_net > 0
