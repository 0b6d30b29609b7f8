"""A scene in SUMO's formats: FCD output is the exported positions, routes are ways of the net, which has a place."""

import json
import math
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from av2.geometry.utm import CITY_ORIGIN_LATLONG_DICT, UTM_ZONE_MAP, CityName, convert_gps_to_utm
from lxml import etree

from bridge.exports.export import export_scene
from bridge.recordings.scenario import read_scenario
from bridge.recordings.sidecar import read_sidecar, sidecar_path
from bridge.sumo.exchange import sumo_files
from bridge.sumo.poses import box_poses
from netconvert.geo import CITY_ORIGINS

_NAMES = {"austin": "ATX", "dearborn": "DTW", "miami": "MIA", "palo-alto": "PAO", "pittsburgh": "PIT"}
_NAMES |= {"washington-dc": "WDC"}


@pytest.fixture(scope="session")
def written(made_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files of a generated scene."""
    out = tmp_path_factory.mktemp("sumo") / "deep" / "out"
    export_scene(made_scene, "sumo", out)
    return out


def _read(folder: Path, ending: str) -> etree._Element:
    (path,) = (path for path in folder.glob(f"*{ending}") if "_scene" not in path.name)
    return etree.parse(path).getroot()


def test_fcd_output_is_the_exported_positions_to_a_millimetre(written: Path, made_scene: Path) -> None:
    """Front bumpers and degrees, turned back into centres and headings: 1 mm, 0.001 degrees; nobody is left out."""
    scenario = read_scenario(made_scene)
    root = _read(written, ".fcd.xml")
    rows = 0
    tracks = {track.track_id: track for track in scenario.tracks}
    for step, timestep in enumerate(root.iter("timestep")):
        assert float(timestep.get("time")) == pytest.approx(step * scenario.step_s)
        for vehicle in timestep:
            track = tracks[vehicle.get("id")]
            (row,) = np.flatnonzero(track.timesteps == step)
            front = np.array([[float(vehicle.get("x")), float(vehicle.get("y"))]])
            length = np.array([track.size.length_m])
            center, heading = box_poses(front, np.array([float(vehicle.get("angle"))]), length)
            assert math.hypot(*(center[0] - track.position[row])) < 0.002
            assert abs(math.remainder(heading[0] - track.heading[row], math.tau)) < 1e-4
            assert float(vehicle.get("speed")) == pytest.approx(track.speed[row], abs=1e-3)
            rows += 1
    assert rows == sum(len(track.timesteps) for track in scenario.tracks)


def test_positions_along_lanes_are_where_the_front_bumpers_are(written: Path, made_scene: Path) -> None:
    """lane and pos of the inserted vehicles, laid on the net's shapes, give x and y to half a lane's width."""
    lanes = {}
    for lane in _read(written, ".net.xml").iter("lane"):
        lanes[lane.get("id")] = np.array([tuple(map(float, xy.split(","))) for xy in lane.get("shape").split()])
    for vehicle in _read(written, ".fcd.xml").iter("vehicle"):
        assert vehicle.get("lane") in lanes
        if not vehicle.get("id").startswith("gen_"):
            continue
        line, pos = lanes[vehicle.get("lane")], float(vehicle.get("pos"))
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
        place = [float(np.interp(pos, along, line[:, axis])) for axis in (0, 1)]
        assert math.dist(place, (float(vehicle.get("x")), float(vehicle.get("y")))) < 3.6


def test_every_inserted_vehicle_has_a_route_that_the_net_has(written: Path, made_scene: Path) -> None:
    scenario = read_scenario(made_scene)
    sidecar = read_sidecar(sidecar_path(made_scene, scenario.scenario_id))
    net, routes = _read(written, ".net.xml"), _read(written, ".rou.xml")
    links = {(link.get("from"), link.get("to")) for link in net.iter("connection")}
    vehicles = {vehicle.get("id"): vehicle for vehicle in routes.iter("vehicle")}
    assert vehicles.keys() == {agent.track_id for agent in sidecar.agents}
    types = {kind.get("id"): kind for kind in routes.iter("vType")}
    for agent in sidecar.agents:
        vehicle = vehicles[agent.track_id]
        edges = vehicle.find("route").get("edges").split()
        assert all(pair in links for pair in pairwise(edges))
        assert float(vehicle.get("depart")) == pytest.approx(scenario.track(agent.track_id).timesteps[0] * 0.1)
        kind = types[vehicle.get("type")]
        assert (float(kind.get("length")), float(kind.get("width"))) == pytest.approx(
            (agent.length_m, agent.width_m), abs=0.006
        )
    departures = [float(vehicle.get("depart")) for vehicle in routes.iter("vehicle")]
    assert departures == sorted(departures)


def test_sumo_takes_each_driver_as_it_was_driven_with(written: Path, made_scene: Path) -> None:
    """SUMO leaves out attributes that it does not know without a word, so what it holds is asked of it."""
    code = """
import json, sys, libsumo
libsumo.start(["sumo", "-c", sys.argv[1], "--no-step-log"])
ask = libsumo.vehicletype
kinds = [name for name in ask.getIDList() if name.startswith("type_")]
got = {k: [ask.getMaxSpeed(k), ask.getTau(k), ask.getAccel(k), ask.getDecel(k), ask.getMinGap(k)] for k in kinds}
print(json.dumps(got))
"""
    (config,) = (path for path in written.glob("*.sumocfg") if "_scene" not in path.name)
    result = subprocess.run([sys.executable, "-c", code, config], capture_output=True, text=True, check=True)
    assert result.stderr == ""
    got = json.loads(result.stdout.splitlines()[-1])
    agents = read_sidecar(sidecar_path(made_scene, read_scenario(made_scene).scenario_id)).agents
    names = ("desired_mps", "tau_s", "accel_mps2", "decel_mps2", "min_gap_m")
    wanted = {f"type_{one.track_id}": [one.driver.parameters[name] for name in names] for one in agents}
    assert got.keys() == wanted.keys()
    for kind, values in wanted.items():
        assert got[kind] == pytest.approx(values, rel=1e-4)


def test_a_recorded_scene_has_no_routes_and_all_else(data_scene: Path) -> None:
    scenario = read_scenario(data_scene)
    names = {name.removeprefix(scenario.scenario_id) for name in sumo_files(scenario)}
    assert {name for name in names if not name.startswith("_scene")} == {
        ".net.xml", ".sumocfg", ".poly.xml", ".view.xml", ".cells.csv", ".fcd.xml"
    }  # fmt: skip


def test_the_net_lies_on_a_map(written: Path, made_scene: Path) -> None:
    """netOffset takes the origin of the city off: UTM minus the offset is the city frame."""
    location = _read(written, ".net.xml").find("location")
    origin = CITY_ORIGINS[read_scenario(made_scene).city]
    east, north = (float(part) for part in location.get("netOffset").split(","))
    assert (-east, -north) == pytest.approx((origin.easting_m, origin.northing_m))
    assert f"+zone={origin.zone}" in location.get("projParameter")
    box, first = (list(map(float, location.get(name).split(","))) for name in ("origBoundary", "convBoundary"))
    assert np.array(box) - np.tile([-east, -north], 2) == pytest.approx(np.array(first), abs=0.02)


@pytest.mark.parametrize("city", CITY_ORIGINS)
def test_origins_are_those_of_av2(city: str) -> None:
    name = CityName(_NAMES[city])
    latitude, longitude = CITY_ORIGIN_LATLONG_DICT[name]
    theirs = convert_gps_to_utm(latitude, longitude, name)
    assert CITY_ORIGINS[city].zone == UTM_ZONE_MAP[name]
    assert (CITY_ORIGINS[city].easting_m, CITY_ORIGINS[city].northing_m) == pytest.approx(theirs, abs=1e-3)
